//! Setpoints: the commanded pose of a job is the cubic through the planned setpoints.

use super::super::bench::FuzzBench;
use super::super::reference::JobSample;
use super::{Cause, CheckResult, Checks, bounds, commanded_pose};
use haptimill_firmware::named_io::config::InputFunction;
use haptimill_protocol::message::{Command, Fault, Source, State};

impl Checks {
    /// Checks the commanded pose of a job against the interpolation of its setpoints.
    pub(super) fn check_setpoints(&mut self, bench: &FuzzBench) -> CheckResult {
        let controller = bench.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let safety = controller.safety();
        if !matches!(safety.state(), State::Run | State::Hold) {
            return Ok(());
        }
        let other_source =
            (0..machine.axes()).any(|axis| machine.motion.source(axis) != Source::Program);
        if other_source || matches!(safety.pending(), Some(Fault::Force(_))) {
            self.job.comparable = false;
        }
        let program = &machine.motion.program;
        let sample = JobSample {
            time: program.program_time(),
            reached: program.reached(),
            accepted: program.accepted(),
            pose: commanded_pose(bench),
            spindle: bench.rig.outputs().spindle_rpm,
            spindle_overrides: self.spindle_overrides(bench),
        };
        let off = match self.job.check(&sample) {
            Ok(off) => off,
            Err(text) => violated!(bench, "setpoints", "{text}"),
        };
        self.record_largest("commanded pose less cubic, axis units", off);
        if off > bounds::CUBIC {
            violated!(
                bench,
                "interpolation",
                "commanded pose is {off} axis units from the setpoints' cubic"
            );
        }
        Ok(())
    }

    /// Returns the spindle overrides that may be in force: the one accepted last, and those whose
    /// answer is under way. None when a session ended before its answers, when a door may have
    /// stopped the spindle, or when an open tool clamp kept it from starting.
    fn spindle_overrides(&self, bench: &FuzzBench) -> Vec<u8> {
        let machine = bench.controller().machine();
        let has_door = machine.is_some_and(|machine| {
            let mut inputs = machine.config.io.inputs.iter();
            inputs.any(|input| matches!(input.function, InputFunction::Door { .. }))
        });
        let stopped = bench.rig.outputs().spindle_rpm == 0;
        let door = has_door && stopped && self.causes.contains(&Cause::Input);
        let clamp = stopped && self.opened_clamp;
        if door || clamp || !bench.abandoned.is_empty() {
            return Vec::new();
        }
        let pending = bench.pending.iter().filter_map(|it| match it.command {
            Command::SpindleOverride { percent } => Some(percent),
            _ => None,
        });
        std::iter::once(self.timeouts.spindle_percent)
            .chain(pending)
            .collect()
    }
}
