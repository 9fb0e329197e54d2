//! What moves by itself once it was asked for: a part program, a step, the way to the home pose. One at a time, and each ends with its session.

use super::desk::Desk;
use super::shown::{Confirm, Overlay, Weight};
use crate::commands::CliError;
use crate::commands::part::PartProgram;
use haptimill_client::client::JobEnding;
use haptimill_client::session::plan_straight_move;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_planner::Plan;
use haptimill_protocol::message::{AxisValues, Event, State};
use haptimill_report::duration;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};

/// How long a step is meant after its key was pressed, microseconds.
const MEANT_US: u64 = 150_000;

/// How long the report of where the machine stands may take until a program is checked from there, microseconds. Nothing moves by itself then: the console asks first.
const REPORT_US: u64 = 2_000_000;

/// A part program that was checked from a pose.
#[derive(Debug, Clone)]
pub(super) struct Checked {
    /// Name of the file, without folders.
    pub(super) name: String,
    pub(super) plan: Arc<Plan>,
    /// Setpoints at which the program pauses, with the line that says so.
    pauses: Arc<BTreeMap<u32, u32>>,
    /// Lines of the file.
    pub(super) lines: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Job {
    Step,
    Home,
    Program,
}

/// What was asked for.
#[derive(Debug, Default)]
pub(super) struct Work {
    path: Option<PathBuf>,
    pub(super) checked: Option<Checked>,
    checking: Option<Receiver<Result<Checked, CliError>>>,
    running: Option<Job>,
    /// Homing was asked for here: when the references are found, the way to the home pose follows.
    homing: bool,
    /// They are found.
    found: bool,
    /// A step that was pressed when the machine had just come to rest, and until when it is still meant (microseconds): the report of where it
    /// stands may be some milliseconds behind.
    step: Option<(usize, bool, u64)>,
    /// A program that was chosen when the machine had just come to rest, and until when the report of where it stands is waited for (microseconds).
    chosen: Option<(PathBuf, u64)>,
    /// The line at which the program pauses.
    pub(super) pause_line: Option<u32>,
    numbers: u32,
}

/// Reads and plans a part program, as `haptimill run` does.
///
/// # Errors
/// The file, its mistakes, or what the machine cannot do; nothing moves.
pub(super) fn check(
    path: &Path,
    machine: &MachineFile,
    model: &Model,
    start: &AxisValues,
) -> Result<Checked, CliError> {
    let job = PartProgram::load(path, false)?;
    let planned = job.plan(machine, model, start)?;
    Ok(Checked {
        name: job.name,
        plan: Arc::new(planned.plan),
        pauses: Arc::new(planned.pauses),
        lines: planned.lines,
    })
}

impl Work {
    /// Nothing is asked for yet; `path` is the program that is offered first.
    pub(super) fn new(path: Option<PathBuf>) -> Self {
        Self {
            path,
            ..Self::default()
        }
    }

    /// Name of the program that was chosen last, without folders.
    pub(super) fn offered(&self) -> Option<String> {
        let name = self.path.as_ref()?.file_name()?;
        Some(name.to_string_lossy().into_owned())
    }

    /// The program that was chosen last.
    pub(super) fn path(&self) -> String {
        self.path
            .as_ref()
            .map(|path| path.display().to_string())
            .unwrap_or_default()
    }

    pub(super) fn runs_program(&self) -> bool {
        self.running == Some(Job::Program)
    }

    pub(super) fn runs_step(&self) -> bool {
        self.running == Some(Job::Step)
    }

    /// What is under way is over; nothing follows it.
    pub(super) fn forget(&mut self) {
        self.running = None;
        self.pause_line = None;
        self.nothing_follows();
    }

    /// Whatever ends now, nothing follows it.
    pub(super) fn nothing_follows(&mut self) {
        self.homing = false;
        self.found = false;
        self.step = None;
        self.chosen = None;
    }

    /// Homing begins.
    pub(super) fn home(&mut self) {
        self.homing = true;
        self.found = false;
    }
}

impl Desk {
    /// Checks a program from where the machine stands, as soon as that is known: it is said to be idle some milliseconds before.
    pub(super) fn check_program(&mut self, path: &str) {
        let path = PathBuf::from(path);
        if self.state() == Some(State::Idle) && self.standing().is_none() {
            self.work.chosen = Some((path, self.now_us() + REPORT_US));
        } else {
            self.begin_check(path);
        }
    }

    /// Reads and checks a program beside everything else.
    fn begin_check(&mut self, path: PathBuf) {
        let homed = self
            .telemetry
            .as_ref()
            .is_some_and(|now| now.homed && now.position_kept);
        let Some(start) = self.standing().filter(|_| homed && self.configured) else {
            let what = "a program is checked from where the machine stands: enabled, homed, idle";
            self.say(Weight::Warning, what);
            return;
        };
        self.work.path = Some(path.clone());
        let (sender, receiver) = mpsc::channel();
        let machine = Arc::clone(&self.machine);
        std::thread::spawn(move || {
            let model = Model::new(&machine);
            let _ = sender.send(check(&path, &machine, &model, &start));
        });
        self.work.checking = Some(receiver);
    }

    /// A program that was checked is run, if the machine still stands where it begins.
    pub(super) fn run_program(&mut self) {
        let Some(checked) = self.work.checked.clone() else {
            return;
        };
        match self.standing() {
            Some(pose) if pose == checked.plan.start => {
                if self.start(Job::Program, &checked.plan) {
                    self.say(Weight::Note, format!("{}: begun", checked.name));
                }
            }
            Some(_) => {
                let path = self.work.path();
                self.check_program(&path);
            }
            None => self.say(Weight::Warning, "the machine does not stand idle"),
        }
    }

