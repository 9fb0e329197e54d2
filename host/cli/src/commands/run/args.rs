//! Arguments of `haptimill run`.

use crate::commands::args::{BoardArg, PortArgs, SimulatorArgs, StockArg, check_baud};
use crate::commands::changes::ChangeArgs;
use crate::commands::force::{ForceArgs, ForceAxes, parse_axes};
use crate::commands::program::LanguageArgs;
use crate::commands::{CliError, Exit};
use clap::Args;
use haptimill_client::port::PortSpec;
use haptimill_client::session::RunTime;
use haptimill_machine_file::MachineFile;
use haptimill_planner::Plan;
use haptimill_protocol::message::Command;
use haptimill_trace::{Keep, MCAP, RECORD_BYTES, RecordingError};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

const LONG: &str = "\
Run a part program.

The command first checks the program against the machine: workspace, strokes, singularities, joint \
rates. Nothing moves when a line is refused. It then homes the machine if it is not homed, \
streams the program, and \
writes to DIR
  recording.hmr  every control period, binary; trace_sha256 in summary.json is its SHA-256, which
                 is equal for every run of a program in the simulator
  trace.csv      the recording in mm, degrees and newtons, every --trace-every periods
  summary.json   duration, length, errors, faults
  report.html    one page with plots
  recording.mcap with --mcap: the recording for Foxglove and PlotJuggler
Ctrl-C stops the machine along its path; the recording is kept.

At M0 the machine waits for Enter, so a program with M0 needs a terminal or --skip-pauses. M1 is \
passed without --optional-stop. On a terminal with a port Space or p holds the machine along its \
path, Enter continues; + and - change the feed override, i and o the rapid override, c and v the \
spindle override.

--stock, --seed and --fault are for a simulated machine (--port sim or pil:...).";

/// The table of simulator faults for `--help`.
pub(in crate::commands) fn faults_help() -> String {
    format!(
        "Faults of the simulated machine (--fault \"NAME KEY=VALUE ...\"):\n{}\n\
         joint= is the name of a joint in the machine file; a wrong name lists those of the \
         machine.\n\
         at=TIME is the start and for=TIME the duration, as 1.5s, 200ms or 40us; without at= the \
         fault begins at power-on, without for= it lasts to the end. TIME is simulated time, \
         including homing.",
        haptimill_hil_sim::fault::catalogue()
    )
}

/// Arguments of `haptimill run`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run a part program", long_about = LONG, after_long_help = faults_help(),
          after_help = "`haptimill run --help` has details and lists the faults.")]
