//! Messages between host and controller.
//!
//! Coordinates on the wire are `i32` in *axis units*: 2^-20 mm for a linear axis, 2^-32 turn for a
//! rotary one. Rates are axis units per second divided by 2^[`RATE_SHIFT`]. Times are counts of
//! control periods.
//!
//! A message has no integrity check of its own. Callers must decode only bytes that came through
//! [`crate::link`].

mod problem;

pub use problem::{
    ConfigField, ConfigProblem, Fault, HomingProblem, InputProblem, OutputProblem, PoseError,
    Refusal,
};

use crate::force::{ForceLoop, ForceTelemetry, TareRefusal};
use crate::haptic::{
    COMPONENTS, ForceFeedback, MasterPose, MasterProblem, MasterTelemetry, VirtualFixture,
};
use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Largest number of axes (pose coordinates, or joints) of a machine.
pub const MAX_AXES: usize = 6;

/// Version of this protocol; both endpoints must have the same.
pub const PROTOCOL_VERSION: u16 = 7;

/// Path rate in reports at the programmed speed.
pub const FULL_PATH_RATE: u16 = 1 << 15;

/// Largest number of named analog inputs, and of named analog outputs.
pub const ANALOG: usize = 4;

/// A rate on the wire is in axis units per second divided by 2^8: 2^-12 mm/s, or 2^-24 turn/s.
pub const RATE_SHIFT: u32 = 8;

/// Largest number of configuration bytes in one [`Command::Configure`].
pub const CONFIG_CHUNK: usize = 64;

/// Largest number of setpoints in one [`Command::Setpoints`].
pub const SETPOINT_BATCH: usize = 4;

/// One value for each axis of the machine, in axis units.
pub type AxisValues = Vec<i32, MAX_AXES>;

/// First message of a session, from the host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// The host's [`PROTOCOL_VERSION`].
    pub version: u16,
    /// The host's [`schema_hash`](crate::schema::schema_hash).
    pub schema: u64,
    /// Session number, chosen by the host, different for each session. Frames of another session
    /// are ignored.
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
    /// Session number of the [`Hello`].
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

/// Reason why a session is refused.
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

/// A command with a number that the answer repeats.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Request {
    /// Repeated in [`Report::Answer`]. 0 asks for no answer unless the command is refused.
    pub id: u8,
    /// The command.
    pub command: Command,
}

