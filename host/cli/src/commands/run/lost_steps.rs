//! Steps that the motors of the simulated machine lost. A controller without encoders cannot know
//! of them; the simulator can.

use haptimill_client::Error;
use haptimill_client::session::{JobLine, Session};
use haptimill_firmware::config::{Drive, SwitchInput};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::joint::DriveConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::per_unit;

/// Joints with step motors and without encoders.
pub(super) struct StepJoints {
    joints: Vec<StepJoint>,
}

/// A joint before the run.
struct StepJoint {
    index: usize,
    /// Half of an electrical turn of the motor, mm or degrees: a rotor that lags farther loses the
    /// whole turn.
    half_turn: f64,
    /// True less counted position, mm or degrees.
    off: f64,
}

/// True less counted position of a joint, mm or degrees; `None` on a machine that is not simulated.
fn off<L: JobLine>(session: &mut Session<L>, index: usize) -> Result<Option<f64>, Error> {
    let status = session.status()?;
    let counted = session.model().unwound_joints(&status).get(index).copied();
    let truth = session.line_mut().truth();
    Ok(counted
        .zip(truth)
        .map(|(counted, truth)| truth.joints[index] - counted))
}

impl StepJoints {
    /// The joints of a homed machine; none where it is not simulated.
    ///
    /// # Errors
    /// The session is lost.
    pub(super) fn of<L: JobLine>(
        session: &mut Session<L>,
        machine: &MachineFile,
    ) -> Result<Self, Error> {
        let mut joints = Vec::new();
        let is_simulated = session.line_mut().truth().is_some();
        let plant = is_simulated
            .then(|| machine.plant::<PlantConfig>().ok())
            .flatten();
        let simulated = plant.iter().flat_map(|plant| &plant.joint);
        for (index, (simulated, joint)) in simulated.zip(&machine.config.joints).enumerate() {
            let is_open = joint.encoder.is_none() && matches!(joint.drive, Drive::Steps { .. });
            if let DriveConfig::Steps(motor) = &simulated.drive
                && is_open
                && let Some(now) = off(session, index)?
            {
                // A joint that has just searched its switch is off by the place of the switch. What
                // it lost since then, also on the way to the home pose, is no part of that.
                let switch = simulated.home.as_ref().zip(joint.home.switch());
                let switch = switch.filter(|(_, home)| home.input == SwitchInput::Home);
                let off = switch.map_or(now, |(switch, home)| {
                    switch.at - f64::from(home.coordinate.0) / per_unit(joint.kind)
                });
                let full_step = simulated.lead / f64::from(motor.full_steps);
                joints.push(StepJoint {
                    index,
                    half_turn: f64::from(motor.phases) * full_step.abs(),
                    off,
                });
            }
        }
        Ok(Self { joints })
    }

    /// Describes the joints that lost steps since then; `None` if there are none.
    ///
    /// # Errors
    /// The session is lost.
    pub(super) fn lost<L: JobLine>(
        &self,
        session: &mut Session<L>,
        machine: &MachineFile,
    ) -> Result<Option<String>, Error> {
        let mut lost = Vec::new();
        for joint in &self.joints {
            let change = off(session, joint.index)?.unwrap_or(joint.off) - joint.off;
            if change.abs() > joint.half_turn {
                let name = &machine.joints[joint.index].name;
                let unit = session.model().joint_units()[joint.index];
                lost.push(format!("{name} is {change:+.4} {unit} off"));
            }
        }
        let what = || {
            format!(
                "steps were lost, which this controller cannot detect: {}; lower the speed, the \
                 acceleration or the load, then home again",
                lost.join(", ")
            )
        };
        Ok((!lost.is_empty()).then(what))
    }
}
