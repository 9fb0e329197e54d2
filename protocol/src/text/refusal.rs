//! Sentences of refused poses, commands and configurations.

use super::drive_alarm::Explained;
use super::{Amount, AxesText, AxisKind, Describe, amount};
use crate::message::{ConfigField, ConfigProblem, Fault, InputProblem, PoseError, Refusal, State};
use core::fmt::{Formatter, Result};

impl Describe for PoseError {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::Unreachable => f.write_str(
                "no joint positions give this pose; move the workpiece or shorten the path",
            ),
            Self::OutOfStroke { joint, by } => {
                let name = axes.joint(joint);
                write!(f, "{name} would leave its stroke")?;
                if let Some(by) = amount(axes.joints, joint, by) {
                    write!(f, " by {by}")?;
                }
                f.write_str("; move the workpiece towards the middle of the workspace")
            }
            Self::NearSingularity { distance } => {
                let distance = Amount {
                    value: distance,
                    kind: AxisKind::Linear,
                };
                write!(
                    f,
                    "the singularity distance would be {distance}, below its margin; \
                     tilt the tool less or move the workpiece"
                )
            }
            Self::Geometry { code } => match axes.pose_errors.get(usize::from(code)) {
                Some(sentence) => f.write_str(sentence),
                None => write!(
                    f,
                    "the geometry of the machine refuses this pose (code {code})"
                ),
            },
        }
    }
}

impl Describe for Refusal {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::State(state) => {
                write!(f, "not possible while the machine is {state}")?;
                f.write_str(match state {
                    State::Disabled => "; enable the drives first",
                    State::Fault | State::EmergencyStop => "; remove the cause, then reset",
                    State::Run | State::Homing | State::Jog => {
                        "; wait until it is done, or stop it"
                    }
                    State::Hold => "; resume or stop the job first",
                    State::Idle => "",
                })
            }
            Self::RecentStop => {
                f.write_str("not possible within 450 ms after a stop; send the command again")
            }
            Self::NotConfigured => f.write_str(
                "the controller has no configuration; `haptimill home` and `haptimill enable` \
                 send the machine file (--machine FILE, or else the built-in one)",
            ),
            Self::NotHomed => f.write_str("the machine is not homed; home it first"),
            Self::Range => f.write_str("a value of the command is out of its range"),
            Self::CoordinateCount => {
                f.write_str("the number of values is not the number of coordinates of the pose")
            }
            Self::OutOfOrder { expected } => write!(f, "setpoint {expected} was expected next"),
            Self::QueueFull => f.write_str("the setpoint queue is full"),
            // The same sentence as for a joint that leaves its stroke with its drives on.
            Self::MeasuredPose(PoseError::OutOfStroke { joint, by }) => {
                Fault::Stroke { joint, by }.describe(axes, f)
            }
            Self::MeasuredPose(error) => Fault::Pose(error).describe(axes, f),
            Self::Pose { setpoint, error } => {
                write!(f, "setpoint {setpoint}: ")?;
                error.describe(axes, f)
            }
            Self::SoftLimit {
                setpoint,
                coordinate,
            } => write!(
                f,
                "setpoint {setpoint}: {} would leave its soft limits; \
                 move the workpiece or change the program",
                axes.coordinate(coordinate)
            ),
            Self::Setpoint { setpoint } => write!(f, "setpoint {setpoint} cannot be decoded"),
            Self::StartPose { coordinate } => write!(
                f,
                "the job does not start at the present pose: {} differs; \
                 start again from the present pose",
                axes.coordinate(coordinate)
            ),
            Self::OldEpoch => f.write_str("this jog was cancelled"),
            Self::DrivesOn => f.write_str("the drives are on; disable them first"),
            Self::NoStorage => f.write_str(
                "this board keeps no configuration; send the machine file after each power-on",
            ),
            Self::Storing => f.write_str(
                "the board is keeping a configuration; wait a second, then send the command again",
            ),
            Self::NotActive => {
                f.write_str("the configuration to be kept is not the active one; activate it first")
            }
            Self::StorageFailed => f.write_str(
                "the memory of the board failed, and the configuration before is still kept; try \
                 again, or replace the board",
            ),
            Self::ConfigCheck => {
                f.write_str("the received configuration is incomplete; send it again")
            }
            Self::Config(problem) => problem.describe(axes, f),
            Self::Input(problem) => problem.describe(axes, f),
            Self::PresetLost => f.write_str(
                "the position is lost; set the joints up at their presets by hand, \
                 then home with --at-preset",
            ),
            Self::NoForceSensor => f.write_str(
                "the machine has no force sensor; add a section [force] to the machine file \
                 and configure the controller with it",
            ),
            Self::Force { axis, refusal } => {
                write!(f, "force loop of {}: ", axes.axis(axis))?;
                refusal.describe(axes, f)
            }
            Self::NotTared => f.write_str(
                "force control is on and the force sensor has no zero; \
                 tare it first, without contact at the tool",
            ),
            Self::Compliant => f.write_str(
                "the compliant displacement is not zero; move the tool off the workpiece, \
                 or take the axes out of force control, then tare",
            ),
            Self::ForceSensor(problem) => {
                f.write_str("force control is on and the force sensor is invalid: ")?;
                problem.describe(axes, f)
            }
            Self::NoErrorTables => f.write_str(
                "the machine has no error tables; add a section [compensation] to the machine \
                 file and configure the controller with it",
            ),
            Self::NoMaster => f.write_str(
                "the machine has no master; add the sections [haptic] or [follow] \
                 to the machine file and configure the controller with it",
            ),
            Self::JointRate {
                setpoint,
                joint,
                rate,
                limit,
            } => {
                write!(f, "setpoint {setpoint}: ")?;
                write_joint_rate(axes, joint, rate, limit, f)?;
                f.write_str("; lower the feed there, or stay away from the edge of the workspace")
            }
            Self::NoProbe { input } => write!(
                f,
                "{} is no probe and no tool setter; name an input with that function",
                axes.input(input)
            ),
            Self::AnalogOutput { output, problem } => {
                write!(f, "{}: {problem}", axes.analog_output(output))
            }
            Self::Output { output, problem } => {
                write!(f, "{}: {problem}", axes.output(output))
            }
            Self::FixturesTooNear => f.write_str(
                "the ball at the tip does not fit between this virtual fixture \
                 and the opposite one; move one of them outwards",
            ),
        }
    }
}

