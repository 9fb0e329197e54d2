//! Overlays: questions, key table, lists, master panel.

use super::panels::wrapped;
use super::{master, style_of};
use crate::console::keys::BINDINGS;
use crate::console::listing::{Kind, Picker};
use crate::console::view_model::{Axis, Confirm, Overlay, Severity, ViewModel};
use haptimill_machine_file::scale::PER_EFFORT;
use haptimill_protocol::force::{COMPONENT_NAMES, ForceLoop};
use haptimill_protocol::message::Source;
use haptimill_report::count;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Block, Clear, Paragraph};
use std::borrow::Cow;
use std::sync::atomic::Ordering;

/// Notices in the question before a run: with more of them its last row would not fit on a small
/// screen.
const SHOWN_NOTICES: usize = 4;

/// Rows of a folder that are shown at once.
const PICKER_ROWS: usize = 12;

/// Title, rows, and which of them are visible where not all fit.
type Content<'a> = (&'a str, Vec<Line<'a>>, Visible);

/// Which rows are visible.
#[derive(Clone, Copy)]
enum Visible {
    /// A part with this row.
    With(usize),
    /// The part from this row on, without empty rows below the last one.
    From(usize),
}

/// Draws the overlay, if there is one, in the middle of an area.
pub(super) fn draw(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) {
    let width = usize::from(area.width.saturating_sub(4)).clamp(1, 90);
    let Some((title, rows, visible)) = content(view, width) else {
        return;
    };
    let height = (rows.len() as u16 + 2).min(area.height);
    let widest = rows
        .iter()
        .map(Line::width)
        .chain([title.chars().count() + 2])
        .max()
        .unwrap_or(0);
    let width = (widest as u16 + 4).min(area.width);
    let frame_area = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    let style = match view.overlay {
        Overlay::Confirm(_) => style_of(Severity::Warning),
        _ => Style::new(),
    };
    frame.render_widget(Clear, frame_area);
    let block = Block::bordered().title(title).style(style);
    let inside = usize::from(frame_area.height.saturating_sub(2)).max(1);
    let last = rows.len().saturating_sub(inside);
    view.last_scroll.store(last, Ordering::Relaxed);
    let hidden = match visible {
        Visible::With(row) => (row + 1).saturating_sub(inside),
        Visible::From(row) => row.min(last),
    };
    let text = Paragraph::new(rows).block(block).scroll((hidden as u16, 0));
    frame.render_widget(text, frame_area);
}

/// Content of the overlay for a width; none without an overlay.
fn content(view: &ViewModel, width: usize) -> Option<Content<'_>> {
    let (title, rows) = match &view.overlay {
        Overlay::None => return None,
        Overlay::Help { from } => {
            let title = "Keys: arrows scroll, Esc closes";
            return Some((title, key_rows(view, width), Visible::From(*from)));
        }
        Overlay::Problems { lines, from } => {
            let title = "Program refused: arrows scroll, Esc closes";
            let rows = lines.iter().flat_map(|line| wrapped(line, width, 2));
            return Some((title, rows.map(Line::from).collect(), Visible::From(*from)));
        }
        Overlay::Confirm(confirm) => {
            let question = wrapped(&question(confirm, &view.static_info.joints), width, 0);
            let rows = question
                .into_iter()
                .chain(notice_rows(confirm, width))
                .map(Line::from);
            let help = highlighted("Enter confirms, any other key cancels");
            ("Confirm", rows.chain([help]).collect())
        }
        Overlay::Prompt { title, text } => {
            let help = highlighted("Enter sets it, Esc cancels, Ctrl-U clears");
            (*title, vec![typed_row(text, width), help])
        }
        Overlay::Programs(picker) => {
            let (rows, row) = picker_rows(picker, width);
            return Some(("Part program", rows, Visible::With(row)));
        }
        Overlay::Sources { selected } => (
            "Coordinate sources: changes from and to jog need standstill",
            list(
                source_rows(view),
                *selected,
                "arrows select; p program, h hold, j jog, m master; Esc closes",
            ),
        ),
        Overlay::Force { selected } => (
            "Force control: mass in N s^2/mm, damping in N s/mm",
            list(
                force_rows(view)?,
                *selected,
                "arrows select; Enter on/off; + - setpoint; Esc closes",
            ),
        ),
        Overlay::Master { position, typed } => {
            let title = "Master: forces, force feedback, virtual fixture";
            let settings = view.master.as_ref()?;
            let (rows, focus) = master::overlay(view, settings, *position, typed, width);
            return Some((title, rows, Visible::With(focus)));
        }
    };
    Some((title, rows, Visible::With(0)))
}

/// A row in reverse video.
fn highlighted<'a>(text: impl Into<Cow<'a, str>>) -> Line<'a> {
    Line::styled(text, Style::new().add_modifier(Modifier::REVERSED))
}

/// A text that is typed; the end of a long one stays visible.
fn typed_row(text: &str, width: usize) -> Line<'static> {
    Line::raw(format!("{}_", end_of(text, width.saturating_sub(2))))
}

/// The last letters of a text.
fn end_of(text: &str, width: usize) -> String {
    let hidden = text.chars().count().saturating_sub(width);
    text.chars().skip(hidden).collect()
}

