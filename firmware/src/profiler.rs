//! Timing of the stages of a control period.

/// A stage of the control period, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stage {
    /// Bytes from the host, at most one message.
    Receive,
    /// Encoders, force sensor, haptic arm.
    Measure,
    /// Fault checks.
    Supervise,
    /// One request or setpoint.
    Command,
    /// Commanded pose.
    Interpolate,
    /// Compliant displacement.
    Comply,
    /// Inverse kinematics.
    Solve,
    /// Position loops, step segments.
    Servo,
    /// Force feedback to the haptic arm.
    Render,
    /// Replies, events, telemetry.
    Report,
    /// Safe outputs.
    Interlock,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Self; STAGES] = [
        Self::Receive,
        Self::Measure,
        Self::Supervise,
        Self::Command,
        Self::Interpolate,
        Self::Comply,
        Self::Solve,
        Self::Servo,
        Self::Render,
        Self::Report,
        Self::Interlock,
    ];

    /// Name of the stage in tables and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Receive => "receive",
            Self::Measure => "measure",
            Self::Supervise => "supervise",
            Self::Command => "command",
            Self::Interpolate => "interpolate",
            Self::Comply => "comply",
            Self::Solve => "solve",
            Self::Servo => "servo",
            Self::Render => "render",
            Self::Report => "report",
            Self::Interlock => "interlock",
        }
    }
}

/// Number of stages.
pub const STAGES: usize = 11;

/// Receives a mark at the end of each stage. The empty profiler `()` costs nothing.
pub trait Profiler {
    /// The stage has just ended.
    fn mark(&mut self, stage: Stage);
}

impl Profiler for () {
    #[inline(always)]
    fn mark(&mut self, _: Stage) {}
}
