//! Tracking profile generator: a coordinate that follows an unplanned target, such as a master.
//!
//! A [`Tracker`] has a position and a rate, and takes a new target in every control period. Its
//! acceleration is bounded for all targets, and its rate decelerates to its own bound. Rate and
//! acceleration are fed forward; they are not differences of the target. A tracker can start from
//! any position and rate, so a coordinate changes its source in motion without a step.
//!
//! The target passes two stages with time constant 1/k. The first stage smooths it: encoders are
//! quantized, and a remote master is sampled. The second stage commands the rate from which the
//! remaining distance e still suffices to brake: k e near the target, sqrt(2 a e) farther off. A
//! stationary target is therefore reached without overshoot if the stopping distance allows it, and
//! without remaining error.
//!
//! The lag behind a master at rate v is 1/k + 1/k up to v = a'/k, and 1/k + v / 2a' + a' / (2 k^2
//! v) above, where a' is 7/8 of the acceleration. It is 20 ms for k = 100/s and a slow master, and
//! 39 ms at 10 mm/s and 200 mm/s^2.
//!
//! Units as in [`super::jog`]: 2^-20 axis units (per control period).
//! Callers must keep targets within the bounds of the coordinate; [`Tracker::advance`] clamps those
//! beyond.

use super::PoseCommand;
use super::envelope::SLOWED_UTILISATION;
use super::jog::{per_period, slope, slower};
use crate::config::PoseAxis;
use crate::digest::impl_digest;
use haptimill_math::root::Root;
use haptimill_math::scale::{multiply_high, saturate};
use haptimill_math::{Acceleration, Coordinate, Rate};

/// Fraction bits of positions and rates.
const FRACTION: u32 = 20;

/// Bounds of a tracker, computed from those of a pose coordinate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct TrackerLimits {
    /// Largest change of the rate in a control period, and its reciprocal 2^(`whole` + 31) / step,
    /// 2^30 to 2^31. The reciprocal avoids a division in the control period.
    step: i64,
    inverse: u32,
    whole: u32,
    rate: i64,
    /// k T, 2^-32.
    pull: u32,
    /// Distance from which the rate profile is a square root, and distance at which it reaches the
    /// rate limit.
    bend: i64,
    far: i64,
    /// Twice the acceleration of the profile, and half the shift that keeps its product with a
    /// distance within 62 bits.
    twice: i64,
    shift: u32,
    low: i64,
    high: i64,
    wraps: bool,
    periods_per_second: i64,
}

/// State of a coordinate that tracks a target.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tracker {
    place: i64,
    rate: i64,
    /// Change of the rate in the last control period.
    change: i64,
    /// The smoothed target.
    filtered_target: i64,
}

/// Bounds of a tracker up to its standstill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrackerEnvelope {
    /// Lowest position, axis units.
    pub low: i64,
    /// Highest position, axis units.
    pub high: i64,
    /// Largest magnitude of the rate, axis units per second.
    pub rate: i64,
}

impl_digest!(TrackerLimits { fields { step, inverse, whole, rate, pull, bend, far, twice, shift, low, high, wraps, periods_per_second }, nested {}, skip {} });

impl TrackerLimits {
    /// Creates bounds for a gain k of 1 to 1000 1/s; `None` if they are inconsistent.
    #[must_use]
    #[cold]
    pub fn new(axis: &PoseAxis, gain: u16, period_us: u16) -> Option<Self> {
        let step = slope(axis.acceleration, period_us)?;
        let rate = per_period(i64::from(axis.rate.0), period_us);
        if !(8..1 << 41).contains(&step) || rate < 1 || !(1..=1000).contains(&gain) {
            return None;
        }
        // k T, below 2^20 * 2^32 / 10^6.
        let pull = ((u64::from(gain) * u64::from(period_us)) << 32) / 1_000_000;
        if !(1 << 10..1 << 31).contains(&pull) {
            return None;
        }
        let gentle = step * 7 / 8;
        // a' / k T / k T, each quotient below 2^63. The first is limited to 2 mm per control
        // period, which no coordinate reaches.
        let coarse = pull as i64 >> 10;
        let bend = ((((gentle << 22) / coarse).min(1 << 41)) << 22) / coarse.max(1);
        // The root reaches the largest rate v at the distance v^2 / 2 a'; v has 31 bits.
        let spare = (64 - rate.leading_zeros()).saturating_sub(31);
        let whole = rate >> spare;
        let reach = (whole * whole / (2 * gentle)).min(1 << (52 - 2 * spare)) << (2 * spare);
        let far = (reach + bend / 2).max(bend);
        let mut shift = 0;
        while (far >> (2 * shift)) > (1 << 61) / (2 * gentle) {
            shift += 1;
        }
        let whole = 63 - step.leading_zeros();
        let quotient = (1_u64 << 62) / step as u64;
        let inverse = match whole {
            ..=31 => quotient >> (31 - whole),
            _ => quotient << (whole - 31),
        };
        Some(Self {
            step,
            inverse: inverse as u32,
            whole,
            rate,
            pull: pull as u32,
            bend,
            far,
            twice: 2 * gentle,
            shift,
            low: i64::from(axis.low.0) << FRACTION,
            high: i64::from(axis.high.0) << FRACTION,
            wraps: axis.wraps(),
            periods_per_second: 1_000_000 / i64::from(period_us.max(1)),
        })
    }

