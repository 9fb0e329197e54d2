//! Watching the stages of a control period go by.

/// A stage of the control period, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stage {
    /// Bytes from the host, at most one message.
    Hear,
    /// Encoders, measured pose.
    Sense,
    /// States, faults, what is wanted.
    Decide,
    /// What the tool yields to a force.
    Yield,
    /// Inverse kinematics.
    Place,
    /// Position loops, pulses.
    Drive,
    /// What the hand shall feel.
    Feel,
    /// Telemetry and answers.
    Tell,
    /// Safe outputs where anything went wrong.
    Gate,
}

/// How many stages there are.
pub const STAGES: usize = 9;

/// Sees each stage end; costs nothing when empty.
pub trait Probe {
    /// The stage has just ended.
    fn ended(&mut self, stage: Stage);
}

impl Probe for () {
    #[inline(always)]
    fn ended(&mut self, _: Stage) {}
}
