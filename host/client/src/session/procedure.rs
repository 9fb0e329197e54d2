//! Requests that take several messages, as procedures that never wait, and the loop that waits for
//! them.

use super::{EMERGENCY_STOP, Line, Session};
use crate::client::Ticket;
use crate::{Error, ErrorKind};
use haptimill_protocol::message::{Command, Event, Fault, State, Telemetry};

/// A procedure on a session: its owner steps the session and advances the procedure in turn.
pub trait Procedure<L> {
    /// The result.
    type Output;

    /// Does what is possible now, without waiting; `None` until the procedure is finished.
    ///
    /// # Errors
    /// The procedure failed.
    fn advance(&mut self, session: &mut Session<L>) -> Result<Option<Self::Output>, Error>;
}

/// Waits for the acknowledgement of a request.
#[derive(Debug, Clone, Copy)]
pub struct Acknowledgement(pub Ticket);

impl<L: Line> Procedure<L> for Acknowledgement {
    type Output = ();

    fn advance(&mut self, session: &mut Session<L>) -> Result<Option<()>, Error> {
        session.answer(self.0).transpose()
    }
}

/// Requests a status report that is newer than everything received before.
#[derive(Debug, Clone, Copy)]
pub struct StatusQuery {
    request: Option<Ticket>,
    /// Period of the newest report or event at the start.
    after: Option<u64>,
    repeat_at_us: u64,
}

/// A telemetry frame may be lost on a bad line: the request is repeated after this time,
/// microseconds.
const REPEAT_STATUS_US: u64 = 2_000_000;

impl StatusQuery {
    /// Sends the request.
    pub fn start<L: Line>(session: &mut Session<L>) -> Self {
        // Telemetry that was made before an event may arrive after it.
        let record_telemetry = session.client.telemetry().map(|report| report.period);
        let event = session.events.last().map(|(period, _)| *period);
        Self {
            request: Some(session.client.request(Command::Status)),
            after: record_telemetry.max(event),
            repeat_at_us: 0,
        }
    }
}

impl<L: Line> Procedure<L> for StatusQuery {
    type Output = Telemetry;

    fn advance(&mut self, session: &mut Session<L>) -> Result<Option<Telemetry>, Error> {
        if let Some(request) = self.request {
            match session.answer(request) {
                None => return Ok(None),
                Some(answer) => answer?,
            }
            self.request = None;
            self.repeat_at_us = session.now_us + REPEAT_STATUS_US;
        }
        if let Some(telemetry) = session.client.telemetry()
            && Some(telemetry.period) > self.after
        {
            return Ok(Some(telemetry.clone()));
        }
        if session.now_us > self.repeat_at_us {
            self.request = Some(session.client.request(Command::Status));
        }
        Ok(None)
    }
}

/// Homes the machine.
#[derive(Debug, Clone, Copy)]
pub struct Homing {
    request: Option<Ticket>,
    next_event: usize,
    is_stopping: bool,
}

impl Homing {
    /// Sends the request.
    pub fn start<L: Line>(session: &mut Session<L>) -> Self {
        Self {
            next_event: session.events.len(),
            request: Some(session.client.request(Command::Home)),
            is_stopping: false,
        }
    }
}

impl<L: Line> Procedure<L> for Homing {
    type Output = ();

