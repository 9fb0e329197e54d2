//! The compact coding of timed setpoints.

use crate::message::{Action, AxisValues};

/// A setpoint: where the machine is to be, and how fast, at the end of a span of time.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Setpoint {
    /// Periods since the setpoint before; at least 1.
    pub periods: u16,
    /// Pose, axis units.
    pub pose: AxisValues,
    /// Rates, axis units per second divided by 2^[`crate::message::RATE_SHIFT`].
    pub rates: AxisValues,
    /// What happens when it is reached.
    pub action: Action,
}
