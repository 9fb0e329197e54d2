//! Volumetric compensation through the whole chain: the error file as the controller's tables, the
//! same file as the truth of the simulated machine, and the tool at standstill in between.

use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::scenario::{with_exact_tables, worn};
use haptimill_machine_file::MachineFile;
use haptimill_volumetric::Vector;
use haptimill_volumetric::grid::{Grid, Sizes};
use std::path::Path;

fn machine() -> MachineFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../machines/vmc3.toml");
    MachineFile::load(&path).unwrap_or_else(|problems| panic!("{problems}"))
}

/// Errors of the tool at standstill at every point of the grid, mm.
fn errors(machine: &mut Machine) -> Vec<Vector> {
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
    let before = Sizes::of(errors(&mut machine));
    machine.compensate(true).unwrap();
    let after = Sizes::of(errors(&mut machine));
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