/// Commands of the host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// Setpoints of the running job, coded by [`crate::setpoint`].
    Setpoints(SetpointBatch),
    /// No action; tests the connection.
    Ping,
    /// A piece of a new configuration. It is only staged.
    Configure(ConfigChunk),
    /// Checks the staged configuration and makes it the active one (drives off only).
    Activate {
        /// Length of the whole configuration in bytes.
        length: u16,
        /// CRC-32 (ISO-HDLC) of the whole configuration.
        crc: u32,
        /// The joints stand at their presets, set up by hand: counting starts there. If false, the
        /// position is kept, or given up if the encoder scaling of the new configuration differs.
        /// The first configuration after power-on counts from the presets, as joint positions at
        /// power-on, and adds what was counted since.
        at_preset: bool,
    },
    /// Switches the drives on. The commanded pose becomes the measured one and nothing moves. The
    /// answer comes when the step motors have locked, within a second.
    Enable,
    /// Switches the drives off, from standstill.
    Disable,
    /// Finds the reference of all axes, as one transaction.
    Home,
    /// Clears a latched fault or emergency stop.
    Reset,
    /// Starts a job at the present pose of the machine.
    JobStart {
        /// The host's number of the job; repeated in reports.
        job: u32,
        /// Start pose. It must equal the commanded pose of the controller (see
        /// [`Telemetry::commanded`]) to the last bit.
        pose: AxisValues,
    },
    /// Ends the series of setpoints: the last setpoint of the job is the one before `count`.
    JobEnd {
        /// Number of setpoints of the job.
        count: u32,
    },
    /// Decelerates along the path and waits; the position is kept.
    Hold,
    /// Continues after [`Command::Hold`], a pause or an underrun stop.
    Resume,
    /// Decelerates along the path, then drops the job; the position is kept.
    Stop,
    /// Drives off and brakes on at once; latched.
    EmergencyStop,
    /// Moves at a rate until the deadline; each jog replaces the one before.
    Jog {
        /// Epoch. Only the newest epoch of the session is accepted. [`Command::JogCancel`], and any
        /// stop or hold, ends an epoch for good.
        epoch: u16,
        /// Deadline after receipt, 1 to 1000 ms: then the machine stops.
        deadline_ms: u16,
        /// Rate of each pose coordinate (see [`RATE_SHIFT`]).
        rates: AxisValues,
    },
    /// Ends jogging: every [`Command::Jog`] of this epoch or an older one is dropped, also when it
    /// arrives later.
    JogCancel {
        /// The epoch that ends.
        epoch: u16,
    },
    /// Sets the source of one pose coordinate.
    Source {
        /// Index of the pose coordinate.
        axis: u8,
        /// The new source.
        source: Source,
    },
    /// Feed override: speed of moves at feed in percent of the programmed one, 0 to 200. Above 100
    /// the [`Pace`] of a move bounds it.
    Override {
        /// Percent.
        percent: u8,
    },
    /// Sets the interval of telemetry; 0 switches it off.
    Telemetry {
        /// Control periods between two frames.
        every: u16,
    },
    /// Requests one telemetry frame now.
    Status,
    /// Sets the axes under force control. An axis that is removed returns to the desired position
    /// at f_d / K_V.
    ForceMask {
        /// Bit 0 for x, 1 for y, 2 for z of the workpiece.
        mask: u8,
    },
    /// Changes the settings of the force loop of one axis. They take effect some periods later,
    /// without a jump of the tool.
    ForceLoop {
        /// The component: 0 for x, 1 for y, 2 for z of the workpiece.
        axis: u8,
        /// The settings.
        settings: ForceLoop,
    },
    /// Sets the zero of the force sensor from its present value. The answer comes when the tare has
    /// begun; [`Event::Tared`] or [`Event::TareRefused`] reports its end.
    Tare,
    /// Pose of a remote master that leads the tool. A last-value message: each one replaces the one
    /// before, and a lost one is not resent.
    MasterPose {
        /// Epoch. Only the newest epoch of the session is accepted. Any stop or hold ends an epoch
        /// for good, as with [`Command::Jog`].
        epoch: u16,
        /// Age of the pose when it was sent, in milliseconds.
        age_ms: u8,
        /// Pose of the master.
        pose: MasterPose,
    },
    /// Remote force on a tool that this haptic arm leads, along x, y, z, 2^-6 N. A last-value
    /// message.
    RemoteForce {
        /// The forces.
        force: [i16; COMPONENTS],
    },
    /// Sets the force feedback law: the part of the force on the tool that the operator feels. The
    /// change is complete within a second.
    ForceFeedback(ForceFeedback),
    /// Sets a virtual fixture: one face of the box around the master's tip.
    VirtualFixture {
        /// The component.
        axis: u8,
        /// True for the upper face, false for the lower one.
        upper: bool,
        /// The face; `None` removes it.
        fixture: Option<VirtualFixture>,
    },
    /// Position scale G_P: ratio of tool motion to master motion, 2^-12; 0.1 to 2.
    PositionScale {
        /// The scale.
        scale: u16,
    },
    /// Sets the interval of telemetry of the master; 0 switches it off.
    MasterTelemetry {
        /// Control periods between two reports.
        every: u16,
    },
    /// Requests the settings of the force loop of an axis: [`Event::ForceSettings`] comes before
    /// the answer.
    ForceSettings {
        /// The component: 0 for x, 1 for y, 2 for z of the workpiece.
        axis: u8,
    },
    /// Sets a digital output; refused while a fault or an emergency stop is latched.
    SetOutput {
        /// Index of the output in the configuration.
        output: u8,
        /// On or off.
        on: bool,
    },
    /// Sets an analog output; refused while a fault or an emergency stop is latched.
    SetAnalogOutput {
        /// Index of the analog output in the configuration.
        output: u8,
        /// The code.
        code: i16,
    },
    /// Arms probing, from idle: the next job or jog decelerates along its path when the input takes
    /// the level, and ends. [`Event::Probed`] reports the contact, [`Event::NoContact`] an end
    /// without it. Both end the probing; so do a fault and the drives going off.
    ArmProbe {
        /// Index of the input in the configuration: a probe or a tool setter.
        input: u8,
        /// The level that ends the motion: active for a contact, inactive for its loss.
        active: bool,
    },
    /// Switches volumetric compensation on or off; it fades within a second. It is on after the
    /// configuration, and has an effect while the machine is homed and the drives are on.
    Compensation {
        /// On or off.
        on: bool,
    },
    /// Rapid override: speed of rapid moves in percent of the programmed one, 0 to 100.
    RapidOverride {
        /// Percent.
        percent: u8,
    },
    /// Spindle override: spindle speed in percent of the programmed one, 10 to 200.
    SpindleOverride {
        /// Percent.
        percent: u8,
    },
    /// Moves a joint off the limit switch on which it stands, from disabled: alone, slowly, away
    /// from the switch, by a sixteenth of its stroke at most. The position is lost.
    /// [`Event::MovedOff`] reports the success.
    MoveOff {
        /// The joint; of a gantry, either motor.
        axis: u8,
    },
}

