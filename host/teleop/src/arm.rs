//! A haptic arm on a controller of its own: a second controller, whose machine file has the role `master`.
//!
//! The arm is connected, given its machine file, and switched on; its telemetry then says where the hand is. All of that is done while the machine is led, one step at a time: when the link is
//! lost, or the port, it is looked for again, and the hand leads again once somebody has told the machine to go on.
//!
//! Misuse: an arm whose [`Source::advance`] is not called. Its controller hears nobody, and lets go of the hand.

use super::latency::What;
use super::script::Person;
use super::{Feeling, Felt, Source, Standing, Word};
use haptimill_client::board::{Chosen, Decision};
use haptimill_client::client::{Client, ClientError, Notice, Options, RequestError, Ticket};
use haptimill_client::port::PortError;
use haptimill_client::session::{JobLine, JobRecording, Line, SimLine};
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterTelemetry};
use haptimill_protocol::message::{Command, Event, Refusal};
use haptimill_protocol::text::{Axes, Describe};
use haptimill_trace::Recorder;
use std::collections::VecDeque;

/// A simulated arm with a person at it.
pub struct PersonLine {
    line: SimLine,
    person: Person,
}

impl PersonLine {
    /// A line to a simulated arm that a person leads.
    #[must_use]
    pub const fn new(line: SimLine, person: Person) -> Self {
        Self { line, person }
    }
}

impl Line for PersonLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        self.person.act(self.line.rig_mut());
        self.line.exchange(transmit, received)
    }

    fn name(&self) -> String {
        "the simulated arm".to_string()
    }

    fn snapshot(&self) -> Option<Snapshot> {
        self.line.snapshot()
    }

    fn recording_is_broken(&self) -> bool {
        self.line.recording_is_broken()
    }

    fn told_force(&self) -> Option<[i16; COMPONENTS]> {
        let arm = self.line.rig().control().machine()?.masters.arm()?;
        Some(arm.remote_force())
    }

    fn happened(&mut self, period: u64, level: u8, text: &str) {
        self.line.happened(period, level, text);
    }
}

impl JobLine for PersonLine {
    fn begin_recording(&mut self, recording: JobRecording) {
        self.line.begin_recording(recording);
    }

    fn end_recording(&mut self) -> Option<Recorder> {
        self.line.end_recording()
    }
}

/// How long the board of an arm may take to answer before anything moves, microseconds.
const PREPARE_US: u64 = 5_000_000;

/// How far it is.
#[derive(Debug)]
enum Phase {
    /// Its board is asked for its configuration, before the machine is homed; nothing is sent to it.
    Asking,
    /// A session is being opened.
    Connecting,
    /// Configuration, drives and telemetry were asked for, in this order.
    Preparing([Ticket; 3]),
    /// It leads.
    Ready,
    /// The port is gone.
    Gone,
}

/// Time between two attempts to open a port that is gone, microseconds.
const REOPEN_US: u64 = 500_000;

/// Periods between two reports, and what a line carries at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Time between two reports of the hand, microseconds.
    pub every_us: u32,
    /// Bytes a second; 0 for no bound.
    pub line_rate: u32,
}

/// The way to a port that is gone.
pub type Reopen<L> = Box<dyn FnMut() -> Result<L, PortError>>;

/// Number of the next session.
pub type Numbers = Box<dyn FnMut() -> u32>;

/// A haptic arm.
pub struct Arm<L> {
    line: L,
    client: Client,
    machine: String,
    config: Vec<u8>,
    /// How the configuration of a board behind a port is chosen.
    board: Option<Chosen>,
    /// The board had this configuration, or took it: after a loss of power it takes it again.
    agreed: bool,
    reflection: Option<ForceFeedback>,
    every: u16,
    phase: Phase,
    /// Why it does not lead.
    why: String,
    numbers: Numbers,
    reopen: Option<Reopen<L>>,
    reopen_at_us: u64,
    received: Vec<u8>,
    transmit: Vec<u8>,
    /// Time of the line.
    now_us: u64,
    /// Times of loop and line at which they began.
    origin: Option<(u64, u64)>,
    /// The newest report that was looked at.
    newest: Option<u64>,
    standing: Option<MasterTelemetry>,
    felt: VecDeque<Felt>,
    /// What its controller said, in words.
    happened: VecDeque<String>,
}

