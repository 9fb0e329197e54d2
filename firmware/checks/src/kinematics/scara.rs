//! The SCARA arm as a subject. Its reference values follow from the law of cosines in the triangle
//! of shoulder, elbow and tip.

use super::subject::{MM, Margin, Margins, Reals, Sequence, Subject};
use core::f64::consts::PI;
use haptimill_kinematics::scara::{Scara, ScaraGeometry};
use haptimill_kinematics::{Joints, Machine, PoseError};
use haptimill_math::{Coordinate, Length};
use heapless::Vec;

/// Lengths in mm.
#[derive(Clone, Copy)]
pub struct Lengths {
    /// Upper arm.
    pub upper: f64,
    /// Forearm.
    pub fore: f64,
    /// Origin of the workpiece, from the shoulder.
    pub origin: [f64; 2],
    /// The elbow is on the right.
    pub right: bool,
    /// Singularity margin.
    pub margin: f64,
}

/// A longer upper arm, and no round values.
pub const RIGHT: Lengths = Lengths {
    upper: 212.6875,
    fore: 187.3125,
    origin: [151.5, -38.25],
    right: true,
    margin: 60.125,
};

/// A longer forearm, and the other branch.
pub const LEFT: Lengths = Lengths {
    upper: 180.0625,
    fore: 241.5625,
    origin: [-12.75, 205.625],
    right: false,
    margin: 75.5,
};

/// A SCARA arm with its reference values and its kinematics.
pub struct Arm {
    lengths: Lengths,
    machine: Scara,
}

/// The error of a pose that is not in the annulus.
fn unreachable(error: &PoseError) -> bool {
    *error == PoseError::Unreachable
}

impl Arm {
    /// Creates the arm of these lengths.
    #[must_use]
    pub fn new(lengths: Lengths) -> Self {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        Self {
            lengths,
            machine: Scara::new(&ScaraGeometry {
                upper: raw(lengths.upper),
                fore: raw(lengths.fore),
                origin: lengths.origin.map(raw),
                right: lengths.right,
                singularity_margin: raw(lengths.margin),
            }),
        }
    }

    fn side(&self) -> f64 {
        if self.lengths.right { 1.0 } else { -1.0 }
    }

    /// Distance of the tip from the shoulder, and its direction.
    fn polar(&self, pose: &Reals) -> (f64, f64) {
        let (x, y) = (
            pose[0] + self.lengths.origin[0],
            pose[1] + self.lengths.origin[1],
        );
        (libm::hypot(x, y), libm::atan2(y, x))
    }

    fn pose(&self, r: f64, direction: f64, z: f64) -> Reals {
        let (sin, cos) = libm::sincos(direction);
        let [x_off, y_off] = self.lengths.origin;
        [r * cos - x_off, r * sin - y_off, z, 0.0, 0.0, 0.0]
    }

    /// Cosines of the angles of the triangle at the elbow (from the straight arm) and the shoulder.
    fn cosines(&self, r: f64) -> [f64; 2] {
        let Lengths { upper, fore, .. } = self.lengths;
        [
            (r * r - upper * upper - fore * fore) / (2.0 * upper * fore),
            (r * r + upper * upper - fore * fore) / (2.0 * upper * r),
        ]
    }

    /// A direction in which theta1 is not near the half turn, where it jumps by a turn.
    fn direction(&self, sequence: &mut Sequence, r: f64) -> f64 {
        let [_, shoulder] = self.cosines(r);
        let lead = self.side() * libm::acos(shoulder.clamp(-1.0, 1.0));
        let theta1 = sequence.between(0.01 - PI, PI - 0.01);
        theta1 + lead
    }
}

impl Subject for Arm {
    type Machine = Scara;

    fn machine(&self) -> &Scara {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let reach = self.lengths.upper + self.lengths.fore;
        let r = sequence.between(1.0, 1.05 * reach);
        let direction = self.direction(sequence, r);
        self.pose(r, direction, sequence.between(-2000.0, 2000.0))
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let Lengths {
            upper,
            fore,
            margin,
            ..
        } = self.lengths;
        // Straight or folded, or bent by as little as the margin allows.
        let bend = libm::sqrt(1.0 - (margin / fore) * (margin / fore));
        let cosine = match sequence.below(4) {
            0 => 1.0,
            1 => -1.0,
            2 => bend,
            _ => -bend,
        };
        let bound = libm::sqrt(upper * upper + fore * fore + 2.0 * upper * fore * cosine);
        let r = libm::fabs(bound + sequence.logarithmic(-7.0, 1.0));
        let direction = self.direction(sequence, r);
        self.pose(r, direction, sequence.between(-2000.0, 2000.0))
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        for joint in &mut joints.0[..3] {
            *joint = Coordinate(sequence.next() as i32);
        }
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        let Lengths {
            upper,
            fore,
            margin,
            ..
        } = self.lengths;
        let (r, _) = self.polar(pose);
        let [elbow, _] = self.cosines(r);
        let distance = fore * libm::sqrt((1.0 - elbow * elbow).max(0.0));
        let mut margins: Vec<Margin, 12> = Vec::new();
        margins.extend([
            Margin::mm(upper + fore - r, unreachable),
            Margin::mm(r - libm::fabs(upper - fore), unreachable),
            Margin::mm(distance - margin, |error| {
                matches!(error, PoseError::NearSingularity { .. })
            }),
        ]);
        Margins(margins)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        let (r, direction) = self.polar(pose);
        let [elbow, shoulder] = self.cosines(r);
        if !(-1.0..=1.0).contains(&elbow) {
            return None;
        }
        let theta1 = direction - self.side() * libm::acos(shoulder);
        let turn = if theta1 > PI {
            -2.0 * PI
        } else if theta1 <= -PI {
            2.0 * PI
        } else {
            0.0
        };
        let theta2 = self.side() * libm::acos(elbow);
        Some([theta1 + turn, theta2, pose[2], 0.0, 0.0, 0.0])
    }

    fn solve(&self, joints: &Reals, _: &Reals) -> Option<Reals> {
        let Lengths {
            upper,
            fore,
            origin: [x_off, y_off],
            ..
        } = self.lengths;
        let both = joints[0] + joints[1];
        let (arm, forearm) = (libm::sincos(joints[0]), libm::sincos(both));
        Some([
            upper * arm.1 + fore * forearm.1 - x_off,
            upper * arm.0 + fore * forearm.0 - y_off,
            joints[2],
            0.0,
            0.0,
            0.0,
        ])
    }
}
