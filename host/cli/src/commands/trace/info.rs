//! `haptimill trace info`: prints the properties of a recording.

use super::{CliError, bad, open};
use clap::Args;
use haptimill_report::duration;
use haptimill_trace::columns;
use haptimill_trace::replay::why_not_replayable;
use serde_json::json;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

/// Arguments of `haptimill trace info`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Print the properties of a recording: machine, duration, columns, events, replay"
)]
pub struct InfoArgs {
    /// The recording (recording.hmr)
    #[arg(value_name = "RECORDING")]
    pub trace: PathBuf,
    /// Print only JSON on standard output
    #[arg(long)]
    pub json: bool,
}

/// Prints the properties of a recording.
pub(super) fn run(args: &InfoArgs) -> Result<(), CliError> {
    let recording = open(&args.trace)?;
    recording.verify().map_err(bad)?;
    let header = recording.header();
    let hash = recording.sha256().map_err(bad)?;
    let first = recording
        .iter()
        .map_err(bad)?
        .next()
        .transpose()
        .map_err(bad)?;
    let last = recording.last().map_err(bad)?;
    let ends = first
        .zip(last)
        .map(|(first, last)| (first.period, last.period));
    let period_s = recording.period_s();
    let duration_s = ends.map_or(0.0, |(first, last)| (last + 1 - first) as f64 * period_s);
    let events = recording.events().map_err(bad)?;
    let why_not = why_not_replayable(&recording);
    let written = std::fs::metadata(&args.trace).and_then(|file| file.modified());
    let written = written.map_or(String::new(), date);
    let columns = columns(&recording);
    let per_period = match recording.periods() {
        0 => 0.0,
        periods => recording.period_bytes() as f64 / periods as f64,
    };
    if args.json {
        let value = json!({
            "file": args.trace.display().to_string(),
            "bytes": recording.bytes(),
            "whole": recording.is_whole(),
            "cut_bytes": recording.cut_bytes(),
            "written": written,
            "recorded_by": header.software,
            "machine": header.machine,
            "configuration_crc": format!("{:08x}", header.config_crc),
            "control_period_us": recording.config().period_us,
            "program": header.program,
            "records": recording.records(),
            "first_period": ends.map(|(first, _)| first),
            "last_period": ends.map(|(_, last)| last),
            "duration_s": duration_s,
            "periods": recording.periods(),
            "bytes_per_period": per_period,
            "replayable": why_not.is_none(),
            "sha256": hash,
            "columns": columns.iter().map(|column| column.name.as_str()).collect::<Vec<_>>(),
            "events": events.iter().map(|event| json!({
                "period": event.period,
                "level": LEVELS[usize::from(event.level.min(2))],
                "text": event.text,
            })).collect::<Vec<_>>(),
        });
        print_line!("{value:#}");
        return Ok(());
    }
    print_line!(
        "file        {}, {:.1} MB{}",
        args.trace.display(),
        recording.bytes() as f64 / 1e6,
        if recording.is_whole() {
            ""
        } else {
            ", truncated: its end is missing"
        }
    );
    print_line!("recorded    {written}, by haptimill {}", header.software);
    print_line!(
        "machine     {}, control period {} us, configuration {:08x}",
        header.machine,
        recording.config().period_us,
        header.config_crc
    );
    print_line!("program     {}", header.program);
    match ends {
        Some((first, last)) => print_line!(
            "job         {}: {} records, control periods {first} to {last}",
            duration(duration_s),
            recording.records()
        ),
        None => print_line!("job         nothing recorded"),
    }
    match &why_not {
        None => print_line!(
            "replay      possible: all {} control periods since power-on, {per_period:.1} bytes each",
            recording.periods()
        ),
        Some(why) => print_line!("replay      {why}"),
    }
    print_line!("sha256      {hash}");
    let mut names = String::new();
    for group in columns.chunk_by(|one, next| one.group == next.group) {
        let group: Vec<&str> = group.iter().map(|column| column.name.as_str()).collect();
        names += &format!("\n            {}", group.join(" "));
    }
    print_line!("columns     {}", names.trim_start());
    for event in &events {
        print_line!(
            "{:<11} {:9.4} s  {}",
            LEVELS[usize::from(event.level.min(2))],
            event.period as f64 * period_s,
            event.text
        );
    }
    Ok(())
}

/// Names of the event levels.
const LEVELS: [&str; 3] = ["event", "warning", "error"];

/// Formats a time as a date, UTC.
fn date(time: SystemTime) -> String {
    let seconds = time
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_secs());
    let (days, minutes) = (seconds / 86_400, seconds % 86_400 / 60);
    // Days since 1 March of the year 0, in cycles of 400 years: the leap day is then the last day.
    let days = days + 719_468;
    let (cycle, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = cycle * 400 + year + u64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02} {:02}:{:02} UTC",
        minutes / 60,
        minutes % 60
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn dates_match_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01 00:00 UTC"),
            (951_782_400, "2000-02-29 00:00 UTC"),
            (951_868_799, "2000-02-29 23:59 UTC"),
            (951_868_800, "2000-03-01 00:00 UTC"),
            (1_735_689_599, "2024-12-31 23:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00 UTC"),
        ] {
            assert_eq!(date(UNIX_EPOCH + Duration::from_secs(seconds)), text);
        }
    }
}
