//! TMC5160, step motor driver for external transistors, by SPI. SPI mode 3, at most 4 MHz
//! with the internal clock.
//!
//! Step and direction come from the step generator of the board (SD_MODE). A datagram has 40 bits.
//! The data of a read come with the next datagram; every reply begins with the state of the driver.

use crate::{CurrentError, MicrostepError, microstep_code};
use embedded_hal::spi::{Operation, SpiDevice};

/// Registers.
mod register {
    pub const GCONF: u8 = 0x00;
    pub const GSTAT: u8 = 0x01;
    pub const IOIN: u8 = 0x04;
    pub const GLOBALSCALER: u8 = 0x0B;
    pub const IHOLD_IRUN: u8 = 0x10;
    pub const TCOOLTHRS: u8 = 0x14;
    pub const CHOPCONF: u8 = 0x6C;
    pub const COOLCONF: u8 = 0x6D;
    pub const DRV_STATUS: u8 = 0x6F;
}

const WRITE: u8 = 0x80;
/// Version that IOIN reports.
const VERSION: u8 = 0x30;
/// Multistep filter.
const GCONF: u32 = 1 << 3;
/// Bit of GCONF: the DIAG0 pin reports a stall.
const DIAG0_STALL: u32 = 1 << 7;
/// Off time 3, hysteresis start 4, end 1 (code 4), blank time 2; interpolation to 256 microsteps.
const CHOPCONF: u32 = 3 | 4 << 4 | 4 << 7 | 2 << 15 | 1 << 28;
/// Full scale of the sense voltage, uV.
const FULL_SCALE_UV: u64 = 325_000;
const HOLD_DELAY: u32 = 6;
/// Least value of the global scaler; less is not allowed (data sheet 6.1).
const MIN_SCALER: u64 = 32;

/// Reason why a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<E> {
    /// The SPI reported an error.
    Spi(E),
    /// The chip is not a TMC5160; the version it reports. 0 and 255: no chip, or no supply.
    Version(u8),
    /// A register that can be read back has another value than was written.
    NotTaken {
        /// The register.
        register: u8,
        /// The value that it has.
        found: u32,
    },
    /// The current cannot be set.
    Current(CurrentError),
    /// The number of microsteps does not exist.
    Microsteps(MicrostepError),
}

/// State of the driver, from DRV_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u32);

impl Status {
    const fn bit(self, bit: u32) -> bool {
        self.0 >> bit & 1 != 0
    }

    /// Load measure, 0 (stalled) to 1023.
    #[must_use]
    pub const fn load_measure(self) -> u16 {
        (self.0 & 0x3FF) as u16
    }

    /// The load measure fell to 0: the motor is stalled.
    #[must_use]
    pub const fn is_stalled(self) -> bool {
        self.bit(24)
    }

    /// The chip switched the motor off because of its temperature.
    #[must_use]
    pub const fn is_overheated(self) -> bool {
        self.bit(25)
    }

    /// The chip is above its warning temperature.
    #[must_use]
    pub const fn is_hot(self) -> bool {
        self.bit(26)
    }

    /// A phase is shorted to ground or to the supply; the chip switched the motor off.
    #[must_use]
    pub const fn is_shorted(self) -> bool {
        self.0 & (0b11 << 12 | 0b11 << 27) != 0
    }

    /// A phase is open. Valid only while the motor moves slowly.
    #[must_use]
    pub const fn is_open(self) -> bool {
        self.0 & 0b11 << 29 != 0
    }

    /// The motor is at standstill.
    #[must_use]
    pub const fn is_standing(self) -> bool {
        self.bit(31)
    }

    /// The driver does not move the motor: an alarm of the drive.
    #[must_use]
    pub const fn is_alarm(self) -> bool {
        self.is_overheated() || self.is_shorted()
    }
}

/// Currents of a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Currents {
    /// While it moves, mA rms.
    pub run_ma: u16,
    /// While it stands, mA rms; at most `run_ma`.
    pub hold_ma: u16,
    /// Sense resistor, mOhm; 75 on most modules.
    pub sense_mohm: u16,
}

/// A TMC5160 on an SPI bus.
pub struct Tmc5160<S> {
    spi: S,
}

impl<S: SpiDevice> Tmc5160<S> {
    /// The driver behind a chip select.
    pub const fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Returns the SPI device.
    pub fn release(self) -> S {
        self.spi
    }

