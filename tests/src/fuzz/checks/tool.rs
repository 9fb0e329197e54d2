//! Tool: the true pose of a healthy machine against the commanded one.

use super::super::bench::FuzzBench;
use super::super::units::kind_unit;
use super::position::is_position_known;
use super::{Cause, CheckResult, Checks, bounds, commanded_pose};
use haptimill_firmware::config::AxisKind;

impl Checks {
    /// Checks that a healthy machine of another machine file has its tool at the commanded pose.
    ///
    /// The true pose comes from the simulator's geometry, which shares no code with the firmware.
    pub(super) fn check_tool(&mut self, bench: &FuzzBench) -> CheckResult {
        let controller = bench.controller();
        let safety = controller.safety();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let undisturbed = self.is_fault_free(bench)
            && self.causes.iter().all(|cause| *cause == Cause::HostSilent);
        let known = is_position_known(bench) && self.previous.homed;
        let on = safety.drives_on() && self.previous.drives_on && !machine.is_locking();
        if !self.other_machine || !undisturbed || !known || !on {
            return Ok(());
        }
        let commanded = commanded_pose(bench);
        let rates = machine.motion.commanded().rates;
        let truth = bench.rig.truth().pose;
        for (axis, limits) in machine.config.pose.iter().enumerate() {
            let unit = kind_unit(limits.kind);
            let mut off = (truth[axis] - commanded[axis] / unit).abs();
            if limits.wraps() {
                off = off.rem_euclid(360.0).min((-off).rem_euclid(360.0));
            }
            let class = usize::from(limits.kind != AxisKind::Linear);
            let beyond = off - bounds::TOOL_LAG * f64::from(rates[axis].0).abs() / unit;
            self.record_largest(["tool mm", "tool deg"][class], beyond);
            if beyond > bounds::TOOL {
                violated!(
                    bench,
                    "tool",
                    "coordinate {axis} is at {:.4} and commanded at {:.4} in {:?}",
                    truth[axis],
                    commanded[axis] / unit,
                    safety.state()
                );
            }
        }
        Ok(())
    }
}
