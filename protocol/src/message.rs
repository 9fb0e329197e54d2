//! The messages: what host and controller say to each other.
//!
//! Coordinates on the wire are `i32` in *axis units*: 2^-20 mm for a linear axis, 2^-32 turn for a rotary one. Rates are
//! axis units per second divided by 2^[`RATE_SHIFT`]. Times are counts of the controller's own periods.
//!
//! Misuse: a message says nothing of its own integrity. Only bytes that came through [`crate::link`] may be decoded here.

mod problem;

pub use problem::{
    ConfigField, ConfigProblem, Fault, HomingProblem, InputProblem, PoseError, Refusal,
};

use crate::force::{ForceLoop, ForceTelemetry, TareRefusal};
use crate::haptic::{COMPONENTS, Hand, HandProblem, HandTelemetry, Reflection, Wall};
use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// The most axes (pose coordinates, or joints) a machine can have.
pub const MAX_AXES: usize = 6;

/// Version of this protocol; both ends must have the same.
pub const PROTOCOL_VERSION: u16 = 4;

/// A rate on the wire is in axis units per second divided by 2^8: 2^-12 mm/s, or 2^-24 turn/s.
pub const RATE_SHIFT: u32 = 8;

/// The most bytes of configuration in one [`Command::Configure`].
pub const CONFIG_CHUNK: usize = 64;

/// The most setpoints in one [`Command::Setpoints`].
pub const SETPOINT_BATCH: usize = 4;

/// One value for each axis of the machine, in axis units.
pub type AxisValues = Vec<i32, MAX_AXES>;

/// First words of a session, host to controller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// The host's [`PROTOCOL_VERSION`].
    pub version: u16,
    /// The host's [`schema_hash`](crate::schema::schema_hash).
    pub schema: u64,
    /// Chosen by the host, different for each session; frames of another session are not heard.
    pub session: u32,
}

/// The controller's answer to [`Hello`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Welcome {
    /// The controller's [`PROTOCOL_VERSION`].
    pub version: u16,
    /// The controller's [`schema_hash`](crate::schema::schema_hash).
    pub schema: u64,
    /// The session that is answered.
    pub session: u32,
    /// Why the session is refused, if it is.
    pub refused: Option<HelloRefusal>,
    /// Name of the machine in the active configuration; empty when there is none.
    pub machine: String<24>,
    /// CRC-32 of the active configuration as sent by [`Command::Configure`]; 0 when there is none.
    pub config_crc: u32,
    /// Length of the control period in microseconds.
    pub period_us: u16,
    /// Pose coordinates of the machine; 0 when not configured.
    pub axes: u8,
    /// Setpoints that the queue holds.
    pub queue: u16,
}

/// Why a session is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HelloRefusal {
    /// Another session is alive and the machine moves or may move.
    Busy,
    /// Versions differ.
    Version,
    /// Versions agree and the message schemas do not.
    Schema,
}

/// What the host asks, with a number that the answer repeats.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Request {
    /// Repeated in [`Report::Answer`]; 0 asks for no answer unless the command is refused.
    pub id: u8,
    /// What is asked.
    pub command: Command,
}

