//! What the encoders counted from power-on to the first configuration.
//!
//! The presets of a machine file say where the joints stand at power-on. The configuration comes later, and a joint may have been moved by then: its counter knows by how
//! much. Nothing is known yet of what a count means, so counts are kept, and judged when the configuration comes.
//!
//! Misuse: a counter that does not count yet at the first period.

use crate::io::{AxisInputs, Inputs};
use haptimill_protocol::message::MAX_AXES;

/// One encoder since power-on.
#[derive(Debug, Clone, Copy, Default)]
pub struct Counted {
    /// The counter.
    pub counts: i32,
    illegal_raw: u16,
    /// Counts since the first period.
    pub travelled: i64,
    /// Illegal transitions in all.
    pub illegal: u32,
    /// Largest change of the counter per period; where periods were missed, its mean over them.
    pub widest: u32,
}

/// All encoders since power-on.
#[derive(Debug, Default)]
pub struct SincePowerOn {
    begun: bool,
    /// The encoders, as many as a machine may have.
    pub axes: [Counted; MAX_AXES],
}

impl SincePowerOn {
    /// One period; the first is the start.
    #[inline(never)]
    pub fn note(&mut self, inputs: &Inputs) {
        let periods = u32::from(inputs.missed) + 1;
        let begun = core::mem::replace(&mut self.begun, true);
        for (counted, axis) in self.axes.iter_mut().zip(&inputs.axes) {
            if begun {
                counted.note(axis, periods);
            }
            counted.counts = axis.counts;
            counted.illegal_raw = axis.illegal;
        }
    }
}

impl Counted {
    fn note(&mut self, axis: &AxisInputs, periods: u32) {
        let moved = axis.counts.wrapping_sub(self.counts);
        self.travelled = self.travelled.saturating_add(i64::from(moved));
        self.widest = self.widest.max(moved.unsigned_abs() / periods);
        let illegal = axis.illegal.wrapping_sub(self.illegal_raw);
        self.illegal = self.illegal.saturating_add(u32::from(illegal));
    }
}
