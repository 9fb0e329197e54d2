//! How a session becomes ready, and how it becomes ready again after the link is lost.
//!
//! ```text
//! Closed -> Connecting -> Starting -> Ready
//!              ^  ^----------+----------|     the link is lost
//!              |-- Disconnected <-------|     the port is lost, until it can be opened again
//! ```
//!
//! A session without a [`Startup`] sends nothing by itself: it is ready when the controller
//! answers. A session without [`Session::with_reconnection`] ends with its link: [`Session::step`]
//! fails. With it, a silent controller is asked again over the same port; a port that fails, or
//! behind which no controller answers, is closed and opened again.

use super::{Line, Session};
use crate::choice::{Chosen, Decision};
use crate::client::{ClientError, RequestError, Ticket};
use crate::port::PortError;
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::frame::crc32;
use haptimill_protocol::message::{Command, Refusal, Welcome};

/// Progress of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SessionPhase {
    /// No session is open.
    Closed,
    /// The controller is asked for its configuration; nothing is sent to it.
    Identifying,
    /// The session is being opened.
    Connecting,
    /// The requests of the [`Startup`] wait for their acknowledgements, in this order.
    Starting(Vec<Ticket>),
    /// The session is open, and the requests of the startup are acknowledged.
    Ready,
    /// The port is closed; each exchange advances its opening.
    Disconnected,
}

/// What a session sends each time the controller answers: the configuration, then commands.
#[derive(Debug, Clone)]
pub struct Startup {
    machine: String,
    is_master: bool,
    config: Vec<u8>,
    file: MachineFile,
    /// How the configuration of a board behind a port is chosen.
    board: Option<Chosen>,
    /// The board had this configuration or accepted it: after a loss of power it is sent again.
    has_agreed: bool,
    commands: Vec<Command>,
    /// A refused request is a notice, and the session becomes ready all the same.
    allows_refusal: bool,
}

impl Startup {
    /// The configuration of a machine file, then commands. An enable command may find the drives
    /// enabled.
    ///
    /// # Errors
    /// The machine file cannot be encoded.
    pub fn new(
        machine: &MachineFile,
        board: Option<Chosen>,
        commands: Vec<Command>,
    ) -> Result<Self, Error> {
        Ok(Self {
            machine: machine.config.name.to_string(),
            is_master: machine.is_master(),
            config: encode(machine)?,
            file: machine.clone(),
            board,
            has_agreed: false,
            commands,
            allows_refusal: false,
        })
    }

    /// Lets the session become ready when the controller refuses a request, for an operator who can
    /// still stop the machine then. The refusal is a notice; see [`Session::is_configured`].
    #[must_use]
    pub fn allowing_refusal(mut self) -> Self {
        self.allows_refusal = true;
        self
    }

    /// Whether the configuration of a board behind a port has to be agreed upon.
    #[must_use]
    pub const fn has_board(&self) -> bool {
        self.board.is_some()
    }

    /// Decides which configuration the controller gets, and returns a message about it.
    fn agree(&mut self, line: &str, welcome: &Welcome) -> Result<Option<String>, Error> {
        let named = |what: &str| format!("{line}: {what}");
        let Some(board) = &self.board else {
            return Ok(None);
        };
        if board.is_second && welcome.axes > 0 {
            let what = format!(
                "\"{}\" is a machine with {} axes, not a haptic arm; \
                 --master is for the arm, --port for the machine",
                welcome.machine, welcome.axes
            );
            return Err(Error::new(ErrorKind::Command, named(&what)));
        }
        let decision = board
            .decide(welcome)
            .map_err(|error| Error::new(error.kind, named(&error.message)))?;
        let mut message = None;
        match decision {
            _ if self.has_agreed && welcome.config_crc == 0 => {}
            // The built-in haptic arm is a known configuration, too.
            Decision::Active(file) if file.is_master() != self.is_master => {
                let what = format!(
                    "the board is configured as \"{}\"; give its machine file with --machine FILE",
                    welcome.machine
                );
                return Err(Error::new(ErrorKind::Command, named(&what)));
            }
            Decision::Active(file) => self.config = encode(&file)?,
            Decision::Send(what) => message = Some(named(&what)),
            Decision::Unknown(what) => return Err(Error::new(ErrorKind::Command, named(&what))),
        }
        self.has_agreed = true;
        Ok(message)
    }
}

