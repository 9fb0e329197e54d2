//! Form, orientation and position of features, from measured points.
//!
//! Least squares fits are those of ISO 10360-6; a minimum zone is the one of ISO 1101: the smallest
//! zone of the nominal form that holds all points. Lengths are in the unit of the points.

mod circle;
mod cylinder;
mod line;
mod plane;
mod position;
mod zone;

pub use circle::{Circle, fit_circle, roundness_zone};
pub use cylinder::{Cylinder, cylindricity_zone, fit_cylinder};
pub use line::{Line, fit_line, straightness_zone};
pub use plane::{Plane, fit_plane, flatness_zone};
pub use position::{
    angularity, axis_perpendicularity, concentricity, in_datum, parallelism, perpendicularity,
    position,
};

/// Largest less smallest value; 0 without any.
#[must_use]
pub fn range(values: &[f64]) -> f64 {
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(*v), high.max(*v))
        });
    if low <= high { high - low } else { 0.0 }
}

/// Points from which no feature can be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Undetermined {
    /// Number of points.
    pub points: usize,
    /// Least number of points of the feature.
    pub needed: usize,
}

impl core::fmt::Display for Undetermined {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "{} points do not determine the feature, which needs at least {} in general position",
            self.points, self.needed
        )
    }
}

impl core::error::Error for Undetermined {}
