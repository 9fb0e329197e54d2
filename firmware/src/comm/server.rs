//! The controller's endpoint of the link: receives messages, transmits answers, events and
//! telemetry.
//!
//! A period receives at most 64 bytes and has one [slice](super::schedule) for a long task. Frames
//! are encoded while they are transmitted. Messages wait in the link; its window stops the host.
//!
//! A refused setpoint ends its batch and changes nothing, not even the prediction for the next one.
//! All later setpoints are out of order until it comes again or the job is restarted. No setpoint
//! is skipped.

use super::schedule::{Schedule, Slice};
use super::telemetry::{LineCount, Stream, Streams};
use crate::io::{Inputs, TRANSMIT_BYTES};
use crate::safety::Safety;
use haptimill_protocol::link::{
    ControllerLink, HelloOutcome, Identity, ReceiveEffort, SHORT_REPORT, Timing,
};
use haptimill_protocol::message::{AxisValues, Command, ConfigChunk, Refusal, Report, Request};
use haptimill_protocol::setpoint::{BatchReader, Setpoint, SetpointCoder};
use heapless::{Deque, Vec};

/// Largest staged configuration, in bytes.
pub const CONFIG_BYTES: usize = 4096;

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
        validated: u8,
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
    validated: Option<u8>,
    /// The request read last, and whether it waits to be executed.
    request: Request,
    request_waits: bool,
    /// Receive effort of this period.
    received: ReceiveEffort,
    schedule: Schedule,
    streams: Streams,
    coder: SetpointCoder,
    session_begun: bool,
    staged: Vec<u8, CONFIG_BYTES>,
    /// Request numbers and results.
    answers: Deque<(u8, Result<(), Refusal>), ANSWERS>,
    deferred: u32,
    lost: u32,
    /// The board's count of lost bytes in the period before.
    lost_before: u16,
}

