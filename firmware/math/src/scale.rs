//! Products of wide integers, scaled by a power of two and rounded to nearest.
//!
//! These are the multiplications of a fixed-point controller. They consist of 32 x 32 -> 64 bit
//! products, which are one instruction on every target of this firmware, and use no division.
//! Rounding is to nearest, halves upwards (towards plus infinity). So the error of one operation is
//! at most half a unit of its result, with a negligible bias.
//!
//! Callers must keep the stated limits of functions that do not saturate. Beyond them the result is
//! meaningless, or a panic in builds with overflow checks. Operands should be limited where they
//! enter.

/// `a * b`. Callers must make sure that the product fits; builds with debug assertions (all tests)
/// check it.
///
/// An overflow check of a 64-bit product costs a 32-bit processor ten times the product itself.
#[inline(always)]
#[must_use]
pub const fn product(a: i64, b: i64) -> i64 {
    debug_assert!(a.checked_mul(b).is_some());
    a.wrapping_mul(b)
}

/// `a + b`. Callers must make sure that the sum fits; builds with debug assertions check it.
#[inline(always)]
#[must_use]
pub const fn total(a: i64, b: i64) -> i64 {
    debug_assert!(a.checked_add(b).is_some());
    a.wrapping_add(b)
}

/// `a - b`. Callers must make sure that the difference fits; builds with debug assertions check it.
#[inline(always)]
#[must_use]
pub const fn difference(a: i64, b: i64) -> i64 {
    debug_assert!(a.checked_sub(b).is_some());
    a.wrapping_sub(b)
}

/// `value`, saturating at the range of `i32`.
#[inline(always)]
#[must_use]
pub const fn saturate(value: i64) -> i32 {
    let word = value as i32;
    if word as i64 == value {
        word
    } else {
        i32::MAX ^ (value >> 63) as i32
    }
}

/// `value >> by`. Callers must pass `by` below 64; the result is meaningless otherwise.
///
/// It shifts two 32-bit halves. With optimisation for size the compiler would call a function that
/// takes three times as long.
#[inline(always)]
#[must_use]
pub const fn shift_right(value: i64, by: u32) -> i64 {
    let (high, low) = ((value >> 32) as i32, value as u32);
    let (high, low) = if by >= 32 {
        (high >> 31, high as u32)
    } else {
        (high, low)
    };
    let part = by & 31;
    // Bits move between the halves in two shifts, because a 32-bit shift cannot shift by 32.
    let low = (low >> part) | (high as u32) << 1 << (31 - part);
    ((high >> part) as i64) << 32 | low as i64
}

/// `value << by`. Callers must pass `by` below 64; the result is meaningless otherwise.
#[inline(always)]
#[must_use]
pub const fn shift_left(value: u64, by: u32) -> u64 {
    let (high, low) = ((value >> 32) as u32, value as u32);
    let (high, low) = if by >= 32 { (low, 0) } else { (high, low) };
    let part = by & 31;
    let high = (high << part) | low >> 1 >> (31 - part);
    (high as u64) << 32 | (low << part) as u64
}

/// `value / 2^shift`, rounded to nearest; `shift` is 1 to 62.
///
/// The result is correct for every value except `i64::MAX` with a shift of 1, which wraps.
#[inline(always)]
#[must_use]
pub const fn round_shift(value: i64, shift: u32) -> i64 {
    // Shifting twice keeps the half bit without an addition that could overflow at the top. Each
    // use relies on the caller for the range of the shift.
    value.wrapping_shr(shift.wrapping_sub(1)).wrapping_add(1) >> 1
}

/// `a * b / 2^shift`, rounded to nearest, for any two `i32`; `shift` is 1 to 62.
#[inline(always)]
#[must_use]
pub const fn multiply_shift(a: i32, b: i32, shift: u32) -> i64 {
    round_shift(a as i64 * b as i64, shift)
}

/// `value / 2^30`, rounded to nearest, if that is known to fit 32 bits. It scales a product with a
/// Q30 number back, in half of the instructions of [`round_shift`].
///
/// A `value` of 2^61 or more gives only the lower 32 bits of the result. `value` must be at most
/// 2^63 - 2^29.
#[inline(always)]
#[must_use]
pub const fn round_q30(value: i64) -> i32 {
    (total(value, 1 << 29) >> 30) as i32
}

