//! Sentences of faults and events.

use super::drive_alarm::Explained;
use super::refusal::write_joint_rate;
use super::{AxesText, Describe, amount};
use crate::message::{Event, Fault, HomingProblem, State};
use core::fmt::{Formatter, Result};

/// Remedy after a fault that makes the encoder of a joint suspected: homing checks the encoder
/// against its index pulses.
const HOME: &str = "then reset and home";

/// Remedy after a fault that leaves no valid preset.
const PRESET: &str =
    "then reset, set the joints up at their presets by hand and home with --at-preset";

impl Describe for Fault {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        let named = |joint| axes.joint(joint);
        match *self {
            Self::FollowingError {
                joint,
                error,
                limit,
            } => {
                write!(f, "the following error of {} ", named(joint))?;
                match (
                    amount(axes.joints, joint, error),
                    amount(axes.joints, joint, limit),
                ) {
                    (Some(error), Some(limit)) => write!(f, "is {error} (at most {limit})")?,
                    _ => f.write_str("exceeds its limit")?,
                }
                write!(f, "; remove what blocks the joint, {HOME}")
            }
            Self::SoftLimit { coordinate } => {
                write!(
                    f,
                    "{} left its soft limits; reset, then jog it back",
                    axes.coordinate(coordinate)
                )
            }
            Self::JointRate {
                setpoint,
                joint,
                rate,
                limit,
            } => {
                write_joint_rate(axes, joint, rate, limit, f)?;
                write!(
                    f,
                    " on the way to setpoint {setpoint}; \
                     reset, then move the master more slowly, or lower the feed there"
                )
            }
            Self::Stroke { joint, by } => {
                write!(f, "{} is ", named(joint))?;
                match amount(axes.joints, joint, by) {
                    Some(by) => write!(f, "{by} beyond the end of its stroke")?,
                    None => f.write_str("beyond the end of its stroke")?,
                }
                write!(f, "; move it back by hand, {HOME}")
            }
            Self::Pose(error) => {
                f.write_str("the pose of the machine is not allowed: ")?;
                error.describe(axes, f)
            }
            Self::LimitSwitch { joint } => {
                write!(
                    f,
                    "{} reached its limit switch; move it off (`haptimill move-off`, or by hand), \
                     {HOME}",
                    named(joint)
                )
            }
            Self::Drive { joint, alarm } => {
                let why = Explained { joint, alarm, axes };
                write!(
                    f,
                    "the drive of {} reports a fault: {why}; then reset",
                    named(joint)
                )
            }
            Self::EncoderIllegal { joint, count } => write!(
                f,
                "the encoder of {} made {count} illegal transitions; check its cable and shield, {PRESET}",
                named(joint)
            ),
            Self::CounterJump { joint, counts } => write!(
                f,
                "the encoder of {} jumped by {counts} counts; check its cable and shield, {PRESET}",
                named(joint)
            ),
            Self::EncoderSlip { joint, counts } => {
                let did = if counts < 0 { "lost" } else { "gained" };
                write!(
                    f,
                    "the encoder of {} {did} {} counts between two index pulses; \
                     check its cable, its shield and the width of its index pulse \
                     (index_slack_counts in the machine file), {PRESET}",
                    named(joint),
                    counts.unsigned_abs()
                )
            }
            Self::EncoderStuck { joint } => write!(
                f,
                "the encoder of {} does not count the commanded motion; \
                 check whether the joint is blocked, its encoder and cable, \
                 and its drive (power, wiring, direction), {HOME}",
                named(joint)
            ),
            Self::EncoderReversed { joint } => write!(
                f,
                "{} moved against its drive; check what pushed it, and after a change of the \
                 wiring the direction of encoder and drive in the machine file, {HOME}",
                named(joint)
            ),
            Self::StepsLost { joint, by } => {
                write!(f, "{} lost steps", named(joint))?;
                if let Some(by) = amount(axes.joints, joint, by) {
                    write!(f, " ({by})")?;
                }
                write!(
                    f,
                    "; lower the feed or the depth of cut, or check the drive and the encoder of \
                     the joint, {HOME}"
                )
            }
            Self::LostHost { silent_ms } => write!(
                f,
                "nothing was received from the host for {silent_ms} ms; \
                 the machine decelerated along its path; check the cable and reset"
            ),
            Self::Configuration => write!(
                f,
                "the configuration in the controller failed its integrity check; {PRESET}, \
                 which sends the configuration again"
            ),
            Self::MissedPeriods { missed } => write!(
                f,
                "the controller missed control periods, {missed} of them in a row; \
                 its computations take longer than a period; report this"
            ),
            Self::Homing {
                joint,
                problem: problem @ HomingProblem::LimitStuck,
            } => write!(f, "{}: {problem}; the drives are off", named(joint)),
            Self::Homing { joint, problem } => {
                write!(
                    f,
                    "homing failed on {}: {problem}; all joints were stopped",
                    named(joint)
                )
            }
            Self::Force(problem) => {
                problem.describe(axes, f)?;
                f.write_str(
                    "; the machine decelerated along its path and keeps its compliant \
                     displacement; remove the cause and reset",
                )
            }
            Self::Master(problem) => {
                problem.describe(axes, f)?;
                f.write_str(
                    "; its motors are off and the machine decelerated; remove the cause and reset",
                )
            }
            Self::NotLocked { joint, by } => {
                write!(
                    f,
                    "the motor of {} did not lock when its drive was switched on",
                    named(joint)
                )?;
                if let Some(by) = amount(axes.joints, joint, by) {
                    write!(f, " (it moved by {by})")?;
                }
                f.write_str(
                    "; check the current and the wiring of the motor and the load of the joint, \
                     then reset and enable",
                )
            }
            Self::ProbeContact { input } => write!(
                f,
                "{} had a contact while no probing was commanded; the machine decelerated along \
                 its path; reset and move it off",
                axes.input(input)
            ),
            Self::Racking { joint, by } => {
                write!(
                    f,
                    "{} and the other motor of its gantry disagree",
                    named(joint)
                )?;
                if let Some(by) = amount(axes.joints, joint, by) {
                    write!(f, " by {by}")?;
                }
                write!(
                    f,
                    "; check both home switches, both motors, and what blocks the beam, square it \
                     by hand where it needs more than the largest racking (racking_mm in the \
                     machine file), {HOME}"
                )
            }
            Self::Internal { line } => write!(
                f,
                "an arithmetic limit was reached inside the controller (line {line}); report this"
            ),
        }
    }
}

