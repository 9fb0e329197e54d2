//! Override mode of the path: the overrides in effect, and the speed factor that a setpoint must
//! allow.
//!
//! The override mode of a part of the path has a maximum speed factor. The speed factor does not
//! change at once: behind the setpoint at which a faster part ends, it decelerates. The setpoints
//! that the motion reaches in this time must allow the speed factor of the faster part, too.

use super::{FULL_FACTOR, Interpolator, Ramp};
use crate::config::Stopping;
use haptimill_protocol::message::{Action, OverrideMode};
use haptimill_protocol::setpoint::Setpoint;
use heapless::Vec;

/// Largest number of faster parts from which the speed factor may still decelerate. The host uses 6
/// factors above 100 %.
const SLOWING: usize = 8;

/// A faster part of the path that has ended.
#[derive(Debug, Clone, Copy)]
struct Faster {
    /// Its maximum speed factor, percent.
    max: u8,
    /// Program time until the speed factor is certainly 100 % or less, control periods.
    periods: u32,
}

/// The modes of the setpoints that were accepted.
#[derive(Debug, Default)]
pub(super) struct AcceptedModes {
    /// Behind the setpoint accepted last.
    override_mode: OverrideMode,
    /// Faster parts before it, the fastest first; each ends later than the one before.
    faster: Vec<Faster, SLOWING>,
}

impl AcceptedModes {
    /// Begins a job.
    pub(super) fn begin(&mut self) {
        self.override_mode = OverrideMode::FEED;
        self.faster.clear();
    }

    /// Maximum speed factor on the segment to the next setpoint, percent.
    pub(super) fn max_percent(&self) -> u8 {
        let fastest = self.faster.first().map_or(0, |faster| faster.max);
        self.override_mode.max_percent().max(fastest)
    }

    /// Follows an accepted setpoint. `braking` has the control periods in which the speed factor
    /// changes by 1, and in which its slope builds up.
    pub(super) fn accept(&mut self, setpoint: &Setpoint, braking: [u32; 2]) {
        let before = self.override_mode.max_percent();
        if let Action::OverrideMode(mode) = setpoint.action {
            self.override_mode = mode;
        }
        let is_slower = before > self.override_mode.max_percent();
        if self.faster.is_empty() && !is_slower {
            return;
        }
        for faster in &mut self.faster {
            faster.periods = faster.periods.saturating_sub(u32::from(setpoint.periods));
            if is_slower && faster.max <= before {
                faster.periods = 0;
            }
        }
        self.faster.retain(|faster| faster.periods != 0);
        // At a setpoint at standstill the speed factor takes the value of the overrides at once.
        if setpoint.rates.iter().all(|rate| *rate == 0) {
            self.faster.clear();
        } else if is_slower {
            self.end_faster(before, braking);
        }
    }

    /// A faster part has ended; all in the list are faster than it. A slope that rises must be
    /// undone before it falls.
    fn end_faster(&mut self, max: u8, [slope, ramp]: [u32; 2]) {
        let (max, change) = (u32::from(max), u32::from(max.saturating_sub(100)));
        let ended = Faster {
            max: max as u8,
            periods: max * (change * slope / 100 + 2 * ramp) / 100,
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

/// Control periods in which the speed factor changes by 1, and in which its slope builds up.
pub(super) fn braking_periods(stopping: &Stopping, period_us: u16) -> [u32; 2] {
    let times = [
        stopping.time_ms.saturating_sub(stopping.ramp_ms),
        stopping.ramp_ms,
    ];
    times.map(|time| u32::from(time) * 1000 / u32::from(period_us.max(1)))
}

impl Interpolator {
    /// Sets the feed override, 0 to [`OverrideMode::MAX_PERCENT`] percent of the programmed speed.
    pub fn set_override(&mut self, percent: u8) {
        self.overrides[0] = percent.min(OverrideMode::MAX_PERCENT);
        self.set_override_mode(self.override_mode);
    }

    /// Sets the rapid override, 0 to 100 percent of the programmed speed.
    pub fn set_rapid_override(&mut self, percent: u8) {
        self.overrides[1] = percent.min(100);
        self.set_override_mode(self.override_mode);
    }

    pub(super) fn set_override_mode(&mut self, mode: OverrideMode) {
        self.override_mode = mode;
        let [feed, rapid] = self.overrides;
        self.override_factor = FULL_FACTOR * i64::from(mode.factor(feed, rapid)) / 100;
    }

    /// Whether the motion is in a part of the path in which overrides have no effect.
    #[must_use]
    pub fn is_fixed(&self) -> bool {
        self.override_mode == OverrideMode::FIXED
    }

    /// Begins a part of the path with another override mode.
    #[inline(never)]
    pub(super) fn enter_override_mode(&mut self, mode: OverrideMode) {
        let is_steady = self.speed_factor == Ramp::at(self.override_factor);
        self.set_override_mode(mode);
        // At standstill any speed factor gives the same motion.
        if is_steady && self.from.is_at_standstill() {
            self.speed_factor = Ramp::at(self.override_factor);
        }
    }

    /// At a setpoint at standstill a speed factor above that of the overrides ends: any speed
    /// factor gives the same motion there, and the setpoints behind it need not allow the higher
    /// one.
    pub(super) fn limit_speed_factor(&mut self) {
        if self.speed_factor.value() > self.override_factor {
            self.speed_factor = Ramp::at(self.override_factor);
        }
    }

    /// Maximum speed factor on the segment to the next setpoint, percent of the programmed speed,
    /// 100 to [`OverrideMode::MAX_PERCENT`].
    #[must_use]
    pub fn max_percent(&self) -> u8 {
        self.accepted_modes.max_percent()
    }
}