/// `value * factor / 2^shift`, rounded to nearest, for a 64-bit value; `shift` is 1 to 32.
///
/// The result must fit in 62 bits, which holds for `|value| < 2^(30 + shift)`.
#[inline(always)]
#[must_use]
pub const fn scale(value: i64, factor: i32, shift: u32) -> i64 {
    let high = product(value >> 32, factor as i64);
    // The lower half counts as positive: 0 <= low < 2^32, so the product is below 2^63 in
    // magnitude.
    let low = product(value & 0xffff_ffff, factor as i64);
    // high * 2^32 is a whole multiple of 2^shift, so only the lower product needs rounding.
    (high << (32 - shift)).wrapping_add(round_shift(low, shift))
}

/// `value * factor / 2^32`, rounded down, for any `value` and a `factor` of at most 2^31.
#[inline(always)]
#[must_use]
pub const fn multiply_high(value: i64, factor: u32) -> i64 {
    let high = product(value >> 32, factor as i64);
    let low = ((value as u32 as u64 * factor as u64) >> 32) as i64;
    total(high, low)
}

/// `a * b / 2^64`, too small by less than 3 units, for any two numbers: three 32 x 32 bit products.
#[inline(always)]
#[must_use]
pub const fn high_product(a: u64, b: u64) -> u64 {
    let (a_high, a_low) = (a >> 32, a & 0xffff_ffff);
    let (b_high, b_low) = (b >> 32, b & 0xffff_ffff);
    // Each term is a product of 32-bit numbers, and their sum is at most the exact value.
    (a_high * b_high)
        .wrapping_add((a_high * b_low) >> 32)
        .wrapping_add((a_low * b_high) >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn exact(product: i128, shift: u32) -> i128 {
        (product + (1i128 << (shift - 1))) >> shift
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: 2_000,
            rng_seed: RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]
        #[test]
        fn round_shift_rounds_to_nearest(value in -(1i64 << 62)..(1i64 << 62), shift in 1u32..=62) {
            prop_assert_eq!(round_shift(value, shift) as i128, exact(value as i128, shift));
        }

        #[test]
        fn round_q30_is_the_lower_word_of_round_shift(value in i64::MIN..i64::MAX - (1 << 29)) {
            prop_assert_eq!(round_q30(value), round_shift(value, 30) as i32);
        }

        #[test]
        fn multiply_shift_is_the_rounded_product(a: i32, b: i32, shift in 1u32..=62) {
            prop_assert_eq!(multiply_shift(a, b, shift) as i128, exact(a as i128 * b as i128, shift));
        }

        #[test]
        fn scale_is_the_rounded_product(raw: i64, factor: i32, shift in 1u32..=32) {
            let value = raw >> (34 - shift);
            prop_assert_eq!(scale(value, factor, shift) as i128, exact(value as i128 * factor as i128, shift));
        }

        #[test]
        fn multiply_high_is_the_product_rounded_down(value: i64, factor in 0u32..=1 << 31) {
            prop_assert_eq!(multiply_high(value, factor) as i128, (value as i128 * factor as i128) >> 32);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: 2_000,
            rng_seed: RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]
        #[test]
        fn high_product_is_short_by_less_than_three(a: u64, b: u64) {
            let exact = ((a as u128 * b as u128) >> 64) as u64;
            prop_assert!((0..3).contains(&(exact - high_product(a, b))));
        }
    }

    #[test]
    fn shifts_by_words_are_shifts() {
        for value in [
            0x8123_4567_89ab_cdef_u64,
            1,
            u64::MAX,
            0x7fff_ffff_8000_0001,
        ] {
            for by in 0..64 {
                assert_eq!(shift_left(value, by), value << by);
                assert_eq!(shift_right(value as i64, by), value as i64 >> by);
            }
        }
    }

    #[test]
    fn extremes_do_not_overflow() {
        for value in [i64::MIN, i64::MIN + 1, -1, 0, 1, i64::MAX - 1, i64::MAX] {
            for shift in 1..=62 {
                let _ = round_shift(value, shift);
            }
            let _ = multiply_high(value, 1 << 31);
        }
        for a in [i32::MIN, -1, 0, 1, i32::MAX] {
            for b in [i32::MIN, -1, 0, 1, i32::MAX] {
                for shift in 1..=62 {
                    assert_eq!(
                        multiply_shift(a, b, shift) as i128,
                        exact(a as i128 * b as i128, shift)
                    );
                }
            }
        }
        assert_eq!(high_product(u64::MAX, u64::MAX), u64::MAX - 2);
        assert_eq!(saturate(i64::MAX), i32::MAX);
        assert_eq!(saturate(i64::MIN), i32::MIN);
        assert_eq!(saturate(-7), -7);
    }
}
