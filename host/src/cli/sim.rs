//! `haptimill sim serve`: the simulated machine as a device that any serial program can talk to, in real time.

use super::{CliError, Exit, MachineArg};
use clap::Args;
use std::path::PathBuf;
use std::str::FromStr;

const LONG: &str = "\
Serve the simulated machine in real time.

On a pseudo-terminal the path is the first line on standard output; on a TCP port the address is. Give it to another `haptimill` as --port. One \
host is served at a time. Ctrl-C ends it.";

/// Arguments of `haptimill sim serve`.
#[derive(Debug, Clone, Args)]
#[command(about = "Serve the simulated machine in real time", long_about = LONG)]
pub struct ServeArgs {
    /// Where: pty (a pseudo-terminal, its path is printed) or tcp:HOST:PORT (port 0 takes a free one)
    #[arg(long, value_name = "WHERE", default_value = "pty")]
    pub listen: Listen,
    /// Also make a symbolic link with this path to the pseudo-terminal
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Seed of the simulated machine, instead of the one in the machine file
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// End after so many seconds
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::seconds)]
    pub duration: Option<f64>,
}

/// Where a simulator is served.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    /// A pseudo-terminal.
    Pty,
    /// A TCP port, `HOST:PORT`.
    Tcp(String),
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("tcp:") {
            _ if text == "pty" => Ok(Self::Pty),
            Some(address) if address.contains(':') => Ok(Self::Tcp(address.to_string())),
            _ => Err("write pty or tcp:HOST:PORT".to_string()),
        }
    }
}

/// Serves the simulated machine.
///
/// # Errors
/// See [`Exit`].
pub fn serve(args: ServeArgs) -> Result<(), CliError> {
    let _ = args.machine.load()?;
    Err(CliError::new(
        Exit::Internal,
        "haptimill sim serve: not built yet",
    ))
}
