//! The state of a Grbl bridge: what the machine does, and what the sender gets.

mod lines;

use super::feed::{Feed, Wishes};
use super::input::{Input, Line as SenderLine, RealTime};
use super::report::{self, Status, alarm};
use crate::commands::CliError;
use crate::commands::requests::{NO_REPORT, Request, Requests, describe_overrides};
use crate::commands::status::StatusReport;
use haptimill_client::client::{JobEnding, Setpoints};
use haptimill_client::session::{
    HOME_JOB, Homing, JobEnd, JobRun, JobStatus, Line, Procedure as _, Session, find_home_pose,
    plan_straight_move,
};
use haptimill_gcode::{Coordinates, Dialog, Offsets, Options, Problem};
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options};
use haptimill_machine_file::work_data::WorkData;
use haptimill_protocol::message::{AxisValues, Command, State, Telemetry};
use std::path::PathBuf;

/// Smallest number of a job that is not the move to the home pose.
const FIRST_JOB: u32 = 10;

/// Lines that are handled between two exchanges with the controller, at most.
const LINES: usize = 32;

/// The limits of the overrides of Grbl, percent.
const OVERRIDES: std::ops::RangeInclusive<i16> = 10..=200;

type Bus = Session<Box<dyn Line>>;

/// What the machine does.
enum Activity {
    Nothing,
    Homing(Homing),
    /// The move to the home pose after homing.
    GoingHome(JobRun),
    /// A job of lines; it begins with its first setpoint.
    Job {
        feed: Box<Feed>,
        run: Option<JobRun>,
        start: AxisValues,
        is_jog: bool,
    },
}

pub(super) struct Bridge {
    session: Bus,
    machine: MachineFile,
    axes: [Option<usize>; 3],
    home: AxisValues,
    dialog: Dialog,
    data: WorkData,
    /// The machine file, if the offsets are kept beside it.
    file: Option<PathBuf>,
    /// Clamped on the table of the simulated machine at the first home pose.
    stock: Option<CuttingConfig>,
    input: Input,
    activity: Activity,
    wishes: Wishes,
    job_number: u32,
    /// `$C`: lines are checked and do not move the machine.
    is_checking: bool,
    /// The activity ends because the sender wants it.
    is_dropping: bool,
    /// A banner follows the end of the activity.
    is_resetting: bool,
    /// The controller is in fault or emergency stop, and the sender knows it.
    has_alarm: bool,
    overrides: [u8; 3],
    spindle_rpm: i16,
    /// Mist and flood.
    coolant: (bool, bool),
    /// Tip and period of the last report, and the speed since the one before, mm/min.
    last_tip: Option<(u64, [f64; 3])>,
    speed: f64,
    is_stopping: bool,
    answers: Vec<u8>,
    /// Requests of other processes.
    pub(super) requests: Requests,
}

impl Bridge {
    pub(super) fn new(
        mut session: Bus,
        machine: MachineFile,
        stock: Option<CuttingConfig>,
        data: WorkData,
    ) -> Result<Self, CliError> {
        let status = session.status()?;
        let here = session.model().to_engineering_units(&status.commanded);
        let file = Some(PathBuf::from(&machine.file)).filter(|path| path.is_file());
        let mut bridge = Self {
            home: find_home_pose(&machine, session.model())?,
            axes: report::axes(&machine),
            dialog: new_dialog(&machine, &data, &here),
            session,
            machine,
            data,
            file,
            stock,
            input: Input::default(),
            activity: Activity::Nothing,
            wishes: Wishes::default(),
            job_number: FIRST_JOB,
            is_checking: false,
            is_dropping: false,
            is_resetting: false,
            has_alarm: false,
            overrides: [100; 3],
            spindle_rpm: 0,
            coolant: (false, false),
            last_tip: None,
            speed: 0.0,
            is_stopping: false,
            answers: Vec::new(),
            requests: Requests::default(),
        };
        bridge.report_always();
        Ok(bridge)
    }

