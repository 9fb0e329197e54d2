//! Cylinders with an axis near z.

use super::zone::minimum_zone;
use super::{Undetermined, range};
use crate::Vector;
use nalgebra::{SMatrix, SVector};

/// A cylinder, with the radial deviations of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Cylinder {
    /// Point of the axis at the mean height of the points.
    pub centre: Vector,
    /// Direction of the axis, of unit length, upwards.
    pub axis: Vector,
    /// Radius.
    pub radius: f64,
    /// Radial deviations, in the order of the points.
    pub deviations: Vec<f64>,
}

impl Cylinder {
    /// Range of the deviations: the cylindricity by least squares.
    #[must_use]
    pub fn cylindricity(&self) -> f64 {
        range(&self.deviations)
    }
}

/// Steps of Gauss and Newton.
const STEPS: usize = 30;

/// Distance of a point from the axis through (x, y, height) with the slopes a, b, and its
/// derivatives by x, y, a and b.
fn distance(point: Vector, [x, y, a, b]: [f64; 4], height: f64) -> (f64, [f64; 4]) {
    let from = point - Vector::new(x, y, height);
    let axis = Vector::new(a, b, 1.0);
    let squared = axis.norm_squared();
    let along = from.dot(&axis) / squared;
    let radial = from - axis * along;
    let rho = radial.norm();
    // The radial vector is normal to the axis, so the change of `along` has no part in rho.
    let unit = radial / rho;
    (rho, [-unit.x, -unit.y, -unit.x * along, -unit.y * along])
}

/// Fits a cylinder by least squares of the radial deviations. Its axis is within 45 degrees of z.
///
/// # Errors
/// Fewer than five points, or points that hold no cylinder.
pub fn fit_cylinder(points: &[Vector]) -> Result<Cylinder, Undetermined> {
    let undetermined = Undetermined {
        points: points.len(),
        needed: 5,
    };
    if points.len() < 5 {
        return Err(undetermined);
    }
    let mean = points.iter().sum::<Vector>() / points.len() as f64;
    let flat: Vec<[f64; 2]> = points.iter().map(|point| [point.x, point.y]).collect();
    let start = super::fit_circle(&flat).map_err(|_| undetermined)?;
    let mut axis = [start.centre[0], start.centre[1], 0.0, 0.0];
    let mut radius = start.radius;
    for _ in 0..STEPS {
        let mut matrix = SMatrix::<f64, 5, 5>::zeros();
        let mut vector = SVector::<f64, 5>::zeros();
        for point in points {
            let (rho, [x, y, a, b]) = distance(*point, axis, mean.z);
            let row = SVector::<f64, 5>::from([x, y, a, b, -1.0]);
            matrix += row * row.transpose();
            vector += row * (radius - rho);
        }
        let step = matrix.lu().solve(&vector).ok_or(undetermined)?;
        for (parameter, step) in axis.iter_mut().zip(&step) {
            *parameter += step;
        }
        radius += step[4];
    }
    let [x, y, a, b] = axis;
    if !radius.is_finite() || a.abs() > 1.0 || b.abs() > 1.0 {
        return Err(undetermined);
    }
    let deviations = points
        .iter()
        .map(|point| distance(*point, axis, mean.z).0 - radius)
        .collect();
    Ok(Cylinder {
        centre: Vector::new(x, y, mean.z),
        axis: Vector::new(a, b, 1.0).normalize(),
        radius,
        deviations,
    })
}

/// Minimum-zone cylindricity: the smallest difference of the radii of two coaxial cylinders that
/// hold all points between them.
///
/// # Errors
/// As [`fit_cylinder`].
pub fn cylindricity_zone(points: &[Vector]) -> Result<f64, Undetermined> {
    let fitted = fit_cylinder(points)?;
    let (centre, axis) = (fitted.centre, fitted.axis);
    let mut parameters = [centre.x, centre.y, axis.x / axis.z, axis.y / axis.z];
    Ok(minimum_zone(&mut parameters, |parameters| {
        let distances = points
            .iter()
            .map(|point| distance(*point, *parameters, centre.z));
        distances.collect()
    }))
}