    /// Largest rate from which the distance still suffices to brake.
    fn profile(&self, gap: i64) -> i64 {
        let distance = gap.abs();
        if distance <= self.bend {
            return multiply_high(gap, self.pull).clamp(-self.rate, self.rate);
        }
        let distance = distance.min(self.far) - self.bend / 2;
        let square = (distance >> (2 * self.shift)).wrapping_mul(self.twice);
        let root = i64::from(Root::of(square as u64).rounded()) << self.shift;
        root.min(self.rate) * gap.signum()
    }

    /// Converts a rate to axis units per second.
    fn per_second(&self, rate: i64) -> i64 {
        (rate * self.periods_per_second) >> FRACTION
    }
}

impl Tracker {
    /// Creates a tracker at a position and a rate.
    #[must_use]
    pub fn at(place: Coordinate, rate: Rate, limits: &TrackerLimits) -> Self {
        let place = i64::from(place.0) << FRACTION;
        Self {
            place,
            rate: (i64::from(rate.0) << FRACTION) / limits.periods_per_second.max(1),
            change: 0,
            filtered_target: place,
        }
    }

    /// Whether the rate is zero.
    #[must_use]
    pub const fn is_at_standstill(&self) -> bool {
        self.rate == 0
    }

    /// The position.
    #[must_use]
    pub fn place(&self) -> Coordinate {
        // Rounded to nearest and clamped to the range of a coordinate.
        Coordinate(saturate((self.place + (1 << (FRACTION - 1))) >> FRACTION))
    }

    /// Upper bound of the stopping distance if it decelerates from now on.
    fn stopping(&self, limits: &TrackerLimits) -> i64 {
        if self.rate == 0 {
            return 0;
        }
        // Both divisions round down, by less than a period each.
        let periods =
            (multiply_high(self.rate.abs(), limits.inverse) >> (limits.whole.max(1) - 1)) + 3;
        self.rate.saturating_mul(periods) / 2
    }

    /// Position at which it comes to standstill if it decelerates from now on.
    #[must_use]
    pub fn standstill_position(&self, limits: &TrackerLimits) -> Coordinate {
        Coordinate(saturate(
            self.place.saturating_add(self.stopping(limits)) >> FRACTION,
        ))
    }

    /// Bounds of position and rate if it continues towards a target for one period (or decelerates
    /// now without one) and decelerates then, given the rate utilisation of the joints in the
    /// period before.
    #[must_use]
    pub fn envelope(
        &self,
        target: Option<Coordinate>,
        utilisation: u32,
        limits: &TrackerLimits,
    ) -> TrackerEnvelope {
        let mut next = *self;
        if target.is_some() {
            next.advance(target, limits);
        }
        let ends = [
            self.place,
            next.place,
            next.place.saturating_add(next.stopping(limits)),
        ];
        let min = ends.iter().fold(i64::MAX, |min, end| min.min(*end));
        let max = ends.iter().fold(i64::MIN, |max, end| max.max(*end));
        if target.is_some() && utilisation > SLOWED_UTILISATION {
            next = *self;
            next.advance_under(target, utilisation, limits);
        }
        TrackerEnvelope {
            low: min >> FRACTION,
            high: (max >> FRACTION) + 1,
            rate: limits.per_second(self.rate.abs().max(next.rate.abs())) + 1,
        }
    }

    /// Advances one control period as [`Tracker::advance`], given the rate utilisation of the
    /// joints in the period before. At a large rate utilisation the rate is limited to what the
    /// joints allow.
    pub fn advance_under(
        &mut self,
        target: Option<Coordinate>,
        utilisation: u32,
        limits: &TrackerLimits,
    ) {
        let slowed = |commanded: i64, rate: i64| {
            // The margin lets a coordinate start from standstill while others move.
            let max = slower(rate.abs(), utilisation) + limits.step / 16;
            commanded.clamp(-max, max)
        };
        self.go(target, limits, |commanded, rate| {
            if utilisation > SLOWED_UTILISATION {
                slowed(commanded, rate)
            } else {
                commanded
            }
        });
    }

    /// Advances one control period: towards a target within the bounds of the coordinate, or to
    /// standstill without one.
    pub fn advance(&mut self, target: Option<Coordinate>, limits: &TrackerLimits) {
        self.go(target, limits, |commanded, _| commanded);
    }

    #[inline]
    fn go(
        &mut self,
        target: Option<Coordinate>,
        limits: &TrackerLimits,
        slowed: impl Fn(i64, i64) -> i64,
    ) {
        let commanded = match target {
            Some(target) => {
                let target = (i64::from(target.0) << FRACTION)
                    .min(limits.high)
                    .max(limits.low);
                self.filtered_target += multiply_high(target - self.filtered_target, limits.pull);
                slowed(limits.profile(self.filtered_target - self.place), self.rate)
            }
            None => 0,
        };
        self.change = (commanded - self.rate).clamp(-limits.step, limits.step);
        self.rate += self.change;
        // The rate at the end of the period is the derivative of the position there, so the
        // distance is the mean of both rates.
        self.place += self.rate - self.change / 2;
        if limits.wraps {
            const ABOVE: u32 = 64 - 32 - FRACTION;
            self.place = (self.place << ABOVE) >> ABOVE;
        }
        if target.is_none() {
            self.filtered_target = self.place;
        }
    }

    /// Writes position, rate and acceleration of the coordinate into `commanded`.
    pub fn write_to(&self, axis: usize, limits: &TrackerLimits, commanded: &mut PoseCommand) {
        commanded.pose.0[axis] = self.place();
        commanded.rates[axis] = Rate(saturate(limits.per_second(self.rate)));
        let acceleration = (limits.per_second(self.change) * limits.periods_per_second) >> 8;
        commanded.accelerations[axis] = Acceleration(saturate(acceleration));
    }
}
