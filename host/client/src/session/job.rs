//! A job from its first setpoint to standstill.

use super::{Line, Procedure, Session, StatusQuery};
use crate::client::{JobEnding, RequestError, Setpoints, Ticket};
use crate::{Error, ErrorKind};
use haptimill_protocol::message::{AxisValues, Command, Event, Fault, State, Telemetry};

/// Message of a latched emergency stop.
pub const EMERGENCY_STOP: &str =
    "the emergency stop is latched, the drives are off; release it, then `haptimill reset`";

/// The result of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobEnd {
    /// How it ended.
    pub ending: JobEnding,
    /// Setpoints that were reached.
    pub setpoints: u32,
    /// Setpoints that were late, with the delay in periods.
    pub underruns: Vec<(u32, u32)>,
    /// Faults that were latched.
    pub faults: Vec<Fault>,
    /// The user stopped it.
    pub stopped: bool,
    /// Status at standstill.
    pub status: Telemetry,
    /// Bytes that were sent during the job.
    pub sent: BytesSent,
}

/// Bytes that the host sent during a job; retransmissions count again.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BytesSent {
    /// All bytes, with keep-alive frames and acknowledgements.
    pub bytes: u32,
    /// Bytes of the frames with messages, which are setpoints with few exceptions; with framing.
    pub message_bytes: u32,
}

/// Observes a job that runs.
pub trait JobObserver {
    /// Called every few milliseconds with the newest telemetry.
    fn progress(&mut self, telemetry: &Telemetry);

    /// Called in every step with the newest telemetry.
    fn reported(&mut self, _: &Telemetry) {}

    /// The program pauses (M0) at a setpoint.
    fn paused(&mut self, setpoint: u32);

    /// Whether the program may resume; called repeatedly during a pause.
    fn may_resume(&mut self) -> bool;

    /// An input holds the job, as `what` says. The job may resume when the input is released.
    fn held_by_input(&mut self, what: &str);

    /// Whether the operator wants the job to hold along its path; called repeatedly while it runs.
    /// The job then waits for [`JobObserver::may_resume`].
    fn wants_hold(&mut self) -> bool {
        false
    }

    /// An override that the operator wants; called repeatedly while the job runs.
    fn wants_override(&mut self) -> Option<Command> {
        None
    }
}

/// Observes nothing and resumes at once.
#[derive(Debug, Clone, Copy)]
pub struct NoObserver;

/// Progress of a program pause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pause {
    /// There is none.
    None,
    /// It was reached. The next hold event belongs to it, and is no stop by another program.
    Reached,
    /// The machine holds.
    Held,
}

impl JobObserver for NoObserver {
    fn progress(&mut self, _: &Telemetry) {}

    fn paused(&mut self, _: u32) {}

    fn may_resume(&mut self) -> bool {
        true
    }

    fn held_by_input(&mut self, _: &str) {}
}

/// Steps between two checks of the telemetry.
const CHECK_EVERY: u32 = 200;

/// Time between two telemetry frames during a job, ms.
const TELEMETRY_MS: u32 = 20;

/// Approximate length of a telemetry frame, bytes.
const TELEMETRY_BYTES: u32 = 150;

/// When the controller is idle for this time while the job has not ended here, the event of its end
/// was lost; microseconds.
const IDLE_US: u64 = 10_000_000;

/// State of a [`JobRun`] after it was advanced.
#[derive(Debug, Clone, PartialEq)]
pub enum JobStatus {
    /// The job runs, or waits for the end of a pause.
    Running,
    /// The pause is over; the job waits for [`JobRun::resume`].
    PauseOver,
    /// The job ended, and the machine is at standstill.
    Ended(Box<JobEnd>),
}

#[derive(Debug)]
enum JobPhase {
    /// Telemetry was requested at the rate of a job.
    Preparing(Ticket),
    Running,
    /// The job ended; the machine may still decelerate.
    Settling(JobEnding, StatusQuery),
    /// Telemetry was switched off.
    Closing(Box<JobEnd>, Ticket),
}

/// Runs a job from its first setpoint to standstill.
#[derive(Debug)]
pub struct JobRun {
    phase: JobPhase,
    /// Number, start and setpoints, until the job begins.
    job: Option<(u32, AxisValues, Setpoints)>,
    first_event: usize,
    next_event: usize,
    bytes_before: BytesSent,
    bytes_sent: BytesSent,
    is_stopped: bool,
    pause: Pause,
    /// The input that holds the job: a feed hold or an open door.
    held_by: Option<u8>,
    /// A `Resume` that was not answered yet. A refused one is sent again.
    resumed: Option<Ticket>,
    idle_since_us: Option<u64>,
    steps: u32,
}

fn count_bytes<L: Line>(session: &Session<L>) -> BytesSent {
    let counters = session.client.link().counters();
    BytesSent {
        bytes: counters.bytes_sent,
        message_bytes: counters.message_bytes,
    }
}

