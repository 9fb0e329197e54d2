//! `haptimill console`: the operator's full-screen console.

use super::{BoardArg, CliError};
use clap::Args;
use haptimill_client::port::PortSpec;
use haptimill_hil_sim::fault::Fault;
use std::path::PathBuf;

const LONG: &str = "\
The operator's console, over the whole terminal: state and what to do next, pose, slides, forces, jog with keys, hold, resume, stop, override, part \
programs, recording. The key ? shows all keys.

Four keys are heard always: Space holds, Ctrl-R resumes, Ctrl-X stops, Ctrl-E is the emergency stop (drives off). Each is a command over the port; it takes \
nothing away from the emergency stop of the machine.

A jog ends when its key is no longer pressed: at once where the terminal tells of releases (the kitty keyboard protocol), otherwise --dead-man \
milliseconds after the last press or repeat. When the console is left, or its terminal is closed, the machine slows down and stops.";

/// Arguments of `haptimill console`.
#[derive(Debug, Clone, Args)]
#[command(about = "The operator's full-screen console: jog, run, hold, stop, forces, recording", long_about = LONG,
          after_help = "`haptimill console --help` says more; docs/console.md has the table of keys.")]
pub struct ConsoleArgs {
    /// A part program to have at hand; it is checked first, and run by the key p
    #[arg(value_name = "FILE")]
    pub program: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    /// Controller: sim (the built-in machine, in real time), a serial port or pseudo-terminal by its path, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", default_value = "sim")]
    pub port: PortSpec,
    /// Baud rate of a serial port (default 115200)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Give up when the controller has not answered for so long, at the beginning
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = super::seconds)]
    pub timeout: f64,
    /// Dead-man: a jog ends so long after the last press or repeat of its key
    #[arg(long, value_name = "MS", default_value_t = 200, value_parser = clap::value_parser!(u16).range(50..=1000))]
    pub dead_man: u16,
    /// Folder for recordings (console-TIME.csv)
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// What is clamped on the simulated machine's table after homing: a file like examples/block.toml; with the simulator only
    #[arg(long, value_name = "FILE")]
    pub work: Option<PathBuf>,
    /// A person at the haptic arm of the machine file, who does what this script says once the arm's motors are on (as examples/teleop.toml; orders in it are not heard); with the simulator only
    #[arg(long, value_name = "FILE")]
    pub person: Option<PathBuf>,
    /// Seed of the simulated machine, instead of the one in the machine file; with the simulator only
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Something that goes wrong in the simulated machine, as "slide-jammed axis=l3 at=30s"; `haptimill run --help` lists all faults
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<Fault>,
}

/// Runs the console.
///
/// # Errors
/// See [`Exit`](super::Exit).
#[cfg(feature = "console")]
pub fn run(args: ConsoleArgs) -> Result<(), CliError> {
    crate::console::run(args)
}

/// Says that there is no console in this build.
///
/// # Errors
/// Always.
#[cfg(not(feature = "console"))]
pub fn run(_: ConsoleArgs) -> Result<(), CliError> {
    Err(CliError::new(
        super::Exit::Usage,
        "this haptimill was built without its console; build it with: cargo build --release",
    ))
}
