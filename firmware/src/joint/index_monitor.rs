//! Index pulses against counts: an encoder that lost or gained counts is found within two turns, however few they are.
//!
//! From one index pulse to another the counter goes a whole number of turns. What it is off is what noise or a bad contact added or took away; supervision
//! of the motion cannot see that, for the loop takes the joint to wherever the counter says. Pulses of one place, come to from both sides, are apart by the width of the pulse:
//! the slack, one line of most encoders.
//!
//! Nothing is believed on a single pulse, which may be noise on the index line: what is off is said when another pulse is off by as much. A first pulse is one of a grid when a second agrees.
//! Only while the references are looked for each pulse counts: there it is what everything is made of.
//!
//! It says the opposite as well. A joint that was pushed or held looks as one whose encoder is dead, and when its next pulse comes in its place it was not: it may be homed
//! without anybody setting it up by hand.
//!
//! What is compared is raw counts, in whole numbers: it is exact after any number of turns. Where a pitch is no whole number of counts nothing is
//! compared. Pulses are remembered while the drives are off, when somebody turns the screw.
//!
//! Misuse: a latch that is read some counts after the pulse, or an index on another shaft than the counts. What is off is then no fault of the encoder.

use crate::config::digest::constants;

/// Where index pulses must come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IndexMonitor {
    /// Counts from one pulse to the next; 0 where that is no whole number, or nothing is to be compared.
    turn: i32,
    /// So many counts a pulse may be off.
    slack: u32,
    /// Raw count at which the newest pulse should have come, judging by the first one.
    due: Option<i32>,
    /// Raw count of a pulse that agreed with none before.
    doubt: Option<i32>,
    /// The references are looked for.
    searching: bool,
}

constants!(IndexMonitor { turn, slack } of {} but { due, doubt, searching });

impl IndexMonitor {
    /// Pulses `pitch` axis units apart, with `per_count` axis units a count, times 2^24. Each may be off by `slack` counts; with 0 nothing is compared.
    #[must_use]
    pub const fn new(pitch: i32, per_count: i64, slack: u16) -> Self {
        let count = per_count.unsigned_abs();
        let pitch = (pitch.unsigned_abs() as u64) << 24;
        let turn = match pitch.saturating_add(count / 2).checked_div(count) {
            // With fewer, half of a turn could be an error within the slack.
            Some(turn) if turn > 4 * slack as u64 && turn <= i32::MAX as u64 => turn,
            _ => 0,
        };
        // The pitch is rounded to an axis unit, the count to the 2^24th part of one. With counts of less than two axis units nobody can tell.
        let rounding = (1 << 23) + turn / 2 + 1;
        let whole = rounding <= count / 4 && turn.saturating_mul(count).abs_diff(pitch) <= rounding;
        Self {
            turn: if whole && slack != 0 { turn as i32 } else { 0 },
            slack: slack as u32,
            due: None,
            doubt: None,
            searching: false,
        }
    }

    /// A pulse came at this raw count: by how many counts it is off, if that is certain and too much.
    #[inline(never)]
    pub fn pulse(&mut self, raw: i32) -> Option<i32> {
        if self.turn == 0 {
            return None;
        }
        let agrees = self
            .doubt
            .is_some_and(|doubt| self.off(raw, doubt).unsigned_abs() <= self.slack);
        let Some(due) = self.due else {
            if agrees || self.searching {
                self.due = Some(raw);
            }
            self.doubt = Some(raw);
            return None;
        };
        let off = self.off(raw, due);
        if off.unsigned_abs() > self.slack {
            self.doubt = Some(raw);
            return (agrees || self.searching).then_some(off);
        }
        self.doubt = None;
        // What is found by this one counts from it.
        let place = if self.searching { 0 } else { off };
        self.due = Some(raw.wrapping_sub(place));
        None
    }

    /// From the place of a pulse, whichever of them, to a raw count: less than half a turn.
    const fn off(&self, raw: i32, place: i32) -> i32 {
        let off = raw.wrapping_sub(place) % self.turn;
        let half = self.turn / 2;
        if off > half {
            off - self.turn
        } else if off < -half {
            off + self.turn
        } else {
            off
        }
    }

    /// What another one, of the same counts and pitch, knows of where pulses come.
    pub const fn take_over(&mut self, other: &Self) {
        self.due = other.due;
        self.doubt = other.doubt;
    }

    /// Whether the next pulse will tell if counts were lost: where they come is known.
    #[must_use]
    pub const fn will_tell(&self) -> bool {
        self.turn != 0 && self.due.is_some()
    }

    /// The references are looked for, or not any more.
    pub const fn search(&mut self, searching: bool) {
        self.searching = searching;
    }

    /// What was off is known: pulses begin anew.
    pub const fn forget(&mut self) {
        self.due = None;
        self.doubt = None;
    }
}
