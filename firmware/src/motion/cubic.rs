//! Cubic that joins two setpoints.
//!
//! It is a cubic Hermite polynomial in the fraction `s` of the segment duration. Position, rate and
//! acceleration come from the same polynomial, so the feedforward rate is the exact derivative of
//! the position and never a difference of positions.
//!
//! Limits: a segment lasts at most [`SPAN_MAX_US`] in motion (any time at standstill). The rates at
//! the ends and the mean rate are below 2^31 axis units/s. [`Cubic::new`] returns `None` otherwise.
//! The coefficients are exact up to the rounding of the rates to 2^-16 axis units, and their sum is
//! exactly the distance. A [`SegmentPolynomial`] holds the form for evaluation in every period.

use super::segment::{self, SegmentPolynomial};
use haptimill_math::reciprocal::high;
use haptimill_math::scale::{product, shift_right, total};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::RATE_SHIFT;

/// Longest duration of a segment with motion, microseconds.
pub const SPAN_MAX_US: u32 = 1 << 20;

/// Cubic of one axis between two setpoints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cubic {
    start: Coordinate,
    /// Coefficients of s, s^2, s^3 in 2^-16 axis units; below 2^53 (rates < 2^31 au/s, duration <
    /// 2^20 us, factor 6).
    c1: i64,
    c2: i64,
    c3: i64,
}

/// Derivatives of a [`Cubic`], in words of a common scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Derivatives {
    /// Rate: r1 + r2 s / 2 + r3 s^2 / 4, in 2^-`rate_fraction` axis units per second.
    pub(super) rate: [i32; 3],
    pub(super) rate_fraction: i32,
    /// Acceleration: a1 + a2 s / 2, in 2^-`push_fraction` of its unit.
    pub(super) push: [i32; 2],
    pub(super) push_fraction: i32,
}

/// Fractional bits of the coefficients.
pub(super) const FRACTION: i32 = 16;

/// Segment duration, shared by the cubics of all axes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SegmentDuration {
    periods: u16,
    microseconds: u32,
    /// 2^48 / periods.
    inverse: u64,
    /// 1 / duration in 1/s is `mantissa` * 2^-`exponent`; the mantissa has 31 bits.
    mantissa: i32,
    exponent: u32,
    /// Duration * 2^24 in s is `travel` * 2^-`travel_shift`, with 39 bits. It converts a wire rate
    /// into 2^-16 axis units.
    travel: i64,
    travel_shift: u32,
}

/// State of one axis at a program time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sample {
    /// Position, axis units.
    pub position: Coordinate,
    /// Rate, per second of program time.
    pub rate: Rate,
    /// Acceleration, per second of program time squared.
    pub acceleration: Acceleration,
}

impl SegmentDuration {
    /// Creates a duration of `periods` control periods of `period_us` microseconds; `None` for
    /// zero.
    #[must_use]
    pub fn new(periods: u16, period_us: u16) -> Option<Self> {
        let microseconds = u32::from(periods) * u32::from(period_us);
        if microseconds == 0 {
            return None;
        }
        // 10^6 / microseconds lies between 2^-13 and 2^15.
        let quotient = (1_000_000_u64 << 40) / u64::from(microseconds);
        let excess = 64 - quotient.leading_zeros() - 31;
        // microseconds * 2^24 / 10^6 = microseconds * 2^18 / 15625, with 39 bits: the numerator has
        // at most 53.
        let bits = 32 - microseconds.leading_zeros();
        let numerator = u64::from(microseconds) << (53 - bits);
        Some(Self {
            periods,
            microseconds,
            inverse: (1 << 48) / u64::from(periods),
            mantissa: (quotient >> excess) as i32,
            exponent: 40 - excess,
            travel: (numerator / 15_625) as i64,
            travel_shift: 53 - bits - 18,
        })
    }

    /// Duration in control periods.
    #[must_use]
    pub const fn periods(&self) -> u16 {
        self.periods
    }

    /// Fraction of the duration, 2^-32, at a time in 2^-16 control periods. Times beyond the end
    /// count as just before it.
    #[must_use]
    #[inline]
    pub fn fraction(&self, time: u32) -> u32 {
        let last = (u32::from(self.periods) << 16).wrapping_sub(1);
        (u64::from(time.min(last)).wrapping_mul(self.inverse) >> 32) as u32
    }