/// What the host can ask.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// Setpoints of the running job, coded by [`crate::setpoint`].
    Setpoints(SetpointBatch),
    /// Nothing but a sign of life.
    Ping,
    /// A piece of a new configuration; staged only.
    Configure(ConfigChunk),
    /// Check the staged configuration and make it the active one (drives off only).
    Activate {
        /// Length of the whole configuration in bytes.
        length: u16,
        /// CRC-32 (ISO-HDLC) of the whole configuration.
        crc: u32,
        /// The joints stand at their presets, set up by hand: count from there. Otherwise what is known of the position is kept, or given up
        /// if the new configuration counts differently. The first configuration after power-on counts from the presets, where the
        /// joints stood at power-on; what was counted since then is added.
        at_preset: bool,
    },
    /// Drives on: wanted becomes measured, nothing moves. Answered when the step motors have locked, within a second.
    Enable,
    /// Drives off, from standstill.
    Disable,
    /// Find the reference of all axes, as one transaction.
    Home,
    /// Clear a latched fault or emergency stop.
    Reset,
    /// Begin a job at the pose at which the machine stands.
    JobStart {
        /// The host's number of the job; repeated in reports.
        job: u32,
        /// Start pose; must equal the wanted pose of the controller (see [`Telemetry::wanted`]) to the last bit.
        pose: AxisValues,
    },
    /// No more setpoints: the job ends with the one before `count`.
    JobEnd {
        /// How many setpoints the job has.
        count: u32,
    },
    /// Slow down along the path and wait; position kept.
    Hold,
    /// Go on after [`Command::Hold`], a pause or an underrun stop.
    Resume,
    /// Slow down along the path, then drop the job; position kept.
    Stop,
    /// Drives off now, brakes on; latched.
    EmergencyStop,
    /// Move at a rate until the deadline; each new one replaces the one before.
    Jog {
        /// Only the newest epoch of the session is heard; [`Command::JogCancel`], and any stop or hold, ends an epoch for good.
        epoch: u16,
        /// Dead-man: the machine stops this long after the command was heard, 1 to 1000 ms.
        deadline_ms: u16,
        /// Rate of each pose coordinate (see [`RATE_SHIFT`]).
        rates: AxisValues,
    },
    /// Stop jogging; every [`Command::Jog`] of this epoch or an older one is dropped, whenever it arrives.
    JogCancel {
        /// The epoch that ends.
        epoch: u16,
    },
    /// Where one pose coordinate takes its wanted value from.
    Source {
        /// Index of the pose coordinate.
        axis: u8,
        /// The new source.
        source: Source,
    },
    /// Speed along the path in percent of the programmed one, 1 to 100.
    Override {
        /// Percent.
        percent: u8,
    },
    /// Telemetry every so many periods; 0 switches it off.
    Telemetry {
        /// Periods between two frames.
        every: u16,
    },
    /// One telemetry frame now.
    Status,
    /// Which axes are under force control. One that is taken out returns to the desired position at f_d / K_V.
    ForceMask {
        /// Bit 0 for x, 1 for y, 2 for z of the work.
        mask: u8,
    },
    /// Other settings of the force loop of one axis; in force some periods later, without a jump of the tool.
    ForceLoop {
        /// The component: 0 for x, 1 for y, 2 for z of the work.
        axis: u8,
        /// The settings.
        settings: ForceLoop,
    },
    /// Take what the force sensor shows now as its zero. Answered when it has begun; [`Event::Tared`] or [`Event::TareRefused`] tells how it ended.
    Tare,
    /// Where a hand is that leads the tool from afar. A latest value: each one replaces the one before, and a lost one is not sent again.
    Hand {
        /// Only the newest epoch of the session is heard; any stop or hold ends an epoch for good, as with [`Command::Jog`].
        epoch: u16,
        /// How old it was when it was sent, in milliseconds.
        age_ms: u8,
        /// The hand.
        hand: Hand,
    },
    /// What a tool feels that a hand leads from here: forces on it along x, y, z, 2^-6 N. A latest value.
    Feel {
        /// The forces.
        force: [i16; COMPONENTS],
    },
    /// What part of the force on the tool the hand feels, from now on; approached within a second.
    Reflect(Reflection),
    /// A virtual wall: a face of the box in which the hand is kept.
    Wall {
        /// The component.
        axis: u8,
        /// The upper face, or the lower one.
        upper: bool,
        /// The face; none takes it away.
        wall: Option<Wall>,
    },
    /// G_P: how far the tool goes for a way of the hand, 2^-12; 0.1 to 2.
    HandScale {
        /// The scale.
        scale: u16,
    },
    /// Telemetry of the hand every so many periods; 0 switches it off.
    HandTelemetry {
        /// Periods between two reports.
        every: u16,
    },
    /// Say which settings the force loop of an axis has: [`Event::ForceSettings`] comes before the answer.
    ForceSettings {
        /// The component: 0 for x, 1 for y, 2 for z of the work.
        axis: u8,
    },
}

/// A piece of the configuration.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigChunk {
    /// Where in the configuration it belongs.
    pub offset: u16,
    /// The bytes.
    pub bytes: Vec<u8, CONFIG_CHUNK>,
}

/// Consecutive setpoints of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetpointBatch {
    /// Number of the first one; the first of a job is 0.
    pub first: u32,
    /// The setpoints, each relative to the one before.
    pub items: Vec<SetpointDelta, SETPOINT_BATCH>,
}

/// A setpoint relative to what the ones before predict; see [`crate::setpoint`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetpointDelta {
    /// Periods since the setpoint before; at least 1.
    pub periods: u16,
    /// Bit `k` is set when axis `k` has residuals; an axis without one is exactly where, and as fast as, was predicted.
    pub moved: u8,
    /// For each axis with its bit set, in order: coordinate less its prediction, then rate less its prediction.
    pub residuals: Vec<i32, { 2 * MAX_AXES }>,
    /// What happens when the setpoint is reached.
    pub action: Action,
}

/// What happens when a setpoint is reached, in the same period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Action {
    /// Nothing.
    #[default]
    None,
    /// Spindle to this speed in rev/min: clockwise above 0 (M3), counter-clockwise below (M4), 0 for off (M5).
    Spindle(i16),
    /// Wait for [`Command::Resume`] (M0, M1); the setpoint must have rate zero.
    Pause,
}

/// Where a pose coordinate takes its wanted value from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Source {
    /// The queue of setpoints.
    #[default]
    Program,
    /// Jog commands.
    Jog,
    /// It stays where it is.
    Hold,
    /// The hand on a haptic arm, here or afar.
    Master,
}

/// State of the controller.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// Drives off.
    #[default]
    Disabled,
    /// Drives on, nothing to do.
    Idle,
    /// Looking for the references.
    Homing,
    /// A job runs (also while it waits for late setpoints).
    Run,
    /// A jog moves the machine, or brakes it.
    Jog,
    /// A job waits, or slows down to wait.
    Hold,
    /// A fault is latched; drives off or holding, see [`Fault`].
    Fault,
    /// Emergency stop is latched; drives off.
    EmergencyStop,
}

