//! Refusals, faults and events as sentences, with the remedy where there is one.
//!
//! `Display` of these types names axes by number, from 1, and omits amounts, because it does not
//! know the axis units. [`Axes::describe`] knows the machine: it adds axis names, and amounts in
//! millimetres or degrees.
//!
//! ```
//! use haptimill_protocol::message::Fault;
//! use haptimill_protocol::text::{Axes, Axis, AxisKind};
//! let axes = Axes { pose: &[], joints: &[Axis { name: "slide 1", kind: AxisKind::Linear }] };
//! let fault = Fault::SoftLimit { axis: 4 };
//! assert_eq!(
//!     fault.to_string(),
//!     "axis 5 left its soft limits; reset, then move it back by jogging"
//! );
//! let fault = Fault::FollowingError { axis: 0, error: -(3 << 20), limit: 1 << 20 };
//! assert_eq!(
//!     axes.describe(&fault).to_string(),
//!     "slide 1 is -3.000 mm from where it should be (at most 1.000 mm); look for what blocks it, then reset and home"
//! );
//! ```

mod force;
mod haptic;
mod plain;

use crate::force::{ForceProblem, ForceRefusal, TareRefusal};
use crate::haptic::MasterProblem;
use crate::message::{
    ConfigField, ConfigProblem, Event, Fault, HelloRefusal, InputProblem, PoseError, Refusal, State,
};
use core::fmt::{Display, Formatter, Result};

/// Kind of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisKind {
    /// Axis units are 2^-20 mm.
    Linear,
    /// Axis units are 2^-32 turn.
    Rotary,
}

/// Name and kind of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axis<'a> {
    /// Name.
    pub name: &'a str,
    /// Linear or rotary.
    pub kind: AxisKind,
}

/// Axes of a machine. The lists may be short or empty; a missing axis is named by its number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Axes<'a> {
    /// Pose coordinates.
    pub pose: &'a [Axis<'a>],
    /// Joints.
    pub joints: &'a [Axis<'a>],
}

impl<'a> Axes<'a> {
    /// Returns the sentence of `Display` with names and amounts.
    pub fn describe<T: Describe>(&'a self, what: &'a T) -> Described<'a, T> {
        Described { axes: self, what }
    }
}

/// A sentence with the names of a machine's axes, from [`Axes::describe`].
#[derive(Debug, Clone, Copy)]
pub struct Described<'a, T> {
    axes: &'a Axes<'a>,
    what: &'a T,
}

impl<T: Describe> Display for Described<'_, T> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        self.what.describe(self.axes, f)
    }
}

/// Types that have a sentence.
pub trait Describe {
    /// Writes the sentence, without a capital at its start or a full stop at its end.
    ///
    /// # Errors
    ///
    /// Those of the formatter.
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result;
}

/// A value in engineering units: millimetres or degrees, three decimals, exactly rounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Amount {
    /// Axis units.
    pub value: i32,
    /// Kind of the axis.
    pub kind: AxisKind,
}

impl Display for Amount {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        // Thousandths, rounded half up: below 2^31 * 360,000 < 2^50.
        let value = i64::from(self.value);
        let (thousandths, unit) = match self.kind {
            AxisKind::Linear => ((value * 1000 + (1 << 19)) >> 20, "mm"),
            AxisKind::Rotary => ((value * 360_000 + (1 << 31)) >> 32, "deg"),
        };
        let sign = if thousandths < 0 { "-" } else { "" };
        let size = thousandths.unsigned_abs();
        write!(f, "{sign}{}.{:03} {unit}", size / 1000, size % 1000)
    }
}

/// Displays an axis by its name, or by its number from 1.
struct Named<'a>(&'a [Axis<'a>], u8);

impl Display for Named<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self.0.get(usize::from(self.1)) {
            Some(axis) => f.write_str(axis.name),
            None => write!(f, "axis {}", u32::from(self.1) + 1),
        }
    }
}

/// Returns the amount if the kind of the axis is known.
fn amount(axes: &[Axis<'_>], axis: u8, value: i32) -> Option<Amount> {
    let kind = axes.get(usize::from(axis))?.kind;
    Some(Amount { value, kind })
}

impl Describe for PoseError {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::Unreachable => f.write_str(
                "no position of the machine reaches this pose; move the work or shorten the path",
            ),
            Self::OutOfStroke { axis, by } => {
                let name = Named(axes.joints, axis);
                write!(f, "{name} would leave its stroke")?;
                if let Some(by) = amount(axes.joints, axis, by) {
                    write!(f, " by {by}")?;
                }
                f.write_str("; move the work towards the middle of the workspace")
            }
            Self::NearSingularity { distance } => {
                let distance = Amount {
                    value: distance,
                    kind: AxisKind::Linear,
                };
                write!(
                    f,
                    "the arm would come to {distance} from its parallel singularity, where it cannot hold the tool; tilt less or move the work"
                )
            }
            Self::NearReachLimit { pair } => {
                let rods = if pair == 0 { "1 and 2" } else { "3 and 4" };
                write!(
                    f,
                    "rods {rods} would be almost stretched out; move the work nearer to the rails"
                )
            }
            Self::Tilt => f.write_str("the tool would be tilted by more than 90 degrees"),
        }
    }
}

