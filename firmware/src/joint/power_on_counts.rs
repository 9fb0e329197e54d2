//! Encoder counts from power-on to the first configuration.
//!
//! The presets of a machine file are the joint positions at power-on. The configuration arrives
//! later, and a joint may have moved by then. Its counter has the distance, but the scaling of a
//! count is still unknown. So raw counts are recorded and evaluated when the configuration arrives.
//!
//! Callers must make sure that the counters are running at the first period.

use crate::io::{Inputs, JointInputs};
use crate::joint::reversals::Reversals;
use haptimill_protocol::message::MAX_AXES;

/// A stuck channel keeps the counter within this many counts of one place.
const STUCK_COUNTS: u32 = 2;

/// Counts of one encoder since power-on.
#[derive(Debug, Clone, Copy, Default)]
pub struct Counted {
    /// Raw count of the last period.
    pub counts: i32,
    illegal_raw: u16,
    /// Counts since the first period.
    pub travelled: i64,
    /// Total illegal transitions.
    pub illegal: u32,
    /// Largest change of the counter per period; after missed periods, the mean change per period.
    pub widest: u32,
    /// A channel was stuck: the other one counted up and down about one place.
    pub stuck: bool,
    reversals: Reversals,
}

/// Counts of all encoders since power-on.
#[derive(Debug, Default)]
pub struct SincePowerOn {
    started: bool,
    /// The encoders, as many as a machine may have.
    pub encoders: [Counted; MAX_AXES],
}

impl SincePowerOn {
    /// Records one period. The first period is the start.
    #[inline(never)]
    pub fn update(&mut self, inputs: &Inputs, period_us: u16) {
        let periods = u32::from(inputs.missed) + 1;
        let started = core::mem::replace(&mut self.started, true);
        for (counted, joint) in self.encoders.iter_mut().zip(&inputs.joints) {
            if started {
                counted.update(joint, periods, period_us);
            }
            counted.counts = joint.counts;
            counted.illegal_raw = joint.illegal;
        }
    }
}

impl Counted {
    fn update(&mut self, joint: &JointInputs, periods: u32, period_us: u16) {
        let moved = joint.counts.wrapping_sub(self.counts);
        self.travelled = self.travelled.saturating_add(i64::from(moved));
        self.widest = self.widest.max(moved.unsigned_abs() / periods);
        let place = self.travelled as i32;
        let is_away = self.reversals.place().wrapping_sub(place).unsigned_abs() > STUCK_COUNTS;
        self.stuck |= self.reversals.update(moved, is_away, place, period_us);
        let illegal = joint.illegal.wrapping_sub(self.illegal_raw);
        self.illegal = self.illegal.saturating_add(u32::from(illegal));
    }
}
