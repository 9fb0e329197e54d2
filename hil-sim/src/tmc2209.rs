//! TMC2209 step drivers on one wire, byte by byte.
//!
//! Written from the data sheet, not from the driver in `firmware/drivers`: datagrams and their
//! check, addresses, the delay of a reply, the counter of writes, the pauses after which a chip
//! gives a datagram up, access and reset values of the registers, the latched flags, the
//! temperature and the shorts. Motor, chopper and the electrical side of the wire are not modelled.

use crate::driver_chip::{DRIVE_ERROR, PowerStage, RESET, Register, Registers};

/// Registers (data sheet 5): address, readable, writable, value after a reset.
const REGISTERS: [Register; 21] = [
    (GCONF, true, true, 0x101),
    (GSTAT, true, true, 0),
    (IFCNT, true, false, 0),
    (NODECONF, false, true, 0),
    // OTP_PROG, OTP_READ.
    (0x04, false, true, 0),
    (0x05, true, false, 0),
    (IOIN, true, false, 0),
    // FACTORY_CONF.
    (0x07, true, true, 0),
    (IHOLD_IRUN, false, true, 0x0001_1F10),
    // TPOWERDOWN, TSTEP, TPWMTHRS, TCOOLTHRS, VACTUAL, SGTHRS, SG_RESULT, COOLCONF.
    (0x11, false, true, 20),
    (0x12, true, false, 0xF_FFFF),
    (0x13, false, true, 0),
    (0x14, false, true, 0),
    (0x22, false, true, 0),
    (0x40, false, true, 0),
    (0x41, true, false, 0),
    (0x42, false, true, 0),
    // MSCNT, MSCURACT.
    (0x6A, true, false, 0),
    (0x6B, true, false, 0),
    (CHOPCONF, true, true, 0x1000_0053),
    (DRV_STATUS, true, false, 0),
];

/// General configuration.
pub const GCONF: u8 = 0x00;
/// Latched flags.
pub const GSTAT: u8 = 0x01;
/// Counter of writes.
pub const IFCNT: u8 = 0x02;
/// Delay of replies.
pub const NODECONF: u8 = 0x03;
/// Levels of the pins, and the version.
pub const IOIN: u8 = 0x06;
/// Currents.
pub const IHOLD_IRUN: u8 = 0x10;
/// Chopper: range of the current, microsteps.
pub const CHOPCONF: u8 = 0x6C;
/// State of the driver.
pub const DRV_STATUS: u8 = 0x6F;

/// Temperature at which the driver switches off with the trim of the reset, C.
const SHUTDOWN_C: f64 = 143.0;
/// Temperatures of the comparators t120, t143, t150, t157.
const COMPARATORS_C: [f64; 4] = [120.0, 143.0, 150.0, 157.0];

/// Check of a datagram: the shift register of the data sheet (4.2), a bit at a time.
fn check(bytes: &[u8]) -> u8 {
    let mut register = [false; 8];
    for byte in bytes {
        for bit in 0..8 {
            // CRC = (CRC << 1) OR (CRC.7 XOR CRC.1 XOR CRC.0 XOR [new incoming bit]): the bits 0, 1
            // and 2 get the feedback of the polynomial x^8 + x^2 + x + 1.
            let feedback = register[7] ^ (byte >> bit & 1 != 0);
            register.rotate_right(1);
            register[0] = feedback;
            register[1] ^= feedback;
            register[2] ^= feedback;
        }
    }
    let weights = register.iter().enumerate();
    weights.fold(0, |sum, (bit, set)| sum | u8::from(*set) << bit)
}

/// A chip.
#[derive(Debug, Clone)]
pub struct Chip {
    address: u8,
    registers: Registers<{ REGISTERS.len() }>,
    stage: PowerStage,
    powered: bool,
    enabled: bool,
    received: Vec<u8>,
    /// It waits for a silent wire.
    is_lost: bool,
}

impl Chip {
    /// A chip after power-on, with an address by its pins.
    #[must_use]
    pub fn new(address: u8) -> Self {
        let mut chip = Self {
            address,
            registers: Registers::new(&REGISTERS),
            stage: PowerStage::new(SHUTDOWN_C),
            powered: true,
            enabled: false,
            received: Vec::new(),
            is_lost: false,
        };
        chip.reset();
        chip
    }

