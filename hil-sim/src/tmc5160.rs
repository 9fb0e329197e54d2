//! TMC5160 step drivers in a chain at an SPI, edge by edge.
//!
//! Written from the data sheet, not from the driver in `firmware/drivers`: the shift register of 40
//! bits, the delay of the data by a datagram, access and reset values of the registers, the latched
//! flags, the temperature, the shorts and the charge pump. Motor, chopper, ramp generator and the
//! electrical side of the wires are not modelled; a chip without its supply holds its SDO low.

use crate::driver_chip::{DRIVE_ERROR, PowerStage, RESET, Register, Registers};

/// Registers (data sheet 6): address, readable, writable, value after a reset. Those of the ramp
/// generator and of the encoder are left out.
const REGISTERS: [Register; 25] = [
    (GCONF, true, true, 0),
    (GSTAT, true, true, 0),
    (IOIN, true, false, 0),
    // OTP_PROG, OTP_READ, FACTORY_CONF, SHORT_CONF, DRV_CONF.
    (0x06, false, true, 0),
    (0x07, true, false, 0),
    (0x08, true, true, 0),
    (0x09, false, true, 0),
    (0x0A, false, true, 0),
    (GLOBALSCALER, false, true, 0),
    // OFFSET_READ.
    (0x0C, true, false, 0),
    (IHOLD_IRUN, false, true, 0),
    // TPOWERDOWN, TSTEP, TPWMTHRS.
    (0x11, false, true, 10),
    (0x12, true, false, 0xF_FFFF),
    (0x13, false, true, 0),
    (TCOOLTHRS, false, true, 0),
    // THIGH, MSCNT, MSCURACT.
    (0x15, false, true, 0),
    (0x6A, true, false, 0),
    (0x6B, true, false, 0),
    (CHOPCONF, true, true, 0x1041_0150),
    (COOLCONF, false, true, 0),
    // DCCTRL.
    (0x6E, false, true, 0),
    (DRV_STATUS, true, false, 0),
    // PWMCONF, PWM_SCALE, LOST_STEPS.
    (0x70, false, true, 0xC40C_001E),
    (0x71, true, false, 0),
    (0x73, true, false, 0),
];

/// General configuration.
pub const GCONF: u8 = 0x00;
/// Latched flags.
pub const GSTAT: u8 = 0x01;
/// Levels of the pins, and the version.
pub const IOIN: u8 = 0x04;
/// Scaler of all currents.
pub const GLOBALSCALER: u8 = 0x0B;
/// Currents.
pub const IHOLD_IRUN: u8 = 0x10;
/// Longest step with the stall detection.
pub const TCOOLTHRS: u8 = 0x14;
/// Chopper: off time, microsteps.
pub const CHOPCONF: u8 = 0x6C;
/// Threshold of the stall detection.
pub const COOLCONF: u8 = 0x6D;
/// State of the driver.
pub const DRV_STATUS: u8 = 0x6F;

/// Flag of GSTAT.
const LOW_CHARGE_PUMP: u32 = 4;

/// Temperature at which the driver switches off, C.
const SHUTDOWN_C: f64 = 150.0;

/// Bits of a datagram.
const BITS: u32 = 40;

/// A chip.
#[derive(Debug, Clone)]
pub struct Chip {
    registers: Registers<{ REGISTERS.len() }>,
    stage: PowerStage,
    powered: bool,
    enabled: bool,
    /// The pin SD_MODE is high: steps come from outside.
    takes_steps: bool,
    standing: bool,
    /// The charge pump has too low a voltage.
    is_pump_low: bool,
    /// Data of the next reply.
    data: u32,
    shift: u64,
    bits: u32,
    /// Level of SDO.
    output: bool,
}

impl Default for Chip {
    /// A chip after power-on, with its pin SD_MODE high, whose motor is at standstill.
    fn default() -> Self {
        let mut chip = Self {
            registers: Registers::new(&REGISTERS),
            stage: PowerStage::new(SHUTDOWN_C),
            powered: true,
            enabled: false,
            takes_steps: true,
            standing: true,
            is_pump_low: false,
            data: 0,
            shift: 0,
            bits: 0,
            output: false,
        };
        chip.reset();
        chip
    }
}

