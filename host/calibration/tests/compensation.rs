//! Volumetric compensation through the whole chain: the error file as the controller's tables, the
//! same file as the truth of the simulated machine, and the tool at standstill in between.

use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::scenario::{travel, truth, with_exact_tables, worn};
use haptimill_machine_file::MachineFile;
use haptimill_math::Coordinate;
use haptimill_volumetric::errors::{ClosedForm, ErrorSet, Function, Shape, Table};
use haptimill_volumetric::grid::{Grid, Sizes};
use haptimill_volumetric::{Vector, file};
use std::path::Path;

fn machine() -> MachineFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../machines/vmc3.toml");
    MachineFile::load(&path).unwrap_or_else(|problems| panic!("{problems}"))
}

/// Errors of the tool at standstill at every point of the grid, mm.
fn errors_of(machine: &mut Machine) -> Vec<Vector> {
    let targets: Vec<[f64; 3]> = Grid::part()
        .points()
        .iter()
        .map(|p| [p.x, p.y, p.z])
        .collect();
    let stood = machine.visit(&targets, 100.0, 1.2, 0.3).unwrap();
    let errors = stood.iter().zip(&targets);
    errors
        .map(|(sample, target)| Vector::from_fn(|axis, _| sample.tool[axis] - target[axis]))
        .collect()
}

/// Checks the largest error of a machine without compensation, um, and that exact tables leave a
/// tenth of a micrometre.
fn check(machine: &MachineFile, um: f64) {
    let compensated = with_exact_tables(machine).unwrap();
    let mut machine = Machine::new(&compensated, SLOW, &Default::default()).unwrap();
    machine.compensate(false).unwrap();
    let before = Sizes::of(errors_of(&mut machine));
    machine.compensate(true).unwrap();
    let after = Sizes::of(errors_of(&mut machine));
    println!("before {before:?}, after {after:?}");
    assert!((before.largest * 1e3 - um).abs() < 0.03 * um, "{before:?}");
    assert!(after.largest <= 0.1e-3, "{after:?}");
}

#[test]
fn exact_tables_leave_a_tenth_of_a_micrometre() {
    check(&machine(), 4.81);
}

// The correction changes the pose at which the errors are evaluated: with ten times the errors,
// that counts a hundred times.
#[test]
fn exact_tables_of_a_worn_machine_leave_a_tenth_of_a_micrometre() {
    check(&worn(&machine(), 10.0).unwrap(), 48.1);
}

/// Pitch errors of the screws of a machine with step motors and without scales: only EXX, EYY and
/// EZZ are known. What is left at standstill is in the order of a microstep, 1.6 um.
#[test]
fn pitch_errors_of_an_open_loop_are_compensated() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../machines/mill3.toml");
    let plain = MachineFile::load(&path).unwrap_or_else(|problems| panic!("{problems}"));
    let mut errors = ErrorSet::default();
    for (name, slope) in [("EXX", 1.5e-4), ("EYY", -2e-4), ("EZZ", 1e-4)] {
        // 0.15 um per mm, and a wave of 8 um over 60 mm.
        let form = ClosedForm {
            slope,
            sines: [[4e-3, 60.0, 0.5], [0.0; 3]],
            ..ClosedForm::default()
        };
        errors.set(Function::of_name(name).unwrap(), Shape::ClosedForm(form));
    }
    let text = file::write(&errors.tabulated(&travel(&plain), [31; 3]), "pitch");
    let with = |text: &str| format!("squareness_yz = 0.0\nerrors = \"\"\"\n{text}\"\"\"\n");
    let truth = plain
        .text
        .replacen("squareness_yz = 0.0\n", &with(&text), 1);
    assert_ne!(truth, plain.text);
    let file = MachineFile::parse("pitch.toml", &truth).unwrap();
    let file = file.with_errors("pitch.csv", &text, "wYbXZt").unwrap();
    let mut machine = Machine::new(&file, SLOW, &Default::default()).unwrap();
    // The first one is not evaluated: all others are reached upwards, without lost motion.
    let places = [-140.0, -130.0, -77.0, -20.0, 41.0, 90.0, 130.0];
    let targets: Vec<[f64; 3]> = places.map(|at| [at, 0.6 * at, 0.25 * at]).into();
    let mut sizes = |on| {
        machine.compensate(on).unwrap();
        let stood = machine.visit(&targets, 20.0, 1.2, 0.3).unwrap();
        let errors: Vec<Vector> = stood
            .iter()
            .zip(&targets)
            .skip(1)
            .map(|(sample, target)| Vector::from_fn(|axis, _| sample.tool[axis] - target[axis]))
            .collect();
        // The switches find the origin to some micrometres; a part has an origin of its own.
        let mean = errors.iter().sum::<Vector>() / errors.len() as f64;
        Sizes::of(errors.iter().map(|error| error - mean))
    };
    let (before, after) = (sizes(false), sizes(true));
    println!("open loop: before {before:?}, after {after:?}");
    assert!(before.largest > 20e-3, "{before:?}");
    assert!(after.largest < 2e-3, "{after:?}");
}

/// A screw with lost motion that grows along the travel, in an error file with a value for each
/// direction. The mean alone leaves half of it; the joint's table of lost motion takes the rest.
#[test]
fn lost_motion_by_place_is_compensated() {
    let plain = machine();
    let (text, errors) = truth(&plain).unwrap();
    let mut errors = errors.tabulated(&travel(&plain), [64; 3]);
    for name in ["EXX", "EYY"] {
        let function = Function::of_name(name).unwrap();
        let Shape::Table(mean) = errors.function(function).clone() else {
            panic!("a table");
        };
        // 3.2 um at the lower end of the part to 4.8 um at the upper one.
        let half = |at: f64| 0.5 * (4e-3 + 1e-5 * at);
        let side = |sign: f64| {
            let values = mean.nodes.iter().zip(&mean.up);
            values.map(|(at, value)| value + sign * half(*at)).collect()
        };
        let pair = Table {
            nodes: mean.nodes.clone(),
            up: side(-1.0),
            down: Some(side(1.0)),
        };
        errors.set(function, Shape::Table(pair));
    }
    let pairs = file::write(&errors, "pairs");
    let text = plain.text.replace(text.trim_end(), pairs.trim_end());
    let file = MachineFile::parse("pairs.toml", &text).unwrap();
    let mut compensated = with_exact_tables(&file).unwrap();
    let sizes = |file: &MachineFile| {
        let mut machine = Machine::new(file, SLOW, &Default::default()).unwrap();
        machine.compensate(true).unwrap();
        Sizes::of(errors_of(&mut machine))
    };
    let with_table = sizes(&compensated);
    for joint in &mut compensated.config.joints {
        joint.backlash = Coordinate(0);
        joint.backlash_table.clear();
    }
    let mean_alone = sizes(&compensated);
    println!("with the table {with_table:?}, the mean alone {mean_alone:?}");
    // The largest errors are those of an axis that stands while its correction reverses: the
    // carriage crosses the lost motion within the wait, and the integrator has not ended.
    assert!(
        with_table.rms < 0.4e-3 && with_table.largest < 1.3e-3,
        "{with_table:?}"
    );
    assert!(mean_alone.rms > 2e-3, "{mean_alone:?}");
}
