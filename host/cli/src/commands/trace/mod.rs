//! `haptimill trace`: looking at recordings.

mod export;
mod info;

use super::{CliError, Exit, out};
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
    pub what: TraceCommand,
}

/// What to do with recordings.
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

impl TraceCommand {
    /// Whether a program reads the standard output.
    pub(super) fn json(&self) -> bool {
        matches!(self, Self::Info(args) if args.json)
    }
}

/// Which part of a recording.
#[derive(Debug, Clone, Args)]
pub struct WindowArgs {
    /// From here on, seconds since the first record
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = since)]
    pub from: f64,
    /// Up to here [default: the end]
    #[arg(long, value_name = "SECONDS", value_parser = since)]
    pub to: Option<f64>,
    /// One of so many control periods
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
}

impl WindowArgs {
    fn thinning(&self) -> Result<Thinning, CliError> {
        let to_s = self.to.unwrap_or(f64::INFINITY);
        if to_s <= self.from {
            let what = format!("--to {to_s} is not behind --from {}", self.from);
            return Err(CliError::new(Exit::Usage, what));
        }
        Ok(Thinning {
            every: self.every,
            from_s: self.from,
            to_s,
        })
    }
}

/// Reads a time in seconds, 0 or more.
fn since(text: &str) -> Result<f64, String> {
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

/// The columns that were asked for; without a wish all of them.
fn chosen(recording: &Recording, wish: Option<&str>) -> Result<Vec<Column>, CliError> {
    let all = columns(recording);
    match wish {
        None => Ok(all),
        Some(wish) => Selection::new(wish)
            .of(&all)
            .map_err(|what| CliError::new(Exit::Usage, what)),
    }
}

/// An error of a file that was to be written, or of the recording.
fn failed(recording: &Recording, error: RecordingError) -> CliError {
    match &error {
        RecordingError::Io(path, _) if path != recording.path() => {
            CliError::new(Exit::Output, error)
        }
        RecordingError::NoMcap => CliError::new(Exit::Usage, error),
        _ => bad(error),
    }
}

/// Says on standard error that a recording was cut off.
fn tell_cut(recording: &Recording) {
    if let Some(cut) = super::replay::cut(recording) {
        eprintln!("{cut}");
    }
}

/// Looks at recordings.
///
/// # Errors
/// See [`Exit`]; [`Exit::Command`] when they differ.
pub fn run(args: &TraceArgs) -> Result<(), CliError> {
    match &args.what {
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
            tell!("the same in all {} records", first.records());
            Ok(())
        }
    }
}
