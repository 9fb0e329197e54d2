//! Setpoints of a job, and the actions at them.

use super::{MAX_AXES, OverrideMode, SETPOINT_BATCH};
use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Consecutive setpoints of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetpointBatch {
    /// Number of the first setpoint; the first of a job is 0.
    pub first: u32,
    /// The setpoints, each relative to its prediction from those before.
    pub items: Vec<SetpointDelta, SETPOINT_BATCH>,
}

/// A setpoint relative to its prediction; see [`crate::setpoint`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetpointDelta {
    /// Control periods since the setpoint before; at least 1.
    pub periods: u16,
    /// Bit `k` is set when axis `k` has residuals. Position and rate of an axis without residuals
    /// equal the prediction.
    pub moved: u8,
    /// For each axis with its bit set, in order: coordinate minus its prediction, then rate minus
    /// its prediction.
    pub residuals: Vec<i32, { 2 * MAX_AXES }>,
    /// Action when the setpoint is reached.
    pub action: Action,
}

/// Action when a setpoint is reached, in the same period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Action {
    /// No action.
    #[default]
    None,
    /// Sets the spindle speed in rev/min: clockwise above 0 (M3), counter-clockwise below (M4), 0
    /// for off (M5).
    Spindle(i16),
    /// Waits for [`Command::Resume`] (M0, M1); the setpoint must have rate zero.
    ///
    /// [`Command::Resume`]: super::Command::Resume
    Pause,
    /// Sets a digital output (M7 to M9, M62 to M65).
    Output {
        /// Index of the output in the configuration.
        output: u8,
        /// On or off.
        on: bool,
    },
    /// Sets an analog output (M67, M68).
    AnalogOutput {
        /// Index of the analog output in the configuration.
        output: u8,
        /// The code.
        code: i16,
    },
    /// Sets the override mode of the motion from this setpoint on.
    OverrideMode(OverrideMode),
}
