//! AD5644R, four 14-bit outputs by SPI: torque commands of servo drives.
//! SPI mode 1, at most 50 MHz.
//!
//! Code 0 of the chip is 0 V, the largest code twice its reference. An amplifier stage makes -10 to
//! 10 V of that, so that the middle code, 8192, is no torque. The chip starts at code 0, which is
//! full torque in reverse: the enable line of the drives must be off until
//! [`Ad5644::set_all_zero`] has returned.

use embedded_hal::spi::SpiDevice;

/// Number of outputs.
pub const CHANNELS: usize = 4;

/// Writes the input register only.
const WRITE: u32 = 0b000;
/// Writes the input register, and updates all outputs.
const WRITE_AND_UPDATE_ALL: u32 = 0b010;
/// Writes the input register, and updates the same output.
const WRITE_AND_UPDATE: u32 = 0b011;
const RESET: u32 = 0b101;
const REFERENCE: u32 = 0b111;
/// Address of all outputs.
const ALL: u32 = 0b111;
/// Code of 0 V behind the amplifier stage.
const MIDDLE: i16 = 8192;

/// An AD5644R behind a chip select.
pub struct Ad5644<S> {
    spi: S,
}

impl<S: SpiDevice> Ad5644<S> {
    /// The chip.
    pub const fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Returns the SPI device.
    pub fn release(self) -> S {
        self.spi
    }

    /// Resets the chip, switches its reference on, and sets all outputs to the middle.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn configure(&mut self) -> Result<(), S::Error> {
        self.send(RESET, 0, 1)?;
        self.send(REFERENCE, 0, 1)?;
        self.set_all_zero()
    }

    /// Sets all outputs to the middle: no torque.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn set_all_zero(&mut self) -> Result<(), S::Error> {
        self.send(WRITE_AND_UPDATE, ALL, data(0))
    }

    /// Sets the four outputs at one moment. Codes are -8192 to 8191, and are limited to that.
    ///
    /// # Errors
    /// The SPI reported an error; some outputs may then have their new codes.
    pub fn set(&mut self, codes: [i16; CHANNELS]) -> Result<(), S::Error> {
        let [first, second, third, fourth] = codes;
        self.send(WRITE, 0, data(first))?;
        self.send(WRITE, 1, data(second))?;
        self.send(WRITE, 2, data(third))?;
        self.send(WRITE_AND_UPDATE_ALL, 3, data(fourth))
    }

    fn send(&mut self, command: u32, address: u32, data: u32) -> Result<(), S::Error> {
        let [_, a, b, c] = (command << 19 | address << 16 | data).to_be_bytes();
        self.spi.write(&[a, b, c])
    }
}

/// Data bits of a signed code.
fn data(code: i16) -> u32 {
    let code = code.clamp(-MIDDLE, MIDDLE - 1) + MIDDLE;
    // Two bits without meaning follow the 14 of the code.
    u32::from(code.unsigned_abs()) << 2
}
