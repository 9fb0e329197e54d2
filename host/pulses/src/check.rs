//! Check of the lines of drives against the commanded pulses and the data sheet.

use crate::align::{self, Track};
use crate::capture::{Capture, Signal};
use crate::expected::{Clock, Planned, Pulse, pulses};
use serde::Serialize;
use std::fmt;

/// Number of faults that a report lists; the others are counted.
const LISTED: usize = 50;

/// Lines of a joint's drive, and what was commanded.
#[derive(Debug, Clone, Copy)]
pub struct AxisSignals<'a> {
    /// Name of the joint.
    pub name: &'a str,
    /// Step line; a step is a rising edge.
    pub step: &'a Signal,
    /// Direction line; high is a positive step.
    pub direction: &'a Signal,
    /// Commanded segments, by period; without them only the data sheet is checked.
    pub planned: Option<&'a [Planned]>,
}

/// Rules of the check. Times are in fs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Step clock and control period.
    pub clock: Clock,
    /// Largest difference of an edge from its commanded time. Each time in a capture is rounded to
    /// the unit of its file, so less than two units would find faults in a perfect board.
    pub tolerance: i64,
    /// Shortest high time of a pulse.
    pub width: i64,
    /// Shortest low time between two pulses.
    pub pause: i64,
    /// Shortest time from a change of the direction to the next rising edge.
    pub setup: i64,
    /// Shortest time from a falling edge to a change of the direction.
    pub hold: i64,
    /// High time that the board makes, in ticks: falling edges then have commanded times too.
    pub exact_width: Option<u32>,
}

/// Kind of a fault on a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// An edge is not at its commanded time.
    Displaced,
    /// A commanded pulse is missing.
    Missing,
    /// A pulse was not commanded.
    Extra,
    /// The direction line has the wrong level at a rising edge.
    WrongDirection,
    /// A pulse is shorter than the drive can detect.
    Narrow,
    /// A pause is shorter than the drive can detect.
    ShortPause,
    /// A pulse comes too soon after a change of the direction.
    Setup,
    /// The direction changes too soon after a pulse, or within it.
    Hold,
    /// A pulse begins while the drives are disabled.
    Disabled,
}

impl FaultKind {
    /// All kinds, in the order of the reports.
    pub const ALL: [Self; 9] = [
        Self::Displaced,
        Self::Missing,
        Self::Extra,
        Self::WrongDirection,
        Self::Narrow,
        Self::ShortPause,
        Self::Setup,
        Self::Hold,
        Self::Disabled,
    ];

    /// What the fault is, for people.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Displaced => "an edge is not at its commanded time",
            Self::Missing => "a commanded pulse is missing",
            Self::Extra => "a pulse was not commanded",
            Self::WrongDirection => "the direction line has the wrong level at a rising edge",
            Self::Narrow => "a pulse is too short",
            Self::ShortPause => "a pause between two pulses is too short",
            Self::Setup => "a pulse comes too soon after a change of the direction",
            Self::Hold => "the direction changes too soon after a pulse",
            Self::Disabled => "a pulse begins while the drives are disabled",
        }
    }
}

impl fmt::Display for FaultKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.text())
    }
}

/// A fault on a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Time in the capture, fs.
    pub time: i64,
    /// Distance from the commanded time, or the time that is too short, fs; 0 where there is none.
    pub amount: i64,
    /// Control period of the pulse, if it was commanded.
    pub period: Option<u64>,
}

/// Result of the check of a joint.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct AxisReport {
    /// Name of the joint.
    pub name: String,
    /// Pulses on the line.
    pub pulses: u64,
    /// Edges that were compared with commanded times.
    pub compared: u64,
    /// Sum of all steps on the line, by the direction line.
    pub count: i64,
    /// Sum of the commanded steps within the capture; `None` where none were given.
    pub commanded: Option<i64>,
    /// Largest distance of a compared edge from its commanded time, fs.
    pub largest_error: i64,
    /// Shortest high time, fs.
    pub shortest_width: Option<i64>,
    /// Shortest low time between two pulses, fs.
    pub shortest_pause: Option<i64>,
    /// Shortest time from a change of the direction to a pulse, fs.
    pub shortest_setup: Option<i64>,
    /// Shortest time from a pulse to a change of the direction, fs.
    pub shortest_hold: Option<i64>,
    /// Number of faults.
    pub fault_count: u64,
    /// The first faults.
    pub faults: Vec<Fault>,
}

