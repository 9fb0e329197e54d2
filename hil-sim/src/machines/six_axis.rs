//! A machine with three slides and three rotary axes for fixtures beside the workpiece: they carry
//! neither the tool nor the workpiece.
//!
//! Units: mm and degrees; the tool points down along z.

use super::Geometry;
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.six_axis]`; it has no keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SixAxisConfig {}

/// The machine.
#[derive(Debug, Clone)]
pub struct SixAxis {}

impl Geometry for SixAxis {
    type Config = SixAxisConfig;

    fn check(_: &SixAxisConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Linear, Linear, Rotary, Rotary, Rotary] {
            check.refuse(
                "geometry: six_axis".into(),
                "needs three linear joints x, y, z and then the rotary ones a, b, c".into(),
            );
        }
    }

    fn new(_: &SixAxisConfig, _: &JointArray) -> Result<Self, String> {
        Ok(Self {})
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        *pose = *joints;
        true
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose::upright([pose[0], pose[1], pose[2]])
    }

    fn joint_loads(
        &self,
        _: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let mut loads = [0.0; MAX_AXES];
        loads[..3].copy_from_slice(&force);
        Some(loads)
    }
}
