//! The laser measures the simulated machine through the controller.

use haptimill_calibration::calibrate::{Measured, Plan, calibrate};
use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::laser::LaserOptions;
use haptimill_calibration::scenario::{Volume, machine, travel, truth, worn};
use haptimill_machine_file::MachineFile;
use haptimill_volumetric::chain::Model;
use haptimill_volumetric::errors::{Approach, ErrorSet, Function, Shape, Table};
use haptimill_volumetric::file;
use haptimill_volumetric::grid::Grid;

fn plan(laser: LaserOptions) -> Plan {
    Plan {
        interval: 60.0,
        wait: 0.8,
        laser,
        ..Plan::default()
    }
}

/// Instruments without noise find the errors of the machine: the volumes differ by a motion of the
/// whole work and by what the drives leave at standstill, at points whose coordinates are targets.
#[test]
fn exact_instruments_find_the_errors() {
    let file = machine().unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let found = calibrate(&mut powered, &file, &plan(LaserOptions::ideal()), |_| ()).unwrap();
    let (_, errors) = truth(&file).unwrap();
    let places = |axis: usize| {
        let targets = found.axes[axis].targets.iter().copied();
        targets.filter(|place| place.abs() < 150.0).collect()
    };
    let grid = Grid {
        places: [places(0), places(1), places(2)],
    };
    let model = Model::default();
    let volume = Volume::of(grid.points(), |point| {
        model.error(&found.errors, point) - model.error(&errors, point)
    });
    let (raw, rest) = (volume.sizes(), volume.without_motion().sizes());
    println!("{raw:?}, without motion {rest:?}");
    assert!(rest.largest < 0.05e-3, "{rest:?}");
    let report = found.report();
    assert!(report.contains("the machine has none"), "{report}");
    assert!(
        report.contains("by another instrument than the laser"),
        "{report}"
    );
    // Every channel shows 0 at its first target.
    for measured in found.axes.iter().flat_map(|axis| &axis.functions) {
        assert_eq!(measured.up[0][0], 0.0, "{}", measured.function);
    }
}

/// A compensated machine is measured too: a beam between tool and table reads what the compensation
/// leaves of the translations, and the whole of the rotations. The report says so.
#[test]
fn a_compensated_machine_reads_what_is_left() {
    let file = machine().unwrap();
    let compensated = haptimill_calibration::scenario::with_exact_tables(&file).unwrap();
    let coarse = Plan {
        interval: 100.0,
        ..plan(LaserOptions::ideal())
    };
    let mut powered = Machine::new(&compensated, SLOW, &Default::default()).unwrap();
    let mut ranges = |on| {
        powered.compensate(on).unwrap();
        let found = calibrate(&mut powered, &compensated, &coarse, |_| ()).unwrap();
        let all = found.axes.iter().flat_map(|axis| &axis.functions);
        let range = |measured: &Measured| {
            let readings = measured.up.iter().chain(&measured.down).flatten();
            let [low, high] =
                [f64::min, f64::max].map(|of| readings.clone().copied().fold(0.0, of));
            (measured.function, high - low)
        };
        (all.map(range).collect::<Vec<_>>(), found.report())
    };
    let (off, report) = ranges(false);
    assert!(report.contains("compensation off"), "{report}");
    let (on, report) = ranges(true);
    assert!(report.contains("ON (100 %)"), "{report}");
    for ((function, off), (_, on)) in off.into_iter().zip(on) {
        let unit = function.file_unit();
        println!("{function} off {:.3} on {:.3}", off / unit, on / unit);
        if function.rotates {
            // At another place by the correction.
            assert!((on - off).abs() < 0.01e-6, "{function}: {off} {on}");
        } else {
            // Twice the goal of 0.1 um: a range has two ends.
            assert!(off > 0.5e-3, "{function}: {off}");
            assert!(on < 0.2e-3, "{function}: {on}");
        }
    }
}

