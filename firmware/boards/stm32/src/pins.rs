//! Pins. All switch inputs are active high at the pin and pulled up, so that a broken wire is an
//! active switch; a normally closed contact to ground is inactive.
//!
//! | pin | direction | |
//! | --- | --- | --- |
//! | PD8, PD9 | out, in | line to the host: transmit, receive |
//! | PE4 to PE8 | out | steps of joints 0 to 4 |
//! | PE10, PE12, PE14, PE15, PE2 | out | directions of joints 0 to 4 |
//! | PA15, PB3, PB10 | in | encoder of joint 0: A, B, index |
//! | PA0, PA1, PA2 | in | encoder of joint 1 |
//! | PB4, PB5, PB0 | in | encoder of joint 2 |
//! | PB6, PB7, PB8 | in | encoder of joint 3 |
//! | PC6 | in | emergency stop |
//! | PC1, PC2, PC4, PC5, PC8 | in | home switches of joints 0 to 4 |
//! | PD0, PD1, PD2, PD3, PD6 | in | limit switches at the lower ends |
//! | PD7, PD10, PD11, PC9, PC11 | in | limit switches at the upper ends |
//! | PA3 | in | alarm of the drives |
//! | PA8, PA10 | in | digital inputs 0 (a probe, for instance) and 1 |
//! | PB12 | out | enable of all drives |
//! | PB13 | out | charge pump: a change in every completed control period |
//! | PB14 | out | spindle speed, PWM |
//! | PB15 | out | spindle direction, high is clockwise |
//! | PB11 | out | digital output 0 |
//! | PD12 | out | LED |

use crate::clocks;
use crate::registers::port::{FUNCTIONS, INPUT, MODES, OUTPUT, PULLS, SET_RESET, SPEEDS};
use crate::registers::timer::{
    CHANNEL_1, CHANNEL_ENABLES, CHANNELS_1_2, CONTROL, EVENTS, PRESCALER, RELOAD, RUN, UPDATE,
};
use crate::registers::{GPIOA, GPIOB, GPIOC, GPIOD, GPIOE, TIM12, change, read, write};
use haptimill_board_common::spindle::SpindleLines;
use haptimill_board_common::step_samples::Lines;
use haptimill_drivers::input_filter::InputFilter;

/// Joints with a drive.
pub const JOINTS: usize = 5;

/// Port of the step and direction lines.
pub const STEP_PORT: usize = GPIOE;
/// The lines of each joint.
pub const STEP_LINES: [Lines; JOINTS] = [
    lines(4, 10),
    lines(5, 12),
    lines(6, 14),
    lines(7, 15),
    lines(8, 2),
];

const fn lines(step: u8, direction: u8) -> Lines {
    Lines { step, direction }
}

/// A pin of a port.
#[derive(Clone, Copy)]
struct Pin(usize, u32);

const ENABLE: Pin = Pin(GPIOB, 12);
const CHARGE_PUMP: Pin = Pin(GPIOB, 13);
const SPINDLE_SPEED: Pin = Pin(GPIOB, 14);
const SPINDLE_CLOCKWISE: Pin = Pin(GPIOB, 15);
const OUTPUT_0: Pin = Pin(GPIOB, 11);
const LED: Pin = Pin(GPIOD, 12);

const EMERGENCY_STOP: Pin = Pin(GPIOC, 6);
const HOME: [Pin; JOINTS] = [
    Pin(GPIOC, 1),
    Pin(GPIOC, 2),
    Pin(GPIOC, 4),
    Pin(GPIOC, 5),
    Pin(GPIOC, 8),
];
const LIMIT_LOW: [Pin; JOINTS] = [
    Pin(GPIOD, 0),
    Pin(GPIOD, 1),
    Pin(GPIOD, 2),
    Pin(GPIOD, 3),
    Pin(GPIOD, 6),
];
const LIMIT_HIGH: [Pin; JOINTS] = [
    Pin(GPIOD, 7),
    Pin(GPIOD, 10),
    Pin(GPIOD, 11),
    Pin(GPIOC, 9),
    Pin(GPIOC, 11),
];
const ALARM: Pin = Pin(GPIOA, 3);
const DIGITAL: [Pin; 2] = [Pin(GPIOA, 8), Pin(GPIOA, 10)];

