//! Motion of a value to a target with bounded slope and bounded change of slope.
//!
//! The speed factor (hold, resume, stop, underrun, override) and the rate of every jogged axis use
//! it. In each control period the slope changes by at most the jerk of [`RampLimits`] and is at
//! most their slope, so value and slope are continuous.
//!
//! Units: the caller's own fixed-point unit per control period. Values must stay below 2^44 and
//! slopes below 2^31 in magnitude; [`RampLimits::new`] rejects limits beyond that.

/// Bounds of a [`Ramp`], per control period.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RampLimits {
    slope: i64,
    jerk: i64,
    /// Slope divided by jerk: control periods in which the slope builds up.
    rise: i64,
    by_slope: Divisor,
    by_twice_jerk: Divisor,
}

/// A divisor below 2^33 and its inverse: a software division takes some 250 instructions, and a jog
/// of five coordinates has eighty in a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Divisor {
    divisor: u64,
    /// 2^(31 + bits of the divisor) / divisor, 2^31 to 2^32 - 1.
    inverse: u32,
    shift: u32,
}

impl Divisor {
    /// Of 1 and above.
    const fn new(divisor: u64) -> Self {
        let shift = 63 - divisor.leading_zeros();
        // 2^(32 + shift) / divisor, which is above 2^31: of a power of two one less.
        let high = (1 << (31 + shift / 2)) / divisor;
        let rest = (1 << (31 + shift / 2)) % divisor;
        let up = 1 + shift - shift / 2;
        let inverse = (high << up) + (rest << up) / divisor;
        Self {
            divisor,
            inverse: if inverse > u32::MAX as u64 {
                u32::MAX
            } else {
                inverse as u32
            },
            shift,
        }
    }

    /// A lower bound of value / divisor, less by some 2^-31 of it and 2.
    #[inline(always)]
    fn about(&self, value: u64) -> u64 {
        let (value, inverse) = (value >> self.shift, u64::from(self.inverse));
        let low = ((value & 0xFFFF_FFFF) * inverse) >> 32;
        (value >> 32) * inverse + low
    }

    /// The quotient of a magnitude, rounded down.
    #[inline(never)]
    fn quotient(&self, value: i64) -> i64 {
        let value = value.unsigned_abs();
        let mut quotient = self.about(value);
        let mut rest = value - quotient * self.divisor;
        let more = self.about(rest);
        quotient += more;
        rest -= more * self.divisor;
        while rest >= self.divisor {
            rest -= self.divisor;
            quotient += 1;
        }
        quotient as i64
    }
}

/// Value that moves to a target.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Ramp {
    value: i64,
    slope: i64,
}

/// Upper bound of the slopes of [`RampLimits`], exclusive: twice their square fits 64 bits.
const SLOPE_MAX: i64 = 1 << 31;

/// Largest target of a ramp.
pub const VALUE_MAX: i64 = 1 << 44;

impl RampLimits {
    /// Creates limits of `slope` per control period, with a change of slope of `jerk` per control
    /// period; `None` unless 0 < jerk <= slope < 2^31.
    #[must_use]
    pub const fn new(slope: i64, jerk: i64) -> Option<Self> {
        if jerk > 0 && jerk <= slope && slope < SLOPE_MAX {
            let rise = slope / jerk;
            Some(Self {
                slope,
                jerk,
                rise,
                by_slope: Divisor::new(slope as u64),
                by_twice_jerk: Divisor::new(2 * jerk as u64),
            })
        } else {
            None
        }
    }

    /// Largest change of the value in a control period.
    #[must_use]
    #[inline]
    pub const fn slope(&self) -> i64 {
        self.slope
    }

    /// Change of the value while the slope goes from `slope` to zero, `slope` included.
    fn run_out(&self, slope: i64) -> i64 {
        if slope == 0 {
            return 0;
        }
        // Slope and jerk are below 2^31: words, whose product needs no overflow check.
        let magnitude = slope.unsigned_abs() as u32;
        let twice = u64::from(magnitude) * u64::from(magnitude + self.jerk as u32);
        let run_out = self.by_twice_jerk.quotient(twice as i64);
        if slope < 0 { -run_out } else { run_out }
    }
}

impl Ramp {
    /// Creates a ramp at standstill at `value`.
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

    /// Change of the value in the last control period.
    #[must_use]
    pub const fn slope(&self) -> i64 {
        self.slope
    }

