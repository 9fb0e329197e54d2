//! Error tables in the controller: integrity while the machine runs, refusal by the configuration,
//! the fade after homing; and the errors of the simulated machine by both models.

use haptimill_calibration::drive::{Machine as Driven, SLOW};
use haptimill_calibration::scenario::{machine, travel, truth, with_exact_tables};
use haptimill_client::client::Options;
use haptimill_client::session::{self, Session, SimLine};
use haptimill_firmware::config::Config;
use haptimill_firmware::config::volumetric::VolumetricConfig;
use haptimill_firmware::io::Inputs;
use haptimill_firmware::machine::Machine;
use haptimill_hil_sim::machines::carriage_errors::{CarriageErrors, ErrorModel};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_math::Coordinate;
use haptimill_protocol::frame::crc32;
use haptimill_protocol::message::{ConfigField, State};
use haptimill_volumetric::errors::{ErrorSet, Function, Shape, Table, even_nodes};
use haptimill_volumetric::file;

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

/// The blob of a configuration keeps its tables, and its CRC detects every flipped bit in them.
#[test]
fn a_corrupted_blob_is_detected_by_its_crc() {
    let file = with_exact_tables(&machine().unwrap()).unwrap();
    let (blob, crc) = file.encoded().unwrap();
    let read: Config = postcard::from_bytes(&blob).unwrap();
    assert_eq!(read.volumetric, file.config.volumetric);
    let (without, _) = machine().unwrap().encoded().unwrap();
    assert!(blob.len() > without.len() + 1000, "{}", blob.len());
    assert_eq!(crc32(&blob), crc);
    for place in 0..blob.len() {
        let mut changed = blob.clone();
        changed[place] ^= 1 << (place % 8);
        assert_ne!(crc32(&changed), crc, "{place}");
    }
}

/// Tables that the controller cannot use are refused with the whole configuration, with their axis.
#[test]
fn unusable_tables_are_refused() {
    let refused = |change: fn(&mut Config)| {
        let mut config = config();
        change(&mut config);
        let problem = config.check().unwrap_err();
        assert_eq!(problem.field, ConfigField::Volumetric, "{problem:?}");
        problem.index
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
        (problem.field, problem.index),
        (ConfigField::Volumetric, None)
    );
}

/// An error function that changes between the nodes of the controller's tables, here with the lead
/// of a screw, is refused with its name: compensation would make it worse. One that the nodes
/// resolve is accepted, and so is the noise of an instrument.
#[test]
fn errors_between_the_nodes_are_refused() {
    let machine = machine().unwrap();
    let travel = travel(&machine);
    let wave = |length: f64, amplitude: f64| {
        let mut errors = truth(&machine).unwrap().1.tabulated(&travel, [31; 3]);
        let function = Function::all().next().unwrap();
        let nodes: Vec<f64> = even_nodes(travel[0], 651);
        let value = |at: &f64| amplitude * (std::f64::consts::TAU * at / length).sin();
        let values = nodes.iter().map(value).collect();
        errors.set(function, Shape::Table(Table::both(nodes, values)));
        let text = file::write(&errors, "");
        machine.with_errors("errors.csv", &text, "wYbXZt")
    };
    for (length, amplitude) in [(10.0, 1.5e-3), (20.0, 3e-3)] {
        let refused = wave(length, amplitude).expect_err("refused").to_string();
        assert!(
            refused.contains("EXX changes between the nodes"),
            "{refused}"
        );
        assert!(refused.contains("; smooth the function"), "{refused}");
    }
    for (length, amplitude) in [(200.0, 1.5e-3), (10.0, 5e-5)] {
        if let Err(refused) = wave(length, amplitude) {
            panic!("{length} {amplitude}: {refused}");
        }
    }
}

/// With the drives off there is no correction, after an emergency stop and after a fault of a
/// drive; the end of the correction moves no joint.
#[test]
fn the_correction_ends_with_the_drives() {
    let file = with_exact_tables(&machine().unwrap()).unwrap();
    let trip = "drive-tripped joint=y at=30s".parse().unwrap();
    for (faults, expected) in [(vec![], State::EmergencyStop), (vec![trip], State::Fault)] {
        let rig = session::rig(&file, None, None, faults).unwrap();
        let line = SimLine::new(rig);
        let mut session = Session::new(line, &file, Options::default(), Default::default());
        session.connect(1).unwrap();
        session.configure(&file).unwrap();
        session.enable().unwrap();
        let home = session::find_home_pose(&file, &Model::new(&file)).unwrap();
        session.go_home(&file, &home).unwrap();
        while session.now_us() < 29_000_000 {
            session.step().unwrap();
        }
        let before = session.status().unwrap();
        assert_eq!(before.compensation(), Some(100));
        // The correction at the home pose is more than 1 um.
        let moved = before.joints.iter().zip(&before.commanded);
        assert!(
            moved
                .into_iter()
                .any(|(joint, pose)| (joint - pose).abs() > 1 << 10)
        );
        if expected == State::EmergencyStop {
            session.emergency_stop();
        }
        while session.now_us() < 31_000_000 {
            session.step().unwrap();
        }
        let after = session.status().unwrap();
        assert_eq!((after.state, after.compensation()), (expected, Some(0)));
        for (joint, before) in after.joints.iter().zip(&before.joints) {
            assert!((joint - before).abs() < 1 << 9, "{joint} {before}");
        }
    }
}

