//! Times of the pulses that the controller commanded.

use crate::NANOSECOND;
use haptimill_firmware::io::StepSegment;

/// Step clock of a board and length of its control period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Ticks of the step clock per microsecond, 1 to 1000.
    pub ticks_per_us: u32,
    /// Control period, in us.
    pub period_us: u32,
}

impl Clock {
    /// Time of a number of ticks, fs, rounded down by less than 1 fs.
    #[must_use]
    pub fn femtoseconds(self, ticks: i64) -> i64 {
        let fs = i128::from(ticks) * i128::from(1000 * NANOSECOND)
            / i128::from(self.ticks_per_us.max(1));
        fs as i64
    }

    /// Ticks of a time in fs, rounded to the nearest.
    #[must_use]
    pub fn nearest_tick(self, time: i64) -> i64 {
        let microsecond = i128::from(1000 * NANOSECOND);
        let scaled = i128::from(time) * i128::from(self.ticks_per_us.max(1));
        ((scaled + microsecond / 2).div_euclid(microsecond)) as i64
    }

    /// Ticks of a control period.
    #[must_use]
    pub fn period_ticks(self) -> i64 {
        i64::from(self.ticks_per_us) * i64::from(self.period_us)
    }
}

/// Segment of a joint in a control period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Planned {
    /// Control period in which the pulses leave: the one after that which computed them.
    pub period: u64,
    /// The pulses.
    pub segment: StepSegment,
}

/// A pulse that was commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// Ticks of the step clock from the start of control period 0 to the rising edge.
    pub tick: i64,
    /// The direction line is high.
    pub up: bool,
    /// Control period in which it leaves.
    pub period: u64,
}

/// All pulses of some segments, in their order.
#[must_use]
pub fn pulses(planned: &[Planned], clock: Clock) -> Vec<Pulse> {
    let mut pulses = Vec::new();
    for Planned { period, segment } in planned {
        let start = clock.period_ticks() * i64::try_from(*period).unwrap_or(i64::MAX / 1_000_000);
        let up = segment.count > 0;
        for k in 0..i64::from(segment.count.unsigned_abs()) {
            let tick = start
                + i64::from(segment.delay)
                + k * i64::from(segment.interval)
                + i64::from(segment.ramp) * (k * (k - 1) / 2);
            pulses.push(Pulse {
                tick,
                up,
                period: *period,
            });
        }
    }
    pulses
}
