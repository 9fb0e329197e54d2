//! `haptimill trace`: reads recordings.

mod export;
mod info;

use super::{CliError, Exit, output};
use clap::{Args, Subcommand};
use haptimill_trace::{
    Column, Recording, RecordingError, Selection, Thinning, columns, difference,
};
use std::path::{Path, PathBuf};

/// Arguments of `haptimill trace`.
#[derive(Debug, Clone, Args)]
pub struct TraceArgs {
    #[command(subcommand)]
    #[allow(missing_docs)]
    pub command: TraceCommand,
}

/// A command on recordings.
#[derive(Debug, Clone, Subcommand)]
pub enum TraceCommand {
    #[allow(missing_docs)]
    Info(info::InfoArgs),
    #[allow(missing_docs)]
    Csv(export::CsvArgs),
    #[allow(missing_docs)]
    Plot(export::PlotArgs),
    #[allow(missing_docs)]
    Mcap(export::McapArgs),
    /// Find the first difference of two recordings: control period, field, both values (exit code
    /// 8)
    Diff {
        /// First recording
        #[arg(value_name = "FIRST")]
        first: PathBuf,
        /// Second recording
        #[arg(value_name = "SECOND")]
        second: PathBuf,
    },
}

impl TraceCommand {
    /// Whether standard output is JSON.
    pub(super) fn is_json(&self) -> bool {
        matches!(self, Self::Info(args) if args.json)
    }
}

/// The part of a recording.
#[derive(Debug, Clone, Args)]
pub struct WindowArgs {
    /// Start time, seconds since the first record
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = time_since_start)]
    pub from: f64,
    /// End time, seconds since the first record [default: the end]
    #[arg(long, value_name = "SECONDS", value_parser = time_since_start)]
    pub to: Option<f64>,
    /// Use every Nth control period
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
}

impl WindowArgs {
    fn thinning(&self) -> Result<Thinning, CliError> {
        let to_s = self.to.unwrap_or(f64::INFINITY);
        if to_s <= self.from {
            let what = format!("--to {to_s} must be greater than --from {}", self.from);
            return Err(CliError::new(Exit::Usage, what));
        }
        Ok(Thinning {
            every: self.every,
            from_s: self.from,
            to_s,
        })
    }
}

/// Parses a time in seconds, 0 or more.
fn time_since_start(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
        _ => Err("write seconds, 0 or more".to_string()),
    }
}

fn bad(error: impl std::fmt::Display) -> CliError {
    CliError::new(Exit::BadInput, error)
}

/// Opens a recording.
///
/// # Errors
/// [`Exit::BadInput`].
pub(super) fn open(path: &Path) -> Result<Recording, CliError> {
    Recording::open(path).map_err(|error| match error {
        RecordingError::Io(path, error) => bad(format!(
            "{}: cannot be read: {error}; check the path",
            path.display()
        )),
        error => bad(error),
    })
}

/// The selected columns; without a selection all of them.
fn select_columns(recording: &Recording, names: Option<&str>) -> Result<Vec<Column>, CliError> {
    let all = columns(recording);
    match names {
        None => Ok(all),
        Some(names) => Selection::new(names)
            .of(&all)
            .map_err(|what| CliError::new(Exit::Usage, what)),
    }
}

/// Converts the error of an output file or of the recording.
fn convert_error(recording: &Recording, error: RecordingError) -> CliError {
    match &error {
        RecordingError::Io(path, _) if path != recording.path() => {
            CliError::new(Exit::Output, error)
        }
        RecordingError::NoMcap => CliError::new(Exit::Usage, error),
        _ => bad(error),
    }
}

/// Reports a truncated recording on standard error.
fn report_truncation(recording: &Recording) {
    if let Some(message) = super::replay::describe_truncation(recording) {
        eprintln!("{message}");
    }
}

/// Runs a command on recordings.
///
/// # Errors
/// See [`Exit`]; [`Exit::Command`] when two recordings differ.
pub fn run(args: &TraceArgs) -> Result<(), CliError> {
    match &args.command {
        TraceCommand::Info(args) => info::run(args),
        TraceCommand::Csv(args) => export::csv(args),
        TraceCommand::Plot(args) => export::plot(args),
        TraceCommand::Mcap(args) => export::mcap(args),
        TraceCommand::Diff { first, second } => diff(first, second),
    }
}

fn diff(first: &Path, second: &Path) -> Result<(), CliError> {
    let (first, second) = (open(first)?, open(second)?);
    match difference(&first, &second).map_err(bad)? {
        Some(difference) => Err(CliError::new(Exit::Command, difference)),
        None => {
            print_line!("equal in all {} records", first.records());
            Ok(())
        }
    }
}
