//! The machine with crossed belts as a subject. Its reference values follow from the lengths of the
//! belts between pulleys in the corners of a frame, and from where two diagonals meet.

use super::subject::{Margin, Margins, Reals, Sequence, Subject};
use haptimill_kinematics::corexy::{Corexy, CorexyGeometry};
use haptimill_kinematics::{Joints, MAX_AXES, Machine, PoseError};
use haptimill_math::Coordinate;
use heapless::Vec;

/// The range of a coordinate, mm.
const RANGE: f64 = 2048.0;

/// Distance of the sides of the frame from its middle, mm.
const FRAME: f64 = 5000.0;

/// The machine with its reference values and its kinematics.
pub struct Belts {
    machine: Corexy,
}

impl Default for Belts {
    fn default() -> Self {
        Self {
            machine: Corexy::new(&CorexyGeometry {}),
        }
    }
}

/// Length of belt from a motor in a near corner, along its side to the pulley on the beam, and
/// along the beam to the tool. The motor of the left corner has side -1.
fn path(side: f64, x: f64, y: f64) -> f64 {
    let corner = [side * FRAME, -FRAME];
    let pulley = [side * FRAME, y];
    let beside = libm::hypot(pulley[0] - corner[0], pulley[1] - corner[1]);
    let along = libm::hypot(x - pulley[0], y - pulley[1]);
    beside + along
}

/// The pose at which the belts have these lengths: the diagonals of both meet there.
fn meet(joints: &Reals) -> Reals {
    let mut pose = [0.0; MAX_AXES];
    // Through (a, 0) along (1, -1), and through (b, 0) along (1, 1).
    let half = 0.5 * (joints[1] - joints[0]);
    pose[..3].copy_from_slice(&[joints[0] + half, -half, joints[2]]);
    pose
}

impl Subject for Belts {
    type Machine = Corexy;

    fn machine(&self) -> &Corexy {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let mut pose = [0.0; MAX_AXES];
        for (value, range) in pose.iter_mut().zip([1050.0, 1050.0, 2047.0]) {
            *value = sequence.between(-range, range);
        }
        pose
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let mut joints = [0.0; MAX_AXES];
        for joint in &mut joints[..3] {
            *joint = sequence.between(-2000.0, 2000.0);
        }
        let near = RANGE + sequence.logarithmic(-7.0, 1.0);
        let side = if sequence.next() & 1 == 0 { 1.0 } else { -1.0 };
        joints[sequence.below(2) as usize] = side * near;
        meet(&joints)
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        for joint in &mut joints.0[..3] {
            *joint = Coordinate(sequence.next() as i32);
        }
        joints
    }

    /// The range ends a unit below its upper end, which is within what rounding may decide.
    fn margins(&self, pose: &Reals) -> Margins {
        let mut margins: Vec<Margin, 12> = Vec::new();
        let [x, y, ..] = *pose;
        let belts = [
            path(-1.0, x, y) - path(-1.0, 0.0, 0.0),
            path(1.0, x, y) - path(1.0, 0.0, 0.0),
        ];
        for value in belts.iter().chain(&pose[..3]) {
            margins.extend([Margin::mm(RANGE - value.abs(), |error| {
                *error == PoseError::Unreachable
            })]);
        }
        Margins(margins)
    }

    /// The path of belt a got longer by a, that of belt b shorter by b.
    fn close(&self, pose: &Reals) -> Option<Reals> {
        let [x, y, z, ..] = *pose;
        let a = path(-1.0, x, y) - path(-1.0, 0.0, 0.0);
        let b = path(1.0, 0.0, 0.0) - path(1.0, x, y);
        Some([a, b, z, 0.0, 0.0, 0.0])
    }

    fn solve(&self, joints: &Reals, _: &Reals) -> Option<Reals> {
        Some(meet(joints))
    }
}
