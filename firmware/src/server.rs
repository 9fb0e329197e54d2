//! Messages in, answers and telemetry out: the controller's end of the link.
//!
//! A period hears at most 64 bytes and does at most one thing that takes long: it reads a message or a setpoint of a batch, or tries whether the machine can go to a setpoint that was read before, or takes one that was tried before,
//! or encodes telemetry, or makes the frame of telemetry that was encoded before. Hearing and telling take turns; the rest waits in the
//! link, whose window stops the host. A setpoint that is refused ends its batch and changes nothing, not even what the next one is relative to: all later ones are out of
//! order until it comes again, or the job is begun anew. Nothing is skipped.

use crate::io::{Inputs, TRANSMIT_BYTES};
use crate::safety::Safety;
use haptimill_protocol::haptic::HandTelemetry;
use haptimill_protocol::link::{ControllerLink, Greeted, Identity, SHORT_REPORT, Timing};
use haptimill_protocol::message::{AxisValues, ConfigChunk, Refusal, Report, Request, Telemetry};
use haptimill_protocol::setpoint::{BatchReader, Setpoint, SetpointCoder};
use heapless::{Deque, Vec};

/// Room for a staged configuration, bytes.
pub const CONFIG_BYTES: usize = 1024;

/// Answers that wait for room in the link; as many as a host can have requests under way.
const ANSWERS: usize = 8;

/// What was heard in a period.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one lives for one period on the stack; there is no allocator for a box"
)]
pub enum Heard {
    /// A request.
    Request(Request),
    /// The next setpoint of a batch, which was read in an earlier period.
    Setpoint {
        /// The setpoint's number in the job.
        number: u32,
        /// The setpoint.
        setpoint: Setpoint,
    },
    /// The same setpoint again, in the period after it was tried.
    Tried {
        /// The setpoint's number in the job.
        number: u32,
        /// The setpoint.
        setpoint: Setpoint,
    },
    /// A setpoint that cannot be read.
    BadSetpoint {
        /// The setpoint's number in the job.
        number: u32,
    },
}

/// The controller's end of the link.
#[derive(Debug)]
pub struct Server {
    link: ControllerLink,
    period_us: u16,
    now_us: u64,
    /// The batch of setpoints that is being worked through; its bytes wait in the link.
    batch: Option<BatchReader>,
    /// Its next setpoint, and whether that was tried.
    decoded: Option<(Setpoint, bool)>,
    /// Something long was done in this period.
    worked: bool,
    /// This period did not work although it might have.
    held: bool,
    /// Answers and events waited, because the period before had worked.
    kept: bool,
    /// Telemetry is due.
    telemetry_waits: bool,
    coder: SetpointCoder,
    /// The coder after the setpoint that was heard last; taken over when that is accepted.
    ahead: SetpointCoder,
    session_begun: bool,
    staged: Vec<u8, CONFIG_BYTES>,
    answers: Deque<Report, ANSWERS>,
    every: u16,
    until_telemetry: u16,
    /// Telemetry of the hand, likewise.
    hand_every: u16,
    until_hand: u16,
    hand_waits: bool,
    deferred: u32,
    lost: u32,
    /// The board's own count of lost bytes in the period before.
    lost_before: u16,
}

/// What happened to the bytes of the line, in all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineCount {
    /// Bytes that had to wait for a later period.
    pub deferred_bytes: u32,
    /// Frames refused by their check.
    pub bad_frames: u32,
    /// Bytes that the board lost for want of room.
    pub lost_bytes: u32,
}

impl Server {
    /// A server of a controller whose period has so many microseconds.
    #[must_use]
    pub fn new(period_us: u16) -> Self {
        Self {
            link: ControllerLink::new(Timing::default()),
            period_us,
            now_us: 0,
            batch: None,
            decoded: None,
            worked: false,
            held: false,
            kept: false,
            telemetry_waits: false,
            coder: SetpointCoder::new(period_us, &AxisValues::new()),
            ahead: SetpointCoder::new(period_us, &AxisValues::new()),
            session_begun: false,
            staged: Vec::new(),
            answers: Deque::new(),
            every: 0,
            until_telemetry: 0,
            hand_every: 0,
            until_hand: 0,
            hand_waits: false,
            deferred: 0,
            lost: 0,
            lost_before: 0,
        }
    }

    /// Takes the period's bytes; says whether a host greets, which [`Server::welcome`] answers.
    #[inline]
    pub fn listen(&mut self, inputs: &Inputs) -> bool {
        self.now_us = inputs.period.wrapping_mul(u64::from(self.period_us));
        self.deferred = self.deferred.saturating_add(u32::from(inputs.waiting));
        let lost = inputs.lost_bytes.wrapping_sub(self.lost_before);
        self.lost = self.lost.saturating_add(u32::from(lost));
        self.lost_before = inputs.lost_bytes;
        if !inputs.received.is_empty() {
            self.receive(&inputs.received);
        }
        self.link.hello().is_some()
    }

