//! From counts and edge times to the coordinate and the rate of the motor side of a joint.
//!
//! The coordinate is computed from the whole count every time, never summed up, so it cannot drift: it is within half an axis unit of
//! the exact product. A linear joint saturates at the ends of [`Coordinate`]; a rotary one wraps around at the turn.
//!
//! The rate is counts over the time *between edges*, not counts per period. At 4 mm/s with 1.25 um counts there is an edge every
//! 312 us: counts per 200 us period would read 0 or 6.25 mm/s; the time between two edges, known to 1 ns (a timer at 168 MHz: 6 ns),
//! gives 4 mm/s within 0.00003 (0.0002) mm/s. Its age is half the time between edges. With no new edge the rate is bounded by one count per time since
//! the last edge, so that it goes to zero by itself when the motion ends, and is zero after 2.1 s.
//! An edge that is crossed back and forth is one place: a reversal reads as zero, not as a count.
//!
//! Misuse: more than 2^31 counts in a period cannot be told from a step the other way, and more than 2^30 give a wrong rate.

use super::reciprocal::{Factor, Reciprocal, high, saturate};
use crate::config::AxisKind;
use crate::io::AxisInputs;
use crate::safety::integrity::constants;
use crate::units::scale::{product, shift_right, total};
use crate::units::{Coordinate, Rate};

/// After this long without an edge the joint is at rest: half of the range of the clock.
const STALE_NS: u32 = 1 << 31;

/// Encoder of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Encoder {
    kind: AxisKind,
    /// Axis units per count, Q24.
    per_count: i64,
    /// So many counts are within the range of a coordinate.
    most: u32,
    /// Half a count in au/s * ns: `mantissa * 2^exponent`, with the sign of `per_count`.
    half_mantissa: i32,
    half_exponent: i32,
    /// Nothing was read yet.
    fresh: bool,
    raw: i32,
    counts: i64,
    reference_counts: i64,
    reference: Coordinate,
    illegal_raw: u16,
    illegal: u32,
    index_pulses: u8,
    edge_time_ns: u32,
    /// Place of the last edge, in half counts; wraps around.
    edge: i32,
    /// `edge_time_ns` and `edge` belong to an edge that was seen, not too long ago.
    edge_known: bool,
    rate: i32,
    /// Age of the last edge up to which the rate cannot be too large.
    believed_ns: u32,
}

constants!(Encoder {
    kind, per_count, most, half_mantissa, half_exponent
} of {} but {
    fresh, raw, counts, reference_counts, reference, illegal_raw, illegal, index_pulses, edge_time_ns, edge, edge_known, rate, believed_ns
});

/// What an encoder says at the start of a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Measured {
    /// Coordinate of the motor side.
    pub coordinate: Coordinate,
    /// Rate of the motor side.
    pub rate: Rate,
    /// Counts since the period before.
    pub moved: i32,
    /// Counter at a new index pulse, raw, and the motor's coordinate there.
    pub index: Option<(i32, Coordinate)>,
}

impl Encoder {
    /// An encoder with `per_count` axis units a count, times 2^24; negative when it counts backwards.
    pub const fn new(kind: AxisKind, per_count: i64) -> Self {
        let size = per_count.unsigned_abs();
        let (half_mantissa, half_exponent) = Factor::of(size)
            .times(Factor::of(500_000_000))
            .shifted(-24)
            .parts();
        let most = match (1_u64 << 55).checked_div(size) {
            Some(most) => most,
            None => u64::MAX,
        };
        Self {
            kind,
            per_count,
            most: if most > u32::MAX as u64 {
                u32::MAX
            } else {
                most as u32
            },
            half_mantissa,
            half_exponent,
            fresh: true,
            raw: 0,
            counts: 0,
            reference_counts: 0,
            reference: Coordinate(0),
            illegal_raw: 0,
            illegal: 0,
            index_pulses: 0,
            edge_time_ns: 0,
            edge: 0,
            edge_known: false,
            rate: 0,
            believed_ns: 0,
        }
    }

    /// Reads the inputs of a period that were latched at `time_ns`. The first reading is the start: nothing has moved.
    #[inline]
    pub fn read(&mut self, inputs: &AxisInputs, time_ns: u32) -> Measured {
        if self.fresh {
            self.fresh = false;
            self.raw = inputs.counts;
            self.counts = i64::from(inputs.counts);
            self.reference_counts = self.counts;
            self.illegal_raw = inputs.illegal;
            self.index_pulses = inputs.index_pulses;
            self.edge_time_ns = inputs.edge_time_ns;
        }
        let moved = inputs.counts.wrapping_sub(self.raw);
        self.raw = inputs.counts;
        self.counts = self.counts.wrapping_add(i64::from(moved));
        let illegal = inputs.illegal.wrapping_sub(self.illegal_raw);
        self.illegal_raw = inputs.illegal;
        self.illegal = self.illegal.saturating_add(u32::from(illegal));
        self.estimate(moved, inputs.edge_time_ns, time_ns);
        let index = if inputs.index_pulses == self.index_pulses {
            None
        } else {
            self.index_pulses = inputs.index_pulses;
            Some((inputs.index_counts, self.coordinate_at(inputs.index_counts)))
        };
        Measured {
            coordinate: self.coordinate_of(self.counts),
            rate: Rate(self.rate),
            moved,
            index,
        }
    }

    /// The motor's coordinate at a raw count, which lies less than 2^31 counts from the present one.
    pub fn coordinate_at(&self, raw: i32) -> Coordinate {
        self.coordinate_of(self.extended(raw))
    }

