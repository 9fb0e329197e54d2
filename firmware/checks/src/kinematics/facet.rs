//! The faceting machine as a subject. Its reference values are products of the link transforms of
//! its D-H table.

use super::subject::{MM, Margin, Margins, RADIAN, Reals, Sequence, Subject};
use crate::Check;
use core::f64::consts::{FRAC_PI_2, PI, TAU};
use haptimill_firmware::digest::Digest;
use haptimill_kinematics::facet::chain::{Chain, ChainJoints, OutOfReach};
use haptimill_kinematics::facet::{Facet, FacetGeometry};
use haptimill_kinematics::{Joints, MAX_AXES, Machine, PoseError};
use haptimill_math::{Angle, Coordinate, Length};
use heapless::Vec;

/// The range of a coordinate, mm.
const RANGE: f64 = 2048.0;

/// Lengths in mm, angles in radians.
#[derive(Clone, Copy)]
pub struct Lengths {
    /// From the lift to the tilt axis.
    pub l2: f64,
    /// From the tilt axis to the spin axis.
    pub l3: f64,
    /// From the tilt axis to the tip.
    pub l4: f64,
    /// z of the lap in the base frame.
    pub z_lap: f64,
    /// Direction of the lap along z of the base: 1 or -1.
    pub lap_dir: f64,
    /// Angle of the chain at which the joint theta2 reads 0.
    pub theta2_zero: f64,
}

/// Digest of [`chain_bits`].
const CHAIN_BITS: u32 = 0x6665_7ce6;

/// The checks of the chain, besides those that every machine has.
pub const CHECKS: &[Check] = &[
    Check {
        name: "kinematics::facet_chain::frames_match_the_links_and_give_their_joints",
        run: || chain_against_links(1000),
    },
    Check {
        name: "kinematics::facet_chain::the_same_bits_everywhere",
        run: chain_bits,
    },
];

/// Joints of the chain: d1 within 200 mm, any angles.
fn random_chain(sequence: &mut Sequence) -> ChainJoints {
    ChainJoints {
        d1: Coordinate(libm::round(sequence.between(-200.0, 200.0) / MM) as i32),
        theta2: Angle(sequence.next() as i32),
        theta3: Angle(sequence.next() as i32),
    }
}

/// Frames of the chain are the products of its links within 0.1 um and 1e-6, and give their joints
/// within 0.1 um and 1 urad; a frame of which r23 is not 0 has none.
fn chain_against_links(count: usize) {
    let mut sequence = Sequence(33);
    for lengths in [SHORT, LONG] {
        let chain = Chain::new(&lengths.geometry());
        for _ in 0..count {
            let joints = random_chain(&mut sequence);
            let mut frame = chain.forward(&joints).unwrap();
            let truth = lengths.frame(
                f64::from(joints.d1.0) * MM,
                f64::from(joints.theta2.0) * RADIAN,
                f64::from(joints.theta3.0) * RADIAN,
            );
            for (row, truth) in truth.iter().take(3).enumerate() {
                for (entry, truth) in frame.rotation[row].iter().zip(truth) {
                    let error = f64::from(*entry) / f64::from(1 << 30) - truth;
                    assert!(error.abs() < 1e-6);
                }
                let error = f64::from(frame.position[row].0) * MM - truth[3];
                assert!(error.abs() < 1e-4);
            }
            let found = chain.inverse(&frame).unwrap();
            assert!(f64::from(found.d1.0.abs_diff(joints.d1.0)) * MM < 1e-4);
            for (found, angle) in [(found.theta2, joints.theta2), (found.theta3, joints.theta3)] {
                let apart = found.wrapping_sub(angle).0.unsigned_abs();
                assert!(f64::from(apart) * RADIAN < 1e-6);
            }
            frame.rotation[1][2] = 1 << 20;
            assert_eq!(chain.inverse(&frame), Err(OutOfReach::Rotation(1, 2)));
        }
    }
}

/// Frames that are disturbed about as much as the tolerance, so that some are refused.
fn chain_bits() {
    let mut sequence = Sequence(34);
    let mut digest = Digest::default();
    for lengths in [SHORT, LONG] {
        let chain = Chain::new(&lengths.geometry());
        for _ in 0..500 {
            let mut frame = chain.forward(&random_chain(&mut sequence)).unwrap();
            for entry in frame.rotation.as_flattened_mut() {
                *entry += sequence.between(-1200.0, 1200.0) as i32;
            }
            digest.add(&(frame.rotation, frame.position));
            match chain.inverse(&frame) {
                Ok(joints) => digest.add(&(joints.d1, joints.theta2, joints.theta3)),
                Err(OutOfReach::Rotation(row, column)) => digest.add(&(row, column)),
                Err(other) => panic!("{other:?}"),
            }
        }
    }
    let bits = core::hash::Hasher::finish(&digest) as u32;
    assert_eq!(bits, CHAIN_BITS, "{bits:#010x}");
}

/// Short arm, the lap below.
pub const SHORT: Lengths = Lengths {
    l2: 280.0,
    l3: 0.24,
    l4: 1.66,
    z_lap: 12.5,
    lap_dir: -1.0,
    theta2_zero: PI,
};

/// Long arm, the lap in the direction of z, and a tilt that reads 0 elsewhere.
pub const LONG: Lengths = Lengths {
    l2: 280.0,
    l3: 24.0,
    l4: 166.0,
    z_lap: 301.25,
    lap_dir: 1.0,
    theta2_zero: 0.3,
};

