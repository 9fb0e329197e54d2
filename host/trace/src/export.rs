//! Export of a recording as CSV (the trace), in mm, degrees and newtons.

use super::column::Value;
use super::{Column, Record, Recording, RecordingError, columns};
use std::fmt::Write as _;
use std::io::Write;

/// Selection of records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thinning {
    /// Number of control periods between two selected records; a recording with fewer records
    /// (telemetry) keeps them all.
    pub every: u32,
    /// Start, seconds since the first record.
    pub from_s: f64,
    /// End, seconds since the first record.
    pub to_s: f64,
}

impl Default for Thinning {
    /// Selects all records.
    fn default() -> Self {
        Self {
            every: 1,
            from_s: 0.0,
            to_s: f64::INFINITY,
        }
    }
}

impl Thinning {
    /// Calls `take` with each selected record and its time in seconds since the first record. The
    /// last record of a recording is always selected.
    ///
    /// # Errors
    ///
    /// Returns an error if the recording cannot be read or `take` fails.
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
            // Rows stay on the grid of the first record.
            next = begin + (record.period.saturating_sub(begin) / every + 1) * every;
            take(&record, time_s)?;
        }
        Ok(())
    }
}

/// Writes all columns, a row every `every` control periods and one for the last record. The unit is
/// part of a column's name; a cell is empty where the recording has no value.
///
/// # Errors
///
/// Returns an error if the recording cannot be read or the trace cannot be written.
pub fn write_csv(
    recording: &Recording,
    out: &mut dyn Write,
    every: u32,
) -> Result<(), RecordingError> {
    let thinning = Thinning {
        every,
        ..Thinning::default()
    };
    let columns = columns(recording);
    if write_table(recording, &columns, &thinning, out)? == 0 {
        let header = name_row(&columns);
        out.write_all(header.as_bytes())
            .and_then(|()| out.flush())
            .map_err(RecordingError::Write)?;
    }
    Ok(())
}

/// Returns the first row.
fn name_row(columns: &[Column]) -> String {
    let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
    names.join(",") + "\n"
}

/// Writes selected columns of selected records and returns the number of rows. The row of names is
/// written only before a first row.
///
/// # Errors
///
/// Returns an error if the recording cannot be read or the table cannot be written.
pub fn write_table(
    recording: &Recording,
    columns: &[Column],
    thinning: &Thinning,
    out: &mut dyn Write,
) -> Result<u64, RecordingError> {
    let mut rows = 0;
    let mut row = name_row(columns);
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
