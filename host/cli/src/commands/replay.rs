//! `haptimill replay`: a recorded job once more, through a new controller, compared bit by bit.

use super::trace::open;
use super::{CliError, Exit};
use clap::Args;
use haptimill_trace::Recording;
use haptimill_trace::replay::{self, ReplayError};
use std::path::PathBuf;
use std::time::Instant;

const LONG: &str = "\
Replay a recorded job: a new controller is given what the recorded one sensed since its power-on, and must say the same, bit by bit: the command to \
every drive, the spindle, every byte to the host, and what it knew of itself in the job.

Equal ends with 0. A difference ends with 8 and names its first control period, the field and both values. A recording that was cut off (the host was killed) \
is replayed as far as it goes. Jobs in the simulator and on an emulated board can be replayed; of a controller behind a port only its telemetry is known.";

/// Arguments of `haptimill replay`.
#[derive(Debug, Clone, Args)]
#[command(about = "A recorded job once more through a new controller: the same bits, or the first difference", long_about = LONG)]
pub struct ReplayArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "TRACE")]
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
    let begun = Instant::now();
    let result = replay::replay(&recording).map_err(|error| match error {
        ReplayError::Recording(error) => bad(&error),
        error => bad(&error),
    })?;
    let took_s = begun.elapsed().as_secs_f64();
    let hash = recording.sha256().map_err(|error| bad(&error))?;
    let header = recording.header();
    let cut = cut(&recording);
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
        tell!("{value:#}");
    }
    match result {
        Ok(equal) => {
            if !args.json {
                let seconds = equal.periods as f64 * recording.period_s();
                tell!(
                    "the same bits in {} control periods ({seconds:.1} s, {:.0} times real time), {} of them with a record",
                    equal.periods,
                    seconds / took_s.max(1e-9),
                    equal.records
                );
                tell!("sha256 {hash}");
            }
            if let Some(cut) = cut {
                eprintln!("{cut}");
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
            Err(if args.json { error.told() } else { error })
        }
    }
}

/// What to say of a recording that was cut off.
pub(super) fn cut(recording: &Recording) -> Option<String> {
    if recording.is_whole() {
        return None;
    }
    let file = recording.path().display();
    Some(match recording.cut_bytes() {
        0 => format!("{file}: was cut off, its end is missing; all that is in it was read"),
        bytes => format!(
            "{file}: was cut off; the last {bytes} bytes, from byte {}, are no whole block and were left out",
            recording.bytes() - bytes
        ),
    })
}