    /// From now on the motor's coordinate at the raw count `raw` is `coordinate`. Gives what has to be added to every coordinate that was known before.
    pub fn set_reference(&mut self, raw: i32, coordinate: Coordinate) -> Coordinate {
        let before = self.coordinate_of(self.counts);
        self.reference_counts = self.extended(raw);
        self.reference = coordinate;
        difference(self.kind, self.coordinate_of(self.counts), before)
    }

    /// Counts of the encoder, extended to 64 bits.
    pub const fn counts(&self) -> i64 {
        self.counts
    }

    /// Illegal transitions since [`Encoder::clear_illegal`].
    pub const fn illegal(&self) -> u32 {
        self.illegal
    }

    /// Forgets the illegal transitions.
    pub const fn clear_illegal(&mut self) {
        self.illegal = 0;
    }

    const fn extended(&self, raw: i32) -> i64 {
        self.counts.wrapping_sub(self.raw.wrapping_sub(raw) as i64)
    }

    #[inline]
    fn coordinate_of(&self, counts: i64) -> Coordinate {
        let counts = counts.wrapping_sub(self.reference_counts);
        match self.kind {
            AxisKind::Linear => {
                let word = counts as i32;
                if i64::from(word) != counts || word.unsigned_abs() > self.most {
                    return self.far(counts);
                }
                let travel = total(product(counts, self.per_count), 1 << 23) >> 24;
                Coordinate(saturate(total(travel, i64::from(self.reference.0))))
            }
            AxisKind::Rotary => {
                let travel = counts.wrapping_mul(self.per_count).wrapping_add(1 << 23) >> 24;
                Coordinate((travel as i32).wrapping_add(self.reference.0))
            }
        }
    }

    /// A linear coordinate that may be out of its range: a product that saturates at 2^63 is 2^39 axis units, far outside, and saturates as it should.
    #[cold]
    #[inline(never)]
    fn far(&self, counts: i64) -> Coordinate {
        let travel = counts
            .saturating_mul(self.per_count)
            .saturating_add(1 << 23)
            >> 24;
        Coordinate(saturate(travel.saturating_add(i64::from(self.reference.0))))
    }

    /// Brings `rate` up to date.
    #[inline]
    fn estimate(&mut self, moved: i32, edge_time_ns: u32, time_ns: u32) {
        let edge_seen = moved != 0 || edge_time_ns != self.edge_time_ns;
        if edge_seen {
            // Place of the last edge: half a count behind the count, seen in its direction. With a net motion of zero the edges were
            // crossed back and forth about the place of the last one.
            let edge = match moved.signum() {
                0 => self.edge,
                sign => (self.counts as i32).wrapping_shl(1).wrapping_sub(sign),
            };
            let interval = edge_time_ns.wrapping_sub(self.edge_time_ns);
            if !self.edge_known {
                self.rate = 0;
            } else if interval != 0 {
                let travel = edge.wrapping_sub(self.edge);
                self.rate = self.rate_of(travel, interval);
                // One count in this interval is not to be doubted before another interval is over.
                self.believed_ns = if travel.unsigned_abs() <= 2 {
                    interval
                } else {
                    0
                };
            }
            self.edge = edge;
            self.edge_time_ns = edge_time_ns;
            self.edge_known = true;
        }
        let age = time_ns.wrapping_sub(self.edge_time_ns);
        if age >= STALE_NS {
            self.edge_known = false;
            self.rate = 0;
        } else if !edge_seen && self.rate != 0 && age > self.believed_ns {
            let bound = self.rate_of(2, age).saturating_abs();
            self.rate = self.rate.min(bound).max(-bound);
        }
    }

    /// au/s of some half counts in some nanoseconds.
    #[inline]
    fn rate_of(&self, half_counts: i32, interval_ns: u32) -> i32 {
        let (mantissa, exponent) = Reciprocal::new(interval_ns).parts();
        // Au/s of one half count, 29 bits at least; a mantissa of 2^31 is taken for a hair less.
        let one = high(self.half_mantissa, mantissa.min(i32::MAX as u32) as i32);
        let product = i64::from(half_counts) * i64::from(one);
        // product * 2^(32 + half_exponent - exponent); the exponents are within +-100.
        let shift = (exponent as i32)
            .wrapping_sub(32)
            .wrapping_sub(self.half_exponent);
        let magnitude = if (0..64).contains(&shift) {
            saturate(shift_right(product, shift as u32))
        } else {
            Self::fast(product, shift)
        };
        if self.per_count < 0 {
            magnitude.saturating_neg()
        } else {
            magnitude
        }
    }

    /// A rate of intervals of less than a microsecond.
    #[cold]
    #[inline(never)]
    fn fast(product: i64, shift: i32) -> i32 {
        if shift > 0 {
            0
        } else {
            saturate(product.saturating_mul(1 << (-shift).min(62)))
        }
    }
}

/// `a - b`: saturates on a linear axis, the shorter way round on a rotary one.
#[inline]
pub(crate) fn difference(kind: AxisKind, a: Coordinate, b: Coordinate) -> Coordinate {
    Coordinate(match kind {
        AxisKind::Linear => a.0.saturating_sub(b.0),
        AxisKind::Rotary => a.0.wrapping_sub(b.0),
    })
}

/// `a + b`, likewise.
#[inline]
pub(crate) fn sum(kind: AxisKind, a: Coordinate, b: Coordinate) -> Coordinate {
    Coordinate(match kind {
        AxisKind::Linear => a.0.saturating_add(b.0),
        AxisKind::Rotary => a.0.wrapping_add(b.0),
    })
}
