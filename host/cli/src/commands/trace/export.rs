//! `haptimill trace csv`, `plot` and `mcap`: recordings for other programs, and for the eye.

use super::{CliError, WindowArgs, bad, chosen, failed, open, out, tell_cut};
use clap::Args;
use haptimill_report::plot::Plot;
use haptimill_trace::{MCAP_RATE, McapWritten, RecordingError, write_mcap, write_table};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Arguments of `haptimill trace csv`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Write a recording as CSV: mm, degrees, newtons; units stand in the names of the columns"
)]
pub struct CsvArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "TRACE")]
    pub trace: PathBuf,
    /// Columns, as time_s,x_*_mm,l?_drive_n; a star stands for any letters [default: all]
    #[arg(long, value_name = "NAMES")]
    pub columns: Option<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub window: WindowArgs,
    /// File to write, instead of standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Arguments of `haptimill trace plot`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Draw columns of a recording over time: on the terminal, or as a picture (SVG) with --out"
)]
pub struct PlotArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "TRACE")]
    pub trace: PathBuf,
    /// Columns, as l?_joint_error_mm; a star stands for any letters
    #[arg(value_name = "NAMES", required = true)]
    pub columns: Vec<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub window: WindowArgs,
    /// Picture to write (SVG, a chart for each unit)
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Arguments of `haptimill trace mcap`.
#[derive(Debug, Clone, Args)]
#[command(about = "Write a recording as MCAP, for Foxglove and PlotJuggler")]
pub struct McapArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "TRACE")]
    pub trace: PathBuf,
    /// Samples a second, as near as whole control periods come to it
    #[arg(long, value_name = "HZ", default_value_t = MCAP_RATE, value_parser = rate)]
    pub rate: f64,
    /// File to write [default: the recording's name with .mcap]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Reads a rate.
fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("write samples a second, above 0".to_string()),
    }
}

/// Writes a table.
pub(super) fn csv(args: &CsvArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    let columns = chosen(&recording, args.columns.as_deref())?;
    let thinning = args.window.thinning()?;
    if let Some(out) = &args.out {
        out::not_over(&args.trace, out, RECORDING)?;
    }
    tell_cut(&recording);
    let write = |out: &mut dyn Write| match write_table(&recording, &columns, &thinning, out)? {
        0 => Err(nothing(&args.trace)),
        _ => Ok(()),
    };
    let done = match &args.out {
        Some(path) => out::file(path, RecordingError::Write, |out| write(out)),
        None => write(&mut BufWriter::new(io::stdout().lock())),
    };
    match (done, &args.out) {
        (Err(RecordingError::Write(error)), Some(path)) => Err(out::unwritten(path, error)),
        (Err(RecordingError::Write(error)), None) => {
            out::lost(error);
            Ok(())
        }
        (done, _) => done.map_err(|error| failed(&recording, error)),
    }
}

/// What would be overwritten.
const RECORDING: &str = "recording";

/// Nothing is in the columns or the time that were asked for.
fn nothing(trace: &Path) -> RecordingError {
    let what = "nothing was recorded in these columns at that time";
    RecordingError::Format(trace.to_path_buf(), what.to_string())
}

/// Characters of a sketch on the terminal.
const SKETCH: (usize, usize) = (78, 8);

/// Draws.
pub(super) fn plot(args: &PlotArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    let columns = chosen(&recording, Some(&args.columns.join(",")))?;
    let thinning = args.window.thinning()?;
    if let Some(out) = &args.out {
        out::not_over(&args.trace, out, RECORDING)?;
    }
    tell_cut(&recording);
    let plot =
        Plot::of(&recording, &columns, &thinning).map_err(|error| failed(&recording, error))?;
    if plot.is_empty() {
        return Err(bad(nothing(&args.trace)));
    }
    match &args.out {
        Some(path) => {
            let failed = |error| out::unwritten(path, error);
            out::file(path, failed, |out| {
                out.write_all(plot.svg().as_bytes()).map_err(failed)
            })
        }
        None => {
            tell!("{}", plot.sketch(SKETCH.0, SKETCH.1).trim_end());
            Ok(())
        }
    }
}

/// Writes MCAP.
pub(super) fn mcap(args: &McapArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    tell_cut(&recording);
    let out = args.out.clone();
    let out = out.unwrap_or_else(|| args.trace.with_extension("mcap"));
    out::not_over(&args.trace, &out, RECORDING)?;
    let mut written = McapWritten::default();
    let done = out::file(&out, RecordingError::Write, |file| {
        written = write_mcap(&recording, file, args.rate)?;
        Ok(())
    });
    done.map_err(|error| match error {
        RecordingError::Write(error) => out::unwritten(&out, error),
        error => failed(&recording, error),
    })?;
    tell!(
        "{}: {} channels, {} messages, {:.1} MB",
        out.display(),
        written.channels,
        written.messages,
        written.bytes as f64 / 1e6
    );
    Ok(())
}
