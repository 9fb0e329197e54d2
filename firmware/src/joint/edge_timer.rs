//! The rate of an encoder: counts over the time *between edges*, not counts per period.
//!
//! At 4 mm/s with 1.25 um counts there is an edge every
//! 312 us: counts per 200 us period would read 0 or 6.25 mm/s; the time between two edges, known to 1 ns (a timer at 168 MHz: 6 ns),
//! gives 4 mm/s within 0.00003 (0.0002) mm/s. Its age is half the time between edges. With no new edge the rate is bounded by one count per time since
//! the last edge, so that it goes to zero by itself when the motion ends, and is zero after 2.1 s.
//! An edge that is crossed back and forth is one place: a reversal reads as zero, not as a count.
//!
//! Every period notes its edges ([`EdgeTimer::note`]); the rate itself, which needs a reciprocal, is worked out for whoever asks.
//!
//! Misuse: more than 2^30 counts in a period give a wrong rate.

use crate::config::digest::constants;
use haptimill_math::Rate;
use haptimill_math::reciprocal::{Factor, Reciprocal, high, saturate};
use haptimill_math::scale::shift_right;

/// After this long without an edge the joint is at rest: half of the range of the clock.
const STALE_NS: u32 = 1 << 31;

/// From here on an age is that of an edge that came up to a millisecond after the clock was read. Older ones were [stale](STALE_NS) long before.
const AHEAD_NS: u32 = u32::MAX - 999_999;

/// The last two places at which edges were seen, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EdgeTimer {
    /// Half a count in au/s * ns: `mantissa * 2^exponent`, of the magnitude of a count.
    half_mantissa: i32,
    half_exponent: i32,
    /// Counts go down where the coordinate goes up.
    reversed: bool,
    edge_time_ns: u32,
    /// Place of the last edge, in half counts; wraps around.
    edge: i32,
    /// `edge_time_ns` and `edge` belong to an edge that was seen, not too long ago.
    edge_known: bool,
    /// From the edge before to the last one: half counts, and nanoseconds. No travel is no rate.
    travel: i32,
    interval_ns: u32,
    /// How long ago the last edge was at the last reading, if that brought none.
    age_ns: u32,
}

constants!(EdgeTimer { half_mantissa, half_exponent, reversed } of {} but {
    edge_time_ns, edge, edge_known, travel, interval_ns, age_ns
});

impl EdgeTimer {
    /// Of an encoder with `per_count` axis units a count, times 2^24; negative when it counts backwards.
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

    /// Whatever was before: the last edge was at this time, where is not known.
    pub const fn begin(&mut self, edge_time_ns: u32) {
        self.edge_time_ns = edge_time_ns;
    }

    /// Takes the readings of a period: so many counts since the last one, to `counts`; when the last edge was, and when it is now.
    #[inline]
    pub const fn note(&mut self, moved: i32, counts: i32, edge_time_ns: u32, time_ns: u32) {
        let interval = edge_time_ns.wrapping_sub(self.edge_time_ns);
        let age = time_ns.wrapping_sub(edge_time_ns);
        self.age_ns = age;
        if moved != 0 || interval != 0 {
            // Place of the last edge: half a count behind the count, seen in its direction. With a net motion of zero the edges were
            // crossed back and forth about the place of the last one.
            let edge = if moved == 0 {
                self.edge
            } else {
                counts.wrapping_shl(1).wrapping_sub((moved >> 31) | 1)
            };
            // Two edges at one time say nothing of a rate.
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
        // An edge between the reading of the clock and that of its time is one of now, not one of four seconds ago.
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
        let rate = self.over(self.travel, self.interval_ns);
        // One count in this interval is not to be doubted before another interval is over.
        let believed = if self.travel.unsigned_abs() <= 2 {
            self.interval_ns
        } else {
            0
        };
        if self.age_ns <= believed {
            return Rate(rate);
        }
        let bound = self.over(2, self.age_ns).saturating_abs();
        Rate(rate.min(bound).max(-bound))
    }

    /// au/s of some half counts in some nanoseconds.
    #[inline(never)]
    fn over(&self, half_counts: i32, interval_ns: u32) -> i32 {
        let (mantissa, exponent) = Reciprocal::new(interval_ns).parts();
        // Au/s of one half count, 29 bits at least; a mantissa of 2^31 is taken for a hair less.
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
