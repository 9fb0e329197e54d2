//! The trace: a recording as CSV, in mm, degrees and newtons.

use super::{Recording, RecordingError, flag};
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::COMPONENTS;
use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::PathBuf;

/// Axis units of a millimetre.
const MM: f64 = (1 << 20) as f64;

/// Writes a row every `every` control periods, and one for the last record; where a recording has fewer records than that (telemetry), each is a row. Units stand in the names of the columns; a cell is empty where the recording has no value.
///
/// # Errors
/// The recording cannot be read, or the trace not written.
pub fn export_csv(
    recording: &Recording,
    out: &mut dyn Write,
    every: u32,
) -> Result<(), RecordingError> {
    let io = |error: io::Error| RecordingError::Io(PathBuf::from("trace"), error);
    out.write_all(heading(recording).as_bytes()).map_err(io)?;
    let (pose, joints) = (recording.pose_units(), recording.joint_units());
    let drives: Vec<f64> = recording.drive_units().iter().map(|(s, _)| *s).collect();
    let every = u64::from(every.max(1));
    let last = recording.records().saturating_sub(1);
    let mut first_period = None;
    let mut next = 0;
    let mut row = String::new();
    for (index, record) in (0_u64..).zip(recording.iter()?) {
        let record = record?;
        let begin = *first_period.get_or_insert(record.period);
        if record.period < next && index != last {
            continue;
        }
        // Rows stay on the grid that the first one began, as far as there are records.
        next = begin + (record.period.saturating_sub(begin) / every + 1) * every;
        let time = record.period.saturating_sub(begin) as f64 * recording.period_s();
        row.clear();
        // Writing to a string cannot fail.
        let _ = write!(
            row,
            "{time:.6},{},{:?},{},{},{:.5},{},{},{}",
            record.period,
            record.state,
            record.setpoint,
            record.line,
            f64::from(record.path_rate) / 65_535.0,
            record.spindle_rpm,
            u8::from(record.has(flag::HOMED)),
            u8::from(record.has(flag::POSITION_KEPT)),
        );
        cells(&mut row, &record.wanted, &pose, true);
        let programmed = record.has(flag::PROGRAMMED);
        cells(&mut row, &record.programmed, &pose, programmed);
        let tool = record.has(flag::TOOL_TRUE | flag::TOOL_MEASURED);
        cells(&mut row, &record.tool, &pose, tool);
        cells(&mut row, &record.joints_wanted, &joints, true);
        cells(&mut row, &record.joints, &joints, true);
        cells(&mut row, &record.following_error, &joints, true);
        cells(&mut row, &record.drive, &drives, true);
        let felt = record.has(flag::FORCE);
        let force = &record.force;
        let newtons = [1.0 / 65_536.0; COMPONENTS];
        cells(&mut row, &force.high, &newtons, felt);
        cells(&mut row, &force.low, &newtons, felt);
        cells(&mut row, &force.yielded, &[1.0 / MM; COMPONENTS], felt);
        let known = felt && record.has(flag::TOOL_TRUE);
        cells(&mut row, &record.true_force, &newtons, known);
        row.push('\n');
        out.write_all(row.as_bytes()).map_err(io)?;
    }
    out.flush().map_err(io)
}

fn heading(recording: &Recording) -> String {
    let header = recording.header();
    let config = recording.config();
    let mut text =
        String::from("time_s,period,state,setpoint,line,path_rate,spindle_rpm,homed,position_kept");
    let unit = |kind: AxisKind| match kind {
        AxisKind::Linear => "mm",
        AxisKind::Rotary => "deg",
    };
    for what in ["wanted", "programmed", "tool"] {
        for (name, axis) in header.pose.iter().zip(&config.pose) {
            let _ = write!(text, ",{name}_{what}_{}", unit(axis.kind));
        }
    }
    for what in ["joint_wanted", "joint_measured", "joint_error"] {
        for (name, axis) in header.joints.iter().zip(&config.joints) {
            let _ = write!(text, ",{name}_{what}_{}", unit(axis.kind));
        }
    }
    for (name, (_, unit)) in header.joints.iter().zip(recording.drive_units()) {
        let _ = write!(text, ",{name}_drive_{unit}");
    }
    for (what, unit) in [
        ("force_high", "n"),
        ("force_low", "n"),
        ("yielded", "mm"),
        ("force_true", "n"),
    ] {
        for axis in ["x", "y", "z"] {
            let _ = write!(text, ",{axis}_{what}_{unit}");
        }
    }
    text.push('\n');
    text
}

fn cells(row: &mut String, values: &[i32], scales: &[f64], there: bool) {
    for (value, scale) in values.iter().zip(scales) {
        if there {
            let _ = write!(row, ",{:.6}", f64::from(*value) * scale);
        } else {
            row.push(',');
        }
    }
}