/// Whether a command is executed in the slice that reads it: stops, and the values of a master,
/// whose delay is a part of the force-feedback loop. They are short. Any other request has a slice
/// of its own.
const fn is_executed_at_once(command: &Command) -> bool {
    matches!(
        command,
        Command::EmergencyStop
            | Command::Stop
            | Command::Hold
            | Command::Disable
            | Command::JogCancel { .. }
            | Command::MasterPose { .. }
            | Command::RemoteForce { .. }
    )
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
            validated: None,
            request: NOTHING,
            request_waits: false,
            received: ReceiveEffort::Nothing,
            schedule: Schedule::default(),
            streams: Streams::default(),
            coder: SetpointCoder::new(period_us, &AxisValues::new()),
            session_begun: false,
            staged: Vec::new(),
            answers: Deque::new(),
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
        self.received = if inputs.received.is_empty() {
            ReceiveEffort::Nothing
        } else {
            self.receive(&inputs.received)
        };
        self.link.hello().is_some()
    }

    /// Begins the slice of this period, and takes the next message or setpoint if it may be
    /// executed. `busy`: interpolation needs the period.
    #[inline]
    pub fn next(&mut self, busy: bool) -> Option<Incoming> {
        self.schedule.begin(busy, self.received);
        let may_execute = self.schedule.may_execute(self.telemetry_waits());
        let nothing =
            !self.request_waits && self.validated.is_none() && self.link.has_received_all();
        if !may_execute || nothing || self.answers.is_full() {
            return None;
        }
        self.execute()
    }

    /// Whether interpolation has this period.
    #[must_use]
    #[inline]
    pub fn is_deferred(&self) -> bool {
        self.schedule.slice() == Slice::Deferred
    }

    /// Gives the message or setpoint of this slice.
    #[inline(never)]
    fn execute(&mut self) -> Option<Incoming> {
        self.schedule.execute();
        if core::mem::take(&mut self.request_waits) {
            return Some(Incoming::Request);
        }
        let Some(validated) = self.validated.take() else {
            return self.read();
        };
        let number = self.batch.map_or(0, |batch| batch.number.wrapping_sub(1));
        Some(Incoming::Setpoint { number, validated })
    }

    /// Takes bytes from the line.
    #[inline(never)]
    fn receive(&mut self, bytes: &[u8]) -> ReceiveEffort {
        self.link.receive(self.now_us, bytes)
    }

    /// Answers a `Hello`. `busy`: the machine is active, so another host may not take over.
    #[inline(never)]
    pub fn welcome(&mut self, identity: &Identity<'_>, busy: bool) {
        let outcome = self.link.welcome(self.now_us, identity, busy);
        if outcome == HelloOutcome::Begun {
            self.reset();
            self.session_begun = true;
            #[cfg(feature = "defmt")]
            defmt::info!("a session begins");
        }
    }

    /// Reads the next message, or the next setpoint of a batch.
    fn read(&mut self) -> Option<Incoming> {
        let Some(payload) = self.link.peek() else {
            self.schedule.release();
            return None;
        };
        if self.batch.is_none() {
            if !BatchReader::fits(payload) {
                let read = self.link.poll_into(&mut self.request);
                let at_once = is_executed_at_once(&self.request.command);
                self.request_waits = read && !at_once;
                return (read && at_once).then_some(Incoming::Request);
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
            self.validated = Some(0);
            None
        } else {
            Some(Incoming::BadSetpoint { number })
        }
    }

    /// Ends the batch and answers it.
    #[inline(never)]
    fn end_batch(&mut self, result: Result<(), Refusal>) {
        self.validated = None;
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
        match self.received {
            ReceiveEffort::Nothing => 8,
            ReceiveEffort::Bytes => 5,
            ReceiveEffort::Frame | ReceiveEffort::Moved => 3,
        }
    }

    /// Stores the validation progress of the setpoint; a later period continues.
    pub const fn continue_setpoint(&mut self, validated: u8) {
        self.validated = Some(validated);
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
            self.validated = Some(0);
        }
    }

    /// Whether telemetry waits for a slice or for the line.
    #[inline]
    fn telemetry_waits(&self) -> bool {
        self.streams.machine_due() || self.link.latest_waits()
    }

    /// Tries to take the slice of this period for a background task.
    #[inline]
    pub fn try_background(&mut self) -> bool {
        self.schedule.try_take(Slice::Background)
    }

    /// The same for a task that can wait until all telemetry is sent.
    #[inline]
    pub fn try_background_idle(&mut self) -> bool {
        !self.streams.any_due() && !self.link.latest_waits() && self.try_background()
    }

    /// Whether a new session has begun since the last call.
    #[inline]
    pub fn session_begun(&mut self) -> bool {
        core::mem::take(&mut self.session_begun)
    }

    /// Drops the state of the old session.
    #[inline(never)]
    fn reset(&mut self) {
        self.batch = None;
        self.validated = None;
        self.request_waits = false;
        self.streams = Streams::default();
        self.answers.clear();
        self.staged.clear();
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

    /// The telemetry streams, for their intervals.
    pub const fn streams(&mut self) -> &mut Streams {
        &mut self.streams
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

    /// Transmits answers, then events, then telemetry; puts up to `room` bytes into `transmit`.
    #[inline]
    pub fn transmit(
        &mut self,
        period: u64,
        safety: &mut Safety,
        room: u16,
        transmit: &mut Vec<u8, TRANSMIT_BYTES>,
    ) {
        transmit.clear();
        let reports = !self.answers.is_empty() || safety.has_events();
        let line = room > 0 && !self.link.is_quiet(self.now_us);
        if !(reports || line) || !self.schedule.may_transmit() {
            return;
        }
        let superseded = self.streams.superseded && room > 0 && self.link.latest_waits();
        if reports && !superseded && self.report(period, safety) {
            self.schedule.transmit();
            self.supersede_telemetry();
        }
        if room > 0 {
            let waited = self.link.latest_waits();
            self.put_bytes(room, transmit);
            if waited && !self.link.latest_waits() {
                self.schedule.transmit();
                self.streams.superseded = false;
            }
        }
    }

    /// Takes the next bytes of the line: starts at most one frame per period, and encodes no more
    /// than fits.
    #[inline(never)]
    fn put_bytes(&mut self, room: u16, transmit: &mut Vec<u8, TRANSMIT_BYTES>) {
        let mut buffer = [0; TRANSMIT_BYTES];
        let room = buffer.len().min(usize::from(room));
        let now_us = self.now_us;
        let free = buffer.get_mut(..room).unwrap_or_default();
        let count = self.link.transmit_some(now_us, free, 1, TRANSMIT_BYTES);
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

    /// Withdraws telemetry that is not transmitted yet. It is older than the report just queued,
    /// and the host would take it for newer.
    fn supersede_telemetry(&mut self) {
        if self.link.latest_waits() {
            self.link.withdraw_latest();
            self.streams.sample_again();
        }
    }

    /// Counts a period of the telemetry streams. Returns the stream whose message must be
    /// [sent](Server::send_telemetry) in this period. Callers must call it once per period.
    ///
    /// Answers and `events` that have room in the link go first. A telemetry sample therefore never
    /// arrives before the reports of what happened earlier.
    #[inline]
    pub fn telemetry_due(&mut self, events: bool) -> Option<Stream> {
        let stream = self.streams.tick(self.link.latest_waits())?;
        let reports = (events || !self.answers.is_empty()) && self.link.room(SHORT_REPORT) > 0;
        let may_sample = !reports && self.schedule.try_take(Slice::Sample);
        may_sample.then_some(stream)
    }

    /// Sends the telemetry message of a stream that was due; `None` where there is nothing to
    /// sample.
    pub fn send_telemetry(&mut self, stream: Stream, message: Option<&Report>) {
        self.streams.sampled(stream);
        if let Some(message) = message {
            // Fails without a session. A message is never too long for a frame (a test of the
            // protocol).
            let _ = self.link.send_latest(message);
        }
    }
}
