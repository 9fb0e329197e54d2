//! What a person sees of a job under way: the bar, the line, the time left, pauses.

use super::RunArgs;
use haptimill_client::port::PortSpec;
use haptimill_client::session::JobObserver;
use haptimill_planner::Plan;
use haptimill_protocol::message::Telemetry;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::BTreeMap;
use std::io::BufRead as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The progress bar, with the time left.
pub(super) struct Bar {
    bar: ProgressBar,
    begun: Instant,
    /// Seconds for a second of the program, where the job takes its own time; in the simulator it goes by faster, and is measured.
    pace: Option<f64>,
    period_s: f64,
    lines: Vec<u32>,
    pauses: BTreeMap<u32, u32>,
    passes_pauses: bool,
    /// The line at which it stands until Enter is pressed.
    waits_at: Option<u32>,
    entered: Arc<AtomicBool>,
}

impl Bar {
    /// The bar of a job that begins now.
    pub(super) fn new(args: &RunArgs, plan: &Plan, pauses: BTreeMap<u32, u32>) -> Self {
        let total = (plan.figures.duration_s * 1000.0).round() as u64;
        let shown = !args.json && !args.quiet;
        let bar = ProgressBar::with_draw_target(
            Some(total),
            if shown {
                ProgressDrawTarget::stderr()
            } else {
                ProgressDrawTarget::hidden()
            },
        );
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent:>3} %  {msg}") {
            bar.set_style(style);
        }
        let lines = (0..plan.setpoints.len())
            .map(|setpoint| plan.line_of(setpoint))
            .collect();
        Self {
            bar,
            begun: Instant::now(),
            pace: (!matches!(args.port, PortSpec::Simulator | PortSpec::Emulated(_)))
                .then(|| args.rate().recip()),
            period_s: plan.period_s,
            lines,
            pauses,
            passes_pauses: args.passes_pauses(),
            waits_at: None,
            entered: Arc::new(AtomicBool::new(false)),
        }
    }

    /// Takes the bar away.
    pub(super) fn done(&self) {
        self.bar.finish_and_clear();
    }
}

impl JobObserver for Bar {
    fn progress(&mut self, telemetry: &Telemetry) {
        let done = f64::from(telemetry.program_periods) * self.period_s;
        let total = self.bar.length().unwrap_or(0) as f64 / 1000.0;
        self.bar.set_position((done * 1000.0) as u64);
        let line = self
            .lines
            .get(telemetry.setpoint as usize)
            .copied()
            .unwrap_or(0);
        if let Some(line) = self.waits_at {
            self.bar
                .set_message(format!("line {line}, waits for Enter"));
            return;
        }
        let measured = || self.begun.elapsed().as_secs_f64() / done.max(0.1);
        let pace = self.pace.unwrap_or_else(measured);
        let left = ((total - done).max(0.0) * pace).ceil();
        let left = match left {
            s if s < 60.0 => format!("{s} s"),
            s => haptimill_report::duration(s),
        };
        self.bar.set_message(format!("line {line}, {left} left"));
    }

    fn paused(&mut self, setpoint: u32) {
        let line = self.pauses.get(&setpoint).copied().unwrap_or(0);
        if self.passes_pauses {
            self.bar
                .println(format!("line {line}: a pause, passed at once"));
            return;
        }
        let what = format!("line {line}: the program pauses; Enter goes on, Ctrl-C ends it");
        if self.bar.is_hidden() {
            // Without a bar, by --quiet or because standard error goes elsewhere, it must be said all the same.
            eprintln!("{what}");
        } else {
            self.bar.println(what);
        }
        self.waits_at = Some(line);
        self.entered.store(false, Ordering::Relaxed);
        // An Enter of before the pause does not pass it.
        #[cfg(unix)]
        let _ = rustix::termios::tcflush(std::io::stdin(), rustix::termios::QueueSelector::IFlush);
        let entered = Arc::clone(&self.entered);
        // Reading a line waits; the session must go on meanwhile, or the controller would miss its host.
        std::thread::spawn(move || {
            // Whatever was typed in front of Enter, text or not.
            let mut line = Vec::new();
            match std::io::stdin().lock().read_until(b'\n', &mut line) {
                Ok(0) => {}
                Ok(_) => entered.store(true, Ordering::Relaxed),
                Err(error) => eprintln!("Enter cannot be read: {error}; Ctrl-C ends the program"),
            }
        });
    }

    fn may_resume(&mut self) -> bool {
        let may_resume = self.passes_pauses || self.entered.swap(false, Ordering::Relaxed);
        if may_resume {
            self.waits_at = None;
        }
        may_resume
    }
}
