//! Encoders of joints 0 to 3: the four state machines of PIO2, each with the program of
//! [`encoder_words`](haptimill_board_common::encoder_words).
//!
//! | pins | |
//! | --- | --- |
//! | GP15, GP16 | channels A and B of joint 0 |
//! | GP17, GP18 | joint 1 |
//! | GP19, GP20 | joint 2 |
//! | GP21, GP22 | joint 3 |

use crate::registers::{PIO2, read, set, write};
use haptimill_board_common::encoder_words::{EncoderCount, PROGRAM, START, WRAP};
use haptimill_firmware::io::JointInputs;

/// Joints with an encoder.
pub const ENCODERS: usize = 4;

/// Channel A of joint 0. The pins of a joint are neighbours, and so are the joints.
const FIRST: u32 = 15;

/// The output shift register shifts to the right, the input one to the left.
const SHIFT: u32 = 1 << 19;
/// The FIFO of the outputs gives its words to that of the inputs. A change empties both.
const JOINED: u32 = SHIFT | 1 << 31;

/// All encoders.
pub struct Encoders([EncoderCount; ENCODERS]);

impl Encoders {
    /// Starts the counters at 0.
    pub fn start() -> Self {
        for (at, word) in PROGRAM.iter().enumerate() {
            write(PIO2, 0x48 + 4 * at, u32::from(*word));
        }
        for machine in 0..ENCODERS {
            let own = 0xC8 + 0x18 * machine;
            write(PIO2, own, 1 << 16);
            write(PIO2, own + 0x4, WRAP.0 << 12 | WRAP.1 << 7);
            write(PIO2, own + 0x8, SHIFT);
            write(PIO2, own + 0x14, (FIRST + 2 * machine as u32) << 15);
            for instruction in START {
                write(PIO2, own + 0x10, u32::from(instruction));
            }
        }
        set(PIO2, 0x0, 0xF);
        Self([const { EncoderCount::new() }; ENCODERS])
    }

    /// Latches all counters: empties the FIFOs, whose first words come within 13 cycles and stay.
    #[inline(always)]
    pub fn latch(&mut self) {
        for machine in 0..ENCODERS {
            let own = 0xC8 + 0x18 * machine;
            write(PIO2, own + 0x8, JOINED);
            write(PIO2, own + 0x8, SHIFT);
        }
    }

    /// Reads the latched counters. `time_ns` is the time of the latch. A counter whose word is not
    /// there keeps its value.
    pub fn read(&mut self, time_ns: u32) {
        let is_empty = read(PIO2, 0x4) >> 8;
        for (machine, count) in self.0.iter_mut().enumerate() {
            if is_empty >> machine & 1 == 0 {
                count.add(read(PIO2, 0x20 + 4 * machine), time_ns);
            }
        }
    }

    /// Writes what was read into the inputs of the joints.
    pub fn write(&self, joints: &mut [JointInputs]) {
        for (count, input) in self.0.iter().zip(joints) {
            input.counts = count.counts();
            input.edge_time_ns = count.edge_time_ns();
        }
    }
}
