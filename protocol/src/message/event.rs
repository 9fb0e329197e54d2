//! Events that the controller reports.

use super::{Fault, OutputProblem, State};
use crate::force::{ForceLoop, TareRefusal};
use crate::haptic::MasterProblem;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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
        /// Whether the joints are homed: the position is kept.
        homed: bool,
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
    ///
    /// [`Command::Resume`]: super::Command::Resume
    Paused {
        /// Setpoint with the pause.
        setpoint: u32,
    },
    /// The program holds, because motion by the operator left no stopping distance on the path
    /// ahead. Make room by jogging, then use [`Command::Resume`].
    ///
    /// [`Command::Resume`]: super::Command::Resume
    Blocked {
        /// Setpoint that the motion was heading for.
        setpoint: u32,
    },
    /// All joints have their reference.
    Homed,
    /// Homing found the switch of a joint at another place than the controller had it, while the
    /// position was kept: steps were lost, or the switch moved. Comes before [`Event::Homed`].
    ReferenceShift {
        /// The joint.
        joint: u8,
        /// Coordinate by the switch minus coordinate before, axis units.
        by: i32,
    },
    /// Homing squared the two motors of a gantry. Comes before [`Event::Homed`].
    Squared {
        /// The joint of the second motor.
        joint: u8,
        /// Distance by which the second motor was moved farther than the first one, axis units.
        by: i32,
    },
    /// A fault was latched.
    Fault(Fault),
    /// A jog reached a soft limit, a stroke or the edge of the workspace, and ends.
    JogLimited {
        /// The pose coordinate.
        coordinate: u8,
    },
    /// A drive command exceeded its limit; it was limited and counted.
    Saturated {
        /// The joint.
        joint: u8,
    },
    /// The force sensor has a new zero.
    Tared,
    /// The tare was refused; the force sensor keeps its zero.
    TareRefused(TareRefusal),
    /// The compliant displacement reached its limit, a soft limit, or the limit of the workspace.
    /// Reported once until the tool can be displaced again.
    ComplianceLimited {
        /// The component of the force.
        axis: u8,
    },
    /// A problem of the haptic arm while it moves no tool: it is off until reset.
    Master(MasterProblem),
    /// No new master pose arrived: the machine decelerates and holds. [`Command::Resume`] continues
    /// from the poses of master and tool at that time.
    ///
    /// [`Command::Resume`]: super::Command::Resume
    MasterLost {
        /// Age of the newest master pose, in milliseconds.
        age_ms: u16,
    },
    /// The master moves the tool beyond a limit of the machine; the tool stays at the limit.
    /// Reported once until the tool can follow again.
    MasterLimited {
        /// The pose coordinate.
        coordinate: u8,
    },
    /// Settings of a force loop in effect, as requested with [`Command::ForceSettings`].
    ///
    /// [`Command::ForceSettings`]: super::Command::ForceSettings
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
        coordinate: u8,
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
        /// The forward kinematics verified the measured pose; otherwise the commanded pose stands
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
    /// An action of the job could not set an output; the job is aborted.
    OutputRefused {
        /// The output.
        output: u8,
        /// The reason.
        problem: OutputProblem,
    },
    /// A joint is at rest off the limit switch on which it stood.
    MovedOff {
        /// The joint.
        joint: u8,
    },
}
