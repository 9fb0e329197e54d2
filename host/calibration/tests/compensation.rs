//! Volumetric compensation through the whole chain: the error file as the controller's tables, the
//! same file as the truth of the simulated machine, and the tool at standstill in between.

use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_machine_file::MachineFile;
use haptimill_volumetric::Vector;
use haptimill_volumetric::errors::ErrorSet;
use haptimill_volumetric::file::{self, Limits};
use haptimill_volumetric::grid::{Grid, Sizes};
use std::path::Path;

fn machine() -> MachineFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../machines/vmc3.toml");
    MachineFile::load(&path).unwrap_or_else(|problems| panic!("{problems}"))
}

fn truth() -> ErrorSet {
    let text = include_str!("../../volumetric/data/vmc3_errors.csv");
    file::read(text, &Limits::default()).unwrap()
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

#[test]
fn exact_tables_leave_a_tenth_of_a_micrometre() {
    let travel = [(-325.0, 325.0), (-250.0, 250.0), (-150.0, 300.0)];
    let tables = truth().tabulated(&travel, [66, 64, 62]);
    let text = file::write(&tables, "exact");
    let machine = machine().with_errors("exact.csv", &text, "wYbXZt");
    let machine = machine.unwrap_or_else(|problems| panic!("{problems}"));
    let mut machine = Machine::new(&machine, SLOW, &Default::default()).unwrap();
    machine.compensate(false).unwrap();
    let before = Sizes::of(errors(&mut machine));
    machine.compensate(true).unwrap();
    let after = Sizes::of(errors(&mut machine));
    println!("before {before:?}, after {after:?}");
    assert!((before.largest - 4.81e-3).abs() < 0.15e-3, "{before:?}");
    assert!(after.largest <= 0.1e-3, "{after:?}");
}