impl JobRun {
    /// Prepares a job that begins at `start`, which must be the commanded pose of the controller.
    pub fn start<L: Line>(
        session: &mut Session<L>,
        job: u32,
        start: AxisValues,
        setpoints: impl Into<Setpoints>,
    ) -> Self {
        let every = session.telemetry_periods();
        let first_event = session.events.len();
        Self {
            phase: JobPhase::Preparing(session.client.request(Command::Telemetry { every })),
            job: Some((job, start, setpoints.into())),
            first_event,
            next_event: first_event,
            bytes_before: BytesSent::default(),
            bytes_sent: BytesSent::default(),
            is_stopped: false,
            pause: Pause::None,
            held_by: None,
            resumed: None,
            idle_since_us: None,
            steps: 0,
        }
    }

    /// Resumes the program after [`JobStatus::PauseOver`].
    pub fn resume<L: Line>(&mut self, session: &mut Session<L>) {
        self.pause = Pause::None;
        self.resumed = Some(session.client.request(Command::Resume));
    }

    /// Does what is possible now, without waiting. Must be called after each step of the session.
    ///
    /// # Errors
    /// The session ended. A job that ends early is no error here; see [`JobEnd`].
    pub fn advance<L: Line>(
        &mut self,
        session: &mut Session<L>,
        observer: &mut dyn JobObserver,
    ) -> Result<JobStatus, Error> {
        match &mut self.phase {
            JobPhase::Preparing(request) => {
                if let Some(answer) = session.answer(*request) {
                    answer?;
                    self.begin(session)?;
                }
                Ok(JobStatus::Running)
            }
            JobPhase::Running => self.watch(session, observer),
            JobPhase::Settling(ending, query) => {
                let Some(status) = query.advance(session)? else {
                    return Ok(JobStatus::Running);
                };
                if session.is_settled(&status) {
                    let ending = ending.clone();
                    let end = Box::new(self.report(session, ending, status));
                    let request = session.client.request(Command::Telemetry { every: 0 });
                    self.phase = JobPhase::Closing(end, request);
                } else {
                    *query = StatusQuery::start(session);
                }
                Ok(JobStatus::Running)
            }
            JobPhase::Closing(end, request) => match session.answer(*request) {
                None => Ok(JobStatus::Running),
                Some(answer) => answer.map(|()| JobStatus::Ended(end.clone())),
            },
        }
    }

    fn begin<L: Line>(&mut self, session: &mut Session<L>) -> Result<(), Error> {
        session.ending = None;
        self.bytes_before = count_bytes(session);
        if let Some((job, start, setpoints)) = self.job.take() {
            session
                .client
                .start_job(job, start, setpoints)
                .map_err(|error| Error::new(ErrorKind::Port, error))?;
        }
        self.phase = JobPhase::Running;
        Ok(())
    }

    fn watch<L: Line>(
        &mut self,
        session: &mut Session<L>,
        observer: &mut dyn JobObserver,
    ) -> Result<JobStatus, Error> {
        if session.is_interrupted() && !self.is_stopped {
            self.is_stopped = true;
            session.stop();
        }
        if let Some(telemetry) = session.client.telemetry() {
            observer.reported(telemetry);
        }
        if self.pause == Pause::None && !self.is_stopped && observer.wants_hold() {
            session.client.request(Command::Hold);
            self.pause = Pause::Reached;
        }
        if !self.is_stopped
            && let Some(command) = observer.wants_override()
        {
            session.client.request(command);
        }
        while let Some((_, event)) = session.events.get(self.next_event) {
            self.next_event += 1;
            match event {
                Event::Paused { setpoint } => {
                    self.pause = Pause::Reached;
                    observer.paused(*setpoint);
                }
                Event::InputHold { input } => {
                    self.pause = Pause::Reached;
                    self.held_by = Some(*input);
                    observer.held_by_input(&session.describe(event));
                }
                Event::State {
                    from: State::Run,
                    to: State::Hold,
                    ..
                } => match self.pause {
                    Pause::Reached => self.pause = Pause::Held,
                    // An out-of-band stop of another program on the port.
                    Pause::None if !self.is_stopped => {
                        session.client.request(Command::Stop);
                    }
                    _ => {}
                },
                _ => {}
            }
        }
        // The door may have opened again before the command arrived.
        if let Some(ticket) = self.resumed
            && let Some(answer) = session.answer(ticket)
        {
            self.resumed = None;
            if answer.is_err() && session.ending.is_none() {
                self.pause = Pause::Held;
            }
        }
        if let Some(input) = self.held_by
            && let Some(io) = session.client.telemetry().and_then(|it| it.io.as_ref())
            && io.inputs >> input & 1 == 0
        {
            self.held_by = None;
        }
        let is_over = self.pause == Pause::Held && self.held_by.is_none() && observer.may_resume();
        self.steps = self.steps.wrapping_add(1);
        if self.steps.is_multiple_of(CHECK_EVERY)
            && let Some(telemetry) = session.client.telemetry()
        {
            observer.progress(telemetry);
            if matches!(telemetry.state, State::Idle | State::Disabled) {
                let since = *self.idle_since_us.get_or_insert(session.now_us);
                if session.now_us - since > IDLE_US {
                    let what = "the controller is idle, and the end of the job was not received: \
                        the line is too slow or has too many errors";
                    return Err(Error::new(ErrorKind::Port, what));
                }
            } else {
                self.idle_since_us = None;
            }
        }
        if let Some(ending) = session.ending.take() {
            let after = count_bytes(session);
            self.bytes_sent = BytesSent {
                bytes: after.bytes - self.bytes_before.bytes,
                message_bytes: after.message_bytes - self.bytes_before.message_bytes,
            };
            self.phase = JobPhase::Settling(ending, StatusQuery::start(session));
        } else if is_over {
            return Ok(JobStatus::PauseOver);
        }
        Ok(JobStatus::Running)
    }