impl Chip {
    fn reset(&mut self) {
        self.registers.reset(GSTAT);
        self.data = 0;
        self.bits = 0;
    }

    /// Value of a register, whether the SPI can read it or not.
    #[must_use]
    pub fn register(&self, register: u8) -> u32 {
        match register {
            IOIN => 0x30 << 24 | u32::from(self.takes_steps) << 6 | u32::from(!self.enabled) << 4,
            DRV_STATUS => self.status(),
            _ => self.registers.get(register),
        }
    }

    /// The supply of the motor is there, or not. After it the chip was reset.
    pub fn set_powered(&mut self, powered: bool) {
        if powered && !self.powered {
            self.reset();
        }
        self.powered = powered;
    }

    /// The enable input releases the motor, or not. A released motor clears a short.
    pub fn set_enabled(&mut self, enabled: bool) {
        self.enabled = enabled;
        self.find_short();
    }

    /// Level of the pin SD_MODE.
    pub const fn set_takes_steps(&mut self, takes_steps: bool) {
        self.takes_steps = takes_steps;
    }

    /// The motor is at standstill.
    pub const fn set_standing(&mut self, standing: bool) {
        self.standing = standing;
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
        self.find_short();
    }

    /// The voltage of the charge pump is too low, or not any more. The flag stays.
    pub fn set_pump_low(&mut self, is_pump_low: bool) {
        self.is_pump_low = is_pump_low;
        if is_pump_low {
            *self.registers.value(GSTAT) |= LOW_CHARGE_PUMP;
        }
    }

    /// A register keeps its value whatever is written.
    pub const fn set_stuck(&mut self, register: Option<u8>) {
        self.registers.set_stuck(register);
    }

    /// The power stage works: the enable input is low, and the off time is not 0.
    fn is_on(&self) -> bool {
        self.powered && self.enabled && self.register(CHOPCONF) & 0xF != 0
    }

    fn find_short(&mut self) {
        if self.stage.find_short(self.is_on()) {
            *self.registers.value(GSTAT) |= DRIVE_ERROR;
        }
    }

    /// Whether the chip drives its motor by steps from outside.
    #[must_use]
    pub fn drives(&self) -> bool {
        self.is_on() && self.takes_steps && self.stage.is_sound() && !self.is_pump_low
    }

    fn status(&self) -> u32 {
        u32::from(self.stage.overheated) << 25
            | u32::from(self.stage.is_hot()) << 26
            | u32::from(self.stage.switched_off) << 27
            | u32::from(self.standing) << 31
    }

    /// Microsteps of a full step.
    #[must_use]
    pub fn microsteps(&self) -> u32 {
        256 >> (self.register(CHOPCONF) >> 24 & 0xF)
    }

    /// Currents of the moving and the standing motor, A rms, with these sense resistors, Ohm (data
    /// sheet 9).
    #[must_use]
    pub fn currents(&self, sense_ohm: f64) -> [f64; 2] {
        let scaler = match self.register(GLOBALSCALER) & 0xFF {
            0 => 256,
            scaler => scaler,
        };
        let codes = self.register(IHOLD_IRUN);
        let amperes = |code: u32| {
            f64::from(scaler) / 256.0 * f64::from((code & 0x1F) + 1) / 32.0 * 0.325 / sense_ohm
                * std::f64::consts::FRAC_1_SQRT_2
        };
        [amperes(codes >> 8), amperes(codes)]
    }

    /// The chip select falls: the reply is in the shift register.
    fn load(&mut self) {
        let flags = self.register(GSTAT);
        let status = flags & (RESET | DRIVE_ERROR) | u32::from(self.standing) << 3;
        self.shift = u64::from(status) << 32 | u64::from(self.data);
        self.bits = 0;
        self.put_out();
    }

    /// The clock falls, or the chip select: SDO has the next bit.
    const fn put_out(&mut self) {
        self.output = self.shift >> (BITS - 1) & 1 != 0;
    }

    /// The clock rises: SDI is taken.
    const fn take_in(&mut self, input: bool) {
        self.shift = self.shift << 1 & ((1 << BITS) - 1) | input as u64;
        self.bits += 1;
    }

