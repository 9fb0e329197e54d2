//! 74HC165 and 74HC595 on an SPI bus: any number of inputs and outputs on three pins and a latch
//! each.
//!
//! The 74HC165 shifts at the rising edge of the clock, so it is read in SPI mode 2, at the falling
//! one. The 74HC595 takes its data at the rising edge: mode 0.

use embedded_hal::digital::OutputPin;
use embedded_hal::spi::SpiBus;

/// Reason why a transfer failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<S, P> {
    /// The SPI reported an error.
    Spi(S),
    /// The latch pin reported an error.
    Pin(P),
}

/// Reads `N` cascaded 74HC165. `load` is their SH/LD pin: low takes the inputs. Byte 0 is the chip
/// whose output is connected to the board, bit 7 its input H.
///
/// # Errors
/// See [`Error`].
pub fn read_inputs<const N: usize, S: SpiBus, P: OutputPin>(
    spi: &mut S,
    load: &mut P,
) -> Result<[u8; N], Error<S::Error, P::Error>> {
    load.set_low().map_err(Error::Pin)?;
    load.set_high().map_err(Error::Pin)?;
    let mut bytes = [0; N];
    spi.read(&mut bytes).map_err(Error::Spi)?;
    Ok(bytes)
}

/// Writes `N` cascaded 74HC595. `latch` is their RCLK pin: its rising edge takes the levels to the
/// outputs, all at one moment. The last byte is the chip that is connected to the board, bit 7 its
/// output H.
///
/// # Errors
/// See [`Error`].
pub fn write_outputs<const N: usize, S: SpiBus, P: OutputPin>(
    spi: &mut S,
    latch: &mut P,
    levels: &[u8; N],
) -> Result<(), Error<S::Error, P::Error>> {
    latch.set_low().map_err(Error::Pin)?;
    spi.write(levels).map_err(Error::Spi)?;
    spi.flush().map_err(Error::Spi)?;
    latch.set_high().map_err(Error::Pin)
}
