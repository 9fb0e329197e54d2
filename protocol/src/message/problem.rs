//! Problems of a pose, a request, a configuration or the machine.

use super::{DriveAlarm, State};
use crate::force::{ForceProblem, ForceRefusal};
use crate::haptic::MasterProblem;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Reason why a pose is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PoseError {
    /// No joint positions give this pose.
    Unreachable,
    /// A joint would leave its stroke.
    OutOfStroke {
        /// The joint, from 0.
        joint: u8,
        /// Distance beyond the nearer end, axis units; negative below the lower end.
        by: i32,
    },
    /// The pose is too near the singularity of the machine.
    NearSingularity {
        /// Singularity distance, 2^-20 mm; negative on the wrong side.
        distance: i32,
    },
    /// An error of one geometry. The descriptor of the machine has its name and its sentence.
    Geometry {
        /// Index in the list of the descriptor.
        code: u8,
    },
}

/// Reason why a command is refused. A refused command changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// The command is not allowed in this state.
    State(State),
    /// The command starts motion, and an out-of-band stop was received in the last 450 ms.
    RecentStop,
    /// No configuration is active.
    NotConfigured,
    /// The machine must be homed first.
    NotHomed,
    /// A value is out of its range.
    Range,
    /// The number of values is not the number of coordinates of the pose.
    CoordinateCount,
    /// Setpoints must come in order; another one was expected.
    OutOfOrder {
        /// Number of the setpoint that was expected.
        expected: u32,
    },
    /// The queue is full: the host sent beyond the credit.
    QueueFull,
    /// The present pose of the machine is one at which it cannot hold.
    MeasuredPose(PoseError),
    /// The kinematics refuse a setpoint.
    Pose {
        /// Number of the setpoint in the job.
        setpoint: u32,
        /// Reason.
        error: PoseError,
    },
    /// A setpoint is beyond a soft limit.
    SoftLimit {
        /// Number of the setpoint in the job.
        setpoint: u32,
        /// The pose coordinate.
        coordinate: u8,
    },
    /// The coding of a setpoint is invalid: period 0, overflow of a coordinate or rate.
    Setpoint {
        /// Number of the setpoint in the job.
        setpoint: u32,
    },
    /// The job must start at the present pose of the machine.
    StartPose {
        /// The first pose coordinate that differs.
        coordinate: u8,
    },
    /// The jog's epoch was cancelled, or a newer one is active.
    OldEpoch,
    /// The staged configuration is incomplete or its CRC differs.
    ConfigCheck,
    /// The staged configuration cannot be decoded or has an invalid value.
    Config(ConfigProblem),
    /// An input, or the present motion of the machine, forbids the command.
    Input(InputProblem),
    /// The position was lost: the joints must be set up at their presets again, and the
    /// configuration activated.
    PresetLost,
    /// The machine has no force sensor.
    NoForceSensor,
    /// Settings of a force loop are invalid.
    Force {
        /// The component of the force.
        axis: u8,
        /// The invalid parameter, and its bound.
        refusal: ForceRefusal,
    },
    /// Force control needs a force sensor with a zero (tare).
    NotTared,
    /// A compliant displacement is active: the present force cannot be taken as zero.
    Compliant,
    /// Force control was requested while the force sensor is invalid.
    ForceSensor(ForceProblem),
    /// The machine has no tables for volumetric compensation.
    NoErrorTables,
    /// The machine has no haptic arm, or its tool cannot follow one.
    NoMaster,
    /// A virtual fixture is so near the opposite one that the ball at the tip does not fit between
    /// them.
    FixturesTooNear,
    /// A joint would exceed its maximum rate before a setpoint.
    JointRate {
        /// Number of the setpoint in the job.
        setpoint: u32,
        /// The joint.
        joint: u8,
        /// The rate that the setpoint demands, axis units per second; negative towards the lower
        /// end.
        rate: i32,
        /// The maximum rate, axis units per second.
        limit: i32,
    },
    /// The drives are on.
    DrivesOn,
    /// The board keeps no configuration.
    NoStorage,
    /// The board is keeping a configuration.
    Storing,
    /// The staged configuration is not the active one.
    NotActive,
    /// The memory of the board failed.
    StorageFailed,
    /// The input is no probe and no tool setter.
    NoProbe {
        /// Index of the input in the configuration.
        input: u8,
    },
    /// The analog output cannot be set.
    AnalogOutput {
        /// Index of the analog output in the configuration.
        output: u8,
        /// The reason.
        problem: OutputProblem,
    },
    /// The output cannot be set.
    Output {
        /// Index of the output in the configuration.
        output: u8,
        /// The reason.
        problem: OutputProblem,
    },
}

/// Reason why an output cannot be set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum OutputProblem {
    /// The configuration has no output with this index.
    Unknown,
    /// The code is beyond the range of the analog output.
    Range,
    /// The output follows the spindle.
    FollowsSpindle,
    /// The output is the tool clamp, and the spindle is commanded to turn.
    SpindleTurns,
    /// The output is the tool clamp, it is off, and the spindle is to start.
    ClampOpen,
}

