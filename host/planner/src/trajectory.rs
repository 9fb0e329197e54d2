//! Trajectory: the speed profile along the exact paths, and the roundings of the corners.

use super::block::Block;
use super::corner::{BEND_SLOPE, BEND_TURN};
use haptimill_gcode::{Coordinates, Path, Place, ToolLength};

/// Largest deviation of the cubic between setpoints from the trajectory: mm, degrees.
pub(crate) const CUBIC_ERROR_MM: f64 = 1e-4;

/// Reason for a setpoint at the beginning of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Knot {
    /// None: the motion continues.
    None,
    /// The jerk changes.
    Jerk,
    /// The jerk jumps farthest: a line meets an arc, or the motion begins or ends.
    Step,
}

/// Part of the trajectory with constant jerk along one path.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Piece {
    /// Start time, seconds.
    pub time: f64,
    /// Length, speed and acceleration at the start, along the path.
    pub s: f64,
    pub speed: f64,
    pub acceleration: f64,
    pub jerk: f64,
    /// Longest segment duration, seconds, for which the cubic stays near the path.
    pub longest: f64,
    /// Number of the path.
    pub path: u32,
    /// Reason for a setpoint at its start.
    pub knot: Knot,
    /// Largest factor of its speed for which the limits hold, percent, at most 200.
    pub max: u8,
}

impl Piece {
    /// Returns the piece of a standstill at the end of a path.
    pub(crate) fn resting(time: f64, path: u32, s: f64) -> Piece {
        Piece {
            time,
            s,
            speed: 0.0,
            acceleration: 0.0,
            jerk: 0.0,
            longest: f64::INFINITY,
            path,
            knot: Knot::None,
            max: 100,
        }
    }

    /// Returns length and speed `t` seconds after its start.
    pub(crate) fn along(&self, t: f64) -> (f64, f64) {
        let s = self.s + t * (self.speed + t * (0.5 * self.acceleration + t * self.jerk / 6.0));
        let speed = self.speed + t * (self.acceleration + 0.5 * t * self.jerk);
        (s, speed)
    }
}

/// The rounding of a corner, see [`super::corner`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bump {
    pub time: f64,
    pub half: f64,
    /// Jumps of rate and of acceleration.
    pub change: Coordinates,
    pub bend: Coordinates,
}

impl Bump {
    /// Adds the bump at a time to pose and rates.
    fn add(&self, time: f64, pose: &mut Coordinates, rates: &mut Coordinates) {
        let t = time - self.time;
        let left = self.half - t.abs();
        if left <= 0.0 {
            return;
        }
        let value = left * left * left / (6.0 * self.half * self.half);
        let slope = left * left / (2.0 * self.half * self.half);
        let slope = if t < 0.0 { slope } else { -slope };
        let (bend_value, bend_slope) = bend(t.abs() / self.half);
        let bend_value = bend_value.copysign(t) * self.half * self.half;
        let bend_slope = bend_slope * self.half;
        for k in 0..6 {
            pose[k] += value * self.change[k] + bend_value * self.bend[k];
            rates[k] += slope * self.change[k] + bend_slope * self.bend[k];
        }
    }
}

/// Returns phi and its slope for x from 0 to 1, see [`super::corner`].
fn bend(x: f64) -> (f64, f64) {
    let (m, left) = (BEND_SLOPE, 1.0 - x);
    if x > BEND_TURN {
        return (m * left * left * left / 6.0, -0.5 * m * left * left);
    }
    let rest = 1.0 - BEND_TURN;
    let slope = 0.5 * (BEND_TURN - m * BEND_TURN * BEND_TURN - m * rest * rest);
    (
        x * (slope + x * (-0.25 + x * m / 6.0)),
        slope + x * (-0.5 + 0.5 * x * m),
    )
}

/// A path with its place in the program.
#[derive(Debug, Clone)]
pub(crate) struct Leg {
    pub place: Place,
    /// As in [`Block`].
    pub places: Vec<(f64, Place)>,
    /// Number of messages of the program before it.
    pub messages: u32,
    /// Path of the tip.
    pub path: Path,
    /// Tool that makes the pose of the machine from that of the tip.
    pub tool: ToolLength,
    /// Whether it is a rapid move.
    pub is_rapid: bool,
    /// Whether the overrides have no effect.
    pub is_fixed: bool,
}

impl Leg {
    /// Returns the place of the motion at a length.
    pub(crate) fn place_at(&self, s: f64) -> Place {
        let passed = self.places.partition_point(|(begin, _)| *begin <= s);
        let last = passed.checked_sub(1).and_then(|last| self.places.get(last));
        last.map_or(self.place, |(_, place)| *place)
    }
}

/// The exact paths and the speed profile along them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Trajectory {
    pub paths: Vec<Leg>,
    pub pieces: Vec<Piece>,
    pub bumps: Vec<Bump>,
    /// Number of the first path.
    first_path: u32,
}

/// Position in a plan for evaluations in sequence: a step forward is cheap, other times need a
/// search.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cursor {
    piece: usize,
    bump: usize,
}

/// Returns the longest segment duration on a piece for which the cubic stays near its arc.
pub(crate) fn longest_on(piece: &Piece, duration: f64, block: &Block) -> f64 {
    let fastest = piece
        .speed
        .max(piece.speed + duration * (piece.acceleration + 0.5 * duration * piece.jerk));
    let acceleration = piece
        .acceleration
        .abs()
        .max((piece.acceleration + duration * piece.jerk).abs());
    let curvature = block.fourth_derivative(fastest, acceleration, piece.jerk.abs());
    // Error of a cubic Hermite segment: T^4 / 384 times the fourth derivative.
    if curvature > 0.0 {
        libm::sqrt(libm::sqrt(384.0 * CUBIC_ERROR_MM / curvature))
    } else {
        f64::INFINITY
    }
}

