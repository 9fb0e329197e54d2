//! Index pulses against counts: an encoder that lost or gained counts is found within a turn, however few they are.
//!
//! From one index pulse to another the counter goes a whole number of turns. What it is off is what noise, a bad contact or a shield added or took away; supervision
//! of the motion cannot see that, for the loop takes the joint to wherever the counter says. Two pulses of one place, come to from both sides, may differ by a
//! count, and pulses of some encoders by an edge or two: [`TOLERANCE`].
//!
//! It says the opposite as well. A joint that was pushed or held looks as one whose encoder is dead, and when its next pulse comes in its place it was not: it may be homed
//! without anybody setting it up by hand.
//!
//! What is compared is raw counts, in whole numbers: it is exact after any number of turns. Where a pitch is no whole number of counts nothing is
//! compared. Pulses are remembered while the drives are off, when somebody turns the screw.

use crate::safety::integrity::constants;

/// So many counts an index pulse may be off: one line of the encoder. Lost counts come to more sooner or later, for what is off adds up.
pub const TOLERANCE: u32 = 4;

/// Where index pulses must come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IndexWatch {
    /// Counts from one pulse to the next; 0 where that is no whole number.
    turn: i32,
    /// Raw count at which the newest pulse should have come, judging by the first one.
    due: Option<i32>,
}

constants!(IndexWatch { turn } of {} but { due });

impl IndexWatch {
    /// Pulses `pitch` axis units apart, with `per_count` axis units a count, times 2^24.
    #[must_use]
    pub const fn new(pitch: i32, per_count: i64) -> Self {
        let count = per_count.unsigned_abs();
        let pitch = (pitch.unsigned_abs() as u64) << 24;
        let turn = match pitch.saturating_add(count / 2).checked_div(count) {
            // With fewer, half of a turn could be an error within tolerance.
            Some(turn) if turn > 4 * TOLERANCE as u64 && turn <= i32::MAX as u64 => turn,
            _ => 0,
        };
        // The pitch is rounded to an axis unit, the count to the 2^24th part of one. With counts of less than two axis units nobody can tell.
        let rounding = (1 << 23) + turn / 2 + 1;
        let whole = rounding <= count / 4 && turn.saturating_mul(count).abs_diff(pitch) <= rounding;
        Self {
            turn: if whole { turn as i32 } else { 0 },
            due: None,
        }
    }

    /// A pulse came at this raw count: by how many counts it is off.
    #[inline(never)]
    pub const fn pulse(&mut self, raw: i32) -> i32 {
        let (Some(due), 1..) = (self.due, self.turn) else {
            self.due = Some(raw);
            return 0;
        };
        let off = raw.wrapping_sub(due) % self.turn;
        let half = self.turn / 2;
        let off = if off > half {
            off - self.turn
        } else if off < -half {
            off + self.turn
        } else {
            off
        };
        self.due = Some(raw.wrapping_sub(off));
        off
    }

    /// Whether the next pulse will tell if counts were lost: one was seen.
    #[must_use]
    pub const fn will_tell(&self) -> bool {
        self.turn != 0 && self.due.is_some()
    }

    /// What was off is known, and the joint gets its reference anew: the next pulse is the first.
    pub const fn forget(&mut self) {
        self.due = None;
    }
}
