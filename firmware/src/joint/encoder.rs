//! Conversion of encoder counts to the motor coordinate of a joint.
//!
//! The coordinate is computed from the whole count every time, never accumulated, so it cannot
//! drift. It is within half an axis unit of the exact product. A linear joint saturates at the ends
//! of [`Coordinate`]; a rotary one wraps around at the turn. The rate comes from the times between
//! edges ([`super::edge_timer`]).
//!
//! Limit: more than 2^31 counts in a period look like motion in the opposite direction.

use super::edge_timer::EdgeTimer;
use crate::config::AxisKind;
use crate::digest::impl_digest;
use crate::io::JointInputs;
use haptimill_math::reciprocal::saturate;
use haptimill_math::{Coordinate, Rate};

/// Encoder of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Encoder {
    kind: AxisKind,
    /// Axis units per count, Q24.
    per_count: i64,
    /// Whole axis units per count, and the fraction, Q24.
    whole: i32,
    part: i32,
    /// Largest magnitude of a count whose product fits into 32 bits; on an axis of one turn the
    /// product may wrap around.
    max: u32,
    /// No inputs were read yet.
    fresh: bool,
    raw: i32,
    /// Counts from the position whose coordinate is `reference`.
    travelled: i64,
    reference: Coordinate,
    illegal_raw: u16,
    illegal: u32,
    index_pulses: u8,
    edges: EdgeTimer,
}

impl_digest!(Encoder { fields {
    kind, per_count, whole, part, max
}, nested { edges }, skip {
    fresh, raw, travelled, reference, illegal_raw, illegal, index_pulses
} });

/// Reading of an encoder at the start of a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Measured {
    /// Coordinate of the motor.
    pub coordinate: Coordinate,
    /// Counts since the previous period.
    pub moved: i32,
    /// Raw count at a new index pulse, and the motor coordinate there.
    pub index: Option<(i32, Coordinate)>,
}

impl Encoder {
    /// An encoder with `per_count` axis units per count, times 2^24; negative if it counts
    /// backwards.
    pub const fn new(kind: AxisKind, per_count: i64) -> Self {
        let whole = per_count >> 24;
        let fits = whole as i32 as i64 == whole;
        let max = match (kind, fits) {
            (_, false) => 0,
            (AxisKind::Rotary, true) => 1 << 31,
            // One unit of room for the rounding.
            (AxisKind::Linear | AxisKind::MultiTurn, true) => {
                match (((1_u64 << 31) - 2) << 24).checked_div(per_count.unsigned_abs()) {
                    Some(max) if max < 1 << 31 => max as u32,
                    _ => 1 << 31,
                }
            }
        };
        Self {
            kind,
            per_count,
            whole: whole as i32,
            part: (per_count & 0xff_ffff) as i32,
            max,
            fresh: true,
            raw: 0,
            travelled: 0,
            reference: Coordinate(0),
            illegal_raw: 0,
            illegal: 0,
            index_pulses: 0,
            edges: EdgeTimer::new(per_count),
        }
    }

    /// Reads the inputs of a period, latched at `time_ns`. The first reading is the start and shows
    /// no motion.
    #[inline]
    pub fn read(&mut self, inputs: &JointInputs, time_ns: u32) -> Measured {
        if self.fresh {
            self.begin(inputs);
        }
        let moved = inputs.counts.wrapping_sub(self.raw);
        self.raw = inputs.counts;
        self.travelled = self.travelled.wrapping_add(i64::from(moved));
        if inputs.illegal != self.illegal_raw {
            self.count_illegal(inputs.illegal);
        }
        self.edges
            .note(moved, inputs.counts, inputs.edge_time_ns, time_ns);
        let index = if inputs.index_pulses == self.index_pulses {
            None
        } else {
            self.index_pulses = inputs.index_pulses;
            Some((inputs.index_counts, self.coordinate_at(inputs.index_counts)))
        };
        Measured {
            coordinate: self.coordinate_of(self.travelled),
            moved,
            index,
        }
    }

    #[cold]
    #[inline(never)]
    fn begin(&mut self, inputs: &JointInputs) {
        self.fresh = false;
        self.raw = inputs.counts;
        self.travelled = 0;
        self.illegal_raw = inputs.illegal;
        self.index_pulses = inputs.index_pulses;
        self.edges.begin(inputs.edge_time_ns);
    }

