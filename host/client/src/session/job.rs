//! A job from its first setpoint to rest.

use super::{Line, Session};
use crate::client::JobEnding;
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

impl<L: Line> Session<L> {
    /// Runs a job from `start`, which must be the controller's wanted pose, and waits until the machine is at rest again.
    ///
    /// # Errors
    /// The session broke. A job that ends early is no error here; see [`JobEnd`].
    pub fn run_job(
        &mut self,
        job: u32,
        start: AxisValues,
        setpoints: Vec<Setpoint>,
        watcher: &mut dyn Watcher,
    ) -> Result<JobEnd, Error> {
        self.run_job_with(job, start, setpoints, watcher, &mut |_| Ok(()))
    }

    /// As [`Session::run_job`]; what is to happen at the end of each pause, before the program goes on, is done by `at_pause`.
    ///
    /// # Errors
    /// As [`Session::run_job`], and what `at_pause` refuses.
    pub fn run_job_with(
        &mut self,
        job: u32,
        start: AxisValues,
        setpoints: Vec<Setpoint>,
        watcher: &mut dyn Watcher,
        at_pause: &mut dyn FnMut(&mut Self) -> Result<(), Error>,
    ) -> Result<JobEnd, Error> {
        let first = self.events.len();
        let period_us = self
            .client
            .controller()
            .map_or(200, |welcome| u32::from(welcome.period_us));
        // On a slow line telemetry takes a quarter of it at most.
        let quarter_ms = (4 * TELEMETRY_BYTES * 1000)
            .checked_div(self.line_rate)
            .unwrap_or(0);
        let every_us = TELEMETRY_MS.max(quarter_ms) * 1000;
        let every = (every_us / period_us.max(1)).clamp(1, u32::from(u16::MAX)) as u16;
        self.ask(Command::Telemetry { every })?;
        self.ending = None;
        let before = self.client.link().counters();
        self.client
            .start_job(job, start, setpoints)
            .map_err(|error| Error::new(ErrorKind::Port, error))?;
        let mut stopped = false;
        let mut pause = Pause::None;
        let mut idle_since = None;
        let mut seen = first;
        let mut steps = 0_u32;
        let ending = loop {
            if let Some(ending) = self.ending.take() {
                break ending;
            }
            self.step()?;
            if self.interrupted() && !stopped {
                stopped = true;
                self.client.urgent_stop();
            }
            while let Some((_, event)) = self.events.get(seen) {
                seen += 1;
                match event {
                    Event::Paused { setpoint } => {
                        pause = Pause::Reached;
                        watcher.paused(*setpoint);
                    }
                    Event::State {
                        from: State::Run,
                        to: State::Hold,
                        ..
                    } if pause == Pause::Reached => pause = Pause::Held,
                    // Nobody here asked for it: another program on the port sent an urgent stop.
                    Event::State {
                        from: State::Run,
                        to: State::Hold,
                        ..
                    } if pause == Pause::None && !stopped => {
                        self.client.request(Command::Stop);
                    }
                    _ => {}
                }
            }
            if pause == Pause::Held && watcher.goes_on() {
                pause = Pause::None;
                at_pause(self)?;
                self.client.request(Command::Resume);
            }
            steps = steps.wrapping_add(1);
            if steps.is_multiple_of(LOOK_EVERY)
                && let Some(telemetry) = self.client.telemetry()
            {
                watcher.progress(telemetry);
                if matches!(telemetry.state, State::Idle | State::Disabled) {
                    let since = *idle_since.get_or_insert(self.now_us);
                    if self.now_us - since > IDLE_US {
                        let what = "the controller stands idle and the end of the job was not heard: the line is too slow or too bad";
                        return Err(Error::new(ErrorKind::Port, what));
                    }
                } else {
                    idle_since = None;
                }
            }
        };
        let after = self.client.link().counters();
        let sent = Sent {
            bytes: after.bytes_sent - before.bytes_sent,
            message_bytes: after.message_bytes - before.message_bytes,
        };
        let status = self.settle()?;
        let mut end = JobEnd {
            ending,
            setpoints: 0,
            underruns: Vec::new(),
            faults: Vec::new(),
            stopped,
            status,
            sent,
        };
        for (_, event) in &self.events[first..] {
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
        self.ask(Command::Telemetry { every: 0 })?;
        Ok(end)
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

    /// Waits until the controller reports a state in which nothing moves, and no stop is on its way to it that would meet what comes next.
    fn settle(&mut self) -> Result<Telemetry, Error> {
        loop {
            let status = self.status()?;
            if !self.client.urgent().0
                && !matches!(status.state, State::Run | State::Homing | State::Jog)
                && (status.state != State::Hold || status.path_rate == 0)
            {
                return Ok(status);
            }
        }
    }
}