    /// Requests telemetry also while no job runs.
    fn report_always(&mut self) {
        let every = self.session.telemetry_periods();
        self.session
            .client_mut()
            .request(Command::Telemetry { every });
    }

    /// Takes bytes of the sender, advances the machine, and appends the answers. Returns why the
    /// bridge ends.
    ///
    /// # Errors
    /// The session with the controller ended.
    pub(super) fn advance(
        &mut self,
        bytes: &[u8],
        answers: &mut Vec<u8>,
    ) -> Result<Option<String>, CliError> {
        let mut requests = std::mem::take(&mut self.requests);
        requests.serve(|request| self.answer_other(request));
        self.requests = requests;
        for byte in bytes {
            if let Some(command) = self.input.add(*byte) {
                self.real_time(command);
            }
        }
        self.session.step()?;
        if self.session.is_interrupted() && !self.is_stopping {
            self.is_stopping = true;
            self.input.clear();
            self.drop_activity();
            self.session.stop();
        }
        self.measure();
        self.watch_faults();
        self.advance_activity()?;
        for _ in 0..LINES {
            if self.is_resetting || self.is_stopping || !self.handle_line()? {
                break;
            }
        }
        answers.append(&mut self.answers);
        if self.is_stopping
            && matches!(self.activity, Activity::Nothing)
            && !self.session.is_stopping()
        {
            let what = "stopped by the user; the machine is at standstill".to_string();
            return Ok(Some(what));
        }
        Ok(None)
    }

    fn say(&mut self, text: &str) {
        self.answers.extend_from_slice(text.as_bytes());
        self.answers.extend_from_slice(b"\r\n");
    }

    fn message(&mut self, text: &str) {
        // A line end or a bracket would end the message for the sender.
        let plain = text
            .replace(['\r', '\n'], " | ")
            .replace('[', "(")
            .replace(']', ")");
        self.say(&format!("[MSG:{plain}]"));
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        self.session.client().telemetry()
    }

    /// The commanded pose in the newest report, mm and degrees.
    fn here(&self) -> Coordinates {
        let pose = self.telemetry().map(|now| &now.commanded);
        pose.map(|pose| self.session.model().to_engineering_units(pose))
            .unwrap_or_default()
    }

    fn state(&self) -> State {
        self.telemetry().map_or(State::Disabled, |now| now.state)
    }

    /// Whether the positions are those of the machine, and it can move.
    fn is_ready(&self) -> bool {
        let is_known = |now: &Telemetry| now.homed;
        let is_latched = matches!(self.state(), State::Fault | State::EmergencyStop);
        self.telemetry().is_some_and(is_known) && !is_latched
    }

    fn real_time(&mut self, command: RealTime) {
        let change = |now: u8, by: Option<i16>| -> u8 {
            let value = by.map_or(100, |by| i16::from(now) + by);
            value.clamp(*OVERRIDES.start(), *OVERRIDES.end()) as u8
        };
        let [feed, rapid, spindle] = self.overrides;
        match command {
            RealTime::Report => {
                let text = self.status().text();
                self.say(&text);
            }
            RealTime::Hold => {
                // A job whose first setpoint is not made yet is held when it starts.
                self.wishes.hold =
                    matches!(self.activity, Activity::Job { .. }) && self.state() != State::Hold;
                self.wishes.resume = false;
                // Homing cannot be continued: it ends.
                if matches!(self.activity, Activity::Homing(_) | Activity::GoingHome(_)) {
                    self.drop_activity();
                }
            }
            RealTime::Resume => self.wishes.resume = self.state() == State::Hold,
            RealTime::Reset => {
                self.input.clear();
                self.is_checking = false;
                self.is_resetting = true;
                self.drop_activity();
            }
            RealTime::JogCancel => {
                if matches!(self.activity, Activity::Job { is_jog: true, .. }) {
                    self.drop_activity();
                }
            }
            RealTime::Feed(by) => self.set_overrides([Some(change(feed, by)), None, None]),
            RealTime::Rapid(percent) if percent != rapid => {
                self.set_overrides([None, Some(percent), None]);
            }
            RealTime::Rapid(_) => {}
            RealTime::Spindle(by) => {
                let percent = change(spindle, by);
                match self.check_spindle(percent) {
                    Ok(()) => self.set_overrides([None, None, Some(percent)]),
                    Err(what) => self.message(&what),
                }
            }
            RealTime::Switch => {
                self.message("spindle and coolant are switched by the program only");
            }
        }
    }

