//! Drawing of a machine that another process commands: `haptimill watch --screen`.

use super::panels::heading;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};
use serde_json::Value;
use std::collections::VecDeque;

/// Events that are kept.
const EVENTS: usize = 100;

/// What the commanding process has passed on.
#[derive(Debug)]
pub(in crate::console) struct Watched {
    /// The address of the commanding process.
    address: String,
    /// The newest report; null before the first one.
    report: Value,
    events: VecDeque<String>,
}

impl Watched {
    /// Nothing is known yet.
    pub(in crate::console) fn new(address: String) -> Self {
        Self {
            address,
            report: Value::Null,
            events: VecDeque::new(),
        }
    }

    /// Takes a report or an event; other objects change nothing.
    pub(in crate::console) fn take(&mut self, line: &str) {
        let Ok(object) = serde_json::from_str::<Value>(line) else {
            return;
        };
        if let Some(event) = object["event"].as_str() {
            self.events.push_back(event.to_string());
            let surplus = self.events.len().saturating_sub(EVENTS);
            self.events.drain(..surplus);
        } else if object["state"].is_string() {
            self.report = object;
        }
    }

    fn status_line(&self) -> Line<'_> {
        let report = &self.report;
        let Some(state) = report["state"].as_str() else {
            return Line::from(format!(" waiting for a report from {}", self.address));
        };
        let is_homed = report["homed"] == true;
        let reference = if is_homed { "homed" } else { "not homed" };
        let label = Style::new().add_modifier(Modifier::REVERSED | Modifier::BOLD);
        Line::from(vec![
            Span::styled(format!(" {} ", state.to_uppercase()), label),
            Span::raw(format!(" {reference}  read-only, {}", self.address)),
        ])
    }

    /// One row per coordinate: name, commanded and measured position, unit.
    fn positions(&self) -> Vec<Line<'_>> {
        let report = &self.report;
        let is_referenced = report["homed"] == true;
        let mark = if is_referenced { ' ' } else { '?' };
        let number = |position: &Value, name: &str| match position[name].as_f64() {
            Some(value) => format!("{value:>11.4}{mark}"),
            None => format!("{:>11} ", "-"),
        };
        let none = Vec::new();
        let names = report["coordinates"].as_array().unwrap_or(&none);
        let units = report["units"].as_array().unwrap_or(&none);
        let rows = names.iter().zip(units).filter_map(|(name, unit)| {
            let (name, unit) = (name.as_str()?, unit.as_str()?);
            let commanded = number(&report["commanded"], name);
            let measured = number(&report["measured"], name);
            Some(Line::from(format!(
                " {name:<7}{commanded}{measured} {unit}"
            )))
        });
        rows.collect()
    }

    fn program_line(&self) -> String {
        let line = match self.report["line"].as_u64() {
            Some(line) => format!("line {line}"),
            None => "no program".to_string(),
        };
        let speed = 100.0 * self.report["speed_factor"].as_f64().unwrap_or(0.0);
        format!(" {line}, path speed {speed:.0} % of the programmed one")
    }
}

/// Draws the whole screen.
pub(in crate::console) fn draw(frame: &mut Frame<'_>, watched: &Watched) {
    let positions = watched.positions();
    let [status, title, rows, program, messages, events, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(positions.len() as u16),
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Min(0),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    frame.render_widget(watched.status_line(), status);
    let titled = |text: &str| heading(text, title.width);
    frame.render_widget(titled("Position commanded ─ measured"), title);
    frame.render_widget(Paragraph::new(positions), rows);
    frame.render_widget(Line::from(watched.program_line()), program);
    frame.render_widget(titled("Messages"), messages);
    let first = watched.events.len().saturating_sub(events.height.into());
    let newest: Vec<Line<'_>> = watched
        .events
        .range(first..)
        .map(|event| Line::from(format!(" {event}")))
        .collect();
    let newest = Paragraph::new(newest).wrap(Wrap { trim: true });
    frame.render_widget(newest, events);
    let key = Style::new().add_modifier(Modifier::REVERSED);
    let quit = Line::from(vec![Span::styled(" q ", key), Span::raw(" quit")]);
    frame.render_widget(quit, keys);
}