    /// Whether the value is zero and remains zero.
    #[must_use]
    #[inline]
    pub const fn is_zero(&self) -> bool {
        self.value == 0 && self.slope == 0
    }

    /// Advances one control period towards `target`. Returns the mean of the value before and
    /// after. A position that adds this mean has the value as its derivative at the end of the
    /// period.
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
            // The target is within reach of one period: the slope then changes by at most twice the
            // jerk over two periods.
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
            // Between the two: interpolate linearly the slope whose run-out ends at the target.
            let span = run_high - run_low;
            low + mul_div(high - low, gap - run_low, span)
        };
        self.value += self.slope;
    }

    /// Largest magnitude of the value from now on, if it goes to zero. A slope away from zero must
    /// first be undone, and a slope that is too steep carries the value through zero.
    #[must_use]
    pub fn peak(&self, limits: &RampLimits) -> i64 {
        let end = self.value + limits.run_out(self.slope);
        self.value.abs().max(end.abs())
    }

    /// Bounds of the sum of the results of [`Ramp::advance`] while the value goes to zero: the
    /// stopping distance to either side.
    ///
    /// The first bound is at most 0, the second at least 0. A slope too steep to be undone before
    /// zero carries the value to the other side, so both can differ from 0. `None` if a bound does
    /// not fit 63 bits; callers must treat that as too far.
    #[must_use]
    #[inline]
    pub fn stopping_range(&self, limits: &RampLimits) -> Option<(i64, i64)> {
        let (low, high, _) = self.stopping_bounds(limits)?;
        Some((low, high))
    }

    /// [`Ramp::stopping_range`] and [`Ramp::peak`] together.
    #[must_use]
    pub fn stopping_bounds(&self, limits: &RampLimits) -> Option<(i64, i64, i64)> {
        let negative = self.value < 0 || (self.value == 0 && self.slope < 0);
        let (value, slope) = if negative {
            (-self.value, -self.slope)
        } else {
            (self.value, self.slope)
        };
        let end = value + limits.run_out(slope);
        // The part of the slope that raises the magnitude must be undone first.
        let ahead = if slope > 0 {
            Self::trapezoid(end, slope, limits)?
        } else {
            Self::trapezoid(value, 0, limits)?
        };
        let behind = Self::trapezoid(-end, -slope, limits)?;
        let peak = value.max(end.abs());
        Some(if negative {
            (-ahead, behind, peak)
        } else {
            (-behind, ahead, peak)
        })
    }

    /// Upper bound of the sum of a value that rises to `peak` and falls to zero; 0 without a peak.
    fn trapezoid(peak: i64, rising: i64, limits: &RampLimits) -> Option<i64> {
        if peak <= 0 {
            return Some(0);
        }
        // Trapezoid of the slope: its duration is peak / slope + slope / jerk, its mean value is
        // half the peak; four periods for the first half period and rounding.
        let rising = if rising == 0 {
            0
        } else {
            limits.by_twice_jerk.quotient(2 * rising) * rising.signum()
        };
        let periods = limits.by_slope.quotient(peak) + limits.rise + 2 * rising + 4;
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
        // The steepest limits, reached in one period, do not overflow.
        let steepest = limits(SLOPE_MAX - 1, SLOPE_MAX - 1);
        assert_eq!(steepest.run_out(SLOPE_MAX - 1), SLOPE_MAX - 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_quotient_is_exact(value in 0..i64::MAX, down in 0_u32..63, divisor in 1_u64..1 << 33, less in 0_u32..33) {
            let (value, divisor) = (value >> down, (divisor >> less).max(1));
            for value in [value, value - value % divisor as i64, i64::MAX] {
                prop_assert_eq!(Divisor::new(divisor).quotient(value), value / divisor as i64);
            }
            let power = divisor.next_power_of_two();
            prop_assert_eq!(Divisor::new(power).quotient(value), value / power as i64);
        }
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
                    // The observable slope: the difference of values.
                    prop_assert!((step - before.slope).abs() <= limits.jerk, "{step} {before:?} {limits:?}");
                }
            }
        }

        #[test]
        fn arrives_and_does_not_overshoot(slope in 1_000_i64..1 << 28, ratio in 1_i64..500, target in -(1_i64 << 34)..1 << 34) {
            let limits = limits(slope, (slope / ratio).max(1));
            let mut ramp = Ramp::default();
            // Duration of a trapezoidal slope, plus some periods for rounding.
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
