//! A linear delta: three spheres about the upper ends of the rods meet in the tip (trilateration),
//! with columns that may lean.
//!
//! Units: mm and degrees. The platform does not turn: the two rods of a pair are parallel. A lever
//! of the force above the tip therefore loads no slide.

use super::Geometry;
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{Vector, cross, dot, length, minus, plus, times};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.linear_delta]`: lengths in mm, and errors. Lengths that differ from
/// those of `[kinematics]` are errors of the parts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearDeltaConfig {
    /// The rods.
    pub rods: [f64; 3],
    /// Distances of the columns from the origin, less those of the lower ends from the tip.
    pub radii: [f64; 3],
    /// Directions of the columns, degrees.
    pub angles_deg: [f64; 3],
    /// Height of the upper ends of the rods above the lower ones at z = 0 with the slides at 0.
    pub height: f64,
    /// The columns lean outwards by these angles, +-5 degrees.
    #[serde(default)]
    pub lean_out_deg: [f64; 3],
    /// The columns lean counter-clockwise about the origin by these angles, +-5 degrees.
    #[serde(default)]
    pub lean_along_deg: [f64; 3],
}

/// The machine.
#[derive(Debug, Clone)]
pub struct LinearDelta {
    rods: [f64; 3],
    /// Upper ends of the rods with the slides at 0.
    feet: [Vector; 3],
    /// Directions of the columns.
    columns: [Vector; 3],
}

impl LinearDelta {
    fn heads(&self, joints: &JointArray) -> [Vector; 3] {
        core::array::from_fn(|index| {
            plus(self.feet[index], times(self.columns[index], joints[index]))
        })
    }

    /// The lower one of the two points at which the spheres about the heads meet.
    fn tip(&self, joints: &JointArray) -> Option<Vector> {
        let [first, second, third] = self.heads(joints);
        let [r1, r2, r3] = self.rods.map(|rod| rod * rod);
        let side = minus(second, first);
        let d = length(side);
        let ahead = times(side, 1.0 / d);
        let other = minus(third, first);
        let i = dot(ahead, other);
        let across = minus(other, times(ahead, i));
        let j = length(across);
        let across = times(across, 1.0 / j);
        let normal = cross(ahead, across);
        let x = (r1 - r2 + d * d) / (2.0 * d);
        let y = (r1 - r3 + i * i + j * j - 2.0 * i * x) / (2.0 * j);
        let square = r1 - x * x - y * y;
        // A value that is no number gives no pose.
        if square.is_nan() || square <= 0.0 {
            return None;
        }
        let down = if normal[2] > 0.0 { -1.0 } else { 1.0 };
        let plane = plus(first, plus(times(ahead, x), times(across, y)));
        Some(plus(plane, times(normal, down * square.sqrt())))
    }
}

impl Geometry for LinearDelta {
    type Config = LinearDeltaConfig;

    fn check(config: &LinearDeltaConfig, kinds: &[JointKind], check: &mut Check) {
        if kinds != [JointKind::Linear; 3] {
            check.refuse(
                "geometry: linear_delta".into(),
                "needs the linear joints s1, s2 and s3".into(),
            );
        }
        let all = |name: &str, values: [f64; 3], min: f64, max: f64, check: &mut Check| {
            for value in values {
                check.within(format!("geometry: linear_delta: {name}"), value, min, max);
            }
        };
        all("rods", config.rods, 1.0, 2000.0, check);
        all("radii", config.radii, 1.0, 2000.0, check);
        all("angles_deg", config.angles_deg, -360.0, 720.0, check);
        all("lean_out_deg", config.lean_out_deg, -5.0, 5.0, check);
        all("lean_along_deg", config.lean_along_deg, -5.0, 5.0, check);
        let height = config.height;
        check.within(
            "geometry: linear_delta: height".into(),
            height,
            -2000.0,
            2000.0,
        );
    }

    fn new(config: &LinearDeltaConfig, joints: &JointArray) -> Result<Self, String> {
        let place = |index: usize| {
            let (sine, cosine) = libm::sincos(config.angles_deg[index].to_radians());
            let out = [cosine, sine, 0.0];
            let along = [-sine, cosine, 0.0];
            let [lean_out, lean_along] = [config.lean_out_deg, config.lean_along_deg]
                .map(|lean| libm::tan(lean[index].to_radians()));
            let leaning = plus(
                [0.0, 0.0, 1.0],
                plus(times(out, lean_out), times(along, lean_along)),
            );
            let foot = plus(times(out, config.radii[index]), [0.0, 0.0, config.height]);
            (foot, times(leaning, 1.0 / length(leaning)))
        };
        let places = [place(0), place(1), place(2)];
        let machine = Self {
            rods: config.rods,
            feet: places.map(|(foot, _)| foot),
            columns: places.map(|(_, column)| column),
        };
        match machine.tip(joints) {
            Some(_) => Ok(machine),
            None => Err("the rods do not meet".into()),
        }
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let Some(tip) = self.tip(joints) else {
            return false;
        };
        *pose = [0.0; MAX_AXES];
        pose[..3].copy_from_slice(&tip);
        true
    }

    /// Each rod, from the upper end to the tip: the model has no platform.
    fn links(&self, joints: &JointArray, pose: &JointArray) -> Vec<Vec<Vector>> {
        let tip = [pose[0], pose[1], pose[2]];
        self.heads(joints).map(|head| vec![head, tip]).to_vec()
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose::upright([pose[0], pose[1], pose[2]])
    }

    /// The forces in the rods balance the force on the tool; a slide takes the part of its rod's
    /// force along its column.
    fn joint_loads(
        &self,
        joints: &JointArray,
        pose: &JointArray,
        force: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let tip = [pose[0], pose[1], pose[2]];
        let rods = self.heads(joints).map(|head| {
            let rod = minus(tip, head);
            times(rod, 1.0 / length(rod))
        });
        let volume = dot(rods[0], cross(rods[1], rods[2]));
        if volume.abs() < 1e-6 {
            return None;
        }
        let mut loads = [0.0; MAX_AXES];
        for index in 0..3 {
            let (next, last) = (rods[(index + 1) % 3], rods[(index + 2) % 3]);
            let tension = dot(force, cross(next, last)) / volume;
            loads[index] = tension * dot(rods[index], self.columns[index]);
        }
        Some(loads)
    }
}
