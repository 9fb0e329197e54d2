//! Haptic arm: currents, and steps of the force at the handle.

use super::super::bench::FuzzBench;
use super::{CheckResult, Checks};
use haptimill_firmware::haptics::config::HapticConfig;

/// Returns the largest current code of a motor of the haptic arm.
fn largest_code(config: &HapticConfig, leg: usize, motor: usize) -> f64 {
    let drive = &config.drives[leg][motor];
    f64::from(drive.limit.0) / f64::from(drive.full_scale.0).abs() * 8192.0
}

impl Checks {
    /// Checks the currents of the haptic arm, and the step of its force in this period.
    pub(super) fn check_haptics(&mut self, bench: &FuzzBench) -> CheckResult {
        let Some(machine) = bench.controller().machine() else {
            return Ok(());
        };
        let (Some(arm), Some(config)) = (machine.masters.arm(), &machine.config.haptic) else {
            return Ok(());
        };
        let outputs = &bench.rig.outputs().haptic;
        let mut saturated = false;
        for (leg, currents) in outputs.currents.iter().enumerate() {
            for (motor, code) in currents.iter().enumerate() {
                let max = largest_code(config, leg, motor);
                let magnitude = f64::from(*code).abs();
                saturated |= magnitude > max - 2.0;
                if magnitude > max + 1.0 {
                    violated!(
                        bench,
                        "haptic current",
                        "leg {leg} motor {motor}: code {code} of at most {max}"
                    );
                }
                if *code != 0 && !outputs.enabled {
                    violated!(bench, "haptic current", "code {code} while disabled");
                }
            }
        }
        if outputs.enabled && !bench.rig.inputs().haptic.drives_ready {
            violated!(
                bench,
                "haptic current",
                "enabled, and the amplifiers are tripped"
            );
        }
        let force = arm.force().map(|force| f64::from(force.0));
        if outputs.enabled && self.previous.valid && !self.foreign_configuration {
            self.check_force_step(bench, &force, f64::from(config.step.0), saturated)?;
        }
        self.previous.haptic_force = force;
        Ok(())
    }

    /// Checks that the force changed by at most one step in each axis.
    ///
    /// A saturated motor scales the whole force by one factor below 1. So one factor of at least 1
    /// must exist that brings each axis within a step of the force before. Without saturation the
    /// factor is 1.
    fn check_force_step(
        &self,
        bench: &FuzzBench,
        force: &[f64; 3],
        step: f64,
        saturated: bool,
    ) -> CheckResult {
        let before = &self.previous.haptic_force;
        let (mut min, mut max) = (1.0_f64, if saturated { f64::INFINITY } else { 1.0 });
        for (now, was) in force.iter().zip(before) {
            // The firmware rounds the product and the factor to whole units.
            let rounding = if saturated { was.abs() / 32_768.0 } else { 0.0 };
            let slack = step + 2.0 + rounding;
            if now.abs() > 2.0 {
                let ends = [(was - slack) / now, (was + slack) / now];
                min = min.max(ends[0].min(ends[1]) - 1.0 / now.abs());
                max = max.min(ends[0].max(ends[1]) + 1.0 / now.abs());
            } else if !saturated && was.abs() > slack + 2.0 {
                max = 0.0;
            }
        }
        if min > max {
            violated!(
                bench,
                "haptic step",
                "the force went from {before:?} to {force:?} in a period; a step is {step}, \
                 motor saturated: {saturated}"
            );
        }
        Ok(())
    }
}
