//! Integrity check: a change of the configuration, or of a value derived from it, is detected while
//! the machine runs.

use crate::reference;
use haptimill_firmware::config::{Config, JointSettings};
use haptimill_firmware::digest::{Constants, Digest};
use haptimill_firmware::force::sensor::ForceSensor;
use haptimill_firmware::force::{EnableCondition, ForceConfig, ForceControl, LoopSettings};
use haptimill_firmware::io::{DriveCommand, Inputs, JointInputs};
use haptimill_firmware::joint::{JointCommand, JointDrive};
use haptimill_firmware::machine::Machine;
use haptimill_firmware::motion::interpolator::Interpolator;
use haptimill_firmware::motion::jog::Jog;
use haptimill_kinematics::Model;
use haptimill_math::force::{Force, VirtualDamping};
use haptimill_math::{Coordinate, Rate};
use reference::h4;

/// The arm with a force sensor.
fn forced() -> Config {
    let force = reference::force();
    Config {
        force: Some(ForceConfig {
            sensor: ForceSensor {
                weight: Force::millinewtons(29_420),
                ..force.sensor
            },
            mask: 5,
            creep: Rate(26_214),
            ..force
        }),
        ..h4()
    }
}

/// Checks until a change is detected; a full check takes one for each part.
fn rounds_until_seen(change: impl FnOnce(&mut Machine)) -> Option<usize> {
    // More than the digest parts of a machine.
    const PERIODS: usize = 100;
    let mut machine = Machine::new(forced(), 0, &Inputs::default()).expect("sound");
    assert!((0..PERIODS).all(|_| machine.check_next_digest()));
    change(&mut machine);
    (0..PERIODS).find(|_| !machine.check_next_digest())
}

#[test]
fn any_flipped_configuration_bit_is_detected() {
    // Bit by bit through the encoding: whatever still decodes is a configuration that differs in
    // one place.
    let mut buffer = [0; 1024];
    let bytes = postcard::to_slice(&forced(), &mut buffer)
        .expect("encodes")
        .to_vec();
    let mut tried = 0;
    for bit in 0..bytes.len() * 8 {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let Ok(config) = postcard::from_bytes::<Config>(&flipped) else {
            continue;
        };
        if config == forced() {
            continue;
        }
        tried += 1;
        let seen = rounds_until_seen(|active| active.config = config);
        assert!(seen.is_some(), "bit {bit} of byte {}", bit / 8);
    }
    assert!(tried > 2000, "{tried}");
}

/// Derived values are checked too: strokes and geometry, limits of program and jog.
#[test]
fn changed_derived_value_is_detected() {
    let changed = |change: fn(&mut Config)| {
        let mut config = forced();
        change(&mut config);
        config
    };
    let stroke = changed(|config| config.joints[2].high.0 += 1);
    let rod = changed(|config| {
        let Model::H4(geometry) = &mut config.model else {
            panic!("an H-4 arm");
        };
        geometry.rod.0 ^= 1 << 9;
    });
    let joint_rate = changed(|config| config.joints[4].rate.0 -= 1 << 12);
    for config in [&stroke, &rod, &joint_rate] {
        assert!(rounds_until_seen(|active| active.kinematics = config.kinematics()).is_some());
    }
    let jerk = changed(|config| config.pose[1].jerk /= 2);
    let soft = changed(|config| config.pose[3].low.0 += 1 << 16);
    for config in [&jerk, &soft] {
        assert!(rounds_until_seen(|active| active.motion.jog = Jog::new(config)).is_some());
    }
    let stopping = changed(|config| config.stopping.time_ms += 10);
    let rate = changed(|config| config.pose[0].rate.0 += 1 << 10);
    for config in [&stopping, &rate] {
        assert!(
            rounds_until_seen(|active| active.motion.program = Interpolator::new(config)).is_some()
        );
    }
}

/// Values derived from another gain, scale, delay or creep rate of force control are detected.
#[test]
fn changed_force_control_constant_is_detected() {
    let changes: [fn(&mut ForceConfig); 8] = [
        |force| force.axes[0].damping.0 += 1 << 12,
        |force| force.axes[1].mass.0 += 1 << 10,
        |force| force.axes[2].limit.0 -= 1 << 18,
        |force| force.axes[2].enable_condition = EnableCondition::Any,
        |force| force.sensor.channels[1].per_code *= -1,
        |force| force.sensor.limit.0 += 1 << 16,
        |force| force.drive_lag_us += 100,
        |force| force.creep.0 *= 2,
    ];
    for (index, change) in changes.into_iter().enumerate() {
        let mut config = forced().force.expect("there");
        change(&mut config);
        let other = ForceControl::new(&config, 200).expect("sound");
        let seen = rounds_until_seen(|active| active.force = Some(other));
        assert!(seen.is_some(), "change {index}");
    }
    // Settings that a person changes at run time are no fault: the digest goes with them.
    let mut machine = Machine::new(forced(), 0, &Inputs::default()).expect("sound");
    let force = machine.force.as_mut().expect("there");
    let gentle = LoopSettings {
        damping: VirtualDamping(2 << 16),
        ..force.settings(0).expect("there").clone()
    };
    force.set(0, &gentle).expect("taken");
    for _ in 0..100 {
        machine.comply(false, false);
        assert!(machine.check_next_digest());
    }
    let force = machine.force.as_ref().expect("there");
    assert_eq!(force.settings(0), Some(&gentle));
}

/// The digest of a joint covers each of its constants and none of its states.
#[test]
fn changed_joint_constant_is_detected_motion_is_not() {
    let digest = |joint: &JointDrive| {
        let mut digest = Digest::default();
        joint.digest(&mut digest);
        digest
    };
    let made = |settings: &JointSettings| digest(&JointDrive::new(settings, 200).expect("sound"));
    let settings = h4().joints[0].clone();
    let changes: [fn(&mut JointSettings); 10] = [
        |settings| settings.encoder.as_mut().expect("an encoder").per_count += 1,
        |settings| settings.backlash.0 += 2,
        |settings| settings.law.kp.0 += 1,
        |settings| settings.law.kd.0 += 1,
        |settings| settings.law.ki.0 += 1 << 8,
        |settings| settings.law.inertia += 1,
        |settings| settings.law.viscous += 1,
        |settings| settings.law.coulomb.0 += 1,
        |settings| settings.law.coulomb_rate.0 += 1 << 4,
        |settings| settings.law.rate_filter_us += 1,
    ];
    for (index, change) in changes.iter().enumerate() {
        let mut other = settings.clone();
        change(&mut other);
        assert_ne!(made(&settings), made(&other), "change {index}");
    }
    let mut joint = JointDrive::new(&settings, 200).expect("sound");
    let before = digest(&joint);
    let mut inputs = JointInputs::default();
    joint.measure(&inputs, 0);
    joint.enable();
    for period in 1..500_i32 {
        inputs.counts = period * period / 100;
        joint.measure(&inputs, period as u32 * 200_000);
        let commanded = JointCommand {
            coordinate: Coordinate(period << 12),
            rate: Rate(-period << 8),
            ..JointCommand::default()
        };
        let mut command = DriveCommand::Off;
        joint.servo(
            commanded.coordinate,
            commanded.rate,
            commanded.acceleration,
            &mut command,
        );
    }
    joint.set_reference(7, Coordinate(99));
    joint.disable();
    assert_eq!(digest(&joint), before);
}
