//! Splines in the plane X Y: cubic (G5), quadratic (G5.1) and NURBS (G5.2, G5.3).
//!
//! A spline becomes pairs of arcs with common tangents, within [`TOLERANCE_MM`] of it.

use super::block::{Block, letters};
use super::codes::Code;
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::output::{Leg, MoveFeed};
use super::path::Arc;
use super::problem::{Cause, Mistake, Place};
use super::series::ControlPoint;
use super::state::{Motion, Plane};
use super::tool_table::PerLetter;
use std::f64::consts::FRAC_PI_2;

/// Largest distance of the arcs from the spline, mm.
pub const TOLERANCE_MM: f64 = 0.0005;

/// Most halvings of a span.
const DEEPEST: u32 = 12;

/// Most control points of a NURBS.
const MAX_POINTS: usize = 10_000;

/// Largest order of a NURBS.
const LARGEST_ORDER: f64 = 20.0;

type Point = [f64; 2];

/// A curve over a span of its parameter.
trait Curve {
    /// Returns point and derivative.
    fn at(&self, parameter: f64) -> (Point, Point);
}

struct Bezier([Point; 4]);

impl Curve for Bezier {
    fn at(&self, t: f64) -> (Point, Point) {
        let [a, b, c, d] = self.0;
        let u = 1.0 - t;
        let mut point = [0.0; 2];
        let mut slope = [0.0; 2];
        for k in 0..2 {
            point[k] = u * u * u * a[k]
                + 3.0 * u * u * t * b[k]
                + 3.0 * u * t * t * c[k]
                + t * t * t * d[k];
            slope[k] =
                3.0 * (u * u * (b[k] - a[k]) + 2.0 * u * t * (c[k] - b[k]) + t * t * (d[k] - c[k]));
        }
        (point, slope)
    }
}

/// One span of a NURBS: parameter `span` to `span + 1`.
struct Nurbs<'a> {
    points: &'a [ControlPoint],
    order: usize,
    span: usize,
}

impl Nurbs<'_> {
    fn knot(&self, index: usize) -> f64 {
        let last = self.points.len() - 1;
        let knot = if index < self.order {
            0
        } else if index <= last {
            index - self.order + 1
        } else {
            last + 2 - self.order
        };
        knot as f64
    }
}

impl Curve for Nurbs<'_> {
    fn at(&self, t: f64) -> (Point, Point) {
        let degree = self.order - 1;
        // De Boor's algorithm on homogeneous coordinates.
        let mut values: Vec<[f64; 3]> = (0..=degree)
            .map(|j| {
                let point = &self.points[self.span + j];
                [
                    point.at[0] * point.weight,
                    point.at[1] * point.weight,
                    point.weight,
                ]
            })
            .collect();
        let first = self.span + degree;
        let mut slope = [0.0; 3];
        for level in 1..=degree {
            if level == degree {
                let width = self.knot(first + 1) - self.knot(first);
                for (k, slope) in slope.iter_mut().enumerate() {
                    *slope = degree as f64 * (values[degree][k] - values[degree - 1][k]) / width;
                }
            }
            for j in (level..=degree).rev() {
                let low = self.knot(self.span + j);
                let high = self.knot(first + 1 + j - level);
                let share = (t - low) / (high - low);
                let before = values[j - 1];
                for (value, before) in values[j].iter_mut().zip(before) {
                    *value = (1.0 - share) * before + share * *value;
                }
            }
        }
        let [x, y, w] = values[degree];
        let point = [x / w, y / w];
        (
            point,
            [
                (slope[0] - point[0] * slope[2]) / w,
                (slope[1] - point[1] * slope[2]) / w,
            ],
        )
    }
}

fn distance(a: Point, b: Point) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

fn unit(vector: Point) -> Option<Point> {
    let length = libm::hypot(vector[0], vector[1]);
    (length > 1e-12).then(|| [vector[0] / length, vector[1] / length])
}

/// A piece of the path: its end, and its arc or none for a line.
type Piece = (Point, Option<Arc>);

