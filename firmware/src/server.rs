//! Messages in, answers and telemetry out: the controller's end of the link.
//!
//! A period hears at most 64 bytes and does at most one thing that takes long: it reads a message or a setpoint of a batch, or tries and takes a setpoint as far as its
//! [share](Server::share) goes, or says an answer or an event, or notes down telemetry, or encodes what was noted down, or puts down its frame. What goes out is made as it goes. Hearing and
//! telling take turns; the rest waits in the link, whose window stops the host. A period that the path needs for itself does none of it, and never two in a row are kept for that.
//! A setpoint that is refused ends its batch and changes nothing, not even what the next one is relative to: all later ones are out of
//! order until it comes again, or the job is begun anew. Nothing is skipped.

use crate::io::{Inputs, TRANSMIT_BYTES};
use crate::safety::Safety;
use haptimill_protocol::haptic::HandTelemetry;
use haptimill_protocol::link::{ControllerLink, Greeted, Identity, SHORT_REPORT, Timing, Work};
use haptimill_protocol::message::{
    AxisValues, Command, ConfigChunk, Refusal, Report, Request, Telemetry,
};
use haptimill_protocol::setpoint::{BatchReader, Setpoint, SetpointCoder};
use heapless::{Deque, Vec};

/// Room for a staged configuration, bytes.
pub const CONFIG_BYTES: usize = 1024;

/// Answers that wait for room in the link; as many as a host can have requests under way.
const ANSWERS: usize = 8;

/// A request that asks for nothing.
const NOTHING: Request = Request {
    id: 0,
    command: Command::Ping,
};

