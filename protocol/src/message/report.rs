//! Reports of the controller, and its telemetry.

use super::{ANALOG, Alarms, AxisValues, Event, Fault, Refusal, State};
use crate::force::ForceTelemetry;
use crate::haptic::MasterTelemetry;
use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Messages of the controller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(
    clippy::large_enum_variant,
    reason = "few of them exist at a time; there is no allocator for a box"
)]
pub enum Report {
    /// Answer to a request.
    Answer {
        /// Number of the request.
        id: u8,
        /// Done (or begun), or the refusal.
        result: Result<(), Refusal>,
    },
    /// Report of something that happened.
    Event {
        /// Control period of the event.
        period: u64,
        /// The event.
        event: Event,
    },
    /// State of the controller.
    Telemetry(Telemetry),
    /// State of the master.
    Master(MasterTelemetry),
}

/// State of the controller at the end of a control period.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Telemetry {
    /// The control period.
    pub period: u64,
    /// State of the controller.
    pub state: State,
    /// All joints are homed, and nothing since has made their positions doubtful.
    pub homed: bool,
    /// Setpoints with a number below this can be accepted. The number is absolute, so setpoints
    /// under way cannot be counted twice.
    pub credit: u32,
    /// Setpoint that the motion is heading for.
    pub setpoint: u32,
    /// Program time of the job in control periods; it does not advance while the machine waits.
    pub program_periods: u32,
    /// Speed factor, [`FULL_SPEED_FACTOR`] for the programmed speed.
    ///
    /// [`FULL_SPEED_FACTOR`]: super::FULL_SPEED_FACTOR
    pub speed_factor: u16,
    /// Commanded pose, axis units.
    pub commanded: AxisValues,
    /// Measured pose, axis units; empty while the forward kinematics has no verified answer.
    pub measured: AxisValues,
    /// Measured joints, axis units.
    pub joints: AxisValues,
    /// Turns of each joint since it was configured, beside its angle; empty on a machine without a
    /// joint that wraps around, which takes one byte.
    pub turns: AxisValues,
    /// Following error of each joint, axis units; of an open-loop joint the steps that are still to
    /// be emitted.
    pub following_error: AxisValues,
    /// Open-loop joints, one bit each: their position is the count of emitted steps and not
    /// measured.
    pub open_loop: u8,
    /// Drive command of each joint: DAC code, or steps emitted since enable.
    pub drive: AxisValues,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Total of received bytes that were deferred, because a period takes at most 64.
    pub deferred_bytes: u32,
    /// Total of frames refused by their check.
    pub bad_frames: u32,
    /// Total of received bytes that the board lost because its buffer was full.
    pub lost_bytes: u32,
    /// Forces. `None` on a machine without a sensor, which takes one byte.
    pub force: Option<ForceTelemetry>,
    /// Named inputs and outputs. `None` on a machine without any, which takes one byte.
    pub io: Option<IoTelemetry>,
    /// What few reports have; without it they are as short as possible.
    pub more: MoreTelemetry,
}

/// Telemetry that few reports have.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MoreTelemetry {
    /// A machine without error tables, and no line is active.
    #[default]
    Nothing,
    /// Volumetric compensation: percent of its fade, 100 where it is in full effect.
    Compensation(u8),
    /// Active lines.
    Lines(ActiveLines),
    /// Both.
    CompensationAndLines(u8, ActiveLines),
}

impl MoreTelemetry {
    /// Telemetry of a machine with this compensation (`None` without error tables) and these lines.
    pub fn new(compensation: Option<u8>, lines: ActiveLines) -> Self {
        let are_active = lines != ActiveLines::default();
        match (compensation, are_active) {
            (None, false) => Self::Nothing,
            (Some(percent), false) => Self::Compensation(percent),
            (None, true) => Self::Lines(lines),
            (Some(percent), true) => Self::CompensationAndLines(percent, lines),
        }
    }
}

/// Lines of the joints that are active, one bit per joint, and the emergency stop circuit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ActiveLines {
    /// Home switches, lower and upper limit switches.
    pub switches: [u8; 3],
    /// Drives that report an alarm, and why.
    pub alarms: Alarms,
    /// The emergency stop circuit is open.
    pub emergency_stop: bool,
}

/// Named inputs and outputs, in the order of the configuration.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct IoTelemetry {
    /// Filtered levels of the digital inputs, one bit per input; 1 is active.
    pub inputs: u16,
    /// Values of the digital outputs, one bit per output; 1 is on.
    pub outputs: u16,
    /// Codes of the analog inputs.
    pub analog_inputs: Vec<i16, ANALOG>,
    /// Codes of the analog outputs.
    pub analog_outputs: Vec<i16, ANALOG>,
}

impl Telemetry {
    /// Volumetric compensation: percent of its fade; `None` on a machine without error tables.
    pub const fn compensation(&self) -> Option<u8> {
        match self.more {
            MoreTelemetry::Compensation(percent)
            | MoreTelemetry::CompensationAndLines(percent, _) => Some(percent),
            MoreTelemetry::Nothing | MoreTelemetry::Lines(_) => None,
        }
    }

    /// The active lines.
    pub fn lines(&self) -> ActiveLines {
        match self.more {
            MoreTelemetry::Lines(lines) | MoreTelemetry::CompensationAndLines(_, lines) => lines,
            MoreTelemetry::Nothing | MoreTelemetry::Compensation(_) => ActiveLines::default(),
        }
    }

    /// Position of a rotary axis, counted on over the turns of the joint that moves it; `value` is
    /// its angle, less than half a turn from the joint's. Without turns it is the angle.
    pub fn unwound(&self, joint: Option<usize>, value: i32) -> i64 {
        let place = joint.and_then(|joint| Some((self.turns.get(joint)?, self.joints.get(joint)?)));
        place.map_or(i64::from(value), |(turns, joint)| {
            let near = (i64::from(*turns) << 32) + i64::from(*joint);
            near + i64::from(value.wrapping_sub(*joint))
        })
    }
}
