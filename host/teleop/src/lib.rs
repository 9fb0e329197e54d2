//! Teleoperation: a master device moves the tool of a machine, and the force on the tool is fed
//! back to the master.
//!
//! A [`MasterDevice`] reports the pose of a handle: a haptic arm on a controller of its own
//! ([`arm`]), or keys and sticks that move a virtual handle ([`input`]). The loop ([`Teleop`])
//! sends each new [`MasterSample`] with its age to the controller of the machine as a last-value
//! message, and sends the force on the tool to the master. Nothing is queued.
//!
//! ```text
//! haptic arm -> its controller -> MasterTelemetry -> host
//!            -> MasterPose { epoch, age } -> machine controller -> tool
//! haptic arm <- its controller <- RemoteForce <- host
//!            <- Telemetry { force } <- machine controller <- force sensor
//! ```
//!
//! The controllers ensure safety: the machine holds when the newest sample is older than
//! `stale_ms`, and resumes on command only; the arm exerts no more force 100 ms after the last
//! force message. The loop never resumes by itself.
//!
//! With both controllers in the simulator the loop runs in virtual time and is deterministic to the
//! bit. With a port on either side it runs in real time.
//!
//! Implementations of [`MasterDevice`] must return a sample only when it is new: an old pose
//! repeated with age 0 defeats the supervision of the machine.

pub mod arm;
pub mod input;
pub mod latency;
mod outcome;
mod run;
pub mod script;

pub use arm::{Arm, OperatorLine};
pub use latency::{ForceSample, Latency, LatencyFigures};
pub use outcome::{Ended, HoldRecord, Row, TeleopOutcome};
pub use run::{Teleop, TeleopOptions};
pub use script::{CommandInput, OperatorCommand, Script};

use haptimill_client::Error;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterPose};

/// Range of G_P, the scale from master to tool.
pub const SCALES: std::ops::RangeInclusive<f64> = 0.1..=2.0;

/// A pose of the master and its age.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MasterSample {
    /// The pose.
    pub pose: MasterPose,
    /// Time since it was measured, microseconds.
    pub age_us: u64,
}

/// Forces at the master, N.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MasterForce {
    /// Force that the motors exert.
    pub force: [f64; COMPONENTS],
    /// Force of the feedback law alone.
    pub feedback: [f64; COMPONENTS],
}

/// Whether a master can move the tool.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MasterStatus {
    /// It can.
    Ready,
    /// It sends no samples now, for this reason.
    Waiting(String),
    /// It is disabled by a fault, which the operator must clear.
    Disabled(String),
}

impl MasterStatus {
    /// Why the master is not ready; `None` when it is.
    #[must_use]
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Ready => None,
            Self::Waiting(reason) | Self::Disabled(reason) => Some(reason),
        }
    }
}

/// A device that an operator moves.
pub trait MasterDevice {
    /// Checks that the device is there; called before anything moves.
    ///
    /// # Errors
    /// The device is of another kind or does not answer.
    fn prepare(&mut self) -> Result<(), Error> {
        Ok(())
    }

    /// Advances to a time of the loop, microseconds, and returns the newest sample if there is a
    /// new one.
    ///
    /// # Errors
    /// The device is of another kind. A lost link is no error, see [`MasterDevice::status`].
    fn advance(&mut self, now_us: u64) -> Result<Option<MasterSample>, Error>;

    /// Whether the master can move the tool now.
    fn status(&self) -> MasterStatus;

    /// Sends the force on the tool to the device: x, y, z, in 2^-6 N.
    fn send_force(&mut self, _force: [i16; COMPONENTS]) {}

    /// Forces at the master; `None` for a device without motors.
    fn force(&self) -> Option<MasterForce> {
        None
    }

    /// The next force that the controller of the device received or rendered.
    fn next_force_sample(&mut self) -> Option<ForceSample> {
        None
    }

    /// The feedback law of the device, if it has one.
    fn force_feedback(&self) -> Option<ForceFeedback> {
        None
    }

    /// Clears the fault of the device.
    fn reset(&mut self) {}

    /// The next message about a fault of the device.
    fn next_message(&mut self) -> Option<String> {
        None
    }

    /// The next command that the operator gave at the device.
    fn next_command(&mut self) -> Option<OperatorCommand> {
        None
    }

    /// Round-trip time to the controller of the device, microseconds; 0 where there is none.
    fn round_trip_us(&self) -> u32 {
        0
    }
}
