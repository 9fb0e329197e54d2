//! TMC5160, step motor driver for external transistors, by SPI. SPI mode 3, at most 4 MHz
//! with the internal clock.
//!
//! Step and direction come from the step generator of the board (SD_MODE). Several chips are a
//! chain behind one chip select: SDO of a chip is SDI of the next one. A datagram has 40 bits, and
//! the chain takes one for each chip at a time, that of the last chip first. The reply of a chip
//! begins with its state; the data of a read, and those that a write has written, come with the
//! next datagram.
//!
//! Each transfer begins with one more datagram, which passes through the whole chain and comes back
//! behind the replies. So every transfer shows that no wire is broken, that each chip has its
//! supply, and that the chain has as many chips as it should.
//!
//! The functions of [`Chain`] never wait: their futures return to the caller while bytes are under
//! way. Nothing wakes them, so the caller polls them again and again, for instance in its main
//! loop.

use crate::{CurrentError, Currents, SettingError, Trouble, microstep_code, turn};
use embedded_hal::digital::OutputPin;
use embedded_hal_nb::spi::FullDuplex;

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

/// Most chips of a chain.
pub const CHIPS_MAX: usize = 5;

/// Bytes of a datagram.
const BYTES: usize = 5;
/// Bytes that are under way at a time. The receiver must hold them.
const AHEAD: usize = 4;

/// The datagram that passes through the chain: a read, so that a chip that takes it changes
/// nothing.
const MARKER: [u8; BYTES] = [register::GCONF, 0x5A, 0xC3, 0x96, 0x3C];
/// The datagram for the chips that are not addressed.
const NOTHING: [u8; BYTES] = [register::GCONF, 0, 0, 0, 0];

const WRITE: u8 = 0x80;
/// Version that IOIN reports.
const VERSION: u8 = 0x30;
/// Bit of IOIN: the pin SD_MODE is high.
const SD_MODE: u32 = 1 << 6;
/// Multistep filter.
const GCONF: u32 = 1 << 3;
/// Bit of GCONF: the DIAG0 pin reports a stall.
const DIAG0_STALL: u32 = 1 << 7;
/// Off time 3, hysteresis start 4, end 1 (code 4), blank time 2; interpolation to 256 microsteps.
const CHOPCONF: u32 = 3 | 4 << 4 | 4 << 7 | 2 << 15 | 1 << 28;
/// Flags of GSTAT: reset, drive error, undervoltage of the charge pump.
const GSTAT: u32 = 0b111;
/// Full scale of the sense voltage, uV.
const FULL_SCALE_UV: u64 = 325_000;
const HOLD_DELAY: u32 = 6;
/// Least value of the global scaler; less is not allowed (data sheet 6.1).
const MIN_SCALER: u64 = 32;

/// Reason why a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<E> {
    /// The SPI or the chip select reported an error.
    Spi(E),
    /// The last chip of the chain whose reply has no bits, at this position: it has no supply, or
    /// the wire from its SDO is broken. No chip can be reached.
    NoReply(u8),
    /// The datagram that passes through the chain did not come back at its place: the chain has
    /// another number of chips, or a wire is disturbed.
    Length,
    /// The chip is not a TMC5160; the version it reports.
    Version(u8),
    /// The pin SD_MODE is low: the chip takes no steps.
    NoStepInputs,
    /// The chip did not receive what was written.
    NotTaken {
        /// The register.
        register: u8,
        /// What it received.
        found: u32,
    },
    /// A register does not have the value that was written.
    ReadBack {
        /// The register.
        register: u8,
        /// Its value.
        found: u32,
    },
    /// The chip is configured, and does not drive its motor.
    Trouble(Trouble),
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

/// Registers of a chip with its settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    scaler: u32,
    holding: u32,
    chopper: u32,
}

