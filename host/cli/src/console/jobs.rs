//! Jobs: a part program, a step, the move to the home pose. One at a time; each ends with its
//! session.

use super::app::App;
use super::listing::Search;
use super::view_model::{Confirm, Overlay, Severity};
use crate::commands::exit::CliError;
use crate::commands::program::{LanguageArgs, PartProgram, Pause, Pauses, source_lines};
use haptimill_client::client::JobEnding;
use haptimill_client::session::{Line as _, TimeTable, plan_straight_move};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_planner::Plan;
use haptimill_protocol::message::{Action, AxisValues, Event, State};
use haptimill_report::{count, duration};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, TryRecvError};

/// Validity of a step request after its key press, us.
const STEP_VALID_US: u64 = 150_000;

/// Longest wait for the exact pose before a program is checked from it, us. Nothing moves then: the
/// console asks first.
const POSE_TIMEOUT_US: u64 = 2_000_000;

/// A part program that was checked from a pose.
#[derive(Debug, Clone)]
pub(super) struct Checked {
    /// File name without folders.
    pub(super) name: String,
    pub(super) plan: Arc<Plan>,
    /// The time that is left at the overrides.
    pub(super) times: TimeTable,
    pauses: Pauses,
    /// Words that change nothing on this machine, and feeds that it lowers.
    notices: Vec<String>,
    /// Spindle speeds, rev/min, by the setpoints at which they are set.
    spindle: Arc<BTreeMap<u32, i16>>,
    /// Number of lines of the file.
    pub(super) lines: u32,
    /// The lines.
    source: Arc<Vec<String>>,
}

impl Checked {
    /// The text of a line of the file.
    pub(super) fn text_of(&self, line: u32) -> &str {
        let index = (line as usize).checked_sub(1);
        let line = index.and_then(|index| self.source.get(index));
        line.map_or("", String::as_str)
    }

