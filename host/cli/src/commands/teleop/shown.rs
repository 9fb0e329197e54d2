//! What people see of a session: as it goes, and what came of it.

use super::TeleopArgs;
use haptimill_teleop::{Outcome, Row};
use std::io::{IsTerminal, Write};

/// The outcome for people.
pub(super) fn terminal(outcome: &Outcome) -> String {
    let three = |values: &[f64; 3]| format!("{:.2} {:.2} {:.2}", values[0], values[1], values[2]);
    let mut text = format!(
        "the hand led for {:.2} s with {} words; {} holds; {}\n",
        outcome.duration_s,
        outcome.words,
        outcome.holds.len(),
        outcome.final_state
    );
    for hold in &outcome.holds {
        let resumed = hold.resumed_s.map_or("not resumed".to_string(), |at| {
            format!("resumed at {at:.2} s")
        });
        text += &format!("held at {:.2} s: {}; {resumed}\n", hold.at_s, hold.why);
    }
    for why in &outcome.refused {
        text += &format!("not done: {why}\n");
    }
    text += &format!(
        "largest force on the tool {} N, at the hand {} N\n",
        three(&outcome.largest_force_n),
        three(&outcome.largest_felt_n)
    );
    if let Some(latency) = &outcome.latency {
        let how = if outcome.latency_is_exact {
            "to the control period"
        } else {
            "as reported; the wait for a report is not in it"
        };
        text += &format!(
            "from force sensed to force at the hand: {:.1} ms half of the time, {:.1} ms in 95 of 100, {:.1} ms at most ({} forces, {how})\n",
            latency.median_ms, latency.p95_ms, latency.largest_ms, latency.count
        );
    }
    text + &format!(
        "round trips: machine {:.1} ms, hand {:.1} ms\n",
        outcome.machine_round_trip_ms, outcome.hand_round_trip_ms
    )
}

/// What people see while it goes.
pub(super) struct Shown {
    lines: bool,
    bar: bool,
    next_s: f64,
    time_s: f64,
    open: bool,
}

impl Shown {
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

    /// Force and position as it goes, ten times a second.
    pub(super) fn row(&mut self, row: &Row) {
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
        // A terminal that was closed is no reason for a panic.
        let _ = write!(
            std::io::stderr(),
            "\r{:7.2} s {:?} {} tool{} mm  force{} N  hand{} N \x1b[K",
            row.time_s,
            row.state,
            if row.engaged { "led " } else { "free" },
            three(&row.tool, 8, 3),
            three(&row.tool_force, 5, 1),
            three(&row.master_force.force, 5, 2)
        );
    }

    pub(super) fn event(&mut self, event: &str) {
        if self.lines {
            self.done();
            tell!("{:7.2} s  {event}", self.time_s);
        }
    }

    pub(super) fn done(&mut self) {
        if std::mem::take(&mut self.open) {
            let _ = writeln!(std::io::stderr());
        }
    }
}
