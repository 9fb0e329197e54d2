//! ADS8684 and ADS8688, 16-bit converter with inputs of +-10.24 V, by SPI:
//! the charge amplifiers of the force sensor connect to it directly. SPI mode 1, at most 17 MHz.
//!
//! A frame has 32 bits: a command, then the code of the channel that the command *before* selected.
//! A sample of three channels therefore takes four frames.

use embedded_hal::spi::SpiDevice;

/// Number of channels of a force sample: x, y, z.
pub const CHANNELS: usize = 3;

const NO_OPERATION: u16 = 0x0000;
const RESET: u16 = 0x8500;
/// Selects channel 0; each further channel is 0x0400 more.
const MANUAL: u16 = 0xC000;
/// Range register of channel 0; the others follow.
const RANGE: u8 = 0x05;

/// Range of an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Range {
    /// -10.24 to 10.24 V.
    Volt10 = 0,
    /// -5.12 to 5.12 V.
    Volt5 = 1,
    /// -2.56 to 2.56 V.
    Volt2 = 2,
}

/// Reason why a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<E> {
    /// The SPI reported an error.
    Spi(E),
    /// The chip did not confirm a range; the byte that it returned. 0 and 255: no chip, or no
    /// supply.
    NotTaken(u8),
}

/// An ADS8684 or ADS8688 behind a chip select.
pub struct Ads8688<S> {
    spi: S,
}

impl<S: SpiDevice> Ads8688<S> {
    /// The chip.
    pub const fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Returns the SPI device.
    pub fn release(self) -> S {
        self.spi
    }

    /// Resets the chip and sets the range of the channels.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn configure(&mut self, range: Range) -> Result<(), Error<S::Error>> {
        self.frame(RESET).map_err(Error::Spi)?;
        for channel in 0..CHANNELS as u8 {
            // Address, a bit for a write, data; the third byte of the reply repeats the data.
            let address = (RANGE + channel) << 1 | 1;
            let mut bytes = [address, range as u8, 0];
            self.spi.transfer_in_place(&mut bytes).map_err(Error::Spi)?;
            if bytes[2] != range as u8 {
                return Err(Error::NotTaken(bytes[2]));
            }
        }
        Ok(())
    }

    /// Converts all channels. Codes are of 14 bits, -8192 to 8191, as the controller has them.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn sample(&mut self) -> Result<[i16; CHANNELS], Error<S::Error>> {
        let mut codes = [0; CHANNELS];
        self.frame(MANUAL).map_err(Error::Spi)?;
        for (channel, code) in codes.iter_mut().enumerate() {
            let next = match channel + 1 {
                CHANNELS => NO_OPERATION,
                following => MANUAL + 0x0400 * following as u16,
            };
            *code = signed(self.frame(next).map_err(Error::Spi)?);
        }
        Ok(codes)
    }

    /// Sends a command; returns the code of the channel that was selected before.
    fn frame(&mut self, command: u16) -> Result<u16, S::Error> {
        let [high, low] = command.to_be_bytes();
        let mut bytes = [high, low, 0, 0];
        self.spi.transfer_in_place(&mut bytes)?;
        Ok(u16::from_be_bytes([bytes[2], bytes[3]]))
    }
}

/// 14-bit code of a straight binary one of 16 bits, whose middle is 0 V.
const fn signed(raw: u16) -> i16 {
    (raw ^ 0x8000) as i16 >> 2
}
