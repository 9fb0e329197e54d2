//! How a session becomes ready, and how it becomes ready again after the link is lost.
//!
//! ```text
//! Closed -> Connecting -> Starting -> Ready
//!              ^  ^----------+----------|     the link is lost
//!              |-- Disconnected <-------|     the port is lost, until it can be opened again
//! ```
//!
//! A session without a [`Startup`] sends nothing by itself: it is ready when the controller
//! answers. A session without a [`Reconnection`] ends with its link: [`Session::step`] fails.

use super::{Line, Session};
use crate::board::{Chosen, Decision};
use crate::client::{ClientError, RequestError, Ticket};
use crate::port::PortError;
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, Refusal, Welcome};

/// Progress of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Phase {
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
    /// The port failed; see [`Session::reopen`].
    Disconnected,
}

/// What a session sends each time the controller answers: the configuration, then commands.
#[derive(Debug, Clone)]
pub struct Startup {
    machine: String,
    is_master: bool,
    config: Vec<u8>,
    /// How the configuration of a board behind a port is chosen.
    board: Option<Chosen>,
    /// The board had this configuration or accepted it: after a loss of power it is sent again.
    has_agreed: bool,
    commands: Vec<Command>,
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
            board,
            has_agreed: false,
            commands,
        })
    }

    /// Whether the configuration of a board behind a port has to be agreed upon.
    #[must_use]
    pub const fn has_board(&self) -> bool {
        self.board.is_some()
    }

    /// Decides which configuration the controller gets.
    fn agree(&mut self, line: &str, welcome: &Welcome) -> Result<(), Error> {
        if self.is_master && welcome.axes > 0 {
            let what = format!(
                "{line}: \"{}\" is a machine with {} axes, not a haptic arm; \
                 --master is for the arm, --port for the machine",
                welcome.machine, welcome.axes
            );
            return Err(Error::new(ErrorKind::Command, what));
        }
        let Some(board) = &self.board else {
            return Ok(());
        };
        let named = |what: &str| format!("{line}: {what}");
        let decision = board
            .decide(welcome)
            .map_err(|error| Error::new(error.kind, named(&error.message)))?;
        match decision {
            _ if self.has_agreed && welcome.config_crc == 0 => {}
            Decision::Active(file) => self.config = encode(&file)?,
            Decision::Send(what) if !self.has_agreed => eprintln!("{}", named(&what)),
            Decision::Send(_) => {}
            Decision::Unknown(what) => return Err(Error::new(ErrorKind::Command, named(&what))),
        }
        self.has_agreed = true;
        Ok(())
    }
}

fn encode(machine: &MachineFile) -> Result<Vec<u8>, Error> {
    let encoded = machine.encoded();
    encoded
        .map(|(bytes, _)| bytes)
        .map_err(|error| Error::new(ErrorKind::Internal, error))
}

/// Opens a port that failed.
pub type Reopen<L> = Box<dyn FnMut() -> Result<L, PortError>>;

/// Gives the number of the next session.
pub type Numbers = Box<dyn FnMut() -> u32>;

/// A session that is opened again when it is lost.
pub struct Reconnection<L> {
    /// Numbers that were never used with this controller before.
    pub numbers: Numbers,
    /// Opens the port again; without it an error of the port ends the session.
    pub reopen: Option<Reopen<L>>,
}

/// Time between two attempts to open a port that failed, microseconds.
const REOPEN_US: u64 = 500_000;

impl<L: Line> Session<L> {
    /// Sends a configuration and commands each time the controller answers.
    #[must_use]
    pub fn with_startup(mut self, startup: Startup) -> Self {
        self.startup = Some(startup);
        self
    }

    /// Opens the session again when it is lost.
    #[must_use]
    pub fn with_reconnection(mut self, reconnection: Reconnection<L>) -> Self {
        self.reconnection = Some(reconnection);
        self
    }

    /// The startup.
    pub fn startup_mut(&mut self) -> Option<&mut Startup> {
        self.startup.as_mut()
    }

    /// Progress of the session.
    pub const fn phase(&self) -> &Phase {
        &self.phase
    }

    /// Why the session is not ready, if a reason is known.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// Begins to open a session. `number` must never have been used with this controller before.
    pub fn begin(&mut self, number: u32) {
        self.phase = Phase::Connecting;
        self.client.connect(number, self.now_us);
    }

