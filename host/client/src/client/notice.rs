//! What a client is told, and what it tells.

use super::{ClientError, JobEnding, RequestError};
use haptimill_protocol::link::Timing;
use haptimill_protocol::message::{Event, Refusal, Telemetry, Welcome};

/// Times of a client, microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// The link's own times, and the rate of the line.
    pub timing: Timing,
    /// How long a controller has to answer the greeting.
    pub connect_us: u64,
    /// How long a controller has to answer a request.
    pub answer_us: u64,
    /// Time between two urgent stops while no standstill is reported.
    pub urgent_repeat_us: u64,
}

impl Default for Options {
    fn default() -> Self {
        let timing = Timing {
            line_ahead_us: 20_000,
            ..Timing::default()
        };
        Self {
            timing,
            connect_us: 3_000_000,
            answer_us: 2_000_000,
            urgent_repeat_us: 20_000,
        }
    }
}

/// Names a request until it is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub(super) u64);

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Notice {
    /// The session is open; this is what the controller says of itself.
    Connected(Welcome),
    /// A request is answered.
    Answered {
        /// Which.
        ticket: Ticket,
        /// What it was called.
        command: &'static str,
        /// What came of it.
        result: Result<(), RequestError>,
    },
    /// The controller reports an event.
    Event {
        /// The control period in which it happened.
        period: u64,
        /// What.
        event: Event,
    },
    /// The controller reports how things stand.
    Telemetry(Box<Telemetry>),
    /// A command that asks for no answer (a jog) was refused.
    Refused(Refusal),
    /// The job is over, one way or another.
    Job(JobEnding),
    /// The session is over.
    Lost(ClientError),
}

/// How a client stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ClientState {
    /// No session.
    Closed,
    /// Greets and waits for an answer.
    Connecting,
    /// Requests are answered.
    Ready,
    /// The session ended, or never began.
    Failed(ClientError),
}
