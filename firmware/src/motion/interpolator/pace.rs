//! Pace of the path: the overrides in effect, and the path rate that a setpoint must allow.
//!
//! Each part of the path allows a largest path rate, its pace. The path rate does not change at
//! once: behind the setpoint at which a faster part ends, it decelerates. The setpoints that the
//! motion reaches in this time must allow the path rate of the faster part, too.

use super::{FULL_RATE, Interpolator, Ramp};
use crate::config::Stopping;
use haptimill_protocol::message::{Action, Pace};
use haptimill_protocol::setpoint::Setpoint;
use heapless::Vec;

/// Largest number of faster parts from which the path rate may still decelerate. The host uses 6
/// factors above 100 %.
const SLOWING: usize = 8;

/// A faster part of the path that has ended.
#[derive(Debug, Clone, Copy)]
struct Faster {
    /// Its largest path rate, percent.
    most: u8,
    /// Program time until the path rate is certainly 100 % or less, control periods.
    periods: u32,
}

/// The paces of the setpoints that were accepted.
#[derive(Debug, Default)]
pub(super) struct AcceptedPace {
    /// Behind the setpoint accepted last.
    pace: Pace,
    /// Faster parts before it, the fastest first; each ends later than the one before.
    faster: Vec<Faster, SLOWING>,
}

impl AcceptedPace {
    /// Begins a job.
    pub(super) fn begin(&mut self) {
        self.pace = Pace::FEED;
        self.faster.clear();
    }

    /// Largest path rate on the segment to the next setpoint, percent.
    pub(super) fn most(&self) -> u8 {
        let fastest = self.faster.first().map_or(0, |faster| faster.most);
        self.pace.most().max(fastest)
    }

    /// Follows an accepted setpoint. `braking` has the control periods in which the path rate
    /// changes by 1, and in which its slope builds up.
    pub(super) fn accept(&mut self, setpoint: &Setpoint, braking: [u32; 2]) {
        let before = self.pace.most();
        if let Action::Pace(pace) = setpoint.action {
            self.pace = pace;
        }
        let is_slower = before > self.pace.most();
        if self.faster.is_empty() && !is_slower {
            return;
        }
        for faster in &mut self.faster {
            faster.periods = faster.periods.saturating_sub(u32::from(setpoint.periods));
            if is_slower && faster.most <= before {
                faster.periods = 0;
            }
        }
        self.faster.retain(|faster| faster.periods != 0);
        // At a setpoint at standstill the path rate takes the value of the overrides at once.
        if setpoint.rates.iter().all(|rate| *rate == 0) {
            self.faster.clear();
        } else if is_slower {
            self.end_faster(before, braking);
        }
    }

    /// A faster part has ended; all in the list are faster than it. A slope that rises must be
    /// undone before it falls.
    fn end_faster(&mut self, most: u8, [slope, ramp]: [u32; 2]) {
        let (most, change) = (u32::from(most), u32::from(most.saturating_sub(100)));
        let ended = Faster {
            most: most as u8,
            periods: most * (change * slope / 100 + 2 * ramp) / 100,
        };
        let is_full = self.faster.is_full();
        if let Some(slowest) = self.faster.last_mut() {
            if slowest.periods >= ended.periods {
                return;
            }
            if is_full {
                slowest.periods = ended.periods;
                return;
            }
        }
        // Cannot fail: the list is not full.
        let _ = self.faster.push(ended);
    }
}

/// Control periods in which the path rate changes by 1, and in which its slope builds up.
pub(super) fn braking_periods(stopping: &Stopping, period_us: u16) -> [u32; 2] {
    let times = [
        stopping.time_ms.saturating_sub(stopping.ramp_ms),
        stopping.ramp_ms,
    ];
    times.map(|time| u32::from(time) * 1000 / u32::from(period_us.max(1)))
}

impl Interpolator {
    /// Sets the feed override, 0 to [`Pace::MOST`] percent of the programmed speed.
    pub fn set_override(&mut self, percent: u8) {
        self.overrides[0] = percent.min(Pace::MOST);
        self.set_pace(self.pace);
    }

    /// Sets the rapid override, 0 to 100 percent of the programmed speed.
    pub fn set_rapid_override(&mut self, percent: u8) {
        self.overrides[1] = percent.min(100);
        self.set_pace(self.pace);
    }

    pub(super) fn set_pace(&mut self, pace: Pace) {
        self.pace = pace;
        let [feed, rapid] = self.overrides;
        self.override_rate = FULL_RATE * i64::from(pace.factor(feed, rapid)) / 100;
    }

    /// Whether the motion is in a part of the path in which overrides have no effect.
    #[must_use]
    pub fn is_fixed(&self) -> bool {
        self.pace == Pace::FIXED
    }

    /// Begins a part of the path with another pace.
    #[inline(never)]
    pub(super) fn enter_pace(&mut self, pace: Pace) {
        let is_steady = self.path_rate == Ramp::at(self.override_rate);
        self.set_pace(pace);
        // At standstill any path rate gives the same motion.
        if is_steady && self.from.is_at_standstill() {
            self.path_rate = Ramp::at(self.override_rate);
        }
    }

    /// At a setpoint at standstill a path rate above that of the overrides ends: any path rate
    /// gives the same motion there, and the setpoints behind it need not allow the higher one.
    pub(super) fn limit_path_rate(&mut self) {
        if self.path_rate.value() > self.override_rate {
            self.path_rate = Ramp::at(self.override_rate);
        }
    }

    /// Largest path rate on the segment to the next setpoint, percent of the programmed speed, 100
    /// to [`Pace::MOST`].
    #[must_use]
    pub fn most(&self) -> u8 {
        self.accepted_pace.most()
    }
}
