//! Tables of volumetric compensation: what is known of the geometric errors of three linear axes.
//!
//! Each axis that moves has six error functions of its position: translations along x, y and z in
//! nm, then rotations about them in nrad. All six share evenly spaced nodes and are linear between
//! them. The sign is that of the tool relative to the workpiece.

use haptimill_math::Coordinate;
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Number of axes with error tables.
pub const ERROR_AXES: usize = 3;

/// Error functions of an axis.
pub const ERRORS: usize = 6;

/// Largest number of values of all tables together: 192 nodes with six values each.
pub const ERROR_VALUES: usize = 1152;

/// Smallest and largest distance of two nodes: 1 mm and 1024 mm.
pub const NODE_PITCH: core::ops::RangeInclusive<i32> = 1 << 20..=1 << 30;

/// Largest translation, nm, and rotation, nrad.
pub const LARGEST: [i32; 2] = [500_000, 1_000_000];

/// Largest change per mm of a translation, nm, and of a rotation, nrad. With the longest arm,
/// 500 mm, both change the correction by 1 um per mm: a moving axis gains or loses a thousandth of
/// its rate.
pub const STEEPEST: [i64; 2] = [1_000, 2_000];

/// Largest squareness error, nrad.
pub const SQUARENESS: i32 = 1_000_000;

/// Largest arm of a rotation, axis units: 1024 mm.
pub const ARM: i32 = 1 << 30;

/// Largest correction of a coordinate, axis units: 4 mm. Joints must have that much travel beyond
/// what the tables need.
pub const CORRECTION: i32 = 4 << 20;

/// Volumetric compensation of a machine.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct VolumetricConfig {
    /// The axes, in the order of the first three pose coordinates.
    pub axes: [ErrorAxis; ERROR_AXES],
    /// Values of all tables: node after node, six values each, axis after axis. A value is
    /// multiplied by two `shift` times.
    pub values: Vec<i16, ERROR_VALUES>,
    /// Binary scale of the values.
    pub shift: u8,
    /// Squareness errors, nrad: y to x about z, z to x about y, z to y about x.
    pub squareness: [i32; ERROR_AXES],
}

/// Tables of one axis.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ErrorAxis {
    /// Position of the first node.
    pub first: Coordinate,
    /// Distance of the nodes.
    pub pitch: Coordinate,
    /// Number of nodes, at least 2.
    pub nodes: u8,
    /// Coordinates that are part of the arm of the rotations, one bit each: where the tool is,
    /// seen from the carriage of the axis.
    pub arm: u8,
    /// Point at which the axis was measured: the arm is zero there.
    pub measured_at: [Coordinate; ERROR_AXES],
}

impl VolumetricConfig {
    /// Number of values before those of an axis.
    #[must_use]
    pub fn start(&self, axis: usize) -> usize {
        let before = self.axes.iter().take(axis);
        before.map(|axis| usize::from(axis.nodes) * ERRORS).sum()
    }

    /// The first axis with a problem, or `None` without one. Positions must be covered from `low`
    /// to `high` of each axis.
    #[must_use]
    #[cold]
    #[inline(never)]
    pub fn unsound_axis(&self, travel: &[(Coordinate, Coordinate); ERROR_AXES]) -> Option<usize> {
        let complete = self.start(ERROR_AXES) == self.values.len() && self.shift <= 5;
        (0..ERROR_AXES).find(|index| {
            let axis = &self.axes[*index];
            let (low, high) = travel[*index];
            let spans = i64::from(axis.nodes) - 1;
            let last = i64::from(axis.first.0) + spans * i64::from(axis.pitch.0);
            let covered = axis.first <= low && i64::from(high.0) <= last;
            let arms = axis
                .measured_at
                .iter()
                .all(|at| at.0.unsigned_abs() <= ARM as u32);
            let square = self.squareness[*index].unsigned_abs() <= SQUARENESS as u32;
            let nodes = axis.nodes >= 2 && NODE_PITCH.contains(&axis.pitch.0);
            let sound = complete && covered && arms && square && nodes && axis.arm < 8;
            !sound || !self.is_gentle(*index)
        })
    }

    /// Whether the values of an axis and their slopes are within their bounds.
    fn is_gentle(&self, index: usize) -> bool {
        let axis = &self.axes[index];
        let start = self.start(index);
        let end = start + usize::from(axis.nodes) * ERRORS;
        let Some(values) = self.values.get(start..end) else {
            return false;
        };
        let scaled = |value: i16| i32::from(value) << self.shift;
        let small = values.iter().enumerate().all(|(place, value)| {
            let bound = LARGEST[place % ERRORS / ERROR_AXES];
            scaled(*value).abs() <= bound
        });
        let pitch = i64::from(axis.pitch.0);
        let steps = values.iter().zip(values.iter().skip(ERRORS)).enumerate();
        let flat = steps.into_iter().all(|(place, (here, next))| {
            let change = i64::from(scaled(*next)) - i64::from(scaled(*here));
            let bound = STEEPEST[place % ERRORS / ERROR_AXES];
            (change.abs() << 20) <= bound * pitch
        });
        small && flat
    }
}
