//! Exact zero-order-hold discretisation of the admittance law (docs/control.md (3.30) and 3.3): K_A
//! v' + K_V v = u, with u constant over a control period T.
//!
//! With x = K_V T / K_A, a = e^-x and the terminal rate w = u T / K_V (displacements per period):
//!
//! ```text
//! displacement += v - (v - w) (1 - g)     g = (1 - a) / x = 1 - x/2 (1 - x/3 (1 - x/4 (...)))
//! v            -= (v - w) (1 - a)         1 - a = x g
//! ```
//!
//! The series is summed at configuration time to 20 terms (x <= 1: the remainder is below 1/22!),
//! with an error below 2^-59. The control period contains no division. 1 - g and 1 - a have a
//! relative error of 2^-31, T / K_V of 2^-30. The rate has 17 bits below 2^-40 mm, so a rounding
//! error in every period adds up to at most 2^-37 mm per period.
//!
//! Callers of [`ZeroOrderHold::step`] must keep the rate below [`RATE_BITS`]; [`super::admittance`]
//! does.

use haptimill_math::force::{VirtualDamping, VirtualMass};
use haptimill_math::scale::{high_product, multiply_high};

/// Bits of a rate below 2^-40 mm per control period: the largest number of leading zeros of 1 - a
/// (x >= 2^-18).
pub const FINENESS: u32 = 17;

/// Rates are below 2^41 * 2^-40 mm, 2 mm, per control period; in the finest scale below 2^58.
pub const RATE_BITS: u32 = 41;

/// Products of force and T / K_V are below 2^58, so they may be shifted left by this number of bits
/// before scaling.
const HEADROOM: u32 = 4;

/// 2^64 / k, rounded down, for the terms of the series.
const RECIPROCALS: [u64; 20] = {
    let mut table = [0; 20];
    let mut place = 0;
    while place < 20 {
        table[place] = u64::MAX / (place as u64 + 2);
        place += 1;
    }
    table
};

/// Fraction with 31 bits: `mantissa` times 2^-(32 + deep).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub(super) struct Part {
    /// 2^31 to 2^32.
    mantissa: u32,
    deep: u32,
}

impl Part {
    /// Creates the fraction of a number below 1 in Q63.
    pub(super) const fn new(value: u64) -> Self {
        let zeros = value.leading_zeros();
        let deep = if zeros < 1 {
            0
        } else if zeros > 32 {
            31
        } else {
            zeros - 1
        };
        Self {
            mantissa: (value >> (31 - deep)) as u32,
            deep,
        }
    }

    /// `numerator` / `denominator`; the denominator must be larger than the numerator and below
    /// 2^62.
    pub(super) fn ratio(numerator: u64, denominator: u64) -> Self {
        Self::new(ratio(numerator, denominator))
    }

    /// This fraction of a number below 2^62, rounded down twice: at most two units too small. It
    /// takes two products of words.
    #[inline]
    pub(super) const fn of(self, whole: i64) -> i64 {
        multiply_high(whole, self.mantissa).wrapping_shr(self.deep)
    }
}

/// Effect of one control period with one damping on displacement and rate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct ZeroOrderHold {
    /// 1 - a.
    approach: Part,
    /// 1 - g.
    lag: Part,
    /// T / K_V in 2^-(40 + FINENESS) mm per 2^-16 N is this times 2^(HEADROOM - shift); 2^30 to
    /// 2^31.
    terminal: i32,
    shift: u32,
}

/// Whether `mass` and `damping` can be discretised with this period: 2^-18 <= K_V T / K_A <= 1.
#[must_use]
pub const fn sound(mass: VirtualMass, damping: VirtualDamping, period_us: u16) -> bool {
    // Below 2^48 and 2^52.
    let part = damping.0 as u64 * period_us as u64;
    let whole = mass.0 as u64 * 1_000_000;
    part > 0 && part <= whole && whole >> 18 <= part
}

impl ZeroOrderHold {
    /// Creates the discretisation of values for which [`sound`] holds; for others it is
    /// meaningless.
    #[must_use]
    pub fn new(mass: VirtualMass, damping: VirtualDamping, period_us: u16) -> Self {
        let x = ratio(
            u64::from(damping.0) * u64::from(period_us),
            u64::from(mass.0) * 1_000_000,
        );
        // Q63; never above 1 and never below 1/2.
        let mut mean = 1 << 63;
        for reciprocal in RECIPROCALS.iter().rev() {
            // x mean / k, Q63: below 2^62.
            mean = (1 << 63) - high_product(high_product(x, mean) << 1, *reciprocal);
        }
        // Q63, at most 0.64.
        let approach = Part::new(high_product(x, mean) << 1);
        let (terminal, shift) = terminal(damping, period_us);
        Self {
            approach,
            lag: Part::new((1 << 63) - mean),
            terminal,
            shift,
        }
    }

    /// Computes one control period under a force (2^-16 N, up to 2^27). Returns the displacement
    /// and the new rate, both in 2^-(40 + [`FINENESS`]) mm, below 2^62.
    ///
    /// `rate` has the same scale and must be below 2^([`RATE_BITS`] + [`FINENESS`]).
    #[inline]
    #[must_use]
    pub const fn step(&self, force: i32, rate: i64) -> (i64, i64) {
        // Below 2^58. 2048 N at the smallest K_V give 20 mm in a millisecond, 2^44.4: below 2^62 in
        // this scale.
        let wide = force as i64 * self.terminal as i64;
        let end = wide.wrapping_shl(HEADROOM).wrapping_shr(self.shift);
        let off = rate.wrapping_sub(end);
        (
            rate.wrapping_sub(self.lag.of(off)),
            rate.wrapping_sub(self.approach.of(off)),
        )
    }
}

/// `part` / `whole`, Q63, rounded down; `part <= whole < 2^62`.
fn ratio(part: u64, whole: u64) -> u64 {
    let (mut rest, mut quotient) = (part, 0u64);
    for _ in 0..63 {
        rest <<= 1;
        quotient <<= 1;
        if rest >= whole {
            rest -= whole;
            quotient |= 1;
        }
    }
    quotient
}

/// T / K_V as mantissa and exponent.
fn terminal(damping: VirtualDamping, period_us: u16) -> (i32, u32) {
    // T / K_V in 2^-40 mm per 2^-16 N: 2^40 T_us / (K_V 10^6), K_V in 2^-16. Below 2^16 and 2^52.
    let whole = (u64::from(damping.0) * 1_000_000).max(1);
    let mut part = u64::from(period_us).max(1);
    let mut shift = 0;
    while part < whole && shift < 52 {
        part <<= 1;
        shift += 1;
    }
    // 1 <= part / whole < 2: 31 bits of it.
    let mut mantissa = 1u32;
    let mut rest = part - whole.min(part);
    for _ in 0..30 {
        rest <<= 1;
        mantissa <<= 1;
        if rest >= whole {
            rest -= whole;
            mantissa |= 1;
        }
    }
    // mantissa 2^-30 2^-shift 2^(40 + FINENESS). K_V of 0.1 N s/mm and a period of 1 ms have a
    // shift of 23; no sound values have less.
    (
        mantissa.min(i32::MAX as u32) as i32,
        (shift + 30 + HEADROOM).saturating_sub(40 + FINENESS),
    )
}