/// What was heard in a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heard {
    /// A request ([`Server::take_request`]).
    Request,
    /// The next setpoint of a batch ([`Server::setpoint`]), which was read in an earlier period.
    Setpoint {
        /// The setpoint's number in the job.
        number: u32,
        /// How much of it was tried already.
        tried: u8,
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
    /// Its next setpoint, and how much of that was tried.
    setpoint: Setpoint,
    tried: Option<u8>,
    /// The request that was read last, and whether it is yet to be heard.
    request: Request,
    read: bool,
    /// What came in this period.
    came: Work,
    /// Something long was done in this period; it was done by what hears.
    worked: bool,
    heard: bool,
    /// This period did not work although it might have.
    held: bool,
    /// Nothing was said in this period although something was to be said; a period is kept free for that.
    mute: bool,
    speaks: bool,
    /// Answers and events waited, because the period before had worked.
    kept: bool,
    /// Telemetry is due.
    telemetry_waits: bool,
    /// Telemetry as it was noted down, all of it in one period, and whether it is yet to be encoded.
    note: Report,
    noted: bool,
    /// It was noted down anew: what is told next waits until it has gone.
    renoted: bool,
    coder: SetpointCoder,
    session_begun: bool,
    staged: Vec<u8, CONFIG_BYTES>,
    /// Requests' numbers, and what became of them.
    answers: Deque<(u8, Result<(), Refusal>), ANSWERS>,
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
            setpoint: Setpoint::default(),
            tried: None,
            request: NOTHING,
            read: false,
            came: Work::Nothing,
            worked: false,
            heard: false,
            held: false,
            mute: false,
            speaks: false,
            kept: false,
            telemetry_waits: false,
            note: Report::Telemetry(Telemetry::default()),
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

    /// Takes the period's bytes; says whether a host greets, which [`Server::welcome`] answers.
    #[inline]
    pub fn listen(&mut self, inputs: &Inputs) -> bool {
        self.now_us = inputs.period.wrapping_mul(u64::from(self.period_us));
        self.deferred = self.deferred.saturating_add(u32::from(inputs.waiting));
        let lost = inputs.lost_bytes.wrapping_sub(self.lost_before);
        self.lost = self.lost.saturating_add(u32::from(lost));
        self.lost_before = inputs.lost_bytes;
        self.came = if inputs.received.is_empty() {
            Work::Nothing
        } else {
            self.receive(&inputs.received)
        };
        self.link.hello().is_some()
    }

    /// Gives the next thing to do. `hold_back`: the period has much to do already; that counts only if the one before did not hold back.
    #[inline]
    pub fn next(&mut self, hold_back: bool) -> Option<Heard> {
        // What tells has its turn when this has had one, and what was kept back for a period is not kept back again.
        let yields = self.kept || (self.heard && self.tells_much());
        self.held = hold_back && !self.held;
        let moved = self.came == Work::Moved;
        // This one is kept free for what could not be said in the one before.
        self.speaks = self.mute && !self.held && !moved;
        self.mute &= self.held;
        // What is told waits as well: a period that was held back has no time for it either.
        self.worked = self.held || moved || self.speaks;
        // A turn that could not be had is not lost.
        self.heard &= self.worked;
        let nothing = self.tried.is_none() && !self.read && self.link.has_heard_all();
        if nothing || yields || self.worked || self.answers.is_full() {
            return None;
        }
        self.hear()
    }

    /// Whether this period was held back, and neither hears nor tells.
    #[must_use]
    #[inline]
    pub const fn is_held(&self) -> bool {
        self.held
    }

    /// The next thing to do.
    #[inline(never)]
    fn hear(&mut self) -> Option<Heard> {
        self.worked = true;
        self.heard = true;
        if core::mem::take(&mut self.read) {
            return Some(Heard::Request);
        }
        let Some(tried) = self.tried.take() else {
            return self.read();
        };
        let number = self.batch.map_or(0, |batch| batch.number.wrapping_sub(1));
        Some(Heard::Setpoint { number, tried })
    }

    /// Takes bytes from the line.
    #[inline(never)]
    fn receive(&mut self, bytes: &[u8]) -> Work {
        self.link.receive(self.now_us, bytes)
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
    fn read(&mut self) -> Option<Heard> {
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
                // What takes long itself has a period of its own.
                self.read = matches!(self.request.command, Command::JobStart { .. });
                return (!self.read).then_some(Heard::Request);
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
            Some(Heard::BadSetpoint { number })
        }
    }

    /// The batch is done with.
    #[inline(never)]
    fn end_batch(&mut self, result: Result<(), Refusal>) {
        self.tried = None;
        if let Some(batch) = self.batch.take() {
            self.link.drop_first();
            self.answer(batch.id, result);
        }
    }

    /// The request that was heard in this period.
    #[must_use]
    pub const fn take_request(&mut self) -> Request {
        core::mem::replace(&mut self.request, NOTHING)
    }

    /// The setpoint that was heard in this period.
    #[must_use]
    #[inline]
    pub const fn setpoint(&self) -> &Setpoint {
        &self.setpoint
    }

    /// What this period has time for, in coordinates of a setpoint that are tried.
    #[must_use]
    #[inline]
    pub const fn share(&self) -> usize {
        match self.came {
            Work::Nothing => 8,
            Work::Bytes => 5,
            Work::Frame | Work::Moved => 3,
        }
    }

    /// As far as it was tried the machine can go to the setpoint that was heard in this period: it is heard again.
    pub const fn pass_setpoint(&mut self, tried: u8) {
        self.tried = Some(tried);
    }

    /// The setpoint that was heard in this period is in the queue: the next one is told relative to it, and read at once where there is time for it.
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
            // Read at once, a setpoint takes two periods and not three. One that cannot be read is left for its turn, which refuses it.
            self.tried = Some(0);
        }
    }

    /// Whether something long is to be done by [`Server::tell`].
    #[inline]
    fn tells_much(&self) -> bool {
        self.telemetry_waits || self.noted || self.link.latest_waits()
    }

    /// Whether this period still has time for something long; it is used up.
    #[inline]
    pub fn claim(&mut self) -> bool {
        !self.kept && !core::mem::replace(&mut self.worked, true)
    }

    /// The same, for something that can wait until all is told.
    #[inline]
    pub fn claim_idle(&mut self) -> bool {
        !self.hand_waits && !self.tells_much() && self.claim()
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

    /// A job begins at `pose`.
    pub fn begin_job(&mut self, pose: &AxisValues) {
        self.coder = SetpointCoder::new(self.period_us, pose);
    }

    /// Drops the setpoint that was heard in this period and the rest of its batch, and says why.
    pub fn refuse_setpoints(&mut self, refusal: Refusal) {
        self.end_batch(Err(refusal));
    }

    /// Whether an answer of an earlier period's request has room.
    #[must_use]
    pub fn can_answer(&self) -> bool {
        !self.answers.is_full()
    }

    /// Answers a request; success of a request without a number is not told.
    pub fn answer(&mut self, id: u8, result: Result<(), Refusal>) {
        #[cfg(feature = "defmt")]
        if let Err(refusal) = &result {
            defmt::warn!("request {} refused: {}", id, refusal);
        }
        if id != 0 || result.is_err() {
            // There is room: nothing is heard while the answers are full, and a period has at most one request.
            let _ = self.answers.push_back((id, result));
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

    /// Answers, then events, then telemetry; and the bytes of this period, as many as the board has `room` for. A period that was held back says nothing.
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
        let after = self.renoted && room > 0 && (self.noted || self.link.latest_waits());
        if due && !self.kept && !after && self.report(period, safety) {
            self.worked = true;
            self.note_anew();
        }
        if self.noted && self.claim() {
            self.encode();
        }
        // The frame of telemetry is long, and put down in a period that had nothing else to do.
        let waited = self.link.latest_waits();
        self.link.hold_latest(self.worked && !self.speaks);
        transmit.clear();
        if room > 0 && !self.held && !self.link.is_quiet(self.now_us) {
            // To work and to speak in one period is much; but what is said waits no longer than one.
            self.mute = self.worked && !self.speaks;
            if !self.mute {
                self.say(room, transmit);
            }
        }
        let gone = waited && !self.link.latest_waits();
        self.renoted &= !gone;
        self.worked |= gone;
    }

    /// Gives the line's next bytes: no more than one frame is begun in a period, and no more of it made than may go.
    #[inline(never)]
    fn say(&mut self, room: u16, transmit: &mut Vec<u8, TRANSMIT_BYTES>) {
        let mut buffer = [0; TRANSMIT_BYTES];
        let room = buffer.len().min(usize::from(room));
        let now_us = self.now_us;
        let said = buffer.get_mut(..room).unwrap_or_default();
        let count = self.link.transmit_some(now_us, said, 1, TRANSMIT_BYTES);
        if count != 0 {
            // As a whole it is copied by words.
            *transmit = Vec::from_array(buffer);
            transmit.truncate(count);
        }
    }

    /// Hands the next answer or event to the link; false when it has no room.
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
            safety.return_event(event);
        }
        sent
    }

    /// What was noted down and has not gone yet is older than what was told just now: whoever reads it would take it for newer. It is noted down again.
    fn note_anew(&mut self) {
        if self.noted || self.link.latest_waits() {
            self.noted = false;
            self.renoted = true;
            self.link.withdraw_latest();
            match self.note {
                Report::Hand(_) => self.hand_waits = true,
                _ => self.telemetry_waits = true,
            }
        }
    }

    /// Encodes the telemetry that was noted down.
    #[inline(never)]
    fn encode(&mut self) {
        self.noted = false;
        // Not open, or too long for a frame (which a test of the protocol excludes): nobody to tell.
        let _ = self.link.send_latest(&self.note);
    }

    /// Counts the periods until telemetry is due; says whether it is to be noted down in this one. Call once a period.
    ///
    /// Answers and `events` that have room in the link go first: whoever reads telemetry has heard of all that had happened by then.
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
        // A period that had much to do leaves it to the next one.
        !first && self.claim()
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
        self.hand_waits && !self.noted && !self.link.latest_waits() && self.claim()
    }

    /// Notes down telemetry of the hand, if there is an arm.
    pub fn note_hand(&mut self, telemetry: Option<HandTelemetry>) {
        self.hand_waits = false;
        if let Some(telemetry) = telemetry {
            self.note = Report::Hand(telemetry);
            self.noted = true;
        }
    }

    /// Where telemetry of this period is noted down; all of it must be.
    pub fn note(&mut self) -> Option<&mut Telemetry> {
        self.telemetry_waits = false;
        self.noted = true;
        if !matches!(self.note, Report::Telemetry(_)) {
            self.note = Report::Telemetry(Telemetry::default());
        }
        match &mut self.note {
            Report::Telemetry(telemetry) => Some(telemetry),
            _ => None,
        }
    }
}
