//! One person's dealings with one controller: connect, ask and wait, run a job to its end, stop in time.
//!
//! A [`Session`] owns a [`Line`] and a [`Client`] and moves both on, step by step. On a [`SimLine`] a step is one control period of the
//! simulated machine in virtual time, on a [`PortLine`] it is at most a millisecond of real time; nothing else differs.
//!
//! Misuse: whoever waits for something must go on stepping; a session that is not stepped falls silent, and the controller stops the
//! machine.

mod force;
mod hand;
mod home;
mod job;
mod line;
#[cfg(unix)]
pub mod pil;
mod sim;

pub use force::{LoopChoice, force_of};
pub use hand::{HandCourse, HandSample};

pub use home::way;
pub use home::{has_tool, home_of};
pub use job::EMERGENCY_STOP;
pub use job::{JobEnd, Sent, Unwatched, Watcher};
pub use line::{JobLine, Line, PortLine};
pub use sim::{JobRecording, SimLine, commissioned, rig, rig_around};

use crate::client::{Client, ClientState, JobEnding, Notice, Options, RequestError, Ticket};
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{Command, Event, Fault, Refusal, State, Telemetry};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How much an event matters: 0 is news, 1 a warning, 2 an error.
fn level(event: &Event) -> u8 {
    match event {
        Event::Fault(_)
        | Event::State {
            to: State::Fault | State::EmergencyStop,
            ..
        } => 2,
        Event::State { .. }
        | Event::JobDone { .. }
        | Event::Paused { .. }
        | Event::Homed
        | Event::Tared => 0,
        _ => 1,
    }
}

/// A session number that was never used before, as far as chance can do it.
#[must_use]
pub fn fresh_number() -> u32 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    // The standard library's hasher is keyed by the system's randomness.
    RandomState::new().build_hasher().finish() as u32
}

/// A controller at the other end, and what it said.
pub struct Session<L> {
    line: L,
    client: Client,
    model: Model,
    received: Vec<u8>,
    transmit: Vec<u8>,
    now_us: u64,
    answers: VecDeque<(Ticket, &'static str, Result<(), RequestError>)>,
    ending: Option<JobEnding>,
    /// Period of the newest report of a hand.
    hand: Option<u64>,
    /// Events since the session began, with their control periods.
    pub events: Vec<(u64, Event)>,
    lost: Option<String>,
    refusal: Option<Refusal>,
    /// Name and CRC of the configuration that this session made active.
    configured: Option<(String, u32)>,
    interrupted: Arc<AtomicBool>,
    /// Bytes per second that the line carries; 0 for no bound.
    line_rate: u32,
}

impl<L: Line> Session<L> {
    /// A session over a line; `interrupted` is set when the user wants everything to stop.
    pub fn new(
        line: L,
        machine: &MachineFile,
        options: Options,
        interrupted: Arc<AtomicBool>,
    ) -> Self {
        Self {
            line,
            line_rate: options.timing.line_rate,
            client: Client::new(options),
            model: Model::new(machine),
            received: Vec::new(),
            transmit: Vec::new(),
            now_us: 0,
            answers: VecDeque::new(),
            ending: None,
            hand: None,
            events: Vec::new(),
            lost: None,
            refusal: None,
            configured: None,
            interrupted,
        }
    }

    /// The line.
    pub fn line_mut(&mut self) -> &mut L {
        &mut self.line
    }

    /// The line, at the end.
    pub fn into_line(self) -> L {
        self.line
    }

    /// The client.
    pub fn client_mut(&mut self) -> &mut Client {
        &mut self.client
    }

    /// The geometry, for conversions and sentences.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Goes by another machine file from now on.
    pub fn use_machine(&mut self, machine: &MachineFile) {
        self.model = Model::new(machine);
    }

    /// The machine file of the controller is not known: its axes have no names and no units.
    pub fn forget_axes(&mut self) {
        self.model.forget_axes();
    }

