//! Commands of the operator.

use super::{FRESH_US, Report, Teleop};
use crate::outcome::Ended;
use crate::script::{CommandInput, OperatorCommand, scale};
use haptimill_client::session::JobLine;
use haptimill_protocol::message::{Command, State};

/// Refusals that the outcome lists at most.
const MAX_REFUSED: usize = 1000;

/// Commands of an input that are executed between two steps of the session at most.
pub(super) const MAX_AT_ONCE: usize = 16;

impl<L: JobLine> Teleop<'_, L> {
    pub(super) fn process_input(&mut self, input: CommandInput, report: &mut Report<'_>) {
        match input {
            CommandInput::Command(command) => self.execute(command, report),
            CommandInput::Invalid(why) => self.refuse(why, report),
            CommandInput::Lost(error) => {
                let what = format!("commands cannot be read any more: {error}; the machine stops");
                self.outcome.because = Some(what.clone());
                self.note(what, report);
                self.execute(OperatorCommand::Stop, report);
            }
        }
    }

    pub(super) fn note(&mut self, what: String, report: &mut Report<'_>) {
        report(None, Some(&what));
        self.outcome.notes.push(what);
    }

    fn request(&mut self, command: Command, name: &str) {
        let ticket = self.session.client_mut().request(command);
        self.pending.push((ticket, name.to_string()));
    }

    pub(super) fn execute(&mut self, command: OperatorCommand, report: &mut Report<'_>) {
        match command {
            OperatorCommand::Hold => self.request(Command::Hold, "hold"),
            OperatorCommand::ResetMaster => self.master.reset(),
            OperatorCommand::Stop => {
                self.is_ending = true;
                self.outcome.ended = Ended::Stopped;
                self.request(Command::Stop, "stop");
            }
            OperatorCommand::End if self.is_ending => {}
            OperatorCommand::End => {
                self.is_ending = true;
                self.is_ended_by_command = true;
                if self.state == State::Run {
                    let count = self.setpoints;
                    self.request(Command::JobEnd { count }, "end");
                    // The last sample has the enabling switch released.
                    self.send_sample();
                } else {
                    self.request(Command::Stop, "end");
                }
            }
            OperatorCommand::Scale(commanded) => match scale(commanded) {
                Ok(scale) => self.request(Command::PositionScale { scale }, "gp"),
                Err(why) => self.refuse(why, report),
            },
            OperatorCommand::Resume => {
                let now_us = self.session.now_us();
                let is_fresh = self
                    .sampled_us
                    .is_some_and(|at| now_us.saturating_sub(at) < FRESH_US);
                let status = self.master.status();
                if let Some(reason) = status.reason() {
                    self.refuse(format!("not resumed: master: {reason}"), report);
                } else if !is_fresh {
                    let what = "not resumed: no sample of the master is received";
                    self.refuse(what.to_string(), report);
                } else {
                    // Samples of before the hold that still arrive are rejected.
                    self.session.client_mut().begin_master_epoch();
                    self.request(Command::Resume, "resume");
                }
            }
        }
    }

    fn refuse(&mut self, why: String, report: &mut Report<'_>) {
        report(None, Some(&why));
        match self.outcome.refused.len() {
            ..MAX_REFUSED => self.outcome.refused.push(why),
            MAX_REFUSED => self.outcome.refused.push("more are left out".to_string()),
            _ => {}
        }
    }

    pub(super) fn process_acknowledgements(&mut self, report: &mut Report<'_>) {
        let mut refused = Vec::new();
        let session = &mut *self.session;
        self.pending
            .retain(|(ticket, name)| match session.answer(*ticket) {
                None => true,
                Some(Ok(())) => false,
                Some(Err(error)) => {
                    refused.push(format!("{name}: {}", error.message));
                    false
                }
            });
        // A sample that arrives after the machine began to hold is refused as intended.
        if let Some(why) = session.refusal()
            && self.state == State::Run
            && !self.is_ending
            && !self.outcome.notes.contains(&why)
        {
            self.outcome.notes.push(why);
        }
        for why in refused {
            self.refuse(why, report);
        }
    }
}
