//! NURBS curves of SPLINE entities.

use crate::curves::fit;
use crate::geometry::{Point, Segment};

/// A rational B-spline curve.
pub struct Nurbs {
    /// Degree, at least 1.
    pub degree: usize,
    /// Knots, not decreasing: as many as points plus degree plus 1.
    pub knots: Vec<f64>,
    /// Control points.
    pub points: Vec<Point>,
    /// Weights, positive, one a point.
    pub weights: Vec<f64>,
}

impl Nurbs {
    /// What is wrong with the curve, if anything.
    pub fn mistake(&self) -> Option<String> {
        let points = self.points.len();
        if self.degree < 1 || self.degree > 25 {
            return Some(format!("its degree is {}", self.degree));
        }
        if points <= self.degree {
            return Some(format!(
                "it has {points} control points for degree {}",
                self.degree
            ));
        }
        if self.knots.len() != points + self.degree + 1 {
            let needed = points + self.degree + 1;
            return Some(format!(
                "it has {} knots and needs {needed}",
                self.knots.len()
            ));
        }
        if self.knots.windows(2).any(|pair| pair[1] < pair[0]) {
            return Some("its knots decrease".into());
        }
        if self.weights.len() != points || self.weights.iter().any(|&weight| weight <= 0.0) {
            return Some("its weights are not one positive number a control point".into());
        }
        None
    }

    /// Appends lines and arcs within the tolerance, mm.
    pub fn fit(&self, tolerance: f64, out: &mut Vec<Segment>) {
        let inner = &self.knots[self.degree..=self.points.len()];
        for (index, pair) in inner.windows(2).enumerate() {
            let (from, to) = (pair[0], pair[1]);
            if to <= from {
                continue;
            }
            let span = index + self.degree;
            let step = (to - from) * 1e-5;
            let curve = |t: f64| {
                let (low, high) = ((t - step).max(from), (t + step).min(to));
                let (a, b) = (self.point(span, low), self.point(span, high));
                (self.point(span, t), [b[0] - a[0], b[1] - a[1]])
            };
            let middle = f64::midpoint(from, to);
            fit(&curve, from, middle, tolerance, out);
            fit(&curve, middle, to, tolerance, out);
        }
    }

    /// Point at a parameter in a knot span (de Boor's algorithm).
    fn point(&self, span: usize, t: f64) -> Point {
        let degree = self.degree;
        let mut d: Vec<[f64; 3]> = (0..=degree)
            .map(|j| {
                let index = j + span - degree;
                let ([x, y], w) = (self.points[index], self.weights[index]);
                [x * w, y * w, w]
            })
            .collect();
        for r in 1..=degree {
            for j in (r..=degree).rev() {
                let low = self.knots[j + span - degree];
                let high = self.knots[j + 1 + span - r];
                let part = if high > low {
                    (t - low) / (high - low)
                } else {
                    0.0
                };
                let before = d[j - 1];
                for (value, before) in d[j].iter_mut().zip(before) {
                    *value = (1.0 - part) * before + part * *value;
                }
            }
        }
        let [x, y, w] = d[degree];
        [x / w, y / w]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance;

    /// The rational quadratic of a quarter circle is that circle.
    #[test]
    fn a_quarter_circle_is_one_arc_of_its_radius() {
        let nurbs = Nurbs {
            degree: 2,
            knots: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
            points: vec![[10.0, 0.0], [10.0, 10.0], [0.0, 10.0]],
            weights: vec![1.0, std::f64::consts::FRAC_1_SQRT_2, 1.0],
        };
        assert_eq!(nurbs.mistake(), None);
        let mut out = Vec::new();
        nurbs.fit(0.0025, &mut out);
        let length: f64 = out.iter().map(Segment::length).sum();
        assert!(
            (length - 5.0 * std::f64::consts::PI).abs() < 1e-4,
            "{length}"
        );
        for segment in &out {
            assert!((distance(segment.point(0.5), [0.0, 0.0]) - 10.0).abs() < 1e-4);
        }
    }

    /// Two clamped cubic spans with the knot of the middle: ends and joint as computed by hand.
    #[test]
    fn a_cubic_of_two_spans_passes_its_ends() {
        let nurbs = Nurbs {
            degree: 3,
            knots: vec![0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0, 2.0],
            points: vec![[0.0, 0.0], [1.0, 2.0], [2.0, -2.0], [3.0, 2.0], [4.0, 0.0]],
            weights: vec![1.0; 5],
        };
        let mut out = Vec::new();
        nurbs.fit(0.0025, &mut out);
        assert_eq!(out[0].from, [0.0, 0.0]);
        assert_eq!(out[out.len() - 1].to, [4.0, 0.0]);
        // At the middle knot of a cubic with these knots: (P1 + 2 P2 + P3) / 4.
        let middle = [2.0, 0.0];
        let near = out
            .iter()
            .map(|one| distance(one.to, middle))
            .fold(9.0, f64::min);
        assert!(near < 1e-9, "{near}");
    }
}
