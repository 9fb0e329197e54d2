//! Progress and summary of a session on the terminal.

use super::TeleopArgs;
use haptimill_report::Cut;
use haptimill_teleop::{Row, TeleopOutcome};
use std::io::{IsTerminal, Write};

/// Describes the outcome of a session, with its greatest spindle speed in rev/min and its cut.
pub(super) fn describe(outcome: &TeleopOutcome, spindle_rpm: u16, cut: Option<&Cut>) -> String {
    let three =
        |values: &[f64; 3]| format!("x {:.2} y {:.2} z {:.2}", values[0], values[1], values[2]);
    let mut text = format!(
        "teleoperation for {:.2} s with {} master samples; {} holds; {}\n",
        outcome.duration_s,
        outcome.samples_sent,
        outcome.holds.len(),
        outcome.final_state_text
    );
    for hold in &outcome.holds {
        let resumed = hold.resumed_s.map_or("not resumed".to_string(), |at| {
            format!("resumed at {at:.2} s")
        });
        text += &format!("held at {:.2} s: {}; {resumed}\n", hold.at_s, hold.why);
    }
    for why in &outcome.refused {
        text += &format!("refused: {why}\n");
    }
    text += &format!(
        "largest force on the tool {} N, fed back to the master {} N\n",
        three(&outcome.largest_force_n),
        three(&outcome.largest_feedback_n)
    );
    if let Some(cut) = cut {
        let (volume, depth) = (cut.removed_mm3, cut.depth_mm);
        text += &format!("cut: {volume:.1} mm^3, {depth:.2} mm deep\n");
    }
    if spindle_rpm > 0 {
        text += &format!("spindle: {spindle_rpm} rev/min at most\n");
    }
    if let Some(latency) = &outcome.latency {
        let how = if outcome.latency_is_exact {
            "exact to the control period"
        } else {
            "without the wait for a report"
        };
        text += &format!(
            "latency of the force feedback: median {:.1} ms, 95th percentile {:.1} ms, largest \
             {:.1} ms ({} forces, {how})\n",
            latency.median_ms, latency.p95_ms, latency.largest_ms, latency.count
        );
    }
    text + &format!(
        "round trips: machine {:.1} ms, master {:.1} ms\n",
        outcome.machine_round_trip_ms, outcome.master_round_trip_ms
    )
}

/// The progress of a session.
pub(super) struct Display {
    lines: bool,
    bar: bool,
    next_s: f64,
    time_s: f64,
    open: bool,
}

impl Display {
    pub(super) fn new(args: &TeleopArgs) -> Self {
        let lines = !args.json && !args.quiet;
        Self {
            lines,
            bar: lines && std::io::stderr().is_terminal(),
            next_s: 0.0,
            time_s: 0.0,
            open: false,
        }
    }

    /// Shows force and position, ten times per second.
    pub(super) fn show_row(&mut self, row: &Row) {
        self.time_s = row.time_s;
        if !self.bar || row.time_s < self.next_s {
            return;
        }
        self.next_s = row.time_s + 0.1;
        self.open = true;
        let three = |values: &[f64; 3], width: usize, decimals: usize| -> String {
            values
                .iter()
                .map(|value| format!(" {value:>width$.decimals$}"))
                .collect()
        };
        // Standard error may be closed.
        let _ = write!(
            std::io::stderr(),
            "\r{:7.2} s {:?} switch {} tool{} mm  force{} N  feedback{} N \x1b[K",
            row.time_s,
            row.state,
            if row.enabling_switch {
                "pressed "
            } else {
                "released"
            },
            three(&row.tool, 8, 3),
            three(&row.tool_force, 5, 1),
            three(&row.master_force.force, 5, 2)
        );
    }

    /// Shows an event.
    pub(super) fn show_event(&mut self, event: &str) {
        if self.lines {
            self.finish();
            print_line!("{:7.2} s  {event}", self.time_s);
        }
    }

    /// Ends the line of the progress.
    pub(super) fn finish(&mut self) {
        if std::mem::take(&mut self.open) {
            let _ = writeln!(std::io::stderr());
        }
    }
}
