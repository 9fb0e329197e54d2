//! Report of a job: `summary.json`, `report.html`, and a few lines on the terminal.
//!
//! All of it is made from the recording and can be made again. On a real machine the position of
//! the tool is measured through the controller's kinematics and does not contain geometric errors;
//! [`Summary::tool_is_true`] distinguishes the two.

pub mod chart;
mod chart_data;
mod contour;
pub mod html;
pub mod markup;
pub mod plot;
mod process;
pub mod series;
mod statistics;
#[cfg(test)]
mod tests;
mod tip;

pub use contour::Contour;
pub use html::{cut_surface, write_html};
pub use process::{Cut, Process};
pub use statistics::{Extent, Following, Spread, Statistics};

use haptimill_protocol::message::State;
use haptimill_trace::{Recorded, Recording, RecordingError, write_csv};
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Smallest angle error of the tool that the terminal shows, degrees.
const SHOWN_ANGLE_DEG: f64 = 0.05;

/// Names of the files in the folder of a job.
pub const RECORDING_FILE: &str = "recording.hmr";
/// The trace.
pub const TRACE_FILE: &str = "trace.csv";
/// The summary.
pub const SUMMARY_FILE: &str = "summary.json";
/// The recording as MCAP.
pub const MCAP_FILE: &str = "recording.mcap";
/// The report.
pub const REPORT_FILE: &str = "report.html";

/// Outcome of a job that the recording does not contain.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobOutcome {
    /// Setpoints of the job that were reached.
    pub setpoints: u64,
    /// Number of underruns.
    pub underruns: u64,
    /// Faults, each as a sentence.
    pub faults: Vec<String>,
    /// Injected faults of the simulator, in the format of the option `--fault`.
    pub injected: Vec<String>,
    /// The program is completed.
    pub completed: bool,
    /// State of the controller at the end; none when the link was lost.
    pub final_state: Option<State>,
    /// The position is known to be right since homing.
    pub position_kept: bool,
    /// Bytes from host to controller per setpoint: frames of messages, framing included.
    pub bytes_per_setpoint: f64,
    /// The same with keep-alive frames and acknowledgements.
    pub line_bytes_per_setpoint: f64,
    /// What was cut from the stock of the simulated machine.
    pub cut: Option<Cut>,
    /// Greatest spindle speed of the program, rev/min; the recording of a job through a port has
    /// none.
    pub spindle_rpm: Option<u16>,
    /// Which part of the control periods the recording has; none where it has all.
    pub recorded_part: Option<String>,
}

/// The summary of a job; summary.json has these fields.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the machine.
    pub machine: String,
    /// Name of the program.
    pub program: String,
    /// Duration of the job, s.
    pub duration_s: f64,
    /// Length of the programmed path, mm.
    pub path_length_mm: f64,
    /// Tool against the programmed geometry at the same time, root mean square, mm.
    pub tool_error_rms_mm: f64,
    /// The same, largest, mm.
    pub tool_error_max_mm: f64,
    /// Time of the largest, s from the start of the job.
    pub tool_error_max_time_s: f64,
    /// Program line of the largest; 0 when there is none.
    pub tool_error_max_line: u32,
    /// Tool against the nearest point of the programmed path, root mean square, mm.
    pub contour_error_rms_mm: f64,
    /// The same, largest, mm.
    pub contour_error_max_mm: f64,
    /// Rotary coordinates against the programmed ones, largest, degrees.
    pub angle_error_max_deg: f64,
    /// Following error of the linear joints, largest, mm.
    pub following_error_max_mm: f64,
    /// Joint of the largest; empty without a linear joint.
    pub following_error_max_mm_joint: String,
    /// Following error of the rotary joints, largest, degrees.
    pub following_error_max_deg: f64,
    /// Joint of the largest; empty without a rotary joint.
    pub following_error_max_deg_joint: String,
    /// The position of the tool, and the force on it, are those of the simulated tool; otherwise
    /// the controller measured them, the force as its peak in the last revolution of the spindle.
    pub tool_is_true: bool,
    /// What the tool and contour errors are against: `programmed path`, or `compliant path` where
    /// an axis under force control was displaced.
    pub error_reference: &'static str,
    /// Setpoints of the job that were reached.
    pub setpoints: u64,
    /// Number of underruns.
    pub underruns: u64,
    /// Faults, each as a sentence.
    pub faults: Vec<String>,
    /// Injected faults of the simulator, in the format of the option `--fault`.
    pub injected: Vec<String>,
    /// The program is completed.
    pub completed: bool,
    /// State of the controller at the end; `Unknown` when the link was lost.
    pub final_state: String,
    /// The same in words.
    #[serde(skip)]
    final_state_text: String,
    /// The position is known to be right since homing.
    pub position_kept: bool,
    /// Joints without an encoder: their steps are counted, and lost steps are not detected.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub open_loop_joints: Vec<String>,
    /// Bytes from host to controller per setpoint: frames of messages, framing included.
    pub bytes_per_setpoint: f64,
    /// The same with keep-alive frames and acknowledgements.
    pub line_bytes_per_setpoint: f64,
    /// Volumetric compensation in full effect during the job: `on`, `off`, or in which part;
    /// missing where the machine has no error tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub volumetric_compensation: Option<String>,
    /// Force, compliance, spindle and cut; a value is missing where machine or job have none.
    #[serde(flatten)]
    pub process: Process,
    /// Control periods recorded.
    pub periods: u64,
    /// Which part of the control periods is recorded; missing where all are. The figures are of
    /// all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorded_part: Option<String>,
    /// SHA-256 of the recording.
    pub trace_sha256: String,
}

