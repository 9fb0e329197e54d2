//! `haptimill run`: a part program, from the file to the report.

mod emulated;
pub(super) mod folder;
mod progress;

use super::part::{PartProgram, Planned};
use super::{BoardArg, CliError, Exit, force};
use crate::commands::interrupt;
use clap::Args;
use emulated::emulated;
use folder::Folder;
use haptimill_client::Error;
use haptimill_client::client::{JobEnding, Options};
use haptimill_client::port::{self, DEFAULT_BAUD, PortSpec};
use haptimill_client::session::{
    self, EMERGENCY_STOP, JobEnd, JobLine, JobRecording, Line, PortLine, Session, SimLine,
};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::Fault;
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{AxisValues, Command, State};
use haptimill_report::Outcome;
use haptimill_trace::{
    Header, MCAP, MCAP_RATE, RECORD_BYTES, Recorder, Recording, RecordingError, write_mcap,
};
use progress::Bar;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::sync::Arc;

const LONG: &str = "\
Run a part program.

The program is read and checked against the machine first: reach, strokes, singularity, the speed of every slide; nothing moves when a line is \
refused. Then the machine is homed, the job streamed, and DIR filled with
  recording.hmr  every control period, binary; its SHA-256 is trace_sha256 in summary.json, the same for every run of a job in the simulator
  trace.csv      the recording in mm, degrees and newtons, every --trace-every periods
  summary.json   duration, length, errors, faults
  report.html    one page with pictures
  recording.mcap with --mcap: the recording for Foxglove and PlotJuggler
Ctrl-C stops the machine along its path; the recording is kept.

At M0 the machine stands until Enter is pressed, so a program with M0 needs a terminal, or --go-on. M1 is passed unless --optional-stop is given.";

/// What `--help` says of the faults of the simulated machine.
pub(super) fn faults_help() -> String {
    format!(
        "Faults of the simulated machine (--fault \"NAME KEY=VALUE ...\"):\n{}\n\
         NAME of an axis is that of a joint in the machine file: l1, l2, l3, l4, alpha on the H-4 arm.\n\
         at=TIME is when it begins and for=TIME how long it stays, as 1.5s, 200ms or 40us; without at= from the start, without for= to the end. The \
         time is that of the machine, homing included.",
        haptimill_hil_sim::fault::catalogue()
    )
}

/// Arguments of `haptimill run`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run a part program", long_about = LONG, after_long_help = faults_help(),
          after_help = "`haptimill run --help` says more, and lists the faults.")]
pub struct RunArgs {
    /// The part program (G-code)
    #[arg(value_name = "FILE")]
    pub program: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
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
    /// Leave recording.mcap too, 1000 samples a second, for Foxglove and PlotJuggler (`haptimill trace mcap` makes it later)
    #[arg(long)]
    pub mcap: bool,
    /// Seed of the simulated machine, instead of the one in the machine file; with the simulator only
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// What is clamped on the simulated machine's table after homing: a file like examples/block.toml. Without it nothing is cut
    #[arg(long, value_name = "FILE")]
    pub work: Option<PathBuf>,
    /// Pass pauses of the program (M0) at once instead of waiting for Enter; the simulator always does
    #[arg(long)]
    pub go_on: bool,
    /// Pause at M1 too (otherwise M1 is passed)
    #[arg(long)]
    pub optional_stop: bool,
    /// Something that goes wrong in the simulated machine, as "slide-jammed axis=l3 at=1.5s"; can be given several times. --help lists all faults
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
    /// With an emulated board: instructions that fit into a control period; one that takes more while a drive is on misses
    /// the next ones [default: as many as a chip of 168 MHz has at one cycle an instruction, 33600 in 200 us]
    #[arg(long, value_name = "INSTRUCTIONS", value_parser = clap::value_parser!(u32).range(1000..))]
    pub budget: Option<u32>,
    /// Axes under force control, as x,z, or none; the sensor is tared first [default: those of the machine file]
    #[arg(long, value_name = "AXES", value_parser = force::axes)]
    pub force: Option<force::Axes>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub gains: force::LoopArgs,
    /// Print the summary as JSON on standard output, and nothing else there; if there is none, {"error", "exit_code", "problems": [{"file", "line",
    /// "column", "message", "remedy"}]}
    #[arg(long)]
    pub json: bool,
    /// No progress bar
    #[arg(long)]
    pub quiet: bool,
}

