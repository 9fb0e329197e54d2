//! What a controller knows of itself in a period, for recorders: one function makes it, in this process and on a chip alike.

use crate::controller::Controller;
use crate::io::{COMPONENTS, DriveCommand, Inputs};
use crate::motion::interpolator::FULL_RATE;
#[cfg(doc)]
use crate::motion::interpolator::QUEUE;
use haptimill_protocol::message::{MAX_AXES, State};

/// Values of all axes, in axis units; those that the machine lacks are 0.
pub type Axes = [i32; MAX_AXES];

/// A configured controller after one control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Snapshot {
    /// State of the controller.
    pub state: State,
    /// All axes have their reference.
    pub homed: bool,
    /// The position is known to be right since homing.
    pub position_kept: bool,
    /// A fault is latched.
    pub fault: bool,
    /// The setpoint that the motion is heading for.
    pub setpoint: u32,
    /// Setpoints that wait in the queue, at most [`QUEUE`].
    pub queued: u16,
    /// More setpoints of the job are to come.
    pub more: bool,
    /// Speed along the path, 65535 for the programmed one.
    pub path_rate: u16,
    /// Spindle, rev/min.
    pub spindle_rpm: i16,
    /// Program time, periods times 2^32.
    pub program_time: u64,
    /// Wanted pose.
    pub commanded: Axes,
    /// Wanted joints.
    pub joints_commanded: Axes,
    /// Measured joints.
    pub joints: Axes,
    /// Following error of the joints.
    pub following_error: Axes,
    /// Drive command: DAC code, or steps emitted.
    pub drive: Axes,
    /// What is felt, on a machine with a force sensor.
    pub force: ForceSnapshot,
    /// The hand, on a machine with a haptic arm.
    pub hand: HapticSnapshot,
}

/// What the controller knows of the force on the tool; zeros on a machine without a sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ForceSnapshot {
    /// Force on the tool of largest magnitude in the last revolution of the spindle, 2^-16 N: the peak.
    pub high: [i32; COMPONENTS],
    /// The opposite end of what it was in that revolution, 2^-16 N.
    pub low: [i32; COMPONENTS],
    /// By how much the tool yields, p_c, 2^-20 mm.
    pub yielded: [i32; COMPONENTS],
}

/// What the controller knows of the hand on its haptic arm; zeros on a machine without.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HapticSnapshot {
    /// The tip, 2^-20 mm.
    pub tip: [i32; COMPONENTS],
    /// What the arm does to the hand, 2^-16 N.
    pub force: [i32; COMPONENTS],
    /// What the law of reflection alone makes of the force on the tool, 2^-16 N.
    pub reflected: [i32; COMPONENTS],
    /// What the virtual walls push, 2^-16 N.
    pub wall: [i32; COMPONENTS],
}

impl Controller {
    /// How things stand after the period of these inputs; `None` without a configuration.
    #[must_use]
    pub fn snapshot(&self, inputs: &Inputs) -> Option<Snapshot> {
        let mut snapshot = Snapshot::default();
        self.read(inputs, &mut snapshot).then_some(snapshot)
    }

    /// The same where there is a reading already, one by default or the last one of a controller; false without a configuration, and then it is as it was.
    ///
    /// Done in every period by a board whose simulator records, so it is written to be short: no list on the way, and one round over the joints.
    #[inline(always)]
    pub fn read(&self, inputs: &Inputs, snapshot: &mut Snapshot) -> bool {
        let Some(machine) = self.machine() else {
            return false;
        };
        let safety = self.safety();
        let program = &machine.motion.program;
        snapshot.state = safety.state();
        snapshot.homed = safety.homed();
        snapshot.position_kept = safety.position_kept();
        snapshot.fault = safety.fault().is_some();
        snapshot.setpoint = program.reached();
        snapshot.queued = program.queued() as u16;
        snapshot.more = !program.is_complete();
        snapshot.path_rate = (program.path_rate().clamp(0, FULL_RATE - 1) >> 16) as u16;
        snapshot.spindle_rpm = self.spindle_rpm();
        snapshot.program_time = program.program_time();
        let commanded = &machine.motion.commanded().pose.0;
        let mut joints = machine.joints();
        for (axis, commanded) in commanded.iter().enumerate() {
            // What the machine lacks is 0.
            let there = joints.next();
            let joint = there.unwrap_or_default();
            snapshot.commanded[axis] = there.map_or(0, |_| commanded.0);
            snapshot.joints_commanded[axis] = joint.commanded.0;
            snapshot.joints[axis] = joint.measured.0;
            snapshot.following_error[axis] = joint.following_error.0;
            snapshot.drive[axis] = match joint.command {
                DriveCommand::Torque(code) => i32::from(code),
                DriveCommand::Steps(_) => inputs.axes[axis].steps,
                DriveCommand::Off => 0,
            };
        }
        match &machine.force {
            Some(force) => {
                let (extremes, yielded) = (force.extremes(), force.displacements());
                for component in 0..COMPONENTS {
                    let extremes = &extremes[component];
                    snapshot.force.high[component] = extremes.peak().0;
                    snapshot.force.low[component] = extremes.other().0;
                    snapshot.force.yielded[component] = yielded[component].length().0;
                }
            }
            None => snapshot.force = ForceSnapshot::default(),
        }
        match machine.masters.arm() {
            Some(arm) => snapshot.hand = arm.snapshot(),
            // Without the feature there is never an arm, and what was zeros is zeros.
            None if cfg!(feature = "hand") => snapshot.hand = HapticSnapshot::default(),
            None => {}
        }
        true
    }
}
