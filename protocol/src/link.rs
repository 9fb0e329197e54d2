//! The link: messages over a line that loses, corrupts, duplicates and reorders bytes.
//!
//! Both endpoints use the same type [`Link`] ([`ControllerLink`], [`HostLink`]). It takes bytes and
//! the time, and returns bytes and messages. It accesses no port and no clock and does not
//! allocate. It behaves the same on a chip, on a host and in a test.
//!
//! * **Session.** The host sends [`Hello`](crate::message::Hello) repeatedly until it receives
//!   [`Welcome`](crate::message::Welcome). A new session drops the one before: its numbers, its
//!   messages, its frames under way. A different version or schema is refused. Session takeover is
//!   refused while the machine is busy.
//! * **Reliable messages** ([`Link::send`]) arrive once and in order, or the session ends. At most
//!   [`WINDOW`] are under way. Each frame has a sequence number, and each frame in the other
//!   direction carries an acknowledgement, also beyond a gap. A frame is resent as soon as a frame
//!   that was sent after it has arrived, or after a time that follows the measured round trip.
//! * **Flow control.** When waiting messages fill more than half of the receive buffer, those
//!   beyond half are acknowledged only as room is made. A fast sender blocks on its window and
//!   never resends because the receiver is full, if the messages under way fit the other half.
//! * **Last-value messages** ([`Link::send_latest`]) are sent once and replaced by the next one. An
//!   older one that arrives late is dropped.
//! * **Keep-alive.** An endpoint that sent nothing for [`Timing::keep_alive_us`] sends a keep-alive
//!   frame of four bytes. Every other frame keeps the link alive too. [`Link::peer_silent_us`] is
//!   the input of the heartbeat.
//!
//! Both endpoints, on a line without delay:
//!
//! ```
//! use haptimill_protocol::link::{
//!     ControllerLink, HostLink, Identity, LinkState, SHORT_REPORT, Timing,
//! };
//! use haptimill_protocol::message::{Command, Kept, Report, Request};
//!
//! let mut host = HostLink::new(Timing::default());
//! let mut controller = ControllerLink::new(Timing::default());
//! host.open(0x1234_5678, 0); // session number: random, never used before
//! let mut buffer = [0; 64];
//! for now_us in (0..100_000).step_by(200) {
//!     // The host: bytes out, bytes in, messages.
//!     let count = host.transmit(now_us, &mut buffer);
//!     controller.receive(now_us, &buffer[..count]);
//!     // The controller, once a period: Hello, at most one message, at most 64 bytes.
//!     if controller.hello().is_some() {
//!         let identity = Identity {
//!             machine: "mill", config_crc: 0, period_us: 200, axes: 5, queue: 64,
//!             kept: Kept::Unsupported,
//!         };
//!         controller.welcome(now_us, &identity, false);
//!     }
//!     if controller.room(SHORT_REPORT) > 0
//!         && let Some(Request { id, command: Command::Ping }) = controller.poll_message()
//!     {
//!         controller.send(&Report::Answer { id, result: Ok(()) }).unwrap();
//!     }
//!     let count = controller.transmit(now_us, &mut buffer);
//!     host.receive(now_us, &buffer[..count]);
//!     if now_us == 50_000 {
//!         assert_eq!(host.state(now_us), LinkState::Open);
//!         host.send(&Request { id: 7, command: Command::Ping }).unwrap();
//!     }
//! }
//! assert_eq!(host.poll_message(), Some(Report::Answer { id: 7, result: Ok(()) }));
//! ```
//!
//! Callers must pass a time that does not run backwards, and a session number that was never used
//! before: a reused number makes late frames of the old session valid again. A duplicate that
//! arrives more than 240 reliable frames late is taken for a new frame; no serial line delays so
//! long.
//!
//! Memory: [`ControllerLink`] has 3.0 KiB, [`HostLink`] 8.1 KiB (held by a test).

mod endpoint;
mod inbox;
mod outbox;
mod payload;
mod status;
#[cfg(test)]
mod tests;

pub use endpoint::{Controller, Endpoint, HelloOutcome, Host, Identity};
pub use status::{Counters, LinkState, ReceiveEffort, SendError, Timing};

