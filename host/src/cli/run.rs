//! `haptimill run`: a part program, from the file to the report.

use super::{CliError, Exit, MachineArg};
use crate::port::PortSpec;
use clap::Args;
use std::path::PathBuf;

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
    /// Controller: sim (built in), a serial port or pseudo-terminal by its path, or tcp:HOST:PORT
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
    let _ = args.machine.load()?;
    Err(CliError::new(
        Exit::Internal,
        "haptimill run: not built yet",
    ))
}
