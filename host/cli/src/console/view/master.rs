//! The hand on a haptic arm: what it feels, the walls around it, and what may be set.

use super::bars::around_zero;
use super::panels::{clock, heading, wrapped};
use super::{STALE_MS, style_of};
use crate::console::master::{ALL, Face, Field, FieldPosition, NAMES, PER_REPORTED, SCALE};
use crate::console::view_model::{ArmView, LinkState, MasterView, Severity, ViewModel};
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM};
use haptimill_protocol::haptic::{ForceFeedbackAxis, MasterTelemetry};
use haptimill_protocol::message::{Source, State};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};

/// Rows of the panel, for terminals that have them to spare.
pub(super) const PANEL_ROWS: u16 = 5;

/// Full scale of the bars of what is felt: 5.5 N really hold a hand back (docs/control.md 3.4).
pub(super) const SCALE_N: f64 = 5.5;

/// From this width on there are bars beside the numbers, and the place of the tip beside the walls.
const WIDE_COLUMNS: usize = 60;

/// A force of a report, N.
pub(super) fn newtons(raw: i16) -> f64 {
    f64::from(raw) / PER_REPORTED
}

/// The arm with its newest report.
pub(super) fn reported(view: &ViewModel) -> Option<(&ArmView, &MasterTelemetry)> {
    let arm = view.master.as_ref()?.arm.as_ref()?;
    Some((arm, arm.report.as_ref()?))
}

/// Numbers of a report that is not of now are dim.
pub(super) fn fresh(view: &ViewModel, arm: &ArmView) -> Style {
    if view.link_state == LinkState::Ready && arm.age.as_millis() <= STALE_MS {
        Style::new()
    } else {
        Style::new().add_modifier(Modifier::DIM)
    }
}

/// Who leads, and whether the arm can.
fn clutch_status(view: &ViewModel, report: &MasterTelemetry) -> String {
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
    let button = match (report.pose.engaged, driven.is_empty()) {
        (false, _) => "button free".to_string(),
        (true, false) if running => format!("button held, leads {}", driven.join(" ")),
        (true, _) => "button held, leads nothing".to_string(),
    };
    let motors = if report.enabled { "on" } else { "off" };
    format!(" {button}; motors {motors}")
}

/// What the hand owes of energy, or may still take.
fn energy(report: &MasterTelemetry) -> String {
    let energy = f64::from(report.energy) / PER_REPORTED;
    if energy < 0.0 {
        format!("; owes {:.2} N mm", -energy)
    } else {
        format!("; owes nothing (credit {energy:.2} N mm)")
    }
}

/// Cells of a bar: an odd number, for there is one in the middle.
fn cells(width: usize) -> usize {
    // Three bars and the space in front of each, four numbers, a name.
    (width.saturating_sub(37) / 3).clamp(5, 17).div_ceil(2) * 2 - 1
}

/// A row of forces: on the tool, at the hand, by the law, of the walls.
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
        NAMES[axis],
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
        format!("  {:>8}{:>8}{:>8}{:>8} N", "tool", "hand", "law", "wall")
    } else {
        let bar = cells(width) + 1;
        let tool = format!("+-{scale} N");
        let master = format!("+-{SCALE_N} N");
        format!(
            "  {:>8}{tool:^bar$}{:>8}{master:^bar$}{:>8}{:>8}{master:^bar$}",
            "tool", "hand", "law", "wall"
        )
    };
    Line::styled(text, Style::new().add_modifier(Modifier::BOLD))
}

fn mark(known: bool) -> &'static str {
    if known { "" } else { "?" }
}

fn face(face: Face) -> String {
    match face {
        Face::Unknown => "none?".to_string(),
        Face::None => "none".to_string(),
        Face::Approximate(at) => format!("~{at:.1}"),
        Face::FieldPosition(at) => format!("{:.2}", at + 0.0),
    }
}

/// What all axes have in common, if they do.
fn same<T: PartialEq + Copy>(
    axes: &[ForceFeedbackAxis; 3],
    of: impl Fn(&ForceFeedbackAxis) -> T,
) -> Option<T> {
    let first = of(&axes[0]);
    axes.iter().all(|axis| of(axis) == first).then_some(first)
}

