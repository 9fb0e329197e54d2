//! Error tables in the controller: integrity while the machine runs, refusal by the configuration,
//! the fade after homing; and the errors of the simulated machine by both models.

use haptimill_calibration::drive::{Machine as Driven, SLOW};
use haptimill_calibration::scenario::{machine, with_exact_tables};
use haptimill_firmware::config::Config;
use haptimill_firmware::config::volumetric::VolumetricConfig;
use haptimill_firmware::io::Inputs;
use haptimill_firmware::machine::Machine;
use haptimill_hil_sim::machines::carriage_errors::{CarriageErrors, ErrorModel};
use haptimill_machine_file::MachineFile;
use haptimill_math::Coordinate;
use haptimill_protocol::message::ConfigField;

fn config() -> Config {
    with_exact_tables(&machine().unwrap()).unwrap().config
}

/// Whether a machine notices a change of its tables while it runs.
fn is_noticed(change: impl FnOnce(&mut VolumetricConfig)) -> bool {
    let mut running = Machine::new(config(), 0, &Inputs::default()).expect("sound");
    assert!((0..60).all(|_| running.check_next_digest()));
    change(running.config.volumetric.as_mut().unwrap());
    (0..60).any(|_| !running.check_next_digest())
}

/// A flipped bit in any part of the tables is noticed.
#[test]
fn a_changed_table_is_noticed() {
    assert!(!is_noticed(|_| ()));
    let values = config().volumetric.unwrap().values.len();
    for place in [0, 200, 400, 600, 800, 1000, values - 1] {
        assert!(is_noticed(|tables| tables.values[place] ^= 1), "{place}");
    }
    for axis in 0..3 {
        assert!(is_noticed(|tables| tables.axes[axis].arm ^= 1));
        assert!(is_noticed(|tables| tables.axes[axis].first.0 ^= 1));
        assert!(is_noticed(|tables| tables.axes[axis].measured_at[2].0 ^= 1));
        assert!(is_noticed(|tables| tables.squareness[axis] ^= 1));
    }
    assert!(is_noticed(|tables| tables.shift ^= 1));
}

/// Tables that the controller cannot use are refused with the whole configuration, with their axis.
#[test]
fn unusable_tables_are_refused() {
    let refused = |change: fn(&mut Config)| {
        let mut config = config();
        change(&mut config);
        let problem = config.check().unwrap_err();
        assert_eq!(problem.field, ConfigField::Volumetric, "{problem:?}");
        problem.axis
    };
    assert_eq!(config().check(), Ok(()));
    // 3 mm of stroke beyond a soft limit, and 4 are needed.
    assert_eq!(
        refused(|config| config.joints[1].low = Coordinate(config.pose[1].low.0 - 3 * (1 << 20))),
        Some(1)
    );
    assert_eq!(
        refused(|config| config.joints[2].high = Coordinate(config.pose[2].high.0 + 3 * (1 << 20))),
        Some(2)
    );
    // A step of 0.03 mm between two nodes of x.
    let steep = |config: &mut Config| {
        let tables = config.volumetric.as_mut().unwrap();
        tables.values[60] = 30_000 >> tables.shift;
    };
    assert_eq!(refused(steep), Some(0));
    // Tables that end before the travel does.
    assert_eq!(
        refused(|config| config.volumetric.as_mut().unwrap().axes[2].nodes -= 1),
        Some(0)
    );
    // Joints that are not the coordinates: the arm.
    let mut arm = MachineFile::built_in().unwrap().config;
    assert_eq!(arm.check(), Ok(()));
    arm.volumetric = config().volumetric;
    let problem = arm.check().unwrap_err();
    assert_eq!(
        (problem.field, problem.axis),
        (ConfigField::Volumetric, None)
    );
}

/// Without a command, compensation is in full effect after homing, and stays out before it.
#[test]
fn compensation_waits_for_homing() {
    let file = with_exact_tables(&machine().unwrap()).unwrap();
    let mut homed = Driven::new(&file, SLOW, &Default::default()).unwrap();
    homed.visit(&[[0.0, 0.0, 0.0]], 100.0, 1.2, 0.3).unwrap();
    assert_eq!(homed.status().unwrap().compensation, Some(100));
    let mut unhomed = Driven::without_homing(&file, SLOW, &Default::default()).unwrap();
    let before = unhomed.status().unwrap().joints;
    let refused = unhomed.compensate(true).unwrap_err();
    assert!(refused.message.contains("home it first"), "{refused:?}");
    let status = unhomed.status().unwrap();
    assert_eq!((status.compensation, status.joints), (Some(0), before));
}

/// The simulated machine has the published errors at one point, with the model of its frames and
/// with that of the thesis (um).
#[test]
fn both_models_of_the_simulated_machine() {
    let text = include_str!("../../volumetric/data/vmc3_errors.csv");
    for (model, expected) in [
        (ErrorModel::Physical, [3.1437, 1.1817, -0.5239]),
        (ErrorModel::Thesis, [0.4253, 2.7701, -1.1598]),
    ] {
        let mut errors = CarriageErrors::parse(text, model).unwrap().unwrap();
        let error = errors.follow([70.0, -80.0, -10.0]);
        println!("{model:?} {error:?}");
        for (error, expected) in error.iter().zip(expected) {
            assert!((error * 1e3 - expected).abs() < 0.002, "{model:?} {error}");
        }
    }
}