    /// Distance, in 2^-16 axis units, at a wire rate (below 2^24 in magnitude) during the segment.
    #[inline]
    fn travel(&self, rate: i32) -> i64 {
        shift_right(product(i64::from(rate), self.travel), self.travel_shift)
    }
}

impl Cubic {
    /// Creates the cubic from (`from`, `from_rate`) to (`to`, `to_rate`), with wire rates. With
    /// `wrap` the axis is rotary and takes the shorter direction. `None` beyond the limits of the
    /// module.
    #[must_use]
    #[inline(always)]
    pub fn new(
        from: Coordinate,
        from_rate: i32,
        to: Coordinate,
        to_rate: i32,
        duration: &SegmentDuration,
        wrap: bool,
    ) -> Option<Self> {
        let distance = if wrap {
            i64::from(to.0.wrapping_sub(from.0))
        } else {
            i64::from(to.0) - i64::from(from.0)
        };
        if distance == 0 && from_rate == 0 && to_rate == 0 {
            return Some(Self {
                start: from,
                ..Self::default()
            });
        }
        let rate_max = 1_u32 << (31 - RATE_SHIFT);
        if duration.microseconds > SPAN_MAX_US
            || from_rate.unsigned_abs() >= rate_max
            || to_rate.unsigned_abs() >= rate_max
            || product(distance.abs(), 1_000_000) >= i64::from(duration.microseconds) << 31
        {
            return None;
        }
        // Both below 2^47 * 2^4: a rate below 2^31 au/s for at most 1.05 s, in 2^-16.
        let (m0, m1, d) = (
            duration.travel(from_rate),
            duration.travel(to_rate),
            distance << 16,
        );
        let sum = total(m0, m1);
        Some(Self {
            start: from,
            c1: m0,
            c2: total(product(3, d), total(m0, sum).wrapping_neg()),
            c3: total(sum, product(-2, d)),
        })
    }

    /// Whether the axis is at standstill for the whole segment.
    #[must_use]
    pub const fn is_at_standstill(&self) -> bool {
        self.c1 == 0 && self.c2 == 0 && self.c3 == 0
    }

    /// Whether the mean rate is within `limit` (wire units, below 2^24).
    #[must_use]
    pub fn keeps_mean_rate(&self, limit: i32, duration: &SegmentDuration) -> bool {
        // The sum of the coefficients is exactly the distance.
        let distance = total(total(self.c1, self.c2), self.c3);
        distance.abs() <= duration.travel(limit)
    }

    /// Whether the rate stays within `limit` (wire units, below 2^24) in the whole segment, given
    /// that it does at both ends. The rate lies within the hull of its ends and the middle control
    /// point c1 + c2. The exact peak is computed only if that point is outside.
    #[must_use]
    pub fn keeps_rate(&self, limit: i32, duration: &SegmentDuration) -> bool {
        let middle = total(self.c1, self.c2).abs();
        middle <= duration.travel(limit) || self.peak_within(limit, duration)
    }

    /// Whether the peak rate, if it lies inside the segment, is within `limit` (wire units).
    #[cold]
    #[inline(never)]
    fn peak_within(&self, limit: i32, duration: &SegmentDuration) -> bool {
        let Some(at) = self.turning(duration) else {
            return true;
        };
        let rate = SegmentPolynomial::new(self, duration)
            .sample(segment::half(at))
            .rate
            .0;
        rate.unsigned_abs() >> RATE_SHIFT <= limit.unsigned_abs()
    }

    /// Fraction of the duration at which the rate has its extremum, if that is inside the segment.
    fn turning(&self, duration: &SegmentDuration) -> Option<u32> {
        // Zero of the acceleration 2 c2 + 6 c3 s; 30 bits of both suffice to find a peak.
        let spare = (64
            - self
                .c2
                .unsigned_abs()
                .max(self.c3.unsigned_abs())
                .leading_zeros())
        .saturating_sub(29);
        let (c2, c3) = (self.c2 >> spare, 3 * (self.c3 >> spare));
        let inside = c3 != 0 && (c2 < 0) != (c3 < 0) && c2.abs() < c3.abs() && duration.periods > 1;
        inside.then(|| ((c2.abs() << 32) / c3.abs()) as u32)
    }