use crate::frame::{FrameDecoder, Header, MAX_PAYLOAD, OutgoingFrame};
use crate::wire;
use inbox::Inbox;
use outbox::Outbox;
use payload::Payload;

/// Window: largest number of reliable frames under way in one direction.
pub const WINDOW: usize = 8;

/// Repetitions of an acknowledgement by an idle endpoint, half of [`Timing::keep_alive_us`] apart.
const REPEATS: u8 = 2;

/// Largest answer or event, bytes (a telemetry frame is larger).
pub const SHORT_REPORT: usize = 32;

/// The controller's endpoint: receives requests, sends reports. Answers and events are short, so
/// the send buffer is small.
pub type ControllerLink = Link<Controller, { WINDOW * SHORT_REPORT }, 1024>;

/// The host's endpoint: sends requests, receives reports.
pub type HostLink = Link<Host, 2400, 4096>;

/// An endpoint of a link. `SEND` and `RECEIVE` are the buffer sizes in the two directions, bytes.
#[derive(Debug)]
pub struct Link<E: Endpoint, const SEND: usize, const RECEIVE: usize> {
    /// Timing and line rate.
    timing: Timing,
    /// State of the host's or the controller's role.
    end: E,
    /// A session is open.
    open: bool,
    /// Number of the session.
    session: u32,
    /// Decoder from bytes to frames.
    decoder: FrameDecoder,
    /// Received messages, to be acknowledged and polled.
    inbox: Inbox<RECEIVE>,
    /// Reliable messages under way.
    outbox: Outbox<SEND>,
    /// The next last-value message, whether it waits, whether it is held back, and its number.
    latest: Payload,
    latest_waits: bool,
    latest_sequence: u8,
    /// The outgoing frame, and whether it carries a reliable message.
    wire: OutgoingFrame,
    reliable: bool,
    /// Nothing is to be sent before this time, unless something happens in the meantime.
    quiet_until_us: u64,
    /// Time since which an acknowledgement waits, and the number of frames that it covers.
    acknowledge_since: Option<u64>,
    acknowledge_count: u8,
    /// Repetitions left of the last acknowledgement while nothing else is sent.
    repeats: u8,
    /// Time at which a frame was last begun, and time at which the last frame of the peer came.
    spoke_us: u64,
    received_us: u64,
    /// Time at which the line will have carried everything given to it, in nanoseconds.
    line_free_ns: u64,
    counters: Counters,
}

impl<E: Endpoint, const SEND: usize, const RECEIVE: usize> Link<E, SEND, RECEIVE> {
    /// Creates a link without a session.
    pub fn new(timing: Timing) -> Self {
        Self {
            timing,
            end: E::default(),
            open: false,
            session: 0,
            decoder: FrameDecoder::new(),
            inbox: Inbox::default(),
            outbox: Outbox::default(),
            latest: Payload::default(),
            latest_waits: false,
            latest_sequence: 0,
            wire: OutgoingFrame::default(),
            reliable: false,
            quiet_until_us: 0,
            acknowledge_since: None,
            acknowledge_count: 0,
            repeats: 0,
            spoke_us: 0,
            received_us: 0,
            line_free_ns: 0,
            counters: Counters::default(),
        }
    }

    /// Returns the state of the link. [`LinkState::Silent`] and [`LinkState::Stalled`] end a host's
    /// session. A controller's session stays until the next Hello, and its caller decides what to
    /// do until then. Callers with a machine in motion must take both for a lost host, because
    /// undeliverable reports stall only this link.
    pub fn state(&self, now_us: u64) -> LinkState {
        if !self.open {
            self.end.closed()
        } else if self.peer_silent_us(now_us) >= u64::from(self.timing.silence_us) {
            LinkState::Silent
        } else if self.outbox.stalled_us(now_us) >= u64::from(self.timing.stall_us) {
            LinkState::Stalled
        } else {
            LinkState::Open
        }
    }

    /// Session number; 0 without a session.
    pub fn session(&self) -> u32 {
        self.session
    }

    /// Time since the last valid frame of the peer, microseconds.
    pub fn peer_silent_us(&self, now_us: u64) -> u64 {
        now_us.saturating_sub(self.received_us)
    }

    /// Counters since the creation of the link.
    pub fn counters(&self) -> Counters {
        Counters {
            bad_frames: self.decoder.bad_frames(),
            resent: self.outbox.resent,
            duplicates: self.inbox.duplicates,
            no_room: self.inbox.no_room,
            ..self.counters
        }
    }

