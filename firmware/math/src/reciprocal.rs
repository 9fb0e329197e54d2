//! Fixed-point division without a divider: reciprocals as 31-bit mantissa and binary exponent, and
//! products wider than 64 bits.
//!
//! All values are pure numbers without units. A Cortex-M4F divides 32 by 32 bits in at most 12
//! cycles, but 64 by 64 in several hundred. So the control period uses this module instead. Callers
//! must keep operands within the stated ranges; [`mul_shift`] is exact only there.

use crate::scale::{product, total};

/// 1/d as `mantissa / 2^exponent`, mantissa in (2^30, 2^31].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Reciprocal {
    mantissa: u32,
    exponent: u32,
}

impl Reciprocal {
    /// Reciprocal of `divisor`; relative error below 2^-28. Zero counts as one.
    ///
    /// One 32-bit division gives a 16-bit quotient. One Newton step y (2 - d y) then squares its
    /// relative error of 2^-15.
    pub const fn new(divisor: u32) -> Self {
        let divisor = if divisor == 0 { 1 } else { divisor };
        let zeros = divisor.leading_zeros();
        let normal = divisor << zeros;
        // 2^48 / normal, to 15 bits; at most 2^17.
        let first = (u32::MAX / (normal >> 16)) as u64;
        // normal * first is 2^48 (1 - error), |error| < 2^-14, so this difference does not overflow
        // and stays above 2^47.
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
    pub const fn scaled(self, value: i64, scale: u32) -> i64 {
        // The shift is 0 to 62: the exponent is at least 31 and the scale at most 31.
        product(value, self.mantissa as i64).wrapping_shr(self.exponent.wrapping_sub(scale))
    }

    /// Mantissa, at most 2^31, and exponent, 31 to 62.
    #[inline]
    pub const fn parts(self) -> (u32, u32) {
        (self.mantissa, self.exponent)
    }
}

/// A positive factor that is known from the configuration: `mantissa * 2^exponent`, mantissa in
/// [2^30, 2^31), or zero. It is computed once, outside the control period; the control period uses
/// its [`Scale`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Factor {
    mantissa: u32,
    exponent: i32,
}

impl Factor {
    /// Factor of a whole number.
    pub const fn of(value: u64) -> Self {
        let bits = 64 - value.leading_zeros() as i32;
        let mantissa = if bits > 31 {
            value >> (bits - 31)
        } else if bits == 0 {
            0
        } else {
            value << (31 - bits)
        };
        Self {
            mantissa: mantissa as u32,
            exponent: bits - 31,
        }
    }

    /// Product, relative error below 2^-30.
    pub const fn times(self, other: Self) -> Self {
        let product = Self::of(self.mantissa as u64 * other.mantissa as u64);
        Self {
            exponent: product.exponent + self.exponent + other.exponent,
            ..product
        }
    }

    /// Quotient, relative error below 2^-30. A divisor of zero counts as a mantissa of 2^30.
    pub const fn over(self, other: Self) -> Self {
        let divisor = if other.mantissa == 0 {
            1 << 30
        } else {
            other.mantissa
        };
        let quotient = Self::of(((self.mantissa as u64) << 32) / divisor as u64);
        Self {
            exponent: quotient.exponent + self.exponent - other.exponent - 32,
            ..quotient
        }
    }

    /// This factor times 2^bits.
    pub const fn shifted(self, bits: i32) -> Self {
        Self {
            exponent: self.exponent + bits,
            ..self
        }
    }

    /// The nearest whole number from 1 to `i32::MAX`.
    pub const fn whole(self) -> i32 {
        let down = -self.exponent;
        if down < 0 {
            return i32::MAX;
        }
        if down > 31 {
            return 1;
        }
        let rounded = (self.mantissa as u64 + ((1 << down) >> 1)) >> down;
        if rounded == 0 { 1 } else { rounded as i32 }
    }

    /// Mantissa, below 2^31, and exponent.
    pub const fn parts(self) -> (i32, i32) {
        (self.mantissa as i32, self.exponent)
    }