    /// Gives the next thing to do. `hold_back`: the period has much to do already; that counts only if the one before did not hold back.
    #[inline]
    pub fn next(&mut self, hold_back: bool) -> Option<Heard> {
        // What tells has its turn when this has had one.
        let yields = self.worked && self.tells_much();
        self.held = hold_back && !self.held;
        // What is told waits as well: a period that was held back has no time for it either.
        self.worked = self.held;
        if yields || self.held || self.answers.is_full() {
            return None;
        }
        self.worked = true;
        let number = self.batch.map_or(0, |batch| batch.number.wrapping_sub(1));
        match self.decoded.take() {
            Some((setpoint, false)) => Some(Heard::Setpoint { number, setpoint }),
            Some((setpoint, true)) => Some(Heard::Tried { number, setpoint }),
            None => self.read(),
        }
    }

    /// Takes bytes from the line.
    #[inline(never)]
    fn receive(&mut self, bytes: &[u8]) {
        self.link.receive(self.now_us, bytes);
    }

    /// Answers a greeting. `busy`: no other host may break in.
    #[inline(never)]
    pub fn welcome(&mut self, identity: &Identity<'_>, busy: bool) {
        let greeted = self.link.welcome(self.now_us, identity, busy);
        if greeted == Greeted::Begun {
            self.forget();
            self.session_begun = true;
        }
    }

    /// Reads the next message, or the next setpoint of a batch.
    #[inline(never)]
    fn read(&mut self) -> Option<Heard> {
        let Some(payload) = self.link.peek() else {
            self.worked = false;
            return None;
        };
        if self.batch.is_none() {
            if !BatchReader::fits(payload) {
                return self.link.poll_message().map(Heard::Request);
            }
            self.batch = BatchReader::open(payload);
        }
        let Some(batch) = &mut self.batch else {
            self.link.drop_unreadable();
            return None;
        };
        let number = batch.number;
        if batch.left == 0 {
            self.end_batch(Ok(()));
            return None;
        }
        let delta = batch.next(payload);
        self.ahead = self.coder.clone();
        match delta.map(|delta| self.ahead.decode(&delta)) {
            Some(Ok(setpoint)) => {
                self.decoded = Some((setpoint, false));
                None
            }
            _ => Some(Heard::BadSetpoint { number }),
        }
    }

    /// The batch is done with.
    #[inline(never)]
    fn end_batch(&mut self, result: Result<(), Refusal>) {
        self.decoded = None;
        if let Some(batch) = self.batch.take() {
            self.link.drop_first();
            self.answer(batch.id, result);
        }
    }

    /// The machine can go to the setpoint that was heard in this period: it is heard again, to be taken.
    pub fn pass_setpoint(&mut self, setpoint: Setpoint) {
        self.decoded = Some((setpoint, true));
    }

    /// The setpoint that was heard in this period is in the queue: the next one is told relative to it.
    #[inline(never)]
    pub fn accept_setpoint(&mut self) {
        self.coder = self.ahead.clone();
        if self.batch.is_some_and(|batch| batch.left == 0) {
            self.end_batch(Ok(()));
        }
    }

    /// Whether something long is to be done by [`Server::tell`].
    #[inline]
    fn tells_much(&self) -> bool {
        self.telemetry_waits || self.link.latest_waits()
    }

    /// Whether this period still has time for something long; it is used up.
    #[inline]
    pub fn claim(&mut self) -> bool {
        !core::mem::replace(&mut self.worked, true)
    }

    /// Whether a new session has begun since the last call.
    #[inline]
    pub fn session_begun(&mut self) -> bool {
        core::mem::take(&mut self.session_begun)
    }

    /// What a session leaves behind when it ends.
    #[inline(never)]
    fn forget(&mut self) {
        self.batch = None;
        self.decoded = None;
        self.telemetry_waits = false;
        self.answers.clear();
        self.staged.clear();
        self.every = 0;
        self.hand_every = 0;
        self.until_hand = 0;
        self.hand_waits = false;
    }

    /// A job begins at `pose`.
    pub fn begin_job(&mut self, pose: &AxisValues) {
        self.coder = SetpointCoder::new(self.period_us, pose);
    }

    /// Drops the setpoint that was heard in this period and the rest of its batch, and says why.
    pub fn refuse_setpoints(&mut self, refusal: Refusal) {
        self.end_batch(Err(refusal));
    }

    /// Answers a request; success of a request without a number is not told.
    pub fn answer(&mut self, id: u8, result: Result<(), Refusal>) {
        #[cfg(feature = "defmt")]
        if let Err(refusal) = &result {
            defmt::warn!("request {} refused: {}", id, refusal);
        }
        if id != 0 || result.is_err() {
            // There is room: nothing is heard while the answers are full, and a period has at most one request.
            let _ = self.answers.push_back(Report::Answer { id, result });
        }
    }

