//! `haptimill trace csv`, `plot` and `mcap`: exports recordings.

use super::{
    CliError, WindowArgs, bad, convert_error, open, output, report_truncation, select_columns,
};
use clap::Args;
use haptimill_report::plot::Plot;
use haptimill_trace::{MCAP_RATE, McapWritten, RecordingError, write_mcap, write_table};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Arguments of `haptimill trace csv`.
#[derive(Debug, Clone, Args)]
#[command(about = "Write a recording as CSV; the column names have the units")]
pub struct CsvArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "RECORDING")]
    pub trace: PathBuf,
    /// Columns, as time_s,x_*_mm,l?_drive_n; * is any text, ? one character [default: all]
    #[arg(long, value_name = "NAMES")]
    pub columns: Option<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub window: WindowArgs,
    /// File to write [default: standard output]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Arguments of `haptimill trace plot`.
#[derive(Debug, Clone, Args)]
#[command(about = "Plot columns of a recording over time: on the terminal, or as SVG with --out")]
pub struct PlotArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "RECORDING")]
    pub trace: PathBuf,
    /// Columns, as l?_joint_error_mm; * is any text, ? one character
    #[arg(value_name = "NAMES", required = true)]
    pub columns: Vec<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub window: WindowArgs,
    /// SVG file to write, with one chart for each unit
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Arguments of `haptimill trace mcap`.
#[derive(Debug, Clone, Args)]
#[command(about = "Write a recording as MCAP, for Foxglove and PlotJuggler")]
pub struct McapArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "RECORDING")]
    pub trace: PathBuf,
    /// Samples per second, rounded to whole control periods
    #[arg(long, value_name = "HZ", default_value_t = MCAP_RATE, value_parser = parse_rate)]
    pub rate: f64,
    /// File to write [default: the recording's name with .mcap]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Parses a sample rate.
fn parse_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("write samples per second, above 0".to_string()),
    }
}

/// Writes a CSV table.
pub(super) fn csv(args: &CsvArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    let columns = select_columns(&recording, args.columns.as_deref())?;
    let thinning = args.window.thinning()?;
    if let Some(out) = &args.out {
        output::refuse_overwrite(&args.trace, out, RECORDING)?;
    }
    report_truncation(&recording);
    let write = |out: &mut dyn Write| match write_table(&recording, &columns, &thinning, out)? {
        0 => Err(no_data(&args.trace)),
        _ => Ok(()),
    };
    let done = match &args.out {
        Some(path) => output::write_file(path, RecordingError::Write, |out| write(out)),
        None => write(&mut BufWriter::new(io::stdout().lock())),
    };
    match (done, &args.out) {
        (Err(RecordingError::Write(error)), Some(path)) => Err(output::write_error(path, error)),
        (Err(RecordingError::Write(error)), None) => {
            output::keep_error(error);
            Ok(())
        }
        (done, _) => done.map_err(|error| convert_error(&recording, error)),
    }
}

/// The input that must not be overwritten.
const RECORDING: &str = "recording";

/// The error of a selection without data.
fn no_data(trace: &Path) -> RecordingError {
    let what = "the recording has no data in these columns and times";
    RecordingError::Format(trace.to_path_buf(), what.to_string())
}

/// Columns and rows of a plot on the terminal.
const TERMINAL_PLOT: (usize, usize) = (78, 8);

/// Plots columns.
pub(super) fn plot(args: &PlotArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    let columns = select_columns(&recording, Some(&args.columns.join(",")))?;
    let thinning = args.window.thinning()?;
    if let Some(out) = &args.out {
        output::refuse_overwrite(&args.trace, out, RECORDING)?;
    }
    report_truncation(&recording);
    let plot = Plot::of(&recording, &columns, &thinning)
        .map_err(|error| convert_error(&recording, error))?;
    if plot.is_empty() {
        return Err(bad(no_data(&args.trace)));
    }
    match &args.out {
        Some(path) => {
            let failed = |error| output::write_error(path, error);
            output::write_file(path, failed, |out| {
                out.write_all(plot.svg().as_bytes()).map_err(failed)
            })
        }
        None => {
            print_line!(
                "{}",
                plot.sketch(TERMINAL_PLOT.0, TERMINAL_PLOT.1).trim_end()
            );
            Ok(())
        }
    }
}

/// Writes an MCAP file.
pub(super) fn mcap(args: &McapArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    report_truncation(&recording);
    let out = args.out.clone();
    let out = out.unwrap_or_else(|| args.trace.with_extension("mcap"));
    output::refuse_overwrite(&args.trace, &out, RECORDING)?;
    let mut written = McapWritten::default();
    let done = output::write_file(&out, RecordingError::Write, |file| {
        written = write_mcap(&recording, file, args.rate)?;
        Ok(())
    });
    done.map_err(|error| match error {
        RecordingError::Write(error) => output::write_error(&out, error),
        error => convert_error(&recording, error),
    })?;
    print_line!(
        "{}: {} channels, {} messages, {:.1} MB",
        out.display(),
        written.channels,
        written.messages,
        written.bytes as f64 / 1e6
    );
    Ok(())
}
