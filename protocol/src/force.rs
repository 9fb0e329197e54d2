//! Force control messages: settings of a loop, their refusals, problems of the sensor and of a
//! tare, and force telemetry.
//!
//! Forces act on the tool along x, y and z of the workpiece, `i32` in 2^-16 N. Displacements are
//! 2^-20 mm. A *component* is 0 for x, 1 for y, 2 for z.
//!
//! Values of these types are not checked. A controller checks them and refuses invalid ones with
//! [`ForceRefusal`].

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Components of a force: x, y, z of the workpiece.
pub const COMPONENTS: usize = 3;

/// Names of the components, in order.
pub const COMPONENT_NAMES: [&str; COMPONENTS] = ["x", "y", "z"];

/// Enable condition: when a force above the force setpoint may move the tool away (docs/control.md
/// 7.1 item 20).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EnableCondition {
    /// Only while the force opposes the commanded motion of the axis: F p_d' < 0. At standstill,
    /// and across the motion, the tool only returns.
    #[default]
    AgainstMotion,
    /// Always.
    Any,
    /// Only in the positive direction of the axis: contact from above.
    Positive,
    /// Only in the negative direction of the axis.
    Negative,
}

/// Settings of the force loop of one axis (docs/control.md (3.30)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceLoop {
    /// Force setpoint f_d, a magnitude, 2^-16 N.
    pub setpoint: i32,
    /// Virtual mass K_A, 2^-16 N s^2/mm.
    pub mass: u32,
    /// Virtual damping K_V, 2^-16 N s/mm.
    pub damping: u32,
    /// Largest compliant displacement, 2^-20 mm.
    pub limit: i32,
    /// Maximum rate of the compliant displacement, 2^-20 mm/s.
    pub rate: i32,
    /// Enable condition.
    pub enable_condition: EnableCondition,
}

/// Refusal of settings. Nothing changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceRefusal {
    /// The invalid parameter.
    pub parameter: ForceParameter,
    /// Nearest accepted value, in the raw unit of the parameter.
    pub bound: i32,
}

/// Parameter of force control that can be invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceParameter {
    /// f_d is zero, negative, or below the noise.
    SetpointTooSmall,
    /// f_d is above three quarters of the sensor range: the loop could not measure by how much a
    /// force is too high.
    SetpointTooLarge,
    /// K_V cannot hold a soft contact with this delay: K_V >= k tau is required.
    DampingTooSmall,
    /// K_V is beyond its range.
    DampingTooLarge,
    /// K_A is less than K_V T at the highest level of damping.
    MassTooSmall,
    /// K_A / K_V is beyond 2^18 periods.
    MassTooLarge,
    /// The limit of p_c is not above 0, or too large.
    Limit,
    /// The rate is not above 0.
    Rate,
    /// A value of the sensor is invalid.
    Sensor,
    /// A revolution at the slowest spindle speed does not fit the window of the peak force.
    SlowestSpindle,
    /// The axis does not exist or is not linear.
    Axis,
    /// The last change of this axis is still in progress; the controller can accept another one a
    /// few periods later.
    Busy,
}

/// Problem that ends force control.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceProblem {
    /// No new samples arrive.
    Silent,
    /// A channel, or the amplifier, is beyond its range.
    Overload {
        /// The component; 3 for the amplifier.
        component: u8,
    },
    /// A channel repeats one code.
    Stuck {
        /// The component.
        component: u8,
    },
    /// The zero has drifted.
    Drift {
        /// The component.
        component: u8,
        /// Drift, 2^-16 N.
        force: i32,
    },
    /// The force exceeds its limit.
    Limit {
        /// The component.
        component: u8,
        /// The force, 2^-16 N.
        force: i32,
    },
    /// The force grows when it displaces the tool.
    WrongSign {
        /// The component.
        component: u8,
    },
    /// The spindle is so slow that the peak of a revolution comes later than the loop was designed
    /// for.
    SlowSpindle {
        /// Spindle speed, rev/min.
        rpm: i16,
    },
}

/// Reason why a tare is refused. The zero is not changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TareRefusal {
    /// Samples were missing.
    Silent,
    /// The codes are not constant.
    Moving {
        /// The component.
        component: u8,
        /// Highest minus lowest code.
        spread: u16,
    },
    /// A channel repeats one code.
    Stuck {
        /// The component.
        component: u8,
    },
    /// The zero is so large that less than half of the range remains.
    Offset {
        /// The component.
        component: u8,
    },
    /// The machine began to move before the tare was complete.
    Interrupted,
}

/// Forces of a machine with a force sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceTelemetry {
    /// Peak force: the sample of the largest magnitude in the last spindle revolution, with its
    /// sign, 2^-16 N.
    pub high: [i32; COMPONENTS],
    /// Opposite extreme of the same revolution, 2^-16 N.
    pub low: [i32; COMPONENTS],
    /// Compliant displacement p_c, 2^-20 mm.
    pub displacement: [i32; COMPONENTS],
    /// Axes under force control: bit 0 for x.
    pub mask: u8,
    /// The sensor has a zero.
    pub tared: bool,
    /// Present problem of the sensor or of the contact.
    pub problem: Option<ForceProblem>,
}