impl RunArgs {
    /// What cannot be meant is refused, not passed over.
    fn check(&self) -> Result<(), CliError> {
        if self.force.is_none() && !self.gains.is_empty() {
            let what =
                "--fd, --ka and --kv are for the axes under force control; say which with --force";
            return Err(CliError::new(Exit::Usage, what));
        }
        if self.mcap && !MCAP {
            return Err(CliError::new(Exit::Usage, RecordingError::NoMcap));
        }
        if matches!(&self.force, Some(force::Axes(axes)) if axes.is_empty())
            && !self.gains.is_empty()
        {
            let what =
                "--fd, --ka and --kv are for the axes under force control, and --force names none";
            return Err(CliError::new(Exit::Usage, what));
        }
        if !matches!(self.port, PortSpec::Emulated(_)) {
            let name = |there: bool, name| there.then_some(name);
            let for_board = name(self.image.is_some(), "--image")
                .or(name(self.log.is_some(), "--log"))
                .or(name(self.budget.is_some(), "--budget"));
            if let Some(option) = for_board {
                let what = format!(
                    "{option} is for an emulated board; add --port pil:mps2, or leave it out"
                );
                return Err(CliError::new(Exit::Usage, what));
            }
        }
        let simulated = matches!(self.port, PortSpec::Simulator | PortSpec::Emulated(_));
        let what = if self.check || simulated {
            return Ok(());
        } else if let Some(fault) = self.fault.first() {
            format!(
                "--fault \"{fault}\": faults are for the simulator in this process; leave out --port, or give the fault to `haptimill sim serve`"
            )
        } else if let Some(work) = &self.work {
            format!(
                "--work {}: a work for the simulator in this process; leave it out, and clamp the work by hand",
                work.display()
            )
        } else if let Some(seed) = self.seed {
            format!(
                "--seed {seed} is for the simulator in this process; leave out --port, or give the seed to `haptimill sim serve`"
            )
        } else if let (PortSpec::Tcp(_), Some(baud)) = (&self.port, self.baud) {
            format!("--baud {baud} is for a serial port or the simulator; leave it out with tcp:")
        } else {
            return Ok(());
        };
        Err(CliError::new(Exit::Usage, what))
    }

    /// Whether pauses are passed at once.
    fn passes_pauses(&self) -> bool {
        self.go_on || matches!(self.port, PortSpec::Simulator | PortSpec::Emulated(_))
    }

    /// Size of the recording of a program that takes so long, about.
    fn recording_bytes(&self, machine: &MachineFile, programmed_s: f64) -> f64 {
        let seconds = programmed_s / self.rate();
        if matches!(self.port, PortSpec::Simulator | PortSpec::Emulated(_)) {
            seconds * bytes_per_s(machine)
        } else {
            // A record for every telemetry frame, one every 20 ms.
            seconds * 50.0 * RECORD_BYTES as f64
        }
    }

    /// Speed along the path as a part of the programmed one.
    fn rate(&self) -> f64 {
        f64::from(self.feed_override) / 100.0
    }

    /// A programmed duration as it will really be, for people.
    fn announced(&self, programmed_s: f64) -> String {
        let time = haptimill_report::duration(programmed_s / self.rate());
        match self.feed_override {
            100 => time,
            percent => format!("{time} at {percent} %"),
        }
    }

