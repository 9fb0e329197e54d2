//! `haptimill teleop`: a hand leads the machine from afar.

mod orders;
mod shown;
mod spec;

use super::run::folder::{self, Folder};
use super::{BoardArg, CliError, Exit, run, seconds};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::board::Chosen;
use haptimill_client::client::Options;
use haptimill_client::port::{self, DEFAULT_BAUD, PortSpec};
use haptimill_client::session::{
    self, JobLine, JobRecording, PortLine, Reconnection, Session, SimLine,
};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::{Fault, FaultKind};
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::{MachineFile, work};
use haptimill_protocol::message::{Command, State};
use haptimill_teleop::arm::Pace;
use haptimill_teleop::input::{self, Joystick, Keyboard, SpaceMouse, VirtualHandle};
use haptimill_teleop::script::{self, BUILT_IN, ScriptedOperator};
use haptimill_teleop::{
    Arm, Ended, MasterDevice, OperatorLine, Outcome, Row, Script, Teleop, TeleopOptions,
};
use haptimill_trace::{Header, Recorded, Recorder, Recording, RecordingError, export_csv};
use shown::{Shown, terminal};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

pub use spec::HandSpec;

const LONG: &str = "\
A hand leads the machine from afar: the tool follows it, and the force on the tool comes back to it.

--hand says where the hand is:
  sim               a simulated haptic arm on a simulated board of its own, with a person who carries out examples/teleop.toml
  script:FILE       the same with another script: strokes, button, orders at their times
  PORT              a haptic arm: the controller behind a serial port, or tcp:HOST:PORT, whose machine file has role = \"master\"
  joystick[:PATH]   a game controller (Linux) [/dev/input/js0]: sticks move while the first button is held
  mouse3d:PATH      a 3D mouse (Linux, /dev/input/event*): its cap moves while the first button is held
  keyboard          arrows or wasd for x and y, r and f (page up and down) for z, + and - for the step; space holds, g goes on, q ends
The machine is the built-in one in the simulator, or behind --port. With a script and the simulator all runs in virtual time, and leaves the same bits every time.

Orders are read from standard input, one a line, where the hand is not a script: hold, resume, stop, end, reset-hand, gp=SCALE. When the hand is not heard of for stale_ms (50) the machine slows down along \
its path and holds. It goes on when `resume` says so, and from where hand and tool are then. Ctrl-C stops.

DIR gets recording.hmr (`haptimill replay`, `trace`), trace.csv, hand.csv (each report: hand, tool, forces) and summary.json; with a simulated arm also hand.hmr, its own recording.";

/// Arguments of `haptimill teleop`.
#[derive(Debug, Clone, Args)]
#[command(about = "A hand leads the machine from afar, and feels the force on the tool", long_about = LONG, after_long_help = run::faults_help(),
          after_help = "`haptimill teleop --help` says more.")]
