//! Underrun monitor: whether the setpoint queue covers the stopping distance.

use super::{FULL_FACTOR, Interpolator, Ramp, Underrun};
use crate::motion::ramp::RampLimits;

impl Interpolator {
    /// Whether motion from standstill may begin at any speed factor: the queue is long enough to
    /// stop again if no more setpoints arrive. It contains a setpoint at standstill, or lasts
    /// longer than braking.
    pub(super) fn can_pass_stop(&self) -> bool {
        self.total.is_some()
            || self.stops_ahead > 0
            || self.queued_periods >= 4 * self.braking_periods
    }

    /// Whether motion from standstill may begin at all. A full queue also suffices, if its
    /// durations are so short that it lasts less than braking. Motion then begins at speed factor
    /// 0, which rises only as far as the queue allows.
    pub(super) fn can_start(&self) -> bool {
        self.can_pass_stop() || self.queue.is_full()
    }

    /// Updates the underrun: whether the queue still covers the stopping distance.
    #[inline]
    pub(super) fn monitor_underrun(&mut self, braking: &RampLimits) {
        if let Some(underrunning) = &mut self.underrunning {
            underrunning.periods = underrunning.periods.saturating_add(1);
        }
        // The motion ends at the setpoint at standstill, and resumes only when enough setpoints
        // have arrived.
        if self.stops_ahead > 0 {
            self.underrunning = None;
            return;
        }
        let remaining = self.remaining_periods();
        let needed = if self.speed_factor == Ramp::at(FULL_FACTOR) {
            self.braking_periods
        } else {
            self.speed_factor
                .stopping_range(braking)
                .map_or(u64::MAX - 2, |(_, ahead)| ahead.unsigned_abs() >> 32)
        } + 2;
        if self.underrunning.is_some() {
            // A full queue cannot grow: resume as fast as it allows, with a margin that keeps
            // braking from starting again at once.
            let is_longest = self.queue.is_full() && remaining > needed + needed / 4 + 8;
            if remaining >= 4 * self.braking_periods || is_longest {
                self.underrunning = None;
            }
        } else if remaining <= needed {
            self.underrunning = Some(Underrun {
                setpoint: self.accepted,
                periods: 0,
            });
        }
    }

    #[inline]
    fn remaining_periods(&self) -> u64 {
        let segment = self
            .segment()
            .map_or(0, |segment| u64::from(segment.duration.periods()));
        (segment + self.queued_periods).saturating_sub((self.time >> 32) + 1)
    }
}