impl Summary {
    /// Evaluates a recording.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn of(
        recording: &Recording,
        recorded: &Recorded,
        outcome: &JobOutcome,
    ) -> Result<(Self, Statistics), RecordingError> {
        let mut statistics = Statistics::new(recording);
        for record in recording.iter()? {
            statistics.add(&record?);
        }
        statistics.finish();
        let summary = Self::of_statistics(recording, &statistics, recorded, outcome);
        Ok((summary, statistics))
    }

    /// The summary of finished statistics.
    fn of_statistics(
        recording: &Recording,
        statistics: &Statistics,
        recorded: &Recorded,
        outcome: &JobOutcome,
    ) -> Self {
        let header = recording.header();
        let (begin, end) = statistics.job.unwrap_or((0.0, 0.0));
        let name = |following: &Following| {
            let joint = following.joint.and_then(|joint| header.joints.get(joint));
            joint.cloned().unwrap_or_default()
        };
        Self {
            machine: header.machine.clone(),
            program: header.program.clone(),
            duration_s: end - begin,
            path_length_mm: statistics.path_length_mm,
            tool_error_rms_mm: statistics.tool_error.rms(),
            tool_error_max_mm: statistics.tool_error.max,
            tool_error_max_time_s: (statistics.tool_error.max_time_s - begin).max(0.0),
            tool_error_max_line: statistics.tool_error.max_line,
            contour_error_rms_mm: statistics.contour_error.rms(),
            contour_error_max_mm: statistics.contour_error.max,
            angle_error_max_deg: statistics.angle_error.max,
            following_error_max_mm: statistics.following_linear.error.max,
            following_error_max_mm_joint: name(&statistics.following_linear),
            following_error_max_deg: statistics.following_rotary.error.max,
            following_error_max_deg_joint: name(&statistics.following_rotary),
            tool_is_true: statistics.tool_is_true,
            error_reference: match statistics.displacement.max > 0.0 {
                true => "compliant path",
                false => "programmed path",
            },
            setpoints: outcome.setpoints,
            underruns: outcome.underruns,
            faults: outcome.faults.clone(),
            injected: outcome.injected.clone(),
            completed: outcome.completed,
            final_state: outcome
                .final_state
                .map_or("Unknown".to_string(), |state| format!("{state:?}")),
            final_state_text: outcome
                .final_state
                .map_or("Unknown".to_string(), state_text),
            position_kept: outcome.position_kept,
            open_loop_joints: (header.joints.iter().zip(&recording.config().joints))
                .filter(|(_, joint)| joint.is_open_loop())
                .map(|(name, _)| name.clone())
                .collect(),
            bytes_per_setpoint: outcome.bytes_per_setpoint,
            line_bytes_per_setpoint: outcome.line_bytes_per_setpoint,
            volumetric_compensation: statistics.compensation(),
            process: Process::of(statistics, outcome),
            periods: recorded.records,
            recorded_part: outcome.recorded_part.clone(),
            trace_sha256: recorded.sha256.clone(),
        }
    }

    /// Largest following errors of the linear and of the rotary joints, with their joints.
    fn following_error(&self, decimals: usize) -> String {
        let parts = [
            (
                self.following_error_max_mm,
                "mm",
                &self.following_error_max_mm_joint,
            ),
            (
                self.following_error_max_deg,
                "deg",
                &self.following_error_max_deg_joint,
            ),
        ];
        let parts: Vec<String> = parts
            .into_iter()
            .filter(|(_, _, joint)| !joint.is_empty())
            .map(|(error, unit, joint)| format!("{error:.decimals$} {unit} ({joint})"))
            .collect();
        if parts.is_empty() {
            "not known".to_string()
        } else {
            parts.join(", ")
        }
    }

    /// A few lines for the terminal; each ends with a line feed.
    pub fn terminal(&self) -> String {
        let line = match self.tool_error_max_line {
            0 => String::new(),
            line => format!(", line {line}"),
        };
        let measured = if self.tool_is_true { "" } else { " (measured)" };
        let against = if self.is_compliant() {
            " against the compliant path"
        } else {
            ""
        };
        let tool = format!("tool error{measured}{against}");
        let kept = match self.final_state.as_str() {
            "Unknown" => "the link to the controller was lost; `haptimill status` shows its state",
            _ if self.position_kept => "position kept",
            _ => "position lost: home the machine",
        };
        let mut text = format!(
            "{}: {} in {}, {:.1} mm of path, {}, {}\n\
             {tool}: {:.4} mm rms, {:.4} mm largest (at {:.2} s{line}); contour {:.4} / {:.4} mm\n\
             largest following error: {}\n",
            self.program,
            match (self.faults.is_empty(), self.completed) {
                (false, _) => "FAULT",
                (true, true) => "ended",
                (true, false) => "stopped",
            },
            duration(self.duration_s),
            self.path_length_mm,
            count(self.setpoints as usize, "setpoint"),
            count(self.underruns as usize, "underrun"),
            self.tool_error_rms_mm,
            self.tool_error_max_mm,
            self.tool_error_max_time_s,
            self.contour_error_rms_mm,
            self.contour_error_max_mm,
            self.following_error(4),
        );
        if self.angle_error_max_deg >= SHOWN_ANGLE_DEG {
            text.push_str(&format!(
                "angle error of the tool: {:.3} deg largest\n",
                self.angle_error_max_deg
            ));
        }
        if let Some(state) = &self.volumetric_compensation {
            text.push_str(&format!("volumetric compensation: {state}\n"));
        }
        text.push_str(&self.process.terminal(self.tool_is_true));
        if let Some(part) = &self.recorded_part {
            let records = count(self.periods as usize, "record");
            text.push_str(&format!(
                "recorded: {part}, {records}; the figures are of all\n"
            ));
        }
        for fault in &self.injected {
            text.push_str(&format!("injected fault: {fault}\n"));
        }
        for fault in &self.faults {
            text.push_str(&format!("fault: {fault}\n"));
        }
        text.push_str(&format!(
            "{}, {kept}{}\n",
            self.final_state_text.to_lowercase(),
            self.counted()
        ));
        text
    }

    /// An axis under force control was displaced: the errors are against the compliant path.
    fn is_compliant(&self) -> bool {
        self.process.displacement_max_mm.is_some()
    }

    /// The joints without an encoder if the position is kept: it is not measured there.
    fn counted(&self) -> String {
        if self.open_loop_joints.is_empty() || !self.position_kept {
            return String::new();
        }
        let joints = self.open_loop_joints.join(", ");
        format!(" ({joints}: counted steps, not measured)")
    }
}