/// Returns the arc from a point with a tangent to another point.
fn tangent_arc(from: Point, tangent: Point, to: Point) -> Option<Arc> {
    let chord = [to[0] - from[0], to[1] - from[1]];
    let length = libm::hypot(chord[0], chord[1]);
    let cross = tangent[0] * chord[1] - tangent[1] * chord[0];
    let dot = tangent[0] * chord[0] + tangent[1] * chord[1];
    // The tangent turns by twice the angle between tangent and chord.
    let half = libm::atan2(cross, dot);
    if length < 1e-9 || half.abs() < 1e-7 {
        return None;
    }
    let radius = 0.5 * length / libm::sin(half);
    let centre = [from[0] - tangent[1] * radius, from[1] + tangent[0] * radius];
    let side = if radius > 0.0 { -FRAC_PI_2 } else { FRAC_PI_2 };
    Some(Arc {
        plane: [0, 1],
        centre,
        radius: [radius.abs(); 2],
        angle: libm::atan2(tangent[1], tangent[0]) + side,
        sweep: 2.0 * half,
    })
}

/// Returns two arcs between two points with given tangents.
fn biarc(from: Point, first: Point, to: Point, last: Point) -> Option<[Piece; 2]> {
    let chord = [to[0] - from[0], to[1] - from[1]];
    let sum = [first[0] + last[0], first[1] + last[1]];
    let squared = chord[0] * chord[0] + chord[1] * chord[1];
    let along = chord[0] * sum[0] + chord[1] * sum[1];
    let dot = first[0] * last[0] + first[1] * last[1];
    let a = 2.0 * (1.0 - dot);
    let size = if a < 1e-12 {
        let b = 4.0 * (chord[0] * last[0] + chord[1] * last[1]);
        (b > 1e-12).then(|| squared / b)?
    } else {
        // The root of a d^2 + 2 along d - squared = 0 that is positive.
        squared / (along + (along * along + a * squared).sqrt())
    };
    if !(size.is_finite() && size > 0.0) {
        return None;
    }
    let joint = [
        0.5 * (from[0] + to[0] + size * (first[0] - last[0])),
        0.5 * (from[1] + to[1] + size * (first[1] - last[1])),
    ];
    let one = tangent_arc(from, first, joint);
    // The second arc is found from its end backwards.
    let two = tangent_arc(to, [-last[0], -last[1]], joint).map(|arc| Arc {
        angle: arc.angle + arc.sweep,
        sweep: -arc.sweep,
        ..arc
    });
    Some([(joint, one), (to, two)])
}

/// Returns the distance of a point from a piece that begins at `from`.
fn off(piece: &Piece, from: Point, point: Point) -> f64 {
    match &piece.1 {
        Some(arc) => (distance(arc.centre, point) - arc.radius[0]).abs(),
        None => {
            let Some(along) = unit([piece.0[0] - from[0], piece.0[1] - from[1]]) else {
                return distance(from, point);
            };
            (along[0] * (point[1] - from[1]) - along[1] * (point[0] - from[0])).abs()
        }
    }
}

/// Divides a span until its arcs are near the curve.
fn divide(curve: &dyn Curve, low: f64, high: f64, depth: u32, pieces: &mut Vec<Piece>) {
    let (from, start) = curve.at(low);
    let (to, end) = curve.at(high);
    if distance(from, to) < 1e-9 && depth >= 3 {
        return;
    }
    // A point where the curve stands still has the direction of its neighbourhood.
    let near = 1e-4 * (high - low);
    let direction = |slope: Point, at: f64, before: bool| {
        unit(slope).or_else(|| {
            let (a, b) = if before {
                (at - near, at)
            } else {
                (at, at + near)
            };
            let (a, b) = (curve.at(a).0, curve.at(b).0);
            unit([b[0] - a[0], b[1] - a[1]])
        })
    };
    let tangents = direction(start, low, false).zip(direction(end, high, true));
    let found = tangents.and_then(|(first, last)| biarc(from, first, to, last));
    if let Some(found) = found
        && depth >= 1
    {
        let joint = found[0].0;
        let turns = found
            .iter()
            .all(|(_, arc)| arc.is_none_or(|arc| arc.sweep.abs() < 2.0));
        let is_near = turns
            && (1..16).all(|part| {
                let point = curve.at(low + (high - low) * f64::from(part) / 16.0).0;
                off(&found[0], from, point).min(off(&found[1], joint, point)) <= TOLERANCE_MM
            });
        if is_near || depth >= DEEPEST {
            pieces.extend(found);
            return;
        }
    } else if depth >= DEEPEST {
        pieces.push((to, None));
        return;
    }
    let middle = 0.5 * (low + high);
    divide(curve, low, middle, depth + 1, pieces);
    divide(curve, middle, high, depth + 1, pieces);
}

