//! A session with one controller: connect, agree on the configuration, enable, home, run a job,
//! stop in time.
//!
//! A [`Session`] owns a [`Line`] and a [`Client`]. It is a state machine that never waits:
//! [`Session::step`] exchanges bytes once and sorts what was received into acknowledgements,
//! events, and the end of a job. On a [`SimLine`] a step is one control period of the simulated
//! machine in virtual time, on a [`PortLine`] at most a millisecond of real time.
//!
//! What takes several messages is a [`Procedure`] ([`Acknowledgement`], [`StatusQuery`],
//! [`Homing`]) or a [`JobRun`]. Programs that wait for the result use [`Session::complete`] and the
//! methods on it; programs that serve an operator meanwhile advance the procedure after each step.
//! A [`Startup`] is sent each time the controller answers, and [`Session::with_reconnection`] opens
//! a lost session again. Owners that handle each [`Notification`] in order use
//! [`Session::exchange`] and [`Session::poll`] in place of [`Session::step`].
//!
//! The session prints nothing: what the user should read is in [`Session::next_notice`].
//!
//! Callers must keep stepping: a session that is not stepped sends no keep-alive frames, and the
//! controller stops the machine.

mod force;
mod haptic_trace;
mod home;
mod job;
mod line;
#[cfg(unix)]
pub mod pil;
#[cfg(unix)]
pub mod pins;
mod procedure;
mod run_time;
mod sim;
mod startup;

pub use force::{ForceLoopChanges, find_force_config};
pub use haptic_trace::{HapticTrace, HapticTraceSample};
pub use home::{HOME_JOB, check_has_tool, find_home_pose, plan_straight_move};
pub use job::{BytesSent, EMERGENCY_STOP, JobEnd, JobObserver, JobRun, JobStatus, NoObserver};
pub use line::{JobLine, Line, PortLine};
pub use procedure::{Acknowledgement, Homing, Procedure, StatusQuery};
pub use run_time::{RunTime, TimeProfile, TimeTable};
pub use sim::{JobRecording, SimLine, clamp, commissioned, rig, rig_around};
pub use startup::{Numbers, SessionPhase, Startup, check_period};

use crate::client::{Client, ClientState, JobEnding, Notification, Options, RequestError, Ticket};
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{Command, Event, Fault, Kept, Refusal, State, Telemetry};
use haptimill_protocol::text::Describe;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Severity of an event: 0 is information, 1 a warning, 2 an error.
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
        | Event::ProbedAt { .. }
        | Event::Probed { .. }
        | Event::Tared => 0,
        _ => 1,
    }
}

/// A random session number: a repetition is very unlikely.
#[must_use]
pub fn fresh_number() -> u32 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    // The standard library keys its hasher with random numbers of the system.
    RandomState::new().build_hasher().finish() as u32
}