    /// Number of bits by which an operand of more than 31 bits may be shifted right before a
    /// [`Scale`] multiplies it, without loss in the product; at most 56.
    pub const fn coarseness(self) -> u32 {
        let bits = -32 - self.exponent;
        if bits < 0 {
            0
        } else if bits > 56 {
            56
        } else {
            bits as u32
        }
    }

    /// Multiplication by this factor.
    pub const fn scale(self) -> Scale {
        // Operand * 2^shift * mantissa / 2^32, with all bits of the mantissa if the shift can
        // absorb the exponent.
        let shift = self.exponent + 32;
        if shift > 30 {
            Scale {
                mantissa: i32::MAX,
                shift: 30,
            }
        } else if shift >= 0 {
            Scale {
                mantissa: self.mantissa as i32,
                shift: shift as u32,
            }
        } else if shift > -31 {
            Scale {
                mantissa: (self.mantissa >> -shift) as i32,
                shift: 0,
            }
        } else {
            Scale {
                mantissa: 0,
                shift: 0,
            }
        }
    }
}

/// Multiplication by a constant factor: six instructions of a 32-bit processor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Scale {
    mantissa: i32,
    shift: u32,
}

impl Scale {
    /// Multiplication by the negative factor.
    pub const fn reversed(self) -> Self {
        Self {
            // A mantissa is never negative here.
            mantissa: self.mantissa.wrapping_neg(),
            ..self
        }
    }

    /// `value` times the factor, rounded down. The result saturates at a magnitude of about 2^30
    /// (2^29 to 2^30, depending on the factor). No value overflows.
    #[inline(always)]
    pub const fn apply(self, value: i32) -> i32 {
        let wide = value.wrapping_shl(self.shift);
        let held = if wide.wrapping_shr(self.shift) == value {
            wide
        } else {
            i32::MAX ^ (value >> 31)
        };
        high(held, self.mantissa)
    }
}

/// `a * b / 2^32`, rounded down: one instruction.
#[inline(always)]
pub const fn high(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

/// `a * b / 2^SHIFT`, rounded down. Callers must pass `SHIFT <= 32` and `|a| < 2^(30 + SHIFT)`.
#[inline]
pub const fn mul_shift<const SHIFT: u32>(a: i64, b: u32) -> i64 {
    let high = product(a >> 32, b as i64);
    let low = ((a & 0xffff_ffff) as u64 * b as u64) >> SHIFT;
    total(high << (32 - SHIFT), low as i64)
}

/// `value`, saturating at the range of `i32`.
#[inline]
pub const fn saturate(value: i64) -> i32 {
    let word = value as i32;
    if word as i64 == value {
        word
    } else {
        i32::MAX ^ (value >> 63) as i32
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
        fn a_factor_is_its_number(a: u64, b in 1u64.., value: i32, down in 0u32..64, bits in -40i32..10) {
            let a = a >> down;
            let factor = Factor::of(a).times(Factor::of(b)).over(Factor::of(b)).shifted(bits);
            let exact = a as f64 * f64::exp2(f64::from(bits));
            let whole = f64::from(factor.whole());
            let bounded = exact.clamp(1.0, f64::from(i32::MAX));
            prop_assert!((whole - bounded).abs() <= 0.5 + bounded * f64::exp2(-28.0), "{whole} {exact}");
            let given = f64::from(factor.mantissa) * f64::exp2(f64::from(factor.exponent));
            prop_assert!((given - exact).abs() <= exact * f64::exp2(-28.0), "{given} {exact}");
            let product = f64::from(factor.scale().apply(value));
            let limit = f64::from(1 << 29);
            if exact * f64::from(value).abs() < limit {
                prop_assert!((product - exact * f64::from(value)).abs() <= 1.5 + f64::from(value).abs() * f64::exp2(-32.0) + limit * f64::exp2(-27.0));
            } else {
                prop_assert!(product.abs() >= limit * 0.999 - 1.0 && (product < 0.0) == (value < 0));
            }
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
