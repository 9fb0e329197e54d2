//! Counter of an incremental encoder in a programmable I/O block (PIO of the RP2350), with the time
//! of the last edge. The program has 30 of the 32 instructions of a block, whose four state
//! machines share it.
//!
//! A state machine samples both channels every 9 cycles, and every 13 cycles after an edge, and
//! offers a word after each sample:
//!
//! | bits | |
//! | --- | --- |
//! | 0 to 15 | turns of the program since the last edge, complemented |
//! | 16 to 31 | counts, lower half |
//!
//! The processor empties the FIFO, and takes the first word after that: its counts are those of
//! this moment. Forward is channel A leading B: (A, B) = 00, 10, 11, 01, 00. A transition of both
//! channels at once is not counted.
//!
//! `y` has the counts, `x` the turns, and the output shift register the last levels. Levels of
//! before and now make the address of the next instruction:
//!
//! ```text
//!     jmp same         00 -> 00, B first
//!     jmp up           00 -> 01
//!     jmp down         00 -> 10
//!     jmp same         00 -> 11, both
//!     jmp down         01 -> 00
//!     jmp same
//!     jmp same         01 -> 10, both
//!     jmp up           01 -> 11
//!     jmp up           10 -> 00
//!     jmp same         10 -> 01, both
//!     jmp same
//!     jmp down         10 -> 11
//!     jmp same         11 -> 00, both
//!     jmp down         11 -> 01
//!     jmp up           11 -> 10
//!     jmp same
//! same:
//!     jmp x--, offer
//! .wrap_target
//! offer:
//!     in y, 16
//!     in x, 16
//!     push noblock
//!     out isr, 2       levels of before
//!     in pins, 2
//!     mov osr, isr
//!     mov pc, isr
//! up:
//!     mov y, ~y
//!     jmp y--, next
//! next:
//!     mov y, ~y
//!     jmp edge
//! down:
//!     jmp y--, edge [3]
//! edge:
//!     mov x, ~null
//! .wrap
//! ```

use crate::counter::extended;

/// The program above, assembled for the address 0, which it needs.
pub const PROGRAM: [u16; 30] = [
    SAME, UP, DOWN, SAME, DOWN, SAME, SAME, UP, UP, SAME, SAME, DOWN, SAME, DOWN, UP, SAME,   //
    0x0051, // jmp x--, 17
    0x4050, // in y, 16
    0x4030, // in x, 16
    0x8000, // push noblock
    0x60C2, // out isr, 2
    0x4002, // in pins, 2
    0xA0E6, // mov osr, isr
    0xA0A6, // mov pc, isr
    0xA04A, // mov y, ~y
    0x009A, // jmp y--, 26
    0xA04A, // mov y, ~y
    0x001D, // jmp 29
    0x039D, // jmp y--, 29     [3]
    0xA02B, // mov x, ~null
];

const SAME: u16 = 16;
const UP: u16 = 24;
const DOWN: u16 = 28;

/// Addresses of the last instruction before the program begins again, and of the one after it.
pub const WRAP: (u32, u32) = (29, 17);

/// Instructions that a state machine executes before it starts: counts 0, the last edge now, the
/// present levels.
pub const START: [u16; 4] = [
    0xA043, // mov y, null
    0xA02B, // mov x, ~null
    0xA0E0, // mov osr, pins
    0x0011, // jmp 17
];

/// Time of a turn without an edge, ns: 9 cycles of 150 MHz.
const TURN_NS: u32 = 60;

/// Time from an edge at the pins to the moment at which the FIFO is emptied, if the first word
/// after that has no turn, ns: 13 cycles. Two of them are those of the input synchroniser; the rest
/// is the mean over the moments of a turn, which are 60 ns about it.
const LATENCY_NS: u32 = 87;

/// Turns by which the turns of two words may differ from the time between them.
const SLACK: u16 = 3;

/// An encoder as the processor sees it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EncoderCount {
    counts: i32,
    edge_time_ns: u32,
    /// Turns and time of the last word.
    turns: u16,
    time_ns: u32,
}

impl EncoderCount {
    /// Counts 0, and the last edge at the time 0.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            counts: 0,
            edge_time_ns: 0,
            turns: 0,
            time_ns: 0,
        }
    }

    /// Adds the first word after the FIFO was emptied, at a time of a clock that wraps around.
    ///
    /// The turns wrap around after 3.9 ms. The time of the edge is right as long as there are less
    /// than 3.9 ms and 2^15 counts from one word to the next.
    pub const fn add(&mut self, word: u32, time_ns: u32) {
        let before = self.counts;
        self.counts = extended(before, (word >> 16) as u16);
        let turns = !(word as u16);
        // Without an edge the turns go on with the time.
        let passed = (time_ns.wrapping_sub(self.time_ns) / TURN_NS) as u16;
        let expected = self.turns.wrapping_add(passed);
        let is_new = turns.wrapping_sub(expected).wrapping_add(SLACK) > 2 * SLACK;
        if self.counts != before || is_new {
            let age = turns as u32 * TURN_NS + LATENCY_NS;
            self.edge_time_ns = time_ns.wrapping_sub(age);
        }
        self.turns = turns;
        self.time_ns = time_ns;
    }

    /// The counts, which wrap around.
    #[must_use]
    pub const fn counts(&self) -> i32 {
        self.counts
    }

    /// Time of the last edge, ns.
    #[must_use]
    pub const fn edge_time_ns(&self) -> u32 {
        self.edge_time_ns
    }
}
