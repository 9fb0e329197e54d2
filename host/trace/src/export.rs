//! The trace: a recording as CSV, in mm, degrees and newtons.

use super::column::Value;
use super::{Column, Record, Recording, RecordingError, columns};
use std::fmt::Write as _;
use std::io::Write;

/// Which records are taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thinning {
    /// One every so many control periods; where a recording has fewer records than that (telemetry), each.
    pub every: u32,
    /// From here on, seconds since the first record.
    pub from_s: f64,
    /// Up to here.
    pub to_s: f64,
}

impl Default for Thinning {
    /// All of them.
    fn default() -> Self {
        Self {
            every: 1,
            from_s: 0.0,
            to_s: f64::INFINITY,
        }
    }
}

impl Thinning {
    /// Calls `take` with each record that is taken and its time in seconds since the first one; the last record of all is always taken.
    ///
    /// # Errors
    /// The recording cannot be read, or `take` fails.
    pub fn apply(
        &self,
        recording: &Recording,
        mut take: impl FnMut(&Record, f64) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        let every = u64::from(self.every.max(1));
        let last = recording.records().saturating_sub(1);
        let mut first_period = None;
        let mut next = 0;
        for (index, record) in (0_u64..).zip(recording.iter()?) {
            let record = record?;
            let begin = *first_period.get_or_insert(record.period);
            let time_s = record.period.saturating_sub(begin) as f64 * recording.period_s();
            if time_s > self.to_s {
                break;
            }
            if record.period < next && index != last || time_s < self.from_s {
                continue;
            }
            // Rows stay on the grid that the first one began, as far as there are records.
            next = begin + (record.period.saturating_sub(begin) / every + 1) * every;
            take(&record, time_s)?;
        }
        Ok(())
    }
}

/// Writes all columns, a row every `every` control periods and one for the last record. Units stand in the names of the columns; a cell is
/// empty where the recording has no value.
///
/// # Errors
/// The recording cannot be read, or the trace not written.
pub fn export_csv(
    recording: &Recording,
    out: &mut dyn Write,
    every: u32,
) -> Result<(), RecordingError> {
    let thinning = Thinning {
        every,
        ..Thinning::default()
    };
    let columns = columns(recording);
    if export_table(recording, &columns, &thinning, out)? == 0 {
        let header = names(&columns);
        out.write_all(header.as_bytes())
            .and_then(|()| out.flush())
            .map_err(RecordingError::Write)?;
    }
    Ok(())
}

/// The first row.
fn names(columns: &[Column]) -> String {
    let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
    names.join(",") + "\n"
}

/// Writes chosen columns of chosen records, and says how many rows that were below their names; with none the names are not written either.
///
/// # Errors
/// The recording cannot be read, or the table not written.
pub fn export_table(
    recording: &Recording,
    columns: &[Column],
    thinning: &Thinning,
    out: &mut dyn Write,
) -> Result<u64, RecordingError> {
    let mut rows = 0;
    let mut row = names(columns);
    thinning.apply(recording, |record, time_s| {
        if rows == 0 {
            out.write_all(row.as_bytes())
                .map_err(RecordingError::Write)?;
        }
        rows += 1;
        row.clear();
        for (index, column) in columns.iter().enumerate() {
            if index > 0 {
                row.push(',');
            }
            // Writing to a string cannot fail.
            let _ = match column.value(record, time_s) {
                Some(Value::Real(value, decimals)) => write!(row, "{value:.decimals$}"),
                Some(Value::Whole(value)) => write!(row, "{value}"),
                Some(Value::Flag(set)) => write!(row, "{}", u8::from(set)),
                Some(Value::State(state)) => write!(row, "{state:?}"),
                None => Ok(()),
            };
        }
        row.push('\n');
        out.write_all(row.as_bytes()).map_err(RecordingError::Write)
    })?;
    out.flush().map_err(RecordingError::Write)?;
    Ok(rows)
}
