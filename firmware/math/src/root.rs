//! Square roots and reciprocals of integers, by a table and Newton's method, without division.
//!
//! | function | result | error |
//! | --- | --- | --- |
//! | [`isqrt`] | whole part of the square root of a `u64` | exact |
//! | [`sqrt_rounded`] | nearest whole number to it | exact (at most 0.5; saturates at `u32::MAX`) |
//! | [`hypot`] | length of the hypotenuse of two `i32` | at most 0.5 |
//! | [`Root`] | root with extra bits, and its reciprocal | relative 2^-30.5, 2^-29.5 |
//! | [`reciprocal`] | reciprocal of a `u32` with its top bit set | relative 2^-31 |
//!
//! Cost: about seven multiplications 32 x 32 -> 64. The start value has 9 correct bits (a table of
//! 384 16-bit numbers). One step gives 17 bits, and the last step uses the remainder of the 64-bit
//! number and gives all 32.

use super::scale::{product, shift_left};

/// 1 / (2 sqrt(v)) in Q16 for v = (i + 1/2) / 512; v runs from 1/4 (i = 128) to 1. The entries
/// below are never read; they avoid the bounds check.
static RECIPROCAL_ROOT: [u16; 512] = reciprocal_roots();

const fn reciprocal_roots() -> [u16; 512] {
    let mut table = [u16::MAX; 512];
    let mut i = 128;
    while i < table.len() {
        // z = 1 / (2 sqrt(v)), 2 z * 2^16 = sqrt(2^32 / v) = sqrt(2^42 / (2 i + 1)); the halving
        // rounds.
        let twice = ((1u64 << 42) / (2 * i as u64 + 1)).isqrt();
        table[i] = twice.div_ceil(2) as u16;
        i += 1;
    }
    table
}

/// The square root of a positive integer as a scaled mantissa: `root = mantissa / 2^shift`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Root {
    /// From 2^31 to 2^32 - 1.
    mantissa: u32,
    /// Q31 of 2^31 / mantissa after one Newton step: 17 correct bits, never too large. Its last
    /// five bits are not significant and hold the number of fractional bits of the mantissa. Two
    /// 32-bit fields are returned in registers, three are not.
    rough_and_shift: u32,
}

/// Mask of the bits that hold the shift of a [`Root`].
const SHIFT: u32 = 31;

impl Root {
    /// The root of `square`; 0 counts as 1.
    #[inline]
    #[must_use]
    pub const fn of(square: u64) -> Self {
        let zeros = (square | 1).leading_zeros() & !1;
        let scaled = shift_left(square, zeros);
        let high = scaled >> 32;
        // v = high / 2^32 is 1/4 to 1: the mask cuts nothing.
        let start = RECIPROCAL_ROOT[(high >> 23) as usize & 511] as u64;
        // z (3/2 - 2 v z^2), z = 1 / (2 sqrt v) in Q16; the result in Q31. v z^2 is 1/4 within
        // 2^-8, so every value fits. The wrapping operations here and below never wrap; they avoid
        // the check. The 2 covers what the two truncations could make too large, so that the root
        // is approached from below.
        let quarter = (high.wrapping_mul(start * start) >> 32) + 2;
        let rough = start.wrapping_mul((3u64 << 30).wrapping_sub(quarter)) >> 16;
        // Below the root, because Newton's method for the reciprocal root converges from below.
        let first = high.wrapping_mul(rough) >> 30;
        let remainder = scaled.wrapping_sub(first.wrapping_mul(first));
        // remainder / (2 root) with the remainder below 2^49.
        let step = (remainder >> 17).wrapping_mul(rough) >> 46;
        Self {
            mantissa: first.wrapping_add(step) as u32,
            rough_and_shift: (rough as u32 & !SHIFT) | (zeros / 2),
        }
    }

