//! The controller's endpoint of the link: receives messages, transmits answers, events and
//! telemetry.
//!
//! A period receives at most 64 bytes. It runs at most one long job:
//! - read a message, or a setpoint of a batch;
//! - validate and enqueue a setpoint, as far as the [slice budget](Server::budget) goes;
//! - queue an answer or an event;
//! - fill in a telemetry sample, encode it, or put its frame on the line.
//!
//! Frames are made while they are transmitted. Receive and transmit jobs alternate. The rest waits
//! in the link, whose window stops the host. Communication is skipped when interpolation needs the
//! whole period, but never twice in a row.
//!
//! A refused setpoint ends its batch and changes nothing, not even the prediction for the next one.
//! All later setpoints are out of order until it comes again or the job starts anew. No setpoint is
//! skipped.

use crate::io::{Inputs, TRANSMIT_BYTES};
use crate::safety::Safety;
use haptimill_protocol::haptic::MasterTelemetry;
use haptimill_protocol::link::{
    ControllerLink, HelloOutcome, Identity, ReceiveEffort, SHORT_REPORT, Timing,
};
use haptimill_protocol::message::{
    AxisValues, Command, ConfigChunk, Refusal, Report, Request, Telemetry,
};
use haptimill_protocol::setpoint::{BatchReader, Setpoint, SetpointCoder};
use heapless::{Deque, Vec};

/// Largest staged configuration, in bytes.
pub const CONFIG_BYTES: usize = 1024;

/// Answers that wait for room in the link: as many as a host can have requests under way.
const ANSWERS: usize = 8;

/// Placeholder for the request that was taken.
const NOTHING: Request = Request {
    id: 0,
    command: Command::Ping,
};

/// What a period received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Incoming {
    /// A request ([`Server::take_request`]).
    Request,
    /// The next setpoint of a batch ([`Server::setpoint`]), read in an earlier period.
    Setpoint {
        /// The setpoint's number in the job.
        number: u32,
        /// Validation progress; 0 at the start.
        tried: u8,
    },
    /// A setpoint that cannot be decoded.
    BadSetpoint {
        /// The setpoint's number in the job.
        number: u32,
    },
}

/// The controller's endpoint of the link.
#[derive(Debug)]
pub struct Server {
    link: ControllerLink,
    period_us: u16,
    now_us: u64,
    /// The batch in progress; its bytes wait in the link.
    batch: Option<BatchReader>,
    /// The next setpoint of the batch, and its validation progress.
    setpoint: Setpoint,
    tried: Option<u8>,
    /// The request read last, and whether it is still to be executed.
    request: Request,
    read: bool,
    /// Receive effort of this period.
    came: ReceiveEffort,
    /// This period ran a long job; `heard`: the job belonged to the receive side.
    worked: bool,
    heard: bool,
    /// This period skipped communication because interpolation needs the time.
    held: bool,
    /// Bytes waited in this period because it had run a long job (`mute`); the next period is kept
    /// free to transmit them (`speaks`).
    mute: bool,
    speaks: bool,
    /// Answers and events waited because this period had run a long job.
    kept: bool,
    /// Telemetry is due.
    telemetry_waits: bool,
    /// Telemetry sample of one period, and whether it is still to be encoded.
    sample: Report,
    noted: bool,
    /// The sample is superseded: answers and events wait until the new one has gone.
    renoted: bool,
    coder: SetpointCoder,
    session_begun: bool,
    staged: Vec<u8, CONFIG_BYTES>,
    /// Request numbers and results.
    answers: Deque<(u8, Result<(), Refusal>), ANSWERS>,
    every: u16,
    until_telemetry: u16,
    /// Interval, countdown and due flag of haptic-arm telemetry.
    hand_every: u16,
    until_hand: u16,
    hand_waits: bool,
    deferred: u32,
    lost: u32,
    /// The board's count of lost bytes in the period before.
    lost_before: u16,
}

/// Total counts of line events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineCount {
    /// Bytes that waited for a later period, summed over the periods.
    pub deferred_bytes: u32,
    /// Frames refused by their CRC.
    pub bad_frames: u32,
    /// Bytes that the board lost because its ring was full.
    pub lost_bytes: u32,
}

