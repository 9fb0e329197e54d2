//! The machines each of whose joints is a coordinate, under test.

use super::subject::{Margins, Reals, Sequence, Subject};
use haptimill_kinematics::cartesian::{CartesianGeometry, Direct};
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_kinematics::{Joints, MAX_AXES, Machine};
use haptimill_math::Coordinate;
use heapless::Vec;

/// The range of a coordinate, mm or radians.
const fn range(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => 2047.0,
        AxisKind::Rotary => 3.1,
        AxisKind::MultiTurn => 511.0 * core::f64::consts::TAU,
    }
}

/// The machine with `AXES` joints.
pub struct CartesianAxes<const AXES: usize> {
    machine: Direct<AXES>,
}

impl<const AXES: usize> Default for CartesianAxes<AXES>
where
    Direct<AXES>: Machine<Geometry = CartesianGeometry>,
{
    fn default() -> Self {
        Self {
            machine: Direct::new(&CartesianGeometry {}),
        }
    }
}

impl<const AXES: usize> Subject for CartesianAxes<AXES>
where
    Direct<AXES>: Machine<Geometry = CartesianGeometry>,
{
    type Machine = Direct<AXES>;

    const HAS_BOUNDS: bool = false;

    fn machine(&self) -> &Direct<AXES> {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let mut pose = [0.0; MAX_AXES];
        for (value, axis) in pose.iter_mut().zip(Direct::<AXES>::DESCRIPTOR.pose) {
            let range = range(axis.kind);
            *value = sequence.between(-range, range);
        }
        pose
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        self.random_pose(sequence)
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        Joints(core::array::from_fn(|axis| {
            Coordinate(if axis < AXES {
                sequence.next() as i32
            } else {
                0
            })
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