/// A line of numbers, and a line for each of the first five faults.
impl fmt::Display for AxisReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "{}: {} pulses, {} edges compared, {} faults, largest error {} fs; sum {}, commanded {}",
            self.name,
            self.pulses,
            self.compared,
            self.fault_count,
            self.largest_error,
            self.count,
            self.commanded.unwrap_or(0)
        )?;
        for fault in self.faults.iter().take(5) {
            write!(out, "\n  {fault:?}")?;
        }
        Ok(())
    }
}

impl AxisReport {
    fn add(&mut self, kind: FaultKind, time: i64, amount: i64, period: Option<u64>) {
        self.fault_count += 1;
        if self.faults.len() < LISTED {
            self.faults.push(Fault {
                kind,
                time,
                amount,
                period,
            });
        }
    }
}

/// Result of a check.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Time in the capture at which control period 0 begins, fs; `None` where no pulse could be
    /// compared.
    pub offset: Option<i64>,
    /// The joints.
    pub axes: Vec<AxisReport>,
}

impl Report {
    /// Number of faults of all joints.
    #[must_use]
    pub fn fault_count(&self) -> u64 {
        self.axes.iter().map(|axis| axis.fault_count).sum()
    }

    /// Number of edges that were compared with commanded times.
    #[must_use]
    pub fn compared(&self) -> u64 {
        self.axes.iter().map(|axis| axis.compared).sum()
    }
}

