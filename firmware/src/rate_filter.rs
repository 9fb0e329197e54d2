//! First-order filters: the pole of a time constant, and the filtered rate of a signal.
//!
//! Signals are `i32`, times are microseconds. States are convex combinations of past inputs, so no
//! input can overflow them.

use crate::digest::impl_digest;
use haptimill_math::reciprocal::mul_shift;
use haptimill_math::scale::total;

/// Fractional bits of the low-passed signal: at a pole of 0.99 a difference of 1 still moves the
/// state.
const FRACTION: u32 = 24;

/// Fractional bits of a change of the filtered signal.
pub const CHANGE_FRACTION: u32 = FRACTION;

/// Fractional bits of the rate.
pub const RATE_FRACTION: u32 = 8;

/// The largest magnitude of a filtered rate, in units per second with [`RATE_FRACTION`].
pub const RATE_LIMIT: i64 = 1 << 44;

/// e^-1, Q32.
const INVERSE_E: u64 = 1_580_030_169;

/// 1 - exp(-period / time), Q32: the fraction of the distance to its input that a filter covers in
/// a period. The error is below 2^-28. A time of zero gives 1 - 2^-32.
///
/// The mapping of the pole is exact, unlike Tustin's or Euler's. exp(-x) is a power of 1/e for the
/// integer part of x, times the series for the fraction.
pub const fn approach(period_us: u16, time_us: u16) -> u32 {
    if time_us == 0 {
        return u32::MAX;
    }
    // Q32, below 2^48.
    let ratio = ((period_us as u64) << 32) / time_us as u64;
    if ratio >> 32 >= 23 {
        return u32::MAX;
    }
    let rest = ratio & 0xffff_ffff;
    // 1 - x + x^2/2 - ...: partial sums stay within 0 to 1, terms below 2^32, products below 2^64.
    let mut sum: u64 = 1 << 32;
    let mut term: u64 = 1 << 32;
    let mut order = 1;
    while order <= 12 {
        term = (((term >> 1) * rest) >> 31) / order;
        sum = if order % 2 == 1 {
            sum - term
        } else {
            sum + term
        };
        order += 1;
    }
    let mut whole = ratio >> 32;
    while whole > 0 {
        sum = ((sum >> 1) * INVERSE_E) >> 31;
        whole -= 1;
    }
    let left = (1u64 << 32).saturating_sub(sum);
    if left > u32::MAX as u64 {
        u32::MAX
    } else {
        left as u32
    }
}

/// Periods per second, Q16; at most 20,000 * 2^16. A period shorter than 50 us counts as 50.
pub(crate) const fn frequency(period_us: u16) -> u32 {
    let period = if period_us < 50 { 50 } else { period_us as u64 };
    (((1_000_000 << 16) + period / 2) / period) as u32
}

/// Rate of a signal through a first-order filter: s / (1 + s tau), mapped exactly for an input that
/// is constant or a ramp.
///
/// The filter low-passes the signal and differentiates the result. So the sum of all changes is the
/// change of the signal itself, to the last bit of the state. The filter does not drift, and it
/// amplifies the quantisation of the signal by at most (1 - pole) / period.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RateFilter {
    /// Q32.
    approach: u32,
    /// Periods per second, Q16.
    frequency: u32,
    /// The low-passed signal, Q24, within the range of the signal.
    state: i64,
}

impl_digest!(RateFilter { fields { approach, frequency }, nested {}, skip { state } });

impl RateFilter {
    /// A filter with the time constant `time_us` (0: none), called once per period of `period_us`
    /// (50 to 1000; a shorter one counts as 50).
    pub const fn new(period_us: u16, time_us: u16) -> Self {
        let period = if period_us < 50 { 50 } else { period_us };
        Self {
            approach: approach(period, time_us),
            frequency: frequency(period),
            state: 0,
        }
    }

    /// Resets the filter to a signal that has been constant at this value.
    pub const fn rest(&mut self, signal: i32) {
        self.state = (signal as i64) << FRACTION;
    }

    /// Shifts past and present of the signal: the next change does not contain `by`.
    pub fn shift(&mut self, by: i32) {
        self.state = total(self.state, i64::from(by) << FRACTION);
    }

    /// Processes the signal of a period. Returns its low-passed change since the previous period,
    /// with [`CHANGE_FRACTION`]; within +-2^56.
    #[inline]
    pub fn change(&mut self, signal: i32) -> i64 {
        // State within +-2^55, difference within +-2^56.
        let difference = total(i64::from(signal) << FRACTION, self.state.wrapping_neg());
        let change = mul_shift::<32>(difference, self.approach);
        self.state = total(self.state, change);
        change
    }

    /// Processes the signal of a period. Returns its rate per second with [`RATE_FRACTION`], within
    /// +-[`RATE_LIMIT`].
    #[inline]
    pub fn rate(&mut self, signal: i32) -> i64 {
        // Q24 * Q16 / 2^32 = Q8.
        mul_shift::<32>(self.change(signal), self.frequency).clamp(-RATE_LIMIT, RATE_LIMIT)
    }
}
