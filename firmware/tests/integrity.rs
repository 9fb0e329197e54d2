//! A change of the configuration, or of what was worked out from it, is seen while the machine runs.

mod reference;

use haptimill_firmware::config::{Config, JointAxis, Model};
use haptimill_firmware::drive::{JointDrive, Wanted};
use haptimill_firmware::io::{AxisInputs, Inputs};
use haptimill_firmware::kinematics::machine::Machine;
use haptimill_firmware::machinery::Machinery;
use haptimill_firmware::motion::jog::Jog;
use haptimill_firmware::motion::program::Program;
use haptimill_firmware::safety::integrity::{Constants, Digest};
use haptimill_firmware::units::{Coordinate, Rate};
use reference::h4;

/// Rounds of the check until a change is seen; the whole configuration takes one for each part.
fn rounds_until_seen(change: impl FnOnce(&mut Machinery)) -> Option<usize> {
    let mut machinery = Machinery::new(h4(), 0, &Inputs::default()).expect("sound");
    assert!((0..40).all(|_| machinery.configuration_intact()));
    change(&mut machinery);
    (0..40).find(|_| !machinery.configuration_intact())
}

#[test]
fn a_flipped_bit_in_any_part_of_the_configuration_is_seen() {
    // Bit by bit through the encoding: whatever still decodes is a configuration that differs in one place.
    let mut buffer = [0; 1024];
    let bytes = postcard::to_slice(&h4(), &mut buffer)
        .expect("encodes")
        .to_vec();
    let mut tried = 0;
    for bit in 0..bytes.len() * 8 {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let Ok(config) = postcard::from_bytes::<Config>(&flipped) else {
            continue;
        };
        if config == h4() {
            continue;
        }
        tried += 1;
        let seen = rounds_until_seen(|active| active.config = config);
        assert!(seen.is_some(), "bit {bit} of byte {}", bit / 8);
    }
    assert!(tried > 2000, "{tried}");
}

/// What was worked out from a configuration is watched as well: strokes and geometry, limits of program and jog.
#[test]
fn a_change_of_what_was_worked_out_is_seen() {
    let changed = |change: fn(&mut Config)| {
        let mut config = h4();
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
    for config in [&stroke, &rod] {
        assert!(rounds_until_seen(|active| active.machine = Machine::new(config)).is_some());
    }
    let jerk = changed(|config| config.pose[1].jerk /= 2);
    let soft = changed(|config| config.pose[3].low.0 += 1 << 16);
    let joint_rate = changed(|config| config.joints[4].rate.0 -= 1 << 12);
    for config in [&jerk, &soft, &joint_rate] {
        assert!(rounds_until_seen(|active| active.motion.jog = Jog::new(config)).is_some());
    }
    let stopping = changed(|config| config.stopping.time_ms += 10);
    let rate = changed(|config| config.pose[0].rate.0 += 1 << 10);
    for config in [&stopping, &rate] {
        assert!(rounds_until_seen(|active| active.motion.program = Program::new(config)).is_some());
    }
}

/// The digest of a joint is that of its constants: every one of them changes it, motion does not.
#[test]
fn a_change_of_a_joint_s_constants_is_seen_and_its_motion_is_not() {
    let digest = |joint: &JointDrive| {
        let mut digest = Digest::default();
        joint.digest(&mut digest);
        digest
    };
    let made = |axis: &JointAxis| digest(&JointDrive::new(axis, 200).expect("sound"));
    let axis = h4().joints[0].clone();
    let changes: [fn(&mut JointAxis); 10] = [
        |axis| axis.per_count += 1,
        |axis| axis.backlash.0 += 2,
        |axis| axis.law.kp.0 += 1,
        |axis| axis.law.kd.0 += 1,
        |axis| axis.law.ki.0 += 1 << 8,
        |axis| axis.law.inertia += 1,
        |axis| axis.law.viscous += 1,
        |axis| axis.law.coulomb.0 += 1,
        |axis| axis.law.coulomb_rate.0 += 1 << 4,
        |axis| axis.law.rate_filter_us += 1,
    ];
    for (index, change) in changes.iter().enumerate() {
        let mut other = axis.clone();
        change(&mut other);
        assert_ne!(made(&axis), made(&other), "change {index}");
    }
    let mut joint = JointDrive::new(&axis, 200).expect("sound");
    let before = digest(&joint);
    let mut inputs = AxisInputs::default();
    joint.sense(&inputs, 0);
    joint.enable();
    for period in 1..500_i32 {
        inputs.counts = period * period / 100;
        joint.sense(&inputs, period as u32 * 200_000);
        let wanted = Wanted {
            coordinate: Coordinate(period << 12),
            rate: Rate(-period << 8),
            ..Wanted::default()
        };
        joint.drive(&wanted);
    }
    joint.set_reference(7, Coordinate(99));
    joint.disable();
    assert_eq!(digest(&joint), before);
}