/// Refuses one word of a control point of G5 without the other.
fn check_pairs(block: &Block, here: &Here) -> Read<()> {
    for [a, b] in [*b"IJ", *b"PQ"] {
        let (word, missing) = match (block.word(a), block.word(b)) {
            (Some(word), None) => (word, b),
            (None, Some(word)) => (word, a),
            _ => continue,
        };
        return mistake(
            word.at,
            format!("{} without {} in G5", here.text(word), char::from(missing)),
            "write both words of the control point",
        );
    }
    Ok(())
}

impl Executor {
    /// Runs a cubic or quadratic spline.
    pub(crate) fn spline(
        &mut self,
        block: &Block,
        here: &Here,
        to: PerLetter,
        at: usize,
    ) -> Read<()> {
        let is_cubic = self.state.modes.motion == Motion::Cubic;
        let name = if is_cubic { "G5" } else { "G5.1" };
        self.check_spline(block, here, name, at)?;
        // The next G5 continues this one, even if it is wrong.
        let before = self.last_tangent;
        let size = self.state.unit();
        let vector = |letters: [u8; 2]| -> Option<Point> {
            let [a, b] = letters.map(|letter| block.value(letter));
            (a.is_some() || b.is_some()).then(|| {
                self.state
                    .rotation
                    .turn([a.unwrap_or(0.0) * size, b.unwrap_or(0.0) * size])
            })
        };
        let from = [self.state.at[0], self.state.at[1]];
        let end = [to[0], to[1]];
        let first = vector(*b"IJ");
        let points = if is_cubic {
            check_pairs(block, here)?;
            let Some(last) = vector(*b"PQ") else {
                return mistake(
                    at,
                    "G5 without P and Q",
                    "write the control point from the end (P, Q)",
                );
            };
            self.last_tangent = Some(last);
            let Some(first) = first.or(before.map(|[x, y]| [-x, -y])) else {
                self.state.at = to;
                return mistake(
                    at,
                    "the first G5 without I and J",
                    "write the control point from the start (I, J)",
                );
            };
            [
                from,
                [from[0] + first[0], from[1] + first[1]],
                [end[0] + last[0], end[1] + last[1]],
                end,
            ]
        } else {
            let Some(first) = first else {
                return mistake(
                    at,
                    "G5.1 without I and J",
                    "write the control point from the start (I, J)",
                );
            };
            let control = [from[0] + first[0], from[1] + first[1]];
            // The cubic with the same shape.
            let towards = |a: Point| {
                [
                    a[0] + 2.0 / 3.0 * (control[0] - a[0]),
                    a[1] + 2.0 / 3.0 * (control[1] - a[1]),
                ]
            };
            [from, towards(from), towards(end), end]
        };
        let move_feed = self.move_feed(at, block)?;
        let mut pieces = Vec::new();
        divide(&Bezier(points), 0.0, 1.0, 0, &mut pieces);
        self.run_pieces(&pieces, to, move_feed, here.place(at), at)
    }

    fn check_spline(&self, block: &Block, here: &Here, name: &str, at: usize) -> Read<()> {
        if self.state.modes.plane != Plane::Xy {
            let found = Mistake::new(at, format!("{name} outside the plane X Y"), "write G17");
            return Err(Box::new(found.because(Cause::Plane)));
        }
        if self.out.compensation.active.is_some() {
            return mistake(
                at,
                format!("{name} while cutter compensation is on"),
                "switch it off (G40) before",
            );
        }
        if [0, 1]
            .iter()
            .any(|axis| self.out.coordinate(*axis).is_none())
        {
            return mistake(
                at,
                format!("the machine has no axes X and Y for {name}"),
                "write straight moves",
            );
        }
        if let Some((_, word)) = block.first_of(letters(b"ZABCUVW")) {
            return mistake(
                word.at,
                format!("{} in a spline", here.text(word)),
                "a spline moves X and Y: move this axis in another block",
            );
        }
        Ok(())
    }

    fn run_pieces(
        &mut self,
        pieces: &[Piece],
        to: PerLetter,
        move_feed: MoveFeed,
        place: Place,
        at: usize,
    ) -> Read<()> {
        // With inverse time, each piece gets its share of the time.
        let mut lengths = Vec::with_capacity(pieces.len());
        let mut from = [self.state.at[0], self.state.at[1]];
        for (end, arc) in pieces {
            lengths.push(match arc {
                Some(arc) => (arc.sweep * arc.radius[0]).abs(),
                None => distance(from, *end),
            });
            from = *end;
        }
        let total: f64 = lengths.iter().sum();
        for ((end, arc), length) in pieces.iter().zip(lengths) {
            if length < 1e-9 {
                continue;
            }
            let mut point = self.state.at;
            (point[0], point[1]) = (end[0], end[1]);
            let move_feed = match move_feed {
                MoveFeed::Inverse(rate) => MoveFeed::Inverse(rate * total / length),
                move_feed => move_feed,
            };
            let line = self.line_to(place, point, move_feed);
            let leg = Leg { arc: *arc, ..line };
            self.out.leg(&leg);
            self.state.at = point;
        }
        let leg = self.line_to(place, to, move_feed);
        if distance([self.state.at[0], self.state.at[1]], [to[0], to[1]]) > 1e-6 {
            return mistake(at, "the spline does not reach its end", "check its words");
        }
        self.out.leg(&leg);
        self.state.at = to;
        Ok(())
    }

