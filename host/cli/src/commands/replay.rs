//! `haptimill replay`: replays a recorded job through a new controller and compares bit by bit.

use super::trace::open;
use super::{CliError, Exit};
use clap::Args;
use haptimill_trace::Recording;
use haptimill_trace::replay::{self, ReplayError};
use std::path::PathBuf;
use std::time::Instant;

const LONG: &str = "\
Replay a recorded job. A new controller gets the recorded inputs since power-on. Its outputs are \
compared bit by bit: the command to every drive, the spindle, every byte to the host, and its state \
during the job.

Exit code 0: equal. Exit code 8: different; the message names the first control period, the field \
and both values. A truncated recording (the host process was killed) is replayed to its end. Jobs \
in the simulator and on an emulated board can be replayed. Jobs behind a port cannot, because only \
telemetry is recorded.";

/// Arguments of `haptimill replay`.
#[derive(Debug, Clone, Args)]
#[command(about = "Replay a recorded job through a new controller and compare bit by bit", long_about = LONG)]
pub struct ReplayArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "RECORDING")]
    pub trace: PathBuf,
    /// Print the result as JSON on standard output, and nothing else there
    #[arg(long)]
    pub json: bool,
}

/// Replays a recording.
///
/// # Errors
/// See [`Exit`]; [`Exit::Command`] when the replay differs.
pub fn run(args: &ReplayArgs) -> Result<(), CliError> {
    let bad = |error: &dyn std::fmt::Display| CliError::new(Exit::BadInput, error);
    let recording = open(&args.trace)?;
    let start = Instant::now();
    let result = replay::replay(&recording).map_err(|error| match error {
        ReplayError::Recording(error) => bad(&error),
        error => bad(&error),
    })?;
    let took_s = start.elapsed().as_secs_f64();
    let hash = recording.sha256().map_err(|error| bad(&error))?;
    let header = recording.header();
    let truncated = describe_truncation(&recording);
    if args.json {
        let mut value = serde_json::json!({
            "recording": args.trace.display().to_string(),
            "sha256": hash,
            "recorded_by": header.software,
            "equal": result.is_ok(),
            "whole": recording.is_whole(),
        });
        match &result {
            Ok(equal) => {
                value["periods"] = equal.periods.into();
                value["records"] = equal.records.into();
            }
            Err(difference) => value["difference"] = serde_json::json!(difference),
        }
        print_line!("{value:#}");
    }
    match result {
        Ok(equal) => {
            if !args.json {
                let seconds = equal.periods as f64 * recording.period_s();
                print_line!(
                    "bit-identical in {} control periods ({seconds:.1} s, {:.0} times real time), {} \
                     of them with a record",
                    equal.periods,
                    seconds / took_s.max(1e-9),
                    equal.records
                );
                print_line!("sha256 {hash}");
            }
            if let Some(truncated) = truncated {
                eprintln!("{truncated}");
            }
            Ok(())
        }
        Err(difference) => {
            let mut text = difference.to_string();
            if header.software != env!("CARGO_PKG_VERSION") {
                text += &format!(
                    " (recorded by haptimill {}, replayed by {})",
                    header.software,
                    env!("CARGO_PKG_VERSION")
                );
            }
            let error = CliError::new(Exit::Command, text);
            Err(if args.json { error.reported() } else { error })
        }
    }
}

/// The message for a truncated recording.
pub(super) fn describe_truncation(recording: &Recording) -> Option<String> {
    if recording.is_whole() {
        return None;
    }
    let file = recording.path().display();
    Some(match recording.cut_bytes() {
        0 => format!("{file}: the recording is truncated; all complete blocks were read"),
        bytes => format!(
            "{file}: the recording is truncated; the last {bytes} bytes, from byte {}, are an \
             incomplete block and were ignored",
            recording.bytes() - bytes
        ),
    })
}
