//! Answers: each request is answered once and in order, and stale jogs are refused.

use super::super::bench::{FuzzBench, name};
use super::super::units::MM;
use super::{Cause, CheckResult, Checks, bounds};
use haptimill_protocol::message::{Command, Refusal};

/// Newest jog epoch according to the answers.
///
/// The controller may know a newer one: a jog that is stale here is stale for certain.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct JogEpoch {
    newest: Option<u16>,
    cancelled: bool,
}

impl JogEpoch {
    /// Returns by how much an epoch is older than the newest one; negative for a newer one.
    fn age(self, epoch: u16) -> i16 {
        self.newest
            .map_or(-1, |newest| newest.wrapping_sub(epoch) as i16)
    }

    const fn take(&mut self, epoch: u16, cancelled: bool) {
        *self = Self {
            newest: Some(epoch),
            cancelled,
        };
    }
}

impl Checks {
    /// Checks the answers of this period and the oldest unanswered request.
    pub(super) fn check_answers(&mut self, bench: &mut FuzzBench) -> CheckResult {
        if let Some(text) = bench.unexpected_answer.take()
            && bench.period > bench.session_start + 300
        {
            violated!(bench, "answers", "{text}");
        }
        for answer in core::mem::take(&mut bench.answers) {
            match answer.result {
                Ok(()) => self.check_accepted(bench, &answer.command)?,
                Err(refusal) if matches!(answer.command, Command::Setpoints(_)) => {
                    let wrong = matches!(
                        refusal,
                        Refusal::OutOfOrder { .. } | Refusal::QueueFull | Refusal::CoordinateCount
                    );
                    if wrong
                        && self.theme.is_healthy()
                        && self.is_fault_free(bench)
                        && !self.job.altered
                    {
                        violated!(bench, "setpoint refused", "{refusal:?}");
                    }
                    self.job.altered = true;
                }
                Err(_) => {}
            }
        }
        self.check_oldest_request(bench)
    }

    fn check_accepted(&mut self, bench: &FuzzBench, command: &Command) -> CheckResult {
        match command {
            Command::Jog {
                epoch, timeout_ms, ..
            } => {
                let age = self.jog_epoch.age(*epoch);
                if age > 0 || (age == 0 && self.jog_epoch.cancelled) {
                    violated!(
                        bench,
                        "stale jog",
                        "a jog of epoch {epoch} was accepted; newest {:?}, cancelled {}",
                        self.jog_epoch.newest,
                        self.jog_epoch.cancelled
                    );
                }
                self.jog_epoch.take(*epoch, false);
                if !(1..=1000).contains(timeout_ms) {
                    violated!(bench, "range", "a jog for {timeout_ms} ms was accepted");
                }
                let until = bench.period + u64::from(*timeout_ms) * 5;
                self.timeouts.jog_until = self.timeouts.jog_until.max(until);
            }
            Command::JogCancel { epoch } if self.jog_epoch.age(*epoch) <= 0 => {
                self.jog_epoch.take(*epoch, true);
            }
            Command::Tare => self.causes.retain(|cause| *cause != Cause::SensorNotTared),
            Command::Hold => self.jog_epoch.cancelled = true,
            Command::Override { percent } => {
                if *percent > 200 {
                    violated!(bench, "range", "an override of {percent} % was accepted");
                }
                self.timeouts.percent = *percent;
                self.timeouts.settled = 0;
            }
            Command::SpindleOverride { percent } => {
                if !(10..=200).contains(percent) {
                    violated!(
                        bench,
                        "range",
                        "a spindle override of {percent} % was accepted"
                    );
                }
                self.timeouts.spindle_percent = *percent;
            }
            Command::ForceLoop { axis, settings } => {
                if let Some(limit) = self.compliance.limits.get_mut(usize::from(*axis)) {
                    *limit = limit.max(f64::from(settings.limit) / MM);
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Checks that a request is answered in time on a clean line with little under way.
    fn check_oldest_request(&self, bench: &FuzzBench) -> CheckResult {
        let quick = bench.rig.to_machine().in_flight() < 200;
        if self.theme.has_clean_line()
            && quick
            && bench.away_since.is_none()
            && !bench.corrupted
            && let Some(oldest) = bench.pending.front()
            && bench.period > oldest.sent + bounds::ANSWER
            && bench.period > bench.session_start + bounds::ANSWER
            && !self.causes.contains(&Cause::HostSilent)
            && !self.causes.contains(&Cause::MissedPeriods)
        {
            violated!(
                bench,
                "no answer",
                "{} of period {} was not answered",
                name(&oldest.command),
                oldest.sent
            );
        }
        Ok(())
    }
}
