//! Encoder slip detection: comparison of index pulses with encoder counts.
//!
//! The counter advances a whole number of turns between two index pulses. Any difference was added
//! or lost by noise or a bad contact. Motion supervision cannot detect it, because the loop moves
//! the joint to the counted position. The monitor finds lost or gained counts within two turns,
//! however few they are. Index pulses of one position, approached from both sides, differ by the
//! width of the pulse. That width is the slack, one line of most encoders.
//!
//! A single pulse may be noise on the index line. So slip is reported only when a second pulse
//! shows the same offset, and the first pulse is accepted as a reference only when a second one
//! agrees. During the reference search every pulse counts, because the references come from these
//! pulses.
//!
//! The monitor also clears a suspected encoder. A joint that was pushed or blocked has the signals
//! of one with a stuck encoder. If its next index pulse comes at the expected count, the encoder is
//! good, and the joint may be homed without a manual preset.
//!
//! The comparison uses raw counts, so it is exact after any number of turns. Nothing is compared if
//! the pitch is not a whole number of counts. The pulses are kept while the drives are off, when
//! the screw may be turned by hand.
//!
//! Callers must latch the count at the pulse itself, and the index must be on the same shaft as the
//! encoder. Otherwise the offset is not an encoder fault.

use crate::digest::impl_digest;

/// Index monitor of one encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IndexMonitor {
    /// Counts between two pulses; 0 if that is not a whole number, or the comparison is switched
    /// off.
    turn: i32,
    /// Largest accepted offset of a pulse, in counts.
    slack: u32,
    /// Raw count at which the last pulse was expected, extrapolated from the first one.
    due: Option<i32>,
    /// Raw count of a pulse that did not agree with an earlier one.
    doubt: Option<i32>,
    /// A reference search is active.
    searching: bool,
}

impl_digest!(IndexMonitor { fields { turn, slack }, nested {}, skip { due, doubt, searching } });

impl IndexMonitor {
    /// A monitor for pulses `pitch` axis units apart, with `per_count` axis units per count, times
    /// 2^24. The offset of a pulse may be `slack` counts; 0 switches the comparison off.
    #[must_use]
    pub const fn new(pitch: i32, per_count: i64, slack: u16) -> Self {
        let count = per_count.unsigned_abs();
        let pitch = (pitch.unsigned_abs() as u64) << 24;
        let turn = match pitch.saturating_add(count / 2).checked_div(count) {
            // With fewer counts per turn, an offset within the slack could be half of a turn.
            Some(turn) if turn > 4 * slack as u64 && turn <= i32::MAX as u64 => turn,
            _ => 0,
        };
        // The pitch is rounded to an axis unit, the count to 2^-24 axis unit. With counts of less
        // than two axis units a whole number cannot be recognised.
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

    /// Checks a pulse at the raw count `raw`. Returns its offset in counts if the offset is
    /// confirmed and above the slack.
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
        // During a reference search the pulse becomes the new origin of the grid.
        let place = if self.searching { 0 } else { off };
        self.due = Some(raw.wrapping_sub(place));
        None
    }

    /// Offset of a raw count from the nearest pulse of the grid through `place`: less than half a
    /// turn.
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

    /// Takes over the pulse positions of another monitor with the same counts and pitch.
    pub const fn take_over(&mut self, other: &Self) {
        self.due = other.due;
        self.doubt = other.doubt;
    }

    /// Whether the next pulse can show lost counts: the grid of pulses is known.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        self.turn != 0 && self.due.is_some()
    }

    /// Starts or ends the reference search.
    pub const fn search(&mut self, searching: bool) {
        self.searching = searching;
    }

    /// Clears the pulse positions, after the offset was reported.
    pub const fn clear(&mut self) {
        self.due = None;
        self.doubt = None;
    }
}