/// Without a command, compensation is in full effect after homing, and stays out before it.
#[test]
fn compensation_waits_for_homing() {
    let file = with_exact_tables(&machine().unwrap()).unwrap();
    let mut homed = Driven::new(&file, SLOW, &Default::default()).unwrap();
    homed.visit(&[[0.0, 0.0, 0.0]], 100.0, 1.2, 0.3).unwrap();
    assert_eq!(homed.status().unwrap().compensation(), Some(100));
    let mut unhomed = Driven::without_homing(&file, SLOW, &Default::default()).unwrap();
    let before = unhomed.status().unwrap().joints;
    let refused = unhomed.compensate(true).unwrap_err();
    assert!(refused.message.contains("home it first"), "{refused:?}");
    let status = unhomed.status().unwrap();
    assert_eq!((status.compensation(), status.joints), (Some(0), before));
}

/// Lines of an error file that the simulated machine cannot follow are refused with their line.
#[test]
fn wrong_errors_of_the_simulated_machine_are_refused() {
    let (closed, tables) = (
        include_str!("../../volumetric/data/vmc3_errors.csv"),
        pairs("EYX"),
    );
    let first = tables
        .lines()
        .position(|line| line.starts_with("EYX,"))
        .unwrap()
        + 1;
    let line = |text: &str, start: &str| {
        text.lines()
            .position(|line| line.starts_with(start))
            .unwrap()
            + 1
    };
    for (text, expected) in [
        (
            tables.replacen(",up,", ",Up,", 1),
            format!("line {first}: \"EYX,-325.0000,Up,"),
        ),
        (
            tables.replacen(",up,", ",forward,", 1),
            "write the direction up or down, or nothing for both".to_string(),
        ),
        (
            closed.replace("EZX,um", "EYX,um"),
            format!("line {}: ", line(closed, "EZX")),
        ),
        (
            closed.replace("EB0Z,urad", "EC0Y,urad"),
            "remove one: this error is there twice".to_string(),
        ),
    ] {
        let refused = CarriageErrors::parse(&text, ErrorModel::Physical).unwrap_err();
        assert!(refused.contains(&expected), "{expected}\n{refused}");
    }
}

/// Tables with 1 um or 1 urad more downwards than upwards in one function, and 0 elsewhere.
fn pairs(name: &str) -> String {
    let travel = travel(&machine().unwrap());
    let mut errors = ErrorSet::default().tabulated(&travel, [14, 11, 10]);
    let function = Function::of_name(name).unwrap();
    let nodes = even_nodes(travel[function.moving.index()], 14);
    let pair = Table {
        up: vec![-0.5 * function.file_unit(); nodes.len()],
        down: Some(vec![0.5 * function.file_unit(); nodes.len()]),
        nodes,
    };
    errors.set(function, Shape::Table(pair));
    file::write(&errors, "pairs")
}

/// A straightness and a rotation by direction turn over within 1 um of a reversal, and act by the
/// arm of their axis: the whole work point for the table, z for the x axis.
#[test]
fn errors_by_direction_follow_the_carriage() {
    let point = [60.0, -40.0, -30.0];
    for (name, axis, expected) in [
        ("EYX", 0, [0.0, 1.0, 0.0]),
        ("EZY", 1, [0.0, 0.0, 1.0]),
        // um: 1 urad on an arm of 1000 mm is 1 um.
        ("EBX", 0, [-0.030, 0.0, 0.0]),
        ("ECY", 1, [0.040, 0.060, 0.0]),
    ] {
        let text = pairs(name);
        let mut errors = CarriageErrors::parse(&text, ErrorModel::Physical)
            .unwrap()
            .unwrap();
        let mut at = |off: f64| {
            let mut place = point;
            place[axis] += off;
            errors.follow(place).map(|part| part * 1e3)
        };
        at(-5.0);
        let up = at(0.0);
        at(5.0);
        let down = at(0.0);
        for (axis, expected) in expected.iter().enumerate() {
            let difference = down[axis] - up[axis];
            assert!(
                (difference - expected).abs() < 1e-5,
                "{name} {up:?} {down:?}"
            );
        }
        // Half of the reversal is passed after 0.5 um, all of it after 1 um.
        let [half, whole] = [0.5e-3, 1e-3].map(at);
        for (axis, expected) in expected.iter().enumerate() {
            assert!(
                (half[axis] - down[axis] + 0.5 * expected).abs() < 1e-5,
                "{name} {half:?}"
            );
            assert!(
                (whole[axis] - down[axis] + expected).abs() < 1e-5,
                "{name} {whole:?}"
            );
        }
    }
}

/// The machine file has the errors of the data file.
#[test]
fn the_machine_file_has_the_published_errors() {
    let (text, _) = truth(&machine().unwrap()).unwrap();
    assert_eq!(
        text.trim(),
        include_str!("../../volumetric/data/vmc3_errors.csv").trim()
    );
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
