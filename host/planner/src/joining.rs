//! Joins successive short lines to one line or arc (G64 Q).
//!
//! The speed changes within a block, without acceleration at its ends, so that a short block limits
//! the speed. The program of a curve has many of them; the joined path has few.
//!
//! Without Q the joined path may take half of the tolerance P. Its corners have the other half, so
//! that the motion stays within P of the program. Rotary coordinates have half of their tolerance,
//! with and without Q.

use super::block::Block;
use super::limits::Settings;
use haptimill_gcode::{Arc, Coordinates, Feed, Measure, Move, Path, WordKind};

/// Most moves of a joined path: a new move is compared with all of them.
const MAX: usize = 256;
/// Largest length of a move that is joined, mm; a longer one limits no speed.
const LONGEST_MM: f64 = 2.0;
/// Largest duration of a joined path at its feed, seconds: its setpoints wait for all of its moves.
const LONGEST_S: f64 = 1.0;
/// Largest duration of a joined move that turns a rotary coordinate, seconds. Below 21 ms it limits
/// the speed, at an override of 200 % below 42 ms; beyond that the exact motion is better.
const LONGEST_TURN_S: f64 = 0.045;
/// Share of the distance for that across an arc, and for that along its axis: together below it.
const ARC_SHARE: f64 = 0.7;
/// Share of the tolerance of rotary coordinates; corners have the rest.
const TURN_SHARE: f64 = 0.5;
/// Largest angle of an arc, radians.
const LARGEST_SWEEP: f64 = 2.5;
/// Largest angle of one line on an arc, radians.
const LARGEST_STEP: f64 = 0.5;
/// Planes of arcs, in the order that makes a positive sweep counter-clockwise, and their axis.
const PLANES: [([usize; 2], usize); 3] = [([0, 1], 2), ([2, 0], 1), ([1, 2], 0)];

/// Moves that are joined.
#[derive(Debug)]
pub(crate) struct Joined {
    /// The joined move; it has the place of the first one.
    pub whole: Move,
    pub moves: Vec<Move>,
    /// Largest distance of the path from the moves.
    within: Within,
    /// Tolerance of its corners, mm, if it has two moves or more; `None` is that of the moves.
    corners: Option<f64>,
    /// Number of messages of the program before them.
    pub messages: u32,
}

/// Largest distance of a joined path from its moves.
#[derive(Debug, Clone, Copy)]
struct Within {
    mm: f64,
    /// Of a rotary coordinate.
    degrees: f64,
}

impl Joined {
    /// Gives the blocks of the whole the places of the moves, and its corners their share of the
    /// tolerance of rotary coordinates.
    pub(crate) fn complete(&self, blocks: &mut [Block], kinds: &[WordKind]) {
        let whole = &self.whole.path;
        let turns = if whole.turns(kinds) {
            1.0 - TURN_SHARE
        } else {
            1.0
        };
        let programmed: f64 = self.moves.iter().map(|step| step.path.length).sum();
        let mut moves = self.moves.iter().peekable();
        // Where the next move and the next block begin, on the whole.
        let (mut begin, mut start) = (0.0, 0.0);
        let mut place = self.whole.place;
        for block in blocks {
            block.turns = turns;
            block.place = place;
            let end = start + block.path.length;
            while let Some(step) = moves.next_if(|_| begin < end) {
                place = step.place;
                block.places.push((begin - start, place));
                begin += step.path.length * whole.length / programmed;
            }
            start = end;
        }
    }
}

/// The last moves, if they can be joined.
#[derive(Debug, Default)]
pub(crate) struct Joining(Option<Joined>);

impl Joining {
    /// Takes the moves that are joined.
    pub(crate) fn take(&mut self) -> Option<Joined> {
        self.0.take()
    }