    fn advance(&mut self, session: &mut Session<L>) -> Result<Option<()>, Error> {
        if let Some(request) = self.request {
            if let Some(answer) = session.answer(request) {
                answer?;
                self.request = None;
            }
            return Ok(None);
        }
        if session.is_interrupted() && !self.is_stopping {
            self.is_stopping = true;
            session.stop();
        }
        while let Some((_, event)) = session.events.get(self.next_event) {
            self.next_event += 1;
            match event {
                Event::Homed => return Ok(Some(())),
                Event::Fault(fault) => return Err(session.fault(fault)),
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
                    // The event of success precedes the change of state.
                    return Err(Error::new(
                        ErrorKind::Stopped,
                        "homing was stopped; the reference is not found",
                    ));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

/// Moves a joint off its limit switch.
#[derive(Debug, Clone, Copy)]
struct MovingOff {
    request: Option<Ticket>,
    next_event: usize,
    is_stopping: bool,
    is_off: bool,
}

impl<L: Line> Procedure<L> for MovingOff {
    type Output = ();

    fn advance(&mut self, session: &mut Session<L>) -> Result<Option<()>, Error> {
        if let Some(request) = self.request {
            if let Some(answer) = session.answer(request) {
                answer?;
                self.request = None;
            }
            return Ok(None);
        }
        if session.is_interrupted() && !self.is_stopping {
            self.is_stopping = true;
            session.stop();
        }
        while let Some((_, event)) = session.events.get(self.next_event) {
            self.next_event += 1;
            match event {
                Event::MovedOff { .. } => self.is_off = true,
                Event::Fault(fault) => return Err(session.fault(fault)),
                Event::State {
                    from: State::Homing,
                    to: State::EmergencyStop,
                    ..
                } => return Err(Error::new(ErrorKind::Fault, EMERGENCY_STOP)),
                Event::State {
                    from: State::Homing,
                    ..
                } if self.is_off => return Ok(Some(())),
                Event::State {
                    from: State::Homing,
                    ..
                } => {
                    let what = "the motion off the limit switch was stopped";
                    return Err(Error::new(ErrorKind::Stopped, what));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

impl<L: Line> Session<L> {
    /// Moves a joint off the limit switch on which it stands, after a reset of the fault of a limit
    /// switch, and waits until it is off. The machine must be homed afterwards.
    ///
    /// # Errors
    /// The controller refuses, the switch does not open, another fault, or the user stopped it.
    pub fn move_off(&mut self, joint: u8) -> Result<(), Error> {
        let status = self.status()?;
        if let (State::Fault, Some(Fault::LimitSwitch { .. })) = (status.state, status.fault) {
            self.ask(Command::Reset)?;
        }
        let moving = MovingOff {
            next_event: self.events.len(),
            request: Some(self.client.request(Command::MoveOff { joint })),
            is_stopping: false,
            is_off: false,
        };
        self.complete(moving)
    }

    /// Steps the session until a procedure is finished.
    ///
    /// # Errors
    /// The procedure failed, the port failed, or the session with the controller ended.
    pub fn complete<P: Procedure<L>>(&mut self, mut procedure: P) -> Result<P::Output, Error> {
        loop {
            if let Some(output) = procedure.advance(self)? {
                return Ok(output);
            }
            self.step()?;
        }
    }

    /// Sends a request and waits for its acknowledgement.
    ///
    /// # Errors
    /// The controller refuses the request or does not answer.
    pub fn ask(&mut self, command: Command) -> Result<(), Error> {
        let ticket = self.client.request(command);
        self.wait_for_acknowledgement(ticket)
    }

    /// Waits for the acknowledgement of a request.
    ///
    /// # Errors
    /// The controller refuses the request or does not answer.
    pub fn wait_for_acknowledgement(&mut self, ticket: Ticket) -> Result<(), Error> {
        self.complete(Acknowledgement(ticket))
    }

    /// Requests the status and waits for it.
    ///
    /// # Errors
    /// The controller does not answer.
    pub fn status(&mut self) -> Result<Telemetry, Error> {
        let query = StatusQuery::start(self);
        self.complete(query)
    }

    /// Enables the drives if they are disabled.
    ///
    /// # Errors
    /// The controller refuses: a latched fault or emergency stop, an input, a pose out of reach. A
    /// fault while the drives are switched on, such as a step motor that does not lock.
    pub fn enable(&mut self) -> Result<(), Error> {
        let before = self.status()?;
        if !matches!(
            before.state,
            State::Disabled | State::Fault | State::EmergencyStop
        ) {
            return Ok(());
        }
        self.ask(Command::Enable).map_err(|refusal| {
            // The refusal names the state only; a fault that is new is its cause.
            match self.status() {
                Ok(Telemetry {
                    fault: Some(fault), ..
                }) if before.fault.is_none() => self.fault(&fault),
                _ => refusal,
            }
        })
    }

    /// Homes the machine and waits until it is homed.
    ///
    /// # Errors
    /// The controller refuses, a fault or an emergency stop while homing, or the user stopped it.
    pub fn home(&mut self) -> Result<(), Error> {
        let homing = Homing::start(self);
        self.complete(homing)
    }
}
