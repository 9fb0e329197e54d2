//! Force control: bounds and direction of the compliant displacement.

use super::super::bench::FuzzBench;
use super::super::units::MM;
use super::{CheckResult, Checks};
use haptimill_protocol::force::EnableCondition;
use haptimill_protocol::message::State;

/// Limits of the compliant displacement, and how long each axis was pressed.
#[derive(Debug)]
pub(super) struct ComplianceRecord {
    /// Largest compliance limit that was set, in mm.
    pub limits: [f64; 3],
    /// Periods above the force setpoint, and the displacement in the first of them.
    pressed: [(u32, f64); 3],
}

impl Default for ComplianceRecord {
    fn default() -> Self {
        Self {
            limits: [64.0; 3],
            pressed: [(0, 0.0); 3],
        }
    }
}

impl Checks {
    /// Checks the compliant displacement of each axis against its limit and the true force.
    pub(super) fn check_compliance(&mut self, bench: &FuzzBench) -> CheckResult {
        let controller = bench.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let Some(force) = &machine.force else {
            return Ok(());
        };
        let on = controller.safety().drives_on();
        let state = controller.safety().state();
        let truth = bench.rig.truth();
        let (reference, commanded) = (machine.reference().pose, machine.motion.commanded().pose);
        for axis in 0..3 {
            // The reference less the commanded pose is the displacement that takes effect.
            let displaced = if on {
                f64::from(reference.0[axis].0.wrapping_sub(commanded.0[axis].0)) / MM
            } else {
                f64::from(force.displacements()[axis].length().0) / MM
            };
            if !on && displaced != 0.0 {
                violated!(
                    bench,
                    "compliance bounds",
                    "axis {axis} is displaced by {displaced} mm with the drives off"
                );
            }
            if displaced.abs() > self.compliance.limits[axis] + 0.001 {
                violated!(
                    bench,
                    "compliance bounds",
                    "axis {axis} is displaced by {displaced} mm of at most {}",
                    self.compliance.limits[axis]
                );
            }
            let settings = force.settings(axis);
            let setpoint =
                settings.map_or(0.0, |settings| f64::from(settings.setpoint.0) / 65_536.0);
            let pressed = truth.force[axis];
            let complies = force.mask() & (1 << axis) != 0
                && matches!(state, State::Run)
                && settings
                    .is_some_and(|settings| settings.enable_condition == EnableCondition::Any)
                && force.condition().is_none()
                && force.conditioner().tared()
                && self.is_fault_free(bench);
            let (periods, from) = &mut self.compliance.pressed[axis];
            if complies && pressed.abs() > setpoint + 3.0 {
                if *periods == 0 {
                    *from = displaced;
                }
                *periods += 1;
                let along = (displaced - *from) * pressed.signum();
                if *periods > 1500 && along < 0.0 && displaced * pressed.signum() < 0.0 {
                    violated!(
                        bench,
                        "compliance",
                        "axis {axis}: {pressed:.2} N, and the tool moved {along:.3} mm against it"
                    );
                }
            } else {
                *periods = 0;
            }
        }
        Ok(())
    }
}
