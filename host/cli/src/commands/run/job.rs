//! A run of a part program on a connected machine.

use super::args::RunArgs;
use super::lost_steps::StepJoints;
use super::operator::Operator;
use super::progress::ProgressDisplay;
use super::results::{self, ResultFolder};
use super::spool::Bytes;
use super::stream::{self, StreamEnd, StreamOptions};
use super::supply::{Supply, Times};
use crate::commands::force::ForceAxes;
use crate::commands::operator_input::Input;
use crate::commands::program::{Checked, PartProgram, Planned};
use crate::commands::{CliError, Exit, interrupt};
use haptimill_client::Error;
use haptimill_client::client::JobEnding;
use haptimill_client::session::{EMERGENCY_STOP, JobEnd, JobLine, JobRecording, Line, Session};
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_planner::Figures;
use haptimill_protocol::force::ForceLoop;
use haptimill_protocol::message::{AxisValues, Command, State, Telemetry};
use haptimill_report::{JobOutcome, Statistics, Summary};
use haptimill_trace::{Header, MCAP_RATE, Recorder, Recording, write_mcap};
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, IsTerminal as _, Seek as _, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// Statistics that the recorder adds to.
type SharedStatistics = Arc<Mutex<Statistics>>;

/// Time between two telemetry frames of a haptic arm behind a port, microseconds.
const MASTER_TELEMETRY_US: u32 = 20_000;

/// What a run sends to the machine.
pub(super) enum Work {
    /// A program that was checked and planned.
    Planned(Box<Planned>),
    /// A program that was checked, and is interpreted and planned again while it runs.
    Checked(Box<CheckedWork>),
    /// A program that is checked while it runs, and whether its blocks may come late.
    Stream(Bytes, bool),
    /// A program that was checked and asks the machine: it runs in parts. With the slowest and the
    /// fastest speed of the spindle, rev/min.
    Parts(Bytes, Option<[u16; 2]>),
}

/// A program that was checked.
pub(super) struct CheckedWork {
    pub(super) bytes: Bytes,
    pub(super) figures: Figures,
    pub(super) times: Times,
}

/// A run of a part program.
pub(super) struct Job<'a> {
    pub(super) args: &'a RunArgs,
    pub(super) machine: &'a MachineFile,
    pub(super) program: &'a PartProgram,
    /// Home pose of the machine.
    pub(super) home: AxisValues,
    pub(super) stock: Option<CuttingConfig>,
    pub(super) folder: ResultFolder,
}