    /// Spindle speed on the way to a setpoint, rev/min; none in a program without spindle.
    pub(super) fn spindle_rpm(&self, setpoint: u32) -> Option<i16> {
        let last = self.spindle.range(..setpoint).next_back();
        (!self.spindle.is_empty()).then(|| last.map_or(0, |(_, speed)| *speed))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Job {
    Step,
    Home,
    Program,
}

/// Requested and running jobs.
#[derive(Debug, Default)]
pub(super) struct Jobs {
    /// The selected program.
    path: Option<PathBuf>,
    /// The path that was typed last.
    typed: Option<PathBuf>,
    pub(super) checked: Option<Checked>,
    /// The folder that is read for the choice of a program.
    pub(super) search: Search,
    checking: Option<(PathBuf, Receiver<Result<Checked, CliError>>)>,
    running: Option<Job>,
    /// Homing was requested here: the move to the home pose follows it.
    homing: bool,
    /// Homing is done; the move to the home pose is pending.
    references_found: bool,
    /// A step requested just after standstill: axis, direction, and end of its validity, us. The
    /// exact pose may be reported some milliseconds later.
    pending_step: Option<(usize, bool, u64)>,
    /// A program selected just after standstill, and the end of the wait for the exact pose, us.
    pending_check: Option<(PathBuf, u64)>,
    /// The present program pause.
    pub(super) pause: Option<Pause>,
    /// Messages of the running program that were shown.
    shown_messages: usize,
    job_number: u32,
}

/// Reads and plans a part program, as `haptimill run` does.
///
/// # Errors
/// The file cannot be read, has errors, or exceeds the machine. Nothing moves.
pub(super) fn check(
    path: &Path,
    machine: &MachineFile,
    model: &Model,
    start: &AxisValues,
) -> Result<Checked, CliError> {
    let job = PartProgram::load(path, LanguageArgs::default())?;
    let planned = job.plan(machine, model, start)?;
    let source = source_lines(&job.text);
    let actions = (0..).zip(&planned.plan.setpoints);
    let spindle = actions
        .filter_map(|(index, setpoint)| match setpoint.action {
            Action::Spindle(speed) => Some((index, speed)),
            _ => None,
        })
        .collect();
    // The screen names a program without its folders.
    let short = |notice: &String| notice.replacen(&job.file_name(), &job.name, 1);
    let notices = planned.notices.iter().map(short).collect();
    Ok(Checked {
        notices,
        name: job.name,
        times: TimeTable::new(machine, &planned.plan.setpoints, 100, 100),
        plan: Arc::new(planned.plan),
        pauses: planned.pauses,
        spindle: Arc::new(spindle),
        lines: source.len() as u32,
        source: Arc::new(source),
    })
}

impl Jobs {
    /// No job. `path` is the program offered first.
    pub(super) fn new(path: Option<PathBuf>) -> Self {
        Self {
            path,
            ..Self::default()
        }
    }

    /// Name of the selected program, without folders.
    pub(super) fn selected_name(&self) -> Option<String> {
        let name = self.path.as_ref()?.file_name()?;
        Some(name.to_string_lossy().into_owned())
    }

    /// Path that was typed last, else of the selected program.
    pub(super) fn typed(&self) -> String {
        let path = self.typed.as_ref().or(self.path.as_ref());
        path.map(|path| path.display().to_string())
            .unwrap_or_default()
    }

    pub(super) fn is_running_program(&self) -> bool {
        self.running == Some(Job::Program)
    }

    pub(super) fn is_running_step(&self) -> bool {
        self.running == Some(Job::Step)
    }

    /// Forgets the running job and everything pending.
    pub(super) fn clear(&mut self) {
        self.running = None;
        self.pause = None;
        self.cancel_pending();
    }

    /// Cancels everything pending.
    pub(super) fn cancel_pending(&mut self) {
        self.homing = false;
        self.references_found = false;
        self.pending_step = None;
        self.pending_check = None;
    }

    /// Records that homing was requested.
    pub(super) fn home(&mut self) {
        self.homing = true;
        self.references_found = false;
    }
}

impl App {
    /// Checks a program from the exact commanded pose, waiting for its report after a change to
    /// idle.
    pub(super) fn check_program(&mut self, path: PathBuf) {
        self.jobs.typed = Some(path.clone());
        if self.state() == Some(State::Idle) && self.standstill_pose().is_none() {
            self.jobs.pending_check = Some((path, self.now_us() + POSE_TIMEOUT_US));
        } else {
            self.begin_check(path);
        }
    }

    /// Reads and checks a program in a thread.
    fn begin_check(&mut self, path: PathBuf) {
        let homed = self.telemetry.as_ref().is_some_and(|now| now.homed);
        let Some(start) = self
            .standstill_pose()
            .filter(|_| homed && self.session.is_configured())
        else {
            let message = "a program is checked from the present pose: \
                           the machine must be enabled, homed and idle";
            self.notify(Severity::Warning, message);
            return;
        };
        let (sender, receiver) = mpsc::channel();
        let machine = Arc::clone(&self.machine);
        let file = path.clone();
        std::thread::spawn(move || {
            let model = Model::new(&machine);
            let _ = sender.send(check(&file, &machine, &model, &start));
        });
        self.jobs.checking = Some((path, receiver));
    }

    /// Runs the checked program if the machine is still at its start pose; otherwise checks it
    /// again.
    pub(super) fn run_program(&mut self) {
        let Some(checked) = self.jobs.checked.clone() else {
            return;
        };
        match self.standstill_pose() {
            Some(pose) if pose == checked.plan.start => {
                if let Err(what) = self.check_spindle(&checked, self.overrides[2]) {
                    self.notify(Severity::Warning, what);
                    return;
                }
                if self.start(Job::Program, &checked.plan) {
                    self.notify(Severity::Info, format!("{}: started", checked.name));
                }
            }
            Some(_) => {
                if let Some(path) = self.jobs.path.clone() {
                    self.begin_check(path);
                }
            }
            None => self.notify(Severity::Warning, "the machine is not idle"),
        }
    }

    /// Computes the time that is left again, after a change of the overrides.
    pub(super) fn note_overrides(&mut self) {
        let [feed, rapid, _] = self.overrides;
        if let Some(checked) = &mut self.jobs.checked {
            checked.times = TimeTable::new(&self.machine, &checked.plan.setpoints, feed, rapid);
        }
    }

    /// Checks the speeds of a program at a spindle override.
    ///
    /// # Errors
    /// The speed that the spindle does not have.
    pub(super) fn check_spindle(&self, checked: &Checked, percent: u8) -> Result<(), String> {
        let speeds = checked.plan.figures.spindle_rpm;
        self.machine.spindle.check_override(speeds, percent)
    }

    /// Moves one pose coordinate by an exact step.
    pub(super) fn step_axis(&mut self, axis: usize, up: bool) {
        // Steps are not queued: a key press during a step is ignored.
        if self.jobs.running.is_some() {
            return;
        }
        let Some(from) = self.standstill_pose() else {
            if self.state() == Some(State::Idle) {
                self.jobs.pending_step = Some((axis, up, self.now_us() + STEP_VALID_US));
            }
            return;
        };
        if !self.telemetry.as_ref().is_some_and(|now| now.homed) {
            self.notify(Severity::Warning, "step: home the machine first");
            return;
        }
        let step = self.jogging.step();
        let mut to = self.model.to_engineering_units(&from);
        to[axis] += if up { step } else { -step };
        let to = self.model.to_axis_units(&to);
        let feed = self.jogging.rate_of(axis) * 60.0;
        match plan_straight_move(&self.machine, &self.model, &from, &to, Some(feed)) {
            Ok(plan) => {
                self.start(Job::Step, &plan);
            }
            Err(error) => self.notify(Severity::Warning, error.message),
        }
    }

    /// Clamps the given stock once the machine is at its home pose.
    fn clamp_stock(&mut self) {
        if let Some(stock) = self.settings.stock.take() {
            match self.session.line_mut().clamp(&stock) {
                Ok(()) => self.notify(
                    Severity::Info,
                    "the stock is clamped on the simulated table",
                ),
                Err(error) => self.notify(Severity::Warning, error.message),
            }
        }
    }

    fn start(&mut self, job: Job, plan: &Plan) -> bool {
        self.jobs.job_number += 1;
        let setpoints = plan.setpoints.clone();
        let number = self.jobs.job_number;
        let client = self.session.client_mut();
        let started = client.start_job(number, plan.start.clone(), setpoints);
        match started {
            Ok(()) => {
                self.jobs.running = Some(job);
                self.jobs.pause = None;
                self.jobs.shown_messages = 0;
                true
            }
            Err(error) => {
                self.notify(Severity::Warning, error.to_string());
                false
            }
        }
    }

    /// Continues pending work: a finished check, a pending step, the move to the home pose.
    pub(super) fn advance_jobs(&mut self) {
        self.advance_search();
        if let Some((path, checking)) = self.jobs.checking.take() {
            match checking.try_recv() {
                Err(TryRecvError::Empty) => self.jobs.checking = Some((path, checking)),
                Err(TryRecvError::Disconnected) => {}
                Ok(Ok(checked)) => {
                    let figures = checked.plan.figures;
                    let pauses = match checked.pauses.count() {
                        0 => String::new(),
                        pauses => format!(", {}", count(pauses, "pause")),
                    };
                    let text = format!(
                        "{}: {}, {:.1} mm, {}{pauses}",
                        checked.name,
                        count(figures.blocks, "block"),
                        figures.path_length_mm,
                        duration(figures.duration_s)
                    );
                    let notices = checked.notices.clone();
                    self.jobs.path = Some(path);
                    self.jobs.checked = Some(checked);
                    self.note_overrides();
                    for notice in &notices {
                        self.notify(Severity::Info, notice.as_str());
                    }
                    self.confirm(Confirm::Run(text, notices));
                }
                Ok(Err(error)) => {
                    // Neither the file that was refused nor the one before it is offered.
                    (self.jobs.path, self.jobs.checked) = (None, None);
                    let first = error.message.lines().next().unwrap_or_default();
                    self.notify(Severity::Warning, format!("refused: {first}"));
                    self.overlay = Overlay::Problems {
                        lines: error.message.lines().map(ToString::to_string).collect(),
                        from: 0,
                    };
                }
            }
        }
        if let Some((path, until_us)) = self.jobs.pending_check.take() {
            let waits = self.state() == Some(State::Idle) && self.standstill_pose().is_none();
            if waits && self.now_us() < until_us {
                self.jobs.pending_check = Some((path, until_us));
            } else {
                self.begin_check(path);
            }
        }
        if let Some((axis, up, until_us)) = self.jobs.pending_step.take() {
            if self.standstill_pose().is_some() {
                self.step_axis(axis, up);
            } else if self.now_us() < until_us {
                self.jobs.pending_step = Some((axis, up, until_us));
            }
        }
        if self.jobs.references_found
            && let Some(from) = self.standstill_pose()
        {
            self.jobs.cancel_pending();
            let Some(to) = self.model.home(&self.machine) else {
                return;
            };
            match plan_straight_move(&self.machine, &self.model, &from, &to, None) {
                Ok(plan) => {
                    self.start(Job::Home, &plan);
                }
                Err(error) => self.notify(Severity::Warning, error.message),
            }
        }
    }

    /// Shows the messages of the running program up to a setpoint.
    pub(super) fn show_program_messages(&mut self, setpoint: u32) {
        if !self.jobs.is_running_program() {
            return;
        }
        while let Some(checked) = &self.jobs.checked
            && let Some((due, text)) = checked.plan.messages().get(self.jobs.shown_messages)
            && *due <= setpoint
        {
            let text = text.clone();
            self.jobs.shown_messages += 1;
            self.notify(Severity::Info, text);
        }
    }

    /// Updates the jobs on an event.
    pub(super) fn update_jobs(&mut self, event: &Event) {
        match event {
            Event::Homed => self.jobs.references_found = std::mem::take(&mut self.jobs.homing),
            Event::Fault(_) => self.jobs.cancel_pending(),
            Event::Paused { setpoint } => {
                let pauses = self.jobs.checked.as_ref().map(|checked| &checked.pauses);
                self.jobs.pause = pauses.and_then(|pauses| pauses.get(*setpoint));
            }
            _ => {}
        }
    }

    /// Handles the end of a job.
    pub(super) fn job_ended(&mut self, ending: &JobEnding) {
        if matches!(ending, JobEnding::Done { .. }) {
            self.show_program_messages(u32::MAX);
        }
        let job = self.jobs.running.take();
        self.jobs.pause = None;
        let name = match (job, &self.jobs.checked) {
            (Some(Job::Program), Some(checked)) => checked.name.clone(),
            (Some(Job::Home), _) => "move to the home pose".to_string(),
            _ => "step".to_string(),
        };
        match ending {
            JobEnding::Done { .. } if job == Some(Job::Step) => {}
            JobEnding::Done { .. } => {
                self.notify(Severity::Info, format!("{name}: done"));
                if job == Some(Job::Home) {
                    self.clamp_stock();
                }
            }
            JobEnding::Dropped { .. } => self.notify(Severity::Warning, format!("{name}: dropped")),
            // The link loss is logged already.
            JobEnding::Lost { .. } => {}
            other => {
                let other = match other {
                    JobEnding::Refused {
                        error: haptimill_client::client::RequestError::Refused(refusal),
                        ..
                    } => self.session.describe(refusal),
                    other => other.to_string(),
                };
                self.notify(Severity::Warning, format!("{name}: {other}"));
            }
        }
    }
}
