//! Contour error: how far the tool is from the programmed path, wherever on it; the error that is seen on the part.
//!
//! The path is followed in a window around the place that is programmed at the tool's time. Half a window of the future must be known, so
//! results come 500 samples late; [`Contour::finish`] gives the rest. Distances are in mm, of the tip, without the rotary coordinates.

use std::collections::VecDeque;

/// A point of the tip, mm.
pub type Point = [f64; 3];

/// Samples of the future that are looked at.
const LAG: usize = 500;

/// A vertex of the path is kept when it is so far from the one before, mm. The chord of an arc of 1 mm radius is then 1e-7 mm off.
const SPACING: f64 = 1e-3;

/// The most vertices looked at to either side: an error above 0.2 mm may be given too large (never larger than the error at the same time).
const WINDOW: usize = 400;

/// Follows a path and measures the distance of a tool from it.
#[derive(Default)]
pub struct Contour {
    /// Vertices of the path, and how many were dropped before the first.
    vertices: VecDeque<Point>,
    dropped: usize,
    /// Samples that wait for their future: the tool, the programmed point, and the vertex that was newest then.
    waiting: VecDeque<(Point, Point, usize)>,
}

impl Contour {
    /// Takes the next sample; gives the contour error of an earlier one, 500 samples before.
    pub fn add(&mut self, programmed: Point, tool: Point) -> Option<f64> {
        let far = |last: &Point| distance(last, &programmed) >= SPACING;
        if self.vertices.back().is_none_or(far) {
            self.vertices.push_back(programmed);
        }
        let newest = self.dropped + self.vertices.len() - 1;
        self.waiting.push_back((tool, programmed, newest));
        if self.waiting.len() <= LAG {
            return None;
        }
        let result = self.measure_next();
        // What no later sample can need.
        if let Some((_, _, vertex)) = self.waiting.front() {
            while self.dropped + WINDOW + 1 < *vertex {
                self.vertices.pop_front();
                self.dropped += 1;
            }
        }
        result
    }

    /// The contour errors of the samples that still wait, in order.
    pub fn finish(mut self) -> Vec<f64> {
        std::iter::from_fn(|| self.measure_next()).collect()
    }

    fn measure_next(&mut self) -> Option<f64> {
        let (tool, programmed, vertex) = self.waiting.pop_front()?;
        let error = distance(&tool, &programmed);
        // The nearest point of the path is no farther from the tool than the programmed one, so no farther than 2 errors from that.
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
