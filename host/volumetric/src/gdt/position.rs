//! Orientation and position relative to a datum.
//!
//! The datum B is a side of the part: the least squares line of its points, in x and y.

use super::{Line, range};
use crate::Vector;

/// Range of the points along the datum line: the perpendicularity of a side to it.
#[must_use]
pub fn perpendicularity(points: &[[f64; 2]], datum: &Line) -> f64 {
    let [x, y] = datum.direction();
    along(points, [x, y])
}

/// Range of the points across the datum line: the parallelism of a side to it.
#[must_use]
pub fn parallelism(points: &[[f64; 2]], datum: &Line) -> f64 {
    let [x, y] = datum.direction();
    along(points, [-y, x])
}

/// Range of the points along a normal that is nominal in the datum frame: the angularity of a side.
/// The datum line is nominally along x.
#[must_use]
pub fn angularity(points: &[[f64; 2]], normal: [f64; 2], datum: &Line) -> f64 {
    let [c, s] = datum.direction();
    along(
        points,
        [normal[0] * c - normal[1] * s, normal[0] * s + normal[1] * c],
    )
}

fn along(points: &[[f64; 2]], direction: [f64; 2]) -> f64 {
    let places: Vec<f64> = points
        .iter()
        .map(|point| point[0] * direction[0] + point[1] * direction[1])
        .collect();
    range(&places)
}

/// Diameter of the zone about the nominal axis that holds a fitted axis over a length: the
/// perpendicularity of a hole to the base.
#[must_use]
pub fn axis_perpendicularity(axis: Vector, length: f64) -> f64 {
    length * libm::hypot(axis.x, axis.y) / axis.z.abs()
}

/// A point in the datum frame: origin at the datum centre, x along the datum line.
#[must_use]
pub fn in_datum(point: [f64; 2], origin: [f64; 2], datum: &Line) -> [f64; 2] {
    let [c, s] = datum.direction();
    let (x, y) = (point[0] - origin[0], point[1] - origin[1]);
    [x * c + y * s, y * c - x * s]
}

/// Diameter of the zone about the nominal point: the position of a feature.
#[must_use]
pub fn position(point: [f64; 2], nominal: [f64; 2]) -> f64 {
    2.0 * libm::hypot(point[0] - nominal[0], point[1] - nominal[1])
}

/// Diameter of the zone about the datum centre: the concentricity of two features.
#[must_use]
pub fn concentricity(one: [f64; 2], other: [f64; 2]) -> f64 {
    position(one, other)
}