impl Job<'_> {
    /// Homes the machine, runs the program and writes the results.
    ///
    /// # Errors
    /// See [`Exit`].
    pub(super) fn run<L: JobLine>(
        &self,
        session: &mut Session<L>,
        mut work: Work,
    ) -> Result<(), CliError> {
        refuse_latched_fault(session)?;
        session.enable()?;
        let status = session.status()?;
        let start = if status.homed {
            // A homed machine starts at its present pose, so the program is interpreted and checked
            // again from there: coordinates that the first block leaves out are those of the start.
            let model = session.model();
            match &mut work {
                Work::Planned(planned) => {
                    **planned = self.program.plan(self.machine, model, &status.commanded)?;
                }
                Work::Checked(checked) => {
                    let start = (model, &status.commanded);
                    checked.check_from(self.args, self.program, self.machine, start)?;
                }
                Work::Stream(..) | Work::Parts(..) => {}
            }
            status.commanded
        } else {
            self.args.print_message("homing");
            session.go_home(self.machine, &self.home)?;
            self.home.clone()
        };
        if let Work::Planned(planned) = &work {
            self.ask_approach(session, planned)?;
        }
        if let Some(stock) = &self.stock {
            session.line_mut().clamp(stock)?;
        }
        for command in self.args.overrides() {
            session.ask(command)?;
        }
        let before = self.set_force_control(session)?;
        if self.machine.config.haptic.is_some() && !self.args.port.is_simulated() {
            // The recording of a simulated machine has the haptic arm without telemetry.
            let every = MASTER_TELEMETRY_US / u32::from(self.machine.config.period_us.max(1));
            let every = every.clamp(1, u32::from(u16::MAX)) as u16;
            session.ask(Command::MasterTelemetry { every })?;
        }
        let speeds = match &work {
            Work::Planned(planned) => planned.plan.figures.spindle_rpm,
            Work::Checked(checked) => checked.figures.spindle_rpm,
            Work::Stream(..) => self.streamed_speeds(),
            Work::Parts(_, speeds) => *speeds,
        };
        let mut operator = Operator::new(self.args, self.machine, session.kept(), speeds);
        let result = self.stream(session, start, work, &mut operator);
        match before {
            Some(before) => result.and(before.restore(session)),
            None => result,
        }
    }

    /// Speeds that a streamed program may have at its spindle override, rev/min.
    fn streamed_speeds(&self) -> Option<[u16; 2]> {
        let [low, high] = self.machine.spindle.rpm;
        let percent = f64::from(self.args.spindle_override);
        let of = |speed: i16| (f64::from(speed) * 100.0 / percent).min(f64::from(i16::MAX)) as u16;
        // A machine file without limits allows every override.
        ([low, high] != [0, i16::MAX]).then(|| [of(low), of(high)])
    }

    /// Shows the approach of a program that begins in the middle, and asks for it.
    fn ask_approach<L: JobLine>(
        &self,
        session: &mut Session<L>,
        planned: &Planned,
    ) -> Result<(), CliError> {
        let Some(approach) = &planned.approach else {
            return Ok(());
        };
        self.args.print_message(approach);
        if self.args.changes.yes || self.args.port.is_simulated() {
            return Ok(());
        }
        let mut input = Input::terminal();
        let answer = input.line(session, "Move there and run? [y/N] ")?;
        let answer = answer.unwrap_or_default();
        if matches!(answer.trim(), "y" | "Y" | "yes") {
            return Ok(());
        }
        let what = "the approach was declined; nothing moved towards it";
        Err(CliError::new(Exit::Stopped, what))
    }

    /// Sets the force control: settings, zero of the sensor without contact, then the axes.
    /// Returns what it replaced.
    fn set_force_control<L: JobLine>(
        &self,
        session: &mut Session<L>,
    ) -> Result<Option<ForceBefore>, CliError> {
        let Some(force) = &self.machine.config.force else {
            return Ok(None);
        };
        let mut before = None;
        match &self.args.force {
            Some(ForceAxes(axes)) => {
                before = Some(ForceBefore::of(session, axes)?);
                session.set_force_loops(self.machine, axes, &self.args.force_settings.choice())?;
                // Other axes may still be under force control from an earlier command.
                session.set_force_mask(&[])?;
                if !axes.is_empty() {
                    session.tare()?;
                }
                session.set_force_mask(axes)?;
            }
            None if force.mask != 0 => session.tare()?,
            None => {}
        }
        Ok(before)
    }

    /// Streams the program and writes the results.
    fn stream<L: JobLine>(
        &self,
        session: &mut Session<L>,
        start: AxisValues,
        work: Work,
        operator: &mut Operator,
    ) -> Result<(), CliError> {
        let dir = self.args.out_dir();
        let output = |error: &dyn std::fmt::Display| {
            CliError::new(Exit::Output, format!("{}: {error}", dir.display()))
        };
        let header = Header::of(self.machine, &self.program.name)
            .map_err(|error| CliError::new(Exit::Internal, error))?
            .with_program(&self.program.text);
        let spindle_rpm = match &work {
            Work::Planned(planned) => planned.plan.figures.spindle_rpm.map(|[_, max]| max),
            Work::Checked(checked) => checked.figures.spindle_rpm.map(|[_, max]| max),
            Work::Stream(..) | Work::Parts(..) => None,
        };
        let supply = match work {
            Work::Planned(planned) => Supply::of(*planned, self.args, self.machine),
            Work::Checked(checked) => {
                let CheckedWork { bytes, times, .. } = *checked;
                let options = StreamOptions {
                    is_checked: true,
                    ..self.stream_options(session, &start, false)?
                };
                let model = session.model().clone();
                let mut supply = stream::start(self.program, rewound(bytes)?, model, options);
                supply.shown.times = Some(times);
                supply
            }
            Work::Stream(bytes, is_live) => {
                let options = self.stream_options(session, &start, is_live)?;
                let model = session.model().clone();
                stream::start(self.program, bytes, model, options)
            }
            Work::Parts(bytes, _) => {
                return self.run_in_parts(session, rewound(bytes)?, &start, operator);
            }
        };
        self.folder.clear()?;
        let (recorder, statistics) = self.recorder(&header).map_err(|error| output(&error))?;
        self.args.print_message(&match &supply.shown.times {
            Some(times) => {
                format!("running, {}", self.args.describe_duration(times.duration_s))
            }
            None => "running; the program is checked while it runs".to_string(),
        });
        let Supply {
            setpoints,
            shown,
            end: stream_end,
        } = supply;
        let mut progress = ProgressDisplay::new(self.args, self.machine, &shown, operator);
        let track = shown.track.clone();
        let step_joints = StepJoints::of(session, self.machine)?;
        session.line_mut().begin_recording(JobRecording::new(
            recorder,
            track.clone(),
            self.machine,
        ));
        let end = session.run_job(2, start, setpoints, &mut progress);
        let completed = matches!(&end, Ok(end) if session.check_completed(end).is_ok());
        progress.finish(completed);
        // `haptimill engrave` compares the cut plate itself.
        let lost_steps = match &end {
            Ok(end) if end.status.homed && !self.args.silent => {
                step_joints.lost(session, self.machine)?
            }
            _ => None,
        };
        // The recording is kept and reported after an error, too.
        let recorder = session.line_mut().end_recording();
        let recorded = match recorder {
            Some(recorder) => recorder
                .finish()
                .map_err(|error| results::recording_error(&dir, &error))?,
            None => return Err(CliError::new(Exit::Internal, "the recording was lost")),
        };
        // A fault whose time did not come was not injected.
        let end_s = session.now_us() as f64 * 1e-6;
        let faults = self.args.simulator.fault.iter();
        let (injected, missed): (Vec<_>, Vec<_>) = faults.partition(|fault| fault.at_s <= end_s);
        let injected = injected.iter().map(ToString::to_string).collect();
        let cut = session
            .line_mut()
            .stock()
            .map(haptimill_experiments::cut_of);
        let recorded_part = self
            .args
            .record
            .keep(self.machine)
            .describe(self.machine.config.period_us);
        let is_whole = !stream_end.as_ref().is_some_and(StreamEnd::has_error);
        let outcome = match &end {
            Ok(end) => JobOutcome {
                setpoints: u64::from(end.setpoints),
                underruns: end.underruns.len() as u64,
                faults: describe_faults(session, end)
                    .into_iter()
                    .chain(lost_steps.clone())
                    .collect(),
                injected,
                completed: is_whole
                    && matches!(end.ending, JobEnding::Done { .. })
                    && lost_steps.is_none(),
                final_state: Some(end.status.state),
                // The controller cannot know of lost steps.
                position_kept: end.status.homed && lost_steps.is_none(),
                bytes_per_setpoint: f64::from(end.sent.message_bytes)
                    / f64::from(end.setpoints.max(1)),
                line_bytes_per_setpoint: f64::from(end.sent.bytes)
                    / f64::from(end.setpoints.max(1)),
                cut,
                spindle_rpm,
                recorded_part,
            },
            // The session is lost, so only the last telemetry is known.
            Err(error) => JobOutcome {
                setpoints: session
                    .client_mut()
                    .telemetry()
                    .map_or(0, |last| u64::from(last.setpoint)),
                faults: vec![error.message.clone()],
                injected,
                recorded_part,
                ..JobOutcome::default()
            },
        };
        let every = self.args.trace_every;
        // The recorder, which had the other reference to them, has ended.
        let statistics = statistics.and_then(Arc::into_inner).map(Mutex::into_inner);
        let statistics = statistics.map(|all| all.unwrap_or_else(PoisonError::into_inner));
        let summary = haptimill_report::write_all(&dir, &recorded, &outcome, every, statistics)
            .map_err(|error| output(&error))?;
        if self.args.mcap {
            let recording = Recording::open(&dir.join(haptimill_report::RECORDING_FILE))
                .map_err(|error| output(&error))?;
            let file = File::create(dir.join(haptimill_report::MCAP_FILE))
                .map_err(|error| output(&error))?;
            let mut file = BufWriter::new(file);
            write_mcap(&recording, &mut file, MCAP_RATE).map_err(|error| output(&error))?;
            file.flush().map_err(|error| output(&error))?;
        }
        for fault in missed {
            eprintln!("--fault \"{fault}\" was not injected: the run ended at {end_s:.2} s");
        }
        let failure = if recorded.disk_full {
            Some(results::disk_full(&dir))
        } else if let Err(error) = end.and_then(|end| self.check_end(session, &end)) {
            Some(error.into())
        } else if let Some(lost) = lost_steps {
            Some(CliError::new(Exit::Fault, lost))
        } else {
            let error = stream_end
                .as_ref()
                .and_then(|end| Some((end, end.take_error()?)));
            error.map(|(end, error)| {
                let line = track.lock().place_of(u32::MAX).line;
                self.ended_early(error, (!end.is_empty()).then_some(line))
            })
        };
        if self.args.silent {
            // The caller prints its own result.
        } else if self.args.json {
            let document = Document {
                summary: &summary,
                failure: failure.as_ref().map(CliError::to_json),
            };
            let json = serde_json::to_string_pretty(&document)
                .map_err(|error| CliError::new(Exit::Internal, error))?;
            print_line!("{json}");
        } else {
            print_line!("{}", summary.terminal().trim_end());
            print_line!(
                "report      {}",
                dir.join(haptimill_report::REPORT_FILE).display()
            );
        }
        match failure {
            Some(error) if self.args.silent => Err(error),
            Some(error) => Err(error.reported()),
            None => Ok(()),
        }
    }

    /// The recorder of the run, and the statistics of all records where it keeps a part of them.
    fn recorder(&self, header: &Header) -> Result<(Recorder, Option<SharedStatistics>), CliError> {
        let output = |error: &dyn std::fmt::Display| CliError::new(Exit::Output, error);
        let path = self.args.out_dir().join(haptimill_report::RECORDING_FILE);
        let keep = self.args.record.keep(self.machine);
        let mut recorder =
            Recorder::create_thinned(&path, header, keep).map_err(|error| output(&error))?;
        let Some(part) = keep.describe(self.machine.config.period_us) else {
            return Ok((recorder, None));
        };
        recorder.event(0, 0, &format!("recorded: {part}"));
        let empty = Recording::of_header(&path, header).map_err(|error| output(&error))?;
        let statistics = Arc::new(Mutex::new(Statistics::new(&empty)));
        let all = Arc::clone(&statistics);
        let recorder = recorder.observed(move |record| {
            let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
            all.add(record);
        });
        Ok((recorder, Some(statistics)))
    }

    /// How a program is streamed.
    fn stream_options<L: JobLine>(
        &self,
        session: &Session<L>,
        start: &AxisValues,
        is_live: bool,
    ) -> Result<StreamOptions, CliError> {
        let is_quiet = self.args.json || self.args.quiet;
        Ok(StreamOptions {
            options: self.program.options(self.machine, session.model(), start)?,
            settings: self.program.settings(self.machine),
            is_live,
            is_checked: false,
            waits: self.args.port.is_simulated(),
            refuses_pauses: !self.args.skips_pauses()
                && (self.args.reads_stdin() || !std::io::stdin().is_terminal()),
            print: Box::new(move |text| {
                if !is_quiet {
                    print_line!("{text}");
                }
            }),
            interrupted: interrupt::flag(),
        })
    }

    /// The error of a streamed program that ended before its end, with the last block that was
    /// executed.
    fn ended_early(&self, error: CliError, last: Option<u32>) -> CliError {
        let last = match last {
            None => "nothing moved".to_string(),
            Some(line) => {
                format!("the machine stopped on its path; the last executed block is line {line}")
            }
        };
        CliError {
            message: format!("{}\n{}: {last}", error.message, self.program.file_name()),
            ..error
        }
    }

    /// Reports underruns, and a job that did not complete.
    fn check_end<L: JobLine>(&self, session: &Session<L>, end: &JobEnd) -> Result<(), Error> {
        for (setpoint, late) in &end.underruns {
            let ms = f64::from(*late) * f64::from(self.machine.config.period_us) / 1000.0;
            eprintln!(
                "setpoint {setpoint} was {ms:.0} ms late; the machine decelerated along its path \
                 and waited"
            );
        }
        session.check_completed(end)
    }
}