/// Checks that a controller has the control period of a machine: its image has a fixed one.
///
/// # Errors
/// The periods differ.
pub fn check_period(line: &str, welcome: &Welcome, machine: &MachineFile) -> Result<(), Error> {
    let (board, file) = (welcome.period_us, machine.config.period_us);
    if board == file {
        return Ok(());
    }
    let name = &machine.file;
    let what = format!(
        "{line}: the control period of the board is {board} us, and {name} has period_us = {file}; \
         set it to {board}, or write an image with a period of {file} us into the board"
    );
    Err(Error::new(ErrorKind::BadInput, what))
}

fn encode(machine: &MachineFile) -> Result<Vec<u8>, Error> {
    let encoded = machine.encoded();
    encoded
        .map(|(bytes, _)| bytes)
        .map_err(|error| Error::new(ErrorKind::Internal, error))
}

/// Gives the number of the next session, which was never used with this controller before.
pub type Numbers = Box<dyn FnMut() -> u32>;

impl<L: Line> Session<L> {
    /// Sends a configuration and commands each time the controller answers.
    #[must_use]
    pub fn with_startup(mut self, startup: Startup) -> Self {
        self.startup = Some(startup);
        self
    }

    /// Opens the session again when it is lost, and its port where [`Line::close`] allows it.
    #[must_use]
    pub fn with_reconnection(mut self, numbers: Numbers) -> Self {
        self.numbers = Some(numbers);
        self
    }

    /// Begins with a line that is not open: each exchange advances its opening, and the session
    /// begins when it is open. Needs [`Session::with_reconnection`].
    #[must_use]
    pub fn with_closed_line(mut self) -> Self {
        self.phase = SessionPhase::Disconnected;
        self
    }

    /// The startup.
    pub fn startup_mut(&mut self) -> Option<&mut Startup> {
        self.startup.as_mut()
    }

    /// Progress of the session.
    pub const fn phase(&self) -> &SessionPhase {
        &self.phase
    }

    /// Why the session is not ready, if a reason is known.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// Begins to open a session. `number` must never have been used with this controller before.
    pub fn begin(&mut self, number: u32) {
        self.phase = SessionPhase::Connecting;
        self.is_configured = false;
        self.client.connect(number, self.now_us);
    }

    /// Opens a session and waits until it is ready.
    ///
    /// # Errors
    /// No controller answers, it refuses, or the user stopped it.
    pub fn connect(&mut self, number: u32) -> Result<(), Error> {
        self.begin(number);
        while self.phase != SessionPhase::Ready {
            self.step()?;
            if self.is_interrupted() {
                return Err(Error::new(
                    ErrorKind::Stopped,
                    "stopped before the controller answered",
                ));
            }
        }
        Ok(())
    }

    /// Opens the session with the next number of [`Session::with_reconnection`]; does nothing
    /// without it.
    pub fn begin_next(&mut self) {
        if let Some(numbers) = &mut self.numbers {
            let number = numbers();
            self.begin(number);
        }
    }

    /// Whether the controller has the configuration of the startup.
    pub const fn is_configured(&self) -> bool {
        self.is_configured
    }

    /// Whether the controller had that configuration before this session: other hosts may have
    /// changed settings since.
    pub fn was_configured(&self) -> bool {
        let active = self.client.controller().map(|welcome| welcome.config_crc);
        let startup = self.startup.as_ref();
        startup.is_some_and(|startup| active == Some(crc32(&startup.config)))
    }

    /// Sends the startup again in an open session: the controller refused it before.
    ///
    /// # Errors
    /// As [`Session::poll`].
    pub fn restart(&mut self) -> Result<(), Error> {
        match self.client.controller().cloned() {
            Some(welcome) if self.phase == SessionPhase::Ready => self.start(&welcome),
            _ => Ok(()),
        }
    }

    /// Agrees on the configuration with the controller, sends nothing, and waits for that.
    ///
    /// # Errors
    /// The board is configured as another machine, or does not answer within a time.
    pub fn identify(&mut self, timeout_us: u64) -> Result<(), Error> {
        self.step()?;
        self.begin_next();
        self.phase = SessionPhase::Identifying;
        let begun_us = self.now_us;
        while !self
            .startup
            .as_ref()
            .is_none_or(|startup| startup.has_agreed)
        {
            self.step()?;
            if self.phase == SessionPhase::Disconnected || self.now_us - begun_us > timeout_us {
                let what = format!(
                    "{}: the controller does not answer: {}",
                    self.line.name(),
                    self.reason
                );
                return Err(Error::new(ErrorKind::Port, what));
            }
        }
        self.phase = SessionPhase::Closed;
        self.reason.clear();
        Ok(())
    }

