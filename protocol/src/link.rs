//! The link: messages over a line that loses, breaks, doubles and reorders bytes.
//!
//! One type, [`Link`], is used at both ends ([`ControllerLink`], [`HostLink`]). It is fed bytes and the time, and gives bytes and
//! messages; it reads no port and no clock, allocates nothing, and does the same on a chip, on a host and in a test.
//!
//! * **Session.** The host says [`Hello`](crate::message::Hello), again and again until it hears [`Welcome`](crate::message::Welcome). A new session forgets the one before: its
//!   numbers, its messages, its frames still under way. Version or schema that differ are refused, and so is a second host while the
//!   machine is busy.
//! * **Reliable messages** ([`Link::send`]) arrive once and in order, or the session ends. At most [`WINDOW`] are under way; each frame has
//!   a sequence number, each frame in the other direction says what arrived, also beyond a gap. A frame is sent again as
//!   soon as one that was sent after it has arrived, or after a time that follows the measured round trip.
//!   Where more than half of the room for messages that wait is used, what lies beyond is told to have arrived only as room is made: so whoever sends faster than the
//!   other end polls is held back by its own window, and sends nothing twice for want of room, if what is under way has room in the other half.
//! * **Latest values** ([`Link::send_latest`]) are sent once and replaced by the next; an older one that comes late is dropped.
//! * **Life.** An end that said nothing for [`Timing::keep_alive_us`] says that it is there, in four bytes; whatever else it says is a sign of life too.
//!   [`Link::peer_silent_us`] feeds the heartbeat.
//!
//! Both ends, on a line that carries everything at once:
//!
//! ```
//! use haptimill_protocol::link::{ControllerLink, HostLink, Identity, LinkState, SHORT_REPORT, Timing};
//! use haptimill_protocol::message::{Command, Report, Request};
//!
//! let mut host = HostLink::new(Timing::default());
//! let mut controller = ControllerLink::new(Timing::default());
//! host.open(0x1234_5678, 0); // the session's number: random, never used before
//! let mut buffer = [0; 64];
//! for now_us in (0..100_000).step_by(200) {
//!     // The host: bytes out, bytes in, messages.
//!     let count = host.transmit(now_us, &mut buffer);
//!     controller.receive(now_us, &buffer[..count]);
//!     // The controller, once a period: a greeting, at most one message, at most so many bytes.
//!     if controller.hello().is_some() {
//!         let identity = Identity { machine: "H4", config_crc: 0, period_us: 200, axes: 5, queue: 64 };
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
//! Misuse: the time must not run backwards. A duplicate that comes more than 240 reliable frames late would be taken for a new one; no
//! serial line does that. A session number that was used before makes late frames of the old session good again.
//!
//! Memory: [`ControllerLink`] has 2.8 KiB, [`HostLink`] 8 KiB (held by a test).

mod ends;
mod inbox;
mod outbox;
mod payload;
mod standing;
#[cfg(test)]
mod tests;

pub use ends::{Controller, End, Greeted, Host, Identity};
pub use standing::{Counters, LinkState, SendError, Timing, Work};

use crate::frame::{FrameDecoder, Header, MAX_PAYLOAD, OutgoingFrame};
use crate::wire;
use inbox::Inbox;
use outbox::Outbox;
use payload::Payload;

/// The most reliable frames under way in one direction.
pub const WINDOW: usize = 8;

/// How often an acknowledgement is said again, half a [`Timing::keep_alive_us`] apart, by an end that has nothing else to say.
const REPEATS: u8 = 2;

/// The most bytes of an answer or an event (of a telemetry frame there are more).
pub const SHORT_REPORT: usize = 32;

/// The controller's end: takes requests, gives reports. Answers and events are short, so the room to send is small.
pub type ControllerLink = Link<Controller, { WINDOW * SHORT_REPORT }, 1024>;

/// The host's end: sends requests, takes reports.
pub type HostLink = Link<Host, 2400, 4096>;

/// One end of a link. `SEND` and `RECEIVE` are the bytes kept of messages under way in either direction.
#[derive(Debug)]
pub struct Link<E: End, const SEND: usize, const RECEIVE: usize> {
    /// Times and rate.
    timing: Timing,
    /// What differs between the ends.
    end: E,
    /// A session is open.
    open: bool,
    /// Number of the session.
    session: u32,
    /// From bytes to frames.
    decoder: FrameDecoder,
    /// What is to be acknowledged and polled.
    inbox: Inbox<RECEIVE>,
    /// What is under way.
    outbox: Outbox<SEND>,
    /// The next latest value, if one waits; its number.
    latest: Payload,
    latest_waits: bool,
    latest_held: bool,
    latest_sequence: u8,
    /// The frame that is going out; whether it carries a reliable message.
    wire: OutgoingFrame,
    reliable: bool,
    /// There is nothing to say before this time, unless something happens in the meantime.
    quiet_until_us: u64,
    /// Since when an acknowledgement waits; how many frames it covers.
    acknowledge_since: Option<u64>,
    acknowledge_count: u8,
    /// How often the last acknowledgement is still to be repeated where nothing else is said.
    repeats: u8,
    /// When a frame was last begun; when the peer was last heard.
    spoke_us: u64,
    heard_us: u64,
    /// When the line will have carried all that was given to it, in nanoseconds.
    line_free_ns: u64,
    counters: Counters,
}