    /// Checks that the chip answers, and sets currents and microsteps.
    ///
    /// # Errors
    /// See [`Error`]. After an error the drive must stay disabled: its current is unknown.
    pub fn configure(
        &mut self,
        currents: Currents,
        microsteps: u16,
    ) -> Result<(), Error<S::Error>> {
        let resolution = microstep_code(microsteps).map_err(Error::Microsteps)?;
        let (scaler, hold) = codes(currents).map_err(Error::Current)?;
        let version = (self.read(register::IOIN)? >> 24) as u8;
        if version != VERSION {
            return Err(Error::Version(version));
        }
        self.write(register::GCONF, GCONF)?;
        self.write(register::GLOBALSCALER, u32::from(scaler))?;
        let holding = HOLD_DELAY << 16 | 31 << 8 | u32::from(hold);
        self.write(register::IHOLD_IRUN, holding)?;
        // Last, because it switches the power stage on; and read back, because a chip without it
        // leaves the motor without current.
        let chopper = CHOPCONF | resolution << 24;
        self.write(register::CHOPCONF, chopper)?;
        let found = self.read(register::CHOPCONF)?;
        if found != chopper {
            return Err(Error::NotTaken {
                register: register::CHOPCONF,
                found,
            });
        }
        self.write(register::GSTAT, 0b111)
    }

    /// Reports a stall on the DIAG0 pin, for homing without a switch. `threshold` (-64 to 63,
    /// higher is less sensitive) is limited to its range. `slowest_step` is the longest time of a
    /// microstep at which stalls are detected, in clocks of 12 MHz.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn detect_stalls(
        &mut self,
        threshold: i8,
        slowest_step: u32,
    ) -> Result<(), Error<S::Error>> {
        let threshold = threshold.clamp(-64, 63) as u32 & 0x7F;
        self.write(register::COOLCONF, threshold << 16)?;
        self.write(register::TCOOLTHRS, slowest_step.min(0xF_FFFF))?;
        self.write(register::GCONF, GCONF | DIAG0_STALL)
    }

    /// State of the driver.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn status(&mut self) -> Result<Status, Error<S::Error>> {
        self.read(register::DRV_STATUS).map(Status)
    }

    /// Whether the driver was reset since [`Tmc5160::configure`]: its supply broke down, and its
    /// motor has no current.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn was_reset(&mut self) -> Result<bool, Error<S::Error>> {
        Ok(self.read(register::GSTAT)? & 1 != 0)
    }

    /// Writes a register.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn write(&mut self, register: u8, value: u32) -> Result<(), Error<S::Error>> {
        let [a, b, c, d] = value.to_be_bytes();
        let bytes = [register | WRITE, a, b, c, d];
        self.spi.write(&bytes).map_err(Error::Spi)
    }

    /// Reads a register with two datagrams.
    ///
    /// # Errors
    /// The SPI reported an error.
    pub fn read(&mut self, register: u8) -> Result<u32, Error<S::Error>> {
        let request = [register, 0, 0, 0, 0];
        self.spi.write(&request).map_err(Error::Spi)?;
        let mut reply = request;
        self.spi
            .transaction(&mut [Operation::TransferInPlace(&mut reply)])
            .map_err(Error::Spi)?;
        let [_, a, b, c, d] = reply;
        Ok(u32::from_be_bytes([a, b, c, d]))
    }
}

/// Current at a scaler of 1 to 256 and a code of the current, in mA rms (data sheet 9).
fn current_ma(scaler: u64, code: u64, sense_mohm: u16) -> u16 {
    let rms = FULL_SCALE_UV * 70_711 / 100_000;
    let scaled = rms * scaler * (code + 1) / (256 * 32);
    u16::try_from(scaled / u64::from(sense_mohm.max(1))).unwrap_or(u16::MAX)
}

/// Global scaler (0 is 256) of the run current at code 31, and code of the hold current.
fn codes(currents: Currents) -> Result<(u8, u8), CurrentError> {
    let of = |scaler, code| current_ma(scaler, code, currents.sense_mohm);
    let limits = (of(MIN_SCALER, 31), of(256, 31));
    if currents.run_ma < limits.0 || currents.run_ma > limits.1 {
        return Err(CurrentError {
            wanted_ma: currents.run_ma,
            range_ma: limits,
        });
    }
    let fits = |scaler: &u64| of(*scaler, 31) <= currents.run_ma;
    let scaler = (MIN_SCALER..=256).rev().find(fits).unwrap_or(MIN_SCALER);
    if currents.hold_ma > currents.run_ma {
        return Err(CurrentError {
            wanted_ma: currents.hold_ma,
            range_ma: (0, currents.run_ma),
        });
    }
    let hold = (0..=31)
        .rev()
        .find(|code| of(scaler, *code) <= currents.hold_ma);
    // 256 is written as 0.
    Ok(((scaler & 0xFF) as u8, hold.unwrap_or(0) as u8))
}
