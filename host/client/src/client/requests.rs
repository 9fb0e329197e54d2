//! Requests and their acknowledgements.

use super::{LineHealth, RequestError, Ticket};
use haptimill_protocol::link::HostLink;
use haptimill_protocol::message::{Command, Refusal, Request};
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
}

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

impl Requests {
    fn ticket(&mut self) -> Ticket {
        self.tickets += 1;
        Ticket(self.tickets)
    }

    /// Queues a request with an acknowledgement.
    pub(super) fn ask(&mut self, command: Command) -> Ticket {
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

    /// Takes an acknowledgement, and returns its request.
    pub(super) fn answered(
        &mut self,
        id: u8,
        result: Result<(), Refusal>,
    ) -> Option<(Ticket, Command)> {
        let index = self.asked.iter().position(|asked| asked.id == id)?;
        let asked = self.asked.remove(index);
        let name = asked.command.name();
        self.done
            .push_back((asked.ticket, name, result.map_err(RequestError::Refused)));
        Some((asked.ticket, asked.command))
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