    /// Opens a session and waits until it is ready.
    ///
    /// # Errors
    /// No controller answers, it refuses, or the user stopped it.
    pub fn connect(&mut self, number: u32) -> Result<(), Error> {
        self.begin(number);
        while self.phase != Phase::Ready {
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

    /// Opens the session with the next number of the [`Reconnection`]; does nothing without one.
    pub fn begin_next(&mut self) {
        if let Some(reconnection) = &mut self.reconnection {
            let number = (reconnection.numbers)();
            self.begin(number);
        }
    }

    /// Agrees on the configuration with the controller, sends nothing, and waits for that.
    ///
    /// # Errors
    /// The board is configured as another machine, or does not answer within a time.
    pub fn identify(&mut self, timeout_us: u64) -> Result<(), Error> {
        self.step()?;
        self.begin_next();
        self.phase = Phase::Identifying;
        let begun_us = self.now_us;
        while !self
            .startup
            .as_ref()
            .is_none_or(|startup| startup.has_agreed)
        {
            self.step()?;
            if self.phase == Phase::Disconnected || self.now_us - begun_us > timeout_us {
                let what = format!(
                    "{}: the controller does not answer: {}",
                    self.line.name(),
                    self.reason
                );
                return Err(Error::new(ErrorKind::Port, what));
            }
        }
        self.phase = Phase::Closed;
        self.reason.clear();
        Ok(())
    }

    /// Tries to open a port that failed, if enough time has passed by the caller's clock: the
    /// line's clock begins anew. True when a line is open.
    pub fn reopen(&mut self, now_us: u64) -> bool {
        if self.phase != Phase::Disconnected {
            return true;
        }
        if now_us < self.reopen_at_us {
            return false;
        }
        self.reopen_at_us = now_us + REOPEN_US;
        let reopen = self
            .reconnection
            .as_mut()
            .and_then(|reconnection| reconnection.reopen.as_mut());
        let Some(Ok(line)) = reopen.map(|reopen| reopen()) else {
            return false;
        };
        self.line = line;
        self.now_us = 0;
        self.transmit.clear();
        self.phase = Phase::Closed;
        true
    }

    /// An error of the port: final, unless the port can be opened again.
    pub(super) fn lose_port(&mut self, error: PortError) -> Result<(), Error> {
        let can_reopen = self
            .reconnection
            .as_ref()
            .is_some_and(|reconnection| reconnection.reopen.is_some());
        if !can_reopen {
            return Err(error.into());
        }
        self.reason = error.to_string();
        self.phase = Phase::Disconnected;
        self.reopen_at_us = 0;
        Ok(())
    }

    /// The session with the controller ended.
    pub(super) fn lose_session(&mut self, error: &ClientError) -> Result<(), Error> {
        let text = format!("{}: {error}", self.line.name());
        if self.reconnection.is_none() {
            self.phase = Phase::Closed;
            self.lost = Some(text);
            return Ok(());
        }
        // The session that was replaced by a new one.
        if *error == ClientError::Closed {
            return Ok(());
        }
        let is_identifying = self.phase == Phase::Identifying;
        self.reason = if is_identifying {
            error.to_string()
        } else {
            text
        };
        self.begin_next();
        if is_identifying {
            self.phase = Phase::Identifying;
        }
        Ok(())
    }

    /// The controller answered.
    pub(super) fn start(&mut self, welcome: &Welcome) -> Result<(), Error> {
        let Some(startup) = &mut self.startup else {
            self.phase = Phase::Ready;
            return Ok(());
        };
        startup.agree(&self.line.name(), welcome)?;
        if self.phase == Phase::Identifying {
            return Ok(());
        }
        let mut tickets = vec![self.client.configure(&startup.config, false)];
        for command in &startup.commands {
            tickets.push(self.client.request(command.clone()));
        }
        self.phase = Phase::Starting(tickets);
        Ok(())
    }

    /// Takes the acknowledgement of a request of the startup; false if the request is none.
    pub(super) fn acknowledge_startup(
        &mut self,
        ticket: Ticket,
        result: &Result<(), RequestError>,
    ) -> Result<bool, Error> {
        let (Phase::Starting(tickets), Some(startup)) = (&self.phase, &self.startup) else {
            return Ok(false);
        };
        let Some(index) = tickets.iter().position(|pending| *pending == ticket) else {
            return Ok(false);
        };
        let command = index.checked_sub(1).map(|index| &startup.commands[index]);
        let is_last = index + 1 == tickets.len();
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
                return Err(Error::new(ErrorKind::Command, what));
            }
            _ => {}
        }
        if is_last {
            self.phase = Phase::Ready;
        }
        Ok(true)
    }
}
