//! Checks of the haptic arm: correct results, and the same bits on every target, in fixed point and
//! in f32.

use crate::Check;
use crate::kinematics::subject::Sequence;
use haptimill_firmware::digest::Digest;
use haptimill_kinematics::haptic_arm::statics::{Efforts, Wrench};
use haptimill_kinematics::haptic_arm::{ArmPose, HapticArm, HapticGeometry, LegReading};
use haptimill_math::{Angle, Length};

/// Number of poses checked.
const COUNT: usize = 200;

/// Digest of all results. Another digest means that a target rounds differently, or that the
/// arithmetic was changed on purpose.
const BITS: u32 = 0xeca9_30cf;

/// The checks of this module.
pub const CHECKS: &[Check] = &[Check {
    name: "haptic::the_arm_has_the_same_bits_everywhere",
    run: bits,
}];

/// REF-M of docs/control.md 7.2.
const REFERENCE: HapticGeometry = HapticGeometry {
    base_radius: Length::millimetres(150),
    platform_radius: Length::millimetres(50),
    link: Length::millimetres(200),
    tilt: Angle::degrees(30),
    tip: [Length::ZERO, Length::ZERO, Length::millimetres(150)],
    side_tolerance: Length::nanometres(400_000),
};

/// Readings of a handle that is moved, and turned a little about z, by loop closure
/// (docs/control.md 2.3) in f64.
fn readings([x, y, z]: [f64; 3], turn: f64) -> [LegReading; 3] {
    core::array::from_fn(|leg| {
        let azimuth = leg as f64 * core::f64::consts::TAU / 3.0;
        let (s1, c1) = (libm::sin(azimuth), libm::cos(azimuth));
        let (px, py) = (
            x + 50.0 * libm::cos(azimuth + turn),
            y + 50.0 * libm::sin(azimuth + turn),
        );
        let (out, side) = (c1 * px + s1 * py - 150.0, c1 * py - s1 * px);
        let (s2, c2) = (0.5, libm::sqrt(0.75));
        let q = [c2 * out + s2 * z, side, c2 * z - s2 * out];
        let sine = libm::hypot(q[0], q[1]) / 200.0;
        let cosine = libm::sqrt(1.0 - sine * sine);
        let angle = |radians: f64| {
            let turns = radians / core::f64::consts::TAU * 4_294_967_296.0;
            Angle(libm::round(turns) as i64 as i32)
        };
        LegReading {
            slide: Length(libm::round((q[2] - 200.0 * cosine) * 1_048_576.0) as i32),
            turn: angle(libm::atan2(q[1], q[0])),
            hinge: angle(libm::atan2(sine, cosine)),
        }
    })
}

fn add(digest: &mut Digest, pose: &ArmPose, efforts: &Efforts) {
    digest.add(&(pose.centre, pose.axes, pose.tip));
    let words = efforts.iter().flatten().map(|effort| effort.to_bits());
    words.for_each(|word| digest.add(&word));
}

fn bits() {
    let arm = HapticArm::new(&REFERENCE);
    let mut sequence = Sequence(5);
    let mut digest = Digest::default();
    for _ in 0..COUNT {
        let mut within = |size: f64| (f64::from(sequence.next() as i32) / 2_147_483_648.0) * size;
        let centre = [within(30.0), within(30.0), 450.0 + within(30.0)];
        let turn = within(0.2);
        let wrench = Wrench {
            force: [within(5.0) as f32, within(5.0) as f32, within(5.0) as f32],
            moment: [within(100.0) as f32, 0.0, within(100.0) as f32],
        };
        let pose = arm.pose(&readings(centre, turn)).expect("a pose");
        for (part, want) in pose.centre.iter().zip(centre) {
            assert!(
                (f64::from(*part) / 1_048_576.0 - want).abs() < 2e-5,
                "{part} {want}"
            );
        }
        let efforts = arm.efforts(&pose, &wrench, 20.0).expect("regular");
        add(&mut digest, &pose, &efforts);
    }
    let bits = core::hash::Hasher::finish(&digest) as u32;
    assert_eq!(bits, BITS, "{bits:#010x}");
}
