//! `haptimill machine`: machine files.

mod check;
mod init;
mod keys;
mod migrate;

use super::CliError;
use clap::Subcommand;

pub use check::CheckArgs;
pub use init::InitArgs;
pub use keys::KeysArgs;
pub use migrate::MigrateArgs;

/// A command on machine files.
#[derive(Debug, Subcommand)]
pub enum MachineCommand {
    #[allow(missing_docs)]
    Check(CheckArgs),
    #[allow(missing_docs)]
    Init(InitArgs),
    #[allow(missing_docs)]
    Keys(KeysArgs),
    #[allow(missing_docs)]
    Migrate(MigrateArgs),
}

impl MachineCommand {
    /// Whether standard output is JSON.
    pub(super) fn is_json(&self) -> bool {
        matches!(self, Self::Check(args) if args.json)
    }
}

/// Runs a command on machine files.
///
/// # Errors
/// See [`Exit`](super::Exit).
pub fn run(command: MachineCommand) -> Result<(), CliError> {
    match command {
        MachineCommand::Check(args) => check::run(args),
        MachineCommand::Init(args) => init::run(args),
        MachineCommand::Keys(args) => keys::run(&args),
        MachineCommand::Migrate(args) => migrate::run(args),
    }
}