pub struct TeleopArgs {
    /// The hand: sim, script:FILE, a port of a haptic arm, joystick or joystick:PATH, mouse3d:PATH or keyboard
    #[arg(long, value_name = "HAND")]
    pub hand: HandSpec,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    /// Controller of the machine: sim (built in), a serial port or pseudo-terminal by its path, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", default_value = "sim")]
    pub port: PortSpec,
    /// Machine file of the arm [default: machines/hand-master.toml, built in]
    #[arg(long, value_name = "FILE")]
    pub hand_machine: Option<PathBuf>,
    /// Replace the configuration of the arm's board by the one of --hand-machine where the names differ
    #[arg(long, requires = "hand_machine")]
    pub replace_hand_machine: bool,
    /// Baud rate of the machine's serial port
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Baud rate of the arm's serial port
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub hand_baud: Option<u32>,
    /// Coordinates that the hand leads, by their names in the machine file
    #[arg(
        long,
        value_name = "AXES",
        value_delimiter = ',',
        default_value = "x,y,z"
    )]
    pub axes: Vec<String>,
    /// G_P: how far the tool goes for a way of the hand, 0.1 to 2 [default: that of the machine file]
    #[arg(long, value_name = "SCALE", value_parser = gp)]
    pub gp: Option<f64>,
    /// How old the newest word of the hand may be before the machine holds, ms; more than the way from the arm to the machine takes [default: that of the
    /// machine file, 50]
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(5..=1000))]
    pub stale: Option<u16>,
    /// End after so many seconds [default: with a script when it says so, otherwise never]
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
    /// Reports a second, of hand and machine; a serial port that carries fewer gets fewer
    #[arg(long, value_name = "HZ", default_value_t = 200, value_parser = clap::value_parser!(u32).range(20..=1000))]
    pub rate: u32,
    /// Speed of the spindle while the hand leads, rev/min
    #[arg(long, value_name = "RPM", default_value_t = 0, value_parser = clap::value_parser!(i16).range(-30_000..=30_000), allow_negative_numbers = true)]
    pub spindle: i16,
    /// Largest speed of a handle that keys or sticks move, mm/s
    #[arg(long, value_name = "MM_S", default_value_t = 20.0, value_parser = speed)]
    pub speed: f64,
    /// Delay of the simulated arm's link, each way, ms
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub delay: Option<u16>,
    /// Something that goes wrong at the simulated arm or its link, as "link-cut at=3s for=1s"; can be given several times
    #[arg(long, value_name = "FAULT")]
    pub hand_fault: Vec<Fault>,
    /// Something that goes wrong in the simulated machine; can be given several times. --help lists all faults
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<Fault>,
    /// Seed of the simulated machine, instead of the one in the machine file
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// What is clamped on the simulated machine's table after homing: a file like examples/block.toml
    #[arg(long, value_name = "FILE")]
    pub work: Option<PathBuf>,
    /// Folder for the results; made when it is not there
    #[arg(long, value_name = "DIR", default_value = "teleop.out")]
    pub out: PathBuf,
    /// A row of trace.csv every so many control periods
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    pub trace_every: u32,
    /// Print the summary as JSON on standard output, and nothing else there
    #[arg(long)]
    pub json: bool,
    /// Say nothing while it goes
    #[arg(long)]
    pub quiet: bool,
}

/// Reads G_P.
fn gp(text: &str) -> Result<f64, String> {
    let scale: f64 = text.parse().map_err(|_| "write 0.1 to 2".to_string())?;
    script::scale(scale).map(|_| scale)
}

fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.1..=200.0).contains(&value) => Ok(value),
        _ => Err("write mm/s, 0.1 to 200".to_string()),
    }
}

/// Bytes of a report of the machine, and of the hand, about.
const MACHINE_BYTES: u32 = 170;
const HAND_BYTES: u32 = 85;

/// The table of what was reported.
const TABLE_FILE: &str = "hand.csv";

/// The recording of the arm's controller.
const HAND_RECORDING: &str = "hand.hmr";

impl TeleopArgs {
    /// What cannot be meant is refused, not passed over.
    fn check(&self) -> Result<(), CliError> {
        let scripted = matches!(self.hand, HandSpec::Script(_));
        let armed = scripted || matches!(self.hand, HandSpec::Port(_));
        let simulated = self.port == PortSpec::Simulator;
        let what = if let PortSpec::Emulated(board) = self.port {
            format!("--port {board}: an emulated board is no port here; use sim, or a port")
        } else if matches!(
            self.hand,
            HandSpec::Port(PortSpec::Simulator | PortSpec::Emulated(_))
        ) {
            "--hand: write sim, or the port of an arm".to_string()
        } else if !scripted && (self.delay.is_some() || !self.hand_fault.is_empty()) {
            "--delay and --hand-fault are for the simulated arm; use --hand sim or script:FILE"
                .to_string()
        } else if !armed && (self.hand_machine.is_some() || self.hand_baud.is_some()) {
            "--hand-machine and --hand-baud are for a haptic arm".to_string()
        } else if !simulated
            && (self.work.is_some() || self.seed.is_some() || !self.fault.is_empty())
        {
            "--work, --seed and --fault are for the simulated machine; leave out --port".to_string()
        } else {
            return Ok(());
        };
        Err(CliError::new(Exit::Usage, what))
    }

