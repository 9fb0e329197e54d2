//! A mill with three slides and a workpiece that turns about an axis along x.
//!
//! Units: mm and degrees; the tool points down along z. The pose is that of the slides and the
//! rotary axis. The workpiece frame is the machine frame with the rotary axis at 0, and turns with
//! the workpiece.

use super::{Geometry, PICTURE_MM, round_table};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{LEVEL, Vector, cross, dot, minus, plus, times};
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.four_axis]`: the place of the rotary axis in the machine frame, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FourAxisConfig {
    /// y of the rotary axis.
    pub axis_y: f64,
    /// z of the rotary axis.
    pub axis_z: f64,
}

/// The mill.
#[derive(Debug, Clone)]
pub struct FourAxis {
    /// A point on the rotary axis.
    origin: Vector,
}

/// Pose coordinate and joint of the rotary axis.
const A: usize = 3;

/// Directions of x, y and z of the workpiece in the machine, turned by `a` degrees about x.
fn axes(a: f64) -> [Vector; 3] {
    let (sin, cos) = libm::sincos(a.to_radians());
    [[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]]
}

impl Geometry for FourAxis {
    type Config = FourAxisConfig;

    fn check(config: &FourAxisConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Linear, Linear, Rotary] {
            check.refuse(
                "geometry: four_axis".into(),
                "needs three linear joints x, y, z and then the rotary one a".into(),
            );
        }
        for (name, value) in [("axis_y", config.axis_y), ("axis_z", config.axis_z)] {
            check.within(
                format!("geometry: four_axis: {name}"),
                value,
                -2000.0,
                2000.0,
            );
        }
    }

    fn new(config: &FourAxisConfig, _: &JointArray) -> Result<Self, String> {
        Ok(Self {
            origin: [0.0, config.axis_y, config.axis_z],
        })
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        *pose = *joints;
        true
    }

    /// The rotary axis, its chuck, and the stand of the chuck.
    fn links(&self, _: &JointArray, pose: &JointArray) -> Vec<Vec<Vector>> {
        let end = |side: f64| plus(self.origin, [side * PICTURE_MM, 0.0, 0.0]);
        let chuck = round_table(end(-1.0), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let up = self.tool_pose(pose).axis;
        let stand = minus(end(-1.0), times(up, 1.5 * PICTURE_MM));
        vec![vec![end(-1.0), end(1.0)], chuck, vec![stand, end(-1.0)]]
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        let axes = axes(pose[A]);
        let back = |vector: Vector| axes.map(|axis| dot(axis, vector));
        let tip = minus([pose[0], pose[1], pose[2]], self.origin);
        ToolPose {
            tip: plus(back(tip), self.origin),
            axis: back([0.0, 0.0, 1.0]),
        }
    }

    fn place_tip(&self, tip: Vector, pose: &mut JointArray) {
        let [_, y, z] = axes(pose[A]);
        let from_axis = minus(tip, self.origin);
        let turned = plus(times(y, from_axis[1]), times(z, from_axis[2]));
        let place = plus([from_axis[0], turned[1], turned[2]], self.origin);
        pose[..3].copy_from_slice(&place);
    }

    fn workpiece_axes(&self, pose: &JointArray) -> [Vector; 3] {
        axes(pose[A])
    }

    /// The sensor stands below the rotary axis.
    fn sensor_axes(&self, _: &JointArray) -> [Vector; 3] {
        LEVEL
    }

    /// Virtual work: a slide moves the tool, the rotary axis moves the workpiece under it.
    fn joint_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        above: f64,
    ) -> Option<JointArray> {
        let [x, y, z] = axes(joints[A]);
        let in_machine =
            core::array::from_fn(|row| x[row] * force[0] + y[row] * force[1] + z[row] * force[2]);
        let at = [joints[0], joints[1], joints[2] + above];
        let path = cross(x, minus(at, self.origin));
        let mut loads = JointArray::default();
        loads[..3].copy_from_slice(&in_machine);
        loads[A] = -1e-3 * dot(in_machine, path);
        Some(loads)
    }
}
