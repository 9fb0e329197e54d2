//! Fault injection: faults of every simulated device, with start and duration in virtual time.
//!
//! A fault is given in a scenario file (serde) or in one line of text, for an option of the command
//! line:
//!
//! ```
//! use haptimill_hil_sim::fault::{Fault, FaultKind};
//! let fault: Fault = "joint-jammed joint=y effort=500 at=1.5s for=200ms".parse().unwrap();
//! assert_eq!(fault.what, FaultKind::JointJammed { joint: "y".into(), effort: Some(500.0) });
//! assert_eq!(fault.for_s, Some(0.2));
//! ```
//!
//! [`catalogue`] lists all faults with their keys, as a help text.
//!
//! A fault of a joint names it as the machine's configuration does. Without `at` a fault begins at
//! the start; without `for` it stays. Two faults of one device add up; where they contradict each
//! other, the later one in the list applies.

mod catalogue;
mod haptic;
mod text;

pub use catalogue::catalogue;
pub use haptic::{HapticEncoder, HapticFault, HapticSensor};

use core::fmt;
use haptimill_firmware::io::LEGS;
use serde::{Deserialize, Serialize};

/// A fault with its time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// Start, seconds.
    #[serde(default)]
    pub at_s: f64,
    /// Duration, seconds; without it the fault stays.
    #[serde(default)]
    pub for_s: Option<f64>,
    /// Kind of the fault.
    pub what: FaultKind,
}

/// Kind of a fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum FaultKind {
    /// A channel of an encoder is stuck.
    EncoderStuck {
        /// Name of the joint.
        joint: String,
        /// Stuck channel.
        channel: Channel,
        /// Level at which it is stuck.
        level: Level,
    },
    /// The channels of an encoder are swapped: it counts backwards.
    EncoderSwapped {
        /// Name of the joint.
        joint: String,
    },
    /// The counter of an encoder slips once.
    EncoderSlip {
        /// Name of the joint.
        joint: String,
        /// Counts added to the counter.
        counts: i32,
    },
    /// Noise pulses on A, B or both.
    EncoderNoise {
        /// Name of the joint.
        joint: String,
        /// Mean rate, 1/s.
        #[serde(rename = "per-second")]
        per_second: f64,
    },
    /// The index line is dead.
    IndexMissing {
        /// Name of the joint.
        joint: String,
    },
    /// The drive has no output and reports no fault.
    DriveDead {
        /// Name of the joint.
        joint: String,
    },
    /// The drive has no output and reports a fault.
    DriveTripped {
        /// Name of the joint.
        joint: String,
    },
    /// The drive's output is smaller or larger than commanded.
    DriveWeak {
        /// Name of the joint.
        joint: String,
        /// Ratio of the effort to the commanded one.
        gain: f64,
    },
    /// The direction of the drive is reversed.
    DriveReversed {
        /// Name of the joint.
        joint: String,
    },
    /// A joint has additional friction.
    JointJammed {
        /// Name of the joint.
        joint: String,
        /// Additional friction, N or N m; without it the joint is blocked.
        #[serde(default)]
        effort: Option<f64>,
    },
    /// An external effort acts on a joint.
    Push {
        /// Name of the joint.
        joint: String,
        /// Effort, N or N m.
        effort: f64,
    },
    /// A switch is stuck.
    SwitchStuck {
        /// Name of the joint.
        joint: String,
        /// Stuck switch.
        switch: Switch,
        /// State in which it is stuck.
        active: bool,
    },
    /// A switch is wired the wrong way: closed for open.
    SwitchInverted {
        /// Name of the joint.
        joint: String,
        /// The switch.
        switch: Switch,
    },
    /// A switch is not connected: its line is low.
    SwitchMissing {
        /// Name of the joint.
        joint: String,
        /// The switch.
        switch: Switch,
    },
    /// The contact of a switch bounces.
    SwitchBounces {
        /// Name of the joint.
        joint: String,
        /// The switch.
        switch: Switch,
        /// Time after a change, ms.
        ms: f64,
    },
    /// The codes of the force sensor are frozen. This fault and the next four have no effect on a
    /// machine without a sensor.
    SensorStuck {
        /// Axis of the sensor.
        along: Along,
    },
    /// The signal of the force sensor is lost: its codes are 0.
    SensorDropped {
        /// Axis of the sensor.
        along: Along,
    },
    /// The force sensor is reversed.
    SensorReversed {
        /// Axis of the sensor.
        along: Along,
    },
    /// The force sensor drifts.
    SensorDrift {
        /// Axis of the sensor.
        along: Along,
        /// Drift, N/s.
        rate: f64,
    },
    /// The force sensor is saturated at an end of its range.
    SensorSaturated {
        /// Axis of the sensor.
        along: Along,
        /// End of the range.
        level: Level,
    },
    /// A fault of the haptic arm.
    HapticArm(HapticFault),
    /// The spindle does not turn, whatever its command is.
    SpindleStalled,
    /// A digital input is forced to a level.
    InputLevel {
        /// Name of the input.
        name: String,
        /// The level.
        level: Level,
    },
    /// The level of a digital input alternates.
    InputBounce {
        /// Name of the input.
        name: String,
        /// Frequency, Hz.
        hz: f64,
    },
    /// The emergency stop circuit is open.
    EmergencyStop,
    /// The controller misses some periods, once.
    MissedPeriods {
        /// Number of periods.
        count: u32,
    },
    /// Bits of the serial line are flipped.
    LinkErrors {
        /// Probability per bit.
        rate: f64,
        /// Direction of the line.
        #[serde(default)]
        direction: Direction,
    },
    /// Bytes of the serial line are lost.
    LinkDrop {
        /// Probability per byte.
        rate: f64,
        /// Direction of the line.
        #[serde(default)]
        direction: Direction,
    },
    /// Bytes of the serial line are duplicated.
    LinkDuplicate {
        /// Probability per byte.
        rate: f64,
        /// Direction of the line.
        #[serde(default)]
        direction: Direction,
    },
    /// Bytes of the serial line are delayed.
    LinkDelay {
        /// Delay, ms.
        ms: f64,
        /// Direction of the line.
        #[serde(default)]
        direction: Direction,
    },
    /// The serial line is cut.
    LinkCut {
        /// Direction of the line.
        #[serde(default)]
        direction: Direction,
    },
}