impl Describe for Refusal {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::State(state) => {
                write!(f, "not possible while the machine is {state}")?;
                f.write_str(match state {
                    State::Disabled => "; enable the drives first",
                    State::Fault | State::EmergencyStop => "; remove the cause, then reset",
                    State::Run | State::Homing | State::Jog => "; wait until it is done, or stop it",
                    State::Hold => "; resume or stop the job first",
                    State::Idle => "",
                })
            }
            Self::NotConfigured => f.write_str("the controller has no configuration; home or enable the machine, which sends the machine file"),
            Self::NotHomed => f.write_str("the machine does not know where it is; home it first"),
            Self::Range => f.write_str("a value is out of its range"),
            Self::AxisCount => f.write_str("the number of values is not the number of axes of the machine"),
            Self::OutOfOrder { expected } => write!(f, "setpoint {expected} was expected next"),
            Self::QueueFull => f.write_str("the queue of setpoints is full"),
            // The same sentence as for a joint that leaves its stroke with its drives on.
            Self::MeasuredPose(PoseError::OutOfStroke { axis, by }) => {
                Fault::Stroke { axis, by }.describe(axes, f)
            }
            Self::MeasuredPose(error) => Fault::Pose(error).describe(axes, f),
            Self::Pose { setpoint, error } => {
                write!(f, "setpoint {setpoint}: ")?;
                error.describe(axes, f)
            }
            Self::SoftLimit { setpoint, axis } => {
                let name = Named(axes.pose, axis);
                write!(f, "setpoint {setpoint}: {name} would leave its soft limits; move the work or change the program")
            }
            Self::Setpoint { setpoint } => write!(f, "setpoint {setpoint} cannot be decoded"),
            Self::StartPose { axis } => {
                let name = Named(axes.pose, axis);
                write!(f, "the job does not start where the machine stands: {name} differs; begin again from the present position")
            }
            Self::OldEpoch => f.write_str("this jog was cancelled"),
            Self::ConfigCheck => f.write_str("the configuration did not arrive whole; send it again"),
            Self::Config(problem) => problem.describe(axes, f),
            Self::Input(problem) => problem.describe(axes, f),
            Self::PresetLost => f.write_str(
                "the position was lost; set the joints up at their presets by hand, then home with --at-preset",
            ),
            Self::NoForceSensor => f.write_str(
                "the machine has no force sensor; add a section [force] to the machine file and configure the controller with it",
            ),
            Self::Force { axis, refusal } => {
                write!(f, "force loop of {}: ", Named(axes.pose, axis))?;
                refusal.describe(axes, f)
            }
            Self::NotTared => f.write_str("force control is on and the force sensor has no zero; tare it first, with nothing at the tool"),
            Self::Compliant => {
                f.write_str("the tool yields to a force; take it off the work, or take the axes out of force control, then tare")
            }
            Self::ForceSensor(problem) => {
                f.write_str("force control is on and its sensor cannot be believed: ")?;
                problem.describe(axes, f)
            }
            Self::NoMaster => f.write_str(
                "no hand can lead this machine; add the sections [haptic] or [follow] to the machine file and configure the controller with it",
            ),
            Self::JointRate {
                setpoint,
                axis,
                rate,
                limit,
            } => {
                write!(f, "setpoint {setpoint}: ")?;
                too_fast(axes, axis, rate, limit, f)?;
                f.write_str("; lower the feed there, or keep away from the bound of the workspace")
            }
            Self::FixturesTooNear => f.write_str("the ball at the tip does not fit between this wall and the opposite one; move one of them outwards"),
        }
    }
}

/// Writes that a joint exceeds its maximum rate, with both rates if the machine is known.
fn too_fast(axes: &Axes<'_>, axis: u8, rate: i32, limit: i32, f: &mut Formatter<'_>) -> Result {
    write!(f, "{} would move", Named(axes.joints, axis))?;
    match (
        amount(axes.joints, axis, rate),
        amount(axes.joints, axis, limit),
    ) {
        (Some(rate), Some(limit)) => write!(f, " at {rate}/s (at most {limit}/s)"),
        _ => f.write_str(" faster than its maximum rate"),
    }
}