/// Pins of devices, and the function that connects them: encoders, emergency stop (TIM8), USART3.
const OF_DEVICES: [(Pin, u32); 15] = [
    (Pin(GPIOA, 15), 1),
    (Pin(GPIOB, 3), 1),
    (Pin(GPIOB, 10), 1),
    (Pin(GPIOA, 0), 2),
    (Pin(GPIOA, 1), 2),
    (Pin(GPIOA, 2), 2),
    (Pin(GPIOB, 4), 2),
    (Pin(GPIOB, 5), 2),
    (Pin(GPIOB, 0), 2),
    (Pin(GPIOB, 6), 2),
    (Pin(GPIOB, 7), 2),
    (Pin(GPIOB, 8), 2),
    (EMERGENCY_STOP, 3),
    (Pin(GPIOD, 8), 7),
    (Pin(GPIOD, 9), 7),
];
/// Function of TIM12.
const SPINDLE_FUNCTION: u32 = 9;

/// Control periods that a new level of a switch or the alarm must last.
const SAMPLES: u8 = 3;

/// Counts of the PWM: 84 MHz / 8,400 = 10 kHz.
const PWM_COUNTS: u32 = 8_400;
/// PWM mode 1 of channel 1, its compare value taken over at an update.
const PWM_MODE: u32 = 0b110 << 4 | 1 << 3;

/// Modes of a pin.
const MODE_INPUT: u32 = 0;
const MODE_OUTPUT: u32 = 1;
const MODE_DEVICE: u32 = 2;
const PULL_NONE: u32 = 0;
const PULL_UP: u32 = 1;
/// Edges of some 10 ns.
const SPEED_MEDIUM: u32 = 1;

impl Pin {
    /// Sets a field of two bits.
    fn set(self, register: usize, value: u32) {
        let shift = 2 * self.1;
        change(self.0, register, 0b11 << shift, value << shift);
    }

    fn drive(self, high: bool) {
        write(
            self.0,
            SET_RESET,
            1 << if high { self.1 } else { self.1 + 16 },
        );
    }

    /// Makes it an output, low before it drives.
    fn start_output(self) {
        self.drive(false);
        self.set(SPEEDS, SPEED_MEDIUM);
        self.set(PULLS, PULL_NONE);
        self.set(MODES, MODE_OUTPUT);
    }

    /// Connects it to a device.
    fn connect(self, function: u32, pull: u32) {
        let (register, shift) = (FUNCTIONS + 4 * (self.1 as usize / 8), 4 * (self.1 % 8));
        change(self.0, register, 0xF << shift, function << shift);
        self.set(PULLS, pull);
        self.set(SPEEDS, SPEED_MEDIUM);
        self.set(MODES, MODE_DEVICE);
    }
}

/// Sets all pins. Outputs are low.
pub fn start() {
    clocks::open_ports();
    for pin in [
        ENABLE,
        CHARGE_PUMP,
        SPINDLE_SPEED,
        SPINDLE_CLOCKWISE,
        OUTPUT_0,
        LED,
    ] {
        pin.start_output();
    }
    for lines in STEP_LINES {
        for pin in [lines.step, lines.direction] {
            Pin(STEP_PORT, pin.into()).start_output();
        }
    }
    let switches = HOME.into_iter().chain(LIMIT_LOW).chain(LIMIT_HIGH);
    for pin in switches.chain(DIGITAL).chain([ALARM]) {
        pin.set(MODES, MODE_INPUT);
        pin.set(PULLS, PULL_UP);
    }
    for (pin, function) in OF_DEVICES {
        pin.connect(function, PULL_UP);
    }
}

/// Starts the PWM of the spindle, at a duty of 0.
pub fn start_spindle() {
    write(TIM12, PRESCALER, 0);
    write(TIM12, RELOAD, PWM_COUNTS - 1);
    write(TIM12, CHANNEL_1, 0);
    write(TIM12, CHANNELS_1_2, PWM_MODE);
    write(TIM12, CHANNEL_ENABLES, 1);
    write(TIM12, EVENTS, UPDATE);
    write(TIM12, CONTROL, RUN);
    SPINDLE_SPEED.connect(SPINDLE_FUNCTION, PULL_NONE);
}

