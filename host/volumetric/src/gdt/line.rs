//! Straight lines in a plane.

use super::{Undetermined, range};

/// A line v = slope u + offset, with the residuals of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Slope.
    pub slope: f64,
    /// Value at u = 0.
    pub offset: f64,
    /// Residuals, in the order of the points.
    pub residuals: Vec<f64>,
}

impl Line {
    /// Range of the residuals: the straightness by least squares.
    #[must_use]
    pub fn straightness(&self) -> f64 {
        range(&self.residuals)
    }

    /// Direction of the line, of unit length.
    #[must_use]
    pub fn direction(&self) -> [f64; 2] {
        let length = libm::hypot(1.0, self.slope);
        [1.0 / length, self.slope / length]
    }
}

/// Fits a line by least squares of the residuals in v.
///
/// # Errors
/// Fewer than two different u.
pub fn fit_line(points: &[[f64; 2]]) -> Result<Line, Undetermined> {
    let undetermined = Undetermined {
        points: points.len(),
        needed: 2,
    };
    let count = points.len() as f64;
    let mean = |part: usize| points.iter().map(|point| point[part]).sum::<f64>() / count;
    let (u, v) = (mean(0), mean(1));
    let squares: f64 = points
        .iter()
        .map(|point| (point[0] - u) * (point[0] - u))
        .sum();
    let products: f64 = points
        .iter()
        .map(|point| (point[0] - u) * (point[1] - v))
        .sum();
    if points.len() < 2 || squares <= 0.0 {
        return Err(undetermined);
    }
    let slope = products / squares;
    let offset = v - slope * u;
    let residuals = points
        .iter()
        .map(|point| (point[1] - v) - slope * (point[0] - u))
        .collect();
    Ok(Line {
        slope,
        offset,
        residuals,
    })
}

/// Minimum-zone straightness: the smallest distance of two parallel lines that hold all points. It
/// touches an edge of the convex hull.
#[must_use]
pub fn straightness_zone(points: &[[f64; 2]]) -> f64 {
    let hull = convex_hull(points);
    let edges = hull.iter().zip(hull.iter().cycle().skip(1));
    let widths = edges.filter_map(|(a, b)| {
        let length = libm::hypot(b[0] - a[0], b[1] - a[1]);
        let normal = [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
        let places: Vec<f64> = hull
            .iter()
            .map(|point| point[0] * normal[0] + point[1] * normal[1])
            .collect();
        (length > 0.0).then(|| range(&places))
    });
    let width = widths.fold(f64::INFINITY, f64::min);
    if width.is_finite() { width } else { 0.0 }
}

/// Corners of the convex hull, counter-clockwise.
fn convex_hull(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    sorted.dedup();
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..]
                && (b[0] - a[0]) * (point[1] - a[1]) <= (b[1] - a[1]) * (point[0] - a[0])
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut sorted.iter().copied());
    hull.extend(half(&mut sorted.iter().rev().copied()));
    hull
}