/// A piece of the configuration.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ConfigChunk {
    /// Offset of the piece in the configuration, bytes.
    pub offset: u16,
    /// The bytes.
    pub bytes: Vec<u8, CONFIG_CHUNK>,
}

/// Consecutive setpoints of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetpointBatch {
    /// Number of the first setpoint; the first of a job is 0.
    pub first: u32,
    /// The setpoints, each relative to its prediction from those before.
    pub items: Vec<SetpointDelta, SETPOINT_BATCH>,
}

/// A setpoint relative to its prediction; see [`crate::setpoint`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetpointDelta {
    /// Control periods since the setpoint before; at least 1.
    pub periods: u16,
    /// Bit `k` is set when axis `k` has residuals. Position and rate of an axis without residuals
    /// equal the prediction.
    pub moved: u8,
    /// For each axis with its bit set, in order: coordinate minus its prediction, then rate minus
    /// its prediction.
    pub residuals: Vec<i32, { 2 * MAX_AXES }>,
    /// Action when the setpoint is reached.
    pub action: Action,
}

/// Action when a setpoint is reached, in the same period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Action {
    /// No action.
    #[default]
    None,
    /// Sets the spindle speed in rev/min: clockwise above 0 (M3), counter-clockwise below (M4), 0
    /// for off (M5).
    Spindle(i16),
    /// Waits for [`Command::Resume`] (M0, M1); the setpoint must have rate zero.
    Pause,
    /// Sets a digital output (M7 to M9, M62 to M65).
    Output {
        /// Index of the output in the configuration.
        output: u8,
        /// On or off.
        on: bool,
    },
    /// Sets an analog output (M67, M68).
    AnalogOutput {
        /// Index of the analog output in the configuration.
        output: u8,
        /// The code.
        code: i16,
    },
    /// Sets the pace of the motion from this setpoint on.
    Pace(Pace),
}

/// Which override applies to a part of a path, and up to which factor. A job begins with
/// [`Pace::FEED`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pace(pub u8);

impl Pace {
    /// A move at feed, up to the programmed speed.
    pub const FEED: Self = Self(0);
    /// A rapid move.
    pub const RAPID: Self = Self(101);
    /// The smaller of feed and rapid override: rapid moves and moves at feed meet.
    pub const CROSSING: Self = Self(102);
    /// The programmed speed: overrides have no effect.
    pub const FIXED: Self = Self(103);
    /// Largest factor of a move at feed, percent.
    pub const MOST: u8 = 200;