    /// Adds a control point of a NURBS.
    pub(crate) fn control_point(
        &mut self,
        block: &Block,
        here: &Here,
        code: Option<Code>,
    ) -> Read<()> {
        let first = block.first_of(letters(b"XYPL")).map(|(_, word)| word.at);
        let Some(at) = code.map(|code| code.at).or(first) else {
            return Ok(());
        };
        self.check_spline(block, here, "G5.2", at)?;
        let order = match block.word(b'L') {
            Some(word)
                if word.value.fract() == 0.0 && (2.0..=LARGEST_ORDER).contains(&word.value) =>
            {
                word.value as usize
            }
            Some(word) => {
                return mistake(
                    word.at,
                    format!("{} is not an order", here.text(word)),
                    "write a whole number from 2 to 20",
                );
            }
            None => self.control_points.first().map_or(3, |point| point.order),
        };
        let weight = match block.word(b'P') {
            Some(word) if word.value <= 0.0 => {
                return mistake(
                    word.at,
                    format!("{} is not a weight", here.text(word)),
                    "write a weight above 0",
                );
            }
            word => word.map(|word| word.value),
        };
        let has_point = block.has_any(letters(b"XY"));
        if self.control_points.len() >= MAX_POINTS {
            return mistake(
                at,
                format!("a NURBS of more than {MAX_POINTS} points"),
                "divide it",
            );
        }
        if self.control_points.is_empty() {
            let here = self.state.at;
            self.control_points.push(ControlPoint {
                at: [here[0], here[1]],
                weight: if has_point {
                    1.0
                } else {
                    weight.unwrap_or(1.0)
                },
                order,
            });
        }
        if has_point {
            let Some(weight) = weight else {
                return mistake(
                    at,
                    "a control point without a weight",
                    "write P with its weight",
                );
            };
            let to = self.target(block, false);
            self.control_points.push(ControlPoint {
                at: [to[0], to[1]],
                weight,
                order,
            });
        }
        Ok(())
    }

    /// G5.3: runs the NURBS of the control points.
    pub(crate) fn finish_nurbs(&mut self, block: &Block, here: &Here, code: Code) -> Read<()> {
        let points = std::mem::take(&mut self.control_points);
        if self.state.modes.motion != Motion::Nurbs {
            let found = Mistake::new(
                code.at,
                "G5.3 without G5.2",
                "write G5.2 and the control points before",
            );
            return Err(Box::new(found.because(Cause::Motion)));
        }
        self.state.modes.motion = Motion::Off;
        let order = points.first().map_or(3, |point| point.order);
        let Some(last) = points.last() else {
            return mistake(code.at, "a NURBS without points", "write them after G5.2");
        };
        if points.len() < order {
            return mistake(
                code.at,
                format!("a NURBS of order {order} with {} points", points.len()),
                "write at least as many points as the order",
            );
        }
        let move_feed = self.move_feed(code.at, block)?;
        let mut to = self.state.at;
        (to[0], to[1]) = (last.at[0], last.at[1]);
        let mut pieces = Vec::new();
        for span in 0..=points.len() - order {
            let curve = Nurbs {
                points: &points,
                order,
                span,
            };
            let low = span as f64;
            divide(&curve, low, low + 1.0, 0, &mut pieces);
        }
        self.run_pieces(&pieces, to, move_feed, here.place(code.at), code.at)
    }

    /// Refuses another motion while the points of a NURBS are read.
    pub(crate) fn refuse_open_nurbs(&mut self, tenths: u16, at: usize) -> Read<()> {
        if tenths == 52 || self.control_points.is_empty() {
            return Ok(());
        }
        self.control_points.clear();
        Err(Box::new(
            Mistake::new(
                at,
                "a motion before the end of the NURBS",
                "write G5.3 after its last point",
            )
            .because(Cause::Motion),
        ))
    }
}