    /// Checks a spindle override at the present speed.
    fn check_spindle(&self, percent: u8) -> Result<(), String> {
        let speed = self.spindle_rpm.unsigned_abs();
        let speeds = (speed != 0).then_some([speed; 2]);
        self.machine.spindle.check_override(speeds, percent)
    }

    /// Sets overrides of feed, rapid moves and spindle, percent.
    fn set_overrides(&mut self, percents: [Option<u8>; 3]) {
        let commands = [
            |percent| Command::Override { percent },
            |percent| Command::RapidOverride { percent },
            |percent| Command::SpindleOverride { percent },
        ];
        for (index, percent) in percents.into_iter().enumerate() {
            if let Some(percent) = percent {
                self.overrides[index] = percent;
                let command = commands[index](percent);
                self.session.client_mut().request(command);
            }
        }
    }

    /// Does what another process requests, and describes it.
    fn answer_other(&mut self, request: Request) -> Result<String, String> {
        let is_held = self.state() == State::Hold;
        match request {
            Request::Override(percents) => {
                if let Some(percent) = percents[2] {
                    self.check_spindle(percent)?;
                }
                self.set_overrides(percents);
                Ok(describe_overrides(self.overrides))
            }
            Request::Hold if is_held => Ok("the job is held".into()),
            Request::Hold if matches!(self.activity, Activity::Nothing) => {
                Err("nothing moves".into())
            }
            Request::Hold => {
                self.real_time(RealTime::Hold);
                Ok("the machine holds along its path".into())
            }
            Request::Resume if is_held => {
                self.real_time(RealTime::Resume);
                Ok("the job continues".into())
            }
            Request::Resume => Err("the job is not held, and does not pause".into()),
            Request::Status => {
                let name = self.session.machine_name();
                let configuration = (self.session.configuration_crc(), self.session.kept());
                let model = self.session.model().clone();
                let telemetry = self.session.client_mut().telemetry().ok_or(NO_REPORT)?;
                Ok(StatusReport::new(&name, configuration, &model, telemetry).answer())
            }
        }
    }

    /// Stops the machine along its path and drops what it does.
    fn drop_activity(&mut self) {
        self.wishes = Wishes::default();
        match &self.activity {
            Activity::Nothing => return,
            // Nothing was sent.
            Activity::Job { run: None, .. } => {
                self.activity = Activity::Nothing;
                return;
            }
            _ => {}
        }
        if !std::mem::replace(&mut self.is_dropping, true) {
            self.session.stop();
            self.session.client_mut().request(Command::Stop);
        }
    }

    /// Measures the speed of the tip between two reports.
    fn measure(&mut self) {
        let Some(now) = self.telemetry() else { return };
        let (period, commanded) = (now.period, now.commanded.clone());
        if self.last_tip.is_some_and(|(last, _)| last == period) {
            return;
        }
        let tip = report::xyz(
            self.axes,
            &self.session.model().to_engineering_units(&commanded),
        );
        if let Some((last, from)) = self.last_tip.replace((period, tip)) {
            let square: f64 = tip.iter().zip(from).map(|(a, b)| (a - b) * (a - b)).sum();
            let micros =
                period.saturating_sub(last) as f64 * f64::from(self.machine.config.period_us);
            self.speed = square.sqrt() / micros.max(1.0) * 60e6;
        }
    }

