//! Pose errors of this geometry.

use crate::PoseError;
use crate::descriptor::GeometryError;

/// The tilt of the tool or the angle of the table is outside +-90 degrees.
pub const TILT: PoseError = PoseError::Geometry { code: 2 };

/// The pose is too near the reach limit of a pair of rods: 0 for rods 1, 2; 1 for rods 3, 4.
#[must_use]
#[inline]
pub const fn near_reach_limit(pair: u8) -> PoseError {
    PoseError::Geometry { code: pair & 1 }
}

const fn reach(sentence: &'static str) -> GeometryError {
    GeometryError {
        name: "near_reach_limit",
        sentence,
    }
}

/// Names and sentences, by their codes.
pub(super) const ERRORS: &[GeometryError] = &[
    reach("rods 1 and 2 would exceed their reach limit; move the workpiece nearer to the rails"),
    reach("rods 3 and 4 would exceed their reach limit; move the workpiece nearer to the rails"),
    GeometryError {
        name: "tilt",
        sentence: "the tilt of the tool would exceed 90 degrees; tilt it less",
    },
];
