//! The cubic that joins two setpoints.
//!
//! A cubic Hermite in the fraction `s` of its span: position, rate and acceleration come from the same polynomial, so the rate that is fed
//! forward is the derivative of the position that is followed, never a difference of positions.
//!
//! Limits: a span lasts at most [`SPAN_MAX_US`] while anything moves (any time at rest); rates at the ends and the mean rate are below
//! 2^31 axis units/s. [`Cubic::new`] returns `None` otherwise. Positions are exact at both ends; in between they differ from the real
//! polynomial by less than 1 axis unit (0.95 nm), held by a test.

use crate::units::scale::{product, total};
use crate::units::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::RATE_SHIFT;

/// Longest span of a segment in which something moves, microseconds.
pub const SPAN_MAX_US: u32 = 1 << 20;

/// One axis between two setpoints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cubic {
    start: Coordinate,
    /// Coefficients of s, s^2, s^3 in 2^-16 axis units.
    c1: i64,
    c2: i64,
    c3: i64,
}

/// The span of time that the cubics of all axes share.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Span {
    periods: u16,
    /// 2^48 / periods.
    inverse: u64,
    /// 1 / span in 1/s is `mantissa` * 2^-`exponent`; the mantissa has 31 bits.
    mantissa: i64,
    exponent: u32,
}

/// Where one axis is at a time, in program time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sample {
    /// Position.
    pub position: Coordinate,
    /// Rate per second of program time.
    pub rate: Rate,
    /// Acceleration per second of program time squared.
    pub acceleration: Acceleration,
}

impl Span {
    /// A span of so many periods.
    #[must_use]
    pub fn new(periods: u16, period_us: u16) -> Option<Self> {
        let microseconds = u32::from(periods) * u32::from(period_us);
        if microseconds == 0 {
            return None;
        }
        // 10^6 / microseconds lies between 2^-7 and 2^15.
        let quotient = (1_000_000_u64 << 40) / u64::from(microseconds);
        let excess = 64 - quotient.leading_zeros() - 31;
        Some(Self {
            periods,
            inverse: (1 << 48) / u64::from(periods),
            mantissa: (quotient >> excess) as i64,
            exponent: 40 - excess,
        })
    }

    /// Length in periods.
    #[must_use]
    pub const fn periods(&self) -> u16 {
        self.periods
    }

    /// Fraction of the span, 2^-32, at a time in 2^-16 periods; times beyond the end count as just before it.
    #[must_use]
    pub fn fraction(&self, time: u32) -> u32 {
        let last = (u32::from(self.periods) << 16).wrapping_sub(1);
        ((u64::from(time.min(last)) * self.inverse) >> 32) as u32
    }
}

impl Cubic {
    /// The cubic from (`from`, `from_rate`) to (`to`, `to_rate`), rates as on the wire. `wrap`: the axis is rotary and takes the short way.
    #[must_use]
    pub fn new(
        from: Coordinate,
        from_rate: i32,
        to: Coordinate,
        to_rate: i32,
        span: &Span,
        period_us: u16,
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
        let microseconds = u32::from(span.periods) * u32::from(period_us);
        let rate_max = 1_i64 << (31 - RATE_SHIFT);
        if microseconds > SPAN_MAX_US
            || i64::from(from_rate).abs() >= rate_max
            || i64::from(to_rate).abs() >= rate_max
            || distance.abs() * 1_000_000 >= i64::from(microseconds) << 31
        {
            return None;
        }
        // rate (256 au/s) * span (us) * 256 / 10^6 * 2^16 = rate * span * 2^18 / 15625; the product is below 2^61.
        let travel = |rate: i32| i64::from(rate) * i64::from(microseconds) * (1 << 18) / 15_625;
        let (m0, m1, d) = (travel(from_rate), travel(to_rate), distance << 16);
        Some(Self {
            start: from,
            c1: m0,
            c2: 3 * d - 2 * m0 - m1,
            c3: m0 + m1 - 2 * d,
        })
    }

    /// Whether the axis stands all the span long.
    #[must_use]
    pub const fn is_still(&self) -> bool {
        self.c1 == 0 && self.c2 == 0 && self.c3 == 0
    }

    /// Accelerations at the beginning and at the end of the span.
    #[must_use]
    pub fn end_accelerations(&self, span: &Span) -> [Acceleration; 2] {
        [2 * self.c2, 2 * self.c2 + 6 * self.c3].map(|value| Self::acceleration(value, span))
    }

    /// A second derivative by the fraction of the span, in 2^-16 axis units, as an acceleration.
    fn acceleration(value: i64, span: &Span) -> Acceleration {
        // Times the span, in axis units per second; bounded so that it can be divided by the span once more.
        let speed = per_second(value, span).clamp(-(1 << 33), 1 << 33);
        Acceleration(clamp(per_second(speed << 16, span) >> 8))
    }

    /// The fraction of the span at which the rate is largest or least, if that is inside.
    #[must_use]
    pub fn turning(&self, span: &Span) -> Option<u32> {
        // Where the acceleration 2 c2 + 6 c3 s is zero; 30 bits of both are plenty to look for a peak.
        let spare = (64
            - self
                .c2
                .unsigned_abs()
                .max(self.c3.unsigned_abs())
                .leading_zeros())
        .saturating_sub(29);
        let (c2, c3) = (self.c2 >> spare, 3 * (self.c3 >> spare));
        let inside = c3 != 0 && (c2 < 0) != (c3 < 0) && c2.abs() < c3.abs() && span.periods > 1;
        inside.then(|| ((c2.abs() << 32) / c3.abs()) as u32)
    }

