//! `haptimill trace`: looking at recordings.

use super::{CliError, Exit};
use crate::record::{Recording, difference};
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};

/// Arguments of `haptimill trace`.
#[derive(Debug, Clone, Args)]
pub struct TraceArgs {
    #[command(subcommand)]
    #[allow(missing_docs)]
    pub what: TraceCommand,
}

/// What to do with recordings.
#[derive(Debug, Clone, Subcommand)]
pub enum TraceCommand {
    /// Say where two recordings differ first: control period, field, both values (exit code 8 when they do)
    Diff {
        /// A recording
        #[arg(value_name = "FIRST")]
        first: PathBuf,
        /// Another one
        #[arg(value_name = "SECOND")]
        second: PathBuf,
    },
}

/// Looks at recordings.
///
/// # Errors
/// See [`Exit`]; [`Exit::Command`] when they differ.
pub fn run(args: &TraceArgs) -> Result<(), CliError> {
    let TraceCommand::Diff { first, second } = &args.what;
    let bad = |error: &dyn std::fmt::Display| CliError::new(Exit::BadInput, error);
    let open = |path: &Path| Recording::open(path).map_err(|error| bad(&error));
    let (first, second) = (open(first)?, open(second)?);
    match difference(&first, &second).map_err(|error| bad(&error))? {
        Some(difference) => Err(CliError::new(Exit::Command, difference)),
        None => {
            tell!("the same in all {} records", first.records());
            Ok(())
        }
    }
}