/// Channel of an encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Channel {
    /// Channel A; it leads upwards.
    A,
    /// Channel B; it follows upwards.
    B,
}

/// Level of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// Low, 0.
    Low,
    /// High, 1.
    High,
}

/// A switch of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Switch {
    /// Home switch.
    Home,
    /// Lower limit switch.
    LimitLow,
    /// Upper limit switch.
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
    /// Both directions.
    #[default]
    Both,
    /// From the host to the machine.
    ToMachine,
    /// From the machine to the host.
    ToHost,
}

/// A fault that is invalid for the machine.
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
    /// Name of the fault's joint, if it has one.
    pub fn joint(&self) -> Option<&str> {
        match self {
            Self::EncoderStuck { joint, .. }
            | Self::EncoderSwapped { joint }
            | Self::EncoderSlip { joint, .. }
            | Self::EncoderNoise { joint, .. }
            | Self::IndexMissing { joint }
            | Self::DriveDead { joint }
            | Self::DriveTripped { joint }
            | Self::DriveWeak { joint, .. }
            | Self::DriveReversed { joint }
            | Self::JointJammed { joint, .. }
            | Self::Push { joint, .. }
            | Self::SwitchStuck { joint, .. }
            | Self::SwitchInverted { joint, .. }
            | Self::SwitchMissing { joint, .. }
            | Self::SwitchBounces { joint, .. } => Some(joint),
            _ => None,
        }
    }

    /// Name of the fault's digital input, if it has one.
    pub fn input(&self) -> Option<&str> {
        match self {
            Self::InputLevel { name, .. } | Self::InputBounce { name, .. } => Some(name),
            _ => None,
        }
    }

    /// Key of the fault's number, its value, and the smallest and largest value that the simulation
    /// supports. Beyond them a joint would be torn off its screw.
    const fn bounded(&self) -> Option<(&'static str, f64, f64, f64)> {
        Some(match self {
            Self::EncoderNoise { per_second, .. }
            | Self::HapticArm(HapticFault::EncoderNoise { per_second, .. }) => {
                ("per-second", *per_second, 0.0, 50_000.0)
            }
            Self::DriveWeak { gain, .. } => ("gain", *gain, -100.0, 100.0),
            Self::JointJammed {
                effort: Some(effort),
                ..
            } => ("effort", *effort, 0.0, 1e6),
            Self::Push { effort, .. } => ("effort", *effort, -1e5, 1e5),
            Self::InputBounce { hz, .. } => ("hz", *hz, 0.001, 1e6),
            Self::SensorDrift { rate, .. } => ("rate", *rate, -1e6, 1e6),
            Self::MissedPeriods { count } => ("count", *count as f64, 1.0, 1e6),
            Self::LinkErrors { rate, .. }
            | Self::LinkDrop { rate, .. }
            | Self::LinkDuplicate { rate, .. } => ("rate", *rate, 0.0, 1.0),
            Self::LinkDelay { ms, .. } | Self::SwitchBounces { ms, .. } => ("ms", *ms, 0.0, 1e6),
            _ => return None,
        })
    }
}

