//! Requests and their acknowledgements.

use super::{LineHealth, RequestError, Ticket};
use haptimill_protocol::link::HostLink;
use haptimill_protocol::message::{Command, InputProblem, Refusal, Request};
use std::collections::VecDeque;

/// A request that is finished.
pub(super) type Finished = (Ticket, &'static str, Result<(), RequestError>);

/// Requests that are queued, that wait for their acknowledgement, and that are finished.
#[derive(Debug, Default)]
pub(super) struct Requests {
    /// To be sent; without a ticket when a failure shows in the next request.
    queue: VecDeque<(Option<Ticket>, Command)>,
    asked: Vec<Asked>,
    done: VecDeque<Finished>,
    tickets: u64,
    last_id: u8,
    /// The enabling that is repeated.
    repeated: Option<RepeatedEnable>,
}

/// `Enable` that the controller refused because of a driver chip. The board may still be setting
/// the chip, or try it again.
#[derive(Debug)]
struct RepeatedEnable {
    ticket: Ticket,
    /// The last refusal.
    refusal: Refusal,
    /// Time of the next request; `None` while it is queued or sent.
    next_us: Option<u64>,
    /// A refusal from this time on is final.
    end_us: u64,
}

/// Longest time in which an enabling that is refused because of a driver chip is repeated,
/// microseconds. A board sets four chips within 0.3 s, and tries a silent one again every 0.1 s or
/// so.
const CHIPS_US: u64 = 1_000_000;

/// Time between two of these requests, microseconds.
const REPEAT_ENABLE_US: u64 = 20_000;

/// A request that waits for its acknowledgement.
#[derive(Debug)]
struct Asked {
    id: u8,
    ticket: Ticket,
    command: Command,
    sent_us: u64,
    by_us: u64,
}

/// Requests that wait for an acknowledgement at most: fewer than there are request numbers.
const MAX_PENDING: usize = 64;

/// Whether a command ends the repetition of an enabling: drives that the operator wants off, or
/// that another command concerns, are not switched on afterwards.
const fn ends_repetition(command: &Command) -> bool {
    matches!(
        command,
        Command::Enable
            | Command::Disable
            | Command::EmergencyStop
            | Command::Stop
            | Command::Hold
            | Command::Reset
            | Command::MoveOff { .. }
            | Command::Activate { .. }
    )
}

impl Requests {
    fn ticket(&mut self) -> Ticket {
        self.tickets += 1;
        Ticket(self.tickets)
    }

    /// Queues a request with an acknowledgement.
    pub(super) fn ask(&mut self, command: Command) -> Ticket {
        if ends_repetition(&command) {
            self.end_repetition();
        }
        let ticket = self.ticket();
        self.queue.push_back((Some(ticket), command));
        ticket
    }

    /// Queues a request without one: its failure shows in the request after it.
    pub(super) fn send_unacknowledged(&mut self, command: Command) {
        self.queue.push_back((None, command));
    }

    /// A request that is finished without being sent.
    pub(super) fn acknowledged(
        &mut self,
        command: &'static str,
        result: Result<(), RequestError>,
    ) -> Ticket {
        let ticket = self.ticket();
        self.done.push_back((ticket, command, result));
        ticket
    }

    /// Whether the queue is empty.
    pub(super) fn is_idle(&self) -> bool {
        self.queue.is_empty()
    }

    /// Passes requests to the link, as far as its window allows.
    pub(super) fn send(&mut self, link: &mut HostLink, now_us: u64, answer_us: u64) {
        if let Some(repeated) = &mut self.repeated
            && repeated.next_us.take_if(|next| now_us >= *next).is_some()
        {
            let ticket = Some(repeated.ticket);
            self.queue.push_front((ticket, Command::Enable));
        }
        while self.asked.len() < MAX_PENDING {
            let Some((ticket, command)) = self.queue.pop_front() else {
                break;
            };
            let id = if ticket.is_some() { self.free_id() } else { 0 };
            let request = Request { id, command };
            if link.send(&request).is_err() {
                self.queue.push_front((ticket, request.command));
                break;
            }
            if let Some(ticket) = ticket {
                self.last_id = id;
                let by_us = now_us.saturating_add(answer_us);
                self.asked.push(Asked {
                    id,
                    ticket,
                    command: request.command,
                    sent_us: now_us,
                    by_us,
                });
            }
        }
    }

    /// A number that no pending request has; 0 stands for no acknowledgement.
    fn free_id(&self) -> u8 {
        (1..=u8::MAX)
            .map(|step| self.last_id.wrapping_add(step))
            .find(|&id| id != 0 && self.asked.iter().all(|asked| asked.id != id))
            .unwrap_or(1)
    }

    /// Takes an acknowledgement, and returns its request. An enabling that is repeated is not
    /// finished.
    pub(super) fn answered(
        &mut self,
        id: u8,
        result: Result<(), Refusal>,
        now_us: u64,
    ) -> Option<(Ticket, Command)> {
        let index = self.asked.iter().position(|asked| asked.id == id)?;
        let asked = self.asked.remove(index);
        if asked.command == Command::Enable && self.repeats(&asked, result.err(), now_us) {
            return None;
        }
        let name = asked.command.name();
        self.done
            .push_back((asked.ticket, name, result.map_err(RequestError::Refused)));
        Some((asked.ticket, asked.command))
    }

    /// Whether an answered `Enable` is repeated: a driver chip was the reason of its refusal.
    fn repeats(&mut self, asked: &Asked, refusal: Option<Refusal>, now_us: u64) -> bool {
        let before = self.repeated.take_if(|it| it.ticket == asked.ticket);
        let end_us = before.map_or(asked.sent_us.saturating_add(CHIPS_US), |it| it.end_us);
        let Some(refusal @ Refusal::Input(InputProblem::Drive { alarm, .. })) = refusal else {
            return false;
        };
        if !alarm.is_of_chip() || now_us >= end_us {
            return false;
        }
        self.end_repetition();
        self.repeated = Some(RepeatedEnable {
            ticket: asked.ticket,
            refusal,
            next_us: Some(now_us + REPEAT_ENABLE_US),
            end_us,
        });
        true
    }

    /// The last refusal of the enabling that is repeated is final.
    fn end_repetition(&mut self) {
        let Some(mut repeated) = self.repeated.take() else {
            return;
        };
        if repeated.next_us.is_some() {
            let refused = Err(RequestError::Refused(repeated.refusal));
            let name = Command::Enable.name();
            self.done.push_back((repeated.ticket, name, refused));
        } else {
            // Its answer comes before those of later requests.
            repeated.end_us = 0;
            self.repeated = Some(repeated);
        }
    }

    /// Fails the request whose acknowledgement is overdue, if there is one.
    pub(super) fn expire(
        &mut self,
        now_us: u64,
        line: LineHealth,
    ) -> Option<(Ticket, RequestError)> {
        let index = self.asked.iter().position(|asked| now_us >= asked.by_us)?;
        let asked = self.asked.remove(index);
        let command = asked.command.name();
        let error = RequestError::NoAnswer {
            command,
            waited_us: now_us - asked.sent_us,
            line,
        };
        self.done
            .push_back((asked.ticket, command, Err(error.clone())));
        Some((asked.ticket, error))
    }

    /// Fails all requests.
    pub(super) fn fail_all(&mut self, error: &RequestError) {
        for asked in self.asked.drain(..) {
            self.done
                .push_back((asked.ticket, asked.command.name(), Err(error.clone())));
        }
        self.fail_queue(error);
    }

    /// Fails the requests that are not sent yet.
    pub(super) fn withdraw(&mut self) {
        self.fail_queue(&RequestError::Withdrawn);
    }

    fn fail_queue(&mut self, error: &RequestError) {
        if let Some(repeated) = self.repeated.take()
            && repeated.next_us.is_some()
        {
            let name = Command::Enable.name();
            self.done
                .push_back((repeated.ticket, name, Err(error.clone())));
        }
        for (ticket, command) in self.queue.drain(..) {
            if let Some(ticket) = ticket {
                self.done
                    .push_back((ticket, command.name(), Err(error.clone())));
            }
        }
    }

    /// Whether a request is sent and waits for its acknowledgement.
    pub(super) fn is_pending(&self, ticket: Ticket) -> bool {
        self.asked.iter().any(|asked| asked.ticket == ticket)
    }

    /// The requests that were finished since the last call.
    pub(super) fn take_finished(&mut self) -> impl Iterator<Item = Finished> + '_ {
        self.done.drain(..)
    }
}
