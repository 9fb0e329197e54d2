//! Trajectory: the speed profile along the exact paths, and the roundings of the corners.

use haptimill_gcode::{Coordinates, Path, Place};

/// Reason for a setpoint at the beginning of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Knot {
    /// None: the motion continues.
    None,
    /// The jerk changes.
    Jerk,
    /// The acceleration jumps: a line meets an arc.
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
    /// Index of the path.
    pub path: u32,
    /// Reason for a setpoint at its start.
    pub knot: Knot,
}

impl Piece {
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
    pub change: Coordinates,
}

/// The exact paths and the speed profile along them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Trajectory {
    pub paths: Vec<(Place, Path)>,
    pub pieces: Vec<Piece>,
    pub bumps: Vec<Bump>,
}

/// Position in a plan for evaluations in sequence: a step forward is cheap, other times need a
/// search.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cursor {
    piece: usize,
    bump: usize,
}

impl Trajectory {
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

    /// Returns the programmed pose on the exact paths.
    pub(crate) fn programmed(&self, cursor: &mut Cursor, time: f64) -> Coordinates {
        let Some(piece) = self.seek(cursor, time) else {
            return [0.0; 6];
        };
        let (s, _) = piece.along((time - piece.time).max(0.0));
        self.paths[piece.path as usize].1.at(s)
    }

    /// Returns pose and rates of the trajectory, with corners rounded.
    pub(crate) fn intended(&self, cursor: &mut Cursor, time: f64) -> (Coordinates, Coordinates) {
        let Some(piece) = self.seek(cursor, time) else {
            return ([0.0; 6], [0.0; 6]);
        };
        let (s, speed) = piece.along((time - piece.time).max(0.0));
        let path = &self.paths[piece.path as usize].1;
        let mut pose = path.at(s);
        let mut rates = path.tangent(s).map(|part| part * speed);
        // Roundings do not overlap: only the one that has not ended matters.
        let ended = |bump: &Bump| bump.time + bump.half <= time;
        let passed = cursor.bump;
        if passed > 0 && !ended(&self.bumps[passed - 1])
            || self.bumps.get(passed).is_some_and(ended)
        {
            cursor.bump = self.bumps.partition_point(ended);
        }
        if let Some(bump) = self.bumps.get(cursor.bump) {
            let t = time - bump.time;
            let left = bump.half - t.abs();
            if left > 0.0 {
                let value = left * left * left / (6.0 * bump.half * bump.half);
                let slope = left * left / (2.0 * bump.half * bump.half);
                let slope = if t < 0.0 { slope } else { -slope };
                for k in 0..6 {
                    pose[k] += value * bump.change[k];
                    rates[k] += slope * bump.change[k];
                }
            }
        }
        (pose, rates)
    }
}
