//! TMC2209, step motor driver with a one-wire UART.
//!
//! Step and direction come from the step generator of the board. The UART sets currents,
//! microsteps and the stall threshold, and reads the state of the driver. A datagram is 8 bytes
//! with an 8-bit check. The wire is shared: the board receives what it sends, and this driver reads
//! that echo and compares it.

use crate::{CurrentError, MicrostepError, microstep_code};
use embedded_hal::delay::DelayNs;
use embedded_hal_nb::serial::{Read, Write};

/// Registers.
mod register {
    pub const GCONF: u8 = 0x00;
    pub const GSTAT: u8 = 0x01;
    pub const IFCNT: u8 = 0x02;
    pub const IOIN: u8 = 0x06;
    pub const IHOLD_IRUN: u8 = 0x10;
    pub const TCOOLTHRS: u8 = 0x14;
    pub const SGTHRS: u8 = 0x40;
    pub const SG_RESULT: u8 = 0x41;
    pub const CHOPCONF: u8 = 0x6C;
    pub const DRV_STATUS: u8 = 0x6F;
}

const SYNC: u8 = 0x05;
const WRITE: u8 = 0x80;
/// Address of the board in a reply.
const MASTER: u8 = 0xFF;
/// Version that IOIN reports.
const VERSION: u8 = 0x21;
/// PDN_UART is a UART; microsteps by register; multistep filter.
const GCONF: u32 = 1 << 6 | 1 << 7 | 1 << 8;
/// Chopper of the data sheet: off time 3, hysteresis start 5; interpolation to 256 microsteps.
const CHOPCONF: u32 = 0x1000_0053;
/// Bit of CHOPCONF: the lower range of the sense voltage, 180 mV.
const VSENSE: u32 = 1 << 17;
/// Full scale of the sense voltage, uV, without and with [`VSENSE`].
const FULL_SCALE_UV: [u64; 2] = [325_000, 180_000];
/// Resistance of the chip beside the sense resistor, mOhm.
const INTERNAL_MOHM: u64 = 20;
/// Delay from run to hold current, in 2^18 clocks per current step.
const HOLD_DELAY: u32 = 6;
/// Wait between two looks at the receiver, us, and number of looks. A reply comes after at most 20
/// ms at the slowest usual rate (9600 baud).
const POLL_US: u32 = 20;
const POLLS: u32 = 1000;

/// Reason why a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<E> {
    /// The UART reported an error.
    Serial(E),
    /// No byte came in time: no supply, wrong address, or the wire is broken.
    NoReply,
    /// The board did not read back what it sent: the wire is shorted or driven by another chip.
    Echo,
    /// The check of a reply is wrong.
    Check,
    /// A reply belongs to another register, or is not addressed to the board.
    WrongReply,
    /// The driver did not take a write: its counter of writes did not advance.
    NotTaken,
    /// The chip is not a TMC2209; the version it reports.
    Version(u8),
    /// The current cannot be set.
    Current(CurrentError),
    /// The number of microsteps does not exist.
    Microsteps(MicrostepError),
}

/// Check of a datagram: x^8 + x^2 + x + 1, each byte from its lowest bit (data sheet 4.2).
#[must_use]
pub fn check_byte(bytes: &[u8]) -> u8 {
    let mut check = 0_u8;
    for byte in bytes {
        let mut rest = *byte;
        for _ in 0..8 {
            let differs = (check >> 7) ^ (rest & 1) != 0;
            check <<= 1;
            if differs {
                check ^= 0x07;
            }
            rest >>= 1;
        }
    }
    check
}

/// State of the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u32);

impl Status {
    const fn bit(self, bit: u32) -> bool {
        self.0 >> bit & 1 != 0
    }

    /// The chip is above its warning temperature, 120 C.
    #[must_use]
    pub const fn is_hot(self) -> bool {
        self.bit(0)
    }

    /// The chip switched the motor off because of its temperature.
    #[must_use]
    pub const fn is_overheated(self) -> bool {
        self.bit(1)
    }

    /// A phase is shorted to ground or to the supply; the chip switched the motor off.
    #[must_use]
    pub const fn is_shorted(self) -> bool {
        self.0 & 0b11_1100 != 0
    }

    /// A phase is open. Valid only while the motor moves slowly.
    #[must_use]
    pub const fn is_open(self) -> bool {
        self.0 & 0b1100_0000 != 0
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
    /// Sense resistor, mOhm; 110 on most modules.
    pub sense_mohm: u16,
}

/// A TMC2209 on a UART.
pub struct Tmc2209<S, D> {
    serial: S,
    delay: D,
    address: u8,
    chopper: u32,
}

impl<S, D, E> Tmc2209<S, D>
where
    S: Read<u8, Error = E> + Write<u8>,
    D: DelayNs,
{
    /// The driver with an address, 0 to 3 (pins MS1 and MS2), on a one-wire UART.
    pub const fn new(serial: S, delay: D, address: u8) -> Self {
        Self {
            serial,
            delay,
            address,
            chopper: CHOPCONF,
        }
    }

    /// Returns the UART and the delay.
    pub fn release(self) -> (S, D) {
        (self.serial, self.delay)
    }

    /// Checks that the chip answers, and sets currents and microsteps.
    ///
    /// # Errors
    /// See [`Error`]. After an error the drive must stay disabled: its current is unknown.
    pub fn configure(&mut self, currents: Currents, microsteps: u16) -> Result<(), Error<E>> {
        let resolution = microstep_code(microsteps).map_err(Error::Microsteps)?;
        let (range, run) = current_code(currents.run_ma, currents).map_err(Error::Current)?;
        let hold = hold_code(range, currents).map_err(Error::Current)?;
        let version = (self.read(register::IOIN)? >> 24) as u8;
        if version != VERSION {
            return Err(Error::Version(version));
        }
        self.chopper = CHOPCONF & !(0xF << 24) | resolution << 24;
        if range == 1 {
            self.chopper |= VSENSE;
        }
        self.write(register::GCONF, GCONF)?;
        self.write(register::CHOPCONF, self.chopper)?;
        let holding = HOLD_DELAY << 16 | u32::from(run) << 8 | u32::from(hold);
        self.write(register::IHOLD_IRUN, holding)?;
        // Flags of the reset are cleared by writing ones, so that the next reset is seen.
        self.write(register::GSTAT, 0b111)
    }

    /// Sets the threshold of the stall detection: the DIAG pin rises when the load measure is below
    /// twice this value and a step takes at most `slowest_step` clocks (12 MHz). At 0 it never
    /// does.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn set_stall_threshold(
        &mut self,
        threshold: u8,
        slowest_step: u32,
    ) -> Result<(), Error<E>> {
        self.write(register::TCOOLTHRS, slowest_step.min(0xF_FFFF))?;
        self.write(register::SGTHRS, u32::from(threshold))
    }