    /// The root to the nearest whole number, for squares up to (2^31 - 1)^2 (`i32::MAX` above).
    /// Error at most 0.5 + 2^-31 of the root.
    #[inline]
    #[must_use]
    pub const fn rounded(self) -> i32 {
        // The half bit is added after the shift. With a shift of 0 it is wrong, but then the root
        // is 2^31 or more and saturates.
        let shift = self.shift();
        let half = self.mantissa.wrapping_shr(shift.wrapping_sub(1)) & 1;
        let whole = self.mantissa >> shift;
        if whole >= i32::MAX as u32 {
            i32::MAX
        } else {
            whole.wrapping_add(half) as i32
        }
    }

    /// Fractional bits of the mantissa.
    #[inline(always)]
    const fn shift(self) -> u32 {
        self.rough_and_shift & SHIFT
    }

    /// The reciprocal of the root.
    #[inline]
    #[must_use]
    pub const fn reciprocal(self) -> Reciprocal {
        // z + z (1 - root / root0): one more Newton step for the reciprocal, from 17 bits to 31.
        let rough = self.rough_and_shift & !SHIFT;
        let one = self.mantissa as u64 * rough as u64;
        // It is 2^62 (1 - error), error from 0 to 2^-16 (or slightly below 0).
        let error = (1i64 << 62).wrapping_sub(one as i64);
        // Below 2^17 * 2^32.
        let correction = product(error >> 30, rough as i64) >> 32;
        Reciprocal {
            mantissa: (rough as i64).wrapping_add(correction) as u32,
            shift: 62 - self.shift(),
        }
    }
}

/// The reciprocal of a [`Root`]: `mantissa / 2^shift`, relative error below 2^-29.5.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reciprocal {
    /// From 2^30 - 4 to 2^31.
    pub mantissa: u32,
    /// From 31 to 62.
    pub shift: u32,
}

/// 1 / v in Q16 for v = (i + 256.5) / 512, i = 0..256: v runs from 1/2 to 1.
static RECIPROCAL: [u32; 256] = reciprocals();

const fn reciprocals() -> [u32; 256] {
    let mut table = [0; 256];
    let mut i = 0;
    while i < table.len() {
        table[i] = (1 << 26) / (2 * i as u32 + 513);
        i += 1;
    }
    table
}

/// 1 / d in Q31, for d in Q32 from 1/2 to 1. Relative error below 2^-31; the result 2 saturates at
/// `u32::MAX`.
///
/// Callers must pass a `value` with its top bit set; the result is meaningless otherwise, without a
/// panic. The function makes two Newton steps: 9, 18, 31 bits.
#[inline]
#[must_use]
pub const fn reciprocal(value: u32) -> u32 {
    // The start belongs to the middle of a cell, so the first step stays below 2. Casts to u32 cut
    // nothing. They tell the compiler that a product has two 32-bit factors, which needs no check
    // and is one instruction.
    let start = RECIPROCAL[((value >> 23) & 255) as usize] as u64;
    let error = (1u64 << 49).wrapping_sub(value as u64 * start);
    let second = start.wrapping_mul((error >> 17) as u32 as u64) >> 16;
    let error = (value as u64 * second as u32 as u64).wrapping_neg();
    let error = (error.wrapping_add(1 << 31) >> 32) as u32;
    let third = (second as u32 as u64 * error as u64 + (1 << 30)) >> 31;
    if third > u32::MAX as u64 {
        u32::MAX
    } else {
        third as u32
    }
}

/// Whole part of the square root, exact.
#[must_use]
pub const fn isqrt(square: u64) -> u32 {
    if square == 0 {
        return 0;
    }
    let root = Root::of(square);
    let mut whole = (root.mantissa >> root.shift()) as u64;
    // The mantissa is within 2 of the exact value, and so is the whole part after the shift.
    // Products stay below 2^64.
    while whole * whole > square {
        whole -= 1;
    }
    while whole < u32::MAX as u64 && (whole + 1) * (whole + 1) <= square {
        whole += 1;
    }
    whole as u32
}

/// Nearest whole number to the square root, exact; 2^32 - 1/2 and above give `u32::MAX`.
#[must_use]
pub const fn sqrt_rounded(square: u64) -> u32 {
    let whole = isqrt(square);
    // sqrt(square) >= whole + 1/2 exactly when square > whole^2 + whole.
    let remainder = square - whole as u64 * whole as u64;
    if remainder > whole as u64 {
        whole.saturating_add(1)
    } else {
        whole
    }
}

