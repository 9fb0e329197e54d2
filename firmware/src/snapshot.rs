//! State of the controller in one period, for recorders and tests. The same function fills it in
//! the simulator's process and on a chip.

use crate::controller::Controller;
pub use crate::haptics::HapticSnapshot;
use crate::io::{COMPONENTS, DriveCommand, Inputs};
#[cfg(doc)]
use crate::motion::interpolator::QUEUE;
pub use crate::named_io::IoSnapshot;
use haptimill_protocol::message::{MAX_AXES, State};

/// Values of all coordinates, or of all joints, in axis units; 0 for those that the machine lacks.
pub type Axes = [i32; MAX_AXES];

/// A configured controller after one control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Snapshot {
    /// State of the controller.
    pub state: State,
    /// All joints are homed, and their positions are known to be right.
    pub homed: bool,
    /// A fault is latched.
    pub fault: bool,
    /// Volumetric compensation is in full effect.
    pub compensated: bool,
    /// Number of the setpoint at which the present segment ends.
    pub setpoint: u32,
    /// Setpoints in the queue, at most [`QUEUE`].
    pub queued: u16,
    /// The job has setpoints that have not arrived yet.
    pub more: bool,
    /// Speed factor; 32768 is the programmed speed.
    pub speed_factor: u16,
    /// Spindle speed, rev/min.
    pub spindle_rpm: i16,
    /// Program time, in periods times 2^32.
    pub program_time: u64,
    /// Commanded pose.
    pub commanded: Axes,
    /// Commanded joint positions.
    pub joints_commanded: Axes,
    /// Measured joint positions.
    pub joints: Axes,
    /// Following error of the joints.
    pub following_error: Axes,
    /// Drive command: DAC code, or steps emitted so far.
    pub drive: Axes,
    /// Force on the tool, on a machine with a force sensor.
    pub force: ForceSnapshot,
    /// The haptic arm, on a machine that has one.
    pub haptic: HapticSnapshot,
    /// Named inputs and outputs.
    pub io: IoSnapshot,
}

/// Force on the tool and compliant displacement; zeros on a machine without a force sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ForceSnapshot {
    /// Peak force: the force of largest magnitude in the last spindle revolution, 2^-16 N.
    pub high: [i32; COMPONENTS],
    /// The opposite extreme of the force in that revolution, 2^-16 N.
    pub low: [i32; COMPONENTS],
    /// Compliant displacement p_c, 2^-20 mm.
    pub displacement: [i32; COMPONENTS],
}

impl Controller {
    /// State after the period of these inputs; `None` without a configuration.
    #[must_use]
    pub fn snapshot(&self, inputs: &Inputs) -> Option<Snapshot> {
        let mut snapshot = Snapshot::default();
        self.read(inputs, &mut snapshot).then_some(snapshot)
    }

    /// Overwrites `snapshot`, which is a default one or the last one of a controller. Returns false
    /// and leaves it unchanged without a configuration.
    ///
    /// A board whose simulator records calls this every period. The code therefore builds no
    /// intermediate list and visits the joints once.
    #[inline(always)]
    pub fn read(&self, inputs: &Inputs, snapshot: &mut Snapshot) -> bool {
        let Some(machine) = self.machine() else {
            return false;
        };
        let safety = self.safety();
        let program = &machine.motion.program;
        snapshot.state = safety.state();
        snapshot.homed = safety.homed();
        snapshot.fault = safety.fault().is_some();
        let compensation = machine.compensation.as_ref();
        snapshot.compensated = compensation.is_some_and(|it| it.is_complete());
        snapshot.setpoint = program.reached();
        snapshot.queued = program.queued() as u16;
        snapshot.more = !program.is_complete();
        snapshot.speed_factor = (program.speed_factor() >> 17).clamp(0, 0xFFFF) as u16;
        snapshot.spindle_rpm = self.spindle_rpm();
        snapshot.program_time = program.program_time();
        let commanded = &machine.motion.commanded().pose.0;
        let mut joints = machine.joints();
        for (index, commanded) in commanded.iter().enumerate() {
            // A coordinate or joint that the machine lacks is 0.
            let joint_snapshot = joints.next();
            let joint = joint_snapshot.unwrap_or_default();
            snapshot.commanded[index] = joint_snapshot.map_or(0, |_| commanded.0);
            snapshot.joints_commanded[index] = joint.commanded.0;
            snapshot.joints[index] = joint.measured.0;
            snapshot.following_error[index] = joint.following_error.0;
            snapshot.drive[index] = match joint.command {
                DriveCommand::Torque(code) => i32::from(code),
                DriveCommand::Steps(_) => inputs.joints[index].steps,
                DriveCommand::Off => 0,
            };
        }
        snapshot.io = machine.io.snapshot(&machine.config.io);
        match &machine.force {
            Some(force) => {
                let (extremes, displacement) = (force.extremes(), force.displacements());
                for component in 0..COMPONENTS {
                    let extremes = &extremes[component];
                    snapshot.force.high[component] = extremes.peak().0;
                    snapshot.force.low[component] = extremes.other().0;
                    snapshot.force.displacement[component] = displacement[component].length().0;
                }
            }
            None => snapshot.force = ForceSnapshot::default(),
        }
        match machine.masters.arm() {
            Some(arm) => snapshot.haptic = arm.snapshot(),
            // Without the feature there is never an arm, so the values stay 0.
            None if cfg!(feature = "haptics") => snapshot.haptic = HapticSnapshot::default(),
            None => {}
        }
        true
    }
}
