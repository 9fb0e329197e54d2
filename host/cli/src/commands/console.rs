//! `haptimill console`: the operator's full-screen console.

use super::CliError;
use super::args::{BoardArg, OperatorArg, PortArgs, SimulatorArgs, StockArg, seconds};
use clap::Args;
use std::path::PathBuf;

const LONG: &str = "\
Operate the machine on a full screen: state and next step, pose, joints, forces, jog with keys, \
hold, resume, stop, feed override, part programs, recording. The key ? lists all keys.

Four keys work in every dialog: Space holds, Ctrl-R resumes, Ctrl-X stops, Ctrl-E is the emergency \
stop (drives off). Each key sends a command over the port. None replaces the emergency-stop button \
of the machine.

A jog ends with the release of its key where the terminal reports it (kitty keyboard protocol). \
On other terminals it ends --jog-timeout milliseconds after the last press or repeat. When the console is left, or its terminal is closed, the machine decelerates and stops.

--stock, --operator, --seed and --fault are for the built-in simulator, which runs in real time.";

/// Arguments of `haptimill console`.
#[derive(Debug, Clone, Args)]
#[command(about = "Operate the machine on a full screen: jog, run, hold, stop, forces, recording",
          long_about = LONG,
          after_help = "`haptimill console --help` has details; docs/console.md lists the keys.")]
pub struct ConsoleArgs {
    /// Part program to load; it is checked first, and started with the key p
    #[arg(value_name = "FILE")]
    pub program: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub port: PortArgs,
    /// Time to wait for the first answer of the controller
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = seconds)]
    pub timeout: f64,
    /// Jog timeout: a jog ends this long after the last press or repeat of its key
    #[arg(long, value_name = "MS", default_value_t = 200, value_parser = clap::value_parser!(u16).range(50..=1000))]
    pub jog_timeout: u16,
    /// Folder for recordings (console-TIME.csv)
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stock: StockArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub operator: OperatorArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simulator: SimulatorArgs,
}

/// Runs the console.
///
/// # Errors
/// See [`Exit`](super::Exit).
#[cfg(feature = "console")]
pub fn run(args: ConsoleArgs) -> Result<(), CliError> {
    crate::console::run(args)
}

/// Reports that this build has no console.
///
/// # Errors
/// Always.
#[cfg(not(feature = "console"))]
pub fn run(_: ConsoleArgs) -> Result<(), CliError> {
    Err(CliError::new(
        super::Exit::Usage,
        "this haptimill was built without the feature `console`; \
         build it with: cargo build --release",
    ))
}
