//! Master panel and overlay: forces, energy, force feedback, virtual fixture, position scale.

use super::bars::around_zero;
use super::panels::{clock, heading, wrapped};
use super::{STALE_MS, style_of};
use crate::console::master::{ALL, Face, Field, FieldPosition, PER_REPORTED, SCALE};
use crate::console::view_model::{ArmView, LinkState, MasterView, Severity, ViewModel};
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM};
use haptimill_protocol::haptic::{COMPONENT_NAMES, ForceFeedbackAxis, MasterTelemetry};
use haptimill_protocol::message::{Source, State};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};

/// Rows of the panel, for terminals of sufficient height.
pub(super) const PANEL_ROWS: u16 = 5;

/// Full scale of the bars: 5.5 N is the force that holds an operator back (docs/control.md 3.4).
pub(super) const SCALE_N: f64 = 5.5;

/// Width from which the overlay has bars and the position of the tip.
const WIDE_COLUMNS: usize = 60;

/// Force of a report, N.
pub(super) fn newtons(raw: i16) -> f64 {
    f64::from(raw) / PER_REPORTED
}

/// The arm with its newest report.
pub(super) fn reported(view: &ViewModel) -> Option<(&ArmView, &MasterTelemetry)> {
    let arm = view.master.as_ref()?.arm.as_ref()?;
    Some((arm, arm.report.as_ref()?))
}

/// Style of a report: dim when it is old.
pub(super) fn fresh(view: &ViewModel, arm: &ArmView) -> Style {
    if view.link_state == LinkState::Ready && arm.age.as_millis() <= STALE_MS {
        Style::new()
    } else {
        Style::new().add_modifier(Modifier::DIM)
    }
}

/// Enabling switch (by this name), coordinates that follow the master, and motors.
fn switch_status(view: &ViewModel, report: &MasterTelemetry, name: &str) -> String {
    let running = view
        .telemetry
        .as_ref()
        .is_some_and(|now| now.state == State::Run);
    let driven: Vec<&str> = view
        .static_info
        .pose
        .iter()
        .zip(&view.sources)
        .filter(|(_, source)| **source == Source::Master)
        .map(|(axis, _)| axis.name.as_str())
        .collect();
    let switch = match (report.pose.enabling_switch, driven.is_empty()) {
        (false, _) => format!("{name} released"),
        (true, false) if running => format!("{name} pressed, moves {}", driven.join(" ")),
        (true, _) => format!("{name} pressed, moves no coordinate"),
    };
    let motors = if report.enabled { "on" } else { "off" };
    format!(" {switch}; motors {motors}")
}

/// Energy balance of the passivity observer.
fn energy(report: &MasterTelemetry) -> String {
    let energy = f64::from(report.energy) / PER_REPORTED;
    if energy < 0.0 {
        format!("; energy deficit {:.2} N mm", -energy)
    } else {
        format!("; energy surplus {energy:.2} N mm")
    }
}

/// Cells of a bar: an odd number, for the one in the middle.
fn cells(width: usize) -> usize {
    // Three bars with a space before each, four numbers, and a name.
    (width.saturating_sub(37) / 3).clamp(5, 17).div_ceil(2) * 2 - 1
}

/// Row of forces: on the tool, on the operator, feedback law, virtual fixture.
fn forces(view: &ViewModel, report: &MasterTelemetry, axis: usize, width: usize) -> String {
    let tool = view
        .telemetry
        .as_ref()
        .and_then(|now| now.force.as_ref())
        .map(|force| f64::from(force.high[axis]) / PER_EFFORT);
    let bar = cells(width);
    let drawn = |value: Option<f64>, scale: f64| {
        let number = value.map_or_else(|| "-".to_string(), |value| format!("{:.2}", value + 0.0));
        match value {
            _ if width < WIDE_COLUMNS => format!("{number:>8}"),
            Some(value) => {
                let part = value / scale;
                format!("{number:>8} {}", around_zero(part, part, bar))
            }
            None => format!("{number:>8} {:bar$}", ""),
        }
    };
    format!(
        " {}{}{}{:>8.2}{}",
        COMPONENT_NAMES[axis],
        drawn(tool, view.force_scale_n),
        drawn(Some(newtons(report.force[axis])), SCALE_N),
        newtons(report.feedback[axis]),
        drawn(Some(newtons(report.fixture[axis])), SCALE_N)
    )
}