    /// Begins with a move; returns false if it is no short line at a feed with a tolerance.
    pub(crate) fn begin(&mut self, step: &Move, messages: u32, settings: &Settings) -> bool {
        let half = 0.5 * step.tolerance.unwrap_or(settings.tolerance_mm);
        let within = Within {
            mm: step.joining.unwrap_or(half),
            degrees: TURN_SHARE * settings.tolerance_deg,
        };
        if !is_short_line(step, &settings.kinds()) || within.mm <= 0.0 {
            return false;
        }
        self.0 = Some(Joined {
            whole: step.clone(),
            moves: vec![step.clone()],
            within,
            corners: step.joining.is_none().then_some(half),
            messages,
        });
        true
    }

    /// Joins a move to those before; returns false if it cannot be.
    pub(crate) fn extend(&mut self, step: &Move, kinds: &[WordKind]) -> bool {
        let Some(joined) = &mut self.0 else {
            return false;
        };
        let Some(first) = joined.moves.first() else {
            return false;
        };
        let length = joined.whole.path.length;
        let is_alike = is_short_line(step, kinds)
            && (step.feed, step.fixed) == (first.feed, first.fixed)
            && (step.tolerance, step.joining) == (first.tolerance, first.joining)
            && step.tool == first.tool
            && step.place.file == first.place.file
            && step.path.from == joined.whole.path.to
            && joined.moves.len() < MAX;
        let Feed::PerMinute(feed) = step.feed else {
            return false;
        };
        if !is_alike || length + step.path.length > LONGEST_S * feed / 60.0 {
            return false;
        }
        joined.moves.push(step.clone());
        let (moves, within) = (&joined.moves, joined.within);
        let path = line_through(moves, within, kinds).or_else(|| {
            let mut planes = PLANES.iter();
            planes.find_map(|plane| arc_through(moves, within, plane, kinds))
        });
        match path {
            Some(path) => {
                joined.whole.path = path;
                joined.whole.tolerance = joined.corners.or(joined.whole.tolerance);
                true
            }
            None => {
                joined.moves.pop();
                false
            }
        }
    }
}

fn is_short_line(step: &Move, kinds: &[WordKind]) -> bool {
    let path = &step.path;
    !step.exact_stop
        && step.feed != Feed::Rapid
        && path.arc.is_none()
        && path.measure == Measure::Tip
        && path.length <= LONGEST_MM
        && (!path.turns(kinds)
            || matches!(step.feed, Feed::PerMinute(feed) if path.length <= LONGEST_TURN_S * feed / 60.0))
}

/// The points of the moves, from the start of the first one to the end of the last one.
fn points(moves: &[Move]) -> impl Iterator<Item = &Coordinates> {
    let first = moves.first().map(|step| &step.path.from);
    first
        .into_iter()
        .chain(moves.iter().map(|step| &step.path.to))
}

/// Returns the line from the first to the last point if all points are near it, in its direction.
fn line_through(moves: &[Move], within: Within, kinds: &[WordKind]) -> Option<Path> {
    let (first, last) = (moves.first()?, moves.last()?);
    let (from, to) = (&first.path.from, &last.path.to);
    let is_rotary = |k: usize| kinds.get(k) == Some(&WordKind::Rotary);
    let along: Coordinates = std::array::from_fn(|k| to[k] - from[k]);
    let linear = |k: &usize| !is_rotary(*k);
    let squared: f64 = (0..6).filter(linear).map(|k| along[k] * along[k]).sum();
    let mut before = 0.0;
    for point in points(moves) {
        let part: Coordinates = std::array::from_fn(|k| point[k] - from[k]);
        let done: f64 = (0..6).filter(linear).map(|k| part[k] * along[k]).sum();
        let share = done / squared;
        let off: Coordinates = std::array::from_fn(|k| part[k] - share * along[k]);
        let across: f64 = (0..6).filter(linear).map(|k| off[k].powi(2)).sum();
        let turned = (0..6).any(|k| is_rotary(k) && off[k].abs() > within.degrees);
        if share
            .partial_cmp(&before)
            .is_none_or(std::cmp::Ordering::is_lt)
            || across > within.mm * within.mm
            || turned
        {
            return None;
        }
        before = share;
    }
    Path::line(kinds, *from, *to)
}