/// A homogeneous transform.
pub type Matrix = [[f64; 4]; 4];

/// Transform of a link, by modified D-H parameters.
#[must_use]
pub fn link(alpha: f64, a: f64, d: f64, theta: f64) -> Matrix {
    let (sa, ca) = (libm::sin(alpha), libm::cos(alpha));
    let (s, c) = (libm::sin(theta), libm::cos(theta));
    [
        [c, -s, 0.0, a],
        [s * ca, c * ca, -sa, -sa * d],
        [s * sa, c * sa, ca, ca * d],
        [0.0, 0.0, 0.0, 1.0],
    ]
}

/// Product of two transforms.
#[must_use]
pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    core::array::from_fn(|i| core::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

impl Lengths {
    /// Frame 4 in frame 0.
    #[must_use]
    pub fn frame(&self, d1: f64, theta2: f64, theta3: f64) -> Matrix {
        let [first, second, third, fourth] = self.links(d1, theta2, theta3);
        product(&product(&product(&first, &second), &third), &fourth)
    }

    /// The transforms of the four links.
    #[must_use]
    pub fn links(&self, d1: f64, theta2: f64, theta3: f64) -> [Matrix; 4] {
        [
            link(0.0, 0.0, d1, 0.0),
            link(-FRAC_PI_2, self.l2, 0.0, theta2),
            link(FRAC_PI_2, self.l3, 0.0, theta3),
            link(0.0, 0.0, self.l4, 0.0),
        ]
    }

    /// The geometry of the firmware.
    #[must_use]
    pub fn geometry(&self) -> FacetGeometry {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        FacetGeometry {
            l2: raw(self.l2),
            l3: raw(self.l3),
            l4: raw(self.l4),
            z_lap: raw(self.z_lap),
            lap_in_z: self.lap_dir > 0.0,
            theta2_zero: Angle(libm::round(self.theta2_zero / RADIAN) as i64 as i32),
        }
    }

    /// theta2 of the chain at an angle of the pose.
    fn theta2(&self, angle: f64) -> f64 {
        if self.lap_dir > 0.0 {
            angle
        } else {
            angle + PI
        }
    }
}

/// A faceting machine with its reference values and its kinematics.
pub struct Faceter {
    lengths: Lengths,
    machine: Facet,
}

/// The angle within half a turn.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * libm::round(angle / TAU)
}

impl Faceter {
    /// Creates the machine of these lengths.
    #[must_use]
    pub fn new(lengths: Lengths) -> Self {
        // The reference has the lengths as the configuration holds them.
        let geometry = lengths.geometry();
        let mm = |length: Length| f64::from(length.0) * MM;
        let lengths = Lengths {
            l2: mm(geometry.l2),
            l3: mm(geometry.l3),
            l4: mm(geometry.l4),
            z_lap: mm(geometry.z_lap),
            theta2_zero: f64::from(geometry.theta2_zero.0) * RADIAN,
            ..lengths
        };
        Self {
            lengths,
            machine: Facet::new(&geometry),
        }
    }

    fn joints(&self, pose: &Reals) -> Reals {
        let lengths = &self.lengths;
        let theta2 = lengths.theta2(pose[3]);
        let tip = lengths.frame(0.0, theta2, pose[4]);
        let z = lengths.z_lap - lengths.lap_dir * pose[2];
        [
            tip[0][3] - pose[0],
            -pose[1],
            z - tip[2][3],
            wrapped(theta2 - lengths.theta2_zero),
            pose[4],
            0.0,
        ]
    }

    fn pose(&self, joints: &Reals) -> Reals {
        let lengths = &self.lengths;
        let theta2 = joints[3] + lengths.theta2_zero;
        let tip = lengths.frame(joints[2], theta2, joints[4]);
        let angle = theta2 - (lengths.theta2(0.0));
        [
            tip[0][3] - joints[0],
            -joints[1],
            lengths.lap_dir * (lengths.z_lap - tip[2][3]),
            wrapped(angle),
            joints[4],
            0.0,
        ]
    }
}

impl Subject for Faceter {
    type Machine = Facet;

    fn machine(&self) -> &Facet {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let mut pose = [0.0; MAX_AXES];
        for value in &mut pose[..3] {
            *value = sequence.between(-900.0, 900.0);
        }
        for value in &mut pose[3..5] {
            *value = sequence.between(-PI, PI);
        }
        pose
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let mut joints = self.random_pose(sequence);
        let near = RANGE + sequence.logarithmic(-7.0, 1.0);
        let side = if sequence.next() & 1 == 0 { 1.0 } else { -1.0 };
        joints[sequence.below(3) as usize] = side * near;
        self.pose(&joints)
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        for joint in &mut joints.0[..5] {
            *joint = Coordinate(sequence.next() as i32);
        }
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        let mut margins: Vec<Margin, 12> = Vec::new();
        let joints = self.joints(pose);
        for value in joints[..3].iter().chain(&pose[..3]) {
            margins.extend([Margin::mm(RANGE - value.abs(), |error| {
                *error == PoseError::Unreachable
            })]);
        }
        Margins(margins)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        Some(self.joints(pose))
    }

    fn solve(&self, joints: &Reals, _: &Reals) -> Option<Reals> {
        Some(self.pose(joints))
    }
}
