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

pub use hand::{HapticEncoder, HapticFault, HapticSensor};
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
    Hand(HapticFault),
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

    /// Its number, by the key of its line, with the least and the largest value that the simulated machine stands: beyond them a slide is torn from
    /// its screw, and there is nothing left to simulate.
    const fn bounded(&self) -> Option<(&'static str, f64, f64, f64)> {
        Some(match self {
            Self::EncoderNoise { per_second, .. }
            | Self::Hand(HapticFault::EncoderNoise { per_second, .. }) => {
                ("per-second", *per_second, 0.0, 50_000.0)
            }
            Self::DriveWeak { gain, .. } => ("gain", *gain, -100.0, 100.0),
            Self::SlideJammed {
                effort: Some(effort),
                ..
            } => ("effort", *effort, 0.0, 1e6),
            Self::Push { effort, .. } => ("effort", *effort, -1e5, 1e5),
            Self::SensorDrift { rate, .. } => ("rate", *rate, -1e6, 1e6),
            Self::MissedPeriods { count } => ("count", *count as f64, 1.0, 1e6),
            Self::LinkErrors { rate, .. }
            | Self::LinkDrop { rate, .. }
            | Self::LinkDuplicate { rate, .. } => ("rate", *rate, 0.0, 1.0),
            Self::LinkDelay { ms, .. } => ("ms", *ms, 0.0, 1e6),
            _ => return None,
        })
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
        if let Some((key, value, low, high)) = self.what.bounded()
            && !(low..=high).contains(&value)
        {
            return refuse(format!("`{key}={value}`: must be {low} to {high}"));
        }
        if let FaultKind::Hand(fault) = &self.what
            && let Some(HapticEncoder { leg, .. }) = fault.encoder()
            && !(1..=LEGS).contains(&usize::from(leg))
        {
            return refuse(format!(
                "there is no leg {leg}; the haptic arm has 1 to {LEGS}"
            ));
        }
        let span = 0.0..=1e6;
        if !span.contains(&self.at_s) {
            return refuse(format!("`at={}s`: must be 0 to 1e6 seconds", self.at_s));
        }
        if let Some(time) = self.for_s
            && !(span.contains(&time) && time > 0.0)
        {
            return refuse(format!(
                "`for={time}s`: must be up to 1e6 seconds, and more than 0"
            ));
        }
        Ok(place)
    }
}
