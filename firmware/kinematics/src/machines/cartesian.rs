//! Kinematics of machines each of whose joints is a pose coordinate.
//!
//! The Cartesian machine has three slides x, y and z. The four-axis mill has a rotary axis a more,
//! which may turn over +-500 turns. The six-axis machine has rotary axes a and b within a turn, and
//! c over +-500 turns. Directions and leads are matters of the drives and encoders,
//! offsets of the presets. Every pose has joints; the strokes are checked by
//! [`crate::BoundedKinematics`].
//!
//! The pose of a machine with rotary axes is that of its axes: a program is made for a workpiece
//! that turns under the tool, as posts for four axes write it.

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use serde::{Deserialize, Serialize};

/// Geometry of a machine each of whose joints is a coordinate; it has no lengths.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CartesianGeometry {}

/// A machine each of whose `AXES` joints is the coordinate of the same name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Direct<const AXES: usize> {}

/// Slides x, y and z.
pub type Cartesian = Direct<3>;

/// Slides x, y and z, and a rotary axis a.
pub type FourAxis = Direct<4>;

/// Slides x, y and z, and rotary axes a, b and c.
pub type SixAxis = Direct<6>;

const X: CoordinateDescriptor = CoordinateDescriptor::new("x", AxisKind::Linear, 'X', Role::ToolX);
const Y: CoordinateDescriptor = CoordinateDescriptor::new("y", AxisKind::Linear, 'Y', Role::ToolY);
const Z: CoordinateDescriptor = CoordinateDescriptor::new("z", AxisKind::Linear, 'Z', Role::ToolZ);
const A: CoordinateDescriptor =
    CoordinateDescriptor::new("a", AxisKind::MultiTurn, 'A', Role::None);

const fn joint(of: &CoordinateDescriptor) -> JointDescriptor {
    JointDescriptor::new(of.name, of.kind)
}

impl Machine for Cartesian {
    type Geometry = CartesianGeometry;

    const DESCRIPTOR: Descriptor = Descriptor {
        code: "cartesian",
        pose: &[X, Y, Z],
        joints: &[joint(&X), joint(&Y), joint(&Z)],
        errors: &[],
    };

    fn new(_: &CartesianGeometry) -> Self {
        Self {}
    }

    fn is_sound(_: &CartesianGeometry) -> bool {
        true
    }
}

impl Machine for FourAxis {
    type Geometry = CartesianGeometry;

    const DESCRIPTOR: Descriptor = Descriptor {
        code: "four_axis",
        pose: &[X, Y, Z, A],
        joints: &[joint(&X), joint(&Y), joint(&Z), joint(&A)],
        errors: &[],
    };

    fn new(_: &CartesianGeometry) -> Self {
        Self {}
    }

    fn is_sound(_: &CartesianGeometry) -> bool {
        true
    }
}

const A_WITHIN_A_TURN: CoordinateDescriptor =
    CoordinateDescriptor::new("a", AxisKind::Rotary, 'A', Role::None);
const B: CoordinateDescriptor = CoordinateDescriptor::new("b", AxisKind::Rotary, 'B', Role::None);
const C: CoordinateDescriptor =
    CoordinateDescriptor::new("c", AxisKind::MultiTurn, 'C', Role::None);

impl Machine for SixAxis {
    type Geometry = CartesianGeometry;

    const DESCRIPTOR: Descriptor = Descriptor {
        code: "six_axis",
        pose: &[X, Y, Z, A_WITHIN_A_TURN, B, C],
        joints: &[
            joint(&X),
            joint(&Y),
            joint(&Z),
            joint(&A_WITHIN_A_TURN),
            joint(&B),
            joint(&C),
        ],
        errors: &[],
    };

    fn new(_: &CartesianGeometry) -> Self {
        Self {}
    }

    fn is_sound(_: &CartesianGeometry) -> bool {
        true
    }
}

impl<const AXES: usize> Kinematics for Direct<AXES> {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        Ok(Joints(first::<AXES, _>(&pose.0)))
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        Ok(JointMotion {
            joints: Joints(first::<AXES, _>(&pose.0)),
            rates: first::<AXES, _>(rates),
            accelerations: first::<AXES, _>(accelerations),
        })
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        Ok(Pose(first::<AXES, _>(&joints.0)))
    }

    fn jacobian(&self, _: &Pose) -> Result<Jacobian, PoseError> {
        let mut jacobian = Jacobian([[0; crate::MAX_AXES]; crate::MAX_AXES]);
        for axis in 0..AXES {
            jacobian.0[axis][axis] = 1 << 32;
        }
        Ok(jacobian)
    }

    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let mut bounds = BoxBounds {
            joints: [
                Joints(first::<AXES, _>(&low.0)),
                Joints(first::<AXES, _>(&high.0)),
            ],
            ..BoxBounds::default()
        };
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            *bound = first::<AXES, _>(&rates.map(|rate| rate.0.unsigned_abs()));
        }
        Ok(bounds)
    }
}

/// The values of the axes; those that the machine lacks are zero.
#[inline]
fn first<const AXES: usize, T: Copy + Default>(
    values: &[T; crate::MAX_AXES],
) -> [T; crate::MAX_AXES] {
    core::array::from_fn(|axis| {
        if axis < AXES {
            values[axis]
        } else {
            T::default()
        }
    })
}
