//! Whether what waits in the queue covers the way to rest.

use super::{FULL_RATE, Late, Program, Ramp};
use crate::motion::ramp::RampLimits;

impl Program {
    /// Whether the way from a rest may begin at any path rate: it is long enough to come to rest again if nothing more arrives. A rest lies ahead, or
    /// more than braking takes.
    pub(super) fn can_pass_rest(&self) -> bool {
        self.total.is_some()
            || self.rests_ahead > 0
            || self.queued_periods >= 4 * self.braking_periods
    }

    /// Whether the way from a rest may begin at all: also with all that the queue can hold, if the spans are so short that this is less than braking
    /// takes. Then it begins at the path rate 0, which rises no further than what is there allows.
    pub(super) fn can_leave_rest(&self) -> bool {
        self.can_pass_rest() || self.queue.is_full()
    }

    /// Decides whether the queue still covers the way to rest.
    #[inline]
    pub(super) fn monitor_underrun(&mut self, braking: &RampLimits) {
        if let Some(underrunning) = &mut self.underrunning {
            underrunning.periods = underrunning.periods.saturating_add(1);
        }
        // At a rest ahead the motion ends by itself, and goes on only when enough has come.
        if self.rests_ahead > 0 {
            self.underrunning = None;
            return;
        }
        let remaining = self.remaining_periods();
        let needed = if self.path_rate == Ramp::at(FULL_RATE) {
            self.braking_periods
        } else {
            self.path_rate
                .stopping_range(braking)
                .map_or(u64::MAX - 2, |(_, ahead)| ahead.unsigned_abs() >> 32)
        } + 2;
        if self.underrunning.is_some() {
            // A full queue is all that there can be: go on as fast as it covers, with some room so that braking does not begin at once.
            let most = self.queue.is_full() && remaining > needed + needed / 4 + 8;
            if remaining >= 4 * self.braking_periods || most {
                self.underrunning = None;
            }
        } else if remaining <= needed {
            self.underrunning = Some(Late {
                setpoint: self.accepted,
                periods: 0,
            });
        }
    }

    #[inline]
    fn remaining_periods(&self) -> u64 {
        let segment = self
            .segment()
            .map_or(0, |segment| u64::from(segment.span.periods()));
        (segment + self.queued_periods).saturating_sub((self.time >> 32) + 1)
    }
}
