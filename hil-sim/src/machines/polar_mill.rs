//! A polar mill: the tool on its way along the slide, and the frame of the workpiece on a table
//! that turns, with the errors of a real assembly.
//!
//! Units: mm and degrees. The tool points down along z. The machine frame has its origin on the
//! axis of the table and its x along the radial slide.

use super::{DEGREE, Geometry, round_table};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{Vector, cross, dot, minus, plus, times};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.polar_mill]`: offsets in mm, and errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolarMillConfig {
    /// x of the workpiece's origin with the table at 0, from the axis of the table.
    pub x_off: f64,
    /// y of the workpiece's origin with the table at 0, from the axis of the table.
    pub y_off: f64,
    /// True place of the tip along the slide where its joint is at 0, +-10 mm.
    #[serde(default)]
    pub r_zero: f64,
    /// Distance by which the tip passes the axis of the table, +-10 mm.
    #[serde(default)]
    pub across: f64,
    /// True angle of the table where its joint is at 0, +-5 degrees.
    #[serde(default)]
    pub theta_zero_deg: f64,
}

/// The mill.
#[derive(Debug, Clone)]
pub struct PolarMill {
    config: PolarMillConfig,
}

const UP: Vector = [0.0, 0.0, 1.0];

/// Directions of the workpiece in the machine frame, with the table at this angle.
fn frame(degrees: f64) -> [Vector; 3] {
    let (sin, cos) = libm::sincos(degrees * DEGREE);
    let ahead = [cos, sin, 0.0];
    [ahead, cross(UP, ahead), UP]
}

impl PolarMill {
    /// Tip in the machine frame.
    fn tip(&self, joints: &JointArray) -> Vector {
        [
            joints[0] + self.config.r_zero,
            self.config.across,
            joints[2],
        ]
    }

    /// Origin of the workpiece in its own directions, from the axis of the table.
    fn origin(&self) -> Vector {
        [self.config.x_off, self.config.y_off, 0.0]
    }

    fn table(&self, joints: &JointArray) -> [Vector; 3] {
        frame(joints[1] + self.config.theta_zero_deg)
    }
}

impl Geometry for PolarMill {
    type Config = PolarMillConfig;

    fn check(config: &PolarMillConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Rotary, Linear] {
            check.refuse(
                "geometry: polar_mill".into(),
                "needs the linear joint r, the rotary one theta and then the linear one z".into(),
            );
        }
        for (name, value, max) in [
            ("x_off", config.x_off, 2000.0),
            ("y_off", config.y_off, 2000.0),
            ("r_zero", config.r_zero, 10.0),
            ("across", config.across, 10.0),
            ("theta_zero_deg", config.theta_zero_deg, 5.0),
        ] {
            check.within(format!("geometry: polar_mill: {name}"), value, -max, max);
        }
    }

    fn new(config: &PolarMillConfig, _: &JointArray) -> Result<Self, String> {
        Ok(Self {
            config: config.clone(),
        })
    }

    /// The closure: the tip on the slide is the tip on the workpiece, in the directions of the
    /// turned workpiece.
    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let tip = self.tip(joints);
        *pose = [0.0; MAX_AXES];
        let on_table = self.table(joints).map(|direction| dot(direction, tip));
        pose[..3].copy_from_slice(&minus(on_table, self.origin()));
        true
    }

    /// The slide of the tool from above the table's axis, and the table.
    fn links(&self, joints: &JointArray, pose: &JointArray) -> Vec<Vec<Vector>> {
        let axis = times(self.origin(), -1.0);
        let tip = [pose[0], pose[1], pose[2]];
        let edge = round_table(axis, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        vec![edge, vec![plus(axis, times(UP, joints[2])), tip]]
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose {
            tip: [pose[0], pose[1], pose[2]],
            axis: UP,
        }
    }

    /// The table has the angle that brings the tip to the line of the slide.
    fn workpiece_axes(&self, pose: &JointArray) -> [Vector; 3] {
        let [x, y, _] = plus([pose[0], pose[1], pose[2]], self.origin());
        let away = libm::hypot(x, y);
        let across = libm::asin((self.config.across / away).clamp(-1.0, 1.0));
        frame((across - libm::atan2(y, x)) / DEGREE)
    }

    /// Virtual work: the slides move the tool, the table moves the workpiece under it.
    fn joint_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let [x, y, z] = self.table(joints);
        let force = plus(
            plus(times(x, force[0]), times(y, force[1])),
            times(z, force[2]),
        );
        let mut loads = [0.0; MAX_AXES];
        let moment = -1e-3 * dot(force, cross(UP, self.tip(joints)));
        loads[..3].copy_from_slice(&[force[0], moment, force[2]]);
        Some(loads)
    }
}
