//! What is said of force control: settings of a loop, what is wrong with them, with the sensor or with a tare, and how the forces stand.
//!
//! Forces are what the work does to the tool along x, y and z of the work, `i32` in 2^-16 N; displacements are 2^-20 mm. A *component* is 0 for x, 1 for y, 2 for z.
//!
//! Misuse: a value here is only a number. Whether a controller takes it, it says itself ([`ForceRefusal`]).

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Components of a force: x, y, z of the work.
pub const COMPONENTS: usize = 3;

/// When a force above the desired one moves the tool away (docs/control.md 7.1 item 20).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Gate {
    /// Only while it opposes the desired motion of the axis: F p_d' < 0. At rest, and across the motion, the tool only returns.
    #[default]
    AgainstMotion,
    /// Always.
    Any,
    /// Only upwards along the axis: contact from above.
    Positive,
    /// Only downwards.
    Negative,
}

/// The loop of one axis (docs/control.md (3.30)).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceLoop {
    /// f_d, a magnitude, 2^-16 N.
    pub desired: i32,
    /// K_A, 2^-16 N s^2/mm.
    pub mass: u32,
    /// K_V, 2^-16 N s/mm.
    pub damping: u32,
    /// The most that the tool yields, 2^-20 mm.
    pub limit: i32,
    /// The fastest that it yields, 2^-20 mm/s.
    pub rate: i32,
    /// When it yields.
    pub gate: Gate,
}

/// Settings that cannot be. Nothing changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceRefusal {
    /// What is wrong.
    pub parameter: ForceParameter,
    /// The nearest value that is taken, in the raw unit of the parameter.
    pub bound: i32,
}

/// What can be wrong with settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceParameter {
    /// f_d is zero, negative, or lost in the noise.
    DesiredTooSmall,
    /// f_d is above three quarters of what the sensor shows: the loop could not see by how much a force is too high.
    DesiredTooLarge,
    /// K_V does not hold a soft contact with this delay: K_V >= k tau.
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
    /// The sensor's values make no sense.
    Sensor,
    /// A revolution at the slowest spindle does not fit the window of the peak.
    SlowestSpindle,
    /// There is no such axis, or it is not linear.
    Axis,
    /// The last change of this axis is still being worked out; a few periods later it will be taken.
    Busy,
}

/// What ends force control, with its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceProblem {
    /// No new samples.
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
    /// The zero has wandered.
    Drift {
        /// The component.
        component: u8,
        /// How far, 2^-16 N.
        force: i32,
    },
    /// The force is larger than may be.
    Limit {
        /// The component.
        component: u8,
        /// The force, 2^-16 N.
        force: i32,
    },
    /// The force grows when the tool yields to it.
    WrongSign {
        /// The component.
        component: u8,
    },
    /// The spindle turns so slowly that the peak of a revolution comes later than the loop was laid out for.
    SlowSpindle {
        /// rev/min.
        rpm: i16,
    },
}

/// Why a tare is refused. The zero stays what it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TareRefusal {
    /// Samples were missing.
    Silent,
    /// The codes move.
    Moving {
        /// The component.
        component: u8,
        /// Codes from lowest to highest.
        spread: u16,
    },
    /// A channel does not move at all.
    Stuck {
        /// The component.
        component: u8,
    },
    /// The zero would be so far off that less than half of the range is left.
    Offset {
        /// The component.
        component: u8,
    },
    /// The machine began to move before it was done.
    Interrupted,
}

/// How the forces stand, on a machine with a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceTelemetry {
    /// Force of largest magnitude in the last revolution of the spindle, sign kept, 2^-16 N.
    pub high: [i32; COMPONENTS],
    /// The opposite end of what it was in that revolution, 2^-16 N.
    pub low: [i32; COMPONENTS],
    /// By how much the tool yields, p_c, 2^-20 mm.
    pub yielded: [i32; COMPONENTS],
    /// Axes under force control: bit 0 for x.
    pub mask: u8,
    /// A zero is known.
    pub tared: bool,
    /// What is wrong with sensor or contact now.
    pub problem: Option<ForceProblem>,
}