/// Condition that forbids to enable the drives, to reset, or to start motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InputProblem {
    /// The emergency stop is pressed.
    EmergencyStop,
    /// A joint is on its limit switch.
    LimitSwitch {
        /// The joint.
        joint: u8,
    },
    /// The drive of a joint is not ready.
    Drive {
        /// The joint.
        joint: u8,
        /// The reason.
        alarm: DriveAlarm,
    },
    /// The drives were switched off and the machine still coasts.
    Coasting,
    /// The drives were just switched on, and the step motors have not locked yet.
    Settling,
    /// The door is open.
    DoorOpen {
        /// The input.
        input: u8,
    },
    /// The feed hold is active.
    FeedHold {
        /// The input.
        input: u8,
    },
    /// The probe has the level already that ends the motion.
    ProbeContact {
        /// The input.
        input: u8,
    },
    /// A joint that must move off its limit switch is on none, and within its stroke.
    NoLimitSwitch {
        /// The joint.
        joint: u8,
    },
    /// Both limit switches of a joint are active: the direction off them is not known.
    BothLimitSwitches {
        /// The joint.
        joint: u8,
    },
}

/// Invalid field of a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigProblem {
    /// The field.
    pub field: ConfigField,
    /// Number of the coordinate, joint, axis of force control or named channel, if there is one.
    pub index: Option<u8>,
}

/// Part of a configuration that can be invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(
    missing_docs,
    reason = "each is the name of a field of the configuration"
)]
pub enum ConfigField {
    Encoding,
    Period,
    CoordinateCount,
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
    Input,
    Output,
    Volumetric,
    Gantry,
}

/// Reason why the controller stopped by itself; latched until reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fault {
    /// The following error of a joint exceeds its limit.
    FollowingError {
        /// The joint.
        joint: u8,
        /// The following error, axis units.
        error: i32,
        /// The limit at that rate, axis units.
        limit: i32,
    },
    /// A pose coordinate left its soft limits.
    SoftLimit {
        /// The pose coordinate.
        coordinate: u8,
    },
    /// A joint was measured beyond its stroke by more than its following error limit at standstill.
    Stroke {
        /// The joint.
        joint: u8,
        /// Distance beyond the end of the stroke, axis units; negative beyond the lower end.
        by: i32,
    },
    /// The measured joints or the commanded pose left the workspace.
    Pose(PoseError),
    /// A hardware limit switch is active.
    LimitSwitch {
        /// The joint.
        joint: u8,
    },
    /// The drive of a joint reports a fault.
    Drive {
        /// The joint.
        joint: u8,
        /// The reason.
        alarm: DriveAlarm,
    },
    /// An encoder made illegal transitions.
    EncoderIllegal {
        /// The joint.
        joint: u8,
        /// Number of transitions since enable.
        count: u16,
    },
    /// Encoder slip: an index pulse came at a count where none is possible.
    EncoderSlip {
        /// The joint.
        joint: u8,
        /// Counts by which the encoder is too high.
        counts: i32,
    },
    /// Encoder stuck: motion was commanded and the encoder counted none.
    EncoderStuck {
        /// The joint.
        joint: u8,
    },
    /// Motion was commanded and the encoder counted in the opposite direction.
    EncoderReversed {
        /// The joint.
        joint: u8,
    },
    /// Emitted steps and encoder disagree.
    StepsLost {
        /// The joint.
        joint: u8,
        /// Steps minus encoder, axis units.
        by: i32,
    },
    /// The heartbeat timed out; the machine decelerated along its path first.
    LostHost {
        /// Silence in milliseconds.
        silent_ms: u32,
    },
    /// The active configuration fails its integrity check.
    Configuration,
    /// Control periods were missed.
    MissedPeriods {
        /// Number of missed periods in a row.
        missed: u16,
    },
    /// Homing failed; all joints were stopped.
    Homing {
        /// The joint.
        joint: u8,
        /// The problem.
        problem: HomingProblem,
    },
    /// A problem of the force sensor or of the force. The machine decelerated along its path first,
    /// and the compliant displacement is kept.
    Force(ForceProblem),
    /// A problem of the haptic arm that moves the tool. Its motors are off, and the machine
    /// decelerated first.
    Master(MasterProblem),
    /// An arithmetic limit was reached inside the controller. This is a defect of the firmware.
    Internal {
        /// Source line, for a bug report.
        line: u16,
    },
    /// The sources that move a joint together commanded more than its maximum rate; the machine
    /// decelerated along its path first.
    JointRate {
        /// Setpoint of the job that the motion was heading for.
        setpoint: u32,
        /// The joint.
        joint: u8,
        /// The commanded rate, axis units per second; negative towards the lower end.
        rate: i32,
        /// The maximum rate, axis units per second.
        limit: i32,
    },
    /// A step motor did not lock after its drive was switched on.
    NotLocked {
        /// The joint.
        joint: u8,
        /// Distance from the position at which it was switched on, axis units.
        by: i32,
    },
    /// A probe or tool setter had a contact in motion while no probing was armed; the machine
    /// decelerated along its path first.
    ProbeContact {
        /// The input.
        input: u8,
    },
    /// The two motors of a gantry disagree by more than the largest racking.
    Racking {
        /// The joint of the second motor.
        joint: u8,
        /// Second motor minus first motor, axis units; during homing the difference of the
        /// distances since its start.
        by: i32,
    },
    /// The counter of an encoder jumped: it changed by more than the joint can move.
    CounterJump {
        /// The joint.
        joint: u8,
        /// Counts of the jump.
        counts: u32,
    },
}

/// Problem during homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HomingProblem {
    /// No index pulse within the search distance.
    NoIndex,
    /// No change of the home switch within the search distance.
    NoSwitch,
    /// The joint did not follow.
    Stalled,
    /// The reference is too far from the preset.
    Implausible,
    /// The pose would leave the workspace.
    Workspace,
    /// Stopped by a command or by another fault.
    Stopped,
    /// The home switch stays active where it must be released.
    SwitchStuck,
    /// The home switch came at two different places.
    SwitchUnsteady,
    /// The limit switch did not open while the joint moved off it.
    LimitStuck,
}