impl State {
    /// All states in their order; recorders and links number them by their place here.
    pub const ALL: [Self; 8] = [
        Self::Disabled,
        Self::Idle,
        Self::Homing,
        Self::Run,
        Self::Jog,
        Self::Hold,
        Self::Fault,
        Self::EmergencyStop,
    ];

    /// The place in [`State::ALL`].
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }
}

/// What the controller says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(
    clippy::large_enum_variant,
    reason = "few of them exist at a time; there is no allocator for a box"
)]
pub enum Report {
    /// The answer to a request.
    Answer {
        /// The request's number.
        id: u8,
        /// Done (or begun), or why not.
        result: Result<(), Refusal>,
    },
    /// Something happened.
    Event {
        /// The control period in which it happened.
        period: u64,
        /// What.
        event: Event,
    },
    /// How things stand.
    Telemetry(Telemetry),
    /// How the hand stands.
    Hand(HandTelemetry),
}

/// How things stand at the end of a period.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Telemetry {
    /// The control period.
    pub period: u64,
    /// State of the controller.
    pub state: State,
    /// All axes have their reference.
    pub homed: bool,
    /// The position is known to be right since homing.
    pub position_kept: bool,
    /// Setpoints with a number below this can be taken; absolute, so what is in flight cannot be counted twice.
    pub credit: u32,
    /// The setpoint that the motion is heading for.
    pub setpoint: u32,
    /// Program time of the job in control periods: it stands while the machine waits.
    pub program_periods: u32,
    /// Speed along the path, 65535 for the programmed one.
    pub path_rate: u16,
    /// Wanted pose, axis units.
    pub wanted: AxisValues,
    /// Measured pose, axis units; empty while the forward kinematics has no certified answer.
    pub measured: AxisValues,
    /// Measured joints (slides, table), axis units.
    pub joints: AxisValues,
    /// Following error of each joint, axis units.
    pub following_error: AxisValues,
    /// Drive command of each joint: DAC code, or steps emitted since enable.
    pub drive: AxisValues,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Received bytes that had to wait because a period hears 64, in all.
    pub deferred_bytes: u32,
    /// Frames refused by their check, in all.
    pub bad_frames: u32,
    /// Received bytes that the board lost for want of room, in all.
    pub lost_bytes: u32,
    /// How the forces stand; one byte on a machine without a sensor.
    pub force: Option<ForceTelemetry>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// The state changed.
    State {
        /// From.
        from: State,
        /// To.
        to: State,
        /// Whether the position is kept.
        position_kept: bool,
    },
    /// The job reached its last setpoint, at rest.
    JobDone {
        /// The host's number of the job.
        job: u32,
        /// Setpoints that were reached.
        setpoints: u32,
    },
    /// The job was dropped by a stop or a fault.
    JobDropped {
        /// The host's number of the job.
        job: u32,
        /// Setpoints that were reached.
        setpoints: u32,
    },
    /// The queue ran short and the machine slowed down along its path.
    Underrun {
        /// The setpoint that was late.
        setpoint: u32,
        /// By how many periods it came too late to keep the speed.
        late_periods: u32,
    },
    /// A pause in the program was reached; [`Command::Resume`] goes on.
    Paused {
        /// The setpoint that carried the pause.
        setpoint: u32,
    },
    /// What was moved by hand leaves the program no room to stop on the way ahead: it holds. Make room by jogging, then [`Command::Resume`].
    Blocked {
        /// The setpoint on the way to which it holds.
        setpoint: u32,
    },
    /// All axes have their reference.
    Homed,
    /// A fault was latched.
    Fault(Fault),
    /// A jog reached a soft limit and was clipped.
    JogLimited {
        /// The pose coordinate.
        axis: u8,
    },
    /// A drive was asked for more than it can give; counted, clipped.
    Saturated {
        /// The joint.
        axis: u8,
    },
    /// The force sensor has a new zero.
    Tared,
    /// The force sensor has no new zero.
    TareRefused(TareRefusal),
    /// The tool cannot yield any further: its limit, a soft limit, or where the machine can go. Told once until it can again.
    YieldLimited {
        /// The component of the force.
        axis: u8,
    },
    /// Something is wrong with the haptic arm while nothing is led by it: it is off until reset.
    Hand(HandProblem),
    /// Nothing new was heard of the hand that leads the tool: the machine slows down and holds. [`Command::Resume`] goes on from where both are then.
    HandLost {
        /// How old the newest word of it is, in milliseconds.
        age_ms: u16,
    },
    /// The hand leads where the machine cannot go; it stays in front of it. Told once until it can go on.
    HandLimited {
        /// The pose coordinate.
        axis: u8,
    },
    /// The settings of a force loop that are in force now, as they were asked for with [`Command::ForceSettings`].
    ForceSettings {
        /// The component of the force.
        axis: u8,
        /// The settings.
        settings: ForceLoop,
    },
}
