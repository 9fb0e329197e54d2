//! The cubic of a segment as a period needs it: words of which a Cortex-M multiplies and adds two in one instruction.
//!
//! With s the fraction of the span, the place is start + ((c3 s + c2) s + c1) s, its rate and acceleration are the derivatives ([`super::cubic`]). The high word of a
//! product with s / 2 is half of what the product with s is, so each coefficient carries a power of two for each s that is still to come.
//!
//! Limits: places differ from the exact cubic by less than 1 axis unit (0.95 nm) for ways below 64 mm, and by a 2^-28th of the largest of way and coefficients
//! beyond; rates and accelerations by a 2^-26th of the largest that occurs in the span. Where the span begins a place is exact.

use super::cubic::{Cubic, Derivatives, FRACTION, Sample, Span};
use crate::drive::reciprocal::high;
use crate::units::scale::{saturate, shift_right};
use crate::units::{Acceleration, Coordinate, Rate};

/// One axis between two setpoints, ready to be sampled.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Way {
    start: Coordinate,
    /// 2 c1, 4 c2, 8 c3; the rate's r1, r2, r3; the acceleration's a1, a2.
    place: [i32; 3],
    rate: [i32; 3],
    push: [i32; 2],
    /// Fractional bits of each, less one.
    drops: [i8; 3],
    /// A rate of 1 m/s, a way of half a metre, or as large an acceleration: some `drops` are no shifts to the right.
    large: bool,
}

/// The two halves of a fraction of a span, 2^-32.
#[must_use]
#[inline]
pub const fn half(fraction: u32) -> i32 {
    (fraction >> 1) as i32
}

impl Way {
    /// Of a cubic of this span.
    #[must_use]
    pub fn new(cubic: &Cubic, span: &Span) -> Self {
        let (start, coefficients) = cubic.parts();
        // Sums of all three stay within a word when each is below 2^30. Shifts lose nothing: coefficients are below 2^53.
        let doubled = [
            coefficients[0] << 1,
            coefficients[1] << 2,
            coefficients[2] << 3,
        ];
        let magnitude = doubled
            .iter()
            .fold(0, |all, value| all | (value ^ (value >> 63)));
        let spare = 64_u32
            .saturating_sub(magnitude.leading_zeros())
            .saturating_sub(30);
        let Derivatives {
            rate,
            rate_fraction,
            push,
            push_fraction,
        } = cubic.derivatives(span);
        let mut way = Self {
            start,
            place: doubled.map(|value| shift_right(value, spare) as i32),
            rate,
            push,
            ..Self::default()
        };
        way.drops = [
            drop(&mut way.place, FRACTION - spare as i32),
            drop(&mut way.rate, rate_fraction),
            drop(&mut way.push, push_fraction),
        ];
        way.large = way.drops.iter().any(|drop| *drop < 0);
        way
    }

    /// Whether the axis stands all the span long.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.place == [0; 3]
    }

    /// Place, rate and acceleration at the [`half`] of a fraction of the span.
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

/// The fractional bits of `words`, less one; what is beyond the range of a shift is taken off the words.
fn drop(words: &mut [i32], fraction: i32) -> i8 {
    let excess = (fraction - 31).clamp(0, 31);
    words.iter_mut().for_each(|word| *word >>= excess);
    (fraction.min(31) - 1) as i8
}

/// `value` / 2^fraction, for a value below 2^31; what a fraction below 0 makes too large is held.
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