    /// The work that shall be clamped, in the machine's cutter.
    fn clamped(&self, machine: &MachineFile) -> Result<Option<CuttingConfig>, CliError> {
        let Some(path) = &self.work else {
            return Ok(None);
        };
        let work = haptimill_machine_file::work::load(path)?;
        let plant: PlantConfig = machine.plant()?;
        Ok(Some(plant.cutting(work)))
    }

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

/// Bytes a second of the recording of a simulated machine: a record, and what was sensed and said, every control period.
pub(super) fn bytes_per_s(machine: &MachineFile) -> f64 {
    let periods = 1e6 / f64::from(machine.config.period_us.max(1));
    periods * (RECORD_BYTES + PERIOD_BYTES) as f64
}

/// Bytes of a control period on the tape, about.
const PERIOD_BYTES: usize = 40;

/// Runs a part program.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: RunArgs) -> Result<(), CliError> {
    args.check()?;
    let chosen = args.machine.load()?;
    let machine = chosen.file.clone();
    if args.force.is_some() {
        session::find_force_config(&machine)?;
    }
    let model = Model::new(&machine);
    let home = session::find_home_pose(&machine, &model)?;
    let job = PartProgram::load(&args.program, args.optional_stop)?;
    let planned = job.plan(&machine, &model, &home)?;
    let work = args.clamped(&machine)?;
    if args.check {
        let plan = &planned.plan;
        let seconds = args.announced(plan.figures.duration_s);
        if args.json {
            let value = serde_json::json!({
                "program": job.name,
                "blocks": plan.figures.blocks,
                "setpoints": plan.setpoints.len(),
                "path_length_mm": plan.figures.path_length_mm,
                "duration_s": plan.figures.duration_s / args.rate(),
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
    if !args.passes_pauses() {
        job.check_pauses(&planned)?;
    }
    folder::has_space(
        &args.out_dir(),
        args.recording_bytes(&machine, planned.plan.figures.duration_s),
    )?;
    // Held to the end: nobody else writes there.
    let folder = Folder::take(&args.out_dir())?;
    let interrupted = interrupt::flag();
    match &args.port {
        PortSpec::Simulator => {
            let faults = args.fault.clone();
            let line = SimLine::new(session::rig(&machine, args.seed, args.baud, faults)?);
            let mut session = Session::new(line, &machine, paced(args.baud), interrupted);
            // Always the same number: a simulated job is the same job every time.
            session.connect(1)?;
            session.configure(&machine)?;
            Running {
                args: &args,
                machine: &machine,
                job: &job,
                home,
                work,
                folder,
            }
            .carry_out(session, planned)
        }
        PortSpec::Emulated(board) => emulated(&args, &machine, &job, home, planned, folder, *board),
        spec => {
            let baud = args.baud.unwrap_or(DEFAULT_BAUD);
            let line = PortLine::new(port::open(spec, baud)?);
            let serial = matches!(spec, PortSpec::Serial(_));
            let paced = paced(serial.then_some(baud));
            let mut session = Session::new(line, &machine, paced, interrupted);
            session.connect(session::fresh_number())?;
            // Without --machine it is the built-in one, whose geometry and limits the program was checked against, or the command ends here.
            let machine = chosen.file_of(&mut session)?;
            let home = session::find_home_pose(&machine, session.model())?;
            Running {
                args: &args,
                machine: &machine,
                job: &job,
                home,
                work,
                folder,
            }
            .carry_out(session, planned)
        }
    }
}

/// Options of a client on a line of so many baud: it says no more than the line carries, so nothing waits where a stop cannot overtake it.
fn paced(baud: Option<u32>) -> Options {
    let mut options = Options::default();
    options.timing.line_rate = baud.map_or(0, |baud| baud / 10);
    options
}

/// Time between two reports of a hand behind a port, microseconds.
const HAND_US: u32 = 20_000;

/// A run under way.
struct Running<'a> {
    args: &'a RunArgs,
    machine: &'a MachineFile,
    job: &'a PartProgram,
    home: AxisValues,
    work: Option<CuttingConfig>,
    folder: Folder,
}

impl Running<'_> {
    fn carry_out<L: JobLine>(
        &self,
        mut session: Session<L>,
        planned: Planned,
    ) -> Result<(), CliError> {
        self.clear(&mut session)?;
        session.enable()?;
        let status = session.status()?;
        let (start, planned) = if status.homed && status.position_kept {
            // Already homed: the program begins where the machine stands, and is checked again from there.
            let planned = self
                .job
                .plan(self.machine, session.model(), &status.commanded)?;
            (status.commanded, planned)
        } else {
            say(self.args, "homing");
            session.go_home(self.machine, &self.home)?;
            (self.home.clone(), planned)
        };
        if let Some(work) = &self.work {
            session.line_mut().clamp(work)?;
        }
        session.ask(Command::Override {
            percent: self.args.feed_override,
        })?;
        self.feel(&mut session)?;
        let simulated = matches!(self.args.port, PortSpec::Simulator | PortSpec::Emulated(_));
        if self.machine.config.haptic.is_some() && !simulated {
            // Of a controller in this process the recording has the hand anyway.
            let every = HAND_US / u32::from(self.machine.config.period_us.max(1));
            let every = every.clamp(1, u32::from(u16::MAX)) as u16;
            session.ask(Command::MasterTelemetry { every })?;
        }
        self.job(session, start, planned)
    }

    /// Force control of the job: settings, a zero of the sensor with nothing at the tool, then the axes.
    fn feel<L: JobLine>(&self, session: &mut Session<L>) -> Result<(), CliError> {
        let Some(force) = &self.machine.config.force else {
            return Ok(());
        };
        match &self.args.force {
            Some(force::Axes(axes)) => {
                session.set_force_loops(self.machine, axes, &self.args.gains.choice())?;
                // Those that are not named may be under control from before.
                session.set_force_mask(&[])?;
                if !axes.is_empty() {
                    session.tare()?;
                }
                session.set_force_mask(axes)?;
            }
            None if force.mask != 0 => session.tare()?,
            None => {}
        }
        Ok(())
    }

    /// A fault of before must be cleared by the one who saw it.
    fn clear<L: JobLine>(&self, session: &mut Session<L>) -> Result<(), CliError> {
        let status = session.status()?;
        match (status.state, status.fault) {
            (State::Fault, Some(fault)) => {
                let what = session.describe(&fault);
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
        let Planned { plan, pauses, .. } = planned;
        let dir = self.args.out_dir();
        let output = |error: &dyn std::fmt::Display| {
            CliError::new(Exit::Output, format!("{}: {error}", dir.display()))
        };
        let header = Header::of(self.machine, &self.job.name)
            .map_err(|error| CliError::new(Exit::Internal, error))?
            .with_program(&self.job.text);
        self.folder.empty()?;
        let recorder = Recorder::create(&dir.join(haptimill_report::RECORDING_FILE), &header)
            .map_err(|error| output(&error))?;
        say(
            self.args,
            &format!("running, {}", self.args.announced(plan.figures.duration_s)),
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
            Some(recorder) => recorder
                .finish()
                .map_err(|error| folder::broken(&dir, &error))?,
            None => return Err(CliError::new(Exit::Internal, "the recording was lost")),
        };
        let injected = self.args.fault.iter().map(ToString::to_string).collect();
        let outcome = match &end {
            Ok(end) => Outcome {
                setpoints: u64::from(end.setpoints),
                underruns: end.underruns.len() as u64,
                faults: faults(&session, end),
                injected,
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
                injected,
                ..Outcome::default()
            },
        };
        let summary = haptimill_report::write_all(&dir, &recorded, &outcome, self.args.trace_every)
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
        let over_s = session.now_us() as f64 * 1e-6;
        for fault in self.args.fault.iter().filter(|fault| fault.at_s > over_s) {
            eprintln!("--fault \"{fault}\" did not happen: all was over after {over_s:.2} s");
        }
        if self.args.json {
            let json = serde_json::to_string_pretty(&summary)
                .map_err(|error| CliError::new(Exit::Internal, error))?;
            tell!("{json}");
        } else {
            tell!("{}", summary.terminal().trim_end());
            tell!(
                "report      {}",
                dir.join(haptimill_report::REPORT_FILE).display()
            );
        }
        if recorded.disk_full {
            return Err(folder::disk_full(&dir).told());
        }
        end.and_then(|end| self.judge(&session, &end))
            .map_err(|error| CliError::from(error).told())
    }

    /// A job that did not reach its end is an error of the command.
    fn judge<L: JobLine>(&self, session: &Session<L>, end: &JobEnd) -> Result<(), Error> {
        for (setpoint, late) in &end.underruns {
            let ms = f64::from(*late) * f64::from(self.machine.config.period_us) / 1000.0;
            eprintln!(
                "setpoint {setpoint} was {ms:.0} ms late; the machine slowed down along its path and waited"
            );
        }
        session.check_completed(end)
    }
}

/// What went wrong with the machine during a job, in words.
fn faults<L: Line>(session: &Session<L>, end: &JobEnd) -> Vec<String> {
    let stop = (end.status.state == State::EmergencyStop).then(|| EMERGENCY_STOP.to_string());
    end.faults
        .iter()
        .map(|fault| session.describe(fault))
        .chain(stop)
        .collect()
}

/// Says something to people, unless the output is for a program.
fn say(args: &RunArgs, text: &str) {
    if !args.json && !args.quiet {
        tell!("{text}");
    }
}
