//! Switches, digital inputs and outputs over shift registers
//! ([`shift_chain`](haptimill_board_common::shift_chain)), and the spindle.
//!
//! | pin | direction | |
//! | --- | --- | --- |
//! | GP0 | out | spindle speed, PWM |
//! | GP1 | out | latch of the shift registers |
//! | GP15 to GP22 | in | [`encoders`](crate::encoders) |
//! | GP26 | out | clock of the shift registers |
//! | GP27 | out | data to them |
//! | GP28 | in | data from them |
//!
//! Each control period starts a transfer. Its inputs are those of the next control period.

use crate::pins;
use crate::registers::{PIO, read, set, write};
use haptimill_board_common::shift_chain::{Inputs, ORIGIN, PROGRAM, TRANSFER, WRAP, outputs};
use haptimill_drivers::input_filter::InputFilter;

const LATCH: u32 = 1;
const CLOCK: u32 = 26;
const DATA_OUT: u32 = 27;
const DATA_IN: u32 = 28;

/// Pin of the spindle speed.
pub const SPINDLE_SPEED: u32 = 0;
/// Pins of the inputs, those of the encoders too.
pub const INPUTS: &[u32] = &[15, 16, 17, 18, 19, 20, 21, 22, DATA_IN];
/// Outputs that no PIO block drives: none.
pub const OUTPUTS: &[u32] = &[];

/// Block of the state machine, its number, and its registers.
const BLOCK: usize = 1;
const MACHINE: usize = 1;
const OWN: usize = 0xC8 + 0x18 * MACHINE;
const SEND: usize = 0x10 + 4 * MACHINE;
const RECEIVE: usize = 0x20 + 4 * MACHINE;

/// Control periods that a new level must last.
const SAMPLES: u8 = 3;

/// Levels of the inputs after the noise filter.
#[derive(Clone, Copy)]
pub struct Levels(Inputs);

impl Levels {
    /// Home switch of a joint.
    pub const fn home(self, joint: usize) -> bool {
        self.0.home(joint)
    }

    /// Limit switches of a joint at the lower and at the upper end.
    pub const fn limits(self, joint: usize) -> (bool, bool) {
        (self.0.limit_low(joint), self.0.limit_high(joint))
    }

    /// The drive of a joint reports no alarm.
    pub const fn is_ready(self, joint: usize) -> bool {
        !self.0.alarm(joint)
    }

    /// Digital inputs, channel `k` in bit `k`.
    pub const fn digital(self) -> u32 {
        self.0.digital()
    }
}

/// The signals.
pub struct Signals {
    filter: InputFilter,
    /// Word for the outputs.
    outputs: u32,
}

impl Signals {
    /// Starts the state machine. All inputs are active, and all outputs off.
    pub fn start() -> Self {
        let block = PIO[BLOCK];
        for (at, word) in PROGRAM.iter().enumerate() {
            write(block, 0x48 + 4 * (ORIGIN + at), u32::from(*word));
        }
        write(block, OWN, 1 << 16);
        write(block, OWN + 0x4, WRAP.0 << 12 | WRAP.1 << 7);
        // Both directions shift to the left.
        write(block, OWN + 0x8, 0);
        // The side-set pin is the clock, the set pin first each of the outputs and then the latch.
        let direct = |pin: u32| {
            write(block, OWN + 0x14, 1 << 26 | pin << 5);
            execute(0xE081); // set pindirs, 1
        };
        for pin in [CLOCK, DATA_OUT, LATCH] {
            direct(pin);
        }
        let pins = 1 << 29 | 1 << 26 | 1 << 20 | DATA_IN << 15 | CLOCK << 10 | LATCH << 5;
        write(block, OWN + 0x14, pins | DATA_OUT);
        execute(0xE001); // set pins, 1   side 0
        execute(ORIGIN as u32); // jmp
        pins::give_outputs_to_pio(&[LATCH, CLOCK, DATA_OUT], BLOCK);
        set(block, 0x0, 1 << MACHINE);
        Self {
            filter: InputFilter::new(SAMPLES, Inputs::ALL.0),
            outputs: 0,
        }
    }

    /// Takes the inputs of the last transfer. They are active if it has not ended.
    #[inline(always)]
    pub fn read(&mut self) -> Levels {
        let inputs = if is_received() {
            Inputs::of(read(PIO[BLOCK], RECEIVE))
        } else {
            Inputs::ALL
        };
        Levels(Inputs(self.filter.add(inputs.0)))
    }

    /// Changes of the inputs that the noise filter suppressed.
    pub const fn glitches(&self) -> u32 {
        self.filter.all_glitches()
    }

    /// Sets the direction of the spindle, and the digital outputs, channel `k` from bit `k`. The
    /// next transfer has them.
    pub const fn write(&mut self, is_clockwise: bool, digital: u32) {
        self.outputs = outputs(is_clockwise, digital);
    }

    /// Starts a transfer.
    pub fn transfer(&mut self) {
        write(PIO[BLOCK], SEND, self.outputs);
    }
}

/// Executes an instruction in the state machine.
fn execute(instruction: u32) {
    write(PIO[BLOCK], OWN + 0x10, instruction);
}

/// A transfer has ended, and its inputs were not taken.
fn is_received() -> bool {
    read(PIO[BLOCK], 0x4) >> (8 + MACHINE) & 1 == 0
}

/// Switches all outputs off, and waits until they are.
pub fn make_safe() {
    let block = PIO[BLOCK];
    // Both sizes of the FIFO in turn, which empties it.
    write(block, OWN + 0x8, 1 << 31);
    write(block, OWN + 0x8, 0);
    write(block, SEND, 0);
    // Two transfers: one may be under way. A turn of the loop takes several cycles.
    for _ in 0..2 {
        for _ in 0..TRANSFER {
            if is_received() {
                read(block, RECEIVE);
                break;
            }
        }
    }
}
