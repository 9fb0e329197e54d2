//! Retraction along the path, away from an excessive force.
//!
//! The path already travelled is free of obstacles. The setpoints passed last are stored, and the
//! retraction evaluates the same segment polynomials at a negative speed factor. Its length is
//! limited to [`PASSED`] setpoints.
//!
//! Callers must not resume a job after a retraction: the setpoints retracted over are no longer in
//! the queue.

use super::{FULL_FACTOR, Interpolator, Knot};
use crate::motion::ramp::RampLimits;

/// Number of stored setpoints.
pub(super) const PASSED: usize = 16;

/// Speed factor of the retraction: a quarter of the programmed speed.
const BACK_RATE: i64 = FULL_FACTOR / 4;

impl Interpolator {
    /// Ends the job: once the speed factor is zero, the machine retracts for `periods` control
    /// periods of program time, as far as setpoints are stored. [`Interpolator::is_at_standstill`]
    /// tells when the retraction is complete.
    pub fn retract(&mut self, periods: u32) {
        self.retract_left = u64::from(periods) << 32;
    }

    /// Stores a passed setpoint.
    pub(super) fn store_passed(&mut self, knot: Knot) {
        if self.passed.is_full() {
            self.passed.pop_front();
        }
        // Cannot fail: room was made above.
        let _ = self.passed.push_back(knot);
    }

    /// Advances the retraction by one control period; false while the machine still moves forwards.
    pub(super) fn is_retracting(&mut self, braking: &RampLimits) -> bool {
        if self.speed_factor.value() > 0 {
            return false;
        }
        let stored: u64 = self.passed.iter().map(|knot| u64::from(knot.periods)).sum();
        // The first stored setpoint is the start of the path. The start of the present segment has
        // the last duration.
        let first = self
            .passed
            .front()
            .map_or(0, |knot| u64::from(knot.periods));
        let last = if self.passed.is_empty() {
            0
        } else {
            u64::from(self.from.periods)
        };
        let available = (stored - first + last) << 32;
        self.retract_left = self.retract_left.min(available + self.time);
        // The distance if the retraction continues for one period and decelerates then.
        let mut rate = self.speed_factor;
        let next = rate.advance(-BACK_RATE, braking).min(0).unsigned_abs();
        let stopping = rate.stopping_range(braking);
        let needed = next.saturating_add(stopping.map_or(u64::MAX, |(far, _)| far.unsigned_abs()));
        let target = if needed < self.retract_left {
            -BACK_RATE
        } else {
            0
        };
        let step = self
            .speed_factor
            .advance(target, braking)
            .min(0)
            .unsigned_abs();
        self.retract_left = self.retract_left.saturating_sub(step);
        if target == 0 && self.speed_factor.is_zero() {
            self.retract_left = 0;
        }
        self.advance_retract(step);
        true
    }

    fn advance_retract(&mut self, mut step: u64) {
        while self.time < step {
            let Some(knot) = self.passed.pop_back() else {
                // Unreachable: the retraction is limited to the stored setpoints.
                self.time = 0;
                return;
            };
            step -= self.time;
            let to = core::mem::replace(&mut self.from, knot);
            self.begin_retract(&to);
            self.time = u64::from(to.periods) << 32;
            self.elapsed = self.elapsed.saturating_sub(u64::from(to.periods));
            self.reached = self.reached.wrapping_sub(1);
        }
        self.time -= step;
    }
}