impl CheckedWork {
    /// Checks the program again, from another start.
    fn check_from(
        &mut self,
        args: &RunArgs,
        program: &PartProgram,
        machine: &MachineFile,
        start: (&Model, &AxisValues),
    ) -> Result<(), CliError> {
        self.bytes.rewind().map_err(|error| unreadable(&error))?;
        let checked = program.check_bytes(&mut self.bytes, machine, start, |_| {})?;
        self.figures = checked.figures;
        self.times = times_of(args, program, machine, start, &mut self.bytes, &checked)?;
        Ok(())
    }
}

/// The times of a checked program.
///
/// # Errors
/// Its text cannot be read again.
pub(super) fn times_of(
    args: &RunArgs,
    program: &PartProgram,
    machine: &MachineFile,
    start: (&Model, &AxisValues),
    bytes: &mut Bytes,
    checked: &Checked,
) -> Result<Times, CliError> {
    Times::of(args, machine, checked.duration_s, |take| {
        bytes.rewind().map_err(|error| unreadable(&error))?;
        program.for_each_setpoint(bytes, machine, start, take)
    })
}

/// The bytes of a program, from their start.
fn rewound(mut bytes: Bytes) -> Result<Bytes, CliError> {
    bytes.rewind().map_err(|error| unreadable(&error))?;
    Ok(bytes)
}

