//! Timeouts: heartbeat, jog timeout, missed periods, hold and feed override.

use super::super::bench::{FuzzBench, name};
use super::answers::JogEpoch;
use super::{CheckResult, Checks};
use haptimill_firmware::machine::Machine;
use haptimill_protocol::message::{Command, Fault, State};

/// Counters and deadlines of the checks of this file.
#[derive(Debug)]
pub(super) struct Timeouts {
    /// The feed override that was accepted last.
    pub percent: u8,
    /// The spindle override that was accepted last.
    pub spindle_percent: u8,
    /// Periods since the speed factor should have settled.
    pub settled: u32,
    /// End of the latest accepted jog.
    pub jog_until: u64,
    /// Periods in a hold.
    hold: u32,
    /// Largest speed factor in the hold; 1 is the programmed speed.
    hold_rate: f64,
    /// Start of the newest session. With it the overrides become 100 % when nothing is active.
    session_start: u64,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            percent: 100,
            spindle_percent: 100,
            settled: 0,
            jog_until: 0,
            hold: 0,
            hold_rate: 0.0,
            session_start: u64::MAX,
        }
    }
}

impl Checks {
    /// Checks that each time limit of the configured machine holds.
    pub(super) fn check_timeouts(&mut self, bench: &FuzzBench) -> CheckResult {
        if bench.session_start + 2 > bench.period {
            self.faults.reported_state = None;
            self.jog_epoch = JogEpoch::default();
        }
        // A session also resets the overrides of a controller that has no machine yet.
        if self.timeouts.session_start != bench.session_start
            && !bench.controller().safety().active()
        {
            self.timeouts.session_start = bench.session_start;
            self.timeouts.percent = 100;
            self.timeouts.spindle_percent = 100;
            self.timeouts.settled = 0;
        }
        let Some(machine) = bench.controller().machine() else {
            return Ok(());
        };
        self.check_missed_periods(bench, machine)?;
        self.check_heartbeat(bench, machine)?;
        self.check_jog_timeout(bench)?;
        self.check_hold(bench, machine)?;
        self.check_override(bench, machine)?;
        Ok(())
    }

    fn check_missed_periods(&self, bench: &FuzzBench, machine: &Machine) -> CheckResult {
        let safety = bench.controller().safety();
        let state = safety.state();
        let limit = machine.config.supervision.missed_periods;
        if bench.rig.inputs().missed >= limit
            && self.previous.drives_on
            && state != State::EmergencyStop
            && safety.pending().is_none()
            && safety.fault().is_none()
        {
            violated!(
                bench,
                "missed periods",
                "{} were missed and nothing stops the machine in {state:?}",
                bench.rig.inputs().missed
            );
        }
        Ok(())
    }

    fn check_heartbeat(&self, bench: &FuzzBench, machine: &Machine) -> CheckResult {
        let safety = bench.controller().safety();
        let state = safety.state();
        let moving = matches!(state, State::Run | State::Jog | State::Hold | State::Homing);
        if let Some(since) = bench.away_since {
            let silent = bench.period - since;
            let heartbeat = u64::from(machine.config.supervision.heartbeat_ms) * 5;
            // Bytes under way, bytes in the receive ring, and the last keep-alive frame add to it.
            if silent > heartbeat + 600 && moving && safety.pending().is_none() {
                violated!(
                    bench,
                    "lost host",
                    "{state:?} after {silent} periods of silence"
                );
            }
            if silent > heartbeat + 600 + 15_000 && moving && !self.foreign_configuration {
                violated!(bench, "lost host", "{state:?} long after the host was lost");
            }
        }
        Ok(())
    }

    fn check_jog_timeout(&mut self, bench: &FuzzBench) -> CheckResult {
        // The controller may have accepted jogs of an abandoned session without an answer.
        for request in &bench.abandoned {
            if let Command::Jog { timeout_ms, .. } = request.command {
                let until = bench.period + u64::from(timeout_ms.min(1000)) * 5;
                self.timeouts.jog_until = self.timeouts.jog_until.max(until);
            }
        }
        let state = bench.controller().safety().state();
        if state == State::Jog
            && bench.period > self.timeouts.jog_until + 12_500
            && !bench
                .pending
                .iter()
                .any(|pending| name(&pending.command) == "Jog")
            && !self.foreign_configuration
        {
            violated!(
                bench,
                "jog timeout",
                "still jogging {} periods after the last timeout",
                bench.period - self.timeouts.jog_until
            );
        }
        Ok(())
    }

    /// Checks that the path is at standstill after the stopping time.
    fn check_hold(&mut self, bench: &FuzzBench, machine: &Machine) -> CheckResult {
        let safety = bench.controller().safety();
        let state = safety.state();
        self.timeouts.hold = if state == State::Hold && self.previous.state == State::Hold {
            self.timeouts.hold + 1
        } else {
            0
        };
        let rate = machine.motion.program.speed_factor();
        if self.timeouts.hold <= 1 {
            self.timeouts.hold_rate = 0.0;
        }
        let speed_factor = rate as f64 / 4_294_967_296.0;
        self.timeouts.hold_rate = self.timeouts.hold_rate.max(speed_factor);
        // The speed factor falls by 1 in the stopping time. A faster part of the path may begin at
        // 2, and an acceleration that a hold interrupts ends with the ramp.
        let stop = f64::from(machine.config.stopping.time_ms) * 5.0;
        let stop = (stop * self.timeouts.hold_rate.max(1.0)) as u32;
        let retracting = matches!(safety.pending(), Some(Fault::Force(_)));
        let is_late = self.timeouts.hold > stop + 400 && !retracting;
        if is_late && rate != 0 && !machine.motion.program.is_at_standstill() {
            violated!(
                bench,
                "hold",
                "speed factor {rate} {} periods after the hold",
                self.timeouts.hold
            );
        }
        Ok(())
    }

    /// Checks that the speed factor settles at the feed override.
    fn check_override(&mut self, bench: &FuzzBench, machine: &Machine) -> CheckResult {
        let safety = bench.controller().safety();
        let state = safety.state();
        let stop = u32::from(machine.config.stopping.time_ms) * 5;
        let program = &machine.motion.program;
        let at_standstill = program.is_at_standstill() || program.queued() == 0;
        let steady = state == State::Run
            && program.is_complete()
            && !at_standstill
            && program.underrunning().is_none()
            && safety.pending().is_none()
            && self.job.long_segments;
        self.timeouts.settled = if steady { self.timeouts.settled + 1 } else { 0 };
        if self.timeouts.settled > stop + 600
            && !self.foreign_configuration
            && self.theme.has_clean_line()
        {
            // The jobs of the fuzz test have no faster override mode.
            let expected = f64::from(self.timeouts.percent.min(100)) / 100.0;
            let actual = program.speed_factor() as f64 / 4_294_967_296.0;
            if (expected - actual).abs() > 1e-4
                && bench
                    .pending
                    .iter()
                    .all(|pending| name(&pending.command) != "Override")
                && bench.abandoned.is_empty()
            {
                violated!(
                    bench,
                    "override",
                    "speed factor {actual}, override {expected}"
                );
            }
        }
        Ok(())
    }
}