impl Server {
    /// Creates the endpoint for a control period in microseconds.
    #[must_use]
    pub fn new(period_us: u16) -> Self {
        Self {
            link: ControllerLink::new(Timing::default()),
            period_us,
            now_us: 0,
            batch: None,
            setpoint: Setpoint::default(),
            tried: None,
            request: NOTHING,
            read: false,
            came: ReceiveEffort::Nothing,
            worked: false,
            heard: false,
            held: false,
            mute: false,
            speaks: false,
            kept: false,
            telemetry_waits: false,
            sample: Report::Telemetry(Telemetry::default()),
            noted: false,
            renoted: false,
            coder: SetpointCoder::new(period_us, &AxisValues::new()),
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

    /// Takes the bytes of the period. Returns whether a `Hello` waits for [`Server::welcome`].
    #[inline]
    pub fn take_bytes(&mut self, inputs: &Inputs) -> bool {
        self.now_us = inputs.period.wrapping_mul(u64::from(self.period_us));
        self.deferred = self.deferred.saturating_add(u32::from(inputs.waiting));
        let lost = inputs.lost_bytes.wrapping_sub(self.lost_before);
        self.lost = self.lost.saturating_add(u32::from(lost));
        self.lost_before = inputs.lost_bytes;
        self.came = if inputs.received.is_empty() {
            ReceiveEffort::Nothing
        } else {
            self.receive(&inputs.received)
        };
        self.link.hello().is_some()
    }

    /// Takes the next job of the receive side. `hold_back`: interpolation needs this period; it has
    /// no effect if the period before was held back.
    #[inline]
    pub fn next(&mut self, hold_back: bool) -> Option<Incoming> {
        // Receive and transmit alternate; a deferred job runs in the next period.
        let yields = self.kept || (self.heard && self.tells_much());
        self.held = hold_back && !self.held;
        let moved = self.came == ReceiveEffort::Moved;
        // This period is kept free for the bytes that waited in the one before.
        self.speaks = self.mute && !self.held && !moved;
        self.mute &= self.held;
        // A period that was held back has no time to transmit either.
        self.worked = self.held || moved || self.speaks;
        // A side that could not take its turn keeps it.
        self.heard &= self.worked;
        let nothing = self.tried.is_none() && !self.read && self.link.has_received_all();
        if nothing || yields || self.worked || self.answers.is_full() {
            return None;
        }
        self.dispatch()
    }

    /// Whether this period is held back, and neither receives nor transmits.
    #[must_use]
    #[inline]
    pub const fn is_deferred(&self) -> bool {
        self.held
    }

    /// Runs the next job of the receive side.
    #[inline(never)]
    fn dispatch(&mut self) -> Option<Incoming> {
        self.worked = true;
        self.heard = true;
        if core::mem::take(&mut self.read) {
            return Some(Incoming::Request);
        }
        let Some(tried) = self.tried.take() else {
            return self.read();
        };
        let number = self.batch.map_or(0, |batch| batch.number.wrapping_sub(1));
        Some(Incoming::Setpoint { number, tried })
    }

    /// Takes bytes from the line.
    #[inline(never)]
    fn receive(&mut self, bytes: &[u8]) -> ReceiveEffort {
        self.link.receive(self.now_us, bytes)
    }

    /// Answers a `Hello`. `busy`: the machine is active, so another host may not take over.
    #[inline(never)]
    pub fn welcome(&mut self, identity: &Identity<'_>, busy: bool) {
        let greeted = self.link.welcome(self.now_us, identity, busy);
        if greeted == HelloOutcome::Begun {
            self.forget();
            self.session_begun = true;
        }
    }

    /// Reads the next message, or the next setpoint of a batch.
    fn read(&mut self) -> Option<Incoming> {
        let Some(payload) = self.link.peek() else {
            self.worked = false;
            self.heard = false;
            return None;
        };
        if self.batch.is_none() {
            if !BatchReader::fits(payload) {
                if !self.link.poll_into(&mut self.request) {
                    return None;
                }
                // A job start takes long and gets a period of its own.
                self.read = matches!(self.request.command, Command::JobStart { .. });
                return (!self.read).then_some(Incoming::Request);
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
        if batch.next(payload, &self.coder, &mut self.setpoint) {
            self.tried = Some(0);
            None
        } else {
            Some(Incoming::BadSetpoint { number })
        }
    }

    /// Ends the batch and answers it.
    #[inline(never)]
    fn end_batch(&mut self, result: Result<(), Refusal>) {
        self.tried = None;
        if let Some(batch) = self.batch.take() {
            self.link.drop_first();
            self.answer(batch.id, result);
        }
    }

    /// Takes the request of this period.
    #[must_use]
    pub const fn take_request(&mut self) -> Request {
        core::mem::replace(&mut self.request, NOTHING)
    }

    /// The setpoint of this period.
    #[must_use]
    #[inline]
    pub const fn setpoint(&self) -> &Setpoint {
        &self.setpoint
    }

    /// Slice budget of this period, in units of the check of one coordinate.
    #[must_use]
    #[inline]
    pub const fn budget(&self) -> usize {
        match self.came {
            ReceiveEffort::Nothing => 8,
            ReceiveEffort::Bytes => 5,
            ReceiveEffort::Frame | ReceiveEffort::Moved => 3,
        }
    }

    /// Stores the validation progress of the setpoint; a later period continues.
    pub const fn pass_setpoint(&mut self, tried: u8) {
        self.tried = Some(tried);
    }

    /// Marks the setpoint as enqueued. The next setpoint is relative to it, and is decoded at once
    /// if `read` is set.
    #[inline(never)]
    pub fn accept_setpoint(&mut self, read: bool) {
        self.coder.take(&self.setpoint);
        let Some(batch) = &mut self.batch else {
            return;
        };
        if batch.left == 0 {
            self.end_batch(Ok(()));
        } else if read
            && let Some(payload) = self.link.peek()
            && batch.next(payload, &self.coder, &mut self.setpoint)
        {
            // Decoded at once, a setpoint takes two periods and not three. The next turn refuses
            // one that cannot be decoded.
            self.tried = Some(0);
        }
    }

    /// Whether [`Server::transmit`] has a long job.
    #[inline]
    fn tells_much(&self) -> bool {
        self.telemetry_waits || self.noted || self.link.latest_waits()
    }

    /// Tries to take the time slice of this period; true if it was free.
    #[inline]
    pub fn try_claim(&mut self) -> bool {
        !self.kept && !core::mem::replace(&mut self.worked, true)
    }

    /// Tries to take the time slice for a job that can wait until all reports are sent.
    #[inline]
    pub fn try_claim_idle(&mut self) -> bool {
        !self.hand_waits && !self.tells_much() && self.try_claim()
    }

    /// Whether a new session has begun since the last call.
    #[inline]
    pub fn session_begun(&mut self) -> bool {
        core::mem::take(&mut self.session_begun)
    }

    /// Drops the state of the old session.
    #[inline(never)]
    fn forget(&mut self) {
        self.batch = None;
        self.tried = None;
        self.read = false;
        self.telemetry_waits = false;
        self.noted = false;
        self.renoted = false;
        self.answers.clear();
        self.staged.clear();
        self.every = 0;
        self.until_telemetry = 0;
        self.hand_every = 0;
        self.until_hand = 0;
        self.hand_waits = false;
    }

    /// Starts the setpoints of a job at `pose`.
    pub fn begin_job(&mut self, pose: &AxisValues) {
        self.coder = SetpointCoder::new(self.period_us, pose);
    }

    /// Refuses the setpoint of this period and drops the rest of its batch.
    pub fn refuse_setpoints(&mut self, refusal: Refusal) {
        self.end_batch(Err(refusal));
    }

    /// Whether there is room for the late answer to a request of an earlier period.
    #[must_use]
    pub fn can_answer(&self) -> bool {
        !self.answers.is_full()
    }

    /// Answers a request. The success of a request without a number has no answer.
    pub fn answer(&mut self, id: u8, result: Result<(), Refusal>) {
        #[cfg(feature = "defmt")]
        if let Err(refusal) = &result {
            defmt::warn!("request {} refused: {}", id, refusal);
        }
        if id != 0 || result.is_err() {
            // There is room: nothing is received while the answers are full, and a period has at
            // most one request.
            let _ = self.answers.push_back((id, result));
        }
    }

    /// Stages a chunk of a configuration; offset 0 starts a new one.
    ///
    /// # Errors
    /// `ConfigCheck` for a chunk out of order, `Range` for a configuration that is too long.
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

    /// Sets the interval of telemetry, in periods; 0 is off.
    pub fn set_telemetry(&mut self, every: u16) {
        self.every = every;
        self.until_telemetry = every;
    }

    /// Sets the interval of haptic-arm telemetry, in periods; 0 is off.
    pub fn set_hand_telemetry(&mut self, every: u16) {
        self.hand_every = every;
        self.until_hand = every;
    }

    /// Requests telemetry in this period.
    pub fn telemetry_now(&mut self) {
        self.until_telemetry = 1;
    }

    /// Silence of the host, in microseconds.
    #[must_use]
    #[inline]
    pub fn silent_us(&self) -> u64 {
        self.link.peer_silent_us(self.now_us)
    }

    /// Total counts of line events.
    #[must_use]
    pub fn counters(&self) -> LineCount {
        LineCount {
            deferred_bytes: self.deferred,
            bad_frames: self.link.counters().bad_frames,
            lost_bytes: self.lost,
        }
    }

    /// Transmits answers, then events, then telemetry; puts up to `room` bytes into `transmit`. A
    /// period that is held back transmits nothing.
    #[inline]
    pub fn transmit(
        &mut self,
        period: u64,
        safety: &mut Safety,
        room: u16,
        transmit: &mut Vec<u8, TRANSMIT_BYTES>,
    ) {
        // Reports of a long job wait for the next period.
        let due = !self.answers.is_empty() || safety.has_events();
        self.kept = due && self.worked && !self.kept;
        let after = self.renoted && room > 0 && (self.noted || self.link.latest_waits());
        if due && !self.kept && !after && self.report(period, safety) {
            self.worked = true;
            self.note_anew();
        }
        if self.noted && self.try_claim() {
            self.encode();
        }
        // A telemetry frame is long: it goes in a period without another long job.
        let waited = self.link.latest_waits();
        self.link.hold_latest(self.worked && !self.speaks);
        transmit.clear();
        if room > 0 && !self.held && !self.link.is_quiet(self.now_us) {
            // A long job and transmission do not fit into one period, but bytes wait for one period
            // only.
            self.mute = self.worked && !self.speaks;
            if !self.mute {
                self.say(room, transmit);
            }
        }
        let gone = waited && !self.link.latest_waits();
        self.renoted &= !gone;
        self.worked |= gone;
    }

    /// Takes the next bytes of the line: starts at most one frame per period, and encodes no more
    /// than fits.
    #[inline(never)]
    fn say(&mut self, room: u16, transmit: &mut Vec<u8, TRANSMIT_BYTES>) {
        let mut buffer = [0; TRANSMIT_BYTES];
        let room = buffer.len().min(usize::from(room));
        let now_us = self.now_us;
        let said = buffer.get_mut(..room).unwrap_or_default();
        let count = self.link.transmit_some(now_us, said, 1, TRANSMIT_BYTES);
        if count != 0 {
            // Copied as a whole, by words.
            *transmit = Vec::from_array(buffer);
            transmit.truncate(count);
        }
    }

    /// Hands the next answer or event to the link; false when the link has no room.
    #[inline(never)]
    fn report(&mut self, period: u64, safety: &mut Safety) -> bool {
        if let Some(&(id, result)) = self.answers.front() {
            let sent = self.link.send(&Report::Answer { id, result }).is_ok();
            if sent {
                self.answers.pop_front();
            }
            return sent;
        }
        if self.link.room(SHORT_REPORT) == 0 {
            return false;
        }
        let Some(event) = safety.next_event() else {
            return false;
        };
        let report = Report::Event { period, event };
        let sent = self.link.send(&report).is_ok();
        if !sent && let Report::Event { event, .. } = report {
            safety.unread_event(event);
        }
        sent
    }

    /// Supersedes telemetry that has not gone yet. It is older than the report just queued, and the
    /// host would take it for newer.
    fn note_anew(&mut self) {
        if self.noted || self.link.latest_waits() {
            self.noted = false;
            self.renoted = true;
            self.link.withdraw_latest();
            match self.sample {
                Report::Master(_) => self.hand_waits = true,
                _ => self.telemetry_waits = true,
            }
        }
    }

    /// Encodes the pending telemetry sample.
    #[inline(never)]
    fn encode(&mut self) {
        self.noted = false;
        // Fails without a session. A sample is never too long for a frame (a test of the protocol).
        let _ = self.link.send_latest(&self.sample);
    }

    /// Counts the periods until telemetry is due; true if this period must fill in a sample.
    /// Callers must call it once per period.
    ///
    /// Answers and `events` that have room in the link go first. A telemetry sample therefore never
    /// arrives before the reports of what happened earlier.
    #[inline]
    pub fn telemetry_due(&mut self, events: bool) -> bool {
        if self.until_telemetry != 0 {
            self.until_telemetry -= 1;
            if self.until_telemetry == 0 {
                self.until_telemetry = self.every;
                self.telemetry_waits = true;
            }
        }
        if !self.telemetry_waits {
            return false;
        }
        let first = (events || !self.answers.is_empty()) && self.link.room(SHORT_REPORT) > 0;
        // A period with a long job leaves telemetry to the next one.
        !first && self.try_claim()
    }

    /// The same for telemetry of the haptic arm. It comes after other telemetry and never replaces
    /// a waiting sample.
    pub fn hand_due(&mut self) -> bool {
        if self.until_hand != 0 {
            self.until_hand -= 1;
            if self.until_hand == 0 {
                self.until_hand = self.hand_every;
                self.hand_waits = true;
            }
        }
        self.hand_waits && !self.noted && !self.link.latest_waits() && self.try_claim()
    }

    /// Stores telemetry of the haptic arm, if there is an arm.
    pub fn note_hand(&mut self, telemetry: Option<MasterTelemetry>) {
        self.hand_waits = false;
        if let Some(telemetry) = telemetry {
            self.sample = Report::Master(telemetry);
            self.noted = true;
        }
    }

    /// Storage for the telemetry sample of this period; callers must fill in all of it.
    pub fn sample(&mut self) -> Option<&mut Telemetry> {
        self.telemetry_waits = false;
        self.noted = true;
        if !matches!(self.sample, Report::Telemetry(_)) {
            self.sample = Report::Telemetry(Telemetry::default());
        }
        match &mut self.sample {
            Report::Telemetry(telemetry) => Some(telemetry),
            _ => None,
        }
    }
}
