//! Telemetry: each sample is what the controller was in that period.

use super::super::bench::FuzzBench;
use super::{CheckResult, Checks};
use haptimill_protocol::message::State;
use std::collections::VecDeque;

/// State of the last 3000 periods: number, state, commanded pose, position known.
pub(super) type Samples = VecDeque<(u64, State, [i32; 6], bool)>;

impl Checks {
    /// Checks the telemetry of this period against the state of the period that it names.
    pub(super) fn check_telemetry(&mut self, bench: &FuzzBench) -> CheckResult {
        let controller = bench.controller();
        let safety = controller.safety();
        let commanded = controller.machine().map_or([0; 6], |machine| {
            machine.motion.commanded().pose.0.map(|place| place.0)
        });
        self.telemetry_samples.push_back((
            bench.rig.inputs().period,
            safety.state(),
            commanded,
            safety.homed(),
        ));
        if self.telemetry_samples.len() > 3000 {
            self.telemetry_samples.pop_front();
        }
        let Some(telemetry) = &bench.telemetry else {
            return Ok(());
        };
        let at = self
            .telemetry_samples
            .binary_search_by_key(&telemetry.period, |entry| entry.0);
        let Ok(at) = at else { return Ok(()) };
        let (period, state, commanded, known) = &self.telemetry_samples[at];
        let same = telemetry.state == *state
            && telemetry
                .commanded
                .iter()
                .zip(commanded)
                .all(|(a, b)| a == b)
            && telemetry.homed == *known;
        if !same {
            violated!(
                bench,
                "telemetry",
                "of period {period}: {telemetry:?}; it was {state:?} at {commanded:?}, position known {known}"
            );
        }
        Ok(())
    }
}