/// Newtons of a force in 2^-8 N.
fn newtons(force: [i16; COMPONENTS]) -> [f64; COMPONENTS] {
    force.map(|part| f64::from(part) / 256.0)
}

/// What its controller says, in words: it has no axes that could be named.
fn said<T: Describe>(what: &T) -> String {
    let (pose, joints) = (&[], &[]);
    Axes { pose, joints }.describe(what).to_string()
}

fn encoded(machine: &MachineFile) -> Result<Vec<u8>, Error> {
    let encoded = machine.encoded();
    encoded
        .map(|(bytes, _)| bytes)
        .map_err(|error| Error::new(ErrorKind::Internal, error))
}

/// More moments than any two steps can leave.
const MOST_FELT: usize = 10_000;

impl<L: Line> Arm<L> {
    /// Whether a machine file is one of a haptic arm alone.
    ///
    /// # Errors
    /// It is not.
    pub fn check(machine: &MachineFile) -> Result<(), Error> {
        if !machine.is_master() {
            let what = format!(
                "{}: not a haptic arm alone; write role = \"master\", as machines/hand-master.toml has it",
                machine.file
            );
            return Err(Error::new(ErrorKind::BadInput, what));
        }
        Ok(())
    }

    /// The arm of a machine file behind a line. Session numbers must never have been used on it before.
    ///
    /// # Errors
    /// The machine file is not one of a haptic arm alone.
    pub fn new(
        line: L,
        machine: &MachineFile,
        pace: Pace,
        numbers: Numbers,
        reopen: Option<Reopen<L>>,
    ) -> Result<Self, Error> {
        Self::check(machine)?;
        let config = encoded(machine)?;
        let mut options = Options::default();
        options.timing.line_rate = pace.line_rate;
        options.connect_us = 1_000_000;
        let period_us = u32::from(machine.config.period_us.max(1));
        Ok(Self {
            line,
            client: Client::new(options),
            machine: machine.config.name.to_string(),
            config,
            board: None,
            agreed: false,
            reflection: machine.config.haptic.as_ref().map(|arm| arm.reflection),
            every: (pace.every_us / period_us).clamp(1, u32::from(u16::MAX)) as u16,
            phase: Phase::Connecting,
            why: "is being connected".to_string(),
            numbers,
            reopen,
            reopen_at_us: 0,
            received: Vec::new(),
            transmit: Vec::new(),
            now_us: 0,
            origin: None,
            newest: None,
            standing: None,
            felt: VecDeque::new(),
            happened: VecDeque::new(),
        })
    }

    /// The arm's board is behind a port, and keeps its configuration unless this choice allows another one.
    #[must_use]
    pub fn on_board(self, chosen: Chosen) -> Self {
        Self {
            board: Some(chosen),
            ..self
        }
    }

    /// The line.
    pub const fn line_mut(&mut self) -> &mut L {
        &mut self.line
    }

    /// Connects anew.
    fn connect(&mut self, why: String) {
        self.why = why;
        self.phase = Phase::Connecting;
        self.standing = None;
        let number = (self.numbers)();
        self.client.connect(number, self.now_us);
    }