    /// Load measure of the motor, 0 (stalled) to 510.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn load_measure(&mut self) -> Result<u16, Error<E>> {
        Ok((self.read(register::SG_RESULT)? & 0x3FF) as u16)
    }

    /// State of the driver.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn status(&mut self) -> Result<Status, Error<E>> {
        self.read(register::DRV_STATUS).map(Status)
    }

    /// Whether the driver was reset since [`Tmc2209::configure`]: its supply broke down, and its
    /// currents are those of the factory.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn was_reset(&mut self) -> Result<bool, Error<E>> {
        Ok(self.read(register::GSTAT)? & 1 != 0)
    }

    /// Writes a register, and checks by the counter of writes that the driver took it.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn write(&mut self, register: u8, value: u32) -> Result<(), Error<E>> {
        let before = self.read(register::IFCNT)? as u8;
        let [a, b, c, d] = value.to_be_bytes();
        let bytes = [SYNC, self.address, register | WRITE, a, b, c, d];
        self.send(&bytes)?;
        if self.read(register::IFCNT)? as u8 == before.wrapping_add(1) {
            Ok(())
        } else {
            Err(Error::NotTaken)
        }
    }

    /// Reads a register.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn read(&mut self, register: u8) -> Result<u32, Error<E>> {
        self.send(&[SYNC, self.address, register])?;
        let mut reply = [0; 8];
        for byte in &mut reply {
            *byte = self.receive()?;
        }
        let [sync, address, replied, a, b, c, d, check] = reply;
        if check_byte(&reply[..7]) != check {
            return Err(Error::Check);
        }
        if (sync & 0xF, address, replied) != (SYNC, MASTER, register) {
            return Err(Error::WrongReply);
        }
        Ok(u32::from_be_bytes([a, b, c, d]))
    }

    /// Sends bytes and their check, and compares the echo.
    fn send(&mut self, bytes: &[u8]) -> Result<(), Error<E>> {
        let check = check_byte(bytes);
        for byte in bytes.iter().copied().chain([check]) {
            let mut looks = 0;
            while self.serial.write(byte).is_err() {
                looks += 1;
                if looks == POLLS {
                    return Err(Error::NoReply);
                }
                self.delay.delay_us(POLL_US);
            }
            // A byte at a time: its echo must leave the receiver before the next one.
            if self.receive()? != byte {
                return Err(Error::Echo);
            }
        }
        Ok(())
    }

    fn receive(&mut self) -> Result<u8, Error<E>> {
        for _ in 0..POLLS {
            match self.serial.read() {
                Ok(byte) => return Ok(byte),
                Err(nb::Error::WouldBlock) => self.delay.delay_us(POLL_US),
                Err(nb::Error::Other(error)) => return Err(Error::Serial(error)),
            }
        }
        Err(Error::NoReply)
    }
}

/// Current at a code in a range of the sense voltage, in mA rms: (code + 1) / 32 * full scale /
/// resistance / sqrt 2 (data sheet 9).
fn current_ma(code: u8, range: usize, sense_mohm: u16) -> u16 {
    let resistance = u64::from(sense_mohm) + INTERNAL_MOHM;
    // uV / mOhm is mA; 1 / sqrt 2 is 0.70711.
    let rms = FULL_SCALE_UV[range] * 70_711 / 100_000;
    let scaled = rms * (u64::from(code) + 1) / 32;
    u16::try_from(scaled / resistance).unwrap_or(u16::MAX)
}

/// Range and code of the largest current up to the one asked for. The lower range has the finer
/// steps.
fn current_code(wanted_ma: u16, currents: Currents) -> Result<(usize, u8), CurrentError> {
    let of = |code, range| current_ma(code, range, currents.sense_mohm);
    for range in [1, 0] {
        if wanted_ma <= of(31, range) {
            let code = (0..=31).rev().find(|code| of(*code, range) <= wanted_ma);
            if let Some(code) = code {
                return Ok((range, code));
            }
        }
    }
    Err(CurrentError {
        wanted_ma,
        range_ma: (of(0, 1), of(31, 0)),
    })
}

/// Code of the hold current in the range of the run current; at least 0.
fn hold_code(range: usize, currents: Currents) -> Result<u8, CurrentError> {
    let of = |code| current_ma(code, range, currents.sense_mohm);
    if currents.hold_ma > currents.run_ma {
        return Err(CurrentError {
            wanted_ma: currents.hold_ma,
            range_ma: (of(0), currents.run_ma),
        });
    }
    let code = (0..=31).rev().find(|code| of(*code) <= currents.hold_ma);
    Ok(code.unwrap_or(0))
}
