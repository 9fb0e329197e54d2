//! The Cartesian machine under test: each joint is the coordinate of the same name.

use super::subject::{Margins, Reals, Sequence, Subject};
use haptimill_kinematics::cartesian::{Cartesian, CartesianGeometry};
use haptimill_kinematics::{Joints, MAX_AXES, Machine};
use haptimill_math::Coordinate;
use heapless::Vec;

/// The range of a coordinate, mm.
const RANGE: f64 = 2047.0;

/// The Cartesian machine.
pub struct Slides {
    machine: Cartesian,
}

impl Default for Slides {
    fn default() -> Self {
        Self {
            machine: Cartesian::new(&CartesianGeometry {}),
        }
    }
}

impl Subject for Slides {
    type Machine = Cartesian;

    const HAS_BOUNDS: bool = false;

    fn machine(&self) -> &Cartesian {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let mut pose = [0.0; MAX_AXES];
        for value in &mut pose[..3] {
            *value = sequence.between(-RANGE, RANGE);
        }
        pose
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        self.random_pose(sequence)
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        Joints(core::array::from_fn(|axis| {
            Coordinate(if axis < 3 { sequence.next() as i32 } else { 0 })
        }))
    }

    fn margins(&self, _: &Reals) -> Margins {
        Margins(Vec::new())
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        Some(*pose)
    }

    fn solve(&self, joints: &Reals, _: &Reals) -> Option<Reals> {
        Some(*joints)
    }
}