    /// Pose coordinates that the hand leads.
    fn led(&self, machine: &MachineFile) -> Result<Vec<u8>, CliError> {
        let names: Vec<&str> = machine.pose.iter().map(|axis| axis.name.as_str()).collect();
        let mut led = Vec::new();
        for wanted in &self.axes {
            let wanted = wanted.trim().to_lowercase();
            let found = names.iter().position(|name| name.to_lowercase() == wanted);
            let Some(index) = found else {
                let what = format!(
                    "there is no axis '{wanted}'; this machine has {}",
                    names.join(", ")
                );
                return Err(CliError::new(Exit::Usage, what));
            };
            if !led.contains(&(index as u8)) {
                led.push(index as u8);
            }
        }
        Ok(led)
    }

    /// Time between reports of so many bytes on a port, at most half of what it carries.
    fn every_us(&self, spec: &PortSpec, baud: Option<u32>, bytes: u32) -> u32 {
        let wanted = 1_000_000 / self.rate;
        match spec {
            PortSpec::Serial(_) => {
                let line = baud.unwrap_or(DEFAULT_BAUD) / 10;
                wanted.max(2 * bytes * 1000 / (line / 1000).max(1))
            }
            _ => wanted,
        }
    }

    /// Says something to people.
    fn say(&self, what: &str) {
        if !self.json && !self.quiet {
            tell!("{what}");
        }
    }
}

/// Bytes a second of a port.
fn line_rate(spec: &PortSpec, baud: Option<u32>) -> u32 {
    match spec {
        PortSpec::Serial(_) => baud.unwrap_or(DEFAULT_BAUD) / 10,
        _ => 0,
    }
}

/// Leads a machine by hand.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: TeleopArgs) -> Result<(), CliError> {
    args.check()?;
    let chosen = args.machine.load()?;
    let machine = chosen.file.clone();
    if machine.is_master() {
        let what = format!(
            "{}: a haptic arm alone; --machine is the machine that it leads",
            machine.file
        );
        return Err(CliError::new(Exit::BadInput, what));
    }
    no_arm(&machine)?;
    let mut machine = machine.with_follow()?;
    if let (Some(follow), Some(stale)) = (&mut machine.config.follow, args.stale) {
        follow.stale_ms = stale;
    }
    if let (Some(follow), Some(delay)) = (&machine.config.follow, args.delay) {
        in_time(delay, follow.stale_ms)?;
    }
    let axes = args.led(&machine)?;
    // All that can be wrong with the hand is told before the machine moves.
    let script = match &args.hand {
        HandSpec::Script(None) => Some(Script::parse("examples/teleop.toml", BUILT_IN)?),
        HandSpec::Script(Some(file)) => Some(Script::load(file)?),
        _ => None,
    };
    let arm_chosen = Chosen {
        file: match &args.hand_machine {
            Some(file) => MachineFile::load(file)?,
            None => MachineFile::built_in_master()?,
        },
        named: args.hand_machine.is_some(),
        replace: args.replace_hand_machine,
        base: None,
        is_second: true,
    };
    let arm_machine = arm_chosen.file.clone();
    Arm::<OperatorLine>::check(&arm_machine)?;
    let work = match &args.work {
        Some(path) => {
            let plant: PlantConfig = machine.plant()?;
            Some(plant.cutting(work::load(path)?))
        }
        None => None,
    };
    let options = TeleopOptions {
        axes,
        scale: args.gp,
        every_us: args.every_us(&args.port, args.baud, MACHINE_BYTES),
        duration_s: args.duration.or(script.as_ref().map(Script::end_s)),
        spindle_rpm: args.spindle,
        orders: script.as_ref().map(Script::orders).unwrap_or_default(),
        stale_ms: machine
            .config
            .follow
            .as_ref()
            .map_or(u16::MAX, |follow| follow.stale_ms),
        real_time: args.port == PortSpec::Simulator && script.is_none(),
    };
    let run = Run {
        args: &args,
        machine: &machine,
        chosen: &chosen.completed(machine.clone()),
        work: work.as_ref(),
        options: &options,
        dir: &args.out,
    };
    match (&args.hand, script) {
        (HandSpec::Script(_), Some(script)) => {
            let mut faults = args.hand_fault.clone();
            faults.extend(args.delay.map(delay));
            let rig = session::rig(&arm_machine, None, None, faults)?;
            let line = OperatorLine::new(SimLine::new(rig), ScriptedOperator::new(&script));
            let folder = Folder::take(&args.out)?;
            let pace = Pace {
                every_us: 1_000_000 / args.rate,
                line_rate: 0,
            };
            let mut number = 0;
            let numbers = Box::new(move || {
                number += 1;
                number
            });
            let reconnection = Reconnection {
                numbers,
                reopen: None,
            };
            let mut arm = Arm::new(line, &arm_machine, None, pace, reconnection)?;
            let outcome = run.with(&mut arm, &folder, |arm| {
                let recording = run.recording(&arm_machine, HAND_RECORDING)?;
                arm.line_mut().begin_recording(recording);
                Ok(())
            })?;
            let recorded = run.finished(arm.line_mut().end_recording())?;
            run.tell(outcome, Some(recorded))
        }
        (HandSpec::Port(spec), _) => {
            let baud = args.hand_baud;
            let line = PortLine::new(port::open(spec, baud.unwrap_or(DEFAULT_BAUD))?);
            let pace = Pace {
                every_us: args.every_us(spec, baud, HAND_BYTES),
                line_rate: line_rate(spec, baud),
            };
            let again = spec.clone();
            let reconnection = Reconnection {
                numbers: Box::new(session::fresh_number),
                reopen: Some(Box::new(move || {
                    port::open(&again, baud.unwrap_or(DEFAULT_BAUD)).map(PortLine::new)
                })),
            };
            let mut arm = Arm::new(line, &arm_machine, Some(arm_chosen), pace, reconnection)?;
            run.alone(&mut arm)
        }
        (HandSpec::Joystick(path), _) => {
            let device = Joystick::new(input::open(path, "game controller", "js")?, args.speed);
            run.alone(&mut VirtualHandle::new(device, &path.display().to_string()))
        }
        (HandSpec::Mouse3d(path), _) => {
            let device = SpaceMouse::new(input::open(path, "3D mouse", "event")?, args.speed);
            run.alone(&mut VirtualHandle::new(device, &path.display().to_string()))
        }
        _ => keyboard(&run),
    }
}