    /// Position, rate and acceleration at a fraction of the span.
    #[must_use]
    pub fn sample(&self, fraction: u32, span: &Span) -> Sample {
        // |c| < 2^53 (rates < 2^31 au/s, span < 2^20 us, factor 6): no sum or product below leaves 64 bits.
        let c3s = scale(self.c3, fraction);
        let bend = total(self.c2, c3s);
        let position = scale(total(self.c1, scale(bend, fraction)), fraction);
        // 2 c2 + 3 c3 s, and 2 c2 + 6 c3 s.
        let steep = total(total(bend, bend), c3s);
        let rate = total(self.c1, scale(steep, fraction));
        let acceleration = total(steep, product(3, c3s));
        let position = (total(position, 1 << 15) >> 16) as i32;
        Sample {
            position: Coordinate(self.start.0.wrapping_add(position)),
            rate: Rate(clamp(per_second(rate, span))),
            acceleration: Self::acceleration(acceleration, span),
        }
    }
}

/// x * s / 2^32.
fn scale(x: i64, s: u32) -> i64 {
    let (high, low) = (x >> 32, x & 0xFFFF_FFFF);
    total(
        product(high, i64::from(s)),
        ((low as u64 * u64::from(s)) >> 32) as i64,
    )
}

/// 2^-16 axis units per span -> axis units per second, to 30 bits.
fn per_second(x: i64, span: &Span) -> i64 {
    let spare = (64 - x.unsigned_abs().leading_zeros()).saturating_sub(32);
    // 32 bits and a sign times 31 bits. The exponent is at least 25 and `spare` at most 32, so the shift is 9 to 63.
    let shift = span.exponent.wrapping_add(16).wrapping_sub(spare);
    product(x >> spare, span.mantissa).wrapping_shr(shift)
}

fn clamp(x: i64) -> i32 {
    x.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_US: u16 = 200;

    /// The Hermite cubic in f64, from its textbook basis: an independent truth.
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
            let span = Span::new(periods, PERIOD_US).expect("span");
            let h = f64::from(periods) * 2e-4;
            let p1 = p0 + (mean * h * f64::from(1 << 20)) as i32;
            let cubic = Cubic::new(Coordinate(p0), v0, Coordinate(p1), v1, &span, PERIOD_US, false).expect("in range");
            let time = ((f64::from(periods) * 65536.0 - 1.0) * at) as u32;
            let sample = cubic.sample(span.fraction(time), &span);
            let (p, v, a) = hermite(f64::from(p0), f64::from(v0) * 256.0, f64::from(p1), f64::from(v1) * 256.0, h,
                f64::from(time) / 65536.0 * 2e-4);
            // The time itself is cut to 2^-32 of the span: at most the speed times that.
            let slack = 1.0 + 2.0 * (60.0 + 120.0) * f64::from(1 << 20) * h / 4e9;
            prop_assert!((f64::from(sample.position.0) - p).abs() <= slack, "position {} {p}", sample.position.0);
            prop_assert!((f64::from(sample.rate.0) - v).abs() <= 2.0 + 1e-8 * v.abs() + 6e-5 / h, "rate {} {v}", sample.rate.0);
            if a.abs() / 256.0 < f64::from(i32::MAX) {
                let error = (f64::from(sample.acceleration.0) - a / 256.0).abs();
                prop_assert!(error <= 2.0 + 1e-8 * (a / 256.0).abs() + 1.0 / (256.0 * h) + 2e-6 / (h * h), "acceleration {} {}", sample.acceleration.0, a / 256.0);
            }
        }

        #[test]
        fn no_input_overflows(
            p0: i32, p1: i32, v0: i32, v1: i32, periods: u16, period_us in 50_u16..=1000, time: u32, wrap: bool,
        ) {
            if let Some(span) = Span::new(periods, period_us)
                && let Some(cubic) = Cubic::new(Coordinate(p0), v0, Coordinate(p1), v1, &span, period_us, wrap)
            {
                let _ = cubic.sample(span.fraction(time), &span);
            }
        }

        #[test]
        fn starts_exactly_and_ends_within_a_unit(p0 in -(1_i32 << 28)..1 << 28, d in -100_000_i32..100_000, v in -4000_i32..4000, periods in 10_u16..5000) {
            let span = Span::new(periods, PERIOD_US).expect("span");
            let cubic = Cubic::new(Coordinate(p0), v, Coordinate(p0 + d), v, &span, PERIOD_US, false).expect("in range");
            prop_assert_eq!(cubic.sample(0, &span).position, Coordinate(p0));
            let end = cubic.sample(u32::MAX, &span).position;
            prop_assert!((end.0 - (p0 + d)).abs() <= 1);
        }
    }

    #[test]
    fn a_rotary_axis_takes_the_short_way() {
        let span = Span::new(5000, PERIOD_US).expect("span");
        let cubic = Cubic::new(
            Coordinate(i32::MAX - 1000),
            0,
            Coordinate(i32::MIN + 1000),
            0,
            &span,
            PERIOD_US,
            true,
        )
        .expect("short");
        let middle = cubic.sample(1 << 31, &span).position;
        assert!(middle.0 > i32::MAX - 10 || middle.0 < i32::MIN + 10);
        assert!(
            Cubic::new(
                Coordinate(i32::MAX),
                0,
                Coordinate(i32::MIN),
                0,
                &span,
                PERIOD_US,
                false
            )
            .is_none()
        );
    }
}