/// Heading of [`forces`].
fn forces_heading(view: &ViewModel, width: usize) -> Line<'static> {
    let scale = view.force_scale_n;
    let text = if width < WIDE_COLUMNS {
        format!(
            "  {:>8}{:>9}{:>7}{:>8} N",
            "tool", "operator", "law", "fixture"
        )
    } else {
        let bar = cells(width) + 1;
        let tool = format!("+-{scale} N");
        let master = format!("+-{SCALE_N} N");
        format!(
            "  {:>8}{tool:^bar$}{:>8}{master:^bar$}{:>8}{:>8}{master:^bar$}",
            "tool", "operator", "law", "fixture"
        )
    };
    Line::styled(text, Style::new().add_modifier(Modifier::BOLD))
}

fn unknown_mark(is_known: bool) -> &'static str {
    if is_known { "" } else { "?" }
}

fn face(face: Face) -> String {
    match face {
        Face::Unknown => "none?".to_string(),
        Face::None => "none".to_string(),
        Face::Approximate(at) => format!("~{at:.1}"),
        Face::Known(at) => format!("{:.2}", at + 0.0),
    }
}

/// Common value of all axes, if they agree.
fn same<T: PartialEq + Copy>(
    axes: &[ForceFeedbackAxis; 3],
    of: impl Fn(&ForceFeedbackAxis) -> T,
) -> Option<T> {
    let first = of(&axes[0]);
    axes.iter().all(|axis| of(axis) == first).then_some(first)
}

/// Row of settings: percentage, limit, lower and upper face.
fn settings(
    arm: &ArmView,
    row: usize,
    selected: Option<(usize, &str)>,
    width: usize,
) -> Line<'static> {
    let is_known = unknown_mark(arm.feedback_known);
    let axes = &arm.feedback.axes;
    let axis = (row < ALL).then(|| axes[row]);
    let percent = match axis {
        Some(axis) => Some(axis.percent),
        None => same(axes, |axis| axis.percent),
    };
    let limit = match axis {
        Some(axis) => Some(axis.limit),
        None => same(axes, |axis| axis.limit),
    };
    let percent = percent.map_or("differ".to_string(), |percent| {
        format!("{percent} %{is_known}")
    });
    let limit = limit.map_or("differ".to_string(), |limit| {
        format!("{:.1} N{is_known}", f64::from(limit) / PER_EFFORT)
    });
    let faces = match arm.faces.get(row) {
        Some(faces) => faces.map(face),
        None => ["remove".to_string(), "remove".to_string()],
    };
    let wide = width >= WIDE_COLUMNS;
    let tip = match &arm.report {
        _ if !wide => String::new(),
        Some(report) if row < ALL => {
            format!("{:>12.2}", f64::from(report.pose.tip[row]) / PER_MM)
        }
        _ => format!("{:>12}", ""),
    };
    let name = if row < ALL {
        COMPONENT_NAMES[row]
    } else {
        "all"
    };
    let cell = |column: usize, text: &str, size: usize| {
        let (text, style) = match selected {
            Some((at, typed)) if at == column => {
                let text = if typed.is_empty() {
                    text.to_string()
                } else {
                    format!("{typed}_")
                };
                (text, Style::new().add_modifier(Modifier::REVERSED))
            }
            _ => (text.to_string(), Style::new()),
        };
        let gap = size.saturating_sub(text.chars().count());
        [Span::raw(" ".repeat(gap)), Span::styled(text, style)]
    };
    let size = if wide { 11 } else { 8 };
    let mut spans = vec![Span::raw(format!(" {name:<3}"))];
    spans.extend(cell(0, &percent, size - 3));
    spans.extend(cell(1, &limit, size - 1));
    spans.push(Span::raw(tip));
    spans.extend(cell(2, &faces[0], size));
    spans.extend(cell(3, &faces[1], size));
    Line::from(spans)
}

fn settings_heading(width: usize) -> Line<'static> {
    let text = if width < WIDE_COLUMNS {
        format!(
            "    {:>5}{:>7}{:>8}{:>8} mm",
            "fdbk", "limit", "lower", "upper"
        )
    } else {
        format!(
            "    {:>8}{:>10}{:>12}{:>11}{:>11}",
            "feedback", "limit", "tip, mm", "lower face", "upper face"
        )
    };
    Line::styled(text, Style::new().add_modifier(Modifier::BOLD))
}

/// Key help of a field.
fn keys(field: Field) -> &'static str {
    match field {
        Field::Fixture { axis: None, .. } => "Enter removes all faces; arrows select; Esc closes",
        Field::Fixture { .. } => {
            "Enter sets a virtual fixture face at the tip, or removes it; Esc closes"
        }
        _ => "type a number, Enter sets it; or + and -; arrows select; Esc closes",
    }
}

