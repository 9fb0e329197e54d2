//! Segment polynomial for evaluation in every control period. It uses words that a Cortex-M
//! multiplies and adds in one instruction.
//!
//! With s the fraction of the segment duration, the position is start + ((c3 s + c2) s + c1) s;
//! rate and acceleration are its derivatives ([`super::cubic`]). The high word of a product with s
//! / 2 is half of the product with s, so each coefficient is scaled by two for each remaining
//! factor s.
//!
//! Limits: positions differ from the exact cubic by less than 1 axis unit (0.95 nm) for distances
//! below 64 mm, and beyond by 2^-28 of the largest of distance and coefficients. Rates and
//! accelerations differ by 2^-26 of the largest value in the segment. The position at the start of
//! the segment is exact.

use super::cubic::{Cubic, Derivatives, FRACTION, Sample, SegmentDuration};
use haptimill_math::reciprocal::high;
use haptimill_math::scale::{saturate, shift_right};
use haptimill_math::{Acceleration, Coordinate, Rate};

/// Polynomial of one axis between two setpoints, ready for evaluation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SegmentPolynomial {
    start: Coordinate,
    /// Position: 2 c1, 4 c2, 8 c3. Rate: r1, r2, r3. Acceleration: a1, a2.
    place: [i32; 3],
    rate: [i32; 3],
    push: [i32; 2],
    /// Fractional bits of each, minus one.
    drops: [i8; 3],
    /// A rate of 1 m/s, a distance of 0.5 m or a similarly large acceleration occurs: some `drops`
    /// are not right shifts.
    large: bool,
}

/// Half of a fraction of a segment duration; the fraction is in 2^-32.
#[must_use]
#[inline]
pub const fn half(fraction: u32) -> i32 {
    (fraction >> 1) as i32
}

impl SegmentPolynomial {
    /// Creates the polynomial of a cubic with this duration.
    #[must_use]
    pub fn new(cubic: &Cubic, duration: &SegmentDuration) -> Self {
        let mut way = Self::default();
        way.set(cubic, duration);
        way
    }

    /// Sets the polynomial of a cubic with this duration, in place.
    #[inline(always)]
    pub fn set(&mut self, cubic: &Cubic, duration: &SegmentDuration) {
        let (start, [c1, c2, c3]) = cubic.parts();
        self.start = start;
        // Sums of all three coefficients fit a word if each is below 2^30. The shifts lose nothing,
        // because coefficients are below 2^53.
        let [c1, c2, c3] = [c1 << 1, c2 << 2, c3 << 3];
        let size = |value: i64| value ^ (value >> 63);
        let spare = 64_u32
            .saturating_sub((size(c1) | size(c2) | size(c3)).leading_zeros())
            .saturating_sub(30);
        let Derivatives {
            rate,
            rate_fraction,
            push,
            push_fraction,
        } = cubic.derivatives(duration);
        self.place = [
            shift_right(c1, spare) as i32,
            shift_right(c2, spare) as i32,
            shift_right(c3, spare) as i32,
        ];
        self.rate = rate;
        self.push = push;
        let (first, second, third) = (FRACTION - spare as i32, rate_fraction, push_fraction);
        if first | second | third > 31 {
            self.take_off([first, second, third]);
        }
        let drop = |fraction: i32| (fraction.min(31) - 1) as i8;
        self.drops = [drop(first), drop(second), drop(third)];
        self.large = first <= 0 || second <= 0 || third <= 0;
    }

    /// Shifts the words right by the bits that exceed the range of a shift.
    #[inline(never)]
    fn take_off(&mut self, fractions: [i32; 3]) {
        let words: [&mut [i32]; 3] = [&mut self.place, &mut self.rate, &mut self.push];
        for (words, fraction) in words.into_iter().zip(fractions) {
            let excess = (fraction - 31).clamp(0, 31);
            words.iter_mut().for_each(|word| *word >>= excess);
        }
    }

    /// Whether the axis is at standstill for the whole segment.
    #[must_use]
    pub fn is_at_standstill(&self) -> bool {
        self.place == [0; 3]
    }

    /// Position, rate and acceleration at the [`half`] of a fraction of the segment duration.
    #[must_use]
    #[inline]
    pub fn sample(&self, half: i32) -> Sample {
        let [c1, c2, c3] = self.place;
        let way = high(
            c1.wrapping_add(high(c2.wrapping_add(high(c3, half)), half)),
            half,
        );
        let [r1, r2, r3] = self.rate;
        let rate = r1.wrapping_add(high(r2.wrapping_add(high(r3, half)), half));
        let [a1, a2] = self.push;
        let push = a1.wrapping_add(high(a2, half));
        let values = [way, rate, push];
        let [way, rate, push] = if self.large {
            self.round_large(values)
        } else {
            // To nearest.
            let [way, rate, push] = values;
            let [first, second, third] = self.drops;
            let round =
                |value: i32, drop: i8| (value.wrapping_shr(drop as u32).wrapping_add(1)) >> 1;
            [round(way, first), round(rate, second), round(push, third)]
        };
        Sample {
            position: Coordinate(self.start.0.wrapping_add(way)),
            rate: Rate(rate),
            acceleration: Acceleration(push),
        }
    }

    #[cold]
    #[inline(never)]
    fn round_large(&self, values: [i32; 3]) -> [i32; 3] {
        let mut rounded = values;
        for (value, drop) in rounded.iter_mut().zip(self.drops) {
            *value = shifted(*value, i32::from(drop) + 1);
        }
        rounded
    }
}

/// `value` / 2^fraction, for a value below 2^31. Results beyond the range are clamped (fraction
/// below 0).
pub(super) fn shifted(value: i32, fraction: i32) -> i32 {
    if (1..32).contains(&fraction) {
        // To nearest.
        (value.wrapping_shr(fraction as u32 - 1).wrapping_add(1)) >> 1
    } else if fraction <= 0 {
        saturate(i64::from(value) << fraction.unsigned_abs().min(31)).max(-i32::MAX)
    } else {
        0
    }
}
