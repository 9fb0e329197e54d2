//! A job from its first setpoint to rest.

use super::{Line, Procedure, Session, StatusQuery};
use crate::client::{JobEnding, Ticket};
use crate::{Error, ErrorKind};
use haptimill_protocol::message::{AxisValues, Command, Event, Fault, State, Telemetry};
use haptimill_protocol::setpoint::Setpoint;

/// The emergency stop, in words.
pub const EMERGENCY_STOP: &str =
    "the emergency stop is latched, the drives are off; release it, then `haptimill reset`";

/// How a job ended, and what happened on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct JobEnd {
    /// How it ended, as the client saw it.
    pub ending: JobEnding,
    /// Setpoints that were reached.
    pub setpoints: u32,
    /// Setpoints that were late, and by how many periods.
    pub underruns: Vec<(u32, u32)>,
    /// Faults that were latched.
    pub faults: Vec<Fault>,
    /// The user stopped it.
    pub stopped: bool,
    /// How things stood when all was at rest.
    pub status: Telemetry,
    /// What went to the controller during the job.
    pub sent: Sent,
}

/// Bytes that went from the host to the controller during a job; what was sent again counts again.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sent {
    /// All bytes, signs of life and acknowledgements included.
    pub bytes: u32,
    /// Bytes of the frames that carry messages, which are the setpoints but for a handful; framing included.
    pub message_bytes: u32,
}

/// Looks on while a job runs.
pub trait Watcher {
    /// Some milliseconds have passed; the newest telemetry.
    fn progress(&mut self, telemetry: &Telemetry);

    /// The program pauses (M0) at a setpoint.
    fn paused(&mut self, setpoint: u32);

    /// Whether the pause is over; asked again and again while it lasts.
    fn goes_on(&mut self) -> bool;
}

/// Nobody looks on; no pause lasts.
#[derive(Debug, Clone, Copy)]
pub struct Unwatched;

/// How far a pause of the program has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pause {
    /// There is none.
    None,
    /// It was reached. That the machine holds because of it is yet to be heard, and is no stop from elsewhere.
    Reached,
    /// The machine holds.
    Held,
}

impl Watcher for Unwatched {
    fn progress(&mut self, _: &Telemetry) {}

    fn paused(&mut self, _: u32) {}

    fn goes_on(&mut self) -> bool {
        true
    }
}

/// Steps between two looks at the telemetry.
const LOOK_EVERY: u32 = 200;

/// Control periods between two telemetry frames during a job, at most one every 20 ms.
const TELEMETRY_MS: u32 = 20;

/// Bytes of a telemetry frame, about.
const TELEMETRY_BYTES: u32 = 150;

/// A controller that stands idle for so long, while its job has not ended here, has told the end and was not heard; microseconds.
const IDLE_US: u64 = 10_000_000;

/// State of a [`JobRun`] after it was advanced.
#[derive(Debug, Clone, PartialEq)]
pub enum JobProgress {
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
    job: Option<(u32, AxisValues, Vec<Setpoint>)>,
    first_event: usize,
    next_event: usize,
    bytes_before: Sent,
    bytes_sent: Sent,
    is_stopped: bool,
    pause: Pause,
    idle_since_us: Option<u64>,
    steps: u32,
}