pub struct RunArgs {
    /// Part program (G-code); - with --stream is standard input
    #[arg(value_name = "FILE")]
    pub program: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub port: PortArgs,
    /// Folder for the results; created if it does not exist [default: the program's name with .out]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Check only: nothing moves, nothing is written
    #[arg(long)]
    pub check: bool,
    /// Start at once, and check the program while it runs: the machine stops along its path before
    /// a block that cannot be executed. For programs of any length, and for standard input
    #[arg(long, conflicts_with_all = ["check", "from_line", "dry", "single"])]
    pub stream: bool,
    /// Feed override, percent of the programmed feed; above 100 as far as the limits of the machine
    /// allow
    #[arg(long = "override", value_name = "PERCENT", default_value_t = 100, value_parser = clap::value_parser!(u8).range(1..=200))]
    pub feed_override: u8,
    /// Rapid override, percent of the speed of rapid moves
    #[arg(long, value_name = "PERCENT", default_value_t = 100, value_parser = clap::value_parser!(u8).range(1..=100))]
    pub rapid_override: u8,
    /// Spindle override, percent of the programmed speed
    #[arg(long, value_name = "PERCENT", default_value_t = 100, value_parser = clap::value_parser!(u8).range(10..=200))]
    pub spindle_override: u8,
    /// Write one row of trace.csv every N control periods
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    pub trace_every: u32,
    /// What is recorded: all (a simulated job can then be replayed), every=N (one of N control
    /// periods), or last=TIME (as 90s, 10min, 2h). The figures of the summary are of all control
    /// periods
    #[arg(long, value_name = "PART", default_value = "all", value_parser = recorded_part)]
    pub record: RecordedPart,
    /// Also write recording.mcap, 1000 samples per second, for Foxglove and PlotJuggler
    /// (`haptimill trace mcap` writes it later)
    #[arg(long)]
    pub mcap: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stock: StockArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simulator: SimulatorArgs,
    /// Pass M0 pauses of the program instead of waiting for Enter; always so in the simulator
    #[arg(long)]
    pub skip_pauses: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub language: LanguageArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub changes: ChangeArgs,
    /// Serve observers on tcp:HOST:PORT (port 0 takes a free one): they get every report and
    /// command nothing (`haptimill watch`); only on a machine behind a port
    #[arg(long, value_name = "ADDRESS")]
    pub serve: Option<PortSpec>,
    /// With --serve: file with the token of the observers [default: a new token for an address that
    /// other computers can reach]
    #[arg(long, value_name = "FILE", requires = "serve")]
    pub token_file: Option<PathBuf>,
    /// Emulated board: firmware image to run instead of the one that is built
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Board emulated with its pins: file for the step, direction and enable lines that it drove
    /// (`haptimill pulses` checks it)
    #[arg(long, value_name = "FILE")]
    pub vcd: Option<PathBuf>,
    /// Emulated board: argument of the image; repeatable
    #[arg(long, value_name = "WORD", hide = true)]
    pub image_word: Vec<String>,
    /// Emulated board whose image logs: file for the binary log (`cargo xtask log` decodes it)
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Emulated board: instructions per control period. After a period that takes more while a
    /// drive is on, the next periods are missed [default: one instruction per cycle at 168 MHz,
    /// 33600 in 200 us]
    #[arg(long, value_name = "INSTRUCTIONS", value_parser = clap::value_parser!(u32).range(1000..))]
    pub budget: Option<u32>,
    /// Axes under force control, as x,z, or none; the force sensor is zeroed first [default: as
    /// the controller has them: those of the machine file, or of the last `haptimill force set`]
    #[arg(long, value_name = "AXES", value_parser = parse_axes)]
    pub force: Option<ForceAxes>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub force_settings: ForceArgs,
    /// Print only the summary as JSON on standard output; an error is {"error", "exit_code",
    /// "problems": [{"file", "line", "column", "message", "remedy"}]}
    #[arg(long)]
    pub json: bool,
    /// Print no progress bar and no notices; messages of the program, pauses and the result are
    /// printed
    #[arg(long)]
    pub quiet: bool,
    /// Print nothing on standard output, for a command that prints a result of its own.
    #[arg(skip)]
    pub silent: bool,
}

impl RunArgs {
    /// Refuses options that contradict each other.
    pub(super) fn check(&self) -> Result<(), CliError> {
        let usage = |what: &str| Err(CliError::new(Exit::Usage, what));
        if !self.force_settings.is_empty() {
            match &self.force {
                None => {
                    return usage(
                        "--force-setpoint, --virtual-mass and --virtual-damping need axes under \
                         force control; add --force AXES",
                    );
                }
                Some(ForceAxes(axes)) if axes.is_empty() => {
                    return usage(
                        "--force-setpoint, --virtual-mass and --virtual-damping need axes under \
                         force control, and --force names none",
                    );
                }
                Some(_) => {}
            }
        }
        if !self.check {
            let is_simulated = self.port.is_simulated();
            self.changes.check(is_simulated, self.skips_pauses())?;
        }
        if self.serve.is_some() && self.port.is_simulated() {
            return usage(
                "--serve is for a machine behind a port: the simulator in this process does not \
                 run in real time; use `haptimill sim serve` and --port",
            );
        }
        if self.program == Path::new("-") && !self.stream {
            return usage(
                "a program from standard input cannot be checked before it runs; add --stream, or \
                 save it in a file",
            );
        }
        if self.mcap && !MCAP {
            return Err(CliError::new(Exit::Usage, RecordingError::NoMcap));
        }
        self.check_emulated()?;
        if self.check || self.port.is_simulated() {
            return Ok(());
        }
        self.simulator.check_unused()?;
        self.stock.check_unused()?;
        check_baud(&self.port.port, self.port.baud)
    }