impl Describe for InputProblem {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        let joint = |axis| Named(axes.joints, axis);
        match *self {
            Self::EmergencyStop => f.write_str("the emergency stop is pressed; release it first"),
            Self::LimitSwitch { axis } => write!(
                f,
                "{} stands on its limit switch; move it off by hand, then home",
                joint(axis)
            ),
            Self::Drive { axis } => write!(
                f,
                "the drive of {} is not ready; look at the drive",
                joint(axis)
            ),
            Self::Coasting => f.write_str("the machine still coasts; wait until it stands"),
            Self::Settling => f.write_str(
                "the step motors have not locked yet; wait until the drives are enabled",
            ),
        }
    }
}

impl Describe for ConfigProblem {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        let field = self.field;
        write!(f, "the configuration is wrong: {field}")?;
        if let Some(axis) = self.axis {
            // The field decides which list the axis belongs to.
            let list = match field {
                ConfigField::SoftLimit
                | ConfigField::StopTime
                | ConfigField::Acceleration
                | ConfigField::Jerk
                | ConfigField::Force => axes.pose,
                _ => axes.joints,
            };
            write!(f, " of {}", Named(list, axis))?;
        }
        f.write_str("; correct the machine file")
    }
}

impl Describe for Fault {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        let joint = |axis| Named(axes.joints, axis);
        match *self {
            Self::FollowingError { axis, error, limit } => {
                write!(f, "{} is ", joint(axis))?;
                match (
                    amount(axes.joints, axis, error),
                    amount(axes.joints, axis, limit),
                ) {
                    (Some(error), Some(limit)) => {
                        write!(f, "{error} from where it should be (at most {limit})")?
                    }
                    _ => f.write_str("too far from where it should be")?,
                }
                f.write_str("; look for what blocks it, then reset and home")
            }
            Self::SoftLimit { axis } => {
                write!(
                    f,
                    "{} left its soft limits; reset, then move it back by jogging",
                    Named(axes.pose, axis)
                )
            }
            Self::JointRate {
                setpoint,
                axis,
                rate,
                limit,
            } => {
                too_fast(axes, axis, rate, limit, f)?;
                write!(
                    f,
                    " on the way to setpoint {setpoint}; reset, then lead the tool more slowly, or lower the feed there"
                )
            }
            Self::Stroke { axis, by } => {
                write!(f, "{} is ", joint(axis))?;
                match amount(axes.joints, axis, by) {
                    Some(by) => write!(f, "{by} beyond the end of its stroke")?,
                    None => f.write_str("beyond the end of its stroke")?,
                }
                f.write_str("; move it back by hand, then reset, enable and home")
            }
            Self::Pose(error) => {
                f.write_str("the machine is where it must not be: ")?;
                error.describe(axes, f)
            }
            Self::LimitSwitch { axis } => {
                write!(
                    f,
                    "{} ran onto its limit switch; free it, then reset and home",
                    joint(axis)
                )
            }
            Self::Drive { axis } => write!(
                f,
                "the drive of {} reports a fault; look at the drive, then reset",
                joint(axis)
            ),
            Self::EncoderIllegal { axis, count } => write!(
                f,
                "the encoder of {} made {count} impossible steps; check its cable and shield, then reset, set the joints up at their presets by hand and home with --at-preset",
                joint(axis)
            ),
            Self::EncoderSlip { axis, counts } => {
                let did = if counts < 0 { "lost" } else { "gained" };
                write!(
                    f,
                    "the encoder of {} {did} {} counts from one index pulse to another; check its cable and shield, and how wide its pulse is (index_slack_counts in the machine file), then reset and home",
                    joint(axis),
                    counts.unsigned_abs()
                )
            }
            Self::EncoderStuck { axis } => write!(
                f,
                "{} was driven and its encoder saw no motion; look for what blocks it, check the encoder's cable, then reset and home",
                joint(axis)
            ),
            Self::EncoderReversed { axis } => write!(
                f,
                "{} went another way than it was driven; look for what pushed it (where the wiring is new: swap the channels of its encoder, or the sign in the machine file), then reset and home",
                joint(axis)
            ),
            Self::StepsLost { axis, by } => {
                write!(f, "{} lost steps", joint(axis))?;
                if let Some(by) = amount(axes.joints, axis, by) {
                    write!(f, " ({by})")?;
                }
                f.write_str("; go slower or cut less, then reset, enable and home, which compares the encoder with its index pulse")
            }
            Self::LostHost { silent_ms } => write!(
                f,
                "nothing was heard from the host for {silent_ms} ms; the machine slowed down along its path, check the cable and reset"
            ),
            Self::Configuration => {
                f.write_str("the configuration in the controller changed by itself; send it again")
            }
            Self::LatePeriod { missed } => write!(
                f,
                "the controller missed control periods, {missed} of them at once; it has more to do than a period is long, report this"
            ),
            Self::Homing { axis, problem } => {
                write!(
                    f,
                    "homing failed on {}: {problem}; all axes were stopped",
                    joint(axis)
                )
            }
            Self::Force(problem) => {
                problem.describe(axes, f)?;
                f.write_str("; the machine slowed down along its path and the tool stayed where it was, remove the cause and reset")
            }
            Self::Master(problem) => {
                problem.describe(axes, f)?;
                f.write_str(
                    "; the hand is free and the machine slowed down, remove the cause and reset",
                )
            }
            Self::NotLocked { axis, by } => {
                write!(
                    f,
                    "the motor of {} did not lock when its drive was switched on",
                    joint(axis)
                )?;
                if let Some(by) = amount(axes.joints, axis, by) {
                    write!(f, " (it moved by {by})")?;
                }
                f.write_str("; check the motor's current and wiring, and what loads the joint, then reset and enable")
            }
            Self::Internal { line } => write!(
                f,
                "an arithmetic limit was reached inside the controller (line {line}); report this"
            ),
        }
    }
}

