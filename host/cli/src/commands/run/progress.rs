//! Progress of a job on the terminal: bar, line, remaining time, pauses.

use super::args::RunArgs;
use super::keys::Keys;
use super::operator::Operator;
use super::supply::{Shown, Times};
use crate::commands::program::Pauses;
use haptimill_client::session::{JobObserver, TimeTable};
use haptimill_machine_file::MachineFile;
use haptimill_planner::SharedTrack;
use haptimill_protocol::message::{Command, Telemetry};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::BufRead as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The progress bar with the remaining time.
pub(super) struct ProgressDisplay<'a> {
    args: &'a RunArgs,
    bar: ProgressBar,
    start: Instant,
    machine: &'a MachineFile,
    times: Option<&'a Times>,
    /// The time that is left on a machine; in the simulator the real time of a program second is
    /// measured.
    left: Option<TimeTable>,
    operator: &'a mut Operator,
    /// The operator commanded the present hold: only a command ends it.
    is_operators: bool,
    period_s: f64,
    track: SharedTrack,
    pauses: Pauses,
    skips_pauses: bool,
    /// The line of the newest telemetry.
    line: u32,
    /// The line of the present pause.
    paused_at: Option<u32>,
    enter_pressed: Arc<AtomicBool>,
    /// The keys of a terminal, on a machine behind a port.
    keys: Option<Keys>,
}

impl<'a> ProgressDisplay<'a> {
    /// Creates the progress bar of a job that starts now.
    pub(super) fn new(
        args: &'a RunArgs,
        machine: &'a MachineFile,
        shown: &'a Shown,
        operator: &'a mut Operator,
    ) -> Self {
        let times = shown.times.as_ref();
        let total = times.map(|times| (times.programmed_s * 1000.0).round() as u64);
        let is_shown = !args.json && !args.quiet;
        let bar = ProgressBar::with_draw_target(
            total,
            if is_shown {
                ProgressDrawTarget::stderr()
            } else {
                ProgressDrawTarget::hidden()
            },
        );
        let template = match total {
            Some(_) => "{wide_bar} {percent:>3} %  {msg}",
            None => "{msg}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        Self {
            args,
            bar,
            start: Instant::now(),
            machine,
            times,
            left: times.and_then(|times| times.left(machine, operator.overrides.of_motion())),
            operator,
            is_operators: false,
            period_s: shown.track.lock().period_s(),
            track: shown.track.clone(),
            pauses: shown.pauses.clone(),
            // Enter cannot come from standard input that is the program.
            skips_pauses: args.skips_pauses() || args.reads_stdin(),
            line: 0,
            paused_at: None,
            enter_pressed: Arc::new(AtomicBool::new(false)),
            keys: (is_shown && !args.port.is_simulated() && !args.reads_stdin())
                .then(Keys::open)
                .flatten(),
        }
    }

    /// Shows the messages that are left after the last motion, and removes the bar.
    pub(super) fn finish(&self, completed: bool) {
        if completed {
            self.show_messages(u32::MAX);
        }
        self.bar.finish_and_clear();
    }
}