    /// Refuses options of emulated boards for other ports.
    fn check_emulated(&self) -> Result<(), CliError> {
        let pil = matches!(self.port.port, PortSpec::Emulated(_));
        let pins = self.port.port == PortSpec::EmulatedPins;
        let simulator = &self.simulator;
        for (refused, option, ports) in [
            (
                self.image.is_some() && !pil && !pins,
                "--image",
                "pil:mps2 or emu:pico2",
            ),
            (self.log.is_some() && !pil, "--log", "pil:mps2"),
            (self.budget.is_some() && !pil, "--budget", "pil:mps2"),
            (self.vcd.is_some() && !pins, "--vcd", "emu:pico2"),
            (
                pins && self.stock.stock.is_some(),
                "--stock",
                "sim or pil:mps2",
            ),
            (
                pins && simulator.seed.is_some(),
                "--seed",
                "sim or pil:mps2",
            ),
            (
                pins && !simulator.fault.is_empty(),
                "--fault",
                "sim or pil:mps2",
            ),
        ] {
            if refused {
                let what = format!("{option} is for --port {ports}; leave it out");
                return Err(CliError::new(Exit::Usage, what));
            }
        }
        Ok(())
    }

    /// Whether M0 pauses are passed.
    pub(super) fn skips_pauses(&self) -> bool {
        self.skip_pauses || self.port.is_simulated()
    }

    /// Whether standard input is the program, not the operator.
    pub(super) fn reads_stdin(&self) -> bool {
        self.stream && self.program == Path::new("-")
    }

    /// Estimated size of the recording of a program with this duration, and of the files from
    /// which it is made.
    pub(super) fn recording_bytes(&self, machine: &MachineFile, seconds: f64) -> f64 {
        self.record
            .bytes(machine, seconds, self.port.is_simulated())
    }

    /// Whether the overrides of motion are 100 %.
    pub(super) const fn is_at_full_speed(&self) -> bool {
        matches!((self.feed_override, self.rapid_override), (100, 100))
    }

    /// Duration of a plan at the overrides, seconds.
    pub(super) fn duration_s(&self, machine: &MachineFile, plan: &Plan) -> f64 {
        if self.is_at_full_speed() {
            return plan.figures.duration_s;
        }
        let mut time = RunTime::new(machine, self.feed_override, self.rapid_override);
        for setpoint in &plan.setpoints {
            time.add(setpoint);
        }
        time.seconds()
    }

    /// The commands that set the overrides.
    pub(super) fn overrides(&self) -> [Command; 3] {
        [
            Command::Override {
                percent: self.feed_override,
            },
            Command::RapidOverride {
                percent: self.rapid_override,
            },
            Command::SpindleOverride {
                percent: self.spindle_override,
            },
        ]
    }

    /// Describes the duration of a program at the overrides.
    pub(super) fn describe_duration(&self, seconds: f64) -> String {
        let time = haptimill_report::duration(seconds);
        match (self.feed_override, self.rapid_override) {
            (100, 100) => time,
            (feed, 100) => format!("{time} at {feed} %"),
            (feed, rapid) => format!("{time} at {feed} %, rapid moves at {rapid} %"),
        }
    }

    /// The folder for the results.
    #[must_use]
    pub fn out_dir(&self) -> PathBuf {
        let default = || {
            let stem = match self.program.file_stem() {
                Some(stem) if stem != "-" => stem,
                _ => OsStr::new("stdin"),
            };
            let mut name = stem.to_os_string();
            name.push(".out");
            PathBuf::from(name)
        };
        self.out.clone().unwrap_or_else(default)
    }

    /// Prints a message of the program to the operator, unless --json is given.
    pub(super) fn print_program_message(&self, text: &str) {
        if !self.json && !self.silent {
            print_line!("{text}");
        }
    }

    /// Prints a remark, unless --json or --quiet is given.
    pub(super) fn print_message(&self, text: &str) {
        if !self.json && !self.quiet {
            print_line!("{text}");
        }
    }
}

