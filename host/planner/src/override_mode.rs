//! Override mode of the spans: which override applies to them, and up to which factor.
//!
//! The controller multiplies the speed of a span by its override. With the factor r, rates grow
//! with r, accelerations with r^2 and jerks with r^3. A piece of the trajectory has the largest
//! factor for which the limits hold. The controller does not look ahead: it changes the speed
//! factor when a span begins. A span therefore has a factor above 100 % only if all pieces that the
//! motion reaches within the time of braking allow it. Spans before a change between rapid moves
//! and moves at feed have the smaller one of both overrides for the same reason.

use super::trajectory::Trajectory;
use haptimill_protocol::message::OverrideMode;

/// Factors above 100 %, in percent.
const LEVELS: [u8; 6] = [110, 120, 130, 150, 175, OverrideMode::MAX_PERCENT];

/// A part of the trajectory ahead.
#[derive(Debug, Clone, Copy)]
struct Window {
    /// Time on the path, seconds.
    length: f64,
    /// First piece behind it.
    next: usize,
}

/// Finds the override mode of spans in sequence.
#[derive(Debug)]
pub(crate) struct ModeFinder {
    /// For each of [`LEVELS`] the window in which all pieces must allow it, and the end of the last
    /// one that does not.
    levels: [(Window, f64); LEVELS.len()],
    /// The window in which all moves must be of one kind, and the ends of the last move at feed and
    /// of the last rapid move.
    kinds: (Window, [f64; 2]),
}

impl ModeFinder {
    /// `slope_s` is the time in which the controller changes the speed factor by 1, `ramp_s` the
    /// time in which this change builds up.
    pub(crate) fn new(slope_s: f64, ramp_s: f64) -> Self {
        // From the factor to 1, or from 1 to 0. A change in the other direction ends before.
        let window = |factor: f64, change: f64| Window {
            length: factor * (change * slope_s + 2.0 * ramp_s),
            next: 0,
        };
        let level = |percent: u8| {
            let factor = f64::from(percent) / 100.0;
            (window(factor, factor - 1.0), 0.0)
        };
        Self {
            levels: LEVELS.map(level),
            kinds: (window(1.0, 1.0), [0.0; 2]),
        }
    }

    /// Begins with a piece.
    pub(crate) fn begin(&mut self, piece: usize) {
        for (window, _) in &mut self.levels {
            window.next = piece;
        }
        self.kinds.0.next = piece;
    }

    /// Follows the removal of the first pieces.
    pub(crate) fn discard(&mut self, pieces: usize) {
        for (window, _) in &mut self.levels {
            window.next = window.next.saturating_sub(pieces);
        }
        self.kinds.0.next = self.kinds.0.next.saturating_sub(pieces);
    }

    /// Returns the override mode of the motion between two times. The trajectory is known up to
    /// `known`; at its `end` the motion stops there. A move that ends within `slack` has ended.
    pub(crate) fn mode(
        &mut self,
        trajectory: &Trajectory,
        [from, to]: [f64; 2],
        (known, is_end): (f64, bool),
        slack: f64,
    ) -> OverrideMode {
        let advance = |window: &mut Window, note: &mut dyn FnMut(usize, f64)| {
            let horizon = to + window.length;
            while let Some(piece) = trajectory.pieces.get(window.next) {
                if piece.time >= horizon {
                    break;
                }
                window.next += 1;
                let following = trajectory.pieces.get(window.next);
                note(window.next - 1, following.map_or(known, |next| next.time));
            }
            is_end || horizon <= known
        };
        let (window, [feed_until, rapid_until]) = &mut self.kinds;
        let is_known = advance(window, &mut |piece, end| {
            let leg = trajectory.leg(trajectory.pieces[piece].path);
            // The motion stops before a move without overrides.
            if leg.is_fixed {
                return;
            }
            *(if leg.is_rapid {
                &mut *rapid_until
            } else {
                &mut *feed_until
            }) = end;
        });
        let (feeds, rapids) = (*feed_until > from + slack, *rapid_until > from + slack);
        let mut max = 100;
        for ((window, low_until), percent) in self.levels.iter_mut().zip(LEVELS) {
            let is_known = advance(window, &mut |piece, end| {
                if trajectory.pieces[piece].max < percent {
                    *low_until = end;
                }
            });
            if is_known && *low_until <= from {
                max = percent;
            }
        }
        match (feeds, rapids) {
            _ if !is_known => OverrideMode::FEED_AND_RAPID,
            (true, true) => OverrideMode::FEED_AND_RAPID,
            (false, true) => OverrideMode::RAPID,
            _ => OverrideMode::feed_up_to(max),
        }
    }
}