    /// Whether the machine has made all that it was sent.
    fn is_standing(&self) -> bool {
        let job = self.session.client().job();
        self.speed == 0.0 && job.is_none_or(|job| job.reached + 1 >= job.sent)
    }

    fn status(&self) -> Status {
        let telemetry = self.telemetry();
        let pose = telemetry.map(|now| self.session.model().to_engineering_units(&now.commanded));
        let pose = pose.unwrap_or_default();
        let machine = report::xyz(self.axes, &pose);
        let work = report::xyz(self.axes, &self.dialog.in_program(&pose));
        let is_moving = self.speed > 0.0;
        let state = match (&self.activity, self.state()) {
            (_, State::Fault | State::EmergencyStop) => "Alarm",
            (Activity::Homing(_) | Activity::GoingHome(_), _) => "Home",
            (Activity::Job { .. }, State::Hold) if is_moving => "Hold:1",
            (Activity::Job { .. }, State::Hold) => "Hold:0",
            (Activity::Job { is_jog: true, .. }, _) => "Jog",
            // A job that only keeps the spindle on: the sender may go on.
            (Activity::Job { feed, .. }, _) if feed.is_drained() && self.is_standing() => "Idle",
            (Activity::Job { .. }, _) => "Run",
            (Activity::Nothing, _) if self.is_checking => "Check",
            (Activity::Nothing, _) if self.is_ready() => "Idle",
            (Activity::Nothing, _) => "Alarm",
        };
        Status {
            state,
            machine,
            offset: std::array::from_fn(|axis| machine[axis] - work[axis]),
            feed_mm_min: self.speed,
            spindle_rpm: self.spindle_rpm,
            coolant: self.coolant,
            overrides: self.overrides,
            room: match &self.activity {
                Activity::Job { feed, .. } => feed.has_room(),
                _ => true,
            },
        }
    }

    /// Tells the sender of a fault once.
    fn watch_faults(&mut self) {
        let is_latched = matches!(self.state(), State::Fault | State::EmergencyStop);
        if is_latched && !self.has_alarm {
            let fault = self.telemetry().and_then(|now| now.fault);
            let what = match fault {
                Some(fault) => self.session.describe(&fault),
                None => "the emergency stop is latched".to_string(),
            };
            self.say(&format!("ALARM:{}", alarm::FAULT));
            self.message(&format!("{what}; remove the cause, then $X"));
        }
        self.has_alarm = is_latched;
    }

    fn advance_activity(&mut self) -> Result<(), CliError> {
        match std::mem::replace(&mut self.activity, Activity::Nothing) {
            Activity::Nothing => self.end_activity(),
            Activity::Homing(mut homing) => match homing.advance(&mut self.session) {
                Ok(None) => self.activity = Activity::Homing(homing),
                Ok(Some(())) => self.go_home()?,
                Err(error) => self.end_homing(Some(&error.message)),
            },
            Activity::GoingHome(mut run) => {
                match run.advance(&mut self.session, &mut self.wishes)? {
                    JobStatus::Ended(end) => {
                        let failed = !matches!(end.ending, JobEnding::Done { .. });
                        let what = failed.then_some("the move to the home pose was stopped");
                        if !failed && let Some(stock) = self.stock.take() {
                            self.session.line_mut().clamp(&stock)?;
                        }
                        self.end_homing(what);
                    }
                    _ => self.activity = Activity::GoingHome(run),
                }
            }
            Activity::Job {
                mut feed,
                mut run,
                start,
                is_jog,
            } => {
                if run.is_none() && feed.has_setpoints() {
                    self.job_number += 1;
                    let setpoints = Setpoints::of(feed.source());
                    let number = self.job_number;
                    let job = JobRun::start(&mut self.session, number, start.clone(), setpoints);
                    run = Some(job);
                }
                let has_line = self.input.next().is_some();
                if !self.is_dropping
                    && let Err(problem) = feed.advance(has_line, self.is_standing())
                {
                    self.stop_at_limit(&problem, &mut feed);
                }
                if let Some(run) = &mut run {
                    match run.advance(&mut self.session, &mut self.wishes)? {
                        JobStatus::PauseOver => run.resume(&mut self.session),
                        JobStatus::Running => {}
                        JobStatus::Ended(end) => {
                            self.end_job(&end);
                            return Ok(());
                        }
                    }
                } else if feed.has_ended() && feed.is_drained() {
                    // Its lines made no setpoint.
                    return Ok(());
                }
                for text in std::mem::take(&mut self.wishes.messages) {
                    self.message(&text);
                }
                self.activity = Activity::Job {
                    feed,
                    run,
                    start,
                    is_jog,
                };
            }
        }
        Ok(())
    }

