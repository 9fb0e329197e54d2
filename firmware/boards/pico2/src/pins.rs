//! Pins of the Pico 2. All inputs are active high at the pin and pulled up, so that a broken wire
//! is an active switch; a normally closed contact to ground is inactive.
//!
//! | pin | direction | |
//! | --- | --- | --- |
//! | GP0, GP1 | out, in | bus of the chips of the drives; with `uart` line to the host |
//! | GP2, GP4, GP6, GP8, GP10 | out | steps of joints 0 to 4 |
//! | GP3, GP5, GP7, GP9, GP11 | out | directions of joints 0 to 4 |
//! | GP12 | out | enable of all drives |
//! | GP13 | out | charge pump: a change in every completed control period |
//! | GP14 | in | emergency stop |
//! | GP15 to GP19 | in | home switches of joints 0 to 4 |
//! | GP20 | in | digital input 0 (a probe, for instance) |
//! | GP21 | out | spindle speed, PWM |
//! | GP22 | out | spindle direction, high is clockwise |
//! | GP25 | out | LED of the board |
//! | GP26 | out | digital output 0 |
//! | GP27 | in | digital input 1 |
//! | GP28 | in | alarm of the drives |

use crate::registers::{IO_BANK0, PADS_BANK0, PWM, SIO, read, write};
use haptimill_board_common::spindle::SpindleLines;
use haptimill_drivers::input_filter::InputFilter;

/// Joints with a drive.
pub const JOINTS: usize = 5;

/// Step pin of joint 0. The pins of a joint are neighbours, step first, and so are the joints.
pub const FIRST_STEP: u32 = 2;
/// Emergency stop.
pub const EMERGENCY_STOP: u32 = 14;

const UART_PINS: [u32; 2] = [0, 1];
const ENABLE: u32 = 12;
const CHARGE_PUMP: u32 = 13;
const FIRST_HOME: u32 = 15;
const INPUTS: [u32; 2] = [20, 27];
const SPINDLE_SPEED: u32 = 21;
const SPINDLE_CLOCKWISE: u32 = 22;
const LED: u32 = 25;
const OUTPUT: u32 = 26;
const ALARM: u32 = 28;

/// Inputs with a noise filter: home switches, digital inputs, alarm.
const FILTERED: u32 = 0x1F << FIRST_HOME | 1 << INPUTS[0] | 1 << INPUTS[1] | 1 << ALARM;
/// Control periods that a new level must last.
const SAMPLES: u8 = 3;

/// Counts of the PWM: 150 MHz / 15,000 = 10 kHz.
const PWM_COUNTS: u32 = 15_000;
/// Registers of the PWM slice of GP21, whose channel B it is.
const SLICE: usize = 2 * 0x14;

/// Functions of a pin.
const UART: u32 = 2;
const PWM_FUNCTION: u32 = 4;
const BY_SOFTWARE: u32 = 5;
const PIO_FUNCTION: [u32; 2] = [6, 7];

const PULL_DOWN: u32 = 1 << 2;
const PULL_UP: u32 = 1 << 3;
const DRIVE_4_MA: u32 = 1 << 4;
const SCHMITT: u32 = 1 << 1;
const INPUT: u32 = 1 << 6;

/// Sets the function and the pad of a pin. It also ends the isolation after a reset.
fn assign(pin: u32, function: u32, pad: u32) {
    write(PADS_BANK0, 4 + 4 * pin as usize, pad | INPUT | SCHMITT);
    write(IO_BANK0, 4 + 8 * pin as usize, function);
}

/// Sets all pins. Outputs are low.
pub fn start() {
    let outputs = [ENABLE, CHARGE_PUMP, SPINDLE_CLOCKWISE, LED, OUTPUT];
    for pin in outputs {
        // Low before the pin drives.
        write(SIO, 0x20, 1 << pin);
        write(SIO, 0x38, 1 << pin);
        assign(pin, BY_SOFTWARE, DRIVE_4_MA | PULL_DOWN);
    }
    let homes = FIRST_HOME..FIRST_HOME + JOINTS as u32;
    for pin in homes.chain(INPUTS).chain([EMERGENCY_STOP, ALARM]) {
        assign(pin, BY_SOFTWARE, PULL_UP);
    }
    if cfg!(feature = "uart") {
        give_to_uart();
    }
    write(PWM, SLICE + 0x10, PWM_COUNTS - 1);
    write(PWM, SLICE + 0xC, 0);
    write(PWM, SLICE, 1);
    assign(SPINDLE_SPEED, PWM_FUNCTION, DRIVE_4_MA | PULL_DOWN);
}