    /// The chip select rises: the last 40 bits are a datagram.
    fn execute(&mut self) {
        if self.bits < BITS {
            return;
        }
        let register = (self.shift >> 32) as u8;
        let value = self.shift as u32;
        if register >> 7 != 0 {
            self.write(register & 0x7F, value);
            self.data = value;
        } else {
            let readable = self.registers.is_readable(register);
            self.data = if readable { self.register(register) } else { 0 };
        }
    }

    fn write(&mut self, register: u8, value: u32) {
        // Ones clear flags; those of a present error stay.
        let mut stays = if self.stage.overheated {
            DRIVE_ERROR
        } else {
            0
        };
        stays |= if self.is_pump_low { LOW_CHARGE_PUMP } else { 0 };
        if let Some(held) = self.registers.writable(register) {
            *held = match register {
                GSTAT => *held & !(value & !stays),
                _ => value,
            };
        }
        self.find_short();
    }
}

/// A broken wire from SDO of a chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// Position of the chip.
    pub position: usize,
    /// Level that the other end of the wire has.
    pub level: bool,
}

/// Chips behind one chip select; SDI of the first one is at the board, and SDO of each one is SDI
/// of the next one, of the last one that of the board.
#[derive(Debug, Clone, Default)]
pub struct Chain {
    /// The chips.
    pub chips: Vec<Chip>,
    /// A broken wire.
    pub cut: Option<Cut>,
    /// Transfers: rises of the chip select.
    pub transfers: u64,
    /// Falls of the chip select with a low clock, which mode 3 does not have.
    pub mode_errors: u64,
    /// Levels of chip select and clock.
    is_selected: bool,
    clock: bool,
}

impl Chain {
    /// A chain of these chips, whose chip select and clock are high.
    #[must_use]
    pub const fn new(chips: Vec<Chip>) -> Self {
        Self {
            chips,
            cut: None,
            transfers: 0,
            mode_errors: 0,
            is_selected: false,
            clock: true,
        }
    }

    /// Level behind SDO of a chip.
    fn output(&self, position: usize) -> bool {
        match self.cut {
            Some(cut) if cut.position == position => cut.level,
            _ => {
                let chip = self.chips.get(position);
                chip.is_none_or(|chip| chip.powered && chip.output)
            }
        }
    }

    /// Follows the levels of chip select, clock and data from the board; returns that of the data
    /// to the board, which is pulled up while no chip drives it.
    pub fn follow(&mut self, select: bool, clock: bool, data: bool) -> bool {
        let is_selected = !select;
        let rises = clock && !self.clock;
        let falls = !clock && self.clock;
        if is_selected && !self.is_selected {
            self.mode_errors += u64::from(!clock);
            self.chips.iter_mut().for_each(Chip::load);
        } else if is_selected && rises {
            let inputs = [data].into_iter();
            let inputs = inputs.chain((0..self.chips.len()).map(|position| self.output(position)));
            let inputs: Vec<bool> = inputs.collect();
            for (chip, input) in self.chips.iter_mut().zip(inputs) {
                chip.take_in(input);
            }
        } else if is_selected && falls {
            self.chips.iter_mut().for_each(Chip::put_out);
        } else if !is_selected && self.is_selected {
            self.transfers += 1;
            let chips = self.chips.iter_mut().filter(|chip| chip.powered);
            chips.for_each(Chip::execute);
        }
        (self.is_selected, self.clock) = (is_selected, clock);
        !is_selected || self.output(self.chips.len().wrapping_sub(1))
    }

    /// Sends a byte in mode 3 while the chip select is low; returns the byte that comes meanwhile.
    pub fn exchange(&mut self, byte: u8) -> u8 {
        (0..8).rev().fold(0, |received, bit| {
            let data = byte >> bit & 1 != 0;
            let level = self.follow(!self.is_selected, false, data);
            self.follow(!self.is_selected, true, data);
            received << 1 | u8::from(level)
        })
    }

    /// Sets the chip select.
    pub fn select(&mut self, level: bool) {
        self.follow(level, self.clock, false);
    }
}
