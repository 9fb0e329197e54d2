//! `haptimill run`: a part program, from the file to the report.

use super::{CliError, Exit, MachineArg};
use crate::client::{JobEnding, Options};
use crate::machine::MachineFile;
use crate::model::{Model, program_options, settings};
use crate::plan::Plan;
use crate::port::{self, DEFAULT_BAUD, PortSpec};
use crate::program;
use crate::record::{Header, Recorder};
use crate::report::{self, Outcome};
use crate::session::{
    self, JobEnd, JobLine, JobRecording, Line, PortLine, Session, SimLine, Watcher, interrupt,
};
use clap::Args;
use haptimill_hil_sim::fault::Fault;
use haptimill_protocol::message::{Action, AxisValues, Command, State, Telemetry};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

const LONG: &str = "\
Run a part program.

The program is read and checked against the machine first: reach, strokes, singularity, the speed of every slide; nothing moves when a line is \
refused. Then the machine is homed, the job streamed, and DIR filled with
  recording.hmr  every control period, binary, hashed
  trace.csv      the recording in mm, degrees and newtons, every --trace-every periods
  summary.json   duration, length, errors, faults
  report.html    one page with pictures
Ctrl-C stops the machine along its path; the recording is kept.";

/// Arguments of `haptimill run`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run a part program", long_about = LONG)]
pub struct RunArgs {
    /// The part program (G-code)
    #[arg(value_name = "FILE")]
    pub program: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Controller: sim (built in), pil:mps2 or pil:mps2-m7 (simulated machine, controller on an emulated Cortex-M4F or M7), a serial port or
    /// pseudo-terminal by its path, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", default_value = "sim")]
    pub port: PortSpec,
    /// Baud rate of a serial port (default 115200); with the simulator, paces the simulated link (default: unpaced)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Folder for the results; made when it is not there [default: the program's name with .out]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Check only: nothing moves, nothing is written
    #[arg(long)]
    pub check: bool,
    /// Speed along the path in percent of the programmed one
    #[arg(long = "override", value_name = "PERCENT", default_value_t = 100, value_parser = clap::value_parser!(u8).range(1..=100))]
    pub feed_override: u8,
    /// A row of trace.csv every so many control periods
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    pub trace_every: u32,
    /// Seed of the simulated machine, instead of the one in the machine file
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Pass pauses of the program (M0) at once instead of waiting for Enter; the simulator always does
    #[arg(long)]
    pub go_on: bool,
    /// Something that goes wrong in the simulated machine, as "slide-jammed axis=2 at=1.5s"; can be given several times
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<Fault>,
    /// With an emulated board: this image, instead of the one that is built
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// With an emulated board: a word of the image's command line; can be given several times
    #[arg(long, value_name = "WORD", hide = true)]
    pub image_word: Vec<String>,
    /// With an emulated board whose image logs: the file for what it logs, as it comes (`cargo xtask log` makes text of it)
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// With an emulated board: instructions that fit into a control period; one that takes more misses the next ones. A chip of
    /// 168 MHz has 33600 in 200 us at one cycle an instruction [default: not looked at]
    #[arg(long, value_name = "INSTRUCTIONS", value_parser = clap::value_parser!(u32).range(1000..))]
    pub budget: Option<u32>,
    /// Print the summary as JSON on standard output, and nothing else there
    #[arg(long)]
    pub json: bool,
    /// No progress bar
    #[arg(long)]
    pub quiet: bool,
}

impl RunArgs {
    /// The folder for the results.
    pub fn out_dir(&self) -> PathBuf {
        let beside = || {
            let mut name = self.program.file_stem().unwrap_or_default().to_os_string();
            name.push(".out");
            PathBuf::from(name)
        };
        self.out.clone().unwrap_or_else(beside)
    }
}