    fn reset(&mut self) {
        self.registers.reset(GSTAT);
        self.received.clear();
        self.is_lost = false;
    }

    /// Value of a register, whether the wire can read it or not.
    #[must_use]
    pub fn register(&self, register: u8) -> u32 {
        match register {
            IOIN => 0x21 << 24 | u32::from(!self.enabled) | u32::from(self.address) << 2 | 1 << 6,
            DRV_STATUS => self.status(),
            _ => self.registers.get(register),
        }
    }

    /// The supply of the motor is there; without it the chip is silent. After it it was reset.
    pub fn set_powered(&mut self, powered: bool) {
        if powered && !self.powered {
            self.reset();
        }
        self.powered = powered;
    }

    /// The enable input releases the motor, or not. A released motor clears a short.
    pub fn set_enabled(&mut self, enabled: bool) {
        self.enabled = enabled;
        if self.stage.find_short(enabled) {
            *self.registers.value(GSTAT) |= DRIVE_ERROR;
        }
    }

    /// Temperature of the chip, C. Above its limit it switches the motor off, until it is cold
    /// enough for no warning.
    pub fn set_temperature(&mut self, celsius: f64) {
        if self.stage.set_temperature(celsius) {
            *self.registers.value(GSTAT) |= DRIVE_ERROR;
        }
    }

    /// A phase of the motor is shorted to ground, or not any more. The chip sees it while it
    /// drives.
    pub fn set_shorted(&mut self, shorted: bool) {
        self.stage.set_shorted(shorted);
        self.set_enabled(self.enabled);
    }

    /// A register keeps its value whatever is written.
    pub const fn set_stuck(&mut self, register: Option<u8>) {
        self.registers.set_stuck(register);
    }

    /// Whether the chip drives its motor.
    #[must_use]
    pub const fn drives(&self) -> bool {
        self.powered && self.enabled && self.stage.is_sound()
    }

    fn status(&self) -> u32 {
        let mut status = u32::from(self.stage.is_hot()) | u32::from(self.stage.overheated) << 1;
        status |= u32::from(self.stage.switched_off) << 2;
        for (bit, limit) in COMPARATORS_C.iter().enumerate() {
            status |= u32::from(self.stage.is_at(*limit)) << (8 + bit);
        }
        status
    }

    /// Microsteps of a full step, as the register has them; those of the pins MS1 and MS2 unless
    /// the register counts.
    #[must_use]
    pub fn microsteps(&self) -> u32 {
        if self.register(GCONF) >> 7 & 1 == 0 {
            return [8, 32, 64, 16][usize::from(self.address)];
        }
        256 >> (self.register(CHOPCONF) >> 24 & 0xF)
    }

    /// Currents of the moving and the standing motor, A rms, with these sense resistors, Ohm (data
    /// sheet 9); `None` if a potentiometer scales them.
    #[must_use]
    pub fn currents(&self, sense_ohm: f64) -> Option<[f64; 2]> {
        if self.register(GCONF) & 1 != 0 {
            return None;
        }
        let is_low = self.register(CHOPCONF) >> 17 & 1 != 0;
        let volts = if is_low { 0.18 } else { 0.325 };
        let codes = self.register(IHOLD_IRUN);
        let amperes = |code: u32| {
            f64::from((code & 0x1F) + 1) / 32.0 * volts / (sense_ohm + 0.02)
                * std::f64::consts::FRAC_1_SQRT_2
        };
        Some([amperes(codes >> 8), amperes(codes)])
    }

    /// Bit times from a request to the reply.
    fn delay_bits(&self) -> u64 {
        match self.register(NODECONF) >> 8 & 0xF {
            0 | 1 => 8,
            delay => 8 * u64::from(delay | 1),
        }
    }