/// Checks the lines of all joints. `enable` is the line that enables the drives, active high; its
/// level applies to every step line.
#[must_use]
pub fn check(
    capture: &Capture,
    axes: &[AxisSignals<'_>],
    enable: Option<&Signal>,
    rules: &Rules,
) -> Report {
    let commanded: Vec<Vec<Pulse>> = axes
        .iter()
        .map(|axis| pulses(axis.planned.unwrap_or_default(), rules.clock))
        .collect();
    let rises: Vec<Vec<i64>> = axes
        .iter()
        .map(|axis| axis.step.changes_to(true).map(|(rise, _)| rise).collect())
        .collect();
    let tracks: Vec<_> = commanded
        .iter()
        .zip(&rises)
        .map(|(pulses, rises)| Track { rises, pulses })
        .collect();
    let offset = align::offset(&tracks, rules.clock, rules.tolerance);
    let reports = axes.iter().zip(&commanded).map(|(axis, commanded)| {
        let mut report = AxisReport {
            name: axis.name.to_string(),
            ..AxisReport::default()
        };
        measure(&mut report, axis, enable, rules);
        if axis.planned.is_some() {
            compare(
                &mut report,
                axis,
                commanded,
                offset.unwrap_or(0),
                capture,
                rules,
            );
        }
        report.faults.sort_by_key(|fault| fault.time);
        report
    });
    Report {
        offset,
        axes: reports.collect(),
    }
}

/// Compares the lines with the data sheet.
fn measure(
    report: &mut AxisReport,
    axis: &AxisSignals<'_>,
    enable: Option<&Signal>,
    rules: &Rules,
) {
    let min = |smallest: &mut Option<i64>, value: i64| {
        *smallest = Some(smallest.map_or(value, |before| before.min(value)));
    };
    let mut last_fall = None;
    for (rise, fall) in axis.step.changes_to(true) {
        report.pulses += 1;
        let changes = axis.direction.changes_until(rise);
        report.count += if axis.direction.level_at(rise) { 1 } else { -1 };
        if enable.is_some_and(|enable| !enable.level_at(rise)) {
            report.add(FaultKind::Disabled, rise, 0, None);
        }
        if let Some(fall) = last_fall {
            let pause = rise - fall;
            min(&mut report.shortest_pause, pause);
            if pause < rules.pause {
                report.add(FaultKind::ShortPause, rise, pause, None);
            }
        }
        if let Some(change) = changes.checked_sub(1).map(|at| axis.direction.changes[at]) {
            let setup = rise - change;
            min(&mut report.shortest_setup, setup);
            if setup < rules.setup {
                report.add(FaultKind::Setup, rise, setup, None);
            }
        }
        let Some(fall) = fall else { continue };
        last_fall = Some(fall);
        let width = fall - rise;
        min(&mut report.shortest_width, width);
        if width < rules.width {
            report.add(FaultKind::Narrow, rise, width, None);
        }
        if let Some(change) = axis.direction.changes.get(changes) {
            let hold = change - fall;
            min(&mut report.shortest_hold, hold);
            if hold < rules.hold {
                report.add(FaultKind::Hold, *change, hold, None);
            }
        }
    }
}

/// Compares the edges of a step line with the commanded pulses that lie within the capture.
fn compare(
    report: &mut AxisReport,
    axis: &AxisSignals<'_>,
    commanded: &[Pulse],
    offset: i64,
    capture: &Capture,
    rules: &Rules,
) {
    let clock = rules.clock;
    let at = |pulse: &Pulse| clock.femtoseconds(pulse.tick) + offset;
    let inside = |pulse: &&Pulse| {
        at(pulse) >= capture.start - rules.tolerance && at(pulse) <= capture.end - rules.tolerance
    };
    let expected: Vec<&Pulse> = commanded.iter().filter(inside).collect();
    let sign = |pulse: &&Pulse| if pulse.up { 1_i64 } else { -1 };
    report.commanded = Some(expected.iter().map(sign).sum());
    let mut next = 0;
    for (rise, fall) in axis.step.changes_to(true) {
        // A commanded pulse belongs to the edge if no other commanded pulse is nearer to it.
        while let Some(pulse) = expected.get(next) {
            let following = expected.get(next + 1).map(|following| at(following));
            let is_passed = match following {
                Some(following) => (rise - at(pulse)).abs() > (rise - following).abs(),
                None => false,
            };
            if !is_passed {
                break;
            }
            report.add(FaultKind::Missing, at(pulse), 0, Some(pulse.period));
            next += 1;
        }
        let Some(pulse) = expected.get(next) else {
            report.add(FaultKind::Extra, rise, 0, None);
            continue;
        };
        let error = rise - at(pulse);
        // Farther away than half the distance to its neighbours, the edge is another pulse.
        let before = next
            .checked_sub(1)
            .map(|before| at(pulse) - at(expected[before]));
        let after = expected.get(next + 1).map(|after| at(after) - at(pulse));
        let room = if error < 0 { before } else { after };
        let reach = room.unwrap_or(clock.femtoseconds(clock.period_ticks()));
        if error.abs() > rules.tolerance.max(reach / 2) {
            if error > 0 {
                report.add(FaultKind::Missing, at(pulse), 0, Some(pulse.period));
                next += 1;
            }
            report.add(FaultKind::Extra, rise, 0, None);
            continue;
        }
        next += 1;
        report.compared += 1;
        report.largest_error = report.largest_error.max(error.abs());
        if error.abs() > rules.tolerance {
            report.add(FaultKind::Displaced, rise, error, Some(pulse.period));
        }
        if axis.direction.level_at(rise) != pulse.up {
            report.add(FaultKind::WrongDirection, rise, 0, Some(pulse.period));
        }
        if let (Some(width), Some(fall)) = (rules.exact_width, fall) {
            let due = clock.femtoseconds(pulse.tick + i64::from(width)) + offset;
            report.compared += 1;
            report.largest_error = report.largest_error.max((fall - due).abs());
            if (fall - due).abs() > rules.tolerance {
                report.add(FaultKind::Displaced, fall, fall - due, Some(pulse.period));
            }
        }
    }
    for pulse in &expected[next..] {
        report.add(FaultKind::Missing, at(pulse), 0, Some(pulse.period));
    }
}