impl Fault {
    /// Checks the fault against a machine with these joints and digital inputs. Returns the index
    /// of the fault's joint or input, or 0 for a fault with neither.
    ///
    /// # Errors
    /// The joint or input does not exist, or a number is out of its range.
    pub fn place(&self, joints: &[&str], inputs: &[&str]) -> Result<usize, FaultError> {
        let refuse = |problem: String| {
            Err(FaultError {
                fault: self.to_string(),
                problem,
            })
        };
        let input = self.what.input();
        let place = match self.what.joint() {
            None => match input.map(|name| inputs.iter().position(|input| *input == name)) {
                None => 0,
                Some(Some(place)) => place,
                Some(None) => {
                    let has = if inputs.is_empty() {
                        "no [[plant.input]]".to_string()
                    } else {
                        inputs.join(", ")
                    };
                    return refuse(format!(
                        "there is no simulated input `{}`; this machine has {has}",
                        input.unwrap_or_default()
                    ));
                }
            },
            Some(name) => match joints.iter().position(|joint| *joint == name) {
                Some(place) => place,
                None => {
                    return refuse(format!(
                        "there is no joint `{name}`; this machine has {}",
                        joints.join(", ")
                    ));
                }
            },
        };
        if let Some((key, value, low, high)) = self.what.bounded()
            && !(low..=high).contains(&value)
        {
            return refuse(format!(
                "`{key}={value}` is out of range, allowed is {low} to {high}"
            ));
        }
        if let FaultKind::HapticArm(fault) = &self.what
            && let Some(HapticEncoder { leg, .. }) = fault.encoder()
            && !(1..=LEGS).contains(&usize::from(leg))
        {
            return refuse(format!(
                "there is no leg {leg}; the haptic arm has 1 to {LEGS}"
            ));
        }
        let span = 0.0..=1e6;
        if !span.contains(&self.at_s) {
            return refuse(format!(
                "`at={}s` is out of range, allowed is 0 to 1e6 seconds",
                self.at_s
            ));
        }
        if let Some(time) = self.for_s
            && !(span.contains(&time) && time > 0.0)
        {
            return refuse(format!(
                "`for={time}s` is out of range, allowed is above 0 to 1e6 seconds"
            ));
        }
        Ok(place)
    }
}
