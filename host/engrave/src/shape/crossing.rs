//! Crossings of lines with segments.

use crate::geometry::{Arc, Point, Segment};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Appends the x of all crossings of a segment with the horizontal line at `y`. A point of a closed
/// path on the line counts once where the path crosses and twice or never where it touches.
pub fn crossings_at(segment: &Segment, y: f64, out: &mut Vec<f64>) {
    match segment.arc() {
        None => {
            let (a, b) = (segment.from, segment.to);
            if (a[1] <= y) != (b[1] <= y) {
                out.push(a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]));
            }
        }
        Some(arc) => {
            for [from, to] in rising_parts(&arc) {
                let height = |part: f64| match part {
                    0.0 => segment.from[1],
                    1.0 => segment.to[1],
                    part => arc.point(part)[1],
                };
                if (height(from) <= y) != (height(to) <= y) {
                    let off = y - arc.centre[1];
                    let half = (arc.radius * arc.radius - off * off).max(0.0).sqrt();
                    let middle = arc.point(f64::midpoint(from, to));
                    let right = middle[0] > arc.centre[0];
                    out.push(if right {
                        arc.centre[0] + half
                    } else {
                        arc.centre[0] - half
                    });
                }
            }
        }
    }
}

/// Parts of an arc on which y only rises or only falls, as fractions of the sweep.
fn rising_parts(arc: &Arc) -> Vec<[f64; 2]> {
    let mut cuts = vec![0.0];
    let mut inside: Vec<f64> = [FRAC_PI_2, -FRAC_PI_2]
        .into_iter()
        .map(|angle| ((angle - arc.start) * arc.sweep.signum()).rem_euclid(TAU) / arc.sweep.abs())
        .filter(|part| *part > 1e-9 && *part < 1.0 - 1e-9)
        .collect();
    inside.sort_by(f64::total_cmp);
    cuts.extend(inside);
    cuts.push(1.0);
    cuts.windows(2).map(|pair| [pair[0], pair[1]]).collect()
}

/// Whether the straight way from `a` to `b` crosses or touches a segment.
pub fn crosses(a: Point, b: Point, segment: &Segment) -> bool {
    let v = [b[0] - a[0], b[1] - a[1]];
    let side = |p: Point| v[0] * (p[1] - a[1]) - v[1] * (p[0] - a[0]);
    match segment.arc() {
        None => {
            let (p, q) = (segment.from, segment.to);
            let w = [q[0] - p[0], q[1] - p[1]];
            let other = |c: Point| w[0] * (c[1] - p[1]) - w[1] * (c[0] - p[0]);
            side(p) * side(q) <= 0.0 && other(a) * other(b) <= 0.0
        }
        Some(arc) => {
            let w = [a[0] - arc.centre[0], a[1] - arc.centre[1]];
            let square = v[0] * v[0] + v[1] * v[1];
            let half = v[0] * w[0] + v[1] * w[1];
            let rest = w[0] * w[0] + w[1] * w[1] - arc.radius * arc.radius;
            let root = half * half - square * rest;
            if root < 0.0 || square == 0.0 {
                return false;
            }
            [root.sqrt(), -root.sqrt()].into_iter().any(|root| {
                let part = (root - half) / square;
                if !(0.0..=1.0).contains(&part) {
                    return false;
                }
                let at = [a[0] + v[0] * part, a[1] + v[1] * part];
                let angle = (at[1] - arc.centre[1]).atan2(at[0] - arc.centre[0]);
                let along = ((angle - arc.start) * arc.sweep.signum()).rem_euclid(TAU);
                along <= arc.sweep.abs()
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Path;

    #[test]
    fn a_circle_is_crossed_twice() {
        let circle = Path::circle([1.0, 2.0], 5.0, 0).rotated(0, 0.3);
        for y in [-2.9, 0.0, 2.0, 5.0, 6.5] {
            let mut xs = Vec::new();
            circle
                .segments()
                .for_each(|segment| crossings_at(&segment, y, &mut xs));
            xs.sort_by(f64::total_cmp);
            let half = (25.0_f64 - (y - 2.0) * (y - 2.0)).sqrt();
            assert_eq!(xs.len(), 2, "{y}");
            assert!((xs[0] - 1.0 + half).abs() < 1e-9 && (xs[1] - 1.0 - half).abs() < 1e-9);
        }
        let any = |a, b| circle.segments().any(|segment| crosses(a, b, &segment));
        assert!(any([1.0, 2.0], [9.0, 2.0]) && any([-9.0, 2.0], [9.0, 2.5]));
        assert!(!any([1.0, 2.0], [5.0, 2.0]) && !any([7.0, 2.0], [9.0, 9.0]));
    }
}