/// Runs a part program.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: RunArgs) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    let model = Model::new(&machine);
    let home = model.home(&machine).ok_or_else(|| {
        CliError::new(
            Exit::BadInput,
            format!("{}: the home preset has no pose", machine.file),
        )
    })?;
    let job = PartProgram::load(&args.program)?;
    let planned = job.plan(&machine, &model, &home)?;
    if args.check {
        let plan = &planned.plan;
        let seconds = report::duration(plan.figures.duration_s);
        if args.json {
            let value = serde_json::json!({
                "program": job.name,
                "blocks": plan.figures.blocks,
                "setpoints": plan.setpoints.len(),
                "path_length_mm": plan.figures.path_length_mm,
                "duration_s": plan.figures.duration_s,
            });
            tell!("{value:#}");
        }
        say(
            &args,
            &format!(
                "{}: well; {} blocks, {} setpoints, {:.1} mm, {seconds}",
                job.name,
                plan.figures.blocks,
                plan.setpoints.len(),
                plan.figures.path_length_mm
            ),
        );
        return Ok(());
    }
    job.check_pauses(&args, &planned)?;
    prepare(&args.out_dir())?;
    let interrupted = interrupt::flag();
    match &args.port {
        PortSpec::Simulator => {
            let faults = args.fault.clone();
            let line = SimLine::new(session::rig(&machine, args.seed, args.baud, faults)?);
            let session = Session::new(line, &machine, paced(args.baud), interrupted);
            // Always the same number: a simulated job is the same job every time.
            Running {
                args: &args,
                machine: &machine,
                job: &job,
                home,
            }
            .carry_out(session, 1, planned)
        }
        PortSpec::Emulated(board) => emulated(&args, &machine, &job, home, planned, *board),
        spec => {
            if let Some(fault) = args.fault.first() {
                let what =
                    format!("--fault \"{fault}\" is for the simulator only; leave out --port");
                return Err(CliError::new(Exit::Usage, what));
            }
            let baud = args.baud.unwrap_or(DEFAULT_BAUD);
            let line = PortLine::new(port::open(spec, baud)?);
            let serial = matches!(spec, PortSpec::Serial(_));
            let session = Session::new(line, &machine, paced(serial.then_some(baud)), interrupted);
            Running {
                args: &args,
                machine: &machine,
                job: &job,
                home,
            }
            .carry_out(session, session::fresh_number(), planned)
        }
    }
}

/// Runs a part program on an emulated board, with the simulated machine around it.
#[cfg(unix)]
fn emulated(
    args: &RunArgs,
    machine: &MachineFile,
    job: &PartProgram,
    home: AxisValues,
    planned: Planned,
    board: port::Board,
) -> Result<(), CliError> {
    use crate::session::pil::{self, Instructions};
    use haptimill_hil_sim::remote::RemoteController;
    let setup = pil::Setup {
        words: args.image_word.clone(),
        log: args.log.clone(),
    };
    let image = match &args.image {
        Some(image) => image.clone(),
        None => pil::image(board)?,
    };
    let emulator = pil::Emulator::start_with(board, &image, &setup)?;
    let period_us = machine.config.period_us;
    let mut remote = RemoteController::begin(emulator, period_us)
        .map_err(|reason| CliError::new(Exit::Port, format!("{board}: {reason}")))?;
    if let Some(budget) = args.budget {
        remote.set_budget(pil::counts(budget));
    }
    let cost = remote.cost();
    let rig = session::rig_around(remote, machine, args.seed, args.baud, args.fault.clone())?;
    let line = SimLine::named(rig, &board.to_string());
    let session = Session::new(line, machine, paced(args.baud), interrupt::flag());
    Running {
        args,
        machine,
        job,
        home,
    }
    .carry_out(session, 1, planned)?;
    let instructions = Instructions::of(
        &cost
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner),
    );
    say(
        args,
        &format!(
            "{board}  {:.0} instructions a control period, at most {:.0}; {} bytes of stack; at most {} bytes in the receive ring; {} to {} setpoints \
             in the queue",
            instructions.mean,
            instructions.worst,
            instructions.stack_bytes,
            instructions.ring_peak,
            instructions.queue_low.unwrap_or(instructions.queue_high),
            instructions.queue_high
        ),
    );
    if instructions.missed > 0 {
        say(
            args,
            &format!(
                "{board}  {} control periods were missed: one before took more instructions than there are in a period",
                instructions.missed
            ),
        );
    }
    let path = args.out_dir().join("instructions.json");
    let output = |error: &dyn std::fmt::Display| {
        CliError::new(Exit::Output, format!("{}: {error}", path.display()))
    };
    let json = serde_json::to_string_pretty(&instructions).map_err(|error| output(&error))?;
    std::fs::write(&path, json).map_err(|error| output(&error))
}

/// Emulated boards need named pipes.
#[cfg(not(unix))]
fn emulated(
    _: &RunArgs,
    _: &MachineFile,
    _: &PartProgram,
    _: AxisValues,
    _: Planned,
    board: port::Board,
) -> Result<(), CliError> {
    Err(CliError::new(
        Exit::Usage,
        format!("{board}: emulated boards need a Unix system"),
    ))
}

