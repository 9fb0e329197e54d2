//! What goes wrong, and when: every simulated device can be spoilt for a time, by virtual time and nothing else.
//!
//! A fault is named in a scenario file (serde) or in one line of text, for an option on the command line:
//!
//! ```
//! use haptimill_hil_sim::fault::{Fault, FaultKind};
//! let fault: Fault = "slide-jammed axis=l3 effort=500 at=1.5s for=200ms".parse().unwrap();
//! assert_eq!(fault.what, FaultKind::SlideJammed { axis: "l3".into(), effort: Some(500.0) });
//! assert_eq!(fault.for_s, Some(0.2));
//! ```
//!
//! [`catalogue`] lists all of them with their keys, for people.
//!
//! An axis is called by the name of its joint in the machine's configuration. Without `at` a fault is there from the start, without `for` it stays. Two faults on
//! one device add up; where they contradict each other the later in the list holds.

mod hand;
mod text;

pub use hand::{HandEncoder, HandFault, HandSensor};
pub use text::catalogue;

use core::fmt;
use haptimill_firmware::io::LEGS;
use serde::{Deserialize, Serialize};

/// A fault in time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// When it begins, seconds.
    #[serde(default)]
    pub at_s: f64,
    /// How long it stays, seconds; without it, for ever.
    #[serde(default)]
    pub for_s: Option<f64>,
    /// What it is.
    pub what: FaultKind,
}

/// What goes wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum FaultKind {
    /// A channel of an encoder stands still.
    EncoderStuck {
        /// Name of the joint.
        axis: String,
        /// The channel.
        channel: Channel,
        /// The level at which it stands.
        level: Level,
    },
    /// The channels of an encoder are swapped: it counts backwards.
    EncoderSwapped {
        /// Name of the joint.
        axis: String,
    },
    /// The counter slips, once.
    EncoderSlip {
        /// Name of the joint.
        axis: String,
        /// By how much.
        counts: i32,
    },
    /// Noise pulses on A, B or both.
    EncoderNoise {
        /// Name of the joint.
        axis: String,
        /// How many, on average.
        #[serde(rename = "per-second")]
        per_second: f64,
    },
    /// The index line is dead.
    IndexMissing {
        /// Name of the joint.
        axis: String,
    },
    /// The drive gives nothing and says it is well.
    DriveDead {
        /// Name of the joint.
        axis: String,
    },
    /// The drive gives nothing and says that it is not well.
    DriveTripped {
        /// Name of the joint.
        axis: String,
    },
    /// The drive gives less (or more) than it is asked for.
    DriveWeak {
        /// Name of the joint.
        axis: String,
        /// By this factor.
        gain: f64,
    },
    /// The drive pulls the wrong way.
    DriveReversed {
        /// Name of the joint.
        axis: String,
    },
    /// A slide is hard to move.
    SlideJammed {
        /// Name of the joint.
        axis: String,
        /// Friction that is added, N or N m; without it the slide is held fast.
        #[serde(default)]
        effort: Option<f64>,
    },
    /// Something pushes a slide.
    Push {
        /// Name of the joint.
        axis: String,
        /// N or N m.
        effort: f64,
    },
    /// A switch stands still.
    SwitchStuck {
        /// Name of the joint.
        axis: String,
        /// The switch.
        switch: Switch,
        /// How it stands.
        active: bool,
    },
    /// The codes of the force sensor stand still. A machine without a sensor does not notice; so for the next four.
    SensorStuck {
        /// Which of its axes.
        along: Along,
    },
    /// The signal of the force sensor is lost: its codes are 0.
    SensorDropped {
        /// Which of its axes.
        along: Along,
    },
    /// The force sensor is wired the wrong way round.
    SensorReversed {
        /// Which of its axes.
        along: Along,
    },
    /// The force sensor drifts.
    SensorDrift {
        /// Which of its axes.
        along: Along,
        /// N/s.
        rate: f64,
    },
    /// The force sensor stands at an end of its range.
    SensorSaturated {
        /// Which of its axes.
        along: Along,
        /// At which end.
        level: Level,
    },
    /// Something at the haptic arm.
    Hand(HandFault),
    /// The spindle stands, whatever it is told.
    SpindleStalled,
    /// The emergency stop circuit is open.
    EmergencyStop,
    /// The controller is not called for some periods, once.
    MissedPeriods {
        /// How many.
        count: u32,
    },
    /// Bits of the serial line are flipped.
    LinkErrors {
        /// Probability per bit.
        rate: f64,
        /// Which way.
        #[serde(default)]
        direction: Direction,
    },
    /// Bytes of the serial line are lost.
    LinkDrop {
        /// Probability per byte.
        rate: f64,
        /// Which way.
        #[serde(default)]
        direction: Direction,
    },
    /// Bytes of the serial line come twice.
    LinkDuplicate {
        /// Probability per byte.
        rate: f64,
        /// Which way.
        #[serde(default)]
        direction: Direction,
    },
    /// Bytes of the serial line come later.
    LinkDelay {
        /// Milliseconds.
        ms: f64,
        /// Which way.
        #[serde(default)]
        direction: Direction,
    },
    /// The serial line is cut.
    LinkCut {
        /// Which way.
        #[serde(default)]
        direction: Direction,
    },
}