/// The part of the control periods that is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RecordedPart {
    /// All.
    All,
    /// One of so many.
    Every(u32),
    /// The last ones, seconds.
    Last(f64),
}

impl RecordedPart {
    /// Estimated size of the recording of a session with this duration, and of the files from which
    /// it is made.
    pub(in crate::commands) fn bytes(
        self,
        machine: &MachineFile,
        seconds: f64,
        is_simulated: bool,
    ) -> f64 {
        // One record per telemetry frame, one frame every 20 ms.
        let telemetry = 50.0 * RECORD_BYTES as f64;
        let records = match is_simulated {
            true => periods_per_s(machine) * RECORD_BYTES as f64,
            false => telemetry,
        };
        match self {
            Self::All if is_simulated => seconds * bytes_per_s(machine),
            Self::All => seconds * telemetry,
            Self::Every(periods) => {
                let thinned = periods_per_s(machine) / f64::from(periods) * RECORD_BYTES as f64;
                seconds * records.min(thinned)
            }
            // Two files in turn, and the one that is made of them.
            Self::Last(last_s) => {
                let turns = if seconds > last_s { 3.0 } else { 1.0 };
                seconds.min(last_s) * turns * records
            }
        }
    }

    /// The recording has the last records only, so that it does not grow.
    pub(in crate::commands) const fn keeps_last(self) -> bool {
        matches!(self, Self::Last(_))
    }

    /// The records that are kept.
    pub(in crate::commands) fn keep(self, machine: &MachineFile) -> Keep {
        match self {
            Self::All => Keep::All,
            Self::Every(periods) => Keep::Every(periods),
            Self::Last(seconds) => Keep::Last((seconds * periods_per_s(machine)).round() as u64),
        }
    }
}

/// Reads `all`, `every=N` or `last=TIME`.
pub(in crate::commands) fn recorded_part(text: &str) -> Result<RecordedPart, String> {
    let usage = || "write all, every=N (N from 2 on), or last=TIME (as 90s, 10min, 2h)".to_string();
    match text.split_once('=') {
        None if text == "all" => Ok(RecordedPart::All),
        Some(("every", number)) => match number.parse() {
            Ok(number) if number >= 2 => Ok(RecordedPart::Every(number)),
            _ => Err(usage()),
        },
        Some(("last", time)) => {
            let units = [("min", 60.0), ("h", 3600.0), ("s", 1.0)];
            let mut read = units.iter().filter_map(|(unit, seconds)| {
                Some(time.strip_suffix(unit)?.parse::<f64>().ok()? * seconds)
            });
            let seconds = read.next().filter(|seconds| (1.0..=1e6).contains(seconds));
            seconds.map(RecordedPart::Last).ok_or_else(usage)
        }
        _ => Err(usage()),
    }
}

fn periods_per_s(machine: &MachineFile) -> f64 {
    1e6 / f64::from(machine.config.period_us.max(1))
}

/// Bytes per second of the recording of a simulated machine: a record and the logged inputs and
/// outputs of every control period.
pub(in crate::commands) fn bytes_per_s(machine: &MachineFile) -> f64 {
    periods_per_s(machine) * (RECORD_BYTES + PERIOD_BYTES) as f64
}

/// Approximate bytes of a control period in the I/O log.
const PERIOD_BYTES: usize = 40;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_recorded_part_is_read_with_its_unit() {
        for (text, part) in [
            ("all", RecordedPart::All),
            ("every=50", RecordedPart::Every(50)),
            ("last=90s", RecordedPart::Last(90.0)),
            ("last=10min", RecordedPart::Last(600.0)),
            ("last=0.5h", RecordedPart::Last(1800.0)),
        ] {
            assert_eq!(recorded_part(text), Ok(part), "{text}");
        }
        for text in [
            "",
            "every",
            "every=1",
            "every=-3",
            "every=2.5",
            "last=",
            "last=10",
            "last=0s",
            "last=-5min",
            "last=nans",
            "last=infs",
            "last=ms",
            "none",
        ] {
            assert!(recorded_part(text).is_err(), "{text}");
        }
    }
}