/// A state as the first words of a line: `Emergency stop`.
#[must_use]
pub fn state_text(state: State) -> String {
    let text = state.to_string();
    let text = text.strip_prefix("in ").unwrap_or(&text);
    let mut letters = text.chars();
    let first = letters.next().map(|first| first.to_ascii_uppercase());
    first.into_iter().chain(letters).collect()
}

/// A number of things: `1 block`, `2 blocks`.
#[must_use]
pub fn count(number: usize, thing: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {thing}{plural}")
}

/// Formats a duration.
pub fn duration(seconds: f64) -> String {
    // Rounded first: 119.7 s must not become 1 min 60 s.
    let whole = seconds.round();
    if seconds < 60.0 {
        format!("{seconds:.2} s")
    } else if whole < 3600.0 {
        format!("{} min {:02} s", (whole / 60.0).floor(), whole % 60.0)
    } else {
        let minutes = (seconds / 60.0).round();
        format!("{} h {:02} min", (minutes / 60.0).floor(), minutes % 60.0)
    }
}

/// Writes trace, summary and report of `DIR/recording.hmr`. `statistics` are those of all records
/// of the job where the recording has a part of them.
///
/// # Errors
/// The recording cannot be read, or a file cannot be written.
pub fn write_all(
    dir: &Path,
    recorded: &Recorded,
    outcome: &JobOutcome,
    trace_every: u32,
    statistics: Option<Statistics>,
) -> Result<Summary, RecordingError> {
    let recording = Recording::open(&dir.join(RECORDING_FILE))?;
    let create = |name: &str| {
        let path = dir.join(name);
        let file = File::create(&path).map_err(|error| RecordingError::Io(path, error))?;
        Ok(BufWriter::new(file))
    };
    write_csv(&recording, &mut create(TRACE_FILE)?, trace_every)?;
    let (summary, statistics) = match statistics {
        None => Summary::of(&recording, recorded, outcome)?,
        Some(mut statistics) => {
            statistics.finish();
            let summary = Summary::of_statistics(&recording, &statistics, recorded, outcome);
            (summary, statistics)
        }
    };
    let mut file = create(SUMMARY_FILE)?;
    let io = |error| RecordingError::Io(dir.join(SUMMARY_FILE), error);
    serde_json::to_writer_pretty(&mut file, &summary).map_err(|error| io(error.into()))?;
    file.write_all(b"\n")
        .and_then(|()| file.flush())
        .map_err(io)?;
    let mut file = create(REPORT_FILE)?;
    let cut = outcome.cut.as_ref();
    write_html(&recording, &summary, &statistics, cut, &mut file)?;
    file.flush()
        .map_err(|error| RecordingError::Io(dir.join(REPORT_FILE), error))?;
    Ok(summary)
}