    /// Takes a byte of the wire; gives the reply if the byte completes a request.
    fn take(&mut self, byte: u8) -> Option<[u8; 8]> {
        self.received.push(byte);
        let received = &self.received;
        if received[0] & 0xF != 0x5 {
            self.is_lost = true;
            self.received.clear();
            return None;
        }
        let is_write = received.len() > 2 && received[2] >> 7 != 0;
        if received.len() < if is_write { 8 } else { 4 } {
            return None;
        }
        let datagram = std::mem::take(&mut self.received);
        let (body, last) = datagram.split_at(datagram.len() - 1);
        if check(body) != last[0] {
            self.is_lost = true;
            return None;
        }
        if body[1] != self.address {
            return None;
        }
        if is_write {
            let value = body[3..].iter();
            let value = value.fold(0, |sum, byte| sum << 8 | u32::from(*byte));
            self.write(body[2] & 0x7F, value);
            return None;
        }
        Some(self.reply(body[2]))
    }

    fn write(&mut self, register: u8, value: u32) {
        *self.registers.value(IFCNT) = (self.register(IFCNT) + 1) & 0xFF;
        // Ones clear flags; that of an error stays above the limit.
        let error = if self.stage.overheated {
            0
        } else {
            DRIVE_ERROR
        };
        if let Some(held) = self.registers.writable(register) {
            *held = match register {
                GSTAT => *held & !(value & (RESET | error)),
                _ => value,
            };
        }
    }

    fn reply(&self, register: u8) -> [u8; 8] {
        let readable = self.registers.is_readable(register);
        let value = if readable { self.register(register) } else { 0 };
        let [a, b, c, d] = value.to_be_bytes();
        let mut reply = [0x05, 0xFF, register, a, b, c, d, 0];
        reply[7] = check(&reply[..7]);
        reply
    }
}

/// The wire with its chips. All times are those of the caller, in one unit.
#[derive(Debug, Clone, Default)]
pub struct Wire {
    /// The chips.
    pub chips: Vec<Chip>,
    /// Bytes that the board sent.
    pub sent: usize,
    /// Requests to a chip whose replies are as early as after a reset, with other chips on the
    /// wire: one of these may take the reply for an error (data sheet 4.4).
    pub early_replies: usize,
    /// End of the last byte on the wire.
    last_end: u64,
    /// Replies that are under way: the time of their begin.
    replies: Vec<(u64, [u8; 8])>,
}

impl Wire {
    /// A wire with these chips.
    #[must_use]
    pub const fn new(chips: Vec<Chip>) -> Self {
        Self {
            chips,
            sent: 0,
            early_replies: 0,
            last_end: 0,
            replies: Vec::new(),
        }
    }

    /// The board has sent a byte, which ended at a time; a bit takes `bit` of it. The board
    /// receives the byte, too: that is for the caller.
    pub fn send(&mut self, byte: u8, end: u64, bit: u64) {
        self.sent += 1;
        let begin = end.saturating_sub(10 * bit);
        let silent = begin.saturating_sub(self.last_end);
        self.last_end = end;
        let several = self.chips.iter().filter(|it| it.powered).count() > 1;
        for chip in self.chips.iter_mut().filter(|it| it.powered) {
            // From start bit to start bit.
            if !chip.received.is_empty() && silent + 10 * bit > 63 * bit {
                chip.received.clear();
                chip.is_lost = true;
            }
            if chip.is_lost && silent < 12 * bit {
                continue;
            }
            chip.is_lost = false;
            if let Some(reply) = chip.take(byte) {
                let delay = chip.delay_bits();
                self.early_replies += usize::from(several && delay <= 8);
                self.replies.push((end + delay * bit, reply));
            }
        }
    }

    /// Replies whose first byte begins until now. Two at a time are noise.
    pub fn replies(&mut self, now: u64, bit: u64) -> Vec<u8> {
        if self.replies.is_empty() {
            return Vec::new();
        }
        let due = self.replies.iter().filter(|(begin, _)| *begin <= now);
        let due: Vec<_> = due.copied().collect();
        self.replies.retain(|(begin, _)| *begin > now);
        let Some((begin, _)) = due.first() else {
            return Vec::new();
        };
        self.last_end = begin + 80 * bit;
        let wired_and = |at: usize| due.iter().fold(0xFF, |level, (_, reply)| level & reply[at]);
        (0..8).map(wired_and).collect()
    }
}