    fn report<L: Line>(
        &self,
        session: &Session<L>,
        ending: JobEnding,
        status: Telemetry,
    ) -> JobEnd {
        let mut end = JobEnd {
            ending,
            setpoints: 0,
            underruns: Vec::new(),
            faults: Vec::new(),
            stopped: self.is_stopped,
            status,
            sent: self.bytes_sent,
        };
        for (_, event) in &session.events[self.first_event..] {
            match event {
                Event::Underrun {
                    setpoint,
                    late_periods,
                } => end.underruns.push((*setpoint, *late_periods)),
                Event::Fault(fault) => end.faults.push(*fault),
                Event::JobDone { setpoints, .. } | Event::JobDropped { setpoints, .. } => {
                    end.setpoints = *setpoints
                }
                _ => {}
            }
        }
        end
    }
}

impl<L: Line> Session<L> {
    /// Runs a job from `start`, which must be the commanded pose of the controller, and waits for
    /// standstill.
    ///
    /// # Errors
    /// The session ended. A job that ends early is no error here; see [`JobEnd`].
    pub fn run_job(
        &mut self,
        job: u32,
        start: AxisValues,
        setpoints: impl Into<Setpoints>,
        observer: &mut dyn JobObserver,
    ) -> Result<JobEnd, Error> {
        self.run_job_with(job, start, setpoints, observer, &mut |_| Ok(()))
    }

    /// As [`Session::run_job`]; `at_pause` is called at the end of each pause, before the program
    /// resumes.
    ///
    /// # Errors
    /// As [`Session::run_job`], and the errors of `at_pause`.
    pub fn run_job_with(
        &mut self,
        job: u32,
        start: AxisValues,
        setpoints: impl Into<Setpoints>,
        observer: &mut dyn JobObserver,
        at_pause: &mut dyn FnMut(&mut Self) -> Result<(), Error>,
    ) -> Result<JobEnd, Error> {
        let mut run = JobRun::start(self, job, start, setpoints);
        loop {
            match run.advance(self, observer)? {
                JobStatus::Running => {}
                JobStatus::PauseOver => {
                    at_pause(self)?;
                    run.resume(self);
                }
                JobStatus::Ended(end) => return Ok(*end),
            }
            self.step()?;
        }
    }

    /// Control periods between two telemetry frames for an operator or during a job: 20 ms, and on
    /// a slow line as many as take a quarter of the bandwidth; the interval of
    /// [`Session::keep_telemetry`] while telemetry is kept.
    pub fn telemetry_periods(&self) -> u16 {
        if let Some((every, _)) = &self.telemetry_log {
            return *every;
        }
        let period_us = self
            .client
            .controller()
            .map_or(200, |welcome| u32::from(welcome.period_us));
        let quarter_ms = (4 * TELEMETRY_BYTES * 1000)
            .checked_div(self.line_rate)
            .unwrap_or(0);
        let every_us = TELEMETRY_MS.max(quarter_ms) * 1000;
        (every_us / period_us.max(1)).clamp(1, u32::from(u16::MAX)) as u16
    }

    /// Whether nothing moves, and no stop is on its way to the controller that would affect the
    /// next command.
    fn is_settled(&self, status: &Telemetry) -> bool {
        !self.is_stopping()
            && !matches!(status.state, State::Run | State::Homing | State::Jog)
            && (status.state != State::Hold || status.speed_factor == 0)
    }

    /// Checks that a job was completed.
    ///
    /// # Errors
    /// The reason why it was not.
    pub fn check_completed(&self, end: &JobEnd) -> Result<(), Error> {
        if let Some(fault) = end.faults.first() {
            return Err(self.fault(fault));
        }
        if end.status.state == State::EmergencyStop {
            return Err(Error::new(ErrorKind::Fault, EMERGENCY_STOP));
        }
        if end.stopped {
            return Err(Error::new(
                ErrorKind::Stopped,
                "stopped by the user; the position is kept",
            ));
        }
        match &end.ending {
            JobEnding::Done { .. } => Ok(()),
            JobEnding::Dropped { setpoints, .. } => Err(Error::new(
                ErrorKind::Stopped,
                format!("the job was stopped from elsewhere after {setpoints} setpoints"),
            )),
            JobEnding::Lost { error, .. } => Err(Error::new(ErrorKind::Port, error)),
            JobEnding::Refused {
                error: RequestError::Refused(refusal),
                ..
            } => Err(Error::new(
                ErrorKind::Command,
                format!("refused: {}", self.why(refusal)),
            )),
            other => Err(Error::new(ErrorKind::Command, other)),
        }
    }
}