    /// Measured round trip, microseconds; 0 before the first measurement.
    pub fn round_trip_us(&self) -> u32 {
        self.outbox.round_trip_us()
    }

    /// Takes bytes from the line and returns the receive effort. Messages wait for
    /// [`Link::poll_message`].
    pub fn receive(&mut self, now_us: u64, bytes: &[u8]) -> ReceiveEffort {
        let Self {
            decoder,
            inbox,
            outbox,
            end,
            counters,
            ..
        } = self;
        let mut is_hello = false;
        let mut received = false;
        let mut line = bytes;
        let mut work = if bytes.is_empty() {
            ReceiveEffort::Nothing
        } else {
            ReceiveEffort::Bytes
        };
        while let Some(frame) = decoder.take(&mut line) {
            work = ReceiveEffort::Frame;
            // Every frame may cause a transmission.
            self.quiet_until_us = 0;
            counters.frames_heard = counters.frames_heard.saturating_add(1);
            match frame.header {
                Header::Hello | Header::Welcome => {
                    is_hello |= end.begins_session(frame.header, frame.payload);
                    continue;
                }
                _ if !self.open => continue,
                Header::Reliable {
                    sequence,
                    acknowledgement,
                } => {
                    outbox.acknowledge(now_us, acknowledgement);
                    let at_once = inbox.reliable(sequence, frame.payload);
                    self.acknowledge_since.get_or_insert(now_us);
                    let more = if at_once { WINDOW as u8 } else { 1 };
                    self.acknowledge_count = self.acknowledge_count.saturating_add(more);
                    self.repeats = REPEATS;
                }
                Header::Latest {
                    sequence,
                    acknowledgement,
                } => {
                    outbox.acknowledge(now_us, acknowledgement);
                    inbox.latest(sequence, frame.payload);
                }
                Header::Acknowledge(acknowledgement) => {
                    outbox.acknowledge(now_us, acknowledgement);
                }
                Header::KeepAlive => {}
            }
            received = true;
        }
        if received {
            self.received_us = now_us;
        }
        if is_hello && let Some(session) = self.end.accepted() {
            self.begin(now_us, session);
        }
        if core::mem::take(&mut self.inbox.moved) {
            work = ReceiveEffort::Moved;
        }
        work
    }

    /// Returns the next message, if there is one. A reliable message comes once and in order.
    pub fn poll_message(&mut self) -> Option<E::Incoming> {
        while let Some(payload) = self.inbox.first() {
            let message = postcard::from_bytes(payload);
            self.drop_first();
            match message {
                Ok(message) => return Some(message),
                Err(_) => self.count_unreadable(),
            }
        }
        None
    }

    /// Writes the next message to `place`, which avoids a copy of a large value. Returns false if
    /// there is none, or one that cannot be decoded.
    pub fn poll_into(&mut self, place: &mut E::Incoming) -> bool {
        let Some(payload) = self.inbox.first() else {
            return false;
        };
        let message = postcard::from_bytes(payload);
        self.drop_first();
        match message {
            Ok(message) => *place = message,
            Err(_) => {
                self.count_unreadable();
                return false;
            }
        }
        true
    }

    /// Returns whether no received message is stored. A stored message may still wait for the one
    /// before it.
    #[inline]
    pub fn has_received_all(&self) -> bool {
        self.inbox.is_empty()
    }

    /// Returns the bytes of the next message, for decoding in steps. It stays until
    /// [`Link::drop_first`].
    pub fn peek(&self) -> Option<&[u8]> {
        self.inbox.first()
    }

    /// Drops the message of [`Link::peek`].
    pub fn drop_first(&mut self) {
        if self.inbox.drop_first() {
            // The peer waits for the room.
            self.acknowledge_since.get_or_insert(0);
            self.acknowledge_count = WINDOW as u8;
            self.repeats = REPEATS;
            self.quiet_until_us = 0;
        }
    }

    /// Drops the message of [`Link::peek`] and counts it as unreadable.
    pub fn drop_unreadable(&mut self) {
        self.drop_first();
        self.count_unreadable();
    }

    fn count_unreadable(&mut self) {
        self.counters.unreadable = self.counters.unreadable.saturating_add(1);
    }

