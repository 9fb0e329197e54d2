//! View model: all displayed values. The application state builds it, another thread draws it, so
//! neither waits for the other.

use super::jogging::Mode;
use super::listing::Picker;
use super::master::{Face, FieldPosition};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::AxisLimits;
use haptimill_protocol::force::ForceLoop;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterTelemetry};
use haptimill_protocol::message::{MAX_AXES, Source, Telemetry};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::Duration;

/// Capacity of the message log.
const LOG_CAPACITY: usize = 200;

/// Messages among which a repeated one is counted.
const RECENT: usize = 30;

/// The commanded motion between the last two reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// Speed of the tool tip in the workpiece, mm/min.
    pub(super) feed_mm_min: f64,
    /// Any coordinate changes.
    pub(super) is_moving: bool,
}

/// Severity of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Severity {
    /// Information.
    Info,
    /// Refusal or abnormal condition.
    Warning,
    /// The machine stopped by itself, or the link was lost.
    Alarm,
}

/// Message with its time.
#[derive(Debug, Clone)]
pub(super) struct LogEntry {
    pub(super) at: Duration,
    pub(super) severity: Severity,
    pub(super) text: String,
    /// Number of consecutive occurrences.
    pub(super) times: u32,
}

/// Latest messages.
#[derive(Debug, Clone, Default)]
pub(super) struct Log(VecDeque<LogEntry>);

impl Log {
    /// Adds a message. A repeated message increments its count.
    pub(super) fn add(&mut self, at: Duration, severity: Severity, text: impl Into<String>) {
        let text = text.into();
        if let Some(last) = self.0.back_mut().filter(|last| last.text == text) {
            last.times += 1;
            last.at = at;
            return;
        }
        if self.0.len() >= LOG_CAPACITY {
            self.0.pop_front();
        }
        self.0.push_back(LogEntry {
            at,
            severity,
            text,
            times: 1,
        });
    }

    /// Adds a message that may repeat among others, such as the refusal of a peer that tries again:
    /// a recent message of the same text comes to the end with its count.
    pub(super) fn add_repeated(&mut self, at: Duration, severity: Severity, text: String) {
        let recent = self.0.len().saturating_sub(RECENT)..self.0.len();
        let mut same = recent.rev().filter(|index| self.0[*index].text == text);
        match same.next().and_then(|index| self.0.remove(index)) {
            Some(entry) => self.0.push_back(LogEntry {
                at,
                times: entry.times + 1,
                ..entry
            }),
            None => self.add(at, severity, text),
        }
    }

    /// The newest messages, oldest first.
    pub(super) fn newest(&self, count: usize) -> impl Iterator<Item = &LogEntry> {
        self.0.iter().skip(self.0.len().saturating_sub(count))
    }
}

/// Axis name and kind.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) kind: AxisKind,
}

impl ViewModel {
    /// Position of an axis in axis units; a rotary one counts on over the turns of the joint of its
    /// name.
    pub(super) fn unwound(&self, axis: &Axis, value: i32) -> i64 {
        let joints = &self.static_info.joints;
        let joint = joints.iter().position(|joint| joint.name == axis.name);
        match &self.telemetry {
            Some(telemetry) if axis.kind.is_circular() => telemetry.unwound(joint, value),
            _ => i64::from(value),
        }
    }
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

/// Values that never change.
#[derive(Debug)]
pub(super) struct StaticInfo {
    pub(super) port: String,
    pub(super) pose: Vec<Axis>,
    pub(super) joints: Vec<Axis>,
    pub(super) period_s: f64,
    /// Torque drive: the drive value is a DAC code, not a step count.
    pub(super) analogue: Vec<bool>,
}

/// Overlay over the panels.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Overlay {
    None,
    Help {
        /// First visible row.
        from: usize,
    },
    /// Question; Enter confirms.
    Confirm(Confirm),
    /// Text input.
    Prompt {
        title: &'static str,
        text: String,
    },
    /// Choice of a part program.
    Programs(Picker),
    /// Errors of a part program.
    Problems {
        lines: Vec<String>,
        from: usize,
    },
    /// Sources of the coordinates.
    Sources {
        selected: usize,
    },
    /// Force loops.
    Force {
        selected: usize,
    },
    /// Master panel, with the number being typed.
    Master {
        position: FieldPosition,
        typed: String,
    },
}

/// Question.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Confirm {
    Home,
    /// The drives are off.
    EnableAndHome,
    /// Index of the joint that moves off its limit switch.
    MoveOff(usize),
    Tare,
    /// Summary of the checked program, and its notices.
    Run(String, Vec<String>),
    /// Effect on the machine.
    Quit(String),
}

