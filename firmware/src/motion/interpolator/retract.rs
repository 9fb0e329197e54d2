//! The way back: a tool that pushes against something it cannot cut goes back along its own path, where nothing is in its way.
//!
//! The setpoints that were passed last are remembered, so the way back is the way there: the same cubics, walked with a path rate below zero. How far that goes is
//! bounded by what is remembered ([`PASSED`] setpoints).
//!
//! Misuse: a job that went back is not to be resumed. Setpoints that were walked back over are not in the queue any more.

use super::{FULL_RATE, Knot, Program};
use crate::motion::ramp::RampLimits;

/// Setpoints that are remembered.
pub(super) const PASSED: usize = 16;

/// The path rate of the way back: a quarter of the programmed speed.
const BACK_RATE: i64 = FULL_RATE / 4;

impl Program {
    /// The job ends here: once it has come to rest, the machine goes back along its path for so many periods of program time, as far as that is
    /// remembered. [`Program::is_at_standstill`] says when it has.
    pub fn retract(&mut self, periods: u32) {
        self.back = u64::from(periods) << 32;
    }

    /// A setpoint was passed.
    pub(super) fn remember(&mut self, knot: Knot) {
        if self.passed.is_full() {
            self.passed.pop_front();
        }
        // There is room: made above.
        let _ = self.passed.push_back(knot);
    }

    /// One period of the way back; false while the machine still goes on.
    pub(super) fn is_retracting(&mut self, braking: &RampLimits) -> bool {
        if self.path_rate.value() > 0 {
            return false;
        }
        let remembered: u64 = self.passed.iter().map(|knot| u64::from(knot.periods)).sum();
        // Of the remembered setpoints the first is where the way begins; the one that the present segment comes from has the last span.
        let first = self
            .passed
            .front()
            .map_or(0, |knot| u64::from(knot.periods));
        let last = if self.passed.is_empty() {
            0
        } else {
            u64::from(self.from.periods)
        };
        let there_is = (remembered - first + last) << 32;
        self.back = self.back.min(there_is + self.time);
        // What is swept if it goes on for one period and brakes then.
        let mut rate = self.path_rate;
        let next = rate.advance(-BACK_RATE, braking).min(0).unsigned_abs();
        let stopping = rate.stopping_range(braking);
        let needed = next.saturating_add(stopping.map_or(u64::MAX, |(far, _)| far.unsigned_abs()));
        let target = if needed < self.back { -BACK_RATE } else { 0 };
        let step = self
            .path_rate
            .advance(target, braking)
            .min(0)
            .unsigned_abs();
        self.back = self.back.saturating_sub(step);
        if target == 0 && self.path_rate.is_zero() {
            self.back = 0;
        }
        self.advance_retract(step);
        true
    }

    fn advance_retract(&mut self, mut step: u64) {
        while self.time < step {
            let Some(knot) = self.passed.pop_back() else {
                // Not reached: the way back is bounded by what is remembered.
                self.time = 0;
                return;
            };
            step -= self.time;
            let to = core::mem::replace(&mut self.from, knot);
            self.begin_back(&to);
            self.time = u64::from(to.periods) << 32;
            self.elapsed = self.elapsed.saturating_sub(u64::from(to.periods));
            self.reached = self.reached.wrapping_sub(1);
        }
        self.time -= step;
    }
}
