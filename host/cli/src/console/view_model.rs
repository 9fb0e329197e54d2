//! What is to be seen: a picture of the console's knowledge, made by the desk and drawn elsewhere, so that neither waits for the other.

mod build;

use super::jogging::Mode;
use super::master::{Face, FieldPosition};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::AxisLimits;
use haptimill_protocol::force::ForceLoop;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterTelemetry};
use haptimill_protocol::message::{MAX_AXES, Source, Telemetry};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// Messages that are kept.
const KEPT: usize = 200;

/// How much a message matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Severity {
    /// Something happened.
    Info,
    /// Something was refused, or is not as it should be.
    Warning,
    /// The machine stopped by itself, or the link broke.
    Alarm,
}

/// A message with its time.
#[derive(Debug, Clone)]
pub(super) struct LogEntry {
    pub(super) at: Duration,
    pub(super) severity: Severity,
    pub(super) text: String,
    /// How often it was said in a row.
    pub(super) times: u32,
}

/// The last messages.
#[derive(Debug, Clone, Default)]
pub(super) struct Log(VecDeque<LogEntry>);

impl Log {
    /// Adds a message; the same one again only counts.
    pub(super) fn add(&mut self, at: Duration, severity: Severity, text: impl Into<String>) {
        let text = text.into();
        if let Some(last) = self.0.back_mut().filter(|last| last.text == text) {
            last.times += 1;
            last.at = at;
            return;
        }
        if self.0.len() >= KEPT {
            self.0.pop_front();
        }
        self.0.push_back(LogEntry {
            at,
            severity,
            text,
            times: 1,
        });
    }

    /// The newest ones, oldest first.
    pub(super) fn newest(&self, count: usize) -> impl Iterator<Item = &LogEntry> {
        self.0.iter().skip(self.0.len().saturating_sub(count))
    }
}

/// An axis as it is shown.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) kind: AxisKind,
}

impl Axis {
    pub(super) fn all(limits: &[AxisLimits]) -> Vec<Self> {
        let axis = |axis: &AxisLimits| Self {
            name: axis.name.clone(),
            kind: axis.kind,
        };
        limits.iter().map(axis).collect()
    }
}

/// What never changes.
#[derive(Debug)]
pub(super) struct StaticInfo {
    pub(super) port: String,
    pub(super) pose: Vec<Axis>,
    pub(super) joints: Vec<Axis>,
    pub(super) period_s: f64,
    /// The drive of a joint is commanded by a DAC code, not by steps.
    pub(super) analogue: Vec<bool>,
}

/// What lies over the panels.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Overlay {
    None,
    Help {
        /// Rows that are scrolled away.
        from: usize,
    },
    /// A question; Enter says yes.
    Confirm(Confirm),
    /// A name is typed.
    Prompt {
        title: &'static str,
        text: String,
    },
    /// Mistakes of a part program.
    Problems {
        lines: Vec<String>,
        from: usize,
    },
    /// Sources of the axes.
    Axes {
        at: usize,
    },
    /// Force loop.
    Force {
        at: usize,
    },
    /// The hand; a number that is being typed.
    Master {
        at: FieldPosition,
        typed: String,
    },
}

/// A question.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Confirm {
    Home,
    Tare,
    /// A checked program, in words.
    Run(String),
    /// In words: what happens to the machine.
    Quit(String),
}

/// How the connection stands.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum LinkState {
    Opening,
    Handshake,
    /// The machine file is being sent.
    Configuring,
    Ready,
    Lost(String),
}

/// Counters of the line.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counters {
    pub(super) round_trip_us: u32,
    /// Broken frames that the host heard.
    pub(super) bad_frames: u32,
    pub(super) resent: u32,
    pub(super) reconnects: u32,
}

/// The program that is chosen or runs.
#[derive(Debug, Clone)]
pub(super) struct ProgramView {
    pub(super) name: String,
    pub(super) duration_s: f64,
    pub(super) is_running: bool,
    pub(super) line: u32,
    pub(super) lines: u32,
}

/// Everything.
#[derive(Debug, Clone)]
pub(super) struct ViewModel {
    pub(super) static_info: Arc<StaticInfo>,
    pub(super) elapsed: Duration,
    pub(super) machine: String,
    pub(super) link_state: LinkState,
    pub(super) counters: Counters,
    /// The newest report, and how old it is. After a loss the last one stays, marked as old.
    pub(super) telemetry: Option<Telemetry>,
    pub(super) age: Duration,
    /// What stands in the first line: what to do next, or the fault with its remedy.
    pub(super) prompt: (Severity, String),
    pub(super) log: Log,
    pub(super) overlay: Overlay,
    pub(super) sources: [Source; MAX_AXES],
    pub(super) feed_override: u8,
    pub(super) jog: JogView,
    pub(super) program: Option<ProgramView>,
    /// Name of the program that was chosen, checked or not.
    pub(super) selected_name: Option<String>,
    /// Force loops of x, y, z; none on a machine without a force sensor.
    pub(super) loops: Option<[ForceLoop; 3]>,
    pub(super) force_scale_n: f64,
    /// None on a machine without a haptic arm that follows none either.
    pub(super) master: Option<MasterView>,
    pub(super) recording: Option<(String, u64)>,
    /// A stop that has not been answered yet.
    pub(super) stopping: Option<&'static str>,
}

/// The hand.
#[derive(Debug, Clone)]
pub(super) struct MasterView {
    /// The arm, if it is one of this machine.
    pub(super) arm: Option<ArmView>,
    /// G_P where the machine follows a hand, and whether it is sure.
    pub(super) scale: Option<(f64, bool)>,
}

/// The haptic arm.
#[derive(Debug, Clone)]
pub(super) struct ArmView {
    /// The newest report, and how old it is.
    pub(super) report: Option<MasterTelemetry>,
    pub(super) age: Duration,
    /// What is wrong with it, in words.
    pub(super) problem: Option<String>,
    pub(super) feedback: ForceFeedback,
    /// No other host can have set something else.
    pub(super) feedback_known: bool,
    /// Of each axis the lower and the upper wall.
    pub(super) faces: [[Face; 2]; COMPONENTS],
}

/// The jog keys.
#[derive(Debug, Clone)]
pub(super) struct JogView {
    pub(super) mode: Mode,
    pub(super) rate: f64,
    pub(super) step: f64,
    pub(super) dead_man_ms: u64,
    pub(super) has_release_events: bool,
    pub(super) held: [Option<(bool, u64)>; MAX_AXES],
}
