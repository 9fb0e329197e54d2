//! Pins of the Pico 2. All inputs are active high at the pin and pulled up, so that a broken wire
//! is an active switch; a normally closed contact to ground is inactive.
//!
//! | pin | direction | |
//! | --- | --- | --- |
//! | GP0, GP1 | out, in | bus of the chips of the drives; with `uart` line to the host |
//! | GP1, GP26, GP27, GP28 | out, out, out, in | with `spi` chip select, clock, data to and from the chips |
//! | GP2, GP4, GP6, GP8, GP10 | out | steps of joints 0 to 4 |
//! | GP3, GP5, GP7, GP9, GP11 | out | directions of joints 0 to 4 |
//! | GP12 | out | enable of all drives |
//! | GP13 | out | charge pump: a change in every completed control period |
//! | GP14 | in | emergency stop |
//! | GP25 | out | LED of the board |
//! | all others | | [`signals`](crate::signals) |

use crate::registers::{IO_BANK0, PADS_BANK0, PWM, SIO, read, write};
use crate::signals;

/// Joints with a drive.
pub const JOINTS: usize = 5;

/// Step pin of joint 0. The pins of a joint are neighbours, step first, and so are the joints.
pub const FIRST_STEP: u32 = 2;
/// Emergency stop.
pub const EMERGENCY_STOP: u32 = 14;

#[cfg(not(any(feature = "encoders", feature = "spi")))]
const UART_PINS: [u32; 2] = [0, 1];
/// Chip select of the chips of the drives.
#[cfg(feature = "spi")]
pub const CHIP_SELECT: u32 = 1;
/// Clock of SPI1, data from it, data to it.
#[cfg(feature = "spi")]
const SPI_PINS: [u32; 3] = [26, 27, 28];
const ENABLE: u32 = 12;
const CHARGE_PUMP: u32 = 13;
const LED: u32 = 25;

/// Counts of the PWM: 150 MHz / 15,000 = 10 kHz.
pub const PWM_COUNTS: u32 = 15_000;
/// Registers of the PWM slice of the spindle, and the place of its channel in them.
const SLICE: usize = (signals::SPINDLE_SPEED / 2 % 8) as usize * 0x14;
const CHANNEL: u32 = 16 * (signals::SPINDLE_SPEED % 2);

/// Functions of a pin.
#[cfg(feature = "spi")]
const SPI: u32 = 1;
#[cfg(not(any(feature = "encoders", feature = "spi")))]
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
    let outputs = [ENABLE, CHARGE_PUMP, LED];
    for &pin in outputs.iter().chain(signals::OUTPUTS) {
        // Low before the pin drives.
        write(SIO, 0x20, 1 << pin);
        write(SIO, 0x38, 1 << pin);
        assign(pin, BY_SOFTWARE, DRIVE_4_MA | PULL_DOWN);
    }
    for &pin in signals::INPUTS.iter().chain(&[EMERGENCY_STOP]) {
        assign(pin, BY_SOFTWARE, PULL_UP);
    }
    #[cfg(feature = "uart")]
    give_to_uart();
    write(PWM, SLICE + 0x10, PWM_COUNTS - 1);
    write(PWM, SLICE + 0xC, 0);
    write(PWM, SLICE, 1);
    assign(signals::SPINDLE_SPEED, PWM_FUNCTION, DRIVE_4_MA | PULL_DOWN);
}

/// Gives the pins of UART0 to it.
#[cfg(not(any(feature = "encoders", feature = "spi")))]
fn give_to_uart() {
    for pin in UART_PINS {
        assign(pin, UART, DRIVE_4_MA | PULL_UP);
    }
}

/// Gives the pins of UART0 to the bus of the chips of the drives. A machine without these chips
/// leaves them as they are after a reset.
#[cfg(not(any(feature = "uart", feature = "encoders", feature = "spi")))]
pub fn give_to_chip_bus() {
    give_to_uart();
}

/// Gives the pins of SPI1 to it, with a high chip select. Without a chip the data read high. A
/// machine without these chips leaves the pins as they are after a reset.
#[cfg(feature = "spi")]
pub fn give_to_chip_chain() {
    // High before the pin drives, and before the clock rises.
    drive(CHIP_SELECT, true);
    write(SIO, 0x38, 1 << CHIP_SELECT);
    assign(CHIP_SELECT, BY_SOFTWARE, DRIVE_4_MA | PULL_UP);
    for pin in SPI_PINS {
        assign(pin, SPI, DRIVE_4_MA | PULL_UP);
    }
}

/// The enable line of the drives is high.
#[cfg(not(any(feature = "uart", feature = "encoders")))]
pub fn drives_are_on() -> bool {
    read(SIO, 0x10) >> ENABLE & 1 != 0
}

/// Gives the pins of a joint to its PIO block.
pub fn give_to_pio(joint: usize, block: usize) {
    let step = FIRST_STEP + 2 * joint as u32;
    give_outputs_to_pio(&[step, step + 1], block);
}

/// Gives outputs to a PIO block.
pub fn give_outputs_to_pio(pins: &[u32], block: usize) {
    for &pin in pins {
        assign(pin, PIO_FUNCTION[block], DRIVE_4_MA | PULL_DOWN);
    }
}

/// Levels of all pins.
#[inline(always)]
pub fn levels() -> u32 {
    read(SIO, 0x4)
}

/// The emergency stop is open.
#[inline(always)]
pub fn emergency_stop() -> bool {
    levels() >> EMERGENCY_STOP & 1 != 0
}

/// Sets an output.
#[inline(always)]
pub fn drive(pin: u32, high: bool) {
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

/// Sets the counts of the PWM in which the line of the spindle speed is high.
pub fn set_duty(counts: u32) {
    write(PWM, SLICE + 0xC, counts << CHANNEL);
}

/// Switches the LED.
pub fn light(on: bool) {
    drive(LED, on);
}

/// Switches everything off that moves.
pub fn make_safe() {
    enable_drives(false);
    set_duty(0);
    signals::make_safe();
}