/// A session with a controller, and what was received in it.
pub struct Session<L> {
    line: L,
    client: Client,
    model: Model,
    received: Vec<u8>,
    transmit: Vec<u8>,
    now_us: u64,
    answers: VecDeque<(Ticket, &'static str, Result<(), RequestError>)>,
    ending: Option<JobEnding>,
    /// Period of the newest telemetry of a master.
    master: Option<u64>,
    /// Events since the session began, with their control periods.
    pub events: Vec<(u64, Event)>,
    startup: Option<Startup>,
    /// Numbers of the next sessions, if a lost one is opened again.
    numbers: Option<Numbers>,
    phase: SessionPhase,
    /// Why the session is not ready.
    reason: String,
    /// The controller has the configuration of the startup.
    is_configured: bool,
    /// An emergency stop that waits for the answer of a controller.
    is_emergency_pending: bool,
    notices: VecDeque<String>,
    /// Why the session ended for good.
    lost: Option<String>,
    refusal: Option<Refusal>,
    /// Name and CRC of the configuration that this session activated.
    configured: Option<(String, u32)>,
    /// CRC of the configuration that the board keeps by this session.
    stored: Option<u32>,
    interrupted: Arc<AtomicBool>,
    /// Bandwidth of the line, bytes per second; 0 for no limit.
    line_rate: u32,
    /// Telemetry of jobs that is kept, and its interval in periods.
    telemetry_log: Option<(u16, Vec<Telemetry>)>,
}

impl<L: Line> Session<L> {
    /// A session over a line; `interrupted` is set when the user stops the program.
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
            master: None,
            events: Vec::new(),
            startup: None,
            numbers: None,
            phase: SessionPhase::Closed,
            reason: String::new(),
            is_configured: false,
            is_emergency_pending: false,
            notices: VecDeque::new(),
            lost: None,
            refusal: None,
            configured: None,
            stored: None,
            interrupted,
            telemetry_log: None,
        }
    }

    /// Keeps the telemetry of the jobs from now on, one frame every `every` control periods.
    pub fn keep_telemetry(&mut self, every: u16) {
        self.telemetry_log = Some((every, Vec::new()));
    }

    /// The telemetry since [`Session::keep_telemetry`] or the last call.
    pub fn take_telemetry(&mut self) -> Vec<Telemetry> {
        let log = self.telemetry_log.as_mut();
        log.map(|(_, frames)| std::mem::take(frames))
            .unwrap_or_default()
    }

    /// The line.
    pub const fn line(&self) -> &L {
        &self.line
    }

    /// The line, for changes.
    pub const fn line_mut(&mut self) -> &mut L {
        &mut self.line
    }

    /// Ends the session and returns the line.
    pub fn into_line(self) -> L {
        self.line
    }

    /// The client.
    pub const fn client(&self) -> &Client {
        &self.client
    }

    /// The client.
    pub fn client_mut(&mut self) -> &mut Client {
        &mut self.client
    }

    /// The geometry and the units of the machine.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Uses another machine file from now on.
    pub fn set_machine(&mut self, machine: &MachineFile) {
        self.model = Model::new(machine);
    }

    /// Describes axes without names and units: the machine file of the controller is not known.
    pub fn clear_axes(&mut self) {
        self.model.clear_axes();
    }

    /// Time of the line, microseconds.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Whether the machine must stop: the user stopped the program, or the recording failed.
    pub fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed) || self.line.is_recording_broken()
    }

    /// Exchanges bytes once, and sorts what was received.
    ///
    /// # Errors
    /// The port failed, the session with the controller ended, or the controller refuses the
    /// [`Startup`].
    pub fn step(&mut self) -> Result<(), Error> {
        self.exchange()?;
        while let Some(notification) = self.poll()? {
            match notification {
                Notification::Answered {
                    ticket,
                    command,
                    result,
                } => self.answers.push_back((ticket, command, result)),
                Notification::Event { period, event } => self.events.push((period, event)),
                Notification::Job(ending) => self.ending = Some(ending),
                Notification::Refused(refusal) => self.refusal = Some(refusal),
                Notification::Telemetry(telemetry) => {
                    if let Some((_, frames)) = &mut self.telemetry_log {
                        frames.push(*telemetry);
                    }
                }
                Notification::Connected(_) | Notification::Lost(_) => {}
            }
        }
        match &self.lost {
            Some(lost) => Err(Error::new(ErrorKind::Port, lost)),
            None => Ok(()),
        }
    }

    /// Exchanges bytes once; while the port is lost, advances its opening instead. The caller must
    /// then take every notification with [`Session::poll`].
    ///
    /// # Errors
    /// The port failed and cannot be opened again.
    pub fn exchange(&mut self) -> Result<(), Error> {
        if self.phase == SessionPhase::Disconnected {
            self.open_port();
            return Ok(());
        }
        self.received.clear();
        match self.line.exchange(&self.transmit, &mut self.received) {
            Ok(now_us) => self.now_us = now_us,
            Err(error) => return self.lose_port(error),
        }
        self.transmit.clear();
        self.client
            .advance(self.now_us, &self.received, &mut self.transmit);
        if let Some(master) = self.client.master()
            && self.master.replace(master.period) != Some(master.period)
        {
            self.line.record_master(master);
        }
        Ok(())
    }

    /// Encodes what was requested since the last exchange, so that the next exchange sends it. A
    /// session without this call sends it one exchange later.
    pub fn flush(&mut self) {
        if self.phase != SessionPhase::Disconnected {
            self.client.advance(self.now_us, &[], &mut self.transmit);
        }
    }

    /// The next notification that is not about the startup.
    ///
    /// # Errors
    /// The controller refuses the [`Startup`].
    pub fn poll(&mut self) -> Result<Option<Notification>, Error> {
        while let Some(notification) = self.client.poll() {
            match &notification {
                Notification::Connected(welcome) => self.start(welcome)?,
                Notification::Answered { ticket, result, .. } => {
                    if self.acknowledge_startup(*ticket, result)? {
                        continue;
                    }
                }
                Notification::Event { period, event } => {
                    let text = self.describe(event);
                    self.line.record_event(*period, level(event), &text);
                }
                Notification::Telemetry(telemetry) => self.line.record_telemetry(telemetry),
                Notification::Lost(error) => {
                    if !self.lose_session(error) {
                        continue;
                    }
                }
                Notification::Job(_) | Notification::Refused(_) => {}
            }
            return Ok(Some(notification));
        }
        Ok(None)
    }

    /// Stops the machine: the next exchange sends the out-of-band stop, which needs no session. It
    /// is repeated, also in the next session, until the controller reports standstill.
    pub fn stop(&mut self) {
        self.client.stop_out_of_band();
    }

    /// As [`Session::stop`]; then switches the drives off, as the first request of the next session
    /// if none is open.
    pub fn emergency_stop(&mut self) {
        self.stop();
        self.is_emergency_pending = !self.send_emergency_stop();
    }

    /// Requests the emergency stop; false without a session.
    fn send_emergency_stop(&mut self) -> bool {
        if self.is_open() {
            self.client.request(Command::EmergencyStop);
        }
        self.is_open()
    }

    /// Whether a stop is repeated until the controller reports standstill.
    pub fn is_stopping(&self) -> bool {
        self.client.repeated_stop().0
    }

    /// Whether the controller has answered and the link works.
    pub fn is_open(&self) -> bool {
        *self.client.state() == ClientState::Ready
    }

    /// Whether an emergency stop waits for the next session.
    pub const fn is_emergency_pending(&self) -> bool {
        self.is_emergency_pending
    }

    /// The next message for the user.
    pub fn next_notice(&mut self) -> Option<String> {
        self.notices.pop_front()
    }

    pub(crate) fn notify(&mut self, text: impl Into<String>) {
        self.notices.push_back(text.into());
    }

    /// Describes a value of the protocol with the names and units of the axes.
    pub fn describe<T: Describe>(&self, value: &T) -> String {
        self.model
            .with_axes(|axes| axes.describe(value).to_string())
    }

    /// Takes the acknowledgement of a request, if it was received.
    ///
    /// # Errors
    /// The controller refused the request or did not answer.
    pub fn answer(&mut self, ticket: Ticket) -> Option<Result<(), Error>> {
        let mut answers = self.answers.iter();
        let index = answers.position(|(answered, _, _)| *answered == ticket)?;
        let (_, command, result) = self.answers.remove(index)?;
        Some(result.map_err(|error| self.refused(command, &error)))
    }

    fn refused(&self, command: &str, error: &RequestError) -> Error {
        match error {
            RequestError::Refused(refusal) => Error::new(
                ErrorKind::Command,
                format!("{command}: {}", self.why(refusal)),
            ),
            other => Error::new(ErrorKind::Port, format!("{command}: {other}")),
        }
    }

    /// Why the controller refused a command, with the fault if that is why.
    fn why(&self, refusal: &Refusal) -> String {
        let why = self.describe(refusal);
        match self.cause(refusal) {
            Some(fault) => format!("{why} ({})", self.describe(&fault)),
            None => why,
        }
    }

    /// The fault for which a command was refused.
    fn cause(&self, refusal: &Refusal) -> Option<Fault> {
        if *refusal != Refusal::State(State::Fault) {
            return None;
        }
        let reported = self.client.telemetry().and_then(|report| report.fault);
        let events = self.events.iter().rev();
        let fault = |(_, event): &(u64, Event)| match event {
            Event::Fault(fault) => Some(*fault),
            _ => None,
        };
        reported.or_else(|| events.map(fault).find_map(|fault| fault))
    }

    /// Makes the machine file the active configuration of the controller, unless it is already.
    ///
    /// # Errors
    /// The controller and this program disagree, or the machine is not disabled.
    pub fn configure(&mut self, machine: &MachineFile) -> Result<(), Error> {
        self.send_configuration(machine, false)
    }

    /// Sends the machine file in any case: the operator has placed the joints at their presets.
    ///
    /// # Errors
    /// As [`Session::configure`].
    pub fn configure_at_preset(&mut self, machine: &MachineFile) -> Result<(), Error> {
        self.send_configuration(machine, true)
    }

    fn send_configuration(&mut self, machine: &MachineFile, at_preset: bool) -> Result<(), Error> {
        if let Some(board) = self.line.board() {
            board.check_machine(machine)?;
        }
        if let Some(welcome) = self.client.controller() {
            startup::check_period(&self.line.name(), welcome, machine)?;
        }
        let (bytes, crc) = machine
            .encoded()
            .map_err(|error| Error::new(ErrorKind::Internal, error))?;
        if self.configuration_crc() == crc && !at_preset {
            return Ok(());
        }
        let ticket = self.client.configure(&bytes, at_preset);
        self.wait_for_acknowledgement(ticket)?;
        self.configured = Some((machine.config.name.to_string(), crc));
        Ok(())
    }

    /// Lets the board keep the machine file, which becomes the active configuration. After a reset
    /// the board activates it by itself.
    ///
    /// # Errors
    /// As [`Session::configure`]; the drives are on; the board keeps no configuration.
    pub fn store(&mut self, machine: &MachineFile) -> Result<(), Error> {
        self.configure(machine)?;
        let (bytes, crc) = machine
            .encoded()
            .map_err(|error| Error::new(ErrorKind::Internal, error))?;
        let ticket = self.client.store(&bytes);
        self.wait_for_acknowledgement(ticket)?;
        self.stored = Some(crc);
        Ok(())
    }

    /// What the board keeps without a supply.
    #[must_use]
    pub fn kept(&self) -> Kept {
        let welcomed = self.client.controller().map(|welcome| welcome.kept);
        let stored = self.stored.map(Kept::Config);
        stored.or(welcomed).unwrap_or_default()
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

    /// Takes the refusal of a command without acknowledgement (a jog).
    pub fn refusal(&mut self) -> Option<String> {
        let refusal = self.refusal.take()?;
        Some(self.describe(&refusal))
    }

    /// The error of a command that a fault ended.
    pub fn fault(&self, fault: &Fault) -> Error {
        Error::new(
            ErrorKind::Fault,
            format!("machine fault: {}", self.describe(fault)),
        )
    }
}

#[cfg(test)]
mod tests;