/// Channel of an encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Channel {
    /// Leads upwards.
    A,
    /// Follows upwards.
    B,
}

/// Level of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// 0.
    Low,
    /// 1.
    High,
}

/// A switch of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Switch {
    /// Home.
    Home,
    /// Lower end.
    LimitLow,
    /// Upper end.
    LimitHigh,
}

/// Axis of the force sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Along {
    /// x_w.
    X,
    /// y_w.
    Y,
    /// z_w.
    Z,
}

/// Direction on the serial line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// Both ways.
    #[default]
    Both,
    /// From the host.
    ToMachine,
    /// To the host.
    ToHost,
}

/// Why a fault makes no sense.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaultError {
    pub(crate) fault: String,
    pub(crate) problem: String,
}

impl fmt::Display for FaultError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "fault `{}`: {}", self.fault, self.problem)
    }
}

impl core::error::Error for FaultError {}

impl FaultKind {
    /// Name of the joint that it is about, if it is about one.
    pub fn axis(&self) -> Option<&str> {
        match self {
            Self::EncoderStuck { axis, .. }
            | Self::EncoderSwapped { axis }
            | Self::EncoderSlip { axis, .. }
            | Self::EncoderNoise { axis, .. }
            | Self::IndexMissing { axis }
            | Self::DriveDead { axis }
            | Self::DriveTripped { axis }
            | Self::DriveWeak { axis, .. }
            | Self::DriveReversed { axis }
            | Self::SlideJammed { axis, .. }
            | Self::Push { axis, .. }
            | Self::SwitchStuck { axis, .. } => Some(axis),
            _ => None,
        }
    }

    /// A number that must not be negative (or must be a probability), with its largest value.
    const fn bounded(&self) -> Option<(f64, f64)> {
        match self {
            Self::EncoderNoise { per_second, .. }
            | Self::Hand(HandFault::EncoderNoise { per_second, .. }) => {
                Some((*per_second, 50_000.0))
            }
            Self::SlideJammed {
                effort: Some(effort),
                ..
            } => Some((*effort, f64::INFINITY)),
            Self::LinkErrors { rate, .. }
            | Self::LinkDrop { rate, .. }
            | Self::LinkDuplicate { rate, .. } => Some((*rate, 1.0)),
            Self::LinkDelay { ms, .. } => Some((*ms, 1e6)),
            _ => None,
        }
    }
}

impl Fault {
    /// Checks the fault against a machine of these joints. Gives the place of its joint among them; 0 for a fault that is about none.
    ///
    /// # Errors
    /// There is no such joint, or a number is out of its range.
    pub fn place(&self, joints: &[&str]) -> Result<usize, FaultError> {
        let refuse = |problem: String| {
            Err(FaultError {
                fault: self.to_string(),
                problem,
            })
        };
        let place = match self.what.axis() {
            None => 0,
            Some(axis) => match joints.iter().position(|joint| *joint == axis) {
                Some(place) => place,
                None => {
                    return refuse(format!(
                        "there is no axis `{axis}`; this machine has {}",
                        joints.join(", ")
                    ));
                }
            },
        };
        if let Some((value, most)) = self
            .what
            .bounded()
            .filter(|(value, most)| !(0.0..=*most).contains(value))
        {
            return refuse(format!("{value} is not within 0 to {most}"));
        }
        if let FaultKind::Hand(fault) = &self.what
            && let Some(HandEncoder { leg, .. }) = fault.encoder()
            && !(1..=LEGS).contains(&usize::from(leg))
        {
            return refuse(format!(
                "there is no leg {leg}; the haptic arm has 1 to {LEGS}"
            ));
        }
        if let FaultKind::DriveWeak { gain: number, .. }
        | FaultKind::Push { effort: number, .. }
        | FaultKind::SensorDrift { rate: number, .. } = self.what
            && !number.is_finite()
        {
            return refuse(format!("{number} is no number to reckon with"));
        }
        let span = 0.0..=1e6;
        if !span.contains(&self.at_s) || self.for_s.is_some_and(|time| !span.contains(&time)) {
            return refuse("times are 0 to 1e6 seconds".into());
        }
        Ok(place)
    }
}
