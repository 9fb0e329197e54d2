//! What may be wrong: with a pose, a request, a configuration, the machine.

use super::State;
use crate::force::{ForceProblem, ForceRefusal};
use crate::haptic::HandProblem;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Why a pose cannot be taken. Never a number instead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PoseError {
    /// No position of the joints gives this pose.
    Unreachable,
    /// A joint would leave its stroke.
    OutOfStroke {
        /// The joint, from 0.
        axis: u8,
        /// How far beyond the nearer end, axis units; negative below the lower end.
        by: i32,
    },
    /// Too near the parallel singularity (H-4 arm: E Z = y D).
    NearSingularity {
        /// Distance that is left, 2^-20 mm; negative on the wrong side.
        distance: i32,
    },
    /// Too near the reach limit of a rod pair (H-4 arm: S < 0.1 R).
    NearReachLimit {
        /// The rod pair: 0 for rods 1, 2; 1 for rods 3, 4.
        pair: u8,
    },
    /// The tilt is outside +-90 degrees.
    Tilt,
}

/// Why a command is refused. A refused command changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// Not in this state.
    State(State),
    /// No configuration is active.
    NotConfigured,
    /// The machine must be homed first.
    NotHomed,
    /// A value is out of its range.
    Range,
    /// The number of values is not the number of axes.
    AxisCount,
    /// Setpoints must come in order; this one was expected.
    OutOfOrder {
        /// Number of the setpoint that was expected.
        expected: u32,
    },
    /// The queue is full; the credit was not respected.
    QueueFull,
    /// The machine stands where it must not be held.
    Standing(PoseError),
    /// A setpoint that is refused by the kinematics.
    Pose {
        /// Its number in the job.
        setpoint: u32,
        /// Why.
        error: PoseError,
    },
    /// A setpoint beyond a soft limit.
    SoftLimit {
        /// Its number in the job.
        setpoint: u32,
        /// The pose coordinate.
        axis: u8,
    },
    /// A setpoint whose coding does not fit: period 0, overflow of a coordinate or rate.
    Setpoint {
        /// Its number in the job.
        setpoint: u32,
    },
    /// The job must start where the machine stands.
    StartPose {
        /// The first pose coordinate that differs.
        axis: u8,
    },
    /// The jog's epoch was cancelled, or a newer one is active.
    OldEpoch,
    /// The staged configuration is not whole or its check differs.
    ConfigCheck,
    /// The staged configuration cannot be read or makes no sense.
    Config(ConfigProblem),
    /// An input forbids it, or how the machine moves.
    Input(InputProblem),
    /// The position was lost: the joints must be set up at their presets again, and the configuration activated.
    PresetLost,
    /// The machine has no force sensor.
    NoForceSensor,
    /// Settings of a force loop that cannot be.
    Force {
        /// The component of the force.
        axis: u8,
        /// What is wrong, and the bound.
        refusal: ForceRefusal,
    },
    /// Force control is wanted and the sensor has no zero.
    NotTared,
    /// The tool yields to a force: what it feels is no zero.
    Yielding,
    /// Force control is wanted and the sensor cannot be believed now.
    ForceSensor(ForceProblem),
    /// The machine has no haptic arm, or its tool cannot be led by one.
    NoHand,
    /// A virtual wall so near the opposite one that the ball at the tip does not fit between them.
    WallTooNear,
    /// On the way to a setpoint a joint would exceed its maximum rate.
    JointRate {
        /// The number of the setpoint in the job.
        setpoint: u32,
        /// The joint.
        axis: u8,
        /// The rate that the setpoint asks for, axis units per second; negative towards the lower end.
        rate: i32,
        /// The maximum rate, axis units per second.
        limit: i32,
    },
}

/// What forbids to switch the drives on, or to clear what is latched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InputProblem {
    /// The emergency stop is pressed.
    EmergencyStop,
    /// A joint stands on its limit switch.
    LimitSwitch {
        /// The joint.
        axis: u8,
    },
    /// The drive of a joint is not ready.
    Drive {
        /// The joint.
        axis: u8,
    },
    /// The machine was switched off and still coasts.
    Coasting,
    /// The drives have just been switched on, and the step motors have not locked yet.
    Settling,
}