/// Options of a client on a line of so many baud: it says no more than the line carries, so nothing waits where a stop cannot overtake it.
fn paced(baud: Option<u32>) -> Options {
    let mut options = Options::default();
    options.timing.line_rate = baud.map_or(0, |baud| baud / 10);
    options
}

/// A program that was checked.
struct Planned {
    plan: Plan,
    /// Setpoints at which the program pauses, with the line that says so.
    pauses: BTreeMap<u32, u32>,
}

/// A part program on disk.
struct PartProgram {
    /// Name of the file, without folders: it goes into the recording, which is the same wherever it was made.
    name: String,
    file: String,
    text: Vec<u8>,
}

impl PartProgram {
    fn load(path: &Path) -> Result<Self, CliError> {
        let file = path.display().to_string();
        let text = std::fs::read(path).map_err(|error| {
            CliError::new(
                Exit::BadInput,
                format!("{file}: cannot be read: {error}; check the path"),
            )
        })?;
        let name = path
            .file_name()
            .map_or_else(|| file.clone(), |name| name.to_string_lossy().into_owned());
        Ok(Self { name, file, text })
    }

    /// The checked motion of the program from a pose.
    fn plan(
        &self,
        machine: &MachineFile,
        model: &Model,
        start: &AxisValues,
    ) -> Result<Planned, CliError> {
        let options = program_options(machine, model.to_people(start));
        let program = program::read(&self.file, &self.text, &options)
            .map_err(|refused| CliError::new(Exit::BadInput, refused))?;
        let plan = Plan::new(&program, &settings(machine), model)
            .map_err(|refused| CliError::new(Exit::Refused, refused))?;
        // Each pause of the program has a setpoint of its own, in the same order.
        let setpoints = (0..)
            .zip(&plan.setpoints)
            .filter(|(_, setpoint)| setpoint.action == Action::Pause);
        let lines = program.steps.iter().filter_map(|step| match step {
            program::Step::Pause { place } => Some(place.line),
            _ => None,
        });
        let pauses = setpoints.map(|(index, _)| index).zip(lines).collect();
        Ok(Planned { plan, pauses })
    }

    /// A pause waits for Enter: somebody must be able to press it.
    fn check_pauses(&self, args: &RunArgs, planned: &Planned) -> Result<(), CliError> {
        match planned.pauses.values().next() {
            Some(line) if !passes_pauses(args) && !std::io::stdin().is_terminal() => {
                Err(CliError::new(
                    Exit::Usage,
                    format!(
                        "{}:{line}: the program pauses here and there is no terminal to press Enter on; run it in a terminal, or with --go-on",
                        self.file
                    ),
                ))
            }
            _ => Ok(()),
        }
    }
}

/// Sees to it that the results can be written, before anything moves.
fn prepare(dir: &Path) -> Result<(), CliError> {
    let file = dir.join(report::RECORDING_FILE);
    let writable = || -> std::io::Result<()> {
        std::fs::create_dir_all(dir)?;
        let there_was_one = file.exists();
        std::fs::OpenOptions::new()
            .append(true)
            .create(true)
            .open(&file)?;
        if !there_was_one {
            std::fs::remove_file(&file)?;
        }
        // What an earlier run left would be taken for the result of this one.
        for name in [
            report::RECORDING_FILE,
            report::TRACE_FILE,
            report::SUMMARY_FILE,
            report::REPORT_FILE,
        ] {
            let old = dir.join(name);
            if old.exists() {
                std::fs::remove_file(old)?;
            }
        }
        Ok(())
    };
    writable().map_err(|error| {
        CliError::new(
            Exit::Output,
            format!(
                "{}: {error}; choose another folder with --out",
                dir.display()
            ),
        )
    })
}

/// A run under way.
struct Running<'a> {
    args: &'a RunArgs,
    machine: &'a MachineFile,
    job: &'a PartProgram,
    home: AxisValues,
}