fn unreadable(error: &std::io::Error) -> CliError {
    let what = format!("the kept text of the program cannot be read again: {error}");
    CliError::new(Exit::Output, what)
}

/// The result of a run on standard output: one document, also where an error ends the run.
#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    summary: &'a Summary,
    #[serde(flatten)]
    failure: Option<serde_json::Value>,
}

/// Refuses a start in the middle that has to be asked for where nobody can answer.
pub(super) fn check_can_ask(args: &RunArgs, planned: &Planned) -> Result<(), CliError> {
    let asks = planned.approach.is_some() && !args.changes.yes && !args.port.is_simulated();
    if asks && (args.json || !std::io::stdin().is_terminal()) {
        let what = "--from-line asks before the approach, and there is no terminal to answer on; \
                    look at it with --check, then add --yes";
        return Err(CliError::new(Exit::Usage, what));
    }
    Ok(())
}

/// The force control before a run that has settings of its own: they end with the run.
struct ForceBefore {
    axes: Vec<u8>,
    loops: Vec<(u8, ForceLoop)>,
}

impl ForceBefore {
    /// Reads the axes under force control, and the loops of the axes of the run.
    fn of<L: JobLine>(session: &mut Session<L>, axes: &[u8]) -> Result<Self, CliError> {
        let mut loops = Vec::new();
        for axis in axes {
            loops.push((*axis, session.force_loop(*axis)?));
        }
        Ok(Self {
            axes: session.force_mask()?,
            loops,
        })
    }