impl Describe for Event {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::State { from, to, homed } => {
                write!(f, "{from} -> {to}")?;
                match to {
                    // The position is being found.
                    State::Homing => Ok(()),
                    _ if homed => f.write_str(", position kept"),
                    _ => f.write_str(", position lost; home the machine before the next job"),
                }
            }
            Self::JobDone { job, setpoints } => {
                write!(f, "job {job} is done, {setpoints} setpoints")
            }
            Self::JobDropped { job, setpoints } => {
                write!(f, "job {job} was dropped after {setpoints} setpoints")
            }
            Self::Underrun {
                setpoint,
                late_periods,
            } => write!(
                f,
                "setpoint {setpoint} arrived {late_periods} control periods late; \
                 the machine decelerated along its path"
            ),
            Self::Paused { setpoint } => write!(
                f,
                "the program pauses at setpoint {setpoint}; resume to continue"
            ),
            Self::Blocked { setpoint } => write!(
                f,
                "hold before setpoint {setpoint}: the offset of jog or master leaves the program \
                 no stopping distance; jog away from the limit, then resume"
            ),
            Self::Homed => f.write_str("all joints are homed"),
            Self::ReferenceShift { joint, by } => {
                write!(f, "homing shifted the reference of {}", axes.joint(joint))?;
                if let Some(by) = amount(axes.joints, joint, by) {
                    write!(f, " by {by}")?;
                }
                f.write_str(": steps were lost, or the switch is not exact")
            }
            Self::Squared { joint, by } => {
                let name = axes.joint(joint);
                write!(f, "homing squared the gantry: {name} was moved")?;
                if let Some(by) = amount(axes.joints, joint, by) {
                    write!(f, " by {by}")?;
                }
                f.write_str(" relative to its other motor")
            }
            Self::Fault(ref fault) => {
                f.write_str("fault: ")?;
                fault.describe(axes, f)
            }
            Self::JogLimited { coordinate } => write!(
                f,
                "the jog of {} ended at its soft limit, at a stroke or at the edge of the workspace; \
                 jog it the other way",
                axes.coordinate(coordinate)
            ),
            Self::Saturated { joint } => write!(
                f,
                "the drive of {} is saturated: the commanded effort exceeds its limit",
                axes.joint(joint)
            ),
            Self::Tared => f.write_str("the force sensor has a new zero"),
            Self::TareRefused(refusal) => {
                f.write_str("the force sensor keeps its zero: ")?;
                refusal.describe(axes, f)
            }
            Self::Master(problem) => {
                problem.describe(axes, f)?;
                f.write_str("; its motors are off until reset")
            }
            Self::MasterLost { age_ms } => write!(
                f,
                "no master pose for {age_ms} ms: the machine decelerates and holds; \
                 resume when the master is connected again"
            ),
            Self::MasterLimited { coordinate } => write!(
                f,
                "the master commands {} beyond a limit of the machine; the tool waits there",
                axes.coordinate(coordinate)
            ),
            Self::ComplianceLimited { axis } => write!(
                f,
                "the compliant displacement of {} is limited: \
                 by its own limit, a soft limit or the edge of the workspace",
                axes.axis(axis)
            ),
            Self::ProbedAt {
                coordinate,
                measured,
                ..
            } => {
                write!(f, "{} was", axes.coordinate(coordinate))?;
                match amount(axes.pose, coordinate, measured) {
                    Some(at) => write!(f, " at {at} at the contact"),
                    None => f.write_str(" measured at the contact"),
                }
            }
            Self::Probed { input, .. } => {
                write!(f, "contact of {}: the motion ends", axes.input(input))
            }
            Self::NoContact { input } => write!(
                f,
                "the motion ended without a contact of {}",
                axes.input(input)
            ),
            Self::ProbeContact { input } => write!(
                f,
                "{} had a contact while no probing was commanded",
                axes.input(input)
            ),
            Self::InputHold { input } => write!(
                f,
                "{} is active: the machine decelerates along its path and holds",
                axes.input(input)
            ),
            Self::MovedOff { joint } => write!(
                f,
                "{} is off its limit switch; home the machine",
                axes.joint(joint)
            ),
            Self::OutputsSafe => f.write_str("the outputs have their safe values"),
            Self::OutputRefused { output, problem } => write!(
                f,
                "the job was dropped, {} cannot be set: {problem}",
                axes.output(output)
            ),
            Self::ForceSettings { axis, .. } => {
                write!(f, "settings of the force loop of {}", axes.axis(axis))
            }
        }
    }
}