    /// Time of the line, microseconds.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Whether everything is to stop: the user wants it, or the job cannot be recorded any more.
    pub fn interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed) || self.line.recording_is_broken()
    }

    /// One step of line and client; what was said is sorted.
    ///
    /// # Errors
    /// The port broke, or the session with the controller ended.
    pub fn step(&mut self) -> Result<(), Error> {
        self.received.clear();
        self.now_us = self.line.exchange(&self.transmit, &mut self.received)?;
        self.transmit.clear();
        self.client
            .advance(self.now_us, &self.received, &mut self.transmit);
        if let Some(hand) = self.client.hand()
            && self.hand.replace(hand.period) != Some(hand.period)
        {
            self.line.reported_hand(hand);
        }
        while let Some(notice) = self.client.poll() {
            match notice {
                Notice::Answered {
                    ticket,
                    command,
                    result,
                } => self.answers.push_back((ticket, command, result)),
                Notice::Event { period, event } => {
                    let text = self
                        .model
                        .with_axes(|axes| axes.describe(&event).to_string());
                    self.line.happened(period, level(&event), &text);
                    self.events.push((period, event));
                }
                Notice::Job(ending) => self.ending = Some(ending),
                Notice::Lost(error) => self.lost = Some(error.to_string()),
                Notice::Telemetry(telemetry) => self.line.reported(&telemetry),
                Notice::Refused(refusal) => self.refusal = Some(refusal),
                Notice::Connected(_) => {}
            }
        }
        match &self.lost {
            Some(lost) => Err(Error::new(
                ErrorKind::Port,
                format!("{}: {lost}", self.line.name()),
            )),
            None => Ok(()),
        }
    }

    /// Opens the session.
    ///
    /// # Errors
    /// No controller answers, it refuses, or the user gave up.
    pub fn connect(&mut self, number: u32) -> Result<(), Error> {
        self.client.connect(number, self.now_us);
        while *self.client.state() != ClientState::Ready {
            self.step()?;
            if self.interrupted() {
                return Err(Error::new(
                    ErrorKind::Stopped,
                    "stopped before the controller answered",
                ));
            }
        }
        Ok(())
    }

    /// Asks, and waits for the answer.
    ///
    /// # Errors
    /// A refusal, in words, or no answer.
    pub fn ask(&mut self, command: Command) -> Result<(), Error> {
        let ticket = self.client.request(command);
        self.wait_for_answer(ticket)
    }

    /// The answer to a request, if it came; asked once.
    ///
    /// # Errors
    /// A refusal, in words, or no answer.
    pub fn answer(&mut self, ticket: Ticket) -> Option<Result<(), Error>> {
        let mut answers = self.answers.iter();
        let index = answers.position(|(answered, _, _)| *answered == ticket)?;
        let (_, command, result) = self.answers.remove(index)?;
        Some(result.map_err(|error| self.refused(command, &error)))
    }

    /// Waits for the answer to a request.
    ///
    /// # Errors
    /// A refusal, in words, or no answer.
    pub fn wait_for_answer(&mut self, ticket: Ticket) -> Result<(), Error> {
        loop {
            if let Some(index) = self
                .answers
                .iter()
                .position(|(answered, _, _)| *answered == ticket)
                && let Some((_, command, result)) = self.answers.remove(index)
            {
                return result.map_err(|error| self.refused(command, &error));
            }
            self.step()?;
        }
    }

    fn refused(&self, command: &str, error: &RequestError) -> Error {
        match error {
            RequestError::Refused(refusal) => {
                let why = self
                    .model
                    .with_axes(|axes| axes.describe(refusal).to_string());
                Error::new(ErrorKind::Command, format!("{command}: {why}"))
            }
            other => Error::new(ErrorKind::Port, format!("{command}: {other}")),
        }
    }

    /// Makes the machine file the controller's configuration, unless it is already.
    ///
    /// # Errors
    /// A refusal: the controller and this program disagree, or the machine is not disabled.
    pub fn configure(&mut self, machine: &MachineFile) -> Result<(), Error> {
        let (bytes, crc) = machine
            .encoded()
            .map_err(|error| Error::new(ErrorKind::Internal, error))?;
        if self.configuration_crc() == crc {
            return Ok(());
        }
        self.send_configuration(&bytes, false)?;
        self.configured = Some((machine.config.name.to_string(), crc));
        Ok(())
    }

    /// Sends the machine file in any case: the joints have been set up at their presets by hand.
    ///
    /// # Errors
    /// As [`Session::configure`].
    pub fn configure_at_preset(&mut self, machine: &MachineFile) -> Result<(), Error> {
        let (bytes, crc) = machine
            .encoded()
            .map_err(|error| Error::new(ErrorKind::Internal, error))?;
        self.send_configuration(&bytes, true)?;
        self.configured = Some((machine.config.name.to_string(), crc));
        Ok(())
    }

    fn send_configuration(&mut self, bytes: &[u8], at_preset: bool) -> Result<(), Error> {
        let ticket = self.client.configure(bytes, at_preset);
        self.wait_for_answer(ticket)
    }

    /// Name of the machine that the controller is configured as; empty when it is not.
    #[must_use]
    pub fn machine_name(&self) -> String {
        match &self.configured {
            Some((name, _)) => name.clone(),
            None => self
                .client
                .controller()
                .map(|welcome| welcome.machine.to_string())
                .unwrap_or_default(),
        }
    }

    /// CRC of the controller's configuration; 0 when there is none.
    #[must_use]
    pub fn configuration_crc(&self) -> u32 {
        let welcomed = self.client.controller().map(|welcome| welcome.config_crc);
        let sent = self.configured.as_ref().map(|(_, crc)| *crc);
        sent.or(welcomed).unwrap_or(0)
    }

    /// How things stand now.
    ///
    /// # Errors
    /// No answer.
    pub fn status(&mut self) -> Result<Telemetry, Error> {
        // Telemetry made before an event may come after it: what is told must be newer than both.
        let told = self.client.telemetry().map(|telemetry| telemetry.period);
        let happened = self.events.last().map(|(period, _)| *period);
        let before = told.max(happened);
        self.ask(Command::Status)?;
        let mut again = self.now_us + 2_000_000;
        loop {
            if let Some(telemetry) = self.client.telemetry()
                && Some(telemetry.period) > before
            {
                return Ok(telemetry.clone());
            }
            if self.now_us > again {
                // One telemetry frame may be lost on a bad line; asking again is cheap.
                again = self.now_us + 2_000_000;
                self.ask(Command::Status)?;
            }
            self.step()?;
        }
    }

    /// Enables the drives if they are off.
    ///
    /// # Errors
    /// A refusal: a latched fault or emergency stop, an input, a pose out of reach.
    pub fn enable(&mut self) -> Result<(), Error> {
        match self.status()?.state {
            State::Disabled | State::Fault | State::EmergencyStop => self.ask(Command::Enable),
            _ => Ok(()),
        }
    }

    /// Homes, and waits until it is done.
    ///
    /// # Errors
    /// A refusal, a fault or an emergency stop while homing, or the user stopped it.
    pub fn home(&mut self) -> Result<(), Error> {
        let first = self.events.len();
        self.ask(Command::Home)?;
        let mut stopping = false;
        loop {
            self.step()?;
            if self.interrupted() && !stopping {
                stopping = true;
                self.client.urgent_stop();
            }
            for (_, event) in &self.events[first..] {
                match event {
                    Event::Homed => return Ok(()),
                    Event::Fault(fault) => return Err(self.fault(fault)),
                    Event::State {
                        from: State::Homing,
                        to: State::EmergencyStop,
                        ..
                    } => return Err(Error::new(ErrorKind::Fault, EMERGENCY_STOP)),
                    Event::State {
                        from: State::Homing,
                        to,
                        ..
                    } if *to != State::Homing => {
                        // The event of success comes before the change of state.
                        return Err(Error::new(
                            ErrorKind::Stopped,
                            "homing was stopped; the reference is not found",
                        ));
                    }
                    _ => {}
                }
            }
        }
    }

    /// A refusal of a command that asks for no answer (a jog), in words, once.
    pub fn refusal(&mut self) -> Option<String> {
        let refusal = self.refusal.take()?;
        Some(
            self.model
                .with_axes(|axes| axes.describe(&refusal).to_string()),
        )
    }

    /// A fault as an error of the command.
    pub fn fault(&self, fault: &Fault) -> Error {
        Error::new(
            ErrorKind::Fault,
            format!("machine fault: {}", self.sentence(fault)),
        )
    }

    /// A fault in words.
    pub fn sentence(&self, fault: &Fault) -> String {
        self.model
            .with_axes(|axes| axes.describe(fault).to_string())
    }
}