    /// Advances the opening of a closed port.
    pub(super) fn open_port(&mut self) {
        match self.line.open() {
            Ok(None) => {}
            Ok(Some(now_us)) => {
                self.now_us = now_us;
                self.transmit.clear();
                self.begin_next();
            }
            Err(error) => self.reason = error.to_string(),
        }
    }

    /// An error of the port: final, unless the port can be opened again.
    pub(super) fn lose_port(&mut self, error: PortError) -> Result<(), Error> {
        if self.numbers.is_none() || !self.line.close() {
            return Err(error.into());
        }
        self.reason = error.to_string();
        self.phase = SessionPhase::Disconnected;
        self.is_configured = false;
        self.client.close();
        Ok(())
    }

    /// The session with the controller ended. False if that was known before.
    pub(super) fn lose_session(&mut self, error: &ClientError) -> bool {
        if *error == ClientError::Closed && self.phase != SessionPhase::Disconnected {
            // The session was replaced by a new one.
            return false;
        }
        if self.phase == SessionPhase::Disconnected {
            return true;
        }
        let text = format!("{}: {error}", self.line.name());
        if self.numbers.is_none() {
            self.phase = SessionPhase::Closed;
            self.lost = Some(text);
            return true;
        }
        let is_identifying = self.phase == SessionPhase::Identifying;
        self.reason = if is_identifying {
            error.to_string()
        } else {
            text
        };
        let is_answering = matches!(
            error,
            ClientError::Silent { .. } | ClientError::Stalled { .. }
        );
        if !is_identifying && !is_answering && self.line.close() {
            self.phase = SessionPhase::Disconnected;
            self.is_configured = false;
            return true;
        }
        self.begin_next();
        if is_identifying {
            self.phase = SessionPhase::Identifying;
        }
        true
    }

    /// The controller answered.
    pub(super) fn start(&mut self, welcome: &Welcome) -> Result<(), Error> {
        if std::mem::take(&mut self.is_emergency_pending) {
            self.send_emergency_stop();
        }
        let name = self.line.name();
        let Some(startup) = &mut self.startup else {
            self.phase = SessionPhase::Ready;
            return Ok(());
        };
        let message = startup.agree(&name, welcome)?;
        self.notices.extend(message);
        if self.phase == SessionPhase::Identifying {
            return Ok(());
        }
        if let Some(board) = self.line.board() {
            board.check_machine(&startup.file)?;
        }
        check_period(&name, welcome, &startup.file)?;
        let mut tickets = vec![self.client.configure(&startup.config, false)];
        for command in &startup.commands {
            tickets.push(self.client.request(command.clone()));
        }
        self.phase = SessionPhase::Starting(tickets);
        Ok(())
    }

    /// Takes the acknowledgement of a request of the startup; false if the request is none.
    pub(super) fn acknowledge_startup(
        &mut self,
        ticket: Ticket,
        result: &Result<(), RequestError>,
    ) -> Result<bool, Error> {
        let (SessionPhase::Starting(tickets), Some(startup)) = (&self.phase, &self.startup) else {
            return Ok(false);
        };
        let Some(index) = tickets.iter().position(|pending| *pending == ticket) else {
            return Ok(false);
        };
        if matches!(result, Err(RequestError::Lost(_))) {
            return Ok(true);
        }
        let command = index.checked_sub(1).map(|index| &startup.commands[index]);
        let is_last = index + 1 == tickets.len();
        if command.is_none() {
            self.is_configured = result.is_ok();
        }
        match (result, command) {
            // The drives are enabled already.
            (Err(RequestError::Refused(Refusal::State(_))), Some(Command::Enable)) => {}
            (Err(RequestError::Refused(refusal)), command) => {
                let name = self.line.name();
                let why = self.describe(refusal);
                let what = match command {
                    None => format!(
                        "{name}: the controller refuses the machine file of \"{}\": {why}; \
                         disable its drives, and use an image that is built for this machine",
                        startup.machine
                    ),
                    Some(command) => format!("{name}: {}: {why}", command.name()),
                };
                if !startup.allows_refusal {
                    return Err(Error::new(ErrorKind::Command, what));
                }
                self.notify(what);
            }
            _ => {}
        }
        if is_last {
            self.phase = SessionPhase::Ready;
        }
        Ok(true)
    }
}
