//! Planes.

use super::zone::minimum_zone;
use super::{Undetermined, range};
use crate::Vector;
use nalgebra::Matrix3;

/// A plane, with the distances of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Mean of the points.
    pub centre: Vector,
    /// Normal of unit length; its largest component is positive.
    pub normal: Vector,
    /// Signed distances, in the order of the points.
    pub deviations: Vec<f64>,
}

impl Plane {
    /// Range of the distances: the flatness by least squares.
    #[must_use]
    pub fn flatness(&self) -> f64 {
        range(&self.deviations)
    }
}

/// Fits a plane by least squares of the distances.
///
/// # Errors
/// Fewer than three points, or all of them on one line.
pub fn fit_plane(points: &[Vector]) -> Result<Plane, Undetermined> {
    let undetermined = Undetermined {
        points: points.len(),
        needed: 3,
    };
    if points.len() < 3 {
        return Err(undetermined);
    }
    let centre = points.iter().sum::<Vector>() / points.len() as f64;
    let spread: Matrix3<f64> = points
        .iter()
        .map(|point| (point - centre) * (point - centre).transpose())
        .sum();
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    if eigen.eigenvalues[order[1]] <= 1e-18 * eigen.eigenvalues[order[2]].max(f64::MIN_POSITIVE) {
        return Err(undetermined);
    }
    let normal: Vector = eigen.eigenvectors.column(order[0]).into_owned();
    let normal = if normal[normal.iamax()] < 0.0 {
        -normal
    } else {
        normal
    };
    let deviations = points
        .iter()
        .map(|point| (point - centre).dot(&normal))
        .collect();
    Ok(Plane {
        centre,
        normal,
        deviations,
    })
}

/// Minimum-zone flatness: the smallest distance of two parallel planes that hold all points.
///
/// # Errors
/// As [`fit_plane`].
pub fn flatness_zone(points: &[Vector]) -> Result<f64, Undetermined> {
    let plane = fit_plane(points)?;
    let helper = if plane.normal.x.abs() < 0.9 {
        Vector::x()
    } else {
        Vector::y()
    };
    let across = plane.normal.cross(&helper).normalize();
    let along = plane.normal.cross(&across);
    let local: Vec<[f64; 3]> = points
        .iter()
        .map(|point| point - plane.centre)
        .map(|point| {
            [
                point.dot(&across),
                point.dot(&along),
                point.dot(&plane.normal),
            ]
        })
        .collect();
    let mut tilt = [0.0; 2];
    Ok(minimum_zone(&mut tilt, |[a, b]| {
        let length = libm::sqrt(1.0 + a * a + b * b);
        let deviations = local.iter().map(|[u, v, w]| {
            let distance = (w - a * u - b * v) / length;
            let slope = |part: f64, tilt: f64| -part / length - distance * tilt / (length * length);
            (distance, [slope(*u, *a), slope(*v, *b)])
        });
        deviations.collect()
    }))
}