    /// Whether the acceleration stays within a limit. It is largest at an end of the segment.
    #[must_use]
    pub fn keeps_acceleration(&self, limit: Acceleration, duration: &SegmentDuration) -> bool {
        let derivatives = self.derivatives(duration);
        let [begin, growth] = derivatives.push;
        let end = begin.saturating_add(growth >> 1);
        [begin, end].iter().all(|end| {
            let end = segment::shifted(*end, derivatives.push_fraction);
            end.unsigned_abs() <= limit.0.unsigned_abs()
        })
    }

    /// Start, and coefficients of s, s^2, s^3 in 2^-[`FRACTION`] axis units.
    #[inline]
    pub(super) const fn parts(&self) -> (Coordinate, [i64; 3]) {
        (self.start, [self.c1, self.c2, self.c3])
    }

    /// Coefficients of rate and acceleration for evaluation in every period.
    #[inline(always)]
    pub(super) fn derivatives(&self, duration: &SegmentDuration) -> Derivatives {
        // c1, 4 c2, 12 c3 in 31 bits and a sign: r1 = c1 / T, r2 / 2 = 2 c2 / T, r3 / 4 = 3 c3 / T.
        let (c2, c3) = (self.c2 << 2, product(12, self.c3));
        let magnitude = |value: i64| (value ^ (value >> 63)) as u64;
        let all = magnitude(self.c1) | magnitude(c2) | magnitude(c3);
        let spare = (64 - all.leading_zeros()).saturating_sub(31);
        let coarse = |value: i64| high(shift_right(value, spare) as i32, duration.mantissa);
        let (r1, r2, r3) = (coarse(self.c1), coarse(c2), coarse(c3));
        // high() removes 32 bits, the coefficients have 16 fraction bits. Spare is at most 27, the
        // exponent 16 to 53.
        let rate_fraction = duration.exponent as i32 - 16 - spare as i32;
        Derivatives {
            rate: [r1, r2, r3],
            rate_fraction,
            push: [
                high(r2, duration.mantissa) >> 1,
                high(r3, duration.mantissa),
            ],
            // The unit of acceleration is 2^8 axis units.
            push_fraction: rate_fraction + duration.exponent as i32 - 24,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_US: u16 = 200;

    fn sample(cubic: &Cubic, duration: &SegmentDuration, fraction: u32) -> Sample {
        SegmentPolynomial::new(cubic, duration).sample(segment::half(fraction))
    }

    /// Hermite cubic in f64 from its textbook basis, as an independent reference.
    fn hermite(p0: f64, v0: f64, p1: f64, v1: f64, h: f64, t: f64) -> (f64, f64, f64) {
        let s = t / h;
        let (s2, s3) = (s * s, s * s * s);
        let p = (2.0 * s3 - 3.0 * s2 + 1.0) * p0
            + (s3 - 2.0 * s2 + s) * h * v0
            + (-2.0 * s3 + 3.0 * s2) * p1
            + (s3 - s2) * h * v1;
        let v = ((6.0 * s2 - 6.0 * s) * p0 + (6.0 * s - 6.0 * s2) * p1) / h
            + (3.0 * s2 - 4.0 * s + 1.0) * v0
            + (3.0 * s2 - 2.0 * s) * v1;
        let a = ((12.0 * s - 6.0) * p0 + (6.0 - 12.0 * s) * p1) / (h * h)
            + ((6.0 * s - 4.0) * v0 + (6.0 * s - 2.0) * v1) / h;
        (p, v, a)
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn follows_the_real_polynomial(
            p0 in -(1_i32 << 29)..1 << 29, mean in -60.0_f64..60.0, v0 in -240_000_i32..240_000, v1 in -240_000_i32..240_000,
            periods in 1_u16..5000, at in 0.0_f64..1.0,
        ) {
            let duration = SegmentDuration::new(periods, PERIOD_US).expect("span");
            let h = f64::from(periods) * 2e-4;
            let p1 = p0 + (mean * h * f64::from(1 << 20)) as i32;
            let cubic = Cubic::new(Coordinate(p0), v0, Coordinate(p1), v1, &duration, false).expect("in range");
            let time = ((f64::from(periods) * 65536.0 - 1.0) * at) as u32;
            let sample = sample(&cubic, &duration, duration.fraction(time));
            let (p, v, a) = hermite(f64::from(p0), f64::from(v0) * 256.0, f64::from(p1), f64::from(v1) * 256.0, h,
                f64::from(time) / 65536.0 * 2e-4);
            // The time is truncated to 2^-31 of the duration: an error of at most the rate times
            // that. Beyond 64 mm the words are coarser than an axis unit.
            let (m0, m1, d) = (f64::from(v0) * 256.0 * h, f64::from(v1) * 256.0 * h, f64::from(p1) - f64::from(p0));
            let largest = m0.abs().max(2.0 * (3.0 * d - 2.0 * m0 - m1).abs()).max(4.0 * (m0 + m1 - 2.0 * d).abs());
            let slack = 1.0 + 2.0 * (60.0 + 120.0) * f64::from(1 << 20) * h / 2e9 + largest * f64::exp2(-28.0);
            prop_assert!((f64::from(sample.position.0) - p).abs() <= slack, "position {} {p}", sample.position.0);
            // Largest coefficient of the rate. Each rate coefficient has at least 28 bits, each
            // acceleration coefficient 26.
            let (v0, v1, mean) = (f64::from(v0) * 256.0, f64::from(v1) * 256.0, f64::from(p1 - p0) / h);
            let coarse = (12.0 * (v0 + v1 - 2.0 * mean).abs()).max(4.0 * (3.0 * mean - 2.0 * v0 - v1).abs()).max(v0.abs()) * f64::exp2(-28.0);
            prop_assert!((f64::from(sample.rate.0) - v).abs() <= 1.5 + 3.0 * coarse + 6e-5 / h, "rate {} {v}", sample.rate.0);
            if a.abs() / 256.0 < f64::from(i32::MAX) {
                let error = (f64::from(sample.acceleration.0) - a / 256.0).abs();
                prop_assert!(error <= 1.5 + 12.0 * coarse / (256.0 * h) + 1.0 / (256.0 * h) + 2e-6 / (h * h), "acceleration {} {}", sample.acceleration.0, a / 256.0);
            }
        }

        #[test]
        fn no_input_overflows(
            p0: i32, p1: i32, v0: i32, v1: i32, periods: u16, period_us in 50_u16..=1000, time: u32, wrap: bool,
        ) {
            if let Some(duration) = SegmentDuration::new(periods, period_us)
                && let Some(cubic) = Cubic::new(Coordinate(p0), v0, Coordinate(p1), v1, &duration, wrap)
            {
                let _ = sample(&cubic, &duration, duration.fraction(time));
            }
        }

        #[test]
        fn starts_exactly_and_ends_within_a_unit(p0 in -(1_i32 << 28)..1 << 28, d in -100_000_i32..100_000, v in -4000_i32..4000, periods in 10_u16..5000) {
            let duration = SegmentDuration::new(periods, PERIOD_US).expect("span");
            let cubic = Cubic::new(Coordinate(p0), v, Coordinate(p0 + d), v, &duration, false).expect("in range");
            prop_assert_eq!(sample(&cubic, &duration, 0).position, Coordinate(p0));
            let end = sample(&cubic, &duration, u32::MAX).position;
            prop_assert!((end.0 - (p0 + d)).abs() <= 1);
        }
    }

    #[test]
    fn a_rotary_axis_takes_the_short_way() {
        let duration = SegmentDuration::new(5000, PERIOD_US).expect("span");
        let cubic = Cubic::new(
            Coordinate(i32::MAX - 1000),
            0,
            Coordinate(i32::MIN + 1000),
            0,
            &duration,
            true,
        )
        .expect("short");
        let middle = sample(&cubic, &duration, 1 << 31).position;
        assert!(middle.0 > i32::MAX - 10 || middle.0 < i32::MIN + 10);
        assert!(
            Cubic::new(
                Coordinate(i32::MAX),
                0,
                Coordinate(i32::MIN),
                0,
                &duration,
                false
            )
            .is_none()
        );
    }
}
