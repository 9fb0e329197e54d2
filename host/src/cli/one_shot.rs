//! `haptimill home`, `status`, `enable`, `disable`, `stop`, `reset`: one command to a running controller.

use super::{CliError, ConnectArgs, Exit, MachineArg};
use clap::Args;

/// Arguments of the one-shot commands.
#[derive(Debug, Clone, Args)]
pub struct OneShotArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `haptimill stop`.
#[derive(Debug, Clone, Args)]
pub struct StopArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Drives off at once instead of slowing down along the path; latched until `haptimill reset`
    #[arg(long)]
    pub emergency: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Which one-shot command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Find the references.
    Home,
    /// How things stand.
    Status,
    /// Drives on.
    Enable,
    /// Drives off.
    Disable,
    /// Clear a latched fault.
    Reset,
}

/// Carries out a one-shot command.
///
/// # Errors
/// See [`Exit`].
pub fn run(order: Order, args: OneShotArgs) -> Result<(), CliError> {
    let _ = args.machine.load()?;
    let name = format!("{order:?}").to_lowercase();
    Err(CliError::new(
        Exit::Internal,
        format!("haptimill {name}: not built yet"),
    ))
}

/// Stops.
///
/// # Errors
/// See [`Exit`].
pub fn stop(_args: StopArgs) -> Result<(), CliError> {
    Err(CliError::new(
        Exit::Internal,
        "haptimill stop: not built yet",
    ))
}
