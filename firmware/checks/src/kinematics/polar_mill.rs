//! The polar mill as a subject. Its reference values follow from a complex number that the table
//! turns to the positive real axis.

use super::subject::{MM, Margin, Margins, Reals, Sequence, Subject};
use core::f64::consts::PI;
use haptimill_kinematics::polar_mill::{PolarMill, PolarMillGeometry};
use haptimill_kinematics::{Joints, MAX_AXES, Machine, PoseError};
use haptimill_math::{Coordinate, Length};
use heapless::Vec;

/// The range of a coordinate, mm.
const RANGE: f64 = 2048.0;

/// Lengths in mm.
#[derive(Clone, Copy)]
pub struct Lengths {
    /// Origin of the workpiece, from the axis of the table.
    pub origin: [f64; 2],
    /// Singularity margin.
    pub margin: f64,
}

/// The workpiece in the middle of the table.
pub const CENTRED: Lengths = Lengths {
    origin: [0.0, 0.0],
    margin: 40.0,
};

/// The workpiece beside the axis, and no round values.
pub const ASIDE: Lengths = Lengths {
    origin: [103.6875, -41.3125],
    margin: 45.625,
};

/// A polar mill with its reference values and its kinematics.
pub struct Table {
    lengths: Lengths,
    machine: PolarMill,
}

impl Table {
    /// Creates the mill of these lengths.
    #[must_use]
    pub fn new(lengths: Lengths) -> Self {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        Self {
            lengths,
            machine: PolarMill::new(&PolarMillGeometry {
                origin: lengths.origin.map(raw),
                singularity_margin: raw(lengths.margin),
            }),
        }
    }

    /// Distance of the tip from the axis of the table, and its direction on the workpiece.
    fn around(&self, pose: &Reals) -> (f64, f64) {
        let [x_off, y_off] = self.lengths.origin;
        let (x, y) = (pose[0] + x_off, pose[1] + y_off);
        (libm::hypot(x, y), libm::atan2(y, x))
    }

    fn pose(&self, [r, theta, z]: [f64; 3]) -> Reals {
        let [x_off, y_off] = self.lengths.origin;
        let (sin, cos) = libm::sincos(-theta);
        let mut pose = [0.0; MAX_AXES];
        pose[..3].copy_from_slice(&[r * cos - x_off, r * sin - y_off, z]);
        pose
    }

    /// A pose at this distance from the axis, away from the half turn, where theta jumps by a turn.
    fn at(&self, sequence: &mut Sequence, r: f64) -> Reals {
        let theta = sequence.between(0.01 - PI, PI - 0.01);
        self.pose([r, theta, sequence.between(-2000.0, 2000.0)])
    }
}

impl Subject for Table {
    type Machine = PolarMill;

    fn machine(&self) -> &PolarMill {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let r = sequence.between(1.0, 1500.0);
        self.at(sequence, r)
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let bound = match sequence.below(2) {
            0 => self.lengths.margin,
            _ => RANGE,
        };
        let r = libm::fabs(bound + sequence.logarithmic(-7.0, 1.0));
        self.at(sequence, r)
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        for joint in &mut joints.0[..3] {
            *joint = Coordinate(sequence.next() as i32);
        }
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        let unreachable = |error: &PoseError| *error == PoseError::Unreachable;
        let (r, _) = self.around(pose);
        let mut margins: Vec<Margin, 12> = Vec::new();
        margins.extend([
            Margin::mm(r - self.lengths.margin, |error| {
                matches!(error, PoseError::NearSingularity { .. })
            }),
            Margin::mm(RANGE - r, unreachable),
        ]);
        for value in &pose[..3] {
            margins.extend([Margin::mm(RANGE - value.abs(), unreachable)]);
        }
        Margins(margins)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        let (r, direction) = self.around(pose);
        Some([r, -direction, pose[2], 0.0, 0.0, 0.0])
    }

    fn solve(&self, joints: &Reals, _: &Reals) -> Option<Reals> {
        Some(self.pose([joints[0], joints[1], joints[2]]))
    }
}
