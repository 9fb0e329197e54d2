//! Contour error: distance of the tool from the nearest point of the programmed path, which is the
//! error visible on the part.
//!
//! The search covers a window of the path around the programmed point of the same time. It includes
//! 500 later samples, so results lag by as many; [`Contour::finish`] returns the rest. Distances
//! are those of the tip, in mm, without the rotary coordinates.

use std::collections::VecDeque;

/// A point of the tip, mm.
pub type Point = [f64; 3];

/// Later samples in the window.
const LAG: usize = 500;

/// Spacing of the kept vertices of the path, mm. The chord error of an arc of 1 mm radius is
/// 1e-7 mm.
const SPACING: f64 = 1e-3;

/// Vertices searched on either side. An error above 0.2 mm can come out too large, but never larger
/// than the error at the same time.
const WINDOW: usize = 400;

/// Follows a path and measures the distance of a tool from it.
#[derive(Default)]
pub struct Contour {
    /// Vertices of the path, and the number of those removed before the first.
    vertices: VecDeque<Point>,
    dropped: usize,
    /// Pending samples: the tool, the programmed point, and the newest vertex at that time.
    pending: VecDeque<(Point, Point, usize)>,
}

impl Contour {
    /// Adds a sample; returns the contour error of the sample 500 samples before.
    pub fn add(&mut self, programmed: Point, tool: Point) -> Option<f64> {
        let far = |last: &Point| distance(last, &programmed) >= SPACING;
        if self.vertices.back().is_none_or(far) {
            self.vertices.push_back(programmed);
        }
        let newest = self.dropped + self.vertices.len() - 1;
        self.pending.push_back((tool, programmed, newest));
        if self.pending.len() <= LAG {
            return None;
        }
        let result = self.measure_next();
        // Vertices out of reach of all pending samples.
        if let Some((_, _, vertex)) = self.pending.front() {
            while self.dropped + WINDOW + 1 < *vertex {
                self.vertices.pop_front();
                self.dropped += 1;
            }
        }
        result
    }

    /// The contour errors of the pending samples, in order.
    pub fn finish(mut self) -> Vec<f64> {
        std::iter::from_fn(|| self.measure_next()).collect()
    }

    fn measure_next(&mut self) -> Option<f64> {
        let (tool, programmed, vertex) = self.pending.pop_front()?;
        let error = distance(&tool, &programmed);
        // The nearest point is at most one error from the tool, so at most two from the programmed
        // point.
        let reach = 2.0 * error + 2.0 * SPACING;
        let at = vertex - self.dropped;
        let mut nearest = error;
        let mut walk = |indices: &mut dyn Iterator<Item = usize>, start: Point| {
            let mut before = start;
            let mut travelled = 0.0;
            for index in indices.take(WINDOW) {
                let vertex = self.vertices[index];
                nearest = nearest.min(distance_to_segment(&tool, &before, &vertex));
                travelled += distance(&before, &vertex);
                if travelled > 3.0 * reach {
                    break;
                }
                before = vertex;
            }
        };
        walk(&mut (0..=at).rev(), programmed);
        walk(&mut (at + 1..self.vertices.len()), programmed);
        Some(nearest)
    }
}

/// Distance of two points.
pub fn distance(a: &Point, b: &Point) -> f64 {
    let out = difference(a, b);
    dot(&out, &out).sqrt()
}

fn distance_to_segment(point: &Point, from: &Point, to: &Point) -> f64 {
    let along = difference(to, from);
    let square = dot(&along, &along);
    let part = if square > 0.0 {
        (dot(&along, &difference(point, from)) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let [x, y, z] = along;
    let nearest = [from[0] + part * x, from[1] + part * y, from[2] + part * z];
    distance(point, &nearest)
}

fn difference(a: &Point, b: &Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: &Point, b: &Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
