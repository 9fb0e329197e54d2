//! Signals between an image and the machine that depend on its wiring: each at a pin of its own,
//! some of which the chain of the TMC5160 may have; or over shift registers, with encoders.

use crate::chain::{Chain, DATA_IN};
use crate::encoders::{ENCODERS, Encoders, PINS};
use haptimill_client::flash::Board;
use haptimill_client::session::pins::record::JOINTS;
use haptimill_firmware::config::ChipKind;
use haptimill_firmware::io::Inputs;
use haptimill_hil_sim::plant::Plant;
use haptimill_hil_sim::tmc5160;

/// Pins, as in `firmware/boards/pico2/src/levels.rs`.
const FIRST_HOME: u32 = 15;
const INPUTS: [u32; 2] = [20, 27];
const ALARM: u32 = 28;
/// Pins of the chain of the TMC5160, as in `firmware/boards/pico2/src/pins.rs`.
const CHIP_SELECT: u32 = 1;
const CLOCK: u32 = 26;
const DATA_OUT: u32 = 27;
const CHIP_DATA_IN: u32 = 28;

/// The wiring of an image.
pub enum Signals {
    /// Each signal has a pin.
    Pins,
    /// Each signal has a pin, but for those whose pins this chain has.
    Spi(Box<tmc5160::Chain>),
    /// Shift registers and encoders.
    Chain(Box<(Chain, Encoders)>),
}

impl Signals {
    /// The wiring of the image with these contents of the flash, with a machine.
    pub fn of(flash: &[u8], plant: &mut Plant) -> Self {
        match Board::of_flash(flash) {
            Some(board) if board.encoders == ENCODERS => {
                Self::Chain(Box::new((Chain::default(), Encoders::of(plant))))
            }
            Some(board) if board.chips == Some(ChipKind::Tmc5160) => Self::Spi(Box::default()),
            _ => Self::Pins,
        }
    }

    /// Pins that are driven from outside.
    pub const fn mask(&self) -> u32 {
        match self {
            Self::Pins => 0x1F << FIRST_HOME | 1 << INPUTS[0] | 1 << INPUTS[1] | 1 << ALARM,
            Self::Spi(_) => 0x1F << FIRST_HOME | 1 << INPUTS[0] | self.live(),
            Self::Chain(_) => self.live(),
        }
    }

    /// Pins of these that follow the board or the time ([`Signals::follow`]).
    pub const fn live(&self) -> u32 {
        match self {
            Self::Pins => 0,
            Self::Spi(_) => 1 << CHIP_DATA_IN,
            Self::Chain(_) => PINS | 1 << DATA_IN,
        }
    }

    /// Sets the signals of the machine. `alarm` are the joints whose drive reports an alarm, one
    /// bit each; `high` are inputs that are high whatever the machine does, one bit each as
    /// [`Chain::inputs`] or a pin each. Returns the levels of the pins, without those of chain and
    /// encoders.
    pub fn set(&mut self, inputs: &Inputs, alarm: u32, high: u32) -> u32 {
        match self {
            Self::Pins | Self::Spi(_) => {
                let mut levels = u32::from(alarm != 0) << ALARM;
                for joint in 0..JOINTS {
                    levels |= u32::from(inputs.joints[joint].home) << (FIRST_HOME + joint as u32);
                }
                for (channel, pin) in INPUTS.into_iter().enumerate() {
                    levels |= (inputs.digital >> channel & 1) << pin;
                }
                (levels | high) & self.mask() & !self.live()
            }
            Self::Chain(chain) => {
                let mut levels = (inputs.digital & 0xF) << 4;
                for (joint, first) in [16, 20, 8, 12, 0].into_iter().enumerate() {
                    let input = &inputs.joints[joint];
                    let four = u32::from(input.home)
                        | u32::from(input.limit_low) << 1
                        | u32::from(input.limit_high) << 2
                        | (alarm >> joint & 1) << 3;
                    levels |= four << first;
                }
                chain.0.inputs = levels | high;
                0
            }
        }
    }

    /// Levels of the pins of chain and encoders at a cycle, after the board has driven its pins to
    /// these levels.
    pub fn follow(&mut self, pins: u32, cycle: u64) -> u32 {
        match self {
            Self::Pins => 0,
            Self::Spi(chain) => {
                let level = |pin: u32| pins >> pin & 1 != 0;
                let data = chain.follow(level(CHIP_SELECT), level(CLOCK), level(DATA_OUT));
                u32::from(data) << CHIP_DATA_IN
            }
            Self::Chain(chain) => {
                let (chain, encoders) = &mut **chain;
                encoders.levels(cycle) | u32::from(chain.follow(pins)) << DATA_IN
            }
        }
    }
}
