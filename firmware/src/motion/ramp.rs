//! A value that goes to its target with bounded slope and bounded change of slope.
//!
//! One mechanism for the rate along the path (hold, resume, stop, underrun, override) and for the rate of every jogged axis. All is in
//! the caller's own fixed-point unit per control period; the ramp only adds. A jump of the value, or of its slope, cannot happen:
//! each period the slope changes by at most the jerk of its [`RampLimits`] and is at most their slope.
//!
//! Values must stay below 2^44 and slopes below 2^31 in magnitude; [`RampLimits::new`] refuses limits beyond that.

/// Bounds of a [`Ramp`], per period.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RampLimits {
    slope: i64,
    jerk: i64,
    /// Slope over jerk: periods in which the slope builds up.
    rise: i64,
}

/// A value on its way to a target.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Ramp {
    value: i64,
    slope: i64,
}

/// Slopes that [`RampLimits`] takes are below: twice their square fits 64 bits.
const SLOPE_MAX: i64 = 1 << 31;

/// Largest value that a ramp may be sent to.
pub const VALUE_MAX: i64 = 1 << 44;

impl RampLimits {
    /// Limits of `slope` per period and a change of slope of `jerk` per period; `None` unless 0 < jerk <= slope < 2^31.
    #[must_use]
    pub const fn new(slope: i64, jerk: i64) -> Option<Self> {
        if jerk > 0 && jerk <= slope && slope < SLOPE_MAX {
            let rise = slope / jerk;
            Some(Self { slope, jerk, rise })
        } else {
            None
        }
    }

    /// The most that the value changes in a period.
    #[must_use]
    #[inline]
    pub const fn slope(&self) -> i64 {
        self.slope
    }

    /// What the value still changes, from `slope` on (itself included), while the slope goes to zero.
    fn run_out(&self, slope: i64) -> i64 {
        if slope == 0 {
            return 0;
        }
        let magnitude = slope.abs();
        slope.signum() * (magnitude * (magnitude + self.jerk) / (2 * self.jerk))
    }
}

impl Ramp {
    /// A ramp at rest at `value`.
    #[must_use]
    pub const fn at(value: i64) -> Self {
        Self { value, slope: 0 }
    }

    /// The value.
    #[must_use]
    #[inline]
    pub const fn value(&self) -> i64 {
        self.value
    }

    /// The change of the value in the last period.
    #[must_use]
    pub const fn slope(&self) -> i64 {
        self.slope
    }

    /// Whether the value is zero and stays so.
    #[must_use]
    #[inline]
    pub const fn is_zero(&self) -> bool {
        self.value == 0 && self.slope == 0
    }

    /// One period towards `target`. Gives the mean of the value before and after: what a position gains in the period, so that the value
    /// is the derivative of the position at the period's end.
    #[inline]
    pub fn advance(&mut self, target: i64, limits: &RampLimits) -> i64 {
        if self.slope == 0 && self.value == target {
            return target;
        }
        let before = self.value;
        self.step(target, limits);
        (before + self.value) >> 1
    }

    fn step(&mut self, target: i64, limits: &RampLimits) {
        let target = target.clamp(-VALUE_MAX, VALUE_MAX);
        let gap = target - self.value;
        if gap.abs() <= limits.jerk && self.slope.abs() <= limits.jerk {
            // Near enough to arrive in one period: the change of slope is then at most twice the jerk over two periods.
            let step = gap
                .max(self.slope - limits.jerk)
                .min(self.slope + limits.jerk);
            self.slope = step;
            self.value += step;
            if self.value == target && step.abs() <= limits.jerk {
                self.slope = 0;
            }
            return;
        }
        let low = (self.slope - limits.jerk).max(-limits.slope);
        let high = (self.slope + limits.jerk).min(limits.slope);
        let (run_low, run_high) = (limits.run_out(low), limits.run_out(high));
        self.slope = if run_high <= gap {
            high
        } else if run_low >= gap {
            low
        } else {
            // In between: the slope whose run-out ends at the target, by linear interpolation between the two.
            let span = run_high - run_low;
            low + mul_div(high - low, gap - run_low, span)
        };
        self.value += self.slope;
    }

    /// The largest magnitude that the value has from now on if it goes to zero: a slope away from zero must be undone first, and one that is too steep
    /// carries the value through zero.
    #[must_use]
    pub fn peak(&self, limits: &RampLimits) -> i64 {
        let end = self.value + limits.run_out(self.slope);
        self.value.abs().max(end.abs())
    }

