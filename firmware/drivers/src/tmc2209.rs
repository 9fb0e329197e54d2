//! TMC2209, step motor driver with a one-wire UART.
//!
//! Step and direction come from the step generator of the board. The UART sets currents,
//! microsteps and the stall threshold, and reads the state of the chip. Up to four chips share the
//! wire. A datagram is 8 bytes with an 8-bit check, or 4 bytes if it asks for a register. The board
//! receives what it sends, and compares it.
//!
//! The functions of [`Bus`] never wait: their futures return to the caller while bytes are under
//! way. Nothing wakes them, so the caller polls them again and again, for instance in its main
//! loop.

use crate::{CurrentError, Currents, SettingError, Trouble, microstep_code, turn};
use embedded_hal_nb::serial::{Read, Write};

/// Registers.
mod register {
    pub const GCONF: u8 = 0x00;
    pub const GSTAT: u8 = 0x01;
    pub const IFCNT: u8 = 0x02;
    pub const NODECONF: u8 = 0x03;
    pub const IOIN: u8 = 0x06;
    pub const IHOLD_IRUN: u8 = 0x10;
    pub const TCOOLTHRS: u8 = 0x14;
    pub const SGTHRS: u8 = 0x40;
    pub const SG_RESULT: u8 = 0x41;
    pub const CHOPCONF: u8 = 0x6C;
    pub const DRV_STATUS: u8 = 0x6F;
}

/// Addresses of a bus, by the pins MS1 and MS2.
pub const ADDRESSES: u8 = 4;

const SYNC: u8 = 0x05;
const WRITE: u8 = 0x80;
/// Address of the board in a reply.
const MASTER: u8 = 0xFF;
/// Version that IOIN reports.
const VERSION: u8 = 0x21;
/// PDN_UART is a UART; microsteps by register; multistep filter. The reference of the currents is
/// the internal one, not a potentiometer.
const GCONF: u32 = 1 << 6 | 1 << 7 | 1 << 8;
/// A reply begins 24 bit times after its request. With the 8 of the reset a chip that is not
/// addressed may take the reply for an error (data sheet 4.4).
const NODECONF: u32 = 2 << 8;
/// Chopper of the data sheet: off time 3, hysteresis start 5; interpolation to 256 microsteps.
const CHOPCONF: u32 = 0x1000_0053;
/// Bit of CHOPCONF: the lower range of the sense voltage, 180 mV.
const VSENSE: u32 = 1 << 17;
/// Flags of GSTAT: reset, drive error, undervoltage of the charge pump.
const GSTAT: u32 = 0b111;
/// Full scale of the sense voltage, uV, without and with [`VSENSE`].
const FULL_SCALE_UV: [u64; 2] = [325_000, 180_000];
/// Resistance of the chip beside the sense resistor, mOhm.
const INTERNAL_MOHM: u64 = 20;
/// Delay from run to hold current, in 2^18 clocks per current step.
const HOLD_DELAY: u32 = 6;

/// Longest time for a byte to leave or to arrive, us. A whole exchange takes less at 9600 baud, so
/// this is a chip that is silent.
const PATIENCE_US: u32 = 20_000;
/// Bit times without a byte before a datagram. After 12 of them a chip that has lost the beginning
/// of a datagram finds the next one (data sheet 4.1); some are for the rounding of the baud rate.
const IDLE_BITS: u32 = 16;

/// Reason why a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<E> {
    /// The UART reported an error.
    Serial(E),
    /// No byte came in time: no supply, wrong address, or the wire is broken.
    NoReply,
    /// The board did not read back what it sent: the wire is shorted or driven by another chip.
    Echo,
    /// The wire was not silent before a datagram.
    Noise,
    /// The check of a reply is wrong.
    Check,
    /// A reply belongs to another register, or is not addressed to the board.
    WrongReply,
    /// The chip did not take every write: its counter of writes is another one.
    NotTaken,
    /// A register does not have the value that was written.
    ReadBack {
        /// The register.
        register: u8,
        /// Its value.
        found: u32,
    },
    /// The chip is not a TMC2209; the version it reports.
    Version(u8),
    /// The chip is configured, and does not drive its motor.
    Trouble(Trouble),
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

