//! Quadrature x4 decoding, for boards without a timer that decodes, and for simulated encoders.
//!
//! The decoder runs at every edge (or sample), in a capture interrupt or in a simulated device. The
//! control period only reads the counters. Counts are raw and wrap around; [`super::encoder`]
//! scales them.
//!
//! Forward is channel A leading B: (A, B) = 00, 10, 11, 01, 00. If both channels change in one
//! transition, its direction is unknown. Such a transition is counted as illegal, and the position
//! may then be wrong by 2 counts.
//!
//! Callers should sample at every edge: sampling at a fixed rate limits the speed to one count per
//! sample.

use crate::io::JointInputs;

/// Both channels changed.
const ILLEGAL: i8 = 2;

/// Change of the count for each (old A, old B, new A, new B).
const TABLE: [i8; 16] = [
    0, -1, 1, ILLEGAL, // from 00
    1, 0, ILLEGAL, -1, // from 01
    -1, ILLEGAL, 0, 1, // from 10
    ILLEGAL, 1, -1, 0, // from 11
];

/// Decoder of one encoder with index.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Quadrature {
    /// Levels of A and B; `None` before the first sample.
    levels: Option<u8>,
    index: bool,
    counts: i32,
    edge_time_ns: u32,
    illegal: u16,
    index_counts: i32,
    index_pulses: u8,
}

impl Quadrature {
    /// A decoder at the given count; its first sample sets the initial levels.
    pub const fn new(counts: i32) -> Self {
        Self {
            levels: None,
            index: false,
            counts,
            edge_time_ns: 0,
            illegal: 0,
            index_counts: 0,
            index_pulses: 0,
        }
    }

    /// Processes the levels of both channels and of the index at `time_ns` of the free-running
    /// clock.
    ///
    /// The index latches the count at its rising edge, after the count of this sample. In the other
    /// direction that edge is the other end of the pulse, so an index one count wide repeats within
    /// 1 count.
    #[inline]
    pub fn feed(&mut self, a: bool, b: bool, index: bool, time_ns: u32) {
        let levels = u8::from(a) << 1 | u8::from(b);
        let Some(before) = self.levels.replace(levels) else {
            self.index = index;
            return;
        };
        // Both operands are below 4, so the table index is below 16.
        match TABLE[usize::from((before << 2 | levels) & 15)] {
            0 => {}
            ILLEGAL => self.illegal = self.illegal.wrapping_add(1),
            step => {
                self.counts = self.counts.wrapping_add(i32::from(step));
                self.edge_time_ns = time_ns;
            }
        }
        if index && !self.index {
            self.index_counts = self.counts;
            self.index_pulses = self.index_pulses.wrapping_add(1);
        }
        self.index = index;
    }

    /// The count.
    pub const fn counts(&self) -> i32 {
        self.counts
    }

    /// Illegal transitions, free-running.
    pub const fn illegal(&self) -> u16 {
        self.illegal
    }

    /// Writes the encoder's state into the inputs of its joint and leaves the other fields
    /// unchanged.
    pub fn latch(&self, inputs: &mut JointInputs) {
        inputs.counts = self.counts;
        inputs.edge_time_ns = self.edge_time_ns;
        inputs.illegal = self.illegal;
        inputs.index_counts = self.index_counts;
        inputs.index_pulses = self.index_pulses;
    }
}
