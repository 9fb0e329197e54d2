//! Three 74HC165 and a 74HC595 at four pins, as the wiring of docs/hardware/pico2-encoders.md has
//! them.

/// Pins, as in `firmware/boards/pico2/src/chain.rs`.
const LATCH: u32 = 1;
const CLOCK: u32 = 26;
const DATA_OUT: u32 = 27;
/// Pin that QH of the first 74HC165 drives.
pub const DATA_IN: u32 = 28;

/// Number of the inputs.
const INPUTS: u32 = 24;
const ALL: u32 = (1 << INPUTS) - 1;

/// Wires that are cut. The pin of the board at one is pulled up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cuts {
    /// The clock: the level that the chips see.
    pub clock: Option<bool>,
    /// The latch: the level that the chips see.
    pub latch: Option<bool>,
    /// Data from the board.
    pub data_out: bool,
    /// Data to the board.
    pub data_in: bool,
}

/// The chips.
#[derive(Debug, Clone, Default)]
pub struct Chain {
    /// Levels of the inputs: A to H of the third 74HC165 from bit 0, of the second one from bit 8,
    /// of the first one from bit 16.
    pub inputs: u32,
    /// Levels of the outputs, QA from bit 0.
    pub outputs: u8,
    /// Cut wires.
    pub cuts: Cuts,
    /// Levels of clock and latch.
    clock: bool,
    latch: bool,
    /// Registers of the 74HC165 and of the 74HC595.
    loaded: u32,
    shifted: u8,
    /// Transfers: falls and rises of the latch after a clock.
    pub transfers: u64,
    clocked: bool,
}

impl Chain {
    /// Follows the pins of the board. Returns the level of [`DATA_IN`].
    pub fn follow(&mut self, pins: u32) -> bool {
        let level = |pin: u32| pins >> pin & 1 != 0;
        let clock = self.cuts.clock.unwrap_or_else(|| level(CLOCK));
        let latch = self.cuts.latch.unwrap_or_else(|| level(LATCH));
        let data = level(DATA_OUT) && !self.cuts.data_out;
        if clock && !self.clock {
            // SER of the third chip is high. A 74HC165 whose SH/LD is low does not shift.
            self.loaded = (self.loaded << 1 | 1) & ALL;
            self.shifted = self.shifted << 1 | u8::from(data);
            self.clocked = true;
        }
        if latch && !self.latch {
            self.outputs = self.shifted;
            self.transfers += u64::from(self.clocked);
            self.clocked = false;
        }
        if !latch {
            self.loaded = self.inputs & ALL;
        }
        (self.clock, self.latch) = (clock, latch);
        self.cuts.data_in || self.loaded >> (INPUTS - 1) & 1 != 0
    }
}
