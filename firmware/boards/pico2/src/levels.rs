//! Switches, digital inputs and outputs, spindle: each signal at a pin of its own.
//!
//! | pin | direction | |
//! | --- | --- | --- |
//! | GP15 to GP19 | in | home switches of joints 0 to 4 |
//! | GP20 | in | digital input 0 (a probe, for instance) |
//! | GP21 | out | spindle speed, PWM |
//! | GP22 | out | spindle direction, high is clockwise |
//! | GP26 | out | digital output 0 |
//! | GP27 | in | digital input 1 |
//! | GP28 | in | alarm of the drives |
//!
//! With the feature `spi` the chips of the drives have GP26 to GP28 and report the alarms.

use crate::pins::{self, JOINTS};
use haptimill_drivers::input_filter::InputFilter;

const FIRST_HOME: u32 = 15;
const FIRST_DIGITAL: u32 = 20;
const SECOND_DIGITAL: u32 = 27;
const ALARM: u32 = 28;
const SPINDLE_CLOCKWISE: u32 = 22;
const OUTPUT: u32 = 26;

/// Pin of the spindle speed.
pub const SPINDLE_SPEED: u32 = 21;
/// Whether the second digital input, the digital output and the alarm have their pins.
const HAS_ALL: bool = !cfg!(feature = "spi");
/// Pins of the inputs. The last two are inputs only with [`HAS_ALL`].
const ALL_INPUTS: [u32; 8] = [15, 16, 17, 18, 19, FIRST_DIGITAL, SECOND_DIGITAL, ALARM];
/// Pins of the inputs.
pub const INPUTS: &[u32] = ALL_INPUTS.split_at(if HAS_ALL { 8 } else { 6 }).0;
/// Pins of the outputs.
pub const OUTPUTS: &[u32] = [SPINDLE_CLOCKWISE, OUTPUT].split_at(1 + HAS_ALL as usize).0;

/// All inputs have the noise filter.
const FILTERED: u32 = {
    let mut all = 0;
    let mut at = 0;
    while at < INPUTS.len() {
        all |= 1 << INPUTS[at];
        at += 1;
    }
    all
};
/// Control periods that a new level must last.
const SAMPLES: u8 = 3;

/// Levels of the inputs after the noise filter.
#[derive(Clone, Copy)]
pub struct Levels(u32);

impl Levels {
    const fn is_high(self, pin: u32) -> bool {
        self.0 >> pin & 1 != 0
    }

    /// Home switch of a joint.
    pub const fn home(self, joint: usize) -> bool {
        joint < JOINTS && self.is_high(FIRST_HOME + joint as u32)
    }

    /// Limit switches of a joint: none.
    pub const fn limits(self, _joint: usize) -> (bool, bool) {
        (false, false)
    }

    /// The drive of a joint reports no alarm: all have one line. Pins that are no inputs are low.
    pub const fn is_ready(self, _joint: usize) -> bool {
        !self.is_high(ALARM)
    }

    /// Digital inputs, channel `k` in bit `k`.
    pub const fn digital(self) -> u32 {
        self.is_high(FIRST_DIGITAL) as u32 | (self.is_high(SECOND_DIGITAL) as u32) << 1
    }
}

/// The signals.
pub struct Signals(InputFilter);

impl Signals {
    /// Starts with the present levels.
    pub fn start() -> Self {
        Self(InputFilter::new(SAMPLES, pins::levels() & FILTERED))
    }

    /// Reads the inputs of a control period.
    #[inline(always)]
    pub fn read(&mut self) -> Levels {
        Levels(self.0.add(pins::levels() & FILTERED))
    }

    /// Changes of the inputs that the noise filter suppressed.
    pub const fn glitches(&self) -> u32 {
        self.0.all_glitches()
    }

    /// Sets the direction of the spindle, and the digital outputs, channel `k` from bit `k`.
    pub fn write(&mut self, is_clockwise: bool, digital: u32) {
        pins::drive(SPINDLE_CLOCKWISE, is_clockwise);
        if HAS_ALL {
            pins::drive(OUTPUT, digital & 1 != 0);
        }
    }

    /// Nothing has to be transferred.
    pub const fn transfer(&mut self) {}
}

/// Switches the digital outputs off.
pub fn make_safe() {
    if HAS_ALL {
        pins::drive(OUTPUT, false);
    }
}
