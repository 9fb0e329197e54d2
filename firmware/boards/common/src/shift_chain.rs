//! Inputs and outputs over shift registers, by a state machine of a programmable I/O block (PIO of
//! the RP2350): three 74HC165 for 24 inputs, and a 74HC595 for 8 outputs, at four pins.
//!
//! | pin | |
//! | --- | --- |
//! | clock | CLK of all chips |
//! | data out | SER of the 74HC595 |
//! | data in | QH of the first 74HC165 |
//! | latch | SH/LD of the 74HC165, RCLK of the 74HC595 |
//!
//! SER of the first 74HC165 is QH of the second one, SER of the second one is QH of the third one,
//! and SER of the third one is high. A transfer has 32 bits: the 24 inputs, and 8 bits that are
//! high. With a broken wire, or without the chips, the inputs read active or the last bits read
//! low; then [`Inputs::of`] takes all inputs as active.
//!
//! The latch line is low, then high: the inputs are loaded. Then come 32 clocks, and the latch line
//! is low and high again: the last 8 bits are at the outputs. A transfer takes [`TRANSFER`] cycles:
//!
//! ```text
//! .side_set 1                     the clock
//! .wrap_target
//!     pull block       side 0     the outputs; it starts the transfer
//!     set pins, 0      side 0 [15]
//!     set x, 31        side 0 [15]
//!     set pins, 1      side 0 [15]
//! bit:
//!     out pins, 1      side 0 [15]
//!     in pins, 1       side 0 [15]
//!     mov y, y         side 1 [15]
//!     jmp x--, bit     side 1 [15]
//!     set pins, 0      side 0 [15]
//!     set pins, 1      side 0 [15]
//!     push noblock     side 0
//! .wrap
//! ```

use crate::step_words;

/// Address of the program: behind that of the steps, which the same block has.
pub const ORIGIN: usize = step_words::PROGRAM.len();

/// The program above, assembled for [`ORIGIN`].
pub const PROGRAM: [u16; 11] = [
    0x80A0,                     // pull block
    0xEF00,                     // set pins, 0
    0xEF3F,                     // set x, 31
    0xEF01,                     // set pins, 1
    0x6F01,                     // out pins, 1
    0x4F01,                     // in pins, 1
    0xBF42,                     // mov y, y        side 1
    0x1F40 + ORIGIN as u16 + 4, // jmp x--, bit    side 1
    0xEF00,                     // set pins, 0
    0xEF01,                     // set pins, 1
    0x8000,                     // push noblock
];

/// Addresses of the last instruction before the program begins again, and of the one after it.
pub const WRAP: (u32, u32) = ((ORIGIN + PROGRAM.len() - 1) as u32, ORIGIN as u32);

/// Cycles of a transfer, from the start to the result.
pub const TRANSFER: u32 = 1 + 3 * 16 + 32 * 64 + 2 * 16 + 1;

/// Cycles from the start of a transfer to the moment at which the inputs are latched.
pub const LATCHED: u32 = 1 + 2 * 16;

/// Joints with inputs.
const JOINTS: usize = 5;

/// Bits behind those of the inputs, which must be high.
const CHECK: u32 = 0xFF;

/// Levels of the 24 inputs: A to H of the third chip from bit 0, of the second one from bit 8, of
/// the first one from bit 16. Each joint has four of them, in this order: home switch, limit switch
/// at the lower end, at the upper end, alarm. Joints 0 and 1 are at the first chip, 2 and 3 at the
/// second one, 4 at A to D of the third one. E to H of the third chip are the digital inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inputs(pub u32);

impl Inputs {
    /// All inputs are active.
    pub const ALL: Self = Self(0xFF_FFFF);

    /// The inputs in the word of a transfer. All are active in a word whose last bits are not high:
    /// a wire or the supply of the chips is broken.
    #[must_use]
    pub const fn of(word: u32) -> Self {
        if word & CHECK == CHECK {
            Self(word >> 8)
        } else {
            Self::ALL
        }
    }

    /// Bit of the first of the four inputs of a joint, below 5.
    #[must_use]
    pub const fn first_of(joint: usize) -> u32 {
        let chip = joint as u32 / 2;
        16 - 8 * chip + 4 * (joint as u32 % 2)
    }

    /// Input of a joint; of joints without inputs it is low.
    const fn of_joint(self, joint: usize, which: u32) -> bool {
        joint < JOINTS && self.0 >> (Self::first_of(joint) + which) & 1 != 0
    }

    /// Home switch of a joint.
    #[must_use]
    pub const fn home(self, joint: usize) -> bool {
        self.of_joint(joint, 0)
    }

    /// Limit switch at the lower end of a joint.
    #[must_use]
    pub const fn limit_low(self, joint: usize) -> bool {
        self.of_joint(joint, 1)
    }

    /// Limit switch at the upper end of a joint.
    #[must_use]
    pub const fn limit_high(self, joint: usize) -> bool {
        self.of_joint(joint, 2)
    }

    /// Alarm of the drive of a joint.
    #[must_use]
    pub const fn alarm(self, joint: usize) -> bool {
        self.of_joint(joint, 3)
    }

    /// Digital inputs, channel `k` in bit `k`: four of them.
    #[must_use]
    pub const fn digital(self) -> u32 {
        self.0 >> 4 & 0xF
    }
}

/// Word for the outputs: QA is the direction of the spindle, QB to QH are the digital outputs from
/// channel 0.
#[must_use]
pub const fn outputs(is_clockwise: bool, digital: u32) -> u32 {
    is_clockwise as u32 | (digital & 0x7F) << 1
}
