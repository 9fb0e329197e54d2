//! A SCARA arm: the chain of rotations and links from the column to the tip, with the errors of a
//! real assembly.
//!
//! Units: mm and degrees. The tool points down along the slide. The chain is: the tilt of the
//! column, turn by the shoulder, upper arm, turn by the elbow, forearm, slide.

use super::{DEGREE, Geometry};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{Vector, cross, dot, minus, plus, times};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.scara]`: lengths in mm, and errors. Lengths that differ from those of
/// `[kinematics]` are errors of the links.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScaraConfig {
    /// From the axis of the shoulder to that of the elbow.
    pub upper: f64,
    /// From the axis of the elbow to the tip of the tool.
    pub fore: f64,
    /// x of the workpiece's origin, from the shoulder.
    pub x_off: f64,
    /// y of the workpiece's origin, from the shoulder.
    pub y_off: f64,
    /// True angle of the shoulder where its joint is at 0, +-5 degrees.
    #[serde(default)]
    pub shoulder_zero_deg: f64,
    /// True angle of the elbow where its joint is at 0, +-5 degrees.
    #[serde(default)]
    pub elbow_zero_deg: f64,
    /// The column leans by this angle about x, +-5 degrees.
    #[serde(default)]
    pub column_about_x_deg: f64,
    /// The column leans by this angle about y, +-5 degrees.
    #[serde(default)]
    pub column_about_y_deg: f64,
}

/// The arm.
#[derive(Debug, Clone)]
pub struct Scara {
    config: ScaraConfig,
    /// Directions of the column's x, y and z.
    column: [Vector; 3],
}

/// A vector turned about an axis of length 1, by Rodrigues' formula.
fn turned(vector: Vector, axis: Vector, degrees: f64) -> Vector {
    let (sin, cos) = libm::sincos(degrees * DEGREE);
    let along = times(axis, dot(axis, vector));
    let across = minus(vector, along);
    plus(
        along,
        plus(times(across, cos), times(cross(axis, vector), sin)),
    )
}

impl Scara {
    /// Elbow and tip in the frame of the shoulder.
    fn chain(&self, joints: &JointArray) -> [Vector; 2] {
        let config = &self.config;
        let [ahead, _, up] = self.column;
        let upper = turned(ahead, up, joints[0] + config.shoulder_zero_deg);
        let fore = turned(upper, up, joints[1] + config.elbow_zero_deg);
        let elbow = times(upper, config.upper);
        let hand = plus(elbow, times(fore, config.fore));
        [elbow, plus(hand, times(up, joints[2]))]
    }
}

impl Geometry for Scara {
    type Config = ScaraConfig;

    fn check(config: &ScaraConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Rotary, Rotary, Linear] {
            check.refuse(
                "geometry: scara".into(),
                "needs the rotary joints theta1 and theta2 and then the linear one z".into(),
            );
        }
        for (name, value, min, max) in [
            ("upper", config.upper, 1.0, 2000.0),
            ("fore", config.fore, 1.0, 2000.0),
            ("x_off", config.x_off, -2000.0, 2000.0),
            ("y_off", config.y_off, -2000.0, 2000.0),
            ("shoulder_zero_deg", config.shoulder_zero_deg, -5.0, 5.0),
            ("elbow_zero_deg", config.elbow_zero_deg, -5.0, 5.0),
            ("column_about_x_deg", config.column_about_x_deg, -5.0, 5.0),
            ("column_about_y_deg", config.column_about_y_deg, -5.0, 5.0),
        ] {
            check.within(format!("geometry: scara: {name}"), value, min, max);
        }
    }

    fn new(config: &ScaraConfig, _: &JointArray) -> Result<Self, String> {
        let leaning = |axis: Vector| {
            let about_x = turned(axis, [1.0, 0.0, 0.0], config.column_about_x_deg);
            turned(about_x, [0.0, 1.0, 0.0], config.column_about_y_deg)
        };
        Ok(Self {
            config: config.clone(),
            column: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(leaning),
        })
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let [_, tip] = self.chain(joints);
        *pose = [0.0; MAX_AXES];
        let origin = [self.config.x_off, self.config.y_off, 0.0];
        pose[..3].copy_from_slice(&minus(tip, origin));
        true
    }

    fn links(&self, joints: &JointArray, _: &JointArray) -> Vec<Vec<Vector>> {
        let origin = [self.config.x_off, self.config.y_off, 0.0];
        let [elbow, tip] = self.chain(joints);
        let hand = minus(tip, times(self.column[2], joints[2]));
        let chain = [[0.0; 3], elbow, hand, tip];
        vec![chain.map(|point| minus(point, origin)).to_vec()]
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose {
            tip: [pose[0], pose[1], pose[2]],
            axis: self.column[2],
        }
    }

    /// Virtual work: shoulder and elbow swing the tool about the column's direction.
    fn joint_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        above: f64,
    ) -> Option<JointArray> {
        let [_, _, up] = self.column;
        let [elbow, tip] = self.chain(joints);
        let at = plus(tip, times(up, above));
        let moment = |lever: Vector| 1e-3 * dot(force, cross(up, lever));
        let mut loads = [0.0; MAX_AXES];
        loads[..3].copy_from_slice(&[moment(at), moment(minus(at, elbow)), dot(force, up)]);
        Some(loads)
    }
}