/// Length of the hypotenuse for any two `i32`, to the nearest whole number.
#[must_use]
pub const fn hypot(x: i32, y: i32) -> u32 {
    let (x, y) = (x.unsigned_abs() as u64, y.unsigned_abs() as u64);
    sqrt_rounded(x * x + y * y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn check(square: u64) {
        let whole = isqrt(square) as u128;
        assert!(whole * whole <= square as u128, "{square}");
        assert!((whole + 1) * (whole + 1) > square as u128, "{square}");
        let nearest = sqrt_rounded(square) as i128;
        // |nearest - sqrt| <= 1/2, squared: (2 nearest - 1)^2 <= 4 square <= (2 nearest + 1)^2.
        assert!((2 * nearest - 1) * (2 * nearest - 1) <= 4 * square as i128 || nearest == 0);
        assert!(
            (2 * nearest + 1) * (2 * nearest + 1) >= 4 * square as i128
                || nearest == u32::MAX as i128
        );
        if square == 0 {
            return;
        }
        let root = Root::of(square);
        let exact = libm::sqrt(square as f64);
        let scaled = root.mantissa as f64 / libm::exp2(root.shift() as f64);
        assert!((scaled / exact - 1.0).abs() < libm::exp2(-30.5), "{square}");
        if square <= i32::MAX as u64 * i32::MAX as u64 {
            let error = (root.rounded() as f64 - exact).abs();
            assert!(error <= 0.5 + exact * libm::exp2(-30.5), "{square}");
        }
        let reciprocal = root.reciprocal();
        assert!(
            ((1 << 30) - 4..=1 << 31).contains(&reciprocal.mantissa),
            "{square}"
        );
        let value = reciprocal.mantissa as f64 / libm::exp2(reciprocal.shift as f64);
        assert!((value * exact - 1.0).abs() < libm::exp2(-29.5), "{square}");
    }

    #[test]
    fn corners() {
        for square in 0..100_000 {
            check(square);
        }
        for bits in 0..64 {
            for offset in -300i64..300 {
                check((1u64 << bits).wrapping_add_signed(offset));
            }
        }
        for root in (0..=u32::MAX as u64).step_by(65_537) {
            for offset in -2i64..=2 {
                check((root * root).wrapping_add_signed(offset));
            }
        }
        check(u64::MAX);
        assert_eq!(Root::of((1 << 62) - 1).rounded(), i32::MAX);
        check(u32::MAX as u64 * u32::MAX as u64);
    }

    #[test]
    fn both_ends_of_every_cell_of_the_table() {
        for cell in 128u64..512 {
            for end in [cell << 55, (cell << 55) | ((1 << 55) - 1)] {
                for shift in [0, 1, 2, 13, 30, 40] {
                    check(end >> shift);
                }
            }
        }
    }

    #[test]
    fn hypot_of_extremes() {
        assert_eq!(hypot(i32::MIN, i32::MIN), 3_037_000_500);
        assert_eq!(hypot(i32::MIN, 0), 1 << 31);
        assert_eq!(hypot(0, 0), 0);
        assert_eq!(hypot(-3, 4), 5);
    }

    #[test]
    fn reciprocals_keep_their_bound() {
        let check = |value: u32| {
            let exact = libm::exp2(63.0) / value as f64;
            let error = reciprocal(value) as f64 / exact - 1.0;
            assert!(error.abs() < libm::exp2(-31.0), "{value} {error}");
        };
        (1u32 << 31..=u32::MAX).step_by(4099).for_each(check);
        for cell in 256u32..512 {
            for offset in 0..300 {
                check((cell << 23) + offset);
                check((cell << 23 | ((1 << 23) - 1)) - offset);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: 200_000,
            rng_seed: RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]
        #[test]
        fn all_magnitudes(raw: u64, shift in 0u32..64) {
            check(raw >> shift);
        }
    }
}