impl JobObserver for ProgressDisplay<'_> {
    fn reported(&mut self, telemetry: &Telemetry) {
        self.operator.note_report(telemetry);
    }

    fn progress(&mut self, telemetry: &Telemetry) {
        let done = f64::from(telemetry.program_periods) * self.period_s;
        self.bar.set_position((done * 1000.0) as u64);
        let line = self.track.lock().place_of(telemetry.setpoint).line;
        self.line = line;
        self.show_messages(telemetry.setpoint);
        if let Some(line) = self.paused_at {
            self.bar
                .set_message(format!("line {line}, paused, waiting for Enter"));
            return;
        }
        let Some(total) = self.bar.length() else {
            let time = haptimill_report::duration(done);
            self.bar.set_message(format!("line {line}, {time}"));
            return;
        };
        let total = total as f64 / 1000.0;
        let measured = || {
            let real_per_program_s = self.start.elapsed().as_secs_f64() / done.max(0.1);
            (total - done).max(0.0) * real_per_program_s
        };
        let left = self.left.as_ref();
        let left = left.map(|left| left.left_s(u64::from(telemetry.program_periods)));
        let remaining = left.unwrap_or_else(measured).ceil();
        let remaining = match remaining {
            s if s < 60.0 => format!("{s} s"),
            s => haptimill_report::duration(s),
        };
        self.bar
            .set_message(format!("line {line}, {remaining} left"));
    }

    fn paused(&mut self, setpoint: u32) {
        let Some(pause) = self.pauses.get(setpoint) else {
            return;
        };
        if self.skips_pauses {
            self.show(&format!("{pause}: pause skipped"));
            return;
        }
        let (line, why) = (pause.line, format!("{pause}: the program pauses"));
        self.wait_for_enter(line, &why);
    }

    fn held_by_input(&mut self, what: &str) {
        if self.skips_pauses {
            self.show(what);
        } else {
            self.wait_for_enter(self.line, what);
        }
    }

    fn wants_hold(&mut self) -> bool {
        self.follow_operator();
        let holds = std::mem::take(&mut self.operator.holds);
        if holds {
            self.wait_for_enter(self.line, "held by the operator");
            self.is_operators = true;
        }
        holds
    }

    fn wants_override(&mut self) -> Option<Command> {
        self.follow_operator();
        let command = self.operator.overrides.take()?;
        let overrides = &self.operator.overrides;
        self.bar.println(overrides.to_string());
        self.left = self
            .times
            .and_then(|times| times.left(self.machine, overrides.of_motion()));
        Some(command)
    }

    fn may_resume(&mut self) -> bool {
        self.follow_operator();
        if std::mem::take(&mut self.operator.resumes) {
            self.enter_pressed.store(true, Ordering::Relaxed);
        }
        let resumes = (self.skips_pauses && !self.is_operators)
            || self.enter_pressed.swap(false, Ordering::Relaxed);
        if resumes {
            self.paused_at = None;
            (self.is_operators, self.operator.is_held) = (false, false);
        }
        resumes
    }
}

impl ProgressDisplay<'_> {
    /// Follows the keys that were pressed, and the requests of other processes.
    fn follow_operator(&mut self) {
        self.operator.serve();
        let Some(keys) = &mut self.keys else { return };
        while let Some(key) = keys.next() {
            if let Err(what) = self.operator.key(key) {
                self.bar.println(what);
            }
        }
    }

    /// Shows the messages of the program up to a setpoint.
    fn show_messages(&self, setpoint: u32) {
        while let Some(text) = self.next_message(setpoint) {
            if self.bar.is_hidden() {
                self.args.print_program_message(&text);
            } else {
                self.bar.println(text);
            }
        }
    }

    /// Shows a line above the bar, or as a message where there is none.
    fn show(&self, text: &str) {
        if self.bar.is_hidden() {
            self.args.print_message(text);
        } else {
            self.bar.println(text);
        }
    }

    fn next_message(&self, setpoint: u32) -> Option<String> {
        self.track.lock().take_message(setpoint)
    }

    /// Asks the user for Enter; [`JobObserver::may_resume`] reports it.
    fn wait_for_enter(&mut self, line: u32, why: &str) {
        let what = format!("{why}; press Enter to continue, Ctrl-C to stop");
        if self.bar.is_hidden() {
            // The bar is hidden with --quiet, or because standard error is no terminal. The user
            // must still know about the pause.
            eprintln!("{what}");
        } else {
            self.bar.println(what);
        }
        self.paused_at = Some(line);
        self.operator.is_held = true;
        self.enter_pressed.store(false, Ordering::Relaxed);
        // An Enter before the pause must not end it.
        if let Some(keys) = &mut self.keys {
            keys.clear();
            (self.operator.holds, self.operator.resumes) = (false, false);
            return;
        }
        #[cfg(unix)]
        let _ = rustix::termios::tcflush(std::io::stdin(), rustix::termios::QueueSelector::IFlush);
        let enter_pressed = Arc::clone(&self.enter_pressed);
        // Reading a line blocks. The session must continue, or the heartbeat of the host times out.
        std::thread::spawn(move || {
            // Any bytes before Enter are accepted.
            match std::io::stdin().lock().skip_until(b'\n') {
                Ok(0) => {}
                Ok(_) => enter_pressed.store(true, Ordering::Relaxed),
                Err(error) => eprintln!("Enter cannot be read: {error}; stop with Ctrl-C"),
            }
        });
    }
}