/// What is left of the errors of a worn machine is what the stated uncertainty of the instruments
/// leaves, not the distance of the targets: in each of ten readings of a target the instruments are
/// off by their uncertainty, and a coordinate of the tool has two straightness errors, one
/// positioning error and the one at the origin.
#[test]
fn measured_errors_are_as_exact_as_the_instruments() {
    let file = worn(&machine().unwrap(), 10.0).unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let plan = Plan::default();
    let found = calibrate(&mut powered, &file, &plan, |_| ()).unwrap();
    let (_, errors) = truth(&file).unwrap();
    let model = Model::default();
    let volume = Volume::of(Grid::part().points(), |point| {
        model.error(&found.errors, point) - model.error(&errors, point)
    });
    let rest = volume.without_motion().sizes();
    // The options are two standard deviations.
    let mean_of_ten = |two: f64| (0.5 * two).powi(2) / 10.0;
    let laser = plan.laser;
    let coordinate = 2.0 * mean_of_ten(laser.straightness.1) + 2.0 * mean_of_ten(laser.resolution);
    let point = (3.0 * coordinate).sqrt();
    println!("expected {point} mm, {rest:?}");
    assert!((0.3 * point..1.5 * point).contains(&rest.rms), "{rest:?}");
    assert!(rest.largest < 3.0 * point, "{rest:?}");
    // Roll, by its own instrument: the mean of ten readings, less the one at the origin.
    let roll = Function::of_name("EAX").unwrap();
    let Shape::Table(table) = found.errors.function(roll) else {
        panic!("a table");
    };
    let truth = |at: f64| errors.function(roll).value(at, Approach::Any);
    let off = |(at, value): (&f64, &f64)| value - (truth(*at) - truth(0.0));
    let off: Vec<f64> = table.nodes.iter().zip(&table.up).map(off).collect();
    let reading = (2.0 * mean_of_ten(laser.roll.unwrap())).sqrt();
    let largest = off
        .iter()
        .fold(0.0_f64, |largest, off| largest.max(off.abs()));
    println!("roll: expected {reading}, largest {largest}");
    assert!(largest < 3.0 * reading, "{largest} {reading}");
}

/// Values by direction are a reversal error of the machine: the laser reads it, and the tables of
/// its axis have a value for each direction.
#[test]
fn errors_by_direction_are_a_reversal() {
    let plain = machine().unwrap();
    let (text, errors) = truth(&plain).unwrap();
    let mut errors = errors.tabulated(&travel(&plain), [64; 3]);
    let name = |name: &str| Function::of_name(name).unwrap();
    let exx = name("EXX");
    let mean = |set: &ErrorSet, at: f64| set.function(exx).value(at, Approach::default());
    let before = errors.clone();
    let Shape::Table(table) = errors.function(exx).clone() else {
        panic!("a table");
    };
    let moved = |by: f64| table.up.iter().map(|value| value + by).collect();
    let pair = Table {
        nodes: table.nodes.clone(),
        up: moved(-1e-3),
        down: Some(moved(1e-3)),
    };
    errors.set(exx, Shape::Table(pair));
    let pairs = file::write(&errors, "pairs");
    let text = plain.text.replace(text.trim_end(), pairs.trim_end());
    let file = MachineFile::parse("pairs.toml", &text).unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let coarse = Plan {
        interval: 100.0,
        ..plan(LaserOptions::ideal())
    };
    let found = calibrate(&mut powered, &file, &coarse, |_| ()).unwrap();
    let reversal = |function: Function| {
        let mut all = found.axes.iter().flat_map(|axis| &axis.functions);
        let measured = all.find(|measured| measured.function == function);
        measured.unwrap().result.reversal
    };
    assert!((reversal(exx) - 2e-3).abs() < 0.15e-3, "{}", reversal(exx));
    assert!(reversal(name("EYY")) < 0.15e-3);
    for target in &found.axes[0].targets {
        let off = mean(&found.errors, *target) - (mean(&before, *target) - mean(&before, 0.0));
        assert!(off.abs() < 0.15e-3, "{target}: {off}");
        let shape = found.errors.function(exx);
        let lost = shape.value(*target, Approach::Down) - shape.value(*target, Approach::Up);
        assert!((lost - 2e-3).abs() < 0.15e-3, "{target}: {lost}");
    }
    let Shape::Table(table) = found.errors.function(name("EYY")) else {
        panic!("a table");
    };
    assert_eq!(table.down, None);
}

/// A machine that is not homed is refused, and nothing moves.
#[test]
fn an_unhomed_machine_is_refused() {
    let file = machine().unwrap();
    let mut powered = Machine::without_homing(&file, SLOW, &Default::default()).unwrap();
    let before = powered.status().unwrap().joints;
    let refused = calibrate(&mut powered, &file, &Plan::default(), |_| ()).unwrap_err();
    assert!(
        refused.message.contains("home it first; nothing moved"),
        "{refused:?}"
    );
    assert_eq!(powered.status().unwrap().joints, before);
}
