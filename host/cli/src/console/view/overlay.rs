//! Overlays: questions, key table, lists, master panel.

use super::panels::wrapped;
use super::{master, style_of};
use crate::console::keys::BINDINGS;
use crate::console::view_model::{Confirm, Overlay, Severity, ViewModel};
use haptimill_machine_file::scale::PER_EFFORT;
use haptimill_protocol::message::Source;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Block, Clear, Paragraph};

/// Draws the overlay, if there is one, in the middle of an area.
pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) {
    let width = usize::from(area.width.saturating_sub(4)).clamp(1, 90);
    let marked = Style::new().add_modifier(Modifier::REVERSED);
    // Row that stays visible where not all rows fit.
    let mut focus = 0;
    let (title, rows): (&str, Vec<Line<'_>>) = match &view.overlay {
        Overlay::None => return,
        Overlay::Help { from } => {
            let axes: Vec<&str> = view
                .static_info
                .pose
                .iter()
                .map(|axis| axis.name.as_str())
                .collect();
            let rows = BINDINGS.iter().flat_map(|row| {
                let Some(description) = row.describe(&axes) else {
                    return Vec::new();
                };
                let mark = if row.always_active { " (always)" } else { "" };
                wrapped(&format!("{:<11}{description}{mark}", row.name), width, 11)
            });
            (
                "Keys: arrows scroll, Esc closes",
                rows.skip(*from).map(Line::from).collect(),
            )
        }
        Overlay::Problems { lines, from } => {
            let rows = lines
                .iter()
                .skip(*from)
                .flat_map(|line| wrapped(line, width, 2));
            (
                "Program rejected: arrows scroll, Esc closes",
                rows.map(Line::from).collect(),
            )
        }
        Overlay::Confirm(confirm) => {
            let text = match confirm {
                Confirm::Home => {
                    "Home? The machine moves: it searches for the index pulses, then moves to the \
                     home pose."
                        .to_string()
                }
                Confirm::Tare => {
                    "Tare? The present force becomes zero: nothing may touch the tool.".to_string()
                }
                Confirm::Run(text) => format!("Run {text}? The machine moves."),
                Confirm::Quit(text) => format!("Quit? {text}."),
            };
            let mut rows: Vec<Line<'_>> = wrapped(&text, width, 0)
                .into_iter()
                .map(Line::from)
                .collect();
            rows.push(Line::styled(
                "Enter confirms, any other key cancels",
                marked,
            ));
            ("Confirm", rows)
        }
        Overlay::Prompt { title, text } => {
            // The end of a long name stays visible.
            let shows = width.saturating_sub(2);
            let hidden = text.chars().count().saturating_sub(shows);
            let tail: String = text.chars().skip(hidden).collect();
            (
                *title,
                vec![
                    Line::raw(format!("{tail}_")),
                    Line::styled("Enter checks it, Esc cancels, Ctrl-U clears", marked),
                ],
            )
        }
        Overlay::Axes { selected } => {
            let mut rows: Vec<Line<'_>> = view
                .static_info
                .pose
                .iter()
                .zip(&view.sources)
                .enumerate()
                .map(|(index, (axis, source))| {
                    let what = match source {
                        Source::Program => "program: follows the part program",
                        Source::Hold => "hold: keeps its position",
                        Source::Master => "master: follows the haptic arm or the remote master",
                        Source::Jog => "jog: follows the jog keys, also while a program runs",
                    };
                    let text = format!("{:<7}{what}", axis.name);
                    Line::styled(
                        text,
                        if index == *selected {
                            marked
                        } else {
                            Style::new()
                        },
                    )
                })
                .collect();
            rows.push(Line::raw(
                "arrows select; p program, h hold, j jog, m master; Esc closes",
            ));
            (
                "Axis sources: changes from and to jog need standstill",
                rows,
            )
        }
        Overlay::Force { selected } => {
            let Some(loops) = &view.loops else { return };
            let force = view.telemetry.as_ref().and_then(|now| now.force.as_ref());
            let mut rows: Vec<Line<'_>> = ["x", "y", "z"]
                .iter()
                .zip(loops)
                .enumerate()
                .map(|(index, (name, settings))| {
                    let is_controlled = force.is_some_and(|force| force.mask & (1 << index) != 0);
                    let per = |value: u32| f64::from(value) / PER_EFFORT;
                    let text = format!(
                        "{name} {}  setpoint {:.1} N  mass {:.2}  damping {:.2}",
                        if is_controlled { "on " } else { "off" },
                        f64::from(settings.desired) / PER_EFFORT,
                        per(settings.mass),
                        per(settings.damping)
                    );
                    Line::styled(
                        text,
                        if index == *selected {
                            marked
                        } else {
                            Style::new()
                        },
                    )
                })
                .collect();
            rows.push(Line::raw(
                "arrows select; Enter on/off; + - setpoint; Esc closes",
            ));
            ("Force control: mass in N s^2/mm, damping in N s/mm", rows)
        }
        Overlay::Master { position, typed } => {
            let Some(settings) = &view.master else {
                return;
            };
            let rows;
            (rows, focus) = master::overlay(view, settings, *position, typed, width);
            ("Master: forces, force feedback, virtual fixture", rows)
        }
    };
    let height = (rows.len() as u16 + 2).min(area.height);
    let widest = rows
        .iter()
        .map(Line::width)
        .chain([title.chars().count() + 2])
        .max()
        .unwrap_or(0);
    let width = (widest as u16 + 4).min(area.width);
    let place = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    let style = match view.overlay {
        Overlay::Confirm(_) => style_of(Severity::Warning),
        _ => Style::new(),
    };
    frame.render_widget(Clear, place);
    let block = Block::bordered().title(title).style(style);
    let inside = usize::from(place.height.saturating_sub(2)).max(1);
    let hidden = (focus + 1).saturating_sub(inside) as u16;
    frame.render_widget(Paragraph::new(rows).block(block).scroll((hidden, 0)), place);
}
