//! Kinematics of a machine whose joints move the tool along x, y and z directly.
//!
//! The pose is `[x, y, z]`, the joints are `[x, y, z]`, and each joint is the coordinate of the
//! same name. Directions and leads are matters of the drives and encoders, offsets of the presets.
//! Every pose has joints; the strokes are checked by [`crate::BoundedKinematics`].

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use serde::{Deserialize, Serialize};

/// Geometry of a Cartesian machine; it has no lengths.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CartesianGeometry {}

/// The Cartesian machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Cartesian {}

const fn linear(name: &'static str, letter: char, role: Role) -> CoordinateDescriptor {
    CoordinateDescriptor {
        name,
        kind: AxisKind::Linear,
        letter,
        role,
    }
}

const fn slide(name: &'static str) -> JointDescriptor {
    JointDescriptor {
        name,
        kind: AxisKind::Linear,
    }
}

impl Machine for Cartesian {
    type Geometry = CartesianGeometry;

    const DESCRIPTOR: Descriptor = Descriptor {
        code: "cartesian",
        pose: &[
            linear("x", 'X', Role::ToolX),
            linear("y", 'Y', Role::ToolY),
            linear("z", 'Z', Role::ToolZ),
        ],
        joints: &[slide("x"), slide("y"), slide("z")],
        errors: &[],
    };

    fn new(_: &CartesianGeometry) -> Self {
        Self {}
    }

    fn is_sound(_: &CartesianGeometry) -> bool {
        true
    }
}

impl Kinematics for Cartesian {
    fn axes(&self) -> usize {
        Self::DESCRIPTOR.axes()
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        Ok(Joints(first_three(&pose.0)))
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        Ok(JointMotion {
            joints: Joints(first_three(&pose.0)),
            rates: first_three(rates),
            accelerations: first_three(accelerations),
        })
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        Ok(Pose(first_three(&joints.0)))
    }

    fn jacobian(&self, _: &Pose) -> Result<Jacobian, PoseError> {
        let mut jacobian = Jacobian([[0; crate::MAX_AXES]; crate::MAX_AXES]);
        for axis in 0..Self::DESCRIPTOR.axes() {
            jacobian.0[axis][axis] = 1 << 32;
        }
        Ok(jacobian)
    }

    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let mut bounds = BoxBounds {
            joints: [Joints(first_three(&low.0)), Joints(first_three(&high.0))],
            ..BoxBounds::default()
        };
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            *bound = first_three(&rates.map(|rate| rate.0.unsigned_abs()));
        }
        Ok(bounds)
    }
}

/// The values of x, y and z; the unused axes are zero.
fn first_three<T: Copy + Default>(values: &[T; crate::MAX_AXES]) -> [T; crate::MAX_AXES] {
    let [x, y, z, ..] = *values;
    let none = T::default();
    [x, y, z, none, none, none]
}
