//! Requests and commands of the host.

use super::{AxisValues, CONFIG_CHUNK, SetpointBatch};
use crate::force::ForceLoop;
use crate::haptic::{COMPONENTS, ForceFeedback, MasterPose, VirtualFixture};
use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A command with a number that the answer repeats.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Request {
    /// Repeated in [`Report::Answer`]. 0 asks for no answer unless the command is refused.
    ///
    /// [`Report::Answer`]: super::Report::Answer
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
    /// Keeps the active configuration without a supply (drives off only). It is staged again by
    /// [`Command::Configure`] before. The answer comes when it is kept, within 2 s.
    Store {
        /// Length of the whole configuration in bytes.
        length: u16,
        /// CRC-32 (ISO-HDLC) of the whole configuration; that of the active one.
        crc: u32,
    },
    /// Switches the drives on. The commanded pose becomes the measured one and nothing moves. The
    /// answer comes when the step motors have locked, within a second.
    Enable,
    /// Switches the drives off, from standstill.
    Disable,
    /// Finds the references of all joints, as one transaction.
    Home,
    /// Clears a latched fault or emergency stop.
    Reset,
    /// Starts a job at the present pose of the machine.
    JobStart {
        /// The host's number of the job; repeated in reports.
        job: u32,
        /// Start pose. It must equal the commanded pose of the controller (see
        /// [`Telemetry::commanded`]) to the last bit.
        ///
        /// [`Telemetry::commanded`]: super::Telemetry::commanded
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
    /// Decelerates along the path, then aborts the job; the position is kept.
    Stop,
    /// Drives off and brakes on at once; latched.
    EmergencyStop,
    /// Moves at a rate until the timeout; each jog replaces the one before.
    Jog {
        /// Epoch. Only the newest epoch of the session is accepted. [`Command::JogCancel`], and any
        /// stop or hold, ends an epoch for good.
        epoch: u16,
        /// Time after receipt at which the machine stops, 1 to 1000 ms.
        timeout_ms: u16,
        /// Rate of each pose coordinate (see [`RATE_SHIFT`]).
        ///
        /// [`RATE_SHIFT`]: super::RATE_SHIFT
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
        coordinate: u8,
        /// The new source.
        source: Source,
    },
    /// Feed override: speed of moves at feed in percent of the programmed one, 0 to 200. Above 100
    /// the [`OverrideMode`] of a move bounds it.
    ///
    /// [`OverrideMode`]: super::OverrideMode
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
    /// Sets the axes under force control. An axis that is removed returns to the commanded position
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
    ///
    /// [`Event::Tared`]: super::Event::Tared
    /// [`Event::TareRefused`]: super::Event::TareRefused
    Tare,
    /// Pose of a remote master that moves the tool. A last-value message: each one replaces the one
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
    /// Remote force on a tool that this haptic arm moves, along x, y, z, 2^-6 N. A last-value
    /// message.
    RemoteForce {
        /// The forces.
        force: [i16; COMPONENTS],
    },
    /// Sets the force feedback law: the part of the force on the tool that is fed back to the
    /// operator. The change is complete within a second.
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
    ///
    /// [`Event::ForceSettings`]: super::Event::ForceSettings
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
    ///
    /// [`Event::Probed`]: super::Event::Probed
    /// [`Event::NoContact`]: super::Event::NoContact
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
    ///
    /// [`Event::MovedOff`]: super::Event::MovedOff
    MoveOff {
        /// The joint; of a gantry, either motor.
        joint: u8,
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
