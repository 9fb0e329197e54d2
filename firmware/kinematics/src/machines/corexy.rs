//! Kinematics of a machine with crossed belts: two motors at rest move the tool in x and y by a
//! belt each, and a slide moves it along z.
//!
//! The pose is `[x, y, z]`: the tip of the tool. The joints are `[a, b, z]`: the lengths of belt
//! that the motors have moved, and the slide, which is the coordinate of its name.
//!
//! ```text
//! a = x + y,         b = x - y
//! x = (a + b) / 2,   y = (a - b) / 2
//! ```
//!
//! Both motors together move the tool along x, against each other along y, and one motor alone
//! moves it along a diagonal. A stroke of a belt therefore bounds a strip between two diagonals,
//! and the strokes of both belts a square that stands on a corner.
//!
//! A home switch of a belt joint measures a or b, so its flag is on the belt, or its edge is at 45
//! degrees to x and y. A switch at the end of the rail of x or y measures a sum of both joints, and
//! can be the home switch of neither.
//!
//! A pose is refused only where a belt is beyond the range of a coordinate. Where the belts are at
//! zero is a matter of the presets.

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::planar::held;
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::scale::saturate;
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 3;
/// Index of the slide in a pose and in the joints.
const Z: usize = 2;

/// Geometry of a machine with crossed belts; it has no lengths.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CorexyGeometry {}

/// The machine with crossed belts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Corexy {}

/// Motions of the belts for motions along x and y, or the lengths for places: below 2^33.
const fn belts(x: i32, y: i32) -> [i64; 2] {
    [x as i64 + y as i64, x as i64 - y as i64]
}

/// The joints of the belts and the slide.
#[inline(always)]
fn joints([a, b]: [i64; 2], z: Coordinate) -> Result<Joints, PoseError> {
    let held = held([a, b, i64::from(z.0)])?;
    let mut joints = Joints::default();
    joints.0[..AXES].copy_from_slice(&held);
    Ok(joints)
}

impl Machine for Corexy {
    type Geometry = CorexyGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::Linear;
        Descriptor {
            code: "corexy",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("z", Linear, 'Z', Role::ToolZ),
            ],
            joints: &[
                JointDescriptor::new("a", Linear),
                JointDescriptor::new("b", Linear),
                JointDescriptor::new("z", Linear),
            ],
            errors: &[],
        }
    };

    fn new(_: &CorexyGeometry) -> Self {
        Self {}
    }

    fn is_sound(_: &CorexyGeometry) -> bool {
        true
    }

    /// Index pulses of both belts are searched together along x, which winds both alike.
    fn search_coordinate(joint: usize) -> usize {
        if joint == Z { Z } else { 0 }
    }
}

impl Kinematics for Corexy {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        joints(belts(pose.0[0].0, pose.0[1].0), pose.0[Z])
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let mut motion = JointMotion {
            joints: self.inverse(pose)?,
            ..JointMotion::default()
        };
        // A rate or acceleration beyond the range is held at its end, which is above every limit.
        let [a, b] = belts(rates[0].0, rates[1].0).map(|rate| Rate(saturate(rate)));
        motion.rates[..AXES].copy_from_slice(&[a, b, rates[Z]]);
        let push = belts(accelerations[0].0, accelerations[1].0);
        let [a, b] = push.map(|push| Acceleration(saturate(push)));
        motion.accelerations[..AXES].copy_from_slice(&[a, b, accelerations[Z]]);
        Ok(motion)
    }

    /// The halves of an odd sum are rounded down, so belt a may be a unit from its measured length.
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let [x, y] = belts(joints.0[0].0, joints.0[1].0).map(|twice| twice >> 1);
        let mut pose = Pose::default();
        pose.0[..AXES].copy_from_slice(&held([x, y, i64::from(joints.0[Z].0)])?);
        // A rounded belt may be beyond the end of its range.
        self.inverse(&pose).map(|_| pose)
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        self.inverse(pose)?;
        let one = 1_i64 << 32;
        let mut jacobian = Jacobian([[0; MAX_AXES]; MAX_AXES]);
        jacobian.0[0][..2].copy_from_slice(&[one, one]);
        jacobian.0[1][..2].copy_from_slice(&[one, -one]);
        jacobian.0[Z][Z] = one;
        Ok(jacobian)
    }

    /// The belts are linear in x and y, so their ends are at corners of the box.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let ends = |sum: &Pose, ahead: &Pose, behind: &Pose| {
            let [a, _] = belts(sum.0[0].0, sum.0[1].0);
            let [_, b] = belts(ahead.0[0].0, behind.0[1].0);
            joints([a, b], sum.0[Z])
        };
        let mut bounds = BoxBounds {
            joints: [ends(low, low, high)?, ends(high, high, low)?],
            ..BoxBounds::default()
        };
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            let [x, y, z, ..] = rates.map(|rate| rate.0.unsigned_abs());
            let both = x.saturating_add(y);
            bound[..AXES].copy_from_slice(&[both, both, z]);
        }
        Ok(bounds)
    }
}