/// What is wrong in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigProblem {
    /// The field.
    pub field: ConfigField,
    /// The axis it belongs to, if any.
    pub axis: Option<u8>,
}

/// A part of the configuration that can be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(
    missing_docs,
    reason = "each is the name of a field of the configuration"
)]
pub enum ConfigField {
    Encoding,
    Period,
    AxisCount,
    Geometry,
    Stroke,
    SoftLimit,
    Rate,
    Acceleration,
    Jerk,
    Encoder,
    Drive,
    Gain,
    Filter,
    Following,
    Backlash,
    Homing,
    Heartbeat,
    StopTime,
    Force,
    Haptic,
    Follow,
}

/// Why the controller stopped by itself; latched until reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fault {
    /// A joint is too far from where it should be.
    FollowingError {
        /// The joint.
        axis: u8,
        /// The error, axis units.
        error: i32,
        /// The limit at that speed, axis units.
        limit: i32,
    },
    /// A pose coordinate left its soft limits.
    SoftLimit {
        /// The pose coordinate.
        axis: u8,
    },
    /// A joint was measured beyond its stroke by more than it may be off at rest.
    Stroke {
        /// The joint.
        axis: u8,
        /// How far beyond the end of its stroke, axis units; negative beyond the lower end.
        by: i32,
    },
    /// The measured joints or the wanted pose left what the machine can do.
    Pose(PoseError),
    /// A hardware limit switch.
    LimitSwitch {
        /// The joint.
        axis: u8,
    },
    /// The drive of a joint reports a fault.
    Drive {
        /// The joint.
        axis: u8,
    },
    /// Illegal transitions of an encoder.
    EncoderIllegal {
        /// The joint.
        axis: u8,
        /// How many, since enable.
        count: u16,
    },
    /// An encoder lost counts, or gained some: an index pulse came where none can be.
    EncoderSlip {
        /// The joint.
        axis: u8,
        /// How many counts too high it was.
        counts: i32,
    },
    /// Motion was commanded and the encoder saw none.
    EncoderStill {
        /// The joint.
        axis: u8,
    },
    /// Motion was commanded and the encoder saw it the other way round.
    EncoderReversed {
        /// The joint.
        axis: u8,
    },
    /// Steps emitted and encoder disagree.
    StepsLost {
        /// The joint.
        axis: u8,
        /// Steps less encoder, axis units.
        by: i32,
    },
    /// Nothing was heard from the host for too long; the machine slowed down along its path first.
    LostHost {
        /// Silence in milliseconds.
        silent_ms: u32,
    },
    /// The active configuration no longer fits its check.
    Configuration,
    /// Control periods were missed.
    LatePeriod {
        /// How many in a row.
        missed: u16,
    },
    /// Homing failed; all axes were stopped.
    Homing {
        /// The joint.
        axis: u8,
        /// How.
        problem: HomingProblem,
    },
    /// The force sensor, or what it feels; the machine slowed down along its path first, and the tool stays where it yielded to.
    Force(ForceProblem),
    /// The haptic arm that leads the tool; its motors are off, and the machine slowed down first.
    Hand(HandProblem),
    /// An arithmetic limit was reached inside the controller: a defect, reported rather than hidden.
    Internal {
        /// Source line, to report.
        line: u16,
    },
    /// A joint was commanded more than its maximum rate, by what moves the machine together; the machine slowed down along its path first.
    JointRate {
        /// The setpoint of the job that was on its way to.
        setpoint: u32,
        /// The joint.
        axis: u8,
        /// The commanded rate, axis units per second; negative towards the lower end.
        rate: i32,
        /// The maximum rate, axis units per second.
        limit: i32,
    },
    /// A step motor did not lock after its drive was switched on.
    NotLocked {
        /// The joint.
        axis: u8,
        /// How far it is from where it was switched on, axis units.
        by: i32,
    },
}

/// What went wrong while homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HomingProblem {
    /// No index pulse within the search distance.
    NoIndex,
    /// No change of the home switch within the search distance.
    NoSwitch,
    /// The axis did not follow.
    Stalled,
    /// The reference that was found is too far from the preset.
    Implausible,
    /// The pose would leave the workspace.
    Workspace,
    /// Stopped by a command or by another fault.
    Stopped,
}