    /// A move at feed, up to a factor in percent, 100 to [`Pace::MOST`].
    #[must_use]
    pub const fn feed_up_to(percent: u8) -> Self {
        let percent = if percent > Self::MOST {
            Self::MOST
        } else {
            percent
        };
        Self(percent.saturating_sub(100))
    }

    /// Whether the code is known.
    #[must_use]
    pub const fn is_valid(self) -> bool {
        self.0 <= Self::FIXED.0
    }

    /// Largest factor, percent.
    #[must_use]
    pub const fn most(self) -> u8 {
        if self.0 <= 100 { 100 + self.0 } else { 100 }
    }

    /// The factor at a feed override and a rapid override, percent.
    #[must_use]
    pub fn factor(self, feed: u8, rapid: u8) -> u8 {
        match self {
            Self::RAPID => rapid,
            Self::CROSSING => feed.min(rapid).min(100),
            Self::FIXED => 100,
            _ => feed.min(self.most()),
        }
    }
}

/// Source of the commanded value of a pose coordinate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Source {
    /// Setpoint queue.
    #[default]
    Program,
    /// Jog commands.
    Jog,
    /// The coordinate is held.
    Hold,
    /// Master: a haptic arm at this controller, or a remote master.
    Master,
}

/// State of the controller.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// Drives off.
    #[default]
    Disabled,
    /// Drives on, no motion.
    Idle,
    /// Homing: search for the references.
    Homing,
    /// A job runs (also while it waits for late setpoints).
    Run,
    /// A jog moves or decelerates the machine.
    Jog,
    /// A job waits, or decelerates to wait.
    Hold,
    /// A fault is latched; drives off or holding, see [`Fault`].
    Fault,
    /// Emergency stop is latched; drives off.
    EmergencyStop,
}

impl State {
    /// All states in order. Recorders and links number a state by its index here.
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

    /// Whether the drives are off. In a fault they may be off, too: that depends on the fault.
    #[must_use]
    pub const fn has_drives_off(self) -> bool {
        matches!(self, Self::Disabled | Self::EmergencyStop)
    }