/// Registers of a chip with its settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    chopper: u32,
    holding: u32,
}

impl Settings {
    /// Registers of these currents and this number of microsteps.
    ///
    /// # Errors
    /// The chip does not have them.
    pub fn new(currents: Currents, microsteps: u16) -> Result<Self, SettingError> {
        let resolution = microstep_code(microsteps).map_err(SettingError::Microsteps)?;
        let (range, run) =
            current_code(currents.run_ma, currents).map_err(SettingError::Current)?;
        let hold = hold_code(range, currents).map_err(SettingError::Current)?;
        let mut chopper = CHOPCONF & !(0xF << 24) | resolution << 24;
        if range == 1 {
            chopper |= VSENSE;
        }
        Ok(Self {
            chopper,
            holding: HOLD_DELAY << 16 | u32::from(run) << 8 | u32::from(hold),
        })
    }
}

/// The one-wire UART of up to four TMC2209. Its receiver must hold a whole exchange, 12 bytes.
pub struct Bus<S, C> {
    serial: S,
    /// A free running count; its counts in [`PATIENCE_US`] and [`IDLE_BITS`].
    clock: C,
    patience: u32,
    idle: u32,
}

impl<S, C, E> Bus<S, C>
where
    S: Read<u8, Error = E> + Write<u8, Error = E>,
    C: FnMut() -> u32,
{
    /// A bus at a UART with this baud rate, 9600 to 500,000. The clock counts so many times in a
    /// microsecond, and wraps around.
    pub const fn new(serial: S, clock: C, counts_per_us: u32, baud: u32) -> Self {
        Self {
            serial,
            clock,
            patience: PATIENCE_US * counts_per_us,
            idle: IDLE_BITS * (1_000_000 / baud + 1) * counts_per_us,
        }
    }

    /// Delays the replies of all chips on the wire, so that none disturbs another one. Chips that
    /// are there take it; nothing is read. Call it before anything is read from one of several
    /// chips.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn separate_replies(&mut self) -> Result<(), Error<E>> {
        for address in 0..ADDRESSES {
            self.send_value(address, register::NODECONF, NODECONF)
                .await?;
        }
        Ok(())
    }

    /// Checks that a chip answers, writes its settings, and reads them back.
    ///
    /// The registers of the currents and of the delay cannot be read: the counter of writes shows
    /// that the chip took them.
    ///
    /// # Errors
    /// See [`Error`]. After an error the drive must stay disabled: its current is unknown.
    pub async fn configure(&mut self, address: u8, settings: &Settings) -> Result<(), Error<E>> {
        let version = (self.read(address, register::IOIN).await? >> 24) as u8;
        if version != VERSION {
            return Err(Error::Version(version));
        }
        let kept = [
            (register::GCONF, GCONF),
            (register::CHOPCONF, settings.chopper),
        ];
        let [general, chopper] = kept;
        let writes = [
            (register::NODECONF, NODECONF),
            general,
            chopper,
            (register::IHOLD_IRUN, settings.holding),
            // Flags of the reset are cleared by writing ones, so that the next reset is seen.
            (register::GSTAT, GSTAT),
        ];
        self.write_all(address, &writes).await?;
        for (register, written) in kept {
            let found = self.read(address, register).await?;
            if found != written {
                return Err(Error::ReadBack { register, found });
            }
        }
        match self.trouble(address).await? {
            None => Ok(()),
            Some(trouble) => Err(Error::Trouble(trouble)),
        }
    }

    /// What keeps a configured chip from driving its motor.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn trouble(&mut self, address: u8) -> Result<Option<Trouble>, Error<E>> {
        let flags = self.read(address, register::GSTAT).await?;
        let status = self.status(address).await?;
        let (is_overheated, is_shorted) = (status.is_overheated(), status.is_shorted());
        Ok(Trouble::of(flags, is_overheated, is_shorted))
    }

    /// State of a chip.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn status(&mut self, address: u8) -> Result<Status, Error<E>> {
        self.read(address, register::DRV_STATUS).await.map(Status)
    }

    /// Sets the threshold of the stall detection: the DIAG pin rises when the load measure is below
    /// twice this value and a step takes at most `slowest_step` clocks (12 MHz). At 0 it never
    /// does.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn set_stall_threshold(
        &mut self,
        address: u8,
        threshold: u8,
        slowest_step: u32,
    ) -> Result<(), Error<E>> {
        let writes = [
            (register::TCOOLTHRS, slowest_step.min(0xF_FFFF)),
            (register::SGTHRS, u32::from(threshold)),
        ];
        self.write_all(address, &writes).await
    }

    /// Load measure of the motor, 0 (stalled) to 510.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn load_measure(&mut self, address: u8) -> Result<u16, Error<E>> {
        let measure = self.read(address, register::SG_RESULT).await?;
        Ok((measure & 0x3FF) as u16)
    }

    /// Writes registers, and checks by the counter of writes that the chip took them.
    async fn write_all(&mut self, address: u8, writes: &[(u8, u32)]) -> Result<(), Error<E>> {
        let before = self.read(address, register::IFCNT).await? as u8;
        for (register, value) in writes {
            self.send_value(address, *register, *value).await?;
        }
        let after = self.read(address, register::IFCNT).await? as u8;
        if after == before.wrapping_add(writes.len() as u8) {
            Ok(())
        } else {
            Err(Error::NotTaken)
        }
    }

    /// Sends the value of a register, without a check that the chip took it.
    async fn send_value(&mut self, address: u8, register: u8, value: u32) -> Result<(), Error<E>> {
        let [a, b, c, d] = value.to_be_bytes();
        self.send(&[SYNC, address, register | WRITE, a, b, c, d])
            .await
    }

    /// Reads a register.
    ///
    /// # Errors
    /// See [`Error`].
    pub async fn read(&mut self, address: u8, register: u8) -> Result<u32, Error<E>> {
        self.send(&[SYNC, address, register]).await?;
        let mut reply = [0; 8];
        for byte in &mut reply {
            *byte = self.receive().await?;
        }
        let [sync, master, replied, a, b, c, d, check] = reply;
        if check_byte(&reply[..7]) != check {
            return Err(Error::Check);
        }
        if (sync & 0xF, master, replied) != (SYNC, MASTER, register) {
            return Err(Error::WrongReply);
        }
        Ok(u32::from_be_bytes([a, b, c, d]))
    }

    /// Sends bytes and their check, and compares the echo.
    async fn send(&mut self, bytes: &[u8]) -> Result<(), Error<E>> {
        self.wait_for_silence().await?;
        let check = check_byte(bytes);
        let all = || bytes.iter().copied().chain([check]);
        // One after the other without a pause: a chip gives a datagram up after a pause of 63 bit
        // times.
        for byte in all() {
            let start = (self.clock)();
            while let Err(error) = self.serial.write(byte) {
                if let nb::Error::Other(error) = error {
                    return Err(Error::Serial(error));
                }
                self.pause(start).await?;
            }
        }
        for byte in all() {
            if self.receive().await? != byte {
                return Err(Error::Echo);
            }
        }
        Ok(())
    }

    /// Waits until the wire was silent for [`IDLE_BITS`]. What arrives meanwhile is late or noise.
    async fn wait_for_silence(&mut self) -> Result<(), Error<E>> {
        let start = (self.clock)();
        let mut since = start;
        loop {
            if !matches!(self.serial.read(), Err(nb::Error::WouldBlock)) {
                since = (self.clock)();
            }
            let now = (self.clock)();
            if now.wrapping_sub(since) >= self.idle {
                return Ok(());
            }
            if now.wrapping_sub(start) > self.patience {
                return Err(Error::Noise);
            }
            turn().await;
        }
    }

    async fn receive(&mut self) -> Result<u8, Error<E>> {
        let start = (self.clock)();
        loop {
            match self.serial.read() {
                Ok(byte) => return Ok(byte),
                Err(nb::Error::WouldBlock) => self.pause(start).await?,
                Err(nb::Error::Other(error)) => return Err(Error::Serial(error)),
            }
        }
    }

    /// Returns to the caller, unless it waits for too long since `start`.
    async fn pause(&mut self, start: u32) -> Result<(), Error<E>> {
        if (self.clock)().wrapping_sub(start) > self.patience {
            return Err(Error::NoReply);
        }
        turn().await;
        Ok(())
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