/// A row of settings: percent, limit, lower and upper wall.
fn settings(
    arm: &ArmView,
    row: usize,
    chosen: Option<(usize, &str)>,
    width: usize,
) -> Line<'static> {
    let known = mark(arm.feedback_known);
    let axes = &arm.feedback.axes;
    let axis = (row < ALL).then(|| axes[row]);
    let percent = match axis {
        Some(axis) => Some(axis.percent),
        None => same(axes, |axis| axis.percent),
    };
    let most = match axis {
        Some(axis) => Some(axis.limit),
        None => same(axes, |axis| axis.limit),
    };
    let percent = percent.map_or("differ".to_string(), |percent| {
        format!("{percent} %{known}")
    });
    let most = most.map_or("differ".to_string(), |most| {
        format!("{:.1} N{known}", f64::from(most) / PER_EFFORT)
    });
    let faces = match arm.faces.get(row) {
        Some(faces) => faces.map(face),
        None => ["away".to_string(), "away".to_string()],
    };
    let wide = width >= WIDE_COLUMNS;
    let tip = match &arm.report {
        _ if !wide => String::new(),
        Some(report) if row < ALL => {
            format!("{:>12.2}", f64::from(report.pose.tip[row]) / PER_MM)
        }
        _ => format!("{:>12}", ""),
    };
    let name = if row < ALL { NAMES[row] } else { "all" };
    let cell = |column: usize, text: &str, size: usize| {
        let (text, style) = match chosen {
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
    spans.extend(cell(1, &most, size - 1));
    spans.push(Span::raw(tip));
    spans.extend(cell(2, &faces[0], size));
    spans.extend(cell(3, &faces[1], size));
    Line::from(spans)
}

fn settings_heading(width: usize) -> Line<'static> {
    let text = if width < WIDE_COLUMNS {
        format!(
            "    {:>5}{:>7}{:>8}{:>8} mm",
            "refl.", "most", "wall", "wall"
        )
    } else {
        format!(
            "    {:>8}{:>10}{:>12}{:>11}{:>11}",
            "reflects", "at most", "tip, mm", "lower wall", "upper wall"
        )
    };
    Line::styled(text, Style::new().add_modifier(Modifier::BOLD))
}

/// What the keys do in a field.
fn keys(field: Field) -> &'static str {
    match field {
        Field::Fixture { axis: None, .. } => {
            "Enter takes all walls away; arrows choose; Esc closes"
        }
        Field::Fixture { .. } => "Enter puts a wall where the tip is, or takes it away; Esc closes",
        _ => "type a number, Enter sets it; or + and -; arrows choose; Esc closes",
    }
}

/// The rows of the overlay, and which of them must be in sight.
pub(super) fn overlay(
    view: &ViewModel,
    master: &MasterView,
    at: FieldPosition,
    typed: &str,
    width: usize,
) -> (Vec<Line<'static>>, usize) {
    let mut rows = Vec::new();
    let mut has_unknown = master.scale.is_some_and(|(_, known)| !known);
    if let Some(arm) = &master.arm {
        let style = fresh(view, arm);
        match &arm.report {
            Some(report) => {
                rows.extend(
                    wrapped(&(clutch_status(view, report) + &energy(report)), width, 1)
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
            None => rows.push(Line::raw(" nothing was heard of the arm yet")),
        }
        rows.push(settings_heading(width));
        has_unknown |= !arm.feedback_known || arm.faces.as_flattened().contains(&Face::Unknown);
    } else {
        rows.extend(
            wrapped(
                " this machine follows a hand afar; `haptimill teleop` leads it, and shows what the hand feels",
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
            let chosen = (row == at.row).then_some((at.column, typed));
            if chosen.is_some() {
                focus = rows.len();
            }
            rows.push(settings(arm, row, chosen, width));
        }
    }
    if let Some((scale, known)) = master.scale {
        let chosen = at.row == SCALE;
        let text = match (chosen, typed) {
            (true, typed) if !typed.is_empty() => format!("{typed}_"),
            _ => format!("{scale:.2}{}", mark(known)),
        };
        let style = if chosen {
            focus = rows.len();
            Style::new().add_modifier(Modifier::REVERSED)
        } else {
            Style::new()
        };
        rows.push(Line::from(vec![
            Span::raw(" G_P "),
            Span::styled(text, style),
            Span::raw(" way of the tool for one of the hand"),
        ]));
    }
    let mut add = |text: &str| {
        rows.extend(wrapped(text, width, 0).into_iter().map(Line::raw));
    };
    if has_unknown {
        add("? unless another host has set it; not told by the controller");
    }
    add(keys(at.field()));
    // The panel of messages lies under this.
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

/// The panel: what is felt, and of what it is made.
pub(super) fn panel(view: &ViewModel, width: u16) -> Option<Vec<Line<'static>>> {
    let (arm, report) = reported(view)?;
    let style = fresh(view, arm);
    let mut rows = vec![heading(
        &format!("Hand ─ felt ── law ── wall ─ +-{SCALE_N} N"),
        width,
    )];
    let bar = usize::from(width).saturating_sub(25).clamp(5, 40);
    for (axis, name) in NAMES.iter().enumerate() {
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
            let (who, owes) = (clutch_status(view, report), energy(report));
            let fits = who.chars().count() + owes.chars().count() <= usize::from(width);
            Line::styled(if fits { who + &owes } else { who }, style)
        }
    });
    Some(rows)
}