/// Levels of the inputs. Bits: home switches from 0, limit switches from 5 and 10, alarm 15,
/// digital inputs from 16, emergency stop 31.
#[derive(Clone, Copy)]
pub struct Levels(u32);

const LOW: u32 = JOINTS as u32;
const HIGH: u32 = 2 * JOINTS as u32;
const ALARM_BIT: u32 = 3 * JOINTS as u32;
const DIGITAL_BIT: u32 = 16;
const STOP_BIT: u32 = 31;
/// The levels with a noise filter: switches and alarm.
const FILTERED: u32 = (1 << DIGITAL_BIT) - 1;

impl Levels {
    /// Reads all ports, one after the other.
    #[inline(always)]
    pub fn read() -> Self {
        let ports = [read(GPIOA, INPUT), read(GPIOC, INPUT), read(GPIOD, INPUT)];
        let level = |pin: Pin| {
            let port = match pin.0 {
                GPIOA => ports[0],
                GPIOC => ports[1],
                _ => ports[2],
            };
            port >> pin.1 & 1
        };
        let mut levels = level(ALARM) << ALARM_BIT
            | level(DIGITAL[0]) << DIGITAL_BIT
            | level(DIGITAL[1]) << (DIGITAL_BIT + 1)
            | level(EMERGENCY_STOP) << STOP_BIT;
        for joint in 0..JOINTS {
            levels |= level(HOME[joint]) << joint
                | level(LIMIT_LOW[joint]) << (LOW + joint as u32)
                | level(LIMIT_HIGH[joint]) << (HIGH + joint as u32);
        }
        Self(levels)
    }

    /// The levels after the noise filter; digital inputs and the emergency stop are not filtered.
    pub fn filtered(self, filter: &mut InputFilter) -> Self {
        Self(filter.add(self.0 & FILTERED) | self.0 & !FILTERED)
    }

    /// A noise filter that starts with these levels.
    pub const fn filter(self) -> InputFilter {
        InputFilter::new(SAMPLES, self.0 & FILTERED)
    }

    const fn is_high(self, bit: u32) -> bool {
        self.0 >> bit & 1 != 0
    }

    /// The emergency stop is open.
    pub const fn emergency_stop(self) -> bool {
        self.is_high(STOP_BIT)
    }

    /// Home switch of a joint.
    pub const fn home(self, joint: usize) -> bool {
        self.is_high(joint as u32)
    }

    /// Limit switch at the lower end of a joint.
    pub const fn limit_low(self, joint: usize) -> bool {
        self.is_high(LOW + joint as u32)
    }

    /// Limit switch at the upper end of a joint.
    pub const fn limit_high(self, joint: usize) -> bool {
        self.is_high(HIGH + joint as u32)
    }

    /// No drive reports an alarm.
    pub const fn drives_ready(self) -> bool {
        !self.is_high(ALARM_BIT)
    }

    /// Digital inputs, channel `k` in bit `k`.
    pub const fn digital(self) -> u32 {
        self.0 >> DIGITAL_BIT & 0b11
    }
}

/// Enables the drives, or disables them.
pub fn enable_drives(on: bool) {
    ENABLE.drive(on);
}

/// Changes the level of the charge pump.
pub fn pump() {
    let Pin(port, pin) = CHARGE_PUMP;
    CHARGE_PUMP.drive(read(port, OUTPUT) >> pin & 1 == 0);
}

/// Sets the spindle: clockwise above 0.
pub fn set_spindle(lines: &mut SpindleLines, rpm: i16) {
    let levels = lines.update(rpm, PWM_COUNTS);
    SPINDLE_CLOCKWISE.drive(levels.is_clockwise);
    // A compare value of all counts is always high.
    write(TIM12, CHANNEL_1, levels.duty);
}

/// Sets the digital outputs, channel `k` from bit `k`.
pub fn set_outputs(levels: u32) {
    OUTPUT_0.drive(levels & 1 != 0);
}

/// Switches the LED.
pub fn light(on: bool) {
    LED.drive(on);
}

/// Switches everything off that moves. It depends on no clock but that of the ports.
pub fn make_safe() {
    enable_drives(false);
    SPINDLE_CLOCKWISE.drive(false);
    SPINDLE_SPEED.start_output();
    set_outputs(0);
    for lines in STEP_LINES {
        write(STEP_PORT, SET_RESET, lines.fall());
    }
}
