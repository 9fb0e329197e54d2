//! Circles in a plane.

use super::zone::minimum_zone;
use super::{Undetermined, range};
use nalgebra::{Matrix3, Vector3};

/// A circle, with the radial deviations of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Circle {
    /// Centre.
    pub centre: [f64; 2],
    /// Radius.
    pub radius: f64,
    /// Radial deviations, in the order of the points.
    pub deviations: Vec<f64>,
}

impl Circle {
    /// Range of the deviations: the roundness by least squares.
    #[must_use]
    pub fn roundness(&self) -> f64 {
        range(&self.deviations)
    }
}

/// Steps of Gauss and Newton; four reach the last bit from the algebraic fit.
const STEPS: usize = 20;

/// Fits a circle by least squares of the radial deviations.
///
/// # Errors
/// Fewer than three points, or all of them on one line.
pub fn fit_circle(points: &[[f64; 2]]) -> Result<Circle, Undetermined> {
    let undetermined = Undetermined {
        points: points.len(),
        needed: 3,
    };
    if points.len() < 3 {
        return Err(undetermined);
    }
    let count = points.len() as f64;
    let mean = |part: usize| points.iter().map(|point| point[part]).sum::<f64>() / count;
    let origin = [mean(0), mean(1)];
    let local: Vec<[f64; 2]> = points
        .iter()
        .map(|point| [point[0] - origin[0], point[1] - origin[1]])
        .collect();
    // The algebraic fit: 2 a x + 2 b y + c = x^2 + y^2.
    let rows = local
        .iter()
        .map(|[x, y]| (Vector3::new(2.0 * x, 2.0 * y, 1.0), x * x + y * y));
    let start = solve_normal(rows).ok_or(undetermined)?;
    let (mut x0, mut y0) = (start.x, start.y);
    let mut radius = libm::sqrt(start.z + x0 * x0 + y0 * y0);
    for _ in 0..STEPS {
        let rows = local.iter().map(|[x, y]| {
            let (dx, dy) = (x - x0, y - y0);
            let rho = libm::hypot(dx, dy);
            (Vector3::new(-dx / rho, -dy / rho, -1.0), radius - rho)
        });
        let step = solve_normal(rows).ok_or(undetermined)?;
        x0 += step.x;
        y0 += step.y;
        radius += step.z;
    }
    if !radius.is_finite() {
        return Err(undetermined);
    }
    let deviations = local
        .iter()
        .map(|[x, y]| libm::hypot(x - x0, y - y0) - radius)
        .collect();
    Ok(Circle {
        centre: [origin[0] + x0, origin[1] + y0],
        radius,
        deviations,
    })
}

/// Least squares of rows J p = r.
fn solve_normal(rows: impl Iterator<Item = (Vector3<f64>, f64)>) -> Option<Vector3<f64>> {
    let (mut matrix, mut vector) = (Matrix3::zeros(), Vector3::zeros());
    for (row, value) in rows {
        matrix += row * row.transpose();
        vector += row * value;
    }
    let scale = matrix.norm();
    let lu = matrix.lu();
    let singular = lu.determinant().abs() <= 1e-12 * scale;
    if singular { None } else { lu.solve(&vector) }
}

/// Minimum-zone roundness: the smallest difference of the radii of two concentric circles that hold
/// all points between them.
///
/// # Errors
/// As [`fit_circle`].
pub fn roundness_zone(points: &[[f64; 2]]) -> Result<f64, Undetermined> {
    let mut centre = fit_circle(points)?.centre;
    Ok(minimum_zone(&mut centre, |centre| {
        let deviations = points.iter().map(|point| {
            let (dx, dy) = (point[0] - centre[0], point[1] - centre[1]);
            let rho = libm::hypot(dx, dy);
            (rho, [-dx / rho, -dy / rho])
        });
        deviations.collect()
    }))
}
