//! Orders of the operator.

use super::{FRESH_US, Report, Teleop};
use crate::outcome::Ended;
use crate::script::{Order, OrderInput, scale};
use haptimill_client::session::JobLine;
use haptimill_protocol::message::{Command, State};

impl<L: JobLine> Teleop<'_, L> {
    pub(super) fn process_input(&mut self, input: OrderInput, report: &mut Report<'_>) {
        match input {
            OrderInput::Order(order) => self.execute(order, report),
            OrderInput::Invalid(why) => self.refuse(why, report),
            OrderInput::Lost(error) => {
                let what = format!("orders cannot be read any more: {error}; the machine stops");
                self.outcome.because = Some(what.clone());
                self.note(what, report);
                self.execute(Order::Stop, report);
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

    pub(super) fn execute(&mut self, order: Order, report: &mut Report<'_>) {
        match order {
            Order::Hold => self.request(Command::Hold, "hold"),
            Order::ResetMaster => self.master.reset(),
            Order::Stop => {
                self.is_ending = true;
                self.outcome.ended = Ended::Stopped;
                self.request(Command::Stop, "stop");
            }
            Order::End if self.is_ending => {}
            Order::End => {
                self.is_ending = true;
                self.is_ended_by_order = true;
                if self.state == State::Run {
                    let count = self.setpoints;
                    self.request(Command::JobEnd { count }, "end");
                    // The last sample has the enabling switch released.
                    self.send_sample();
                } else {
                    self.request(Command::Stop, "end");
                }
            }
            Order::Scale(commanded) => match scale(commanded) {
                Ok(scale) => self.request(Command::PositionScale { scale }, "gp"),
                Err(why) => self.refuse(why, report),
            },
            Order::Resume => {
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
        self.outcome.refused.push(why);
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