fn count_bytes<L: Line>(session: &Session<L>) -> Sent {
    let counters = session.client.link().counters();
    Sent {
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
        setpoints: Vec<Setpoint>,
    ) -> Self {
        let every = session.telemetry_periods();
        let first_event = session.events.len();
        Self {
            phase: JobPhase::Preparing(session.client.request(Command::Telemetry { every })),
            job: Some((job, start, setpoints)),
            first_event,
            next_event: first_event,
            bytes_before: Sent::default(),
            bytes_sent: Sent::default(),
            is_stopped: false,
            pause: Pause::None,
            idle_since_us: None,
            steps: 0,
        }
    }

    /// Resumes the program after [`JobProgress::PauseOver`].
    pub fn resume<L: Line>(&mut self, session: &mut Session<L>) {
        self.pause = Pause::None;
        session.client.request(Command::Resume);
    }

    /// Does what is possible now, without waiting. Must be called after each step of the session.
    ///
    /// # Errors
    /// The session ended. A job that ends early is no error here; see [`JobEnd`].
    pub fn advance<L: Line>(
        &mut self,
        session: &mut Session<L>,
        watcher: &mut dyn Watcher,
    ) -> Result<JobProgress, Error> {
        match &mut self.phase {
            JobPhase::Preparing(request) => {
                if let Some(answer) = session.answer(*request) {
                    answer?;
                    self.begin(session)?;
                }
                Ok(JobProgress::Running)
            }
            JobPhase::Running => self.watch(session, watcher),
            JobPhase::Settling(ending, query) => {
                let Some(status) = query.advance(session)? else {
                    return Ok(JobProgress::Running);
                };
                if session.is_settled(&status) {
                    let ending = ending.clone();
                    let end = Box::new(self.report(session, ending, status));
                    let request = session.client.request(Command::Telemetry { every: 0 });
                    self.phase = JobPhase::Closing(end, request);
                } else {
                    *query = StatusQuery::start(session);
                }
                Ok(JobProgress::Running)
            }
            JobPhase::Closing(end, request) => match session.answer(*request) {
                None => Ok(JobProgress::Running),
                Some(answer) => answer.map(|()| JobProgress::Ended(end.clone())),
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
        watcher: &mut dyn Watcher,
    ) -> Result<JobProgress, Error> {
        if session.interrupted() && !self.is_stopped {
            self.is_stopped = true;
            session.client.urgent_stop();
        }
        while let Some((_, event)) = session.events.get(self.next_event) {
            self.next_event += 1;
            match event {
                Event::Paused { setpoint } => {
                    self.pause = Pause::Reached;
                    watcher.paused(*setpoint);
                }
                Event::State {
                    from: State::Run,
                    to: State::Hold,
                    ..
                } => match self.pause {
                    Pause::Reached => self.pause = Pause::Held,
                    // An urgent stop of another program on the port.
                    Pause::None if !self.is_stopped => {
                        session.client.request(Command::Stop);
                    }
                    _ => {}
                },
                _ => {}
            }
        }
        let is_over = self.pause == Pause::Held && watcher.goes_on();
        self.steps = self.steps.wrapping_add(1);
        if self.steps.is_multiple_of(LOOK_EVERY)
            && let Some(telemetry) = session.client.telemetry()
        {
            watcher.progress(telemetry);
            if matches!(telemetry.state, State::Idle | State::Disabled) {
                let since = *self.idle_since_us.get_or_insert(session.now_us);
                if session.now_us - since > IDLE_US {
                    let what = "the controller is idle, and the end of the job was not received: \
                        the line is too slow or too bad";
                    return Err(Error::new(ErrorKind::Port, what));
                }
            } else {
                self.idle_since_us = None;
            }
        }
        if let Some(ending) = session.ending.take() {
            let after = count_bytes(session);
            self.bytes_sent = Sent {
                bytes: after.bytes - self.bytes_before.bytes,
                message_bytes: after.message_bytes - self.bytes_before.message_bytes,
            };
            self.phase = JobPhase::Settling(ending, StatusQuery::start(session));
        } else if is_over {
            return Ok(JobProgress::PauseOver);
        }
        Ok(JobProgress::Running)
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
    /// Runs a job from `start`, which must be the commanded pose of the controller, and waits for standstill.
    ///
    /// # Errors
    /// The session ended. A job that ends early is no error here; see [`JobEnd`].
    pub fn run_job(
        &mut self,
        job: u32,
        start: AxisValues,
        setpoints: Vec<Setpoint>,
        watcher: &mut dyn Watcher,
    ) -> Result<JobEnd, Error> {
        self.run_job_with(job, start, setpoints, watcher, &mut |_| Ok(()))
    }

    /// As [`Session::run_job`]; `at_pause` is called at the end of each pause, before the program resumes.
    ///
    /// # Errors
    /// As [`Session::run_job`], and the errors of `at_pause`.
    pub fn run_job_with(
        &mut self,
        job: u32,
        start: AxisValues,
        setpoints: Vec<Setpoint>,
        watcher: &mut dyn Watcher,
        at_pause: &mut dyn FnMut(&mut Self) -> Result<(), Error>,
    ) -> Result<JobEnd, Error> {
        let mut run = JobRun::start(self, job, start, setpoints);
        loop {
            match run.advance(self, watcher)? {
                JobProgress::Running => {}
                JobProgress::PauseOver => {
                    at_pause(self)?;
                    run.resume(self);
                }
                JobProgress::Ended(end) => return Ok(*end),
            }
            self.step()?;
        }
    }

    /// Control periods between two telemetry frames during a job.
    fn telemetry_periods(&self) -> u16 {
        let period_us = self
            .client
            .controller()
            .map_or(200, |welcome| u32::from(welcome.period_us));
        // On a slow line telemetry takes a quarter of the bandwidth at most.
        let quarter_ms = (4 * TELEMETRY_BYTES * 1000)
            .checked_div(self.line_rate)
            .unwrap_or(0);
        let every_us = TELEMETRY_MS.max(quarter_ms) * 1000;
        (every_us / period_us.max(1)).clamp(1, u32::from(u16::MAX)) as u16
    }

    /// Whether nothing moves, and no stop is on its way to the controller that would affect the next command.
    fn is_settled(&self, status: &Telemetry) -> bool {
        !self.client.urgent().0
            && !matches!(status.state, State::Run | State::Homing | State::Jog)
            && (status.state != State::Hold || status.path_rate == 0)
    }

    /// Whether a job came to its end.
    ///
    /// # Errors
    /// Why it did not.
    pub fn well_ended(&self, end: &JobEnd) -> Result<(), Error> {
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
            other => Err(Error::new(ErrorKind::Command, other)),
        }
    }
}
