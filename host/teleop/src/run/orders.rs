//! Orders: carried out, or refused in words.

use super::{FRESH_US, Teleop};
use crate::outcome::{Ended, Row};
use crate::script::{Heard, Order, scale};
use haptimill_client::session::JobLine;
use haptimill_protocol::message::{Command, State};

impl<L: JobLine> Teleop<'_, L> {
    pub(super) fn obey(&mut self, heard: Heard, look: &mut dyn FnMut(Option<&Row>, Option<&str>)) {
        match heard {
            Heard::Order(order) => self.carry_out(order, look),
            Heard::NoOrder(why) => self.refuse(why, look),
            Heard::Lost(error) => {
                let what = format!("orders cannot be read any more: {error}; the machine stops");
                self.outcome.because = Some(what.clone());
                self.note(what, look);
                self.carry_out(Order::Stop, look);
            }
        }
    }

    pub(super) fn note(&mut self, what: String, look: &mut dyn FnMut(Option<&Row>, Option<&str>)) {
        look(None, Some(&what));
        self.outcome.notes.push(what);
    }

    pub(super) fn carry_out(
        &mut self,
        order: Order,
        look: &mut dyn FnMut(Option<&Row>, Option<&str>),
    ) {
        let ask = |command: Command, name: &str, this: &mut Self| {
            let ticket = this.session.client_mut().request(command);
            this.asked.push((ticket, name.to_string()));
        };
        match order {
            Order::Hold => ask(Command::Hold, "hold", self),
            Order::ResetHand => self.source.reset(),
            Order::Stop => {
                self.ending = true;
                self.outcome.ended = Ended::Stopped;
                ask(Command::Stop, "stop", self);
            }
            Order::End if self.ending => {}
            Order::End => {
                self.ending = true;
                self.ended_by_order = true;
                if self.state == State::Run {
                    let count = self.setpoints;
                    ask(Command::JobEnd { count }, "end", self);
                    // The last word: the hand has let go.
                    self.tell();
                } else {
                    ask(Command::Stop, "end", self);
                }
            }
            Order::Scale(commanded) => match scale(commanded) {
                Ok(scale) => ask(Command::PositionScale { scale }, "gp", self),
                Err(why) => self.refuse(why, look),
            },
            Order::Resume => {
                let now_us = self.session.now_us();
                let fresh = self
                    .word_us
                    .is_some_and(|at| now_us.saturating_sub(at) < FRESH_US);
                let standing = self.source.standing();
                if let Some(why) = standing.why() {
                    self.refuse(format!("not resumed: the hand: {why}"), look);
                } else if !fresh {
                    self.refuse("not resumed: the hand is not heard".to_string(), look);
                } else {
                    // What is still under way of before is not heard any more.
                    self.session.client_mut().lead_anew();
                    ask(Command::Resume, "resume", self);
                }
            }
        }
    }

    fn refuse(&mut self, why: String, look: &mut dyn FnMut(Option<&Row>, Option<&str>)) {
        look(None, Some(&why));
        self.outcome.refused.push(why);
    }

    pub(super) fn hear_answers(&mut self, look: &mut dyn FnMut(Option<&Row>, Option<&str>)) {
        let mut refused = Vec::new();
        let session = &mut *self.session;
        self.asked
            .retain(|(ticket, name)| match session.answer(*ticket) {
                None => true,
                Some(Ok(())) => false,
                Some(Err(error)) => {
                    refused.push(format!("{name}: {}", error.message));
                    false
                }
            });
        // A word that was under way when the machine began to hold is refused, as it should be.
        if let Some(why) = session.refusal()
            && self.state == State::Run
            && !self.ending
            && !self.outcome.notes.contains(&why)
        {
            self.outcome.notes.push(why);
        }
        for why in refused {
            self.refuse(why, look);
        }
    }
}
