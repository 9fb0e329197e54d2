//! Tip of the tool, from the roles of the pose coordinates.

use super::Extent;
use super::contour::Point;
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_trace::{Axes, Recording};

/// The coordinates of a machine that are x, y and z of the tool tip.
#[derive(Debug, Clone)]
pub struct Tip {
    /// Index and mm per axis unit of x, y and z; `None` where the machine has no such coordinate.
    axes: [Option<(usize, f64)>; 3],
    /// Names of x, y and z in the descriptor; empty where there is none.
    pub names: [&'static str; 3],
}

impl Tip {
    /// Tip of the machine of a recording.
    pub fn new(recording: &Recording) -> Self {
        let machine = recording.config().model.descriptor();
        let units = recording.pose_units();
        let axes = machine.tool_tip_parts().map(|axis| {
            let axis = axis?;
            let is_linear = machine.pose.get(axis)?.kind == AxisKind::Linear;
            Some((axis, *units.get(axis).filter(|_| is_linear)?))
        });
        Self {
            axes,
            names: axes.map(|axis| axis.map_or("", |(axis, _)| machine.pose[axis].name)),
        }
    }

    /// Position of the tip, mm; a coordinate that the machine does not have is 0.
    pub fn point(&self, pose: &Axes) -> Point {
        self.axes
            .map(|axis| axis.map_or(0.0, |(axis, unit)| f64::from(pose[axis]) * unit))
    }

    /// Spans of x, y and z, mm.
    pub fn spans(&self, extents: &[Extent; 6]) -> [f64; 3] {
        self.axes
            .map(|axis| axis.map_or(0.0, |(axis, _)| extents[axis].span()))
    }
}
