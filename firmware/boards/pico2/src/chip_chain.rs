//! Chain of the chips of the drives: SPI1 in mode 3, 1 MHz.
//!
//! GP26 is the clock, GP27 sends, GP28 receives, GP1 is the chip select. The main loop polls the
//! bus between all handlers: it takes no time of a control period. A handler between two bytes
//! stops the clock for its time, which the chips do not notice.

use crate::chips::Keeper;
use crate::clocks::{CYCLES_PER_US, cycles};
use crate::pins;
use crate::registers::{read, write};
use core::convert::Infallible;
use embedded_hal::digital::{self, OutputPin};
use embedded_hal_nb::spi::{self, FullDuplex};
use haptimill_drivers::tmc5160::Chain;

/// The SPI.
const SPI1: usize = 0x4008_8000;

const CONTROL_0: usize = 0x0;
const CONTROL_1: usize = 0x4;
const DATA: usize = 0x8;
const STATUS: usize = 0xC;
const PRESCALER: usize = 0x10;

/// Mode 3, words of 8 bits.
const MODE_3: u32 = 0b11 << 6 | 7;
const ENABLED: u32 = 1 << 1;
const TRANSMITTER_HAS_ROOM: u32 = 1 << 1;
const RECEIVED: u32 = 1 << 2;
/// Cycles of a bit: 1 MHz.
const BIT: u32 = CYCLES_PER_US;

struct Spi;

impl spi::ErrorType for Spi {
    type Error = Infallible;
}

impl FullDuplex<u8> for Spi {
    fn read(&mut self) -> nb::Result<u8, Infallible> {
        match read(SPI1, STATUS) & RECEIVED {
            0 => Err(nb::Error::WouldBlock),
            _ => Ok(read(SPI1, DATA) as u8),
        }
    }

    fn write(&mut self, byte: u8) -> nb::Result<(), Infallible> {
        if read(SPI1, STATUS) & TRANSMITTER_HAS_ROOM == 0 {
            return Err(nb::Error::WouldBlock);
        }
        write(SPI1, DATA, u32::from(byte));
        Ok(())
    }
}

/// The chip select.
struct Select;

impl digital::ErrorType for Select {
    type Error = Infallible;
}

impl OutputPin for Select {
    fn set_low(&mut self) -> Result<(), Infallible> {
        pins::drive(pins::CHIP_SELECT, false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        pins::drive(pins::CHIP_SELECT, true);
        Ok(())
    }
}

/// Starts the SPI, whose clock is then high, and its pins.
fn start() {
    write(SPI1, PRESCALER, BIT);
    write(SPI1, CONTROL_0, MODE_3);
    write(SPI1, CONTROL_1, ENABLED);
    pins::give_to_chip_chain();
}

/// Keeps the chips of the drives configured, for ever.
pub async fn serve(keeper: Keeper) -> Infallible {
    let mut chain = Chain::new(Spi, Select, 0);
    keeper
        .keep(&mut chain, cycles, CYCLES_PER_US, start, || {
            !pins::drives_are_on()
        })
        .await
}