impl Settings {
    /// Registers of these currents and this number of microsteps.
    ///
    /// # Errors
    /// The chip does not have them.
    pub fn new(currents: Currents, microsteps: u16) -> Result<Self, SettingError> {
        let resolution = microstep_code(microsteps).map_err(SettingError::Microsteps)?;
        let (scaler, hold) = codes(currents).map_err(SettingError::Current)?;
        Ok(Self {
            scaler: u32::from(scaler),
            holding: HOLD_DELAY << 16 | 31 << 8 | u32::from(hold),
            chopper: CHOPCONF | resolution << 24,
        })
    }
}

/// A chain of TMC5160 behind a chip select.
pub struct Chain<S, P> {
    spi: S,
    select: P,
    /// Number of its chips.
    chips: usize,
}

impl<S, P, E> Chain<S, P>
where
    S: FullDuplex<u8, Error = E>,
    P: OutputPin<Error = E>,
{
    /// A chain of this many chips, at most [`CHIPS_MAX`], at a bus that holds four bytes. The chip
    /// select is high.
    pub fn new(spi: S, select: P, chips: usize) -> Self {
        let mut chain = Self {
            spi,
            select,
            chips: 0,
        };
        chain.set_chips(chips);
        chain
    }

    /// Sets the number of chips, at most [`CHIPS_MAX`].
    pub fn set_chips(&mut self, chips: usize) {
        self.chips = chips.min(CHIPS_MAX);
    }

    /// Checks that a chip answers, writes its settings, and reads them back.
    ///
    /// The registers of the currents cannot be read: the chip returns what it has received.
    ///
    /// # Errors
    /// See [`Error`]. After an error the drive must stay disabled: its current is unknown.
    pub async fn configure(&mut self, position: u8, settings: &Settings) -> Result<(), Error<E>> {
        let [pins] = self.read(position, [register::IOIN]).await?;
        let version = (pins >> 24) as u8;
        if version != VERSION {
            return Err(Error::Version(version));
        }
        if pins & SD_MODE == 0 {
            return Err(Error::NoStepInputs);
        }
        for (register, value) in [
            (register::GCONF, GCONF),
            (register::GLOBALSCALER, settings.scaler),
            (register::IHOLD_IRUN, settings.holding),
            // Behind the currents, because it switches the power stage on.
            (register::CHOPCONF, settings.chopper),
            // Flags of the reset are cleared by writing ones, so that the next reset is seen.
            (register::GSTAT, GSTAT),
        ] {
            self.write(position, register, value).await?;
        }
        let kept = [
            (register::GCONF, GCONF),
            (register::CHOPCONF, settings.chopper),
        ];
        let values = self.read(position, kept.map(|(it, _)| it)).await?;
        for ((register, written), found) in kept.into_iter().zip(values) {
            if found != written {
                return Err(Error::ReadBack { register, found });
            }
        }
        match self.trouble(position).await? {
            None => Ok(()),
            Some(trouble) => Err(Error::Trouble(trouble)),
        }
    }

    /// What keeps a configured chip from driving its motor.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn trouble(&mut self, position: u8) -> Result<Option<Trouble>, Error<E>> {
        let registers = [register::GSTAT, register::DRV_STATUS];
        let [flags, status] = self.read(position, registers).await?;
        let status = Status(status);
        let (is_overheated, is_shorted) = (status.is_overheated(), status.is_shorted());
        Ok(Trouble::of(flags, is_overheated, is_shorted))
    }

    /// Reports a stall on the DIAG0 pin, for homing without a switch. `threshold` (-64 to 63,
    /// higher is less sensitive) is limited to its range. `slowest_step` is the longest time of a
    /// microstep at which stalls are detected, in clocks of 12 MHz.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn detect_stalls(
        &mut self,
        position: u8,
        threshold: i8,
        slowest_step: u32,
    ) -> Result<(), Error<E>> {
        let threshold = threshold.clamp(-64, 63) as u32 & 0x7F;
        for (register, value) in [
            (register::COOLCONF, threshold << 16),
            (register::TCOOLTHRS, slowest_step.min(0xF_FFFF)),
            (register::GCONF, GCONF | DIAG0_STALL),
        ] {
            self.write(position, register, value).await?;
        }
        Ok(())
    }

    /// Writes a register, and checks that the chip received the value.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn write(&mut self, position: u8, register: u8, value: u32) -> Result<(), Error<E>> {
        let [a, b, c, d] = value.to_be_bytes();
        let datagram = [register | WRITE, a, b, c, d];
        self.exchange(position, datagram).await?;
        let found = self.exchange(position, NOTHING).await?;
        if found == value {
            Ok(())
        } else {
            Err(Error::NotTaken { register, found })
        }
    }

    /// Reads registers of a chip, one after the other.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn read<const N: usize>(
        &mut self,
        position: u8,
        registers: [u8; N],
    ) -> Result<[u32; N], Error<E>> {
        let mut values = [0; N];
        for at in 0..=N {
            let register = registers.get(at).copied().unwrap_or(register::GCONF);
            let found = self.exchange(position, [register, 0, 0, 0, 0]).await?;
            // The reply to a request comes with the next one.
            if let Some(value) = at.checked_sub(1).and_then(|before| values.get_mut(before)) {
                *value = found;
            }
        }
        Ok(values)
    }

    /// Transfers a datagram to a chip; returns the data of its reply to the datagram before.
    async fn exchange(&mut self, position: u8, datagram: [u8; BYTES]) -> Result<u32, Error<E>> {
        let own = usize::from(position);
        let last = self.chips.saturating_sub(1);
        // The datagram of the last chip leaves first, behind the marker; its reply comes first.
        let sent = |at: usize| match at / BYTES {
            0 => MARKER[at % BYTES],
            place if last.checked_sub(place - 1) == Some(own) => datagram[at % BYTES],
            _ => NOTHING[at % BYTES],
        };
        let mut replies = [[0; BYTES]; CHIPS_MAX + 1];
        self.select.set_low().map_err(Error::Spi)?;
        let result = self.transfer(sent, replies.as_flattened_mut()).await;
        self.select.set_high().map_err(Error::Spi)?;
        result?;
        // The chips take their datagrams now, before the next transfer.
        turn().await;
        let (replies, rest) = replies.split_at(self.chips);
        if rest.first() != Some(&MARKER) {
            let dead = replies.iter().position(is_dead);
            return Err(match dead {
                Some(place) => Error::NoReply((last - place) as u8),
                None => Error::Length,
            });
        }
        let reply = last.checked_sub(own).and_then(|place| replies.get(place));
        let [_, a, b, c, d] = *reply.ok_or(Error::Length)?;
        Ok(u32::from_be_bytes([a, b, c, d]))
    }

    /// Sends the bytes of the chain and of the marker, and receives as many.
    async fn transfer(
        &mut self,
        sent: impl Fn(usize) -> u8,
        received: &mut [u8],
    ) -> Result<(), Error<E>> {
        let count = BYTES * (self.chips + 1);
        let (mut sending, mut receiving) = (0, 0);
        while receiving < count {
            while sending < count.min(receiving + AHEAD) {
                match self.spi.write(sent(sending)) {
                    Ok(()) => sending += 1,
                    Err(nb::Error::WouldBlock) => break,
                    Err(nb::Error::Other(error)) => return Err(Error::Spi(error)),
                }
            }
            match self.spi.read() {
                Ok(byte) => {
                    if let Some(place) = received.get_mut(receiving) {
                        *place = byte;
                    }
                    receiving += 1;
                }
                Err(nb::Error::WouldBlock) => turn().await,
                Err(nb::Error::Other(error)) => return Err(Error::Spi(error)),
            }
        }
        Ok(())
    }
}

/// The wire had one level for the whole reply.
fn is_dead(reply: &[u8; BYTES]) -> bool {
    *reply == [0; BYTES] || *reply == [0xFF; BYTES]
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