    #[cold]
    #[inline(never)]
    fn count_illegal(&mut self, raw: u16) {
        let illegal = raw.wrapping_sub(self.illegal_raw);
        self.illegal_raw = raw;
        self.illegal = self.illegal.saturating_add(u32::from(illegal));
    }

    /// Rate of the motor at the last reading.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.edges.rate()
    }

    /// The motor coordinate at a raw count. The raw count must be less than 2^31 counts from the
    /// present one.
    #[inline(never)]
    pub fn coordinate_at(&self, raw: i32) -> Coordinate {
        self.coordinate_of(self.travelled.wrapping_sub(self.ahead_of(raw)))
    }

    /// Sets the motor coordinate at the raw count `raw` to `coordinate`. Returns the shift of every
    /// coordinate that was known before.
    pub fn set_reference(&mut self, raw: i32, coordinate: Coordinate) -> Coordinate {
        let before = self.coordinate_at(self.raw);
        self.travelled = self.ahead_of(raw);
        self.reference = coordinate;
        difference(self.kind, self.coordinate_at(self.raw), before)
    }

    /// Illegal transitions since [`Encoder::clear_illegal`]; [`u32::MAX`] if the encoder is
    /// [invalid](Encoder::invalidate).
    pub const fn illegal(&self) -> u32 {
        self.illegal
    }

    /// Marks the counts as wrong, which outranks any number of illegal transitions.
    pub const fn invalidate(&mut self) {
        self.illegal = u32::MAX;
    }

    /// Takes over the illegal transitions that were counted under another configuration.
    pub const fn take_over_illegal(&mut self, illegal: u32) {
        self.illegal = illegal;
    }

    /// Clears the illegal transitions.
    pub const fn clear_illegal(&mut self) {
        self.illegal = 0;
    }

    /// Counts from the raw count `raw` to the present one.
    const fn ahead_of(&self, raw: i32) -> i64 {
        self.raw.wrapping_sub(raw) as i64
    }

    #[inline(always)]
    fn coordinate_of(&self, counts: i64) -> Coordinate {
        let word = counts as i32;
        // 32-bit operands: with 64-bit ones the product would be 64 by 64 bits.
        if (counts >> 32) as i32 != word >> 31 || word.unsigned_abs() > self.max {
            return self.coordinate_wide(counts);
        }
        // A 32-bit number times 24 bits.
        let part = (i64::from(word) * i64::from(self.part)).wrapping_add(1 << 23) >> 24;
        let travel = word.wrapping_mul(self.whole).wrapping_add(part as i32);
        sum(self.kind, Coordinate(travel), self.reference)
    }

    /// A coordinate that may be out of its range. A product that saturates at 2^63 is 2^39 axis
    /// units, far out of range, and saturates as required. A rotary coordinate wraps around.
    #[cold]
    #[inline(never)]
    fn coordinate_wide(&self, counts: i64) -> Coordinate {
        match self.kind {
            AxisKind::Linear | AxisKind::MultiTurn => {
                let travel = counts
                    .saturating_mul(self.per_count)
                    .saturating_add(1 << 23)
                    >> 24;
                Coordinate(saturate(travel.saturating_add(i64::from(self.reference.0))))
            }
            AxisKind::Rotary => {
                let travel = counts.wrapping_mul(self.per_count).wrapping_add(1 << 23) >> 24;
                Coordinate((travel as i32).wrapping_add(self.reference.0))
            }
        }
    }
}

/// `a - b`; saturates, but takes the shorter way round on an axis of one turn.
#[inline]
pub(crate) fn difference(kind: AxisKind, a: Coordinate, b: Coordinate) -> Coordinate {
    Coordinate(if kind.is_circular() {
        a.0.wrapping_sub(b.0)
    } else {
        a.0.saturating_sub(b.0)
    })
}

/// `a + b`; saturates, but wraps around on an axis of one turn.
#[inline]
pub(crate) fn sum(kind: AxisKind, a: Coordinate, b: Coordinate) -> Coordinate {
    Coordinate(if kind.is_circular() {
        a.0.wrapping_add(b.0)
    } else {
        a.0.saturating_add(b.0)
    })
}