/// Rows of the overlay, and the row that stays visible.
pub(super) fn overlay(
    view: &ViewModel,
    master: &MasterView,
    at: FieldPosition,
    typed: &str,
    width: usize,
) -> (Vec<Line<'static>>, usize) {
    let mut rows = Vec::new();
    let mut has_unknown = master.scale.is_some_and(|(_, is_known)| !is_known);
    if let Some(arm) = &master.arm {
        let style = fresh(view, arm);
        match &arm.report {
            Some(report) => {
                rows.extend(
                    wrapped(
                        &(switch_status(view, report, "enabling switch") + &energy(report)),
                        width,
                        1,
                    )
                    .into_iter()
                    .map(|row| Line::styled(row, style)),
                );
                if let Some(problem) = &arm.problem {
                    let text = format!(" {problem}");
                    rows.extend(
                        wrapped(&text, width, 1)
                            .into_iter()
                            .map(|row| Line::styled(row, style_of(Severity::Warning))),
                    );
                }
                rows.push(forces_heading(view, width));
                rows.extend(
                    (0..ALL).map(|axis| Line::styled(forces(view, report, axis, width), style)),
                );
            }
            None => rows.push(Line::raw(" the arm has not reported yet")),
        }
        rows.push(settings_heading(width));
        has_unknown |= !arm.feedback_known || arm.faces.as_flattened().contains(&Face::Unknown);
    } else {
        rows.extend(
            wrapped(
                " this machine follows a remote master: \
                 `haptimill teleop` connects it and shows its forces",
                width,
                1,
            )
            .into_iter()
            .map(Line::raw),
        );
    }
    let mut focus = 0;
    if let Some(arm) = &master.arm {
        for row in 0..=ALL {
            let selected = (row == at.row).then_some((at.column, typed));
            if selected.is_some() {
                focus = rows.len();
            }
            rows.push(settings(arm, row, selected, width));
        }
    }
    if let Some((scale, is_known)) = master.scale {
        let selected = at.row == SCALE;
        let text = match (selected, typed) {
            (true, typed) if !typed.is_empty() => format!("{typed}_"),
            _ => format!("{scale:.2}{}", unknown_mark(is_known)),
        };
        let style = if selected {
            focus = rows.len();
            Style::new().add_modifier(Modifier::REVERSED)
        } else {
            Style::new()
        };
        rows.push(Line::from(vec![
            Span::raw(" position scale "),
            Span::styled(text, style),
            Span::raw(" tool motion per master motion"),
        ]));
    }
    let mut add = |text: &str| {
        rows.extend(wrapped(text, width, 0).into_iter().map(Line::raw));
    };
    if has_unknown {
        add("? another host may have changed it; the controller does not report it");
    }
    add(keys(at.field()));
    // The overlay covers the messages panel, which leaves this message out.
    if let Some(entry) = view.log.newest(1).next() {
        let style = match entry.severity {
            Severity::Info => Style::new(),
            severity => style_of(severity),
        };
        let text = format!("{} {}", clock(entry.at), entry.text);
        rows.extend(
            wrapped(&text, width, 8)
                .into_iter()
                .map(|row| Line::styled(row, style)),
        );
    }
    (rows, focus)
}

/// Panel: operator force and its parts.
pub(super) fn panel(view: &ViewModel, width: u16) -> Option<Vec<Line<'static>>> {
    let (arm, report) = reported(view)?;
    let style = fresh(view, arm);
    let mut rows = vec![heading(
        &format!("Master ─ force ─ law ─ fixture ─ +-{SCALE_N} N"),
        width,
    )];
    let bar = usize::from(width).saturating_sub(25).clamp(5, 40);
    for (axis, name) in COMPONENT_NAMES.iter().enumerate() {
        let force = newtons(report.force[axis]);
        let part = force / SCALE_N;
        rows.push(Line::styled(
            format!(
                " {name}{force:>7.2}{:>7.2}{:>7.2} {}",
                newtons(report.feedback[axis]),
                newtons(report.fixture[axis]),
                around_zero(part, part, bar)
            ),
            style,
        ));
    }
    rows.push(match &arm.problem {
        Some(problem) => Line::styled(format!(" {problem}"), style_of(Severity::Warning)),
        None => {
            let (status, energy) = (switch_status(view, report, "switch"), energy(report));
            let fits = status.chars().count() + energy.chars().count() <= usize::from(width);
            Line::styled(if fits { status + &energy } else { status }, style)
        }
    });
    Some(rows)
}