/// State of the link.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum LinkState {
    Opening,
    Handshake,
    /// The machine file is being sent.
    Configuring,
    Ready,
    Lost(String),
}

/// Counters of the link.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counters {
    pub(super) round_trip_us: u32,
    /// Bad frames received by the host.
    pub(super) bad_frames: u32,
    pub(super) resent: u32,
    pub(super) reconnects: u32,
}

/// Selected or running program.
#[derive(Debug, Clone)]
pub(super) struct ProgramView {
    pub(super) name: String,
    pub(super) duration_s: f64,
    /// Time that is left at the overrides, seconds.
    pub(super) left_s: f64,
    pub(super) is_running: bool,
    pub(super) line: u32,
    pub(super) lines: u32,
    /// Text of the line.
    pub(super) text: String,
    /// Spindle speed that the running program has set, at the override, rev/min.
    pub(super) spindle_rpm: Option<i16>,
}

/// All displayed values.
#[derive(Debug, Clone)]
pub(super) struct ViewModel {
    pub(super) static_info: Arc<StaticInfo>,
    pub(super) elapsed: Duration,
    pub(super) machine: String,
    pub(super) link_state: LinkState,
    pub(super) counters: Counters,
    /// Newest telemetry and its age. After a link loss it stays, marked as old.
    pub(super) telemetry: Option<Telemetry>,
    pub(super) age: Duration,
    /// Next action of the operator, or the fault with its remedy.
    pub(super) prompt: (Severity, String),
    pub(super) log: Log,
    pub(super) overlay: Overlay,
    /// First row of the last page of the overlay; its drawing writes it.
    pub(super) last_scroll: Arc<AtomicUsize>,
    pub(super) sources: [Source; MAX_AXES],
    /// Feed, rapid and spindle override, percent.
    pub(super) overrides: [u8; 3],
    /// Commanded motion; none while it is unknown.
    pub(super) motion: Option<Motion>,
    pub(super) jog: JogView,
    pub(super) program: Option<ProgramView>,
    /// Name of the selected program, checked or not.
    pub(super) selected_name: Option<String>,
    /// Force loops of x, y, z; none without a force sensor.
    pub(super) loops: Option<[ForceLoop; 3]>,
    pub(super) force_scale_n: f64,
    /// None without a haptic arm and without a remote master.
    pub(super) master: Option<MasterView>,
    pub(super) recording: Option<(String, u64)>,
    /// Stop without an answer yet.
    pub(super) stopping: Option<&'static str>,
}

/// Haptic arm and position scale.
#[derive(Debug, Clone)]
pub(super) struct MasterView {
    /// The arm, if it belongs to this machine.
    pub(super) arm: Option<ArmView>,
    /// Position scale where a master drives the machine, and whether it is known.
    pub(super) scale: Option<(f64, bool)>,
}

/// Haptic arm.
#[derive(Debug, Clone)]
pub(super) struct ArmView {
    /// Newest report and its age.
    pub(super) report: Option<MasterTelemetry>,
    pub(super) age: Duration,
    /// Problem of the arm.
    pub(super) problem: Option<String>,
    pub(super) feedback: ForceFeedback,
    /// No other host can have changed the force feedback settings.
    pub(super) feedback_known: bool,
    /// Lower and upper face of the virtual fixture along each axis.
    pub(super) faces: [[Face; 2]; COMPONENTS],
}

/// Jog keys.
#[derive(Debug, Clone)]
pub(super) struct JogView {
    pub(super) mode: Mode,
    pub(super) rate: f64,
    pub(super) step: f64,
    pub(super) jog_timeout_ms: u64,
    pub(super) has_release_events: bool,
    pub(super) held: [Option<(bool, u64)>; MAX_AXES],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_that_alternate_are_counted_and_other_messages_stay() {
        let mut log = Log::default();
        let at = Duration::from_secs;
        log.add(at(0), Severity::Info, "drives on");
        for second in 1..=70 {
            log.add_repeated(at(second), Severity::Warning, "busy".to_string());
            log.add_repeated(at(second), Severity::Warning, "no request".to_string());
        }
        let shown: Vec<_> = log
            .newest(30)
            .map(|it| (it.text.as_str(), it.times))
            .collect();
        let expected = [("drives on", 1), ("busy", 70), ("no request", 70)];
        assert_eq!(shown, expected);
        assert_eq!(log.newest(1).next().map(|it| it.at), Some(at(70)));
    }
}
