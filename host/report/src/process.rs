//! Force, compliance, spindle and cut of a job.

use super::chart::Backdrop;
use super::{JobOutcome, Statistics};
use serde::Serialize;

/// What was cut from the stock of a simulated machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    /// Volume, mm^3.
    pub removed_mm3: f64,
    /// Greatest depth below the uncut top, mm.
    pub depth_mm: f64,
    /// The cut surface from above.
    pub surface: Option<Backdrop>,
}

/// Figures of force, compliance, spindle and cut.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Process {
    /// Greatest force on the tool, N; where [`super::Summary::tool_is_true`] is false, the greatest
    /// peak per revolution of the spindle that the sensor measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_n: Option<f64>,
    /// Its root mean square, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_rms_n: Option<f64>,
    /// Time of the greatest, s from the start of the job.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_time_s: Option<f64>,
    /// Program line of the greatest; 0 when there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_max_line: Option<u32>,
    /// Greatest compliant displacement, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub displacement_max_mm: Option<f64>,
    /// Greatest spindle speed, rev/min: of the recording, else of the program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spindle_rpm: Option<u16>,
    /// Volume that was cut, mm^3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub removed_mm3: Option<f64>,
    /// Greatest depth of the cut, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut_depth_mm: Option<f64>,
}

impl Process {
    pub(super) fn of(statistics: &Statistics, outcome: &JobOutcome) -> Self {
        let (begin, _) = statistics.job.unwrap_or_default();
        let force = Some(&statistics.force).filter(|force| force.max > 0.0);
        Self {
            force_max_n: force.map(|force| force.max),
            force_rms_n: force.map(super::Spread::rms),
            force_max_time_s: force.map(|force| (force.max_time_s - begin).max(0.0)),
            force_max_line: force.map(|force| force.max_line),
            displacement_max_mm: Some(statistics.displacement.max).filter(|max| *max > 0.0),
            spindle_rpm: Some(statistics.spindle_rpm)
                .filter(|speed| *speed > 0)
                .or(outcome.spindle_rpm),
            removed_mm3: outcome.cut.as_ref().map(|cut| cut.removed_mm3),
            cut_depth_mm: outcome.cut.as_ref().map(|cut| cut.depth_mm),
        }
    }

    /// Rows of the table of figures; a text is empty where the job has none.
    pub(super) fn rows(&self, is_true: bool) -> [(&'static str, String); 5] {
        let force = match (self.force_rms_n, self.force_max_n) {
            (Some(rms), Some(max)) => format!("{rms:.3} / {max:.3} N"),
            _ => String::new(),
        };
        let text = |value: Option<f64>, decimals: usize, unit: &str| {
            value.map_or(String::new(), |value| format!("{value:.decimals$} {unit}"))
        };
        let spindle = self.spindle_rpm.map(|speed| format!("{speed} rev/min"));
        [
            (
                match is_true {
                    true => "Force on the tool, rms / largest",
                    false => "Peak force per revolution (measured), rms / largest",
                },
                force,
            ),
            (
                "Compliant displacement, largest",
                text(self.displacement_max_mm, 5, "mm"),
            ),
            ("Spindle speed, largest", spindle.unwrap_or_default()),
            ("Volume removed", text(self.removed_mm3, 1, "mm^3")),
            (
                "Depth of the cut, largest",
                text(self.cut_depth_mm, 3, "mm"),
            ),
        ]
    }

    /// Name and text of the tile of the force; none without a force.
    pub(super) fn tile(&self, is_true: bool) -> Option<(&'static str, String)> {
        let name = match is_true {
            true => "force, largest",
            false => "peak force, largest",
        };
        Some((name, format!("{:.2} N", self.force_max_n?)))
    }

    /// Lines for the terminal; none without force, spindle and cut.
    pub(super) fn terminal(&self, is_true: bool) -> String {
        let mut text = String::new();
        if let (Some(max), Some(rms)) = (self.force_max_n, self.force_rms_n) {
            let line = match self.force_max_line {
                None | Some(0) => String::new(),
                Some(line) => format!(", line {line}"),
            };
            let time = self.force_max_time_s.unwrap_or_default();
            let what = match is_true {
                true => "force",
                false => "peak force per revolution (measured)",
            };
            text.push_str(&format!(
                "{what}: {max:.2} N largest (at {time:.2} s{line}), {rms:.2} N rms"
            ));
            if let Some(displacement) = self.displacement_max_mm {
                text.push_str(&format!(
                    "; compliant displacement {displacement:.4} mm at most"
                ));
            }
            text.push('\n');
        }
        if let (Some(volume), Some(depth)) = (self.removed_mm3, self.cut_depth_mm) {
            text.push_str(&format!("cut: {volume:.1} mm^3, {depth:.2} mm deep\n"));
        }
        if let Some(speed) = self.spindle_rpm {
            text.push_str(&format!("spindle: {speed} rev/min at most\n"));
        }
        text
    }
}
