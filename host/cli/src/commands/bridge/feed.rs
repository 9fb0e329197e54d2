//! Setpoints of a job whose lines arrive while it runs.

use haptimill_client::client::SetpointSource;
use haptimill_client::session::JobObserver;
use haptimill_gcode::{Problem, Step};
use haptimill_machine_file::model::Model;
use haptimill_planner::Planner;
use haptimill_protocol::message::Telemetry;
use haptimill_protocol::setpoint::Setpoint;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::{Duration, Instant};

/// Lines that are accepted before they are sent to the machine, at most.
const MAX_AHEAD: u32 = 128;

/// How long the machine may wait for setpoints before a part of the look-ahead is planned.
const HUNGER: Duration = Duration::from_millis(50);

/// Silence of the sender after which a job ends.
const QUIET: Duration = Duration::from_millis(300);

/// Setpoints that are made and not sent.
#[derive(Debug, Default)]
struct Made {
    /// With the line of the motion towards each.
    setpoints: VecDeque<(Setpoint, u32)>,
    /// Line of the last one that was sent.
    sent_line: u32,
    /// There are none since then.
    hungry_since: Option<Instant>,
    ended: bool,
}

/// The end of the queue at the session.
pub(super) struct GrowingProgram(Arc<Mutex<Made>>);

fn lock(made: &Mutex<Made>) -> MutexGuard<'_, Made> {
    made.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SetpointSource for GrowingProgram {
    fn next_setpoint(&mut self) -> Poll<Option<Setpoint>> {
        let mut made = lock(&self.0);
        if let Some((setpoint, line)) = made.setpoints.pop_front() {
            made.sent_line = line;
            made.hungry_since = None;
            return Poll::Ready(Some(setpoint));
        }
        if made.ended {
            return Poll::Ready(None);
        }
        made.hungry_since.get_or_insert_with(Instant::now);
        Poll::Pending
    }
}

/// Plans the lines of a job.
pub(super) struct Feed {
    planner: Planner<Model>,
    made: Arc<Mutex<Made>>,
    accepted_line: u32,
    accepted_at: Instant,
    /// There are steps that are not planned to a standstill.
    is_open: bool,
    /// Spindle, coolant or an output is on: the job then goes on without lines.
    devices_on: bool,
}

impl Feed {
    pub(super) fn new(planner: Planner<Model>, line: u32) -> Self {
        let made = Made {
            sent_line: line,
            hungry_since: Some(Instant::now()),
            ..Made::default()
        };
        Self {
            planner,
            made: Arc::new(Mutex::new(made)),
            accepted_line: line,
            accepted_at: Instant::now(),
            is_open: false,
            devices_on: false,
        }
    }

    /// The source of the job.
    pub(super) fn source(&self) -> GrowingProgram {
        GrowingProgram(Arc::clone(&self.made))
    }

    /// Whether setpoints are made.
    pub(super) fn has_setpoints(&self) -> bool {
        !lock(&self.made).setpoints.is_empty()
    }

    /// Whether another line may be accepted.
    pub(super) fn has_room(&self) -> bool {
        let made = lock(&self.made);
        made.setpoints.is_empty() || self.accepted_line.saturating_sub(made.sent_line) < MAX_AHEAD
    }

    /// Whether all that was accepted is planned and sent.
    pub(super) fn is_drained(&self) -> bool {
        !self.is_open && !self.has_setpoints()
    }

    /// Adds the steps of a line.
    ///
    /// # Errors
    /// What the machine cannot do; what was added before stays.
    pub(super) fn add(&mut self, steps: &[Step], line: u32) -> Result<(), Problem> {
        self.accepted_line = line;
        self.accepted_at = Instant::now();
        for step in steps {
            match step {
                Step::Spindle { rpm, .. } => self.devices_on = *rpm != 0,
                Step::Coolant { mist, flood, .. } => self.devices_on |= *mist || *flood,
                Step::Output { .. } => self.devices_on = true,
                _ => {}
            }
            self.is_open = true;
            self.planner.step(step)?;
        }
        self.keep_made();
        Ok(())
    }

    /// Plans what the machine waits for, and ends the job when the sender is silent and the machine
    /// stands still.
    ///
    /// # Errors
    /// A pose of the last motions that the machine cannot reach.
    pub(super) fn advance(&mut self, has_line: bool, is_standing: bool) -> Result<(), Problem> {
        let hungry_since = {
            let mut made = lock(&self.made);
            let is_empty = made.setpoints.is_empty() && !made.ended;
            is_empty.then(|| *made.hungry_since.get_or_insert_with(Instant::now))
        };
        let Some(since) = hungry_since else {
            return Ok(());
        };
        if self.is_open && since.elapsed() > HUNGER && self.accepted_at.elapsed() > HUNGER / 2 {
            self.is_open = has_line;
            self.planner.hurry(!has_line)?;
            self.keep_made();
        } else if self.is_drained() && is_standing {
            let is_quiet = self.accepted_at.elapsed() > QUIET;
            if is_quiet && !self.devices_on {
                self.end()?;
            }
        }
        Ok(())
    }

    /// Whether no line may be added.
    pub(super) fn has_ended(&self) -> bool {
        lock(&self.made).ended
    }

    /// Ends the job at standstill.
    ///
    /// # Errors
    /// As [`Feed::advance`].
    pub(super) fn end(&mut self) -> Result<(), Problem> {
        if lock(&self.made).ended {
            return Ok(());
        }
        self.is_open = false;
        let ended = self.planner.finish(self.accepted_line);
        self.keep_made();
        lock(&self.made).ended = true;
        ended
    }

    fn keep_made(&mut self) {
        let mut made = lock(&self.made);
        for planned in self.planner.made() {
            made.setpoints
                .push_back((planned.setpoint, planned.place.line));
        }
    }
}

/// What the sender wants of the running job.
#[derive(Debug, Default)]
pub(super) struct Wishes {
    pub(super) hold: bool,
    pub(super) resume: bool,
    /// For the sender.
    pub(super) messages: Vec<String>,
}

impl JobObserver for Wishes {
    fn progress(&mut self, _: &Telemetry) {}

    fn paused(&mut self, _: u32) {
        self.resume = false;
        self.messages.push("paused; ~ resumes".to_string());
    }

    fn may_resume(&mut self) -> bool {
        std::mem::take(&mut self.resume)
    }

    fn held_by_input(&mut self, what: &str) {
        self.resume = false;
        self.messages.push(format!("{what}; ~ resumes"));
    }

    fn wants_hold(&mut self) -> bool {
        std::mem::take(&mut self.hold)
    }
}
