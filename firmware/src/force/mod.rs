//! Force control: from the codes of a force sensor to the displacement by which the tool yields.
pub mod compliance;
pub mod guard;
pub mod peak;
pub mod pole;

use crate::units::force::{Force, VirtualDamping, VirtualMass};
use crate::units::{Length, Rate};
use serde::{Deserialize, Serialize};

/// When a force above the desired one moves the tool away (spec h4-milling 7.1 item 20).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gate {
    /// Only while it opposes the desired motion of the axis.
    #[default]
    AgainstMotion,
    /// Always.
    Any,
    /// Only upwards: contact from above.
    Positive,
    /// Only downwards.
    Negative,
}

/// The loop of one axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoopSettings {
    /// f_d.
    pub desired: Force,
    /// K_A.
    pub mass: VirtualMass,
    /// K_V.
    pub damping: VirtualDamping,
    /// The most that the tool yields.
    pub limit: Length,
    /// The fastest that it yields.
    pub rate: Rate,
    /// When it yields.
    pub gate: Gate,
}

impl LoopSettings {
    /// The least desired force: 0.5 N.
    pub const LEAST_DESIRED: Force = Force::millinewtons(500);
}

/// A parameter that cannot be, with its bound in raw units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused {
    /// What is wrong.
    pub parameter: Parameter,
    /// The nearest value that is taken.
    pub bound: i32,
}

/// What can be wrong with settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Parameter {
    DesiredTooSmall,
    DesiredTooLarge,
    DampingTooSmall,
    DampingTooLarge,
    MassTooSmall,
    MassTooLarge,
    Limit,
    Rate,
}