/// Writes that a joint exceeds its maximum rate, with both rates if the machine is known.
pub(super) fn write_joint_rate(
    axes: &AxesText<'_>,
    joint: u8,
    rate: i32,
    limit: i32,
    f: &mut Formatter<'_>,
) -> Result {
    write!(f, "{} would move", axes.joint(joint))?;
    match (
        amount(axes.joints, joint, rate),
        amount(axes.joints, joint, limit),
    ) {
        (Some(rate), Some(limit)) => write!(f, " at {rate}/s (at most {limit}/s)"),
        _ => f.write_str(" faster than its maximum rate"),
    }
}

impl Describe for InputProblem {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        let named = |joint| axes.joint(joint);
        match *self {
            Self::EmergencyStop => f.write_str("the emergency stop is pressed; release it first"),
            Self::LimitSwitch { joint } => write!(
                f,
                "{} is on its limit switch; move it off (`haptimill move-off`, or by hand), then try \
                 again",
                named(joint)
            ),
            Self::NoLimitSwitch { joint } => {
                write!(
                    f,
                    "{} is on no limit switch and within its stroke; nothing was moved",
                    named(joint)
                )
            }
            Self::BothLimitSwitches { joint } => write!(
                f,
                "both limit switches of {} are active, so the direction off them is not known; \
                 check their wiring and active levels, or move the joint by hand",
                named(joint)
            ),
            Self::Drive { joint, alarm } => {
                let why = Explained { joint, alarm, axes };
                write!(f, "the drive of {} is not ready: {why}", named(joint))
            }
            Self::Coasting => f.write_str("the machine still coasts; wait for its standstill"),
            Self::Settling => f.write_str(
                "the step motors have not locked yet; wait until the drives are enabled",
            ),
            Self::DoorOpen { input } => {
                write!(f, "{} is open; close it first", axes.input(input))
            }
            Self::FeedHold { input } => write!(
                f,
                "the feed hold {} is active; release it first",
                axes.input(input)
            ),
            Self::ProbeContact { input } => write!(
                f,
                "{} is in contact already; move it off, then probe again",
                axes.input(input)
            ),
        }
    }
}

impl ConfigProblem {
    /// Whether the index is that of a pose coordinate or of an axis of force control, which has the
    /// name of its coordinate; otherwise it is that of a joint.
    #[must_use]
    pub const fn is_of_pose(&self) -> bool {
        matches!(
            self.field,
            ConfigField::SoftLimit
                | ConfigField::StopTime
                | ConfigField::Acceleration
                | ConfigField::Jerk
                | ConfigField::Force
                | ConfigField::Follow
                | ConfigField::Volumetric
        )
    }
}

impl Describe for ConfigProblem {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        write!(f, "the configuration is invalid: {}", self.field)?;
        if let Some(index) = self.index
            && matches!(self.field, ConfigField::Input | ConfigField::Output)
        {
            write!(f, ", entry {}", u32::from(index) + 1)?;
        } else if let Some(index) = self.index {
            let named = if self.is_of_pose() {
                axes.coordinate(index)
            } else {
                axes.joint(index)
            };
            write!(f, " of {named}")?;
        }
        f.write_str("; correct the machine file")
    }
}