#[cfg(unix)]
fn keyboard(run: &Run<'_>) -> Result<(), CliError> {
    let terminal = input::terminal::Terminal::take()?;
    run.args.say(
        "arrows or wasd: x and y, r and f: z, + and -: the step; space holds, g goes on, q ends",
    );
    let keys = Keyboard::new(terminal, run.args.speed);
    run.alone(&mut VirtualHandle::new(keys, "the keyboard"))
}

#[cfg(not(unix))]
fn keyboard(_: &Run<'_>) -> Result<(), CliError> {
    let what = "--hand keyboard needs a Unix terminal";
    Err(CliError::new(Exit::Usage, what))
}

/// A machine with an arm on its own board is led by that one.
fn no_arm(machine: &MachineFile) -> Result<(), CliError> {
    if machine.config.haptic.is_none() {
        return Ok(());
    }
    let what = format!(
        "{}: this machine has a haptic arm on its own board, and is led by that one; a hand afar would not be heard",
        machine.file
    );
    Err(CliError::new(Exit::BadInput, what))
}

/// A link that is late from the start.
fn delay(ms: u16) -> Fault {
    Fault {
        what: FaultKind::LinkDelay {
            ms: f64::from(ms),
            direction: haptimill_hil_sim::fault::Direction::Both,
        },
        at_s: 0.0,
        for_s: None,
    }
}

/// A link that makes every word of the hand too old to lead is refused.
fn in_time(delay: u16, stale: u16) -> Result<(), CliError> {
    if delay < stale {
        return Ok(());
    }
    // Twice the way is enough for reports, and for links that are a little later than they are said to be.
    let remedy = match 2 * delay + 20 {
        enough @ ..=1000 => format!("--stale {enough}, or a shorter --delay"),
        _ if delay < 1000 => "--stale 1000, or a shorter --delay".to_string(),
        _ => "a shorter --delay".to_string(),
    };
    let what = format!(
        "--delay {delay}: each word of the hand is too old when it arrives, for --stale is {stale} ms, and the tool would never move; give {remedy}"
    );
    Err(CliError::new(Exit::Usage, what))
}