impl Running<'_> {
    fn carry_out<L: JobLine>(
        &self,
        mut session: Session<L>,
        number: u32,
        planned: Planned,
    ) -> Result<(), CliError> {
        session.connect(number)?;
        session.configure(self.machine)?;
        self.clear(&mut session)?;
        session.enable()?;
        let status = session.status()?;
        let (start, planned) = if status.homed && status.position_kept {
            // Already homed: the program begins where the machine stands, and is checked again from there.
            let planned = self
                .job
                .plan(self.machine, session.model(), &status.wanted)?;
            (status.wanted, planned)
        } else {
            say(self.args, "homing");
            let end = session.go_home(self.machine, &self.home)?;
            self.well_ended(&session, &end)?;
            (self.home.clone(), planned)
        };
        session.ask(Command::Override {
            percent: self.args.feed_override,
        })?;
        self.job(session, start, planned)
    }

    /// A fault of before must be cleared by the one who saw it.
    fn clear<L: JobLine>(&self, session: &mut Session<L>) -> Result<(), CliError> {
        let status = session.status()?;
        match (status.state, status.fault) {
            (State::Fault, Some(fault)) => {
                let what = session.sentence(&fault);
                Err(CliError::new(
                    Exit::Fault,
                    format!("a fault is latched: {what}; remove the cause, then `haptimill reset`"),
                ))
            }
            (State::EmergencyStop, _) => Err(CliError::new(Exit::Fault, EMERGENCY_STOP)),
            _ => Ok(()),
        }
    }

    fn job<L: JobLine>(
        &self,
        mut session: Session<L>,
        start: AxisValues,
        planned: Planned,
    ) -> Result<(), CliError> {
        let Planned { plan, pauses } = planned;
        let dir = self.args.out_dir();
        let output = |error: &dyn std::fmt::Display| {
            CliError::new(Exit::Output, format!("{}: {error}", dir.display()))
        };
        let header = Header::of(self.machine, &self.job.name)
            .map_err(|error| CliError::new(Exit::Internal, error))?;
        let recorder = Recorder::create(&dir.join(report::RECORDING_FILE), &header)
            .map_err(|error| output(&error))?;
        say(
            self.args,
            &format!("running, {}", report::duration(plan.figures.duration_s)),
        );
        let plan = Arc::new(plan);
        let setpoints = plan.setpoints.clone();
        let mut watcher = Bar::new(self.args, &plan, pauses);
        session.line_mut().begin_recording(JobRecording::new(
            recorder,
            Arc::clone(&plan),
            self.machine,
        ));
        let end = session.run_job(2, start, setpoints, &mut watcher);
        watcher.done();
        // Whatever happened, what was recorded is kept and reported.
        let recorder = session.line_mut().end_recording();
        let recorded = match recorder {
            Some(recorder) => recorder.finish().map_err(|error| output(&error))?,
            None => return Err(CliError::new(Exit::Internal, "the recording was lost")),
        };
        let outcome = match &end {
            Ok(end) => Outcome {
                setpoints: u64::from(end.setpoints),
                underruns: end.underruns.len() as u64,
                faults: faults(&session, end),
                completed: matches!(end.ending, JobEnding::Done { .. }),
                final_state: Some(end.status.state),
                position_kept: end.status.position_kept,
                bytes_per_setpoint: f64::from(end.sent.message_bytes)
                    / f64::from(end.setpoints.max(1)),
                line_bytes_per_setpoint: f64::from(end.sent.bytes)
                    / f64::from(end.setpoints.max(1)),
            },
            // The session broke: what the controller does now is not known, only what it said last.
            Err(error) => Outcome {
                setpoints: session
                    .client_mut()
                    .telemetry()
                    .map_or(0, |last| u64::from(last.setpoint)),
                faults: vec![error.message.clone()],
                ..Outcome::default()
            },
        };
        let summary = report::write_all(&dir, &recorded, &outcome, self.args.trace_every)
            .map_err(|error| output(&error))?;
        if self.args.json {
            let json = serde_json::to_string_pretty(&summary)
                .map_err(|error| CliError::new(Exit::Internal, error))?;
            tell!("{json}");
        } else {
            tell!("{}", summary.terminal().trim_end());
            tell!("report      {}", dir.join(report::REPORT_FILE).display());
        }
        self.well_ended(&session, &end?)
    }

    /// A job that did not reach its end is an error of the command.
    fn well_ended<L: JobLine>(&self, session: &Session<L>, end: &JobEnd) -> Result<(), CliError> {
        for (setpoint, late) in &end.underruns {
            let ms = f64::from(*late) * f64::from(self.machine.config.period_us) / 1000.0;
            eprintln!(
                "setpoint {setpoint} was {ms:.0} ms late; the machine slowed down along its path and waited"
            );
        }
        if let Some(fault) = end.faults.first() {
            return Err(session.fault(fault));
        }
        if end.status.state == State::EmergencyStop {
            return Err(CliError::new(Exit::Fault, EMERGENCY_STOP));
        }
        if end.stopped {
            return Err(CliError::new(
                Exit::Stopped,
                "stopped by the user; the position is kept",
            ));
        }
        match &end.ending {
            JobEnding::Done { .. } => Ok(()),
            JobEnding::Dropped { setpoints, .. } => Err(CliError::new(
                Exit::Stopped,
                format!("the job was stopped from elsewhere after {setpoints} setpoints"),
            )),
            JobEnding::Lost { error, .. } => Err(CliError::new(Exit::Port, error)),
            other => Err(CliError::new(Exit::Command, other)),
        }
    }
}