impl<E: End, const SEND: usize, const RECEIVE: usize> Link<E, SEND, RECEIVE> {
    /// A link without a session.
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
            latest_held: false,
            latest_sequence: 0,
            wire: OutgoingFrame::default(),
            reliable: false,
            quiet_until_us: 0,
            acknowledge_since: None,
            acknowledge_count: 0,
            repeats: 0,
            spoke_us: 0,
            heard_us: 0,
            line_free_ns: 0,
            counters: Counters::default(),
        }
    }

    /// How the link stands at a time. [`LinkState::Silent`] and [`LinkState::Stalled`] end a host's session; a controller's session stays
    /// until the next greeting, and what to do in the meantime is the caller's decision: a machine that moves should take either for a host that
    /// is lost, for reports that cannot be brought over stall only here.
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

    /// Number of the session; 0 when there is none.
    pub fn session(&self) -> u32 {
        self.session
    }

    /// How long nothing good has been heard of the peer, microseconds.
    pub fn peer_silent_us(&self, now_us: u64) -> u64 {
        now_us.saturating_sub(self.heard_us)
    }

    /// What was counted since the link was made.
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

    /// Takes bytes from the line; messages wait for [`Link::poll_message`]. Says how much work that was.
    pub fn receive(&mut self, now_us: u64, bytes: &[u8]) -> Work {
        let Self {
            decoder,
            inbox,
            outbox,
            end,
            counters,
            ..
        } = self;
        let mut greeted = false;
        let mut heard = false;
        let mut line = bytes;
        let mut work = if bytes.is_empty() {
            Work::Nothing
        } else {
            Work::Bytes
        };
        while let Some(frame) = decoder.take(&mut line) {
            work = Work::Frame;
            // Any of them may give something to say.
            self.quiet_until_us = 0;
            counters.frames_heard = counters.frames_heard.saturating_add(1);
            match frame.header {
                Header::Hello | Header::Welcome => {
                    greeted |= end.greeted(frame.header, frame.payload);
                    continue;
                }
                _ if !self.open => continue,
                Header::Reliable {
                    sequence,
                    acknowledgement,
                } => {
                    outbox.acknowledge(now_us, acknowledgement);
                    let urgent = inbox.reliable(sequence, frame.payload);
                    self.acknowledge_since.get_or_insert(now_us);
                    let more = if urgent { WINDOW as u8 } else { 1 };
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
                Header::Alive => {}
            }
            heard = true;
        }
        if heard {
            self.heard_us = now_us;
        }
        if greeted && let Some(session) = self.end.accepted() {
            self.begin(now_us, session);
        }
        if core::mem::take(&mut self.inbox.moved) {
            work = Work::Moved;
        }
        work
    }

    /// The next message, if there is one. A reliable one comes once and in order.
    pub fn poll_message(&mut self) -> Option<E::Hears> {
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

    /// The same, written where it shall be: messages are large. False if there is none, or one that cannot be read.
    pub fn poll_into(&mut self, place: &mut E::Hears) -> bool {
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

    /// Whether nothing at all arrived that is yet to be heard; a message may still have to wait for the one before it.
    #[inline]
    pub fn has_heard_all(&self) -> bool {
        self.inbox.is_empty()
    }

    /// The bytes of the next message, for whoever takes it apart bit by bit; it stays until [`Link::drop_first`].
    pub fn peek(&self) -> Option<&[u8]> {
        self.inbox.first()
    }

    /// Drops the message that [`Link::peek`] gives.
    pub fn drop_first(&mut self) {
        if self.inbox.drop_first() {
            // The peer waits for the room.
            self.acknowledge_since.get_or_insert(0);
            self.acknowledge_count = WINDOW as u8;
            self.repeats = REPEATS;
            self.quiet_until_us = 0;
        }
    }

    /// The message that [`Link::peek`] gives cannot be read.
    pub fn drop_unreadable(&mut self) {
        self.drop_first();
        self.count_unreadable();
    }

    fn count_unreadable(&mut self) {
        self.counters.unreadable = self.counters.unreadable.saturating_add(1);
    }

    /// Sends a message that must arrive, once and in order.
    ///
    /// # Errors
    ///
    /// [`SendError::Full`] when the window or the room is used up: nothing was taken, try again later.
    pub fn send(&mut self, message: &E::Sends) -> Result<(), SendError> {
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

    /// How many reliable messages of up to so many bytes can be sent now. A controller polls a message only when there is room for
    /// the answer and the events that it may cause ([`SHORT_REPORT`] bytes each): then none of them is ever lost, and a host that asks faster
    /// than it listens is held back by its own window.
    pub fn room(&self, bytes: usize) -> usize {
        if self.open {
            self.outbox.room(bytes)
        } else {
            0
        }
    }

    /// Reliable messages that the peer has not confirmed.
    pub fn under_way(&self) -> usize {
        self.outbox.len()
    }

    /// Sends a message of which only the newest is of interest; one that still waits is replaced.
    ///
    /// # Errors
    ///
    /// [`SendError`] when no session is open, or the message fits no frame.
    pub fn send_latest(&mut self, message: &E::Sends) -> Result<(), SendError> {
        if !self.open {
            return Err(SendError::NotOpen);
        }
        let encoded = self.latest.encode(message);
        self.latest_waits = encoded.is_ok();
        self.quiet_until_us = 0;
        encoded
    }

    /// Whether a latest value waits to be sent. Making its frame is the longest that [`Link::transmit`] may have to do.
    pub fn latest_waits(&self) -> bool {
        self.latest_waits
    }

    /// The latest value is not to be sent any more, if it has no frame yet.
    pub fn withdraw_latest(&mut self) {
        self.latest_waits = false;
    }

    /// A latest value is kept back while `held`: it gets no frame in [`Link::transmit`].
    pub fn hold_latest(&mut self, held: bool) {
        self.latest_held = held;
    }

    /// Whether there is nothing to say now: then [`Link::transmit`] need not be called.
    #[inline]
    pub fn is_quiet(&self, now_us: u64) -> bool {
        self.wire.is_gone() && now_us < self.quiet_until_us
    }

    /// Fills a buffer with the next bytes for the line and says how many they are.
    pub fn transmit(&mut self, now_us: u64, buffer: &mut [u8]) -> usize {
        self.transmit_some(now_us, buffer, usize::MAX, usize::MAX)
    }

    /// The same for an end that has little time: begins at most so many frames, and looks at so many bytes of each; what is not ready then comes with the next call.
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

    /// Begins a session: nothing of the one before is left.
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
        self.heard_us = now_us;
        self.spoke_us = now_us;
        self.quiet_until_us = 0;
        // A frame that has begun to go out goes out whole; the peer will not hear it.
    }

    /// Ends the session; [`Link::counters`] are kept.
    pub fn close(&mut self) {
        self.open = false;
        self.session = 0;
        self.quiet_until_us = 0;
        self.decoder.set_session(0);
        self.end = E::default();
    }

    /// Puts down the next frame in `wire`; false when there is nothing to say. What is said first: greetings, then frames to be
    /// sent again and new ones, then the latest value, then an acknowledgement that found nothing to ride on, then
    /// a sign of life.
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
        let composed = if let Some(header) = end.greeting(now_us, timing.hello_us, &mut self.latest)
        {
            // It has taken the place of a latest value, which nobody was listening to.
            self.latest_waits = false;
            // A zero in front: what the line had before is unknown.
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
            // An acknowledgement may have been lost, and would be missed until the peer sends its frames again.
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
            } else if self.latest_waits && !self.latest_held {
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
                // A zero in front, as with a greeting: one that follows the rest of a broken frame would be lost with it.
                wire.begin(Header::Alive, &[], *session, true)
            } else {
                if !self.latest_waits {
                    self.quiet_until_us =
                        due_us.min(silent_us).min(outbox.due_us(timing.resend_us));
                }
                return false;
            };
            // Each of them carries the acknowledgement; a sign of life comes only after all its repetitions.
            self.acknowledge_since = None;
            self.acknowledge_count = 0;
            framed
        };
        self.spoke_us = now_us;
        self.counters.frames_sent = self.counters.frames_sent.saturating_add(1);
        composed.is_ok()
    }

    /// Bytes that the line can take now: what it carries in the time that it may be filled ahead, less what it still has.
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

    /// The line has been given some bytes.
    fn charge(&mut self, now_us: u64, bytes: usize) {
        if self.timing.line_rate != 0 {
            let cost =
                (bytes as u64).saturating_mul(1_000_000_000) / u64::from(self.timing.line_rate);
            let from = self.line_free_ns.max(now_us.saturating_mul(1000));
            self.line_free_ns = from.saturating_add(cost);
        }
    }
}
