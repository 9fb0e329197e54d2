//! Options of a client, and the notifications that it gives.

use super::{ClientError, JobEnding, RequestError};
use haptimill_protocol::link::Timing;
use haptimill_protocol::message::{Event, Refusal, Telemetry, Welcome};

/// Times of a client, microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// The link's own times, and the rate of the line.
    pub timing: Timing,
    /// Timeout of the answer to the Hello.
    pub connect_us: u64,
    /// Timeout of the acknowledgement of a request.
    pub answer_us: u64,
    /// Repeat time of an out-of-band stop while no standstill is reported.
    pub stop_repeat_us: u64,
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
            stop_repeat_us: 20_000,
        }
    }
}

/// Identifies a request until it is acknowledged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub(super) u64);

/// A notification of a client.
#[derive(Debug, Clone, PartialEq)]
pub enum Notification {
    /// The session is open; the answer of the controller.
    Connected(Welcome),
    /// A request is acknowledged, refused, or failed.
    Answered {
        /// The request.
        ticket: Ticket,
        /// Name of its command.
        command: &'static str,
        /// The result.
        result: Result<(), RequestError>,
    },
    /// The controller reports an event.
    Event {
        /// Control period of the event.
        period: u64,
        /// The event.
        event: Event,
    },
    /// Telemetry of the controller.
    Telemetry(Box<Telemetry>),
    /// A command without acknowledgement (a jog) was refused.
    Refused(Refusal),
    /// The job ended.
    Job(JobEnding),
    /// The session ended.
    Lost(ClientError),
}

/// State of the session of a client.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ClientState {
    /// No session.
    Closed,
    /// The Hello is sent; the answer is awaited.
    Connecting,
    /// The session is open.
    Ready,
    /// The session ended, or never began.
    Failed(ClientError),
}