/// Returns the arc through the first, a middle and the last point if all points, and the middles of
/// the lines between them, are near it.
fn arc_through(
    moves: &[Move],
    within: Within,
    (plane, axis): &([usize; 2], usize),
    kinds: &[WordKind],
) -> Option<Path> {
    let (first, last) = (moves.first()?, moves.last()?);
    let (from, to) = (&first.path.from, &last.path.to);
    let is_linear = |k: &usize| kinds.get(*k) == Some(&WordKind::Linear);
    if !plane.iter().all(is_linear) {
        return None;
    }
    let in_plane = |point: &Coordinates| plane.map(|k| point[k]);
    let ends = [from, &moves[moves.len() / 2].path.from, to].map(in_plane);
    let centre = centre_of(ends)?;
    let polar = |[x, y]: [f64; 2]| {
        let (x, y) = (x - centre[0], y - centre[1]);
        (x.hypot(y), y.atan2(x))
    };
    let (radius, angle) = polar(ends[0]);
    let max = ARC_SHARE * within.mm;
    let mut sweep = 0.0f64;
    let mut angles = Vec::with_capacity(moves.len());
    for step in moves {
        let [a, b] = [&step.path.from, &step.path.to].map(in_plane);
        let middle = [0, 1].map(|k| 0.5 * (a[k] + b[k]));
        let turned = polar(b).1 - polar(a).1;
        let whole = std::f64::consts::TAU;
        let turned = turned - whole * (turned / whole).round();
        let is_onward = turned * sweep >= 0.0 && turned.abs() <= LARGEST_STEP;
        let is_near = [b, middle]
            .iter()
            .all(|at| (polar(*at).0 - radius).abs() <= max);
        if !is_onward || !is_near {
            return None;
        }
        sweep += turned;
        angles.push(sweep);
    }
    if sweep == 0.0 || sweep.abs() > LARGEST_SWEEP {
        return None;
    }
    // The other coordinates are in proportion to the angle. Between the ends of a line its angle is
    // not in proportion to its length: by up to 2 / (9 sqrt(3)) times the cube of half its angle.
    let mut before = 0.0;
    for (step, angle) in moves.iter().zip(angles) {
        let between = 0.129 * (0.5 * (angle - before)).abs().powi(3);
        before = angle;
        for k in 0..6 {
            let slope = (to[k] - from[k]) / sweep;
            let off = step.path.to[k] - from[k] - slope * angle;
            let max = match k {
                _ if plane.contains(&k) => continue,
                _ if k == *axis => max,
                _ if kinds.get(k) == Some(&WordKind::Rotary) => within.degrees,
                _ => 0.0,
            };
            if off.abs() + between * slope.abs() > max {
                return None;
            }
        }
    }
    let arc = Arc {
        plane: *plane,
        centre,
        radius: [radius, polar(ends[2]).0],
        angle,
        sweep,
    };
    Path::arc(kinds, *from, *to, arc)
}

/// Returns the centre of the circle through three points; none if it is nearly a line.
fn centre_of([a, b, c]: [[f64; 2]; 3]) -> Option<[f64; 2]> {
    let (b, c) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let cross = 2.0 * (b[0] * c[1] - b[1] * c[0]);
    let squares = [b[0] * b[0] + b[1] * b[1], c[0] * c[0] + c[1] * c[1]];
    if cross.abs() <= 1e-9 * (squares[0] * squares[1]).sqrt() {
        return None;
    }
    let x = (c[1] * squares[0] - b[1] * squares[1]) / cross;
    let y = (b[0] * squares[1] - c[0] * squares[0]) / cross;
    Some([a[0] + x, a[1] + y])
}