    /// Stages a piece of a configuration.
    pub fn stage(&mut self, chunk: &ConfigChunk) -> Result<(), Refusal> {
        let offset = usize::from(chunk.offset);
        if offset == 0 {
            self.staged.clear();
        }
        if offset != self.staged.len() {
            return Err(Refusal::ConfigCheck);
        }
        self.staged
            .extend_from_slice(&chunk.bytes)
            .map_err(|_| Refusal::Range)
    }

    /// The staged configuration.
    #[must_use]
    pub fn staged(&self) -> &[u8] {
        &self.staged
    }

    /// Telemetry every so many periods.
    pub fn set_telemetry(&mut self, every: u16) {
        self.every = every;
        self.until_telemetry = every;
    }

    /// Telemetry of the hand every so many periods.
    pub fn set_hand_telemetry(&mut self, every: u16) {
        self.hand_every = every;
        self.until_hand = every;
    }

    /// Telemetry in this period.
    pub fn telemetry_now(&mut self) {
        self.until_telemetry = 1;
    }

    /// How long the host has been silent, microseconds.
    #[must_use]
    #[inline]
    pub fn silent_us(&self) -> u64 {
        self.link.peer_silent_us(self.now_us)
    }

    /// What happened to the bytes of the line.
    #[must_use]
    pub fn counters(&self) -> LineCount {
        LineCount {
            deferred_bytes: self.deferred,
            bad_frames: self.link.counters().bad_frames,
            lost_bytes: self.lost,
        }
    }

    /// Answers, then events, then telemetry; and the bytes of this period, as many as the board has `room` for.
    #[inline]
    pub fn tell(
        &mut self,
        period: u64,
        safety: &mut Safety,
        room: u16,
        transmit: &mut Vec<u8, TRANSMIT_BYTES>,
    ) {
        // What is to be said of what was done long is said in the next period.
        let due = !self.answers.is_empty() || safety.has_events();
        self.kept = due && self.worked && !self.kept;
        if due && !self.kept {
            self.report(period, safety);
        }
        // The frame of telemetry is long, and made in a period that had nothing else to do.
        let waited = self.link.latest_waits();
        self.link.hold_latest(self.worked);
        transmit.clear();
        if room > 0 {
            self.say(room, transmit);
        }
        self.worked |= waited && !self.link.latest_waits();
    }

    /// Gives the line's next bytes.
    #[inline(never)]
    fn say(&mut self, room: u16, transmit: &mut Vec<u8, TRANSMIT_BYTES>) {
        if !self.link.is_ready(self.now_us) {
            return;
        }
        let mut buffer = [0; TRANSMIT_BYTES];
        let room = usize::from(room).min(TRANSMIT_BYTES);
        let count = self.link.transmit(self.now_us, &mut buffer[..room]);
        // As long as the buffer: fits.
        let _ = transmit.extend_from_slice(&buffer[..count]);
    }

    /// Hands answers and events to the link, as many as it has room for.
    #[inline(never)]
    fn report(&mut self, period: u64, safety: &mut Safety) {
        while let Some(answer) = self.answers.front() {
            if self.link.send(answer).is_err() {
                break;
            }
            self.answers.pop_front();
        }
        while self.answers.is_empty() && self.link.room(SHORT_REPORT) > 0 {
            let Some(event) = safety.next_event() else {
                break;
            };
            if self
                .link
                .send(&Report::Event {
                    period,
                    event: event.clone(),
                })
                .is_err()
            {
                safety.return_event(event);
                break;
            }
        }
    }

    /// Counts the periods until telemetry is due; says whether it is to be sent in this one. Call once a period.
    #[inline]
    pub fn telemetry_due(&mut self) -> bool {
        if self.until_telemetry != 0 {
            self.until_telemetry -= 1;
            if self.until_telemetry == 0 {
                self.until_telemetry = self.every;
                self.telemetry_waits = true;
            }
        }
        // A period that had much to do leaves it to the next one.
        self.telemetry_waits && self.claim()
    }

    /// The same for telemetry of the hand; after the other one, and never in place of what still waits.
    pub fn hand_due(&mut self) -> bool {
        if self.until_hand != 0 {
            self.until_hand -= 1;
            if self.until_hand == 0 {
                self.until_hand = self.hand_every;
                self.hand_waits = true;
            }
        }
        self.hand_waits && !self.link.latest_waits() && self.claim()
    }

    /// Sends telemetry of the hand, if there is an arm.
    pub fn send_hand(&mut self, telemetry: Option<HandTelemetry>) {
        self.hand_waits = false;
        if let Some(telemetry) = telemetry {
            let _ = self.link.send_latest(&Report::Hand(telemetry));
        }
    }

    /// Sends telemetry.
    #[inline(never)]
    pub fn send_telemetry(&mut self, telemetry: Telemetry) {
        self.telemetry_waits = false;
        // Not open, or too long for a frame (which a test of the protocol excludes): nobody to tell.
        let _ = self.link.send_latest(&Report::Telemetry(telemetry));
    }
}