    /// Nothing moves any more.
    fn end_activity(&mut self) {
        self.is_dropping = false;
        if self.is_resetting && !self.session.is_stopping() {
            self.is_resetting = false;
            self.dialog = new_dialog(&self.machine, &self.data, &self.here());
            self.say("");
            self.say(report::BANNER);
            if !self.is_ready() {
                self.message("'$H'|'$X' to unlock");
            }
        }
    }

    fn end_job(&mut self, end: &JobEnd) {
        let was_ours = self.is_dropping || self.is_stopping;
        self.is_dropping = false;
        self.spindle_rpm = 0;
        self.coolant = (false, false);
        self.report_always();
        // The interpreter goes on where the machine is.
        let here = self
            .session
            .model()
            .to_engineering_units(&end.status.commanded);
        self.dialog.place_at(&here);
        if matches!(end.ending, JobEnding::Done { .. }) || was_ours || !end.faults.is_empty() {
            return;
        }
        self.input.clear();
        self.message(&format!("the job ended early: {}", end.ending));
        self.say(&format!("ALARM:{}", alarm::LIMIT));
    }

    /// A motion that was accepted cannot be made: what was planned before it still ends at
    /// standstill.
    fn stop_at_limit(&mut self, problem: &Problem, feed: &mut Feed) {
        self.input.clear();
        self.say(&format!("ALARM:{}", alarm::LIMIT));
        let what = format!(
            "line {}: {}; {}",
            problem.place.line, problem.what, problem.remedy
        );
        self.message(&what);
        // A planner that refused a motion refuses it again: the setpoints end here.
        let _ = feed.end();
    }

    fn go_home(&mut self) -> Result<(), CliError> {
        let here = self.session.status()?.commanded;
        let model = Model::new(&self.machine);
        match plan_straight_move(&self.machine, &model, &here, &self.home, None) {
            Ok(plan) => {
                let run = JobRun::start(&mut self.session, HOME_JOB, here, plan.setpoints);
                self.activity = Activity::GoingHome(run);
            }
            Err(error) => self.end_homing(Some(&error.message)),
        }
        Ok(())
    }

    fn end_homing(&mut self, failed: Option<&str>) {
        self.is_dropping = false;
        self.report_always();
        match failed {
            Some(what) => {
                self.message(what);
                self.say(&format!("ALARM:{}", alarm::HOMING));
            }
            None => self.say("ok"),
        }
    }
}

/// An interpreter with the modes of a program, and the offsets that a reset keeps.
fn new_dialog(machine: &MachineFile, data: &WorkData, here: &Coordinates) -> Dialog {
    let kept = &data.offsets;
    Dialog::new(&Options {
        offsets: Offsets {
            systems: kept.systems,
            g28: kept.g28,
            g30: kept.g30,
            ..Offsets::default()
        },
        tools: data.tools.clone(),
        ..program_options(machine, *here)
    })
}