impl Describe for Event {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::State {
                from,
                to,
                position_kept,
            } => {
                let kept = if position_kept {
                    "kept"
                } else {
                    "lost; home the machine before the next job"
                };
                write!(f, "{from} -> {to}, position {kept}")
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
                "setpoint {setpoint} came {late_periods} control periods too late; the machine slowed down along its path"
            ),
            Self::Paused { setpoint } => write!(
                f,
                "the program pauses at setpoint {setpoint}; resume to go on"
            ),
            Self::Blocked { setpoint } => write!(
                f,
                "held before setpoint {setpoint}: what was moved by hand leaves the program no room to stop ahead; make room by jogging, then resume"
            ),
            Self::Homed => f.write_str("all axes have their reference"),
            Self::Fault(ref fault) => {
                f.write_str("fault: ")?;
                fault.describe(axes, f)
            }
            Self::JogLimited { axis } => write!(
                f,
                "{} is at its soft limit; the jog was clipped",
                Named(axes.pose, axis)
            ),
            Self::Saturated { axis } => write!(
                f,
                "the drive of {} was asked for more than it can give",
                Named(axes.joints, axis)
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
                "nothing new was heard of the hand for {age_ms} ms; the machine slows down and holds, resume when the hand is there again"
            ),
            Self::MasterLimited { axis } => write!(
                f,
                "the hand leads {} where the machine cannot go; it waits in front of it",
                Named(axes.pose, axis)
            ),
            Self::ComplianceLimited { axis } => write!(
                f,
                "the tool cannot yield any further along {}: its limit, a soft limit or the end of the machine's reach",
                Named(axes.pose, axis)
            ),
            Self::ForceSettings { axis, .. } => {
                write!(
                    f,
                    "settings of the force loop of {}",
                    Named(axes.pose, axis)
                )
            }
        }
    }
}

/// Implements `Display` without a machine, and the error trait where it applies.
macro_rules! display {
    ($($name:ident),*) => {$(
        impl Display for $name {
            fn fmt(&self, f: &mut Formatter<'_>) -> Result {
                self.describe(&Axes::default(), f)
            }
        }
    )*};
}
display!(
    PoseError,
    Refusal,
    ConfigProblem,
    Fault,
    Event,
    ForceProblem,
    ForceRefusal,
    TareRefusal,
    MasterProblem
);

impl core::error::Error for PoseError {}
impl core::error::Error for Refusal {}
impl core::error::Error for HelloRefusal {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        /// An amount equals the value within half a thousandth when parsed as a decimal number.
        #[test]
        fn amounts_are_right(value: i32) {
            for (kind, scale, unit) in [(AxisKind::Linear, 1048576.0, " mm"), (AxisKind::Rotary, 4294967296.0 / 360.0, " deg")] {
                let text = Amount { value, kind }.to_string();
                let read: f64 = text.strip_suffix(unit).unwrap().parse().unwrap();
                prop_assert!((read - f64::from(value) / scale).abs() <= 0.0005 + 1e-9, "{} for {}", text, value);
            }
        }
    }

    #[test]
    fn names_are_used_where_they_are_known() {
        let slide = [Axis {
            name: "slide 1",
            kind: AxisKind::Linear,
        }];
        let axes = Axes {
            pose: &[],
            joints: &slide,
        };
        let error = PoseError::OutOfStroke {
            axis: 0,
            by: 1 << 19,
        };
        let refusal = Refusal::Pose {
            setpoint: 12,
            error,
        };
        assert_eq!(
            axes.describe(&refusal).to_string(),
            "setpoint 12: slide 1 would leave its stroke by 0.500 mm; move the work towards the middle of the workspace"
        );
        assert!(
            refusal
                .to_string()
                .starts_with("setpoint 12: axis 1 would leave its stroke;")
        );
    }
}