    fn step(&mut self) -> Result<(), Error> {
        self.received.clear();
        match self.line.exchange(&self.transmit, &mut self.received) {
            Ok(now_us) => self.now_us = now_us,
            Err(error) if self.reopen.is_some() => {
                self.why = error.to_string();
                self.phase = Phase::Gone;
                self.standing = None;
                self.reopen_at_us = 0;
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        }
        self.transmit.clear();
        self.client
            .advance(self.now_us, &self.received, &mut self.transmit);
        while let Some(notice) = self.client.poll() {
            self.hear(notice)?;
        }
        Ok(())
    }

    fn hear(&mut self, notice: Notice) -> Result<(), Error> {
        match notice {
            Notice::Connected(welcome) => {
                if welcome.axes > 0 {
                    let what = format!(
                        "{}: \"{}\" is a machine with {} axes, not a haptic arm; --master is for the arm, --port for the machine",
                        self.line.name(),
                        welcome.machine,
                        welcome.axes
                    );
                    return Err(Error::new(ErrorKind::Command, what));
                }
                if let Some(board) = &self.board {
                    let agreed = self.agreed && welcome.config_crc == 0;
                    let decision = board.decide(&welcome).map_err(|error| {
                        let what = error.message.replace("-machine", "-master-machine");
                        Error::new(error.kind, format!("{}: {what}", self.line.name()))
                    })?;
                    match decision {
                        _ if agreed => {}
                        Decision::Active(file) => self.config = encoded(&file)?,
                        Decision::Send(what) if !self.agreed => {
                            eprintln!("{}: {what}", self.line.name());
                        }
                        Decision::Send(_) => {}
                        Decision::Unknown(what) => {
                            let what = what.replace("--machine", "--master-machine");
                            let what = format!("{}: {what}", self.line.name());
                            return Err(Error::new(ErrorKind::Command, what));
                        }
                    }
                    self.agreed = true;
                }
                if let Phase::Asking = self.phase {
                    return Ok(());
                }
                self.phase = Phase::Preparing([
                    self.client.configure(&self.config, false),
                    self.client.request(Command::Enable),
                    self.client
                        .request(Command::MasterTelemetry { every: self.every }),
                ]);
            }
            Notice::Answered { ticket, result, .. } => self.answered(ticket, result)?,
            // The session that was dropped for a new one.
            Notice::Lost(ClientError::Closed) => {}
            Notice::Lost(error) => {
                let why = format!("{}: {error}", self.line.name());
                if let Phase::Asking = self.phase {
                    self.why = error.to_string();
                    self.client.connect((self.numbers)(), self.now_us);
                    return Ok(());
                }
                self.connect(why);
            }
            Notice::Event { period, event } => {
                if matches!(event, Event::Fault(_) | Event::Master(_)) {
                    let text = format!("the arm: {}", said(&event));
                    self.line.happened(period, 2, &text);
                    self.happened.push_back(text);
                }
            }
            Notice::Telemetry(_) | Notice::Refused(_) | Notice::Job(_) => {}
        }
        Ok(())
    }

    fn answered(&mut self, ticket: Ticket, result: Result<(), RequestError>) -> Result<(), Error> {
        let Phase::Preparing([configured, enabled, reports]) = &self.phase else {
            return Ok(());
        };
        // An arm that is on already says that it is.
        let on = matches!(result, Err(RequestError::Refused(Refusal::State(_))));
        let last = ticket == *reports;
        let refused = match result {
            Err(RequestError::Refused(refusal)) if !(ticket == *enabled && on) => refusal,
            _ => {
                if last {
                    self.phase = Phase::Ready;
                }
                return Ok(());
            }
        };
        let name = self.line.name();
        let what = if ticket == *configured {
            format!(
                "{name}: does not take the machine file of \"{}\": {refused:?}; is it switched off, and built for a hand?",
                self.machine
            )
        } else {
            format!("{name}: the haptic arm cannot lead: {}", said(&refused))
        };
        Err(Error::new(ErrorKind::Command, what))
    }

    /// A new report, as a word.
    fn news(&mut self) -> Option<Word> {
        let Phase::Ready = self.phase else {
            return None;
        };
        let standing = *self.client.hand()?;
        if self.newest.replace(standing.period) == Some(standing.period) {
            return None;
        }
        self.standing = Some(standing);
        Some(Word {
            hand: standing.pose,
            age_us: u64::from(self.client.link().round_trip_us()) / 2,
        })
    }

    /// Notes what has come of the force on the tool.
    fn note(&mut self, at_us: u64, news: Option<&Word>) {
        let felt = match (self.line.told_force(), news, &self.standing) {
            (Some(force), ..) => Felt {
                at_us,
                what: What::Told(force),
            },
            (None, Some(word), Some(standing)) => Felt {
                at_us: at_us.saturating_sub(word.age_us),
                what: What::Reflected {
                    force: newtons(standing.feedback),
                    owes: standing.energy < 0,
                },
            },
            _ => return,
        };
        if self.felt.len() < MOST_FELT {
            self.felt.push_back(felt);
        }
    }

    fn open_again(&mut self, now_us: u64) {
        if now_us < self.reopen_at_us {
            return;
        }
        self.reopen_at_us = now_us + REOPEN_US;
        if let Some(Ok(line)) = self.reopen.as_mut().map(|reopen| reopen()) {
            self.line = line;
            self.now_us = 0;
            self.origin = None;
            self.transmit.clear();
            self.phase = Phase::Connecting;
        }
    }
}

impl<L: Line> Source for Arm<L> {
    fn prepare(&mut self) -> Result<(), Error> {
        if self.board.is_none() {
            return Ok(());
        }
        self.step()?;
        self.phase = Phase::Asking;
        self.client.connect((self.numbers)(), self.now_us);
        let begun_us = self.now_us;
        while !self.agreed {
            self.step()?;
            if matches!(self.phase, Phase::Gone) || self.now_us - begun_us > PREPARE_US {
                let what = format!(
                    "{}: the haptic arm does not answer: {}",
                    self.line.name(),
                    self.why
                );
                return Err(Error::new(ErrorKind::Port, what));
            }
        }
        self.phase = Phase::Connecting;
        self.why = "is being connected".to_string();
        Ok(())
    }