    /// Returns the index in [`State::ALL`].
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }
}

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
    /// All axes have their reference.
    pub homed: bool,
    /// The position is known to be right since homing.
    pub position_kept: bool,
    /// Setpoints with a number below this can be accepted. The number is absolute, so setpoints
    /// under way cannot be counted twice.
    pub credit: u32,
    /// Setpoint that the motion is heading for.
    pub setpoint: u32,
    /// Program time of the job in control periods; it does not advance while the machine waits.
    pub program_periods: u32,
    /// Path rate, [`FULL_PATH_RATE`] for the programmed speed.
    pub path_rate: u16,
    /// Commanded pose, axis units.
    pub commanded: AxisValues,
    /// Measured pose, axis units; empty while the forward kinematics has no certified answer.
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
    /// Volumetric compensation: percent of its fade, 100 where it is in full effect. `None` on a
    /// machine without error tables, which takes one byte.
    pub compensation: Option<u8>,
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
    /// The job reached its last setpoint, at standstill.
    JobDone {
        /// The host's number of the job.
        job: u32,
        /// Number of setpoints that were reached.
        setpoints: u32,
    },
    /// The job was dropped by a stop or a fault.
    JobDropped {
        /// The host's number of the job.
        job: u32,
        /// Number of setpoints that were reached.
        setpoints: u32,
    },
    /// Underrun: the queue ran short and the machine decelerated along its path.
    Underrun {
        /// The setpoint that was late.
        setpoint: u32,
        /// Control periods by which it came too late to keep the speed.
        late_periods: u32,
    },
    /// A pause of the program was reached; [`Command::Resume`] continues.
    Paused {
        /// Setpoint with the pause.
        setpoint: u32,
    },
    /// The program holds, because motion by the operator left no stopping distance on the path
    /// ahead. Make room by jogging, then use [`Command::Resume`].
    Blocked {
        /// Setpoint that the motion was heading for.
        setpoint: u32,
    },
    /// All axes have their reference.
    Homed,
    /// Homing found the switch of a joint at another place than the controller had it, while the
    /// position was kept: steps were lost, or the switch moved. Comes before [`Event::Homed`].
    ReferenceShift {
        /// The joint.
        axis: u8,
        /// Coordinate by the switch minus coordinate before, axis units.
        by: i32,
    },
    /// Homing squared the two motors of a gantry. Comes before [`Event::Homed`].
    Squared {
        /// The joint of the second motor.
        axis: u8,
        /// Distance by which the second motor was moved farther than the first one, axis units.
        by: i32,
    },
    /// A fault was latched.
    Fault(Fault),
    /// A jog reached a soft limit, a stroke or the edge of the workspace, and ends.
    JogLimited {
        /// The pose coordinate.
        axis: u8,
    },
    /// A drive command exceeded its limit; it was limited and counted.
    Saturated {
        /// The joint.
        axis: u8,
    },
    /// The force sensor has a new zero.
    Tared,
    /// The tare was refused; the force sensor keeps its zero.
    TareRefused(TareRefusal),
    /// The compliant displacement reached its limit, a soft limit, or the limit of the workspace.
    /// Reported once until the tool can yield again.
    ComplianceLimited {
        /// The component of the force.
        axis: u8,
    },
    /// A problem of the haptic arm while it leads no tool: it is off until reset.
    Master(MasterProblem),
    /// No new master pose arrived: the machine decelerates and holds. [`Command::Resume`] continues
    /// from the poses of master and tool at that time.
    MasterLost {
        /// Age of the newest master pose, in milliseconds.
        age_ms: u16,
    },
    /// The master leads the tool beyond a limit of the machine; the tool stays at the limit.
    /// Reported once until the tool can follow again.
    MasterLimited {
        /// The pose coordinate.
        axis: u8,
    },
    /// Settings of a force loop in effect, as requested with [`Command::ForceSettings`].
    ForceSettings {
        /// The component of the force.
        axis: u8,
        /// The settings.
        settings: ForceLoop,
    },
    /// Position of an axis in the period in which the probe took its level. One event per axis
    /// comes directly before [`Event::Probed`].
    ProbedAt {
        /// The pose coordinate, and the joint with that number.
        axis: u8,
        /// Measured pose coordinate, axis units.
        measured: i32,
        /// Commanded pose coordinate, axis units.
        commanded: i32,
        /// Measured joint, axis units.
        joint: i32,
    },
    /// The armed probe took its level: the machine decelerates along its path, and the job or jog
    /// ends.
    Probed {
        /// The input.
        input: u8,
        /// Control period in which the level changed.
        period: u64,
        /// The forward kinematics certified the measured pose; otherwise the commanded pose stands
        /// in its place.
        is_measured: bool,
    },
    /// The motion for which a probe was armed ended without a contact.
    NoContact {
        /// The input.
        input: u8,
    },
    /// A probe had a contact in motion while no probing was armed; the machine file makes this a
    /// warning.
    ProbeContact {
        /// The input.
        input: u8,
    },
    /// An input holds the job, or stops jog or homing: a feed hold or an open door.
    InputHold {
        /// The input.
        input: u8,
    },
    /// Outputs went to their safe values: a fault, an emergency stop, or a silent host.
    OutputsSafe,
    /// An action of the job could not set an output; the job is dropped.
    OutputRefused {
        /// The output.
        output: u8,
        /// The reason.
        problem: OutputProblem,
    },
    /// A joint is at rest off the limit switch on which it stood.
    MovedOff {
        /// The joint.
        axis: u8,
    },
}