/// Gives the pins of UART0 to it.
fn give_to_uart() {
    for pin in UART_PINS {
        assign(pin, UART, DRIVE_4_MA | PULL_UP);
    }
}

/// Gives the pins of UART0 to the bus of the chips of the drives. A machine without these chips
/// leaves them as they are after a reset.
#[cfg(not(feature = "uart"))]
pub fn give_to_chip_bus() {
    give_to_uart();
}

/// The enable line of the drives is high.
#[cfg(not(feature = "uart"))]
pub fn drives_are_on() -> bool {
    read(SIO, 0x10) >> ENABLE & 1 != 0
}

/// Gives the pins of a joint to its PIO block.
pub fn give_to_pio(joint: usize, block: usize) {
    let step = FIRST_STEP + 2 * joint as u32;
    for pin in [step, step + 1] {
        assign(pin, PIO_FUNCTION[block], DRIVE_4_MA | PULL_DOWN);
    }
}

/// Levels of the inputs at one moment.
#[derive(Clone, Copy)]
pub struct Levels(u32);

impl Levels {
    /// Reads all pins.
    #[inline(always)]
    pub fn read() -> Self {
        Self(read(SIO, 0x4))
    }

    /// The levels after the noise filter; the emergency stop is not filtered.
    pub fn filtered(self, filter: &mut InputFilter) -> Self {
        let unfiltered = 1 << EMERGENCY_STOP;
        Self(filter.add(self.0 & FILTERED) | self.0 & unfiltered)
    }

    /// A noise filter that starts with these levels.
    pub const fn filter(self) -> InputFilter {
        InputFilter::new(SAMPLES, self.0 & FILTERED)
    }

    const fn is_high(self, pin: u32) -> bool {
        self.0 >> pin & 1 != 0
    }

    /// The emergency stop is open.
    pub const fn emergency_stop(self) -> bool {
        self.is_high(EMERGENCY_STOP)
    }

    /// Home switch of a joint.
    pub const fn home(self, joint: usize) -> bool {
        self.is_high(FIRST_HOME + joint as u32)
    }

    /// No drive reports an alarm.
    pub const fn drives_ready(self) -> bool {
        !self.is_high(ALARM)
    }

    /// Digital inputs, channel `k` in bit `k`.
    pub const fn digital(self) -> u32 {
        self.is_high(INPUTS[0]) as u32 | (self.is_high(INPUTS[1]) as u32) << 1
    }
}

/// Sets an output.
#[inline(always)]
fn drive(pin: u32, high: bool) {
    write(SIO, if high { 0x18 } else { 0x20 }, 1 << pin);
}

/// Enables the drives, or disables them.
pub fn enable_drives(on: bool) {
    drive(ENABLE, on);
}

/// Changes the level of the charge pump.
pub fn pump() {
    write(SIO, 0x28, 1 << CHARGE_PUMP);
}

/// Sets the spindle for a control period: clockwise above 0.
pub fn set_spindle(lines: &mut SpindleLines, rpm: i16) {
    let levels = lines.update(rpm, PWM_COUNTS);
    drive(SPINDLE_CLOCKWISE, levels.is_clockwise);
    set_duty(levels.duty);
}

/// Sets the compare value of channel B; a value of all counts is always high.
fn set_duty(counts: u32) {
    write(PWM, SLICE + 0xC, counts << 16);
}

/// Sets the digital outputs, channel `k` from bit `k`.
pub fn set_outputs(levels: u32) {
    drive(OUTPUT, levels & 1 != 0);
}

/// Switches the LED.
pub fn light(on: bool) {
    drive(LED, on);
}

/// Switches everything off that moves.
pub fn make_safe() {
    enable_drives(false);
    set_duty(0);
    set_outputs(0);
}