    /// Sends a reliable message: delivered once and in order.
    ///
    /// # Errors
    ///
    /// [`SendError::Full`] when the window or the buffer is full: nothing was taken, try again
    /// later. [`SendError::NotOpen`] without a session. [`SendError::TooLong`] when the message
    /// does not fit a frame.
    pub fn send(&mut self, message: &E::Outgoing) -> Result<(), SendError> {
        if !self.open {
            return Err(SendError::NotOpen);
        }
        let length = wire::write(message, self.outbox.free()).unwrap_or(usize::MAX);
        if length > MAX_PAYLOAD {
            Err(SendError::TooLong)
        } else if self.outbox.push(length) {
            self.quiet_until_us = 0;
            Ok(())
        } else {
            Err(SendError::Full)
        }
    }

    /// Returns how many reliable messages of up to `bytes` bytes can be sent now. A controller must
    /// poll a message only when there is room for its answer and events ([`SHORT_REPORT`] bytes
    /// each). Then none of them is lost, and a host that sends faster than it receives is blocked
    /// by its own window.
    pub fn room(&self, bytes: usize) -> usize {
        if self.open {
            self.outbox.room(bytes)
        } else {
            0
        }
    }

    /// Number of reliable messages that the peer has not acknowledged.
    pub fn under_way(&self) -> usize {
        self.outbox.len()
    }

    /// Sends a last-value message; one that still waits is replaced.
    ///
    /// # Errors
    ///
    /// [`SendError`] when no session is open, or the message does not fit a frame.
    pub fn send_latest(&mut self, message: &E::Outgoing) -> Result<(), SendError> {
        if !self.open {
            return Err(SendError::NotOpen);
        }
        let encoded = self.latest.encode(message);
        self.latest_waits = encoded.is_ok();
        self.quiet_until_us = 0;
        encoded
    }

    /// Returns whether a last-value message waits to be sent. Framing it is the longest task of
    /// [`Link::transmit`].
    pub fn latest_waits(&self) -> bool {
        self.latest_waits
    }

    /// Cancels the last-value message that waits, if its frame has not begun.
    pub fn withdraw_latest(&mut self) {
        self.latest_waits = false;
    }

    /// Returns whether nothing is to be sent now. Then [`Link::transmit`] need not be called.
    #[inline]
    pub fn is_quiet(&self, now_us: u64) -> bool {
        self.wire.is_gone() && now_us < self.quiet_until_us
    }

    /// Fills a buffer with the next bytes for the line and returns their number.
    pub fn transmit(&mut self, now_us: u64, buffer: &mut [u8]) -> usize {
        self.transmit_some(now_us, buffer, usize::MAX, usize::MAX)
    }

    /// The same with limited effort: begins at most `frames` frames, and encodes at most `bytes`
    /// bytes of content before each output. The rest follows with the next call.
    pub fn transmit_some(
        &mut self,
        now_us: u64,
        buffer: &mut [u8],
        frames: usize,
        bytes: usize,
    ) -> usize {
        let allowed = self.allowed(now_us).min(buffer.len());
        let (mut count, mut frames) = (0, frames);
        while count < allowed {
            if self.wire.is_gone() {
                if frames == 0 || !self.compose(now_us) {
                    break;
                }
                frames -= 1;
            }
            let free = buffer.get_mut(count..allowed).unwrap_or_default();
            let part = self.wire.read(free, bytes);
            if part == 0 {
                break;
            }
            if self.reliable {
                self.counters.message_bytes =
                    self.counters.message_bytes.saturating_add(part as u32);
            }
            count += part;
        }
        self.counters.bytes_sent = self.counters.bytes_sent.saturating_add(count as u32);
        self.charge(now_us, count);
        count
    }

    /// Begins a session and clears the state of the one before.
    fn begin(&mut self, now_us: u64, session: u32) {
        self.session = session;
        self.open = true;
        self.decoder.set_session(session);
        self.inbox.clear();
        self.outbox.clear();
        self.latest_waits = false;
        self.latest_sequence = 0;
        self.acknowledge_since = None;
        self.acknowledge_count = 0;
        self.repeats = 0;
        self.received_us = now_us;
        self.spoke_us = now_us;
        self.quiet_until_us = 0;
        // An outgoing frame is sent to its end; the peer ignores it.
    }

