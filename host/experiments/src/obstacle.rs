//! Reasons why a machine cannot run an experiment.

use super::definition::Experiment;
use haptimill_machine_file::MachineFile;

/// Refusal of an experiment with force control.
pub const NO_FORCE_CONTROL: &str = "this machine has no force control";

/// Refusal of an experiment with teleoperation.
pub const NO_HAPTIC_ARM: &str = "this machine has no haptic arm";

impl Experiment {
    /// Why a machine cannot run it, or none if it can.
    #[must_use]
    pub fn obstacle(&self, machine: &MachineFile) -> Option<&'static str> {
        if self.needs_force_control() && machine.config.force.is_none() {
            return Some(NO_FORCE_CONTROL);
        }
        (self.needs_haptic_arm() && machine.with_haptic_arm().is_err()).then_some(NO_HAPTIC_ARM)
    }
}