/// A session under way.
struct Run<'a> {
    args: &'a TeleopArgs,
    machine: &'a MachineFile,
    chosen: &'a Chosen,
    work: Option<&'a CuttingConfig>,
    options: &'a TeleopOptions,
    dir: &'a Path,
}

impl Run<'_> {
    fn output(&self, error: &dyn std::fmt::Display) -> CliError {
        CliError::new(Exit::Output, format!("{}: {error}", self.dir.display()))
    }

    fn recording(&self, machine: &MachineFile, file: &str) -> Result<JobRecording, CliError> {
        let header =
            Header::of(machine, "teleop").map_err(|error| CliError::new(Exit::Internal, error))?;
        let recorder =
            Recorder::create(&self.dir.join(file), &header).map_err(|error| self.output(&error))?;
        Ok(JobRecording::unplanned(recorder, machine))
    }

    fn finished(&self, recorder: Option<Recorder>) -> Result<Recorded, CliError> {
        recorder
            .ok_or_else(|| CliError::new(Exit::Internal, "the recording was lost"))?
            .finish()
            .map_err(|error| folder::broken(self.dir, &error))
    }

    /// With a source that leaves nothing of its own.
    fn alone<S: MasterDevice>(&self, source: &mut S) -> Result<(), CliError> {
        let folder = Folder::take(self.dir)?;
        let outcome = self.with(source, &folder, |_| Ok(()))?;
        self.tell(outcome, None)
    }

    /// Leads; when the machine is ready the folder is emptied and `ready` is called.
    fn with<S: MasterDevice>(
        &self,
        source: &mut S,
        folder: &Folder,
        ready: impl FnOnce(&mut S) -> Result<(), CliError>,
    ) -> Result<(Outcome, Recorded), CliError> {
        let (args, machine) = (self.args, self.machine);
        if let (Some(seconds), PortSpec::Simulator) = (self.options.duration_s, &args.port) {
            folder::has_space(self.dir, seconds * run::bytes_per_s(machine))?;
        }
        source.prepare()?;
        let interrupted = interrupt::flag();
        match &args.port {
            PortSpec::Simulator => {
                let rig = session::rig(machine, args.seed, args.baud, args.fault.clone())?;
                let line = SimLine::new(rig);
                let session = Session::new(line, machine, Options::default(), interrupted);
                // Always the same number: a scripted session is the same session every time.
                self.lead(session, 1, source, folder, ready)
            }
            spec => {
                let line = PortLine::new(port::open(spec, args.baud.unwrap_or(DEFAULT_BAUD))?);
                let mut options = Options::default();
                options.timing.line_rate = line_rate(spec, args.baud);
                let session = Session::new(line, machine, options, interrupted);
                self.lead(session, session::fresh_number(), source, folder, ready)
            }
        }
    }

    fn lead<L: JobLine, S: MasterDevice>(
        &self,
        mut session: Session<L>,
        number: u32,
        source: &mut S,
        folder: &Folder,
        ready: impl FnOnce(&mut S) -> Result<(), CliError>,
    ) -> Result<(Outcome, Recorded), CliError> {
        session.connect(number)?;
        self.make_ready(&mut session)?;
        folder.empty()?;
        ready(source)?;
        let recording = self.recording(self.machine, haptimill_report::RECORDING_FILE)?;
        session.line_mut().begin_recording(recording);
        let file = std::fs::File::create(self.dir.join(TABLE_FILE))
            .map_err(|error| self.output(&error))?;
        let mut table = BufWriter::new(file);
        let mut written = table.write_all(Row::HEAD.as_bytes());
        let mut shown = Shown::new(self.args);
        let keyboard = matches!(self.args.hand, HandSpec::Keyboard | HandSpec::Script(_));
        let lines = (!keyboard).then(orders::listen);
        self.args.say("the hand leads");
        let teleop = Teleop::new(&mut session, source, self.options).with_order_input(lines);
        let outcome = teleop.run(&mut |row, event| {
            if let Some(row) = row {
                if written.is_ok() {
                    written = table.write_all(row.to_csv().as_bytes());
                }
                shown.row(row);
            }
            if let Some(event) = event {
                shown.event(event);
            }
        });
        shown.done();
        // Whatever happened, what was recorded is kept.
        let recorded = self.finished(session.line_mut().end_recording());
        written
            .and_then(|()| table.flush())
            .map_err(|error| self.output(&error))?;
        let (outcome, recorded) = (outcome?, recorded?);
        let trace = || -> Result<(), RecordingError> {
            let recording = Recording::open(&self.dir.join(haptimill_report::RECORDING_FILE))?;
            let path = self.dir.join(haptimill_report::TRACE_FILE);
            let file = std::fs::File::create(&path)
                .map_err(|error| RecordingError::Io(path.clone(), error))?;
            let mut file = BufWriter::new(file);
            export_csv(&recording, &mut file, self.args.trace_every)?;
            file.flush()
                .map_err(|error| RecordingError::Io(path, error))
        };
        trace().map_err(|error| self.output(&error))?;
        Ok((outcome, recorded))
    }

    /// Homed, with nothing latched, the work clamped and the sensor tared.
    fn make_ready<L: JobLine>(&self, session: &mut Session<L>) -> Result<(), CliError> {
        let (args, machine) = (self.args, self.machine);
        let other = session.client_mut().controller();
        if let Some(arm) = other.filter(|other| other.config_crc != 0 && other.axes == 0) {
            let what = format!(
                "\"{}\" is a haptic arm, not a machine; --hand is for the arm, --port for the machine",
                arm.machine
            );
            return Err(CliError::new(Exit::Command, what));
        }
        let status = session.status()?;
        if let (State::Fault | State::EmergencyStop, fault) = (status.state, status.fault) {
            let what = fault.map_or("the emergency stop".to_string(), |f| session.describe(&f));
            let what =
                format!("a fault is latched: {what}; remove the cause, then `haptimill reset`");
            return Err(CliError::new(Exit::Fault, what));
        }
        if args.port == PortSpec::Simulator {
            session.configure(machine)?;
        } else {
            no_arm(&self.chosen.file_of(session)?)?;
        }
        session.enable()?;
        if !status.homed || !status.position_kept {
            args.say("homing");
            let home = session::find_home_pose(machine, session.model())?;
            session.go_home(machine, &home)?;
        }
        if let Some(work) = self.work {
            session.line_mut().clamp(work)?;
        }
        if machine.config.force.is_some() {
            session.set_force_mask(&[])?;
            session.tare()?;
        }
        Ok(session.ask(Command::Override { percent: 100 })?)
    }

    /// The summary, on disk and for whoever asked.
    fn tell(
        &self,
        (outcome, recorded): (Outcome, Recorded),
        hand: Option<Recorded>,
    ) -> Result<(), CliError> {
        let value = serde_json::json!({
            "machine": self.machine.config.name.as_str(),
            "session": outcome,
            "periods": recorded.records,
            "trace_sha256": recorded.sha256,
            "hand_trace_sha256": hand.map(|hand| hand.sha256),
        });
        let text = format!("{value:#}\n");
        std::fs::write(self.dir.join(haptimill_report::SUMMARY_FILE), &text)
            .map_err(|error| self.output(&error))?;
        if self.args.json {
            tell!("{value:#}");
        } else {
            tell!("{}", terminal(&outcome).trim_end());
            tell!("results in {}", self.dir.display());
        }
        if recorded.disk_full {
            return Err(folder::disk_full(self.dir).told());
        }
        let (exit, why) = match outcome.ended {
            Ended::Done => return Ok(()),
            Ended::Stopped => (Exit::Stopped, "stopped by the operator".to_string()),
            Ended::Fault => (
                Exit::Fault,
                format!("machine fault: {}", outcome.faults.join("; ")),
            ),
            Ended::MasterLost => (Exit::Port, "the hand is lost".to_string()),
            Ended::HapticFault => (Exit::Fault, "the arm is off".to_string()),
        };
        let error = CliError::new(exit, outcome.because.unwrap_or(why));
        Err(if self.args.json { error.told() } else { error })
    }
}
