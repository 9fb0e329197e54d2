//! The arguments that choose the machine file of a command on a port.

use super::{CliError, MachineArg};
use clap::Args;
use haptimill_client::board::Chosen;

/// Which machine, on a port.
#[derive(Debug, Clone, Args)]
pub struct BoardArg {
    /// Machine file; without it the configuration that the board has, and with the built-in simulator the built-in H-4 arm (machines/h4.toml)
    #[arg(long, value_name = "FILE")]
    pub machine: Option<std::path::PathBuf>,
    /// Replace the configuration of a board that is configured as another machine, by the one of --machine; only with the drives off
    #[arg(long, requires = "machine")]
    pub replace_machine: bool,
}

impl BoardArg {
    /// Reads the machine file that was named, or the built-in one.
    ///
    /// # Errors
    /// Every problem of the file.
    pub fn load(&self) -> Result<Chosen, CliError> {
        let machine = MachineArg {
            machine: self.machine.clone(),
        };
        Ok(Chosen {
            file: machine.load()?,
            named: self.machine.is_some(),
            replace: self.replace_machine,
            base: None,
            is_second: false,
        })
    }
}