/// The emergency stop, in words.
const EMERGENCY_STOP: &str =
    "the emergency stop is latched, the drives are off; release it, then `haptimill reset`";

/// What went wrong with the machine during a job, in words.
fn faults<L: Line>(session: &Session<L>, end: &JobEnd) -> Vec<String> {
    let stop = (end.status.state == State::EmergencyStop).then(|| EMERGENCY_STOP.to_string());
    end.faults
        .iter()
        .map(|fault| session.sentence(fault))
        .chain(stop)
        .collect()
}

/// Says something to people, unless the output is for a program.
fn say(args: &RunArgs, text: &str) {
    if !args.json && !args.quiet {
        tell!("{text}");
    }
}

/// Whether pauses are passed at once.
fn passes_pauses(args: &RunArgs) -> bool {
    args.go_on || matches!(args.port, PortSpec::Simulator | PortSpec::Emulated(_))
}

/// The progress bar, with the time left.
struct Bar {
    bar: ProgressBar,
    begun: Instant,
    /// The job takes its own time; in the simulator it goes by faster.
    real_time: bool,
    period_s: f64,
    lines: Vec<u32>,
    pauses: BTreeMap<u32, u32>,
    passes_pauses: bool,
    entered: Arc<AtomicBool>,
}

impl Bar {
    fn new(args: &RunArgs, plan: &Plan, pauses: BTreeMap<u32, u32>) -> Self {
        let total = (plan.figures.duration_s * 1000.0).round() as u64;
        let shown = !args.json && !args.quiet;
        let bar = ProgressBar::with_draw_target(
            Some(total),
            if shown {
                ProgressDrawTarget::stderr()
            } else {
                ProgressDrawTarget::hidden()
            },
        );
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent:>3} %  {msg}") {
            bar.set_style(style);
        }
        let lines = (0..plan.setpoints.len())
            .map(|setpoint| plan.line_of(setpoint))
            .collect();
        Self {
            bar,
            begun: Instant::now(),
            real_time: args.port != PortSpec::Simulator,
            period_s: plan.period_s,
            lines,
            pauses,
            passes_pauses: passes_pauses(args),
            entered: Arc::new(AtomicBool::new(false)),
        }
    }

    fn done(&self) {
        self.bar.finish_and_clear();
    }
}

impl Watcher for Bar {
    fn progress(&mut self, telemetry: &Telemetry) {
        let done = f64::from(telemetry.program_periods) * self.period_s;
        let total = self.bar.length().unwrap_or(0) as f64 / 1000.0;
        self.bar.set_position((done * 1000.0) as u64);
        let line = self
            .lines
            .get(telemetry.setpoint as usize)
            .copied()
            .unwrap_or(0);
        let pace = if self.real_time {
            1.0
        } else {
            self.begun.elapsed().as_secs_f64() / done.max(0.1)
        };
        let left = ((total - done).max(0.0) * pace).ceil();
        let left = match left {
            s if s < 60.0 => format!("{s} s"),
            s => report::duration(s),
        };
        self.bar.set_message(format!("line {line}, {left} left"));
    }

    fn paused(&mut self, setpoint: u32) {
        let line = self.pauses.get(&setpoint).copied().unwrap_or(0);
        if self.passes_pauses {
            self.bar
                .println(format!("line {line}: a pause, passed at once"));
            return;
        }
        self.bar.println(format!(
            "line {line}: the program pauses; Enter goes on, Ctrl-C ends it"
        ));
        self.entered.store(false, Ordering::Relaxed);
        let entered = Arc::clone(&self.entered);
        // Reading a line waits; the session must go on meanwhile, or the controller would miss its host.
        std::thread::spawn(move || {
            let mut line = String::new();
            if std::io::stdin()
                .read_line(&mut line)
                .is_ok_and(|count| count > 0)
            {
                entered.store(true, Ordering::Relaxed);
            }
        });
    }

    fn goes_on(&mut self) -> bool {
        self.passes_pauses || self.entered.swap(false, Ordering::Relaxed)
    }
}
