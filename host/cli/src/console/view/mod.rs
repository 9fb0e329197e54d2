//! Drawing of a [`ViewModel`] into an area.
//!
//! All panels need 76 columns and 22 rows. Smaller terminals show state, operator prompt, pose, jog
//! and the last messages. State, prompt and the keys that are always active stay visible under
//! every overlay. Colours only repeat the text.

mod bars;
mod master;
mod overlay;
mod panels;
pub(super) mod watched;

use super::view_model::{LinkState, Severity, ViewModel};
use haptimill_protocol::message::{State, Telemetry};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

/// Smallest size for all panels: columns, rows.
const FULL: (u16, u16) = (76, 22);

/// Age above which a report is drawn dim, ms.
const STALE_MS: u128 = 500;

/// Draws the whole screen.
pub(super) fn draw(frame: &mut Frame<'_>, view: &ViewModel) {
    let area = frame.area();
    if area.width == 0 || area.height == 0 {
        return;
    }
    let free = if area.width >= FULL.0 && area.height >= FULL.1 {
        full(frame, area, view)
    } else {
        compact(frame, area, view)
    };
    overlay::draw(frame, free, view);
}

/// Draws all panels. Returns the area for overlays.
fn full(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) -> Rect {
    let axes = view
        .static_info
        .pose
        .len()
        .max(view.static_info.joints.len()) as u16;
    let right_rows = panels::right_rows(view, area.height);
    let body = (2 * (axes + 1) + panels::FEED_ROWS).max(right_rows);
    let [status, prompt, body, messages, link, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(2),
        Constraint::Length(body),
        Constraint::Min(2),
        Constraint::Length(1),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(status_line(view, status.width), status);
    frame.render_widget(prompt_text(view), prompt);
    let left = (body.width * 9 / 16).clamp(45, 80);
    let [left, _, right] = Layout::horizontal([
        Constraint::Length(left),
        Constraint::Length(1),
        Constraint::Min(0),
    ])
    .areas(body);
    panels::left(frame, left, view);
    panels::right(frame, right, view);
    panels::messages(frame, messages, view);
    frame.render_widget(panels::link_line(view), link);
    frame.render_widget(keys_line(keys.width), keys);
    let bottom = link.y;
    Rect {
        y: prompt.y + prompt.height,
        height: bottom.saturating_sub(prompt.y + prompt.height),
        ..area
    }
}

/// Draws as much as fits on a small terminal, most important first. Returns the area for overlays.
fn compact(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) -> Rect {
    let row = |from_top: u16| Rect {
        y: area.y + from_top,
        height: 1,
        ..area
    };
    frame.render_widget(status_line(view, area.width), row(0));
    if area.height == 1 {
        return row(0);
    }
    frame.render_widget(keys_line(area.width), row(area.height - 1));
    if area.height == 2 {
        return row(0);
    }
    let rows = area.height - 2;
    let pose = (view.static_info.pose.len() as u16).min(rows.saturating_sub(1));
    let rest = rows - pose;
    // Rows of prompt, jog and messages.
    let prompt = if rest > 5 { 2 } else { 1 };
    let mut at = 1;
    let mut take = |count: u16| {
        let taken = Rect {
            y: area.y + at,
            height: count.min(rows + 1 - at),
            ..area
        };
        at += taken.height;
        taken
    };
    frame.render_widget(prompt_text(view), take(prompt));
    panels::pose_rows(frame, take(pose), view, false);
    let jog = take(1);
    if jog.height > 0 {
        frame.render_widget(panels::jog_line(view), jog);
    }
    let messages = take(rows);
    if messages.height > 0 {
        panels::message_rows(frame, messages, view);
    }
    Rect {
        y: area.y + 1 + prompt,
        height: rows.saturating_sub(prompt),
        ..area
    }
}

/// Style of a severity.
fn style_of(severity: Severity) -> Style {
    match severity {
        Severity::Info => Style::new().add_modifier(Modifier::BOLD),
        Severity::Warning => Style::new().fg(Color::Black).bg(Color::Yellow),
        Severity::Alarm => Style::new()
            .fg(Color::White)
            .bg(Color::Red)
            .add_modifier(Modifier::BOLD),
    }
}

/// State name in capitals, with its style.
fn state_label(view: &ViewModel) -> (String, Style) {
    let on = |color: Color| {
        Style::new()
            .fg(Color::Black)
            .bg(color)
            .add_modifier(Modifier::BOLD)
    };
    if view.link_state != LinkState::Ready {
        let word = match view.link_state {
            LinkState::Lost(_) => "NO LINK",
            _ => "CONNECTING",
        };
        return (word.to_string(), style_of(Severity::Alarm));
    }
    if let Some(stopping) = view.stopping {
        return (
            format!("{} SENT", stopping.to_uppercase()),
            on(Color::Yellow),
        );
    }
    let Some(telemetry) = &view.telemetry else {
        return ("?".to_string(), on(Color::Gray));
    };
    match telemetry.state {
        State::Disabled => ("DISABLED".to_string(), on(Color::Gray)),
        State::Idle => ("IDLE".to_string(), on(Color::Green)),
        State::Homing => ("HOMING".to_string(), on(Color::Cyan)),
        State::Run => ("RUN".to_string(), on(Color::Cyan)),
        State::Jog => ("JOG".to_string(), on(Color::Cyan)),
        State::Hold => ("HOLD".to_string(), on(Color::Yellow)),
        State::Fault => ("FAULT".to_string(), style_of(Severity::Alarm)),
        State::EmergencyStop => ("EMERGENCY STOP".to_string(), style_of(Severity::Alarm)),
    }
}

fn status_line(view: &ViewModel, width: u16) -> Paragraph<'static> {
    let (word, style) = state_label(view);
    let flags = match &view.telemetry {
        Some(Telemetry { homed: true, .. }) => "homed",
        Some(_) => "not homed",
        None => "",
    };
    let mut spans = vec![Span::styled(format!(" {word} "), style)];
    let mut right = panels::clock(view.elapsed);
    if width >= 70 {
        spans.push(Span::raw(format!(
            " {flags}  {} on {}",
            view.machine, view.static_info.port
        )));
        if let Some((name, rows)) = &view.recording {
            right = format!("REC {name} {rows}  {right}");
        }
    } else {
        spans.push(Span::raw(format!(" {flags} ")));
        if view.recording.is_some() {
            right = format!("REC {right}");
        }
    }
    let used: usize = spans.iter().map(Span::width).sum();
    let gap = usize::from(width).saturating_sub(used + right.chars().count() + 1);
    spans.push(Span::raw(" ".repeat(gap.max(1))));
    let style = if view.recording.is_some() {
        Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
    } else {
        Style::new()
    };
    spans.push(Span::styled(right, style));
    Paragraph::new(Line::from(spans))
}

fn prompt_text(view: &ViewModel) -> Paragraph<'_> {
    let (severity, text) = &view.prompt;
    Paragraph::new(format!(" {text}"))
        .style(style_of(*severity))
        .wrap(Wrap { trim: true })
}

fn keys_line(width: u16) -> Paragraph<'static> {
    let keys: &[(&str, &str)] = if width >= 74 {
        &[
            ("Space", "hold"),
            ("Ctrl-R", "resume"),
            ("Ctrl-X", "stop"),
            ("Ctrl-E", "emergency"),
            ("?", "keys"),
            ("q", "quit"),
        ]
    } else {
        &[
            ("Spc", "hold"),
            ("^R", "resume"),
            ("^X", "stop"),
            ("^E", "EMERG"),
            ("?", ""),
        ]
    };
    let mut spans = Vec::new();
    for (key, what) in keys {
        let style = Style::new().add_modifier(Modifier::REVERSED);
        spans.push(Span::styled(format!(" {key} "), style));
        spans.push(Span::raw(if width >= 74 {
            format!(" {what} ")
        } else {
            what.to_string()
        }));
    }
    Paragraph::new(Line::from(spans))
}
