//! First-order filters: the pole of a time constant, and the filtered rate of a signal.
//!
//! Signals are `i32`, times microseconds. States are convex combinations of the inputs that were seen, so no input can overflow them.

use crate::config::digest::constants;
use haptimill_math::reciprocal::mul_shift;
use haptimill_math::scale::total;

/// Fractional bits of the low-passed signal: at a pole of 0.99 a difference of 1 still moves the state.
const FRACTION: u32 = 24;

/// Fractional bits of a change of the filtered signal.
pub const CHANGE_FRACTION: u32 = FRACTION;

/// Fractional bits of the rate.
pub const RATE_FRACTION: u32 = 8;

/// The largest magnitude of a filtered rate, in units per second with [`RATE_FRACTION`].
pub const RATE_LIMIT: i64 = 1 << 44;

/// e^-1, Q32.
const INVERSE_E: u64 = 1_580_030_169;

/// 1 - exp(-period / time), Q32: the part of the way to its input that a filter goes in a period; error below 2^-28. A time of zero gives the whole way (less 2^-32).
///
/// The exact mapping of the pole, not Tustin's nor Euler's: exp(-x) is the whole part of x in powers of 1/e times the series of the rest.
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

/// Periods per second, Q16; at most 20,000 * 2^16, a shorter period than 50 us is taken for 50.
pub(crate) const fn frequency(period_us: u16) -> u32 {
    let period = if period_us < 50 { 50 } else { period_us as u64 };
    (((1_000_000 << 16) + period / 2) / period) as u32
}

/// The rate of a signal through a first-order filter: s / (1 + s tau), mapped exactly for an input that is held or ramps.
///
/// It low-passes the signal and takes the rate of *that*, so the sum of all rates is the signal's own change, to the last bit of the state: there is
/// no drift, and quantisation of the signal cannot be amplified more than (1 - pole) / period times.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RateFilter {
    /// Q32.
    approach: u32,
    /// Periods per second, Q16.
    frequency: u32,
    /// The low-passed signal, Q24, within the range of the signal.
    state: i64,
}

constants!(RateFilter { approach, frequency } of {} but { state });

impl RateFilter {
    /// A filter with a time constant (0: none), called once a period (50 to 1000 us; a shorter one is taken for 50).
    pub const fn new(period_us: u16, time_us: u16) -> Self {
        let period = if period_us < 50 { 50 } else { period_us };
        Self {
            approach: approach(period, time_us),
            frequency: frequency(period),
            state: 0,
        }
    }

    /// The signal has rested at this value.
    pub const fn rest(&mut self, signal: i32) {
        self.state = (signal as i64) << FRACTION;
    }

    /// Takes the signal of a period; gives by how much it has changed since the last one, low-passed, with [`CHANGE_FRACTION`]; within +-2^56.
    #[inline]
    pub fn change(&mut self, signal: i32) -> i64 {
        // State within +-2^55, difference within +-2^56.
        let difference = total(i64::from(signal) << FRACTION, self.state.wrapping_neg());
        let change = mul_shift::<32>(difference, self.approach);
        self.state = total(self.state, change);
        change
    }

    /// Takes the signal of a period; gives its rate per second with [`RATE_FRACTION`], within +-[`RATE_LIMIT`].
    #[inline]
    pub fn rate(&mut self, signal: i32) -> i64 {
        // Q24 * Q16 / 2^32 = Q8.
        mul_shift::<32>(self.change(signal), self.frequency).clamp(-RATE_LIMIT, RATE_LIMIT)
    }
}
