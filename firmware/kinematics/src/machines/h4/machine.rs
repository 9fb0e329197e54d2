//! The H-4 arm as a machine: lengths in a configuration, descriptor, search of homing.

use super::errors::ERRORS;
use super::{ALPHA, H4};
use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::{Machine, Pose, PoseError};
use haptimill_math::{Angle, Length};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Lengths of the H-4 arm (docs/control.md 2.5-2.6), 2^-20 mm.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct H4Geometry {
    /// E = a - b - e: lateral distance between rail joint and platform joint at y = 0.
    pub lateral: Length,
    /// c: half the distance of the two platform joints along the tool axis.
    pub half_spacing: Length,
    /// d: half the height difference of the rail pairs.
    pub half_height: Length,
    /// w: x offset of the slide's joint.
    pub joint_offset: Length,
    /// R: length of the rods.
    pub rod: Length,
    /// g_e: z offset of the rails.
    pub rail_offset: Length,
    /// T_L: tool length from the lower platform joint to the tip.
    pub tool: Length,
    /// p + x_Ow^O1: from x_w to x of the base frame.
    pub x_offset: Length,
    /// y_Ow^O1.
    pub y_offset: Length,
    /// z_O1^O2.
    pub z_offset: Length,
    /// h: height of the table axis below the origin of the base frame.
    pub table_height: Length,
    /// The platform is below the rails (the minus root of (3.19)) instead of above.
    pub below: bool,
    /// Singularity margin: smallest accepted distance from the parallel singularity (5 mm).
    pub singularity_margin: Length,
}

impl Machine for H4 {
    type Geometry = H4Geometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::{Linear, Rotary};
        Descriptor {
            code: "h4",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("z", Linear, 'Z', Role::ToolZ),
                CoordinateDescriptor::new("theta", Rotary, 'B', Role::ToolTilt),
                CoordinateDescriptor::new("alpha", Rotary, 'A', Role::WorkpieceRotation),
            ],
            joints: &[
                JointDescriptor::new("l1", Linear),
                JointDescriptor::new("l2", Linear),
                JointDescriptor::new("l3", Linear),
                JointDescriptor::new("l4", Linear),
                JointDescriptor::new("alpha", Rotary),
            ],
            errors: ERRORS,
        }
    };

    fn new(geometry: &H4Geometry) -> Self {
        Self::new(geometry)
    }

    fn is_sound(geometry: &H4Geometry) -> bool {
        let length =
            |value: Length, low: i64, high: i64| (low << 20..=high << 20).contains(&value.0.into());
        length(geometry.rod, 10, 1000)
            && length(geometry.half_spacing, 1, 1000)
            && length(geometry.tool, 0, 1000)
            && length(geometry.singularity_margin, 1, 100)
            && [
                geometry.lateral,
                geometry.half_height,
                geometry.joint_offset,
                geometry.rail_offset,
                geometry.x_offset,
                geometry.y_offset,
                geometry.z_offset,
                geometry.table_height,
            ]
            .iter()
            .all(|value| length(*value, -1000, 1000))
            && Self::is_sound(geometry)
    }

    fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        Some(self.singularity_distance(pose))
    }

    #[inline]
    fn sensor_rotation(&self, pose: &Pose) -> [Angle; 2] {
        [pose.0[ALPHA].angle(), Angle::ZERO]
    }

    /// Slides that move alone would leave the workspace.
    fn joints_move_alone() -> bool {
        false
    }

    /// The slides search along x, which shifts all of them alike; the table searches by itself.
    fn search_coordinate(joint: usize) -> usize {
        if joint == ALPHA { ALPHA } else { 0 }
    }

    /// While the table searches, the tool turns with the workpiece about the axis of the table, so
    /// the slides are at rest.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        rates[Self::search_coordinate(joint)] = rate;
        if joint == ALPHA {
            // 2^32 axis units are a turn: 411,775 is 2 pi, 2^-16. A lever is below 2^32, and so is
            // a rate.
            let speed = |lever: i64| (((lever * (rate >> 8)) >> 24) * 411_775) >> 16;
            let [_, y_offset, z_offset] = self.offset.map(i64::from);
            rates[1] = speed(i64::from(pose.0[2].0) + z_offset);
            rates[2] = -speed(i64::from(pose.0[1].0) + y_offset);
        }
        rates
    }
}