    /// Between which sums of what [`Ramp::advance`] gives the way to rest at zero stays: how far a rate still carries, to either side.
    ///
    /// The first is never above 0, the second never below. A slope too steep to be undone before zero carries the value through to the other
    /// side, so both can differ from 0. `None` where a bound does not fit 63 bits; take that as "too far".
    #[must_use]
    pub fn stopping_range(&self, limits: &RampLimits) -> Option<(i64, i64)> {
        let sign = if self.value == 0 {
            self.slope.signum()
        } else {
            self.value.signum()
        };
        let slope = self.slope * sign;
        let end = self.value * sign + limits.run_out(slope);
        // The part of the slope that still raises the magnitude must be undone first.
        let ahead = if slope > 0 {
            Self::trapezoid(end, slope, limits)?
        } else {
            Self::trapezoid(self.value * sign, 0, limits)?
        };
        let behind = Self::trapezoid(-end, -slope, limits)?;
        Some(if sign < 0 {
            (-ahead, behind)
        } else {
            (-behind, ahead)
        })
    }

    /// The sum of a value that rises to `peak` and falls to zero, at most; 0 when there is no peak.
    fn trapezoid(peak: i64, rising: i64, limits: &RampLimits) -> Option<i64> {
        if peak <= 0 {
            return Some(0);
        }
        // Trapezoid of the slope: its duration is peak / slope + slope / jerk, its mean value is half the peak; four periods for the first half period and rounding.
        let rising = if rising == 0 { 0 } else { rising / limits.jerk };
        let periods = peak / limits.slope + limits.rise + 2 * rising + 4;
        Some(peak.checked_mul(periods)? / 2)
    }
}

/// a * b / c for 0 <= b <= c, without overflow for |a| < 2^32.
fn mul_div(a: i64, b: i64, c: i64) -> i64 {
    let shift = (64 - (c as u64).leading_zeros()).saturating_sub(30);
    a * (b >> shift) / (c >> shift).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits(slope: i64, jerk: i64) -> RampLimits {
        RampLimits::new(slope, jerk).expect("valid limits")
    }

    #[test]
    fn limits_refuse_what_cannot_work() {
        assert!(RampLimits::new(0, 0).is_none());
        assert!(RampLimits::new(10, 0).is_none());
        assert!(RampLimits::new(10, 11).is_none());
        assert!(RampLimits::new(SLOPE_MAX, 1).is_none());
        // As steep as they may be, in one period: nothing overflows.
        let steepest = limits(SLOPE_MAX - 1, SLOPE_MAX - 1);
        assert_eq!(steepest.run_out(SLOPE_MAX - 1), SLOPE_MAX - 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn bounded_slope_and_jerk_whatever_the_targets(
            slope in 1_000_i64..1 << 30,
            ratio in 1_i64..1000,
            targets in prop::collection::vec((-(1_i64 << 38)..1 << 38, 1_usize..400), 1..12),
        ) {
            let limits = limits(slope, (slope / ratio).max(1));
            let mut ramp = Ramp::default();
            for (target, periods) in targets {
                for _ in 0..periods {
                    let before = ramp;
                    ramp.advance(target, &limits);
                    let step = ramp.value() - before.value();
                    prop_assert!(step.abs() <= limits.slope);
                    // The slope as the outside sees it: the difference of values.
                    prop_assert!((step - before.slope).abs() <= limits.jerk, "{step} {before:?} {limits:?}");
                }
            }
        }

        #[test]
        fn arrives_and_does_not_overshoot(slope in 1_000_i64..1 << 28, ratio in 1_i64..500, target in -(1_i64 << 34)..1 << 34) {
            let limits = limits(slope, (slope / ratio).max(1));
            let mut ramp = Ramp::default();
            // Duration of a trapezoidal slope, and some periods for rounding.
            let periods = target.abs() / slope + 2 * ratio + 4 * (1 << 17).min(target.abs() / limits.jerk + 1).min(4 * ratio) + 50;
            for _ in 0..periods {
                ramp.advance(target, &limits);
                let overshoot = (ramp.value() - target) * target.signum();
                prop_assert!(overshoot <= 2 * limits.jerk + target.abs() / 1_000_000, "overshoot {overshoot} {limits:?}");
            }
            prop_assert_eq!(ramp, Ramp::at(target));
        }

        #[test]
        fn stopping_range_is_never_left(
            slope in 10_000_i64..1 << 28, ratio in 2_i64..400,
            targets in prop::collection::vec((-(1_i64 << 33)..1 << 33, 1_usize..2000), 1..4),
        ) {
            let limits = limits(slope, slope / ratio);
            let mut ramp = Ramp::default();
            for (target, periods) in targets {
                for _ in 0..periods {
                    ramp.advance(target, &limits);
                }
            }
            let (low, high) = ramp.stopping_range(&limits).expect("fits");
            prop_assert!(low <= 0 && high >= 0);
            let mut sum = 0_i64;
            for _ in 0..2_000_000 {
                if ramp.is_zero() { break; }
                sum += ramp.advance(0, &limits);
                prop_assert!((low..=high).contains(&sum), "sum {sum} range {low} {high}");
            }
            prop_assert!(ramp.is_zero());
        }
    }
}
