//! Division without a divider: reciprocals as 31-bit mantissa and binary exponent, and products wider than 64 bits.
//!
//! Pure numbers, no units. A Cortex-M4F divides 32 by 32 bits in at most 12 cycles, but 64 by 64 in several hundred; everything in
//! the control period goes through here instead. Misuse: [`mul_shift`] is exact only within the range that it states.

use crate::units::scale::{product, total};

/// 1/d as `mantissa / 2^exponent`, mantissa in (2^30, 2^31].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Reciprocal {
    mantissa: u32,
    exponent: u32,
}

impl Reciprocal {
    /// Reciprocal of `divisor`; relative error below 2^-28. Zero is taken for one.
    ///
    /// A 16-bit quotient of one 32-bit division, then one Newton step y (2 - d y), which squares its relative error of 2^-15.
    pub(crate) const fn new(divisor: u32) -> Self {
        let divisor = if divisor == 0 { 1 } else { divisor };
        let zeros = divisor.leading_zeros();
        let normal = divisor << zeros;
        // 2^48 / normal, to 15 bits; at most 2^17.
        let first = (u32::MAX / (normal >> 16)) as u64;
        // normal * first is 2^48 (1 - error), |error| < 2^-14, so this difference neither overflows nor goes below 2^47.
        let correction = ((1u64 << 49) - normal as u64 * first) >> 17;
        // At most 2^17 * 2^32.
        let mantissa = (first * correction) >> 17;
        Self {
            mantissa: if mantissa > 1 << 31 {
                1 << 31
            } else {
                mantissa as u32
            },
            exponent: 62 - zeros,
        }
    }

    /// `value * 2^scale / divisor`, rounded down; `|value| <= 2^31`, `scale <= 31`.
    #[inline]
    pub(crate) const fn scaled(self, value: i64, scale: u32) -> i64 {
        // The shift is 0 to 62: the exponent is at least 31, the scale at most that.
        product(value, self.mantissa as i64).wrapping_shr(self.exponent.wrapping_sub(scale))
    }

    /// Mantissa, at most 2^31, and exponent, 31 to 62.
    #[inline]
    pub(crate) const fn parts(self) -> (u32, u32) {
        (self.mantissa, self.exponent)
    }
}

/// `a * b / 2^SHIFT`, rounded down, `SHIFT <= 32`; needs `|a| < 2^(30 + SHIFT)`.
#[inline]
pub(crate) const fn mul_shift<const SHIFT: u32>(a: i64, b: u32) -> i64 {
    let high = product(a >> 32, b as i64);
    let low = ((a & 0xffff_ffff) as u64 * b as u64) >> SHIFT;
    total(high << (32 - SHIFT), low as i64)
}

/// The nearest `i32`.
#[inline]
pub(crate) const fn saturate(value: i64) -> i32 {
    if value > i32::MAX as i64 {
        i32::MAX
    } else if value < i32::MIN as i64 {
        i32::MIN
    } else {
        value as i32
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn reciprocal_is_within_its_bound(divisor in 1u32.., shift in 0u32..32) {
            let divisor = (divisor >> shift).max(1);
            let reciprocal = Reciprocal::new(divisor);
            let value = f64::from(reciprocal.mantissa) / f64::exp2(f64::from(reciprocal.exponent));
            prop_assert!((value * f64::from(divisor) - 1.0).abs() < f64::exp2(-28.0));
            prop_assert!(reciprocal.mantissa > (1 << 30) - 8 && reciprocal.mantissa <= 1 << 31);
        }

        #[test]
        fn mul_shift_is_exact(a in -(1i64 << 57)..(1i64 << 57), b: u32) {
            prop_assert_eq!(i128::from(mul_shift::<32>(a, b)), (i128::from(a) * i128::from(b)) >> 32);
            prop_assert_eq!(i128::from(mul_shift::<28>(a, b)), (i128::from(a) * i128::from(b)) >> 28);
            let a = a >> 12;
            prop_assert_eq!(i128::from(mul_shift::<16>(a, b)), (i128::from(a) * i128::from(b)) >> 16);
        }
    }

    #[test]
    fn reciprocal_at_the_corners() {
        for divisor in [
            0u32,
            1,
            2,
            3,
            0x7fff_ffff,
            0x8000_0000,
            0x8000_0001,
            0x8000_ffff,
            0xffff_0000,
            u32::MAX,
        ] {
            let reciprocal = Reciprocal::new(divisor);
            let value = f64::from(reciprocal.mantissa) / f64::exp2(f64::from(reciprocal.exponent));
            assert!(
                (value * f64::from(divisor.max(1)) - 1.0).abs() < f64::exp2(-28.0),
                "{divisor}"
            );
        }
    }
}