    /// Ends the session; [`Link::counters`] are kept.
    pub fn close(&mut self) {
        self.open = false;
        self.session = 0;
        self.quiet_until_us = 0;
        self.decoder.set_session(0);
        self.end = E::default();
    }

    /// Puts the next frame into `wire`; returns false when nothing is to be sent. Order: Hello or
    /// Welcome, resent and new reliable frames, the last-value message, an acknowledgement that no
    /// other frame carried, a keep-alive frame.
    fn compose(&mut self, now_us: u64) -> bool {
        let Self {
            timing,
            end,
            inbox,
            outbox,
            wire,
            session,
            ..
        } = self;
        self.reliable = false;
        let composed = if let Some(header) =
            end.handshake_frame(now_us, timing.hello_us, &mut self.latest)
        {
            // The payload has replaced a last-value message, which had no receiver.
            self.latest_waits = false;
            // A zero first: the state of the line is unknown.
            wire.begin(header, self.latest.bytes(), 0, true)
        } else if !self.open {
            return false;
        } else {
            let acknowledgement = inbox.acknowledgement();
            let due_us = self.acknowledge_since.map_or(u64::MAX, |since| {
                if usize::from(self.acknowledge_count) >= WINDOW / 2 {
                    0
                } else {
                    since.saturating_add(u64::from(timing.acknowledge_us))
                }
            });
            // An acknowledgement may be lost. Without a repetition, the peer would resend its
            // frames.
            let half = if self.repeats > 0 { 2 } else { 1 };
            let silence_us = u64::from(timing.keep_alive_us / half);
            let silent_us = self.spoke_us.saturating_add(silence_us);
            let again = now_us >= silent_us;
            let framed = if let Some((sequence, payload)) = outbox.next(now_us, timing.resend_us) {
                let header = Header::Reliable {
                    sequence,
                    acknowledgement,
                };
                self.reliable = true;
                wire.begin(header, payload, *session, false)
            } else if self.latest_waits {
                self.latest_waits = false;
                self.latest_sequence = self.latest_sequence.wrapping_add(1);
                let header = Header::Latest {
                    sequence: self.latest_sequence,
                    acknowledgement,
                };
                wire.begin(header, self.latest.bytes(), *session, false)
            } else if now_us >= due_us || (again && self.repeats > 0) {
                self.repeats -= u8::from(again && self.repeats > 0);
                wire.begin(Header::Acknowledge(acknowledgement), &[], *session, false)
            } else if again {
                // A zero first, as with Hello: otherwise the frame is lost if it follows the rest
                // of a broken frame.
                wire.begin(Header::KeepAlive, &[], *session, true)
            } else {
                if !self.latest_waits {
                    self.quiet_until_us =
                        due_us.min(silent_us).min(outbox.due_us(timing.resend_us));
                }
                return false;
            };
            // Every frame but the keep-alive frame carries the acknowledgement, and that one comes
            // only after all its repetitions.
            self.acknowledge_since = None;
            self.acknowledge_count = 0;
            framed
        };
        self.spoke_us = now_us;
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        composed.is_ok()
    }

    /// Bytes that the line can take now: its capacity in the time that it may be filled ahead,
    /// minus the bytes that it still has.
    fn allowed(&self, now_us: u64) -> usize {
        if self.timing.line_rate == 0 {
            return usize::MAX;
        }
        let ahead_ns = u64::from(self.timing.line_ahead_us.min(1_000_000)) * 1000;
        let until = now_us.saturating_mul(1000).saturating_add(ahead_ns);
        let room_ns = until.saturating_sub(self.line_free_ns).min(ahead_ns);
        // Below 10^9 * 2^32 < 2^62.
        (room_ns * u64::from(self.timing.line_rate) / 1_000_000_000) as usize
    }

    /// Accounts for bytes given to the line.
    fn charge(&mut self, now_us: u64, bytes: usize) {
        if self.timing.line_rate != 0 {
            let cost =
                (bytes as u64).saturating_mul(1_000_000_000) / u64::from(self.timing.line_rate);
            let from = self.line_free_ns.max(now_us.saturating_mul(1000));
            self.line_free_ns = from.saturating_add(cost);
        }
    }
}