    /// Moves one pose coordinate by a step, exactly.
    pub(super) fn step_axis(&mut self, axis: usize, up: bool) {
        // Nothing waits for its turn: a press during a step is no step.
        if self.work.running.is_some() {
            return;
        }
        let Some(from) = self.standing() else {
            if self.state() == Some(State::Idle) {
                self.work.step = Some((axis, up, self.now_us() + MEANT_US));
            }
            return;
        };
        if !self.telemetry.as_ref().is_some_and(|now| now.homed) {
            self.say(Weight::Warning, "a step: home the machine first");
            return;
        }
        let step = self.jogging.step();
        let mut to = self.model.to_people(&from);
        to[axis] += if up { step } else { -step };
        let to = self.model.to_units(&to);
        let feed = self.jogging.rate_of(axis) * 60.0;
        match plan_straight_move(&self.machine, &self.model, &from, &to, Some(feed)) {
            Ok(plan) => {
                self.start(Job::Step, &plan);
            }
            Err(error) => self.say(Weight::Warning, error.message),
        }
    }

    /// The work that was given is clamped once the machine is at its home pose, as an operator does it.
    fn clamp(&mut self) {
        if let Some(work) = self.settings.work.take() {
            match self.connection.clamp(&work) {
                Ok(()) => self.say(Weight::Note, "the work is clamped on the simulated table"),
                Err(why) => self.say(Weight::Warning, why),
            }
        }
    }

    fn start(&mut self, job: Job, plan: &Plan) -> bool {
        self.work.numbers += 1;
        let setpoints = plan.setpoints.clone();
        let started = self
            .client
            .start_job(self.work.numbers, plan.start.clone(), setpoints);
        match started {
            Ok(()) => {
                self.work.running = Some(job);
                self.work.pause_line = None;
                true
            }
            Err(error) => {
                self.say(Weight::Warning, error.to_string());
                false
            }
        }
    }

    /// Goes on with what follows by itself: a check that is done, the way home.
    pub(super) fn advance_work(&mut self) {
        if let Some(checking) = &self.work.checking
            && let Ok(result) = checking.try_recv()
        {
            self.work.checking = None;
            match result {
                Ok(checked) => {
                    let figures = checked.plan.figures;
                    let pauses = match checked.pauses.len() {
                        0 => String::new(),
                        count => format!(", {count} pauses"),
                    };
                    let text = format!(
                        "{}: {} blocks, {:.1} mm, {}{pauses}",
                        checked.name,
                        figures.blocks,
                        figures.path_length_mm,
                        duration(figures.duration_s)
                    );
                    self.work.checked = Some(checked);
                    self.confirm(Confirm::Run(text));
                }
                Err(error) => {
                    self.overlay = Overlay::Problems {
                        lines: error.message.lines().map(ToString::to_string).collect(),
                        from: 0,
                    };
                }
            }
        }
        if let Some((path, until_us)) = self.work.chosen.take() {
            let waits = self.state() == Some(State::Idle) && self.standing().is_none();
            if waits && self.now_us() < until_us {
                self.work.chosen = Some((path, until_us));
            } else {
                self.begin_check(path);
            }
        }
        if let Some((axis, up, until_us)) = self.work.step.take() {
            if self.standing().is_some() {
                self.step_axis(axis, up);
            } else if self.now_us() < until_us {
                self.work.step = Some((axis, up, until_us));
            }
        }
        if self.work.found
            && let Some(from) = self.standing()
        {
            self.work.nothing_follows();
            let Some(to) = self.model.home(&self.machine) else {
                return;
            };
            match plan_straight_move(&self.machine, &self.model, &from, &to, None) {
                Ok(plan) => {
                    self.start(Job::Home, &plan);
                }
                Err(error) => self.say(Weight::Warning, error.message),
            }
        }
    }

    /// What events mean for the work.
    pub(super) fn work_event(&mut self, event: &Event) {
        match event {
            Event::Homed => self.work.found = std::mem::take(&mut self.work.homing),
            Event::Fault(_) => self.work.nothing_follows(),
            Event::Paused { setpoint } => {
                let line = self
                    .work
                    .checked
                    .as_ref()
                    .and_then(|checked| checked.pauses.get(setpoint));
                self.work.pause_line = Some(line.copied().unwrap_or(0));
            }
            _ => {}
        }
    }

    /// The job is over.
    pub(super) fn job_ended(&mut self, ending: &JobEnding) {
        let job = self.work.running.take();
        self.work.pause_line = None;
        let name = match (job, &self.work.checked) {
            (Some(Job::Program), Some(checked)) => checked.name.clone(),
            (Some(Job::Home), _) => "way to the home pose".to_string(),
            _ => "step".to_string(),
        };
        match ending {
            JobEnding::Done { .. } if job == Some(Job::Step) => {}
            JobEnding::Done { .. } => {
                self.say(Weight::Note, format!("{name}: done"));
                if job == Some(Job::Home) {
                    self.clamp();
                }
            }
            JobEnding::Dropped { .. } => self.say(Weight::Warning, format!("{name}: dropped")),
            // The loss of the link says it.
            JobEnding::Lost { .. } => {}
            other => {
                let other = match other {
                    JobEnding::Refused {
                        error: haptimill_client::client::RequestError::Refused(refusal),
                        ..
                    } => self
                        .model
                        .with_axes(|axes| axes.describe(refusal).to_string()),
                    other => other.to_string(),
                };
                self.say(Weight::Warning, format!("{name}: {other}"));
            }
        }
    }
}
