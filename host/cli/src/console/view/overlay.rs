//! What lies over the panels: questions, the table of keys, lists.

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
    // The row that has to be in sight where not all are.
    let mut focus = 0;
    let (title, rows): (&str, Vec<Line<'_>>) = match &view.overlay {
        Overlay::None => return,
        Overlay::Help { from } => {
            let rows = BINDINGS.iter().flat_map(|row| {
                let mark = if row.always_active { " (always)" } else { "" };
                wrapped(&format!("{:<11}{}{mark}", row.name, row.what), width, 11)
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
                "The program is refused: arrows scroll, Esc closes",
                rows.map(Line::from).collect(),
            )
        }
        Overlay::Confirm(confirm) => {
            let text = match confirm {
                Confirm::Home => {
                    "Home? The machine moves: it looks for its references, then goes to the home pose.".to_string()
                }
                Confirm::Tare => {
                    "Tare? What the force sensor shows now becomes zero: nothing may touch the tool.".to_string()
                }
                Confirm::Run(text) => format!("Run {text}? The machine moves."),
                Confirm::Quit(text) => format!("Quit? {text}."),
            };
            let mut rows: Vec<Line<'_>> = wrapped(&text, width, 0)
                .into_iter()
                .map(Line::from)
                .collect();
            rows.push(Line::styled(
                "Enter does it, any other key does not",
                marked,
            ));
            ("Sure?", rows)
        }
        Overlay::Prompt { title, text } => {
            // The end of a long name is what is being typed.
            let shows = width.saturating_sub(2);
            let hidden = text.chars().count().saturating_sub(shows);
            let tail: String = text.chars().skip(hidden).collect();
            (
                *title,
                vec![
                    Line::raw(format!("{tail}_")),
                    Line::styled("Enter checks it, Esc leaves, Ctrl-U clears", marked),
                ],
            )
        }
        Overlay::Axes { at } => {
            let mut rows: Vec<Line<'_>> = view
                .static_info
                .pose
                .iter()
                .zip(&view.sources)
                .enumerate()
                .map(|(index, (axis, source))| {
                    let what = match source {
                        Source::Program => "program: led by the part program",
                        Source::Hold => "hold: stays where it is",
                        Source::Master => "master: led by the haptic arm's hand",
                        Source::Jog => "jog: led by the jog keys, also beside a program",
                    };
                    let text = format!("{:<7}{what}", axis.name);
                    Line::styled(text, if index == *at { marked } else { Style::new() })
                })
                .collect();
            rows.push(Line::raw(
                "arrows choose; p program, h hold, j jog, m master; Esc closes",
            ));
            ("Axes: a jog begins and ends at rest", rows)
        }
        Overlay::Force { at } => {
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
                        "{name} {}  f_d {:.1} N  K_A {:.2}  K_V {:.2}",
                        if is_controlled { "yields" } else { "stiff " },
                        f64::from(settings.desired) / PER_EFFORT,
                        per(settings.mass),
                        per(settings.damping)
                    );
                    Line::styled(text, if index == *at { marked } else { Style::new() })
                })
                .collect();
            rows.push(Line::raw(
                "arrows choose; Enter yields or not; + - f_d; Esc closes",
            ));
            ("Force loop: above f_d the tool yields", rows)
        }
        Overlay::Master { at, typed } => {
            let Some(shown_hand) = &view.master else {
                return;
            };
            let rows;
            (rows, focus) = master::overlay(view, shown_hand, *at, typed, width);
            ("Hand: what it feels, and what it may", rows)
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
