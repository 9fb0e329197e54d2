//! Rate of an encoder from the time *between edges* instead of counts per period.
//!
//! At 4 mm/s with 1.25 um counts there is an edge every 312 us. Counts per 200 us period would read
//! 0 or 6.25 mm/s. The time between two edges is known to 1 ns (6 ns with a timer at 168 MHz) and
//! gives 4 mm/s within 0.00003 (0.0002) mm/s. The age of the rate is half the time between edges.
//!
//! Without a new edge the rate is bounded by one count per time since the last edge. So it goes to
//! zero when the motion ends, and is exactly zero after 2.1 s. An edge that is crossed back and
//! forth is one position: a reversal reads as zero rate.
//!
//! Every period records its edges ([`EdgeTimer::note`]). [`EdgeTimer::rate`] needs a reciprocal and
//! is computed on demand.
//!
//! Limit: more than 2^30 counts in a period give a wrong rate.

use crate::digest::impl_digest;
use haptimill_math::Rate;
use haptimill_math::reciprocal::{Factor, Reciprocal, high, saturate};
use haptimill_math::scale::shift_right;

/// Age of the last edge from which the joint is at standstill: half of the range of the clock.
const STALE_NS: u32 = 1 << 31;

/// Ages from here on belong to an edge up to a millisecond after the clock was read. A real age of
/// that size became [stale](STALE_NS) long before.
const AHEAD_NS: u32 = u32::MAX - 999_999;

/// The last two edge positions and their times.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EdgeTimer {
    /// Half a count in au/s * ns: `mantissa * 2^exponent`, of the magnitude of a count.
    half_mantissa: i32,
    half_exponent: i32,
    /// Counts decrease while the coordinate increases.
    reversed: bool,
    edge_time_ns: u32,
    /// Position of the last edge, in half counts; wraps around.
    edge: i32,
    /// `edge_time_ns` and `edge` belong to a recorded edge that is not stale.
    edge_known: bool,
    /// Half counts and nanoseconds between the last two edges. Zero travel means zero rate.
    travel: i32,
    interval_ns: u32,
    /// Age of the last edge at the last reading; 0 if that reading brought an edge.
    age_ns: u32,
}

impl_digest!(EdgeTimer { fields { half_mantissa, half_exponent, reversed }, nested {}, skip {
    edge_time_ns, edge, edge_known, travel, interval_ns, age_ns
} });

impl EdgeTimer {
    /// Timer of an encoder with `per_count` axis units per count, times 2^24; negative if it counts
    /// backwards.
    pub const fn new(per_count: i64) -> Self {
        let (half_mantissa, half_exponent) = Factor::of(per_count.unsigned_abs())
            .times(Factor::of(500_000_000))
            .shifted(-24)
            .parts();
        Self {
            half_mantissa,
            half_exponent,
            reversed: per_count < 0,
            edge_time_ns: 0,
            edge: 0,
            edge_known: false,
            travel: 0,
            interval_ns: 0,
            age_ns: 0,
        }
    }

    /// Restarts with the last edge at this time and an unknown position.
    pub const fn begin(&mut self, edge_time_ns: u32) {
        self.edge_time_ns = edge_time_ns;
    }

    /// Records a period: `moved` counts since the previous one, up to `counts`; the time of the
    /// last edge and the present time, in nanoseconds.
    #[inline]
    pub const fn note(&mut self, moved: i32, counts: i32, edge_time_ns: u32, time_ns: u32) {
        let interval = edge_time_ns.wrapping_sub(self.edge_time_ns);
        let age = time_ns.wrapping_sub(edge_time_ns);
        self.age_ns = age;
        if moved != 0 || interval != 0 {
            // The last edge is half a count behind the count, seen in its direction. With a net
            // motion of zero the edges were crossed back and forth about the last edge position.
            let edge = if moved == 0 {
                self.edge
            } else {
                counts.wrapping_shl(1).wrapping_sub((moved >> 31) | 1)
            };
            // Two edges at the same time give no rate.
            if interval != 0 {
                self.travel = if self.edge_known {
                    edge.wrapping_sub(self.edge)
                } else {
                    0
                };
                self.interval_ns = interval;
            }
            self.edge = edge;
            self.edge_time_ns = edge_time_ns;
            self.edge_known = true;
            self.age_ns = 0;
        }
        // An edge between the reading of the clock and the reading of its time is new, not four
        // seconds old.
        if age >= STALE_NS && age < AHEAD_NS {
            self.edge_known = false;
            self.travel = 0;
        }
    }

    /// The rate at the last reading.
    #[must_use]
    pub fn rate(&self) -> Rate {
        if self.travel == 0 {
            return Rate(0);
        }
        let rate = self.rate_over(self.travel, self.interval_ns);
        // One count in this interval is valid until another interval is over.
        let valid_ns = if self.travel.unsigned_abs() <= 2 {
            self.interval_ns
        } else {
            0
        };
        if self.age_ns <= valid_ns {
            return Rate(rate);
        }
        let bound = self.rate_over(2, self.age_ns).saturating_abs();
        Rate(rate.min(bound).max(-bound))
    }

    /// Rate in au/s of `half_counts` in `interval_ns` nanoseconds.
    #[inline(never)]
    fn rate_over(&self, half_counts: i32, interval_ns: u32) -> i32 {
        let (mantissa, exponent) = Reciprocal::new(interval_ns).parts();
        // Au/s of one half count, 29 bits at least; a mantissa of 2^31 counts as 2^31 - 1.
        let one = high(self.half_mantissa, mantissa.min(i32::MAX as u32) as i32);
        let product = i64::from(half_counts) * i64::from(one);
        // product * 2^(32 + half_exponent - exponent); the exponents are within +-100.
        let shift = (exponent as i32)
            .wrapping_sub(32)
            .wrapping_sub(self.half_exponent);
        let rate = if (0..64).contains(&shift) {
            saturate(shift_right(product, shift as u32))
        } else if shift > 0 {
            0
        } else {
            // Intervals of less than a microsecond.
            saturate(product.saturating_mul(1 << (-shift).min(62)))
        };
        if self.reversed {
            rate.saturating_neg()
        } else {
            rate
        }
    }
}
