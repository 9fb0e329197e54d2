//! Named inputs and outputs of a machine: conditions of a motion, actions of setpoints, telemetry.

use super::Machine;
use crate::named_io::config::InputFunction;
use crate::named_io::{NamedIo, Probing};
use haptimill_protocol::message::{Action, InputProblem, IoTelemetry, Refusal};

impl Machine {
    /// Refuses to start or resume motion: for an open door, for the armed probe if it is in contact
    /// already, and for a job (`is_job`) for an active feed hold.
    ///
    /// # Errors
    /// [`Refusal::Input`].
    pub(crate) fn check_inputs(&self, is_job: bool) -> Result<(), Refusal> {
        let config = &self.config.io;
        if config.inputs.is_empty() {
            return Ok(());
        }
        let refuse = |problem| Err(Refusal::Input(problem));
        let door = |it| matches!(it, InputFunction::Door { .. });
        if let Some(input) = self.io.active_with(config, door) {
            return refuse(InputProblem::DoorOpen { input });
        }
        let hold = |it| it == InputFunction::FeedHold;
        if is_job && let Some(input) = self.io.active_with(config, hold) {
            return refuse(InputProblem::FeedHold { input });
        }
        match self.io.probing() {
            Some(Probing { input, .. }) if self.io.is_at_contact() => {
                refuse(InputProblem::ProbeContact { input })
            }
            _ => Ok(()),
        }
    }

    /// Control periods from the restart of the spindle to the motion, after the door was open.
    pub(crate) fn run_up_periods(&self) -> u16 {
        let functions = self.config.io.inputs.iter().map(|input| input.function);
        functions
            .filter_map(|function| match function {
                InputFunction::Door { run_up } => Some(run_up),
                _ => None,
            })
            .next()
            .unwrap_or_default()
    }

    /// Checks the action of a setpoint: its output exists, and it does not follow the spindle.
    ///
    /// # Errors
    /// [`Refusal::Output`] or [`Refusal::AnalogOutput`].
    pub(crate) fn check_action(&self, action: &Action) -> Result<(), Refusal> {
        match *action {
            Action::None | Action::Spindle(_) | Action::Pause | Action::OverrideMode(_) => Ok(()),
            Action::Output { output, .. } => self.io.may_set(&self.config.io, output, 0),
            Action::AnalogOutput { output, code } => {
                NamedIo::may_set_analog(&self.config.io, output, code)
            }
        }
    }

    /// Named inputs and outputs for telemetry; `None` on a machine without any.
    pub(crate) fn io_telemetry(&self) -> Option<IoTelemetry> {
        let (io, config) = (&self.io, &self.config.io);
        (!config.is_empty()).then(|| IoTelemetry {
            inputs: io.levels(),
            outputs: io.outputs(),
            analog_inputs: (0..config.analog_inputs.len())
                .map(|input| io.analog_input(config, input))
                .collect(),
            analog_outputs: (0..config.analog_outputs.len())
                .map(|output| io.analog_output(output))
                .collect(),
        })
    }
}
