//! Entry points of paths: where closed paths start and open ones begin, by the shortest gaps.

use super::local::gap;
use super::pieces::{Pieces, Placed, ends};
use crate::geometry::{Path, Point, Segment, distance};

/// Moves the starts of closed paths, and the ends where open ones begin and end, to where the gaps
/// before and after them are shortest, until that changes nothing.
pub fn settle_starts(pieces: Pieces<'_>, order: &mut [Placed], reference: Point) {
    const SWEEPS: usize = 10;
    if !order.iter().any(|placed| pieces.has_one_place(placed.path)) {
        return;
    }
    // Neighbours for which the start of each place is the best one: the next sweep searches only
    // where they have changed.
    let mut settled: Vec<Option<[Point; 2]>> = vec![None; order.len()];
    for _ in 0..SWEEPS {
        let mut gain = 0.0;
        let mut before = reference;
        for index in 0..order.len() {
            let placed = order[index];
            let after = order
                .get(index + 1)
                .map_or(reference, |next| ends(pieces, next)[0]);
            if pieces.has_one_place(placed.path) && settled[index] != Some([before, after]) {
                settled[index] = Some([before, after]);
                let over = |at: Point| distance(before, at) + distance(at, after);
                let length = over(ends(pieces, &placed)[0]);
                let path = &pieces.paths[placed.path];
                let (best, moved) = if path.closed {
                    let (best, start) = best_start(path, before, after);
                    (best, Placed { start, ..placed })
                } else {
                    let reversed = !placed.reversed;
                    let moved = Placed { reversed, ..placed };
                    (over(ends(pieces, &moved)[0]), moved)
                };
                if best < length - 1e-9 {
                    gain += length - best;
                    order[index] = moved;
                }
            }
            before = ends(pieces, &order[index])[1];
        }
        if gain < 1e-6 {
            break;
        }
    }
}

/// The point of a closed path with the shortest way from `a` over it to `b`.
fn best_start(path: &Path, a: Point, b: Point) -> (f64, (usize, f64)) {
    let over = |at: Point| gap(a, at) + gap(at, b);
    let corners: Vec<f64> = path.vertices.iter().map(|one| over(one.at)).collect();
    let mut best = (f64::INFINITY, (0, 0.0));
    for (index, &length) in corners.iter().enumerate() {
        if length < best.0 {
            best = (length, (index, 0.0));
        }
    }
    for (index, &length) in corners.iter().enumerate() {
        let segment = path.segment(index);
        // The way changes by no more than twice the distance along the segment. An arc is no longer
        // than its chord times 1 + bulge^2.
        let next = corners[(index + 1) % corners.len()];
        let longest = gap(segment.from, segment.to) * (1.0 + segment.bulge * segment.bulge);
        if f64::midpoint(length, next) - longest >= best.0 {
            continue;
        }
        let part = best_part(&segment, a, b);
        if part <= 1e-6 || part >= 1.0 - 1e-6 {
            continue;
        }
        let length = over(segment.point(part));
        if length < best.0 - 1e-9 {
            best = (length, (index, part));
        }
    }
    best
}

/// Fraction of a segment with the shortest way from `a` over it to `b`.
fn best_part(segment: &Segment, a: Point, b: Point) -> f64 {
    if segment.bulge == 0.0 {
        // The image of b on the other side of the line than a; the straight way crosses the line.
        let v = [
            segment.to[0] - segment.from[0],
            segment.to[1] - segment.from[1],
        ];
        let square = v[0] * v[0] + v[1] * v[1];
        let side = |p: Point| {
            let w = [p[0] - segment.from[0], p[1] - segment.from[1]];
            let along = (w[0] * v[0] + w[1] * v[1]) / square;
            (along, ((v[0] * w[1] - v[1] * w[0]) / square).abs())
        };
        let ((along_a, off_a), (along_b, off_b)) = (side(a), side(b));
        let off = off_a + off_b;
        let part = if off > 0.0 { off_a / off } else { 0.5 };
        return (along_a + (along_b - along_a) * part).clamp(0.0, 1.0);
    }
    let Some(arc) = segment.arc() else {
        return 0.0;
    };
    const PARTS: usize = 8;
    /// Golden-section steps, after which the interval is below 2e-5 of the segment.
    const STEPS: usize = 20;
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let length = |part: f64| {
        let at = arc.point(part);
        gap(a, at) + gap(at, b)
    };
    let mut nearest = (f64::INFINITY, 0);
    for k in 0..=PARTS {
        let one = length(k as f64 / PARTS as f64);
        if one < nearest.0 {
            nearest = (one, k);
        }
    }
    let k = nearest.1;
    let mut low = k.saturating_sub(1) as f64 / PARTS as f64;
    let mut high = (k + 1).min(PARTS) as f64 / PARTS as f64;
    let inner = |low: f64, high: f64| [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let [mut left, mut right] = inner(low, high);
    let (mut at_left, mut at_right) = (length(left), length(right));
    for _ in 0..STEPS {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = inner(low, high)[0];
            at_left = length(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = inner(low, high)[1];
            at_right = length(right);
        }
    }
    f64::midpoint(low, high)
}