    fn restore<L: JobLine>(&self, session: &mut Session<L>) -> Result<(), CliError> {
        for (axis, settings) in &self.loops {
            session.ask(Command::ForceLoop {
                axis: *axis,
                settings: *settings,
            })?;
        }
        Ok(session.set_force_mask(&self.axes)?)
    }
}

/// Messages of the faults of a job.
fn describe_faults<L: Line>(session: &Session<L>, end: &JobEnd) -> Vec<String> {
    let stop = (end.status.state == State::EmergencyStop).then(|| EMERGENCY_STOP.to_string());
    end.faults
        .iter()
        .map(|fault| session.describe(fault))
        .chain(stop)
        .collect()
}

/// Refuses to move a machine with a latched fault. The user who has seen the fault clears it.
pub(in crate::commands) fn refuse_latched_fault<L: Line>(
    session: &mut Session<L>,
) -> Result<Telemetry, CliError> {
    let status = session.status()?;
    match (status.state, &status.fault) {
        (State::Fault, Some(fault)) => {
            let fault = session.describe(fault);
            let what =
                format!("a fault is latched: {fault}; remove the cause, then `haptimill reset`");
            Err(CliError::new(Exit::Fault, what))
        }
        (State::EmergencyStop, _) => Err(CliError::new(Exit::Fault, EMERGENCY_STOP)),
        _ => Ok(status),
    }
}