    fn advance(&mut self, now_us: u64) -> Result<Option<Word>, Error> {
        if let Phase::Gone = self.phase {
            self.open_again(now_us);
            return Ok(None);
        }
        let (loop_us, line_us) = match self.origin {
            Some(origin) => origin,
            // The line's clock may have run for long before anybody looked at it.
            None => {
                self.step()?;
                if let Phase::Gone = self.phase {
                    return Ok(None);
                }
                let why = std::mem::take(&mut self.why);
                self.connect(why);
                *self.origin.insert((now_us, self.now_us))
            }
        };
        let mut newest = None;
        loop {
            self.step()?;
            if let Phase::Gone = self.phase {
                return Ok(None);
            }
            let at_us = loop_us + self.now_us.saturating_sub(line_us);
            let news = self.news();
            self.note(at_us, news.as_ref());
            newest = news.or(newest);
            if at_us >= now_us {
                return Ok(newest);
            }
        }
    }

    fn standing(&self) -> Standing {
        match (&self.phase, &self.standing) {
            (Phase::Ready, Some(standing)) => match standing.problem {
                None => Standing::Ready,
                Some(problem) => {
                    Standing::Off(format!("the arm is off: {}", said(&Event::Master(problem))))
                }
            },
            (Phase::Ready, None) => Standing::Waiting("has said nothing yet".to_string()),
            _ => Standing::Waiting(self.why.clone()),
        }
    }

    fn feel(&mut self, force: [i16; COMPONENTS]) {
        if let Phase::Ready = self.phase {
            // Without a session nobody would feel it.
            let _ = self.client.feel(force);
        }
    }

    fn feeling(&self) -> Option<Feeling> {
        self.standing.as_ref().map(|standing| Feeling {
            force: newtons(standing.force),
            reflected: newtons(standing.feedback),
        })
    }

    fn felt(&mut self) -> Option<Felt> {
        self.felt.pop_front()
    }

    fn reflection(&self) -> Option<ForceFeedback> {
        self.reflection
    }

    fn reset(&mut self) {
        if let Phase::Ready = self.phase {
            self.client.request(Command::Reset);
            self.client.request(Command::Enable);
        }
    }

    fn happened(&mut self) -> Option<String> {
        self.happened.pop_front()
    }

    fn round_trip_us(&self) -> u32 {
        self.client.link().round_trip_us()
    }
}