impl Trajectory {
    /// Returns a path by its number.
    pub(crate) fn leg(&self, number: u32) -> &Leg {
        &self.paths[(number - self.first_path) as usize]
    }

    /// Returns the number of the last path.
    pub(crate) fn last_path(&self) -> u32 {
        self.first_path + self.paths.len() as u32 - 1
    }

    /// Removes what ends before a time, and returns the number of removed pieces. Cursors are void
    /// after it.
    pub(crate) fn discard(&mut self, time: f64) -> usize {
        let ended = self.pieces.partition_point(|piece| piece.time <= time);
        let pieces = ended.saturating_sub(1);
        self.pieces.drain(..pieces);
        let ended = |bump: &Bump| bump.time + bump.half <= time;
        let count = self.bumps.partition_point(ended);
        self.bumps.drain(..count);
        if let Some(piece) = self.pieces.first() {
            self.paths.drain(..(piece.path - self.first_path) as usize);
            self.first_path = piece.path;
        }
        pieces
    }

    /// Appends the pieces of another trajectory from a number on, with the paths that are new.
    pub(crate) fn append(&mut self, from: &Trajectory, first: usize) {
        if self.paths.is_empty() {
            self.first_path = from.first_path;
        }
        let known = self.first_path as usize + self.paths.len();
        let new = known.saturating_sub(from.first_path as usize);
        self.paths.extend_from_slice(&from.paths[new..]);
        self.pieces.extend_from_slice(&from.pieces[first..]);
    }

    /// Returns the piece at a time.
    pub(crate) fn seek(&self, cursor: &mut Cursor, time: f64) -> Option<&Piece> {
        let after = |index: usize| {
            self.pieces
                .get(index + 1)
                .is_none_or(|next| time < next.time)
        };
        let here = self.pieces.get(cursor.piece)?;
        if time < here.time || !after(cursor.piece) {
            if time >= here.time && after(cursor.piece + 1) {
                cursor.piece += 1;
            } else {
                cursor.piece = self
                    .pieces
                    .partition_point(|piece| piece.time <= time)
                    .saturating_sub(1);
            }
        }
        self.pieces.get(cursor.piece)
    }

    /// Returns the programmed pose of the machine on the exact paths.
    pub(crate) fn programmed(&self, cursor: &mut Cursor, time: f64) -> Coordinates {
        let Some(piece) = self.seek(cursor, time) else {
            return [0.0; 6];
        };
        let (s, _) = piece.along((time - piece.time).max(0.0));
        let leg = self.leg(piece.path);
        leg.tool.machine_pose(&leg.path.at(s))
    }

    /// Returns pose and rates of the machine on the trajectory, with corners rounded.
    pub(crate) fn intended(&self, cursor: &mut Cursor, time: f64) -> (Coordinates, Coordinates) {
        let Some(piece) = self.seek(cursor, time) else {
            return ([0.0; 6], [0.0; 6]);
        };
        let (s, speed) = piece.along((time - piece.time).max(0.0));
        let leg = self.leg(piece.path);
        let (mut pose, tangent) = leg.path.at_with_tangent(s);
        let mut rates = tangent.map(|part| part * speed);
        // Roundings do not overlap: only the one that has not ended matters.
        let ended = |bump: &Bump| bump.time + bump.half <= time;
        let passed = cursor.bump;
        if passed > 0 && !ended(&self.bumps[passed - 1])
            || self.bumps.get(passed).is_some_and(ended)
        {
            cursor.bump = self.bumps.partition_point(ended);
        }
        if let Some(bump) = self.bumps.get(cursor.bump) {
            bump.add(time, &mut pose, &mut rates);
        }
        (
            leg.tool.machine_pose(&pose),
            leg.tool.machine_rates(&pose, &rates),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bump of a jump of curvature: continuous, slope and value end at 0, the second derivative
    /// jumps by -1 at the corner, and its slope is within m.
    #[test]
    fn the_bend_cancels_a_jump_of_acceleration() {
        let h = 1e-4;
        let second = |x: f64| (bend(x + h).1 - bend(x - h).1) / (2.0 * h);
        assert_eq!(bend(0.0).0, 0.0);
        assert!(bend(1.0).0.abs() < 1e-15 && bend(1.0).1.abs() < 1e-15);
        let (below, above) = (bend(BEND_TURN), bend(BEND_TURN + 1e-12));
        assert!((below.0 - above.0).abs() < 1e-11 && (below.1 - above.1).abs() < 1e-11);
        assert!((second(2.0 * h) + 0.5).abs() < 1e-3);
        for step in 2..9998 {
            let x = f64::from(step) * h;
            let slope = (bend(x + h).0 - bend(x - h).0) / (2.0 * h);
            assert!((slope - bend(x).1).abs() < 1e-6, "slope at {x}");
            let third = (second(x + h) - second(x - h)) / (2.0 * h);
            assert!(third.abs() <= BEND_SLOPE * 1.001, "jerk {third} at {x}");
            assert!(second(x) < 0.1757 && bend(x).0 < 0.0146);
        }
    }
}