/// The typed path, the folder with the rows around the selected one, and the key help; with the
/// row that stays visible.
fn picker_rows(picker: &Picker, width: usize) -> (Vec<Line<'static>>, usize) {
    let mut rows = vec![typed_row(&picker.text, width)];
    let mut visible = 0;
    let selected = picker
        .listing
        .as_ref()
        .and_then(|list| Some((list, list.entries.get(picker.selected?)?)));
    match &picker.listing {
        None => rows.push(Line::raw("the folder is read ...")),
        Some(list) => {
            let folder = list.folder.display().to_string();
            rows.push(Line::raw(end_of(&folder, width)));
            let problem = list.problem.iter().flat_map(|what| wrapped(what, width, 2));
            rows.extend(problem.map(Line::from));
            let row = picker.selected.unwrap_or(0);
            let first = row
                .saturating_sub(PICKER_ROWS / 2)
                .min(list.entries.len().saturating_sub(PICKER_ROWS));
            let shown = list
                .entries
                .iter()
                .enumerate()
                .skip(first)
                .take(PICKER_ROWS);
            for (index, entry) in shown {
                let text = match entry.kind {
                    Kind::Medium => format!(
                        " {} (mounted)",
                        end_of(&entry.name, width.saturating_sub(12))
                    ),
                    Kind::Up | Kind::Folder => {
                        format!(" {}/", end_of(&entry.name, width.saturating_sub(3)))
                    }
                    Kind::Program => format!(" {}", end_of(&entry.name, width.saturating_sub(2))),
                };
                if picker.selected == Some(index) {
                    visible = rows.len();
                    rows.push(highlighted(text));
                } else {
                    rows.push(Line::raw(text));
                }
            }
            if list.more > 0 {
                let more = count(list.more, "more row");
                rows.push(Line::raw(format!("{more}: type the path")));
            }
        }
    }
    let help = match selected {
        Some((_, entry)) if entry.kind == Kind::Program => {
            "Enter checks it, Backspace goes up, Esc cancels"
        }
        Some(_) => "Enter opens it, Backspace goes up, Esc cancels",
        None => "Enter checks it, Down selects, Esc cancels, Ctrl-U clears",
    };
    rows.push(highlighted(help));
    (rows, visible)
}

/// A list with a selected row, and the key help below it.
fn list(rows: Vec<String>, selected: usize, help: &'static str) -> Vec<Line<'static>> {
    let row = |(index, text)| {
        if index == selected {
            highlighted(text)
        } else {
            Line::raw(text)
        }
    };
    let rows = rows.into_iter().enumerate().map(row);
    rows.chain([Line::raw(help)]).collect()
}

/// The key table with the names of coordinates of the machine file.
fn key_rows(view: &ViewModel, width: usize) -> Vec<Line<'static>> {
    let pose = view.static_info.pose.iter();
    let axes: Vec<&str> = pose.map(|axis| axis.name.as_str()).collect();
    let rows = BINDINGS.iter().filter_map(|row| {
        let mark = if row.always_active { " (always)" } else { "" };
        Some(format!("{:<11}{}{mark}", row.name, row.describe(&axes)?))
    });
    let rows = rows.flat_map(|row| wrapped(&row, width, 11));
    rows.map(Line::from).collect()
}

fn question(confirm: &Confirm, joints: &[Axis]) -> String {
    match confirm {
        Confirm::Home => "Home? The machine moves: it searches its references, then moves to the \
                          home pose."
            .to_string(),
        Confirm::EnableAndHome => "Home? The drives are switched on, and the machine moves: it \
                                   searches its references, then moves to the home pose."
            .to_string(),
        Confirm::MoveOff(joint) => {
            let name = joints
                .get(*joint)
                .map_or("a joint", |joint| joint.name.as_str());
            format!(
                "Move {name} off its limit switch? It moves alone, slowly, away from the switch. \
                 Then home the machine."
            )
        }
        Confirm::Tare => {
            "Tare? The present force becomes zero: nothing may touch the tool.".to_string()
        }
        Confirm::Run(text, _) => format!("Run {text}? The machine moves."),
        Confirm::Quit(text) => format!("Quit? {text}."),
    }
}

/// The first notices of a program that is asked for; the messages have all of them.
fn notice_rows(confirm: &Confirm, width: usize) -> Vec<String> {
    let Confirm::Run(_, notices) = confirm else {
        return Vec::new();
    };
    let shown = notices.iter().take(SHOWN_NOTICES);
    let mut rows: Vec<String> = shown.flat_map(|notice| wrapped(notice, width, 2)).collect();
    if notices.len() > SHOWN_NOTICES {
        let more = count(notices.len() - SHOWN_NOTICES, "more notice");
        rows.push(format!("{more} in the messages"));
    }
    rows
}

/// One row per pose coordinate: its source.
fn source_rows(view: &ViewModel) -> Vec<String> {
    let axes = view.static_info.pose.iter().zip(&view.sources);
    axes.map(|(axis, source)| {
        let text = match source {
            Source::Program => "program: follows the part program",
            Source::Hold => "hold: keeps its position",
            Source::Master => "master: follows the haptic arm or the remote master",
            Source::Jog => "jog: follows the jog keys, also while a program runs",
        };
        format!("{:<7}{text}", axis.name)
    })
    .collect()
}

/// One row per force loop; none on a machine without a force sensor.
fn force_rows(view: &ViewModel) -> Option<Vec<String>> {
    let force = view.telemetry.as_ref().and_then(|now| now.force.as_ref());
    let mask = force.map_or(0, |force| force.mask);
    let loops = COMPONENT_NAMES.iter().zip(view.loops.as_ref()?).enumerate();
    let row = |(index, (name, settings)): (usize, (&&str, &ForceLoop))| {
        format!(
            "{name} {}  setpoint {:.1} N  mass {:.2}  damping {:.2}",
            if mask & (1 << index) != 0 {
                "on "
            } else {
                "off"
            },
            f64::from(settings.setpoint) / PER_EFFORT,
            f64::from(settings.mass) / PER_EFFORT,
            f64::from(settings.damping) / PER_EFFORT
        )
    };
    Some(loops.map(row).collect())
}
