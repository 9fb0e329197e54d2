//! The laser measures the simulated machine through the controller.

use haptimill_calibration::calibrate::{Plan, calibrate};
use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::laser::LaserOptions;
use haptimill_calibration::scenario::{Volume, machine, truth};
use haptimill_volumetric::chain::Model;
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
    assert!(rest.largest < 0.15e-3, "{rest:?}");
    let report = found.report();
    assert!(report.contains("the machine has none"), "{report}");
    assert!(
        report.contains("by another instrument than the laser"),
        "{report}"
    );
    // A compensated machine is measured too, and the report says so.
    let compensated = haptimill_calibration::scenario::with_exact_tables(&file).unwrap();
    let mut powered = Machine::new(&compensated, SLOW, &Default::default()).unwrap();
    powered.compensate(true).unwrap();
    let status = powered.status().unwrap();
    assert_eq!(status.compensation, Some(100));
    let mut said = found;
    said.compensation = status.compensation;
    assert!(said.report().contains("ON (100 %)"));
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
