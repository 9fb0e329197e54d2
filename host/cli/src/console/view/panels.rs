//! Panels: position, joints, force, jog, program, messages, link.

use super::bars::{around_zero, from_left, percent};
use super::{STALE_MS, master, style_of};
use crate::commands::status::path_speed;
use crate::console::jogging::Mode;
use crate::console::view_model::{Axis, LinkState, LogEntry, Overlay, Severity, ViewModel};
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, per_unit};
use haptimill_protocol::force::COMPONENT_NAMES;
use haptimill_protocol::message::{AxisValues, Source, State};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::Paragraph;
use std::time::Duration;

/// Rows of the right column: force 6, jog 4, program 4.
const RIGHT_ROWS: u16 = 14;

/// Rows of feed, spindle and program text.
pub(super) const FEED_ROWS: u16 = 2;

/// Height from which the master panel takes no row from other panels.
const TALL: u16 = 24 + master::PANEL_ROWS;

/// Rows of the right column at a terminal height.
pub(super) fn right_rows(view: &ViewModel, height: u16) -> u16 {
    if height >= TALL && master::reported(view).is_some() {
        RIGHT_ROWS + master::PANEL_ROWS
    } else {
        RIGHT_ROWS
    }
}

/// Converter code at full scale.
const FULL_CODE: f64 = 8191.0;

/// Time as hours, minutes, seconds.
pub(super) fn clock(time: Duration) -> String {
    let seconds = time.as_secs();
    format!(
        "{}:{:02}:{:02}",
        seconds / 3600,
        seconds / 60 % 60,
        seconds % 60
    )
}

pub(super) fn heading(text: &str, width: u16) -> Line<'static> {
    let text = format!("── {text} ");
    let rest = usize::from(width).saturating_sub(text.chars().count());
    Line::styled(
        text + &"─".repeat(rest),
        Style::new().fg(Color::Cyan).add_modifier(Modifier::DIM),
    )
}

/// The mark of a position that is not certain: the machine is not homed, or lost its position.
fn reference_mark(view: &ViewModel) -> char {
    match &view.telemetry {
        Some(telemetry) if !telemetry.homed => '?',
        _ => ' ',
    }
}

/// Value in mm or degrees, right-aligned; a dash where it is unknown.
fn value(
    view: &ViewModel,
    axes: &[Axis],
    values: Option<&AxisValues>,
    index: usize,
    width: usize,
) -> String {
    let known = values.and_then(|values| values.get(index));
    match (known, axes.get(index)) {
        (Some(value), Some(axis)) => {
            let value = view.unwound(axis, *value) as f64 / per_unit(axis.kind);
            // No minus sign before a displayed zero.
            let value = if value.abs() < 5e-5 { 0.0 } else { value };
            format!("{value:>width$.4}")
        }
        _ => format!("{:>width$}", "-"),
    }
}

/// Style of telemetry: dim when it is old.
fn fresh(view: &ViewModel) -> Style {
    if view.link_state == LinkState::Ready && view.age.as_millis() <= STALE_MS {
        Style::new()
    } else {
        Style::new().add_modifier(Modifier::DIM)
    }
}

/// One row per pose coordinate.
pub(super) fn pose_rows(frame: &mut Frame<'_>, area: Rect, view: &ViewModel, is_wide: bool) {
    let telemetry = view.telemetry.as_ref();
    // With the drives off there is no commanded pose.
    let pose = telemetry
        .filter(|t| !matches!(t.state, State::Disabled | State::EmergencyStop))
        .map(|t| &t.commanded);
    let (name, number) = if is_wide { (7, 11) } else { (6, 10) };
    let mark = reference_mark(view);
    let rows: Vec<Line<'_>> = view
        .static_info
        .pose
        .iter()
        .enumerate()
        .map(|(index, axis)| {
            let commanded = value(view, &view.static_info.pose, pose, index, number);
            let actual = value(
                view,
                &view.static_info.pose,
                telemetry.map(|t| &t.measured),
                index,
                number,
            );
            let source = view.sources.get(index).copied().unwrap_or_default();
            let (what, style) = match view.jog.held[index] {
                Some((up, left)) => (
                    format!("{} {left} ms", if up { "+" } else { "-" }),
                    Style::new().fg(Color::Black).bg(Color::Cyan),
                ),
                None if source == Source::Program => (source.to_string(), Style::new()),
                None => (source.to_string(), style_of(Severity::Warning)),
            };
            Line::from(vec![
                Span::styled(
                    format!(" {:<name$}{commanded}{mark}{actual}{mark} ", axis.name),
                    fresh(view),
                ),
                Span::styled(what, style),
            ])
        })
        .collect();
    frame.render_widget(Paragraph::new(rows), area);
}

/// Position and joints.
pub(super) fn left(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) {
    let part = |from: u16, rows: u16| Rect {
        y: area.y + from.min(area.height),
        height: rows.min(area.height.saturating_sub(from)),
        ..area
    };
    let pose = view.static_info.pose.len() as u16;
    let mark = reference_mark(view);
    let title = match mark {
        ' ' => "Position commanded ─ measured ─ mm, deg",
        _ => "Position ─ mm, deg ─ ? not referenced",
    };
    let title = heading(title, area.width);
    frame.render_widget(Paragraph::new(title), part(0, 1));
    pose_rows(frame, part(1, pose), view, true);
    let telemetry = view.telemetry.as_ref();
    let mut rows = vec![heading(
        "Joints ─ mm, deg ── error um, mdeg ─ motor",
        area.width,
    )];
    let bar = usize::from(area.width).saturating_sub(35).clamp(6, 30);
    for (index, axis) in view.static_info.joints.iter().enumerate() {
        let place = value(
            view,
            &view.static_info.joints,
            telemetry.map(|t| &t.joints),
            index,
            11,
        );
        let error =
            telemetry
                .and_then(|t| t.following_error.get(index))
                .map_or("-".to_string(), |error| {
                    // um, or thousandths of a degree.
                    format!("{:.1}", f64::from(*error) / per_unit(axis.kind) * 1000.0)
                });
        let motor = match telemetry.and_then(|t| t.drive.get(index)) {
            Some(code) if view.static_info.analogue.get(index) == Some(&true) => {
                let part = f64::from(*code) / FULL_CODE;
                format!("{} {:>4} %", around_zero(part, part, bar), percent(part))
            }
            Some(steps) if telemetry.is_some_and(|t| t.open_loop >> index & 1 != 0) => {
                format!("{steps} steps, open loop")
            }
            Some(steps) => format!("{steps} steps"),
            None => "-".to_string(),
        };
        rows.push(Line::styled(
            format!(" {:<6}{place}{mark}{error:>7} {motor}", axis.name),
            fresh(view),
        ));
    }
    rows.extend(feed_rows(view, area.width));
    let count = rows.len() as u16;
    frame.render_widget(Paragraph::new(rows), part(1 + pose, count));
}

/// Feed, spindle speed, and the line of the program that is being executed.
fn feed_rows(view: &ViewModel, width: u16) -> [Line<'static>; FEED_ROWS as usize] {
    let telemetry = view.telemetry.as_ref();
    let is_driven = telemetry.is_some_and(|t| !t.state.has_drives_off());
    let feed = match view.motion.filter(|_| is_driven) {
        Some(motion) => format!("{:.0}", motion.feed_mm_min),
        None => "-".to_string(),
    };
    let running = view.program.as_ref().filter(|program| program.is_running);
    let spindle = match running.and_then(|program| program.spindle_rpm) {
        Some(speed) => speed.to_string(),
        None => "-".to_string(),
    };
    let title = format!("Feed {feed} mm/min ─ spindle {spindle} rev/min");
    let text = match running {
        Some(program) => format!(" {} {}", program.line, program.text),
        None => String::new(),
    };
    [heading(&title, width), Line::raw(text)]
}

/// Force, master where it fits, jog, program.
pub(super) fn right(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) {
    let fits = area.height >= RIGHT_ROWS + master::PANEL_ROWS;
    let panel = master::panel(view, area.width).filter(|_| fits);
    let mut rows = force_rows(view, area.width, panel.is_none());
    rows.extend(panel.into_iter().flatten());
    rows.push(heading("Jog", area.width));
    rows.extend(jog_rows(view));
    rows.push(heading("Program", area.width));
    rows.extend(program_rows(view, area.width));
    frame.render_widget(Paragraph::new(rows), area);
}

/// Force on the tool; with the operator force unless the master has its own panel.
fn force_rows(view: &ViewModel, width: u16, with_master: bool) -> Vec<Line<'static>> {
    let telemetry = view.telemetry.as_ref();
    let master_force = master::reported(view).filter(|_| with_master);
    let master_force = master_force
        .map(|(arm, report)| (master::fresh(view, arm), report.force.map(master::newtons)));
    let Some(loops) = &view.loops else {
        let none = " this machine has no force sensor";
        let mut rows = vec![heading("Force", width), Line::raw(none)];
        if let Some((style, [x, y, z])) = master_force {
            let size = (x * x + y * y + z * z).sqrt();
            let bar = from_left(size / master::SCALE_N, 6);
            rows.push(Line::styled(
                format!(" master{x:>6.2}{y:>6.2}{z:>6.2} N {bar}"),
                style,
            ));
        }
        rows.resize(6, Line::default());
        return rows;
    };
    let scale = view.force_scale_n;
    let title = if master_force.is_some() {
        format!("Force high low master ─ +-{scale} N")
    } else {
        format!("Force ─ high ── low ─ +-{scale} N")
    };
    let mut rows = vec![heading(&title, width)];
    let force = telemetry.and_then(|t| t.force.as_ref());
    let bar = usize::from(width).saturating_sub(21).clamp(6, 40);
    for (index, name) in COMPONENT_NAMES.iter().enumerate() {
        let text = match (force, &master_force) {
            (Some(force), master_force) => {
                let high = f64::from(force.high[index]) / PER_EFFORT;
                let low = f64::from(force.low[index]) / PER_EFFORT;
                let (from, to) = (high.min(low) / scale, high.max(low) / scale);
                match master_force {
                    Some((_, master_force)) => format!(
                        " {name}{high:>7.2}{low:>7.2}{:>6.2} {}",
                        master_force[index],
                        around_zero(from, to, bar.saturating_sub(4).max(5))
                    ),
                    None => format!(
                        " {name}{high:>8.2}{low:>8.2} {}",
                        around_zero(from, to, bar)
                    ),
                }
            }
            (None, Some((_, master_force))) => {
                format!(" {name}{:>7}{:>7}{:>6.2}", "-", "-", master_force[index])
            }
            (None, None) => format!(" {name}{:>8}{:>8}", "-", "-"),
        };
        rows.push(Line::styled(text, fresh(view)));
    }
    let Some(force) = force else {
        rows.resize(6, Line::default());
        return rows;
    };
    let mut spans = vec![Span::raw(" control")];
    for (index, name) in COMPONENT_NAMES.iter().enumerate() {
        let is_controlled = force.mask & (1 << index) != 0;
        let setpoint = f64::from(loops[index].setpoint) / PER_EFFORT;
        let style = if is_controlled {
            Style::new().fg(Color::Black).bg(Color::Green)
        } else {
            Style::new().add_modifier(Modifier::DIM)
        };
        let text = if is_controlled {
            format!("{name}>{setpoint:.1}N")
        } else {
            format!("{name} off")
        };
        spans.push(Span::raw(" "));
        spans.push(Span::styled(text, style));
    }
    spans.push(Span::raw(if force.tared { " tared" } else { " untared" }));
    rows.push(Line::from(spans));
    let last = match &force.problem {
        Some(problem) => Line::styled(format!(" {problem}"), style_of(Severity::Warning)),
        None => {
            let mm = force.displacement.map(|value| f64::from(value) / PER_MM);
            Line::raw(format!(
                " displ{:>7.3}{:>7.3}{:>7.3} mm",
                mm[0], mm[1], mm[2]
            ))
        }
    };
    rows.push(last);
    rows
}

fn jog_setting(view: &ViewModel) -> String {
    let jog = &view.jog;
    match jog.mode {
        Mode::Continuous => format!("continuous {} mm/s, deg/s", jog.rate),
        Mode::Step => format!("step {} mm, deg at {} mm/s", jog.step, jog.rate),
    }
}

fn jog_rows(view: &ViewModel) -> Vec<Line<'static>> {
    let jog = &view.jog;
    let held = jog.held.iter().any(Option::is_some);
    let style = if held {
        Style::new().fg(Color::Black).bg(Color::Cyan)
    } else {
        Style::new().add_modifier(Modifier::BOLD)
    };
    let ends = match (jog.mode, jog.has_release_events) {
        (Mode::Step, _) => " one step per press; Space stops".to_string(),
        (Mode::Continuous, true) => {
            format!(" ends on release or after {} ms", jog.jog_timeout_ms)
        }
        (Mode::Continuous, false) => {
            format!(" ends {} ms after the last key", jog.jog_timeout_ms)
        }
    };
    let name = |index: usize| {
        view.static_info
            .pose
            .get(index)
            .map_or("", |axis| &axis.name)
    };
    let others: String = [",.", "nm"]
        .iter()
        .zip(view.static_info.pose.iter().skip(3))
        .map(|(keys, axis)| format!("  {keys} {}", axis.name))
        .collect();
    let keys = format!(
        " arrows {} {}  PgUp/Dn {}{others}",
        name(0),
        name(1),
        name(2)
    );
    vec![
        Line::from(vec![Span::raw(" "), Span::styled(jog_setting(view), style)]),
        Line::raw(ends),
        Line::raw(keys),
    ]
}

/// Jog, override and program in one row, for small terminals.
pub(super) fn jog_line(view: &ViewModel) -> Paragraph<'static> {
    let what = match view.jog.mode {
        Mode::Continuous => format!("{} mm/s", view.jog.rate),
        Mode::Step => format!("step {}", view.jog.step),
    };
    let program = match &view.program {
        Some(program) if program.is_running => {
            format!("{:.0} % L{}", 100.0 * done(view), program.line)
        }
        _ => format!("timeout {} ms", view.jog.jog_timeout_ms),
    };
    Paragraph::new(format!(
        " jog {what}  feed {} %  {program}",
        view.overrides[0]
    ))
}

/// Completed part of the program, 0 to 1.
fn done(view: &ViewModel) -> f64 {
    match (&view.program, &view.telemetry) {
        (Some(program), Some(telemetry)) if program.is_running && program.duration_s > 0.0 => {
            f64::from(telemetry.program_periods) * view.static_info.period_s / program.duration_s
        }
        _ => 0.0,
    }
}

fn program_rows(view: &ViewModel, width: u16) -> Vec<Line<'static>> {
    let rate = view
        .telemetry
        .as_ref()
        .filter(|_| view.motion.is_some_and(|motion| motion.is_moving))
        .map_or(0.0, |telemetry| path_speed(telemetry) * 100.0);
    let [feed, rapid, spindle] = view.overrides;
    let feed = Line::raw(if (rapid, spindle) == (100, 100) {
        format!(" override {feed} %  path speed {rate:.0} %")
    } else {
        format!(" override {feed}/{rapid}/{spindle} %  path speed {rate:.0} %")
    });
    let Some(program) = &view.program else {
        let name = match &view.selected_name {
            Some(name) => format!(" {name}; p checks it"),
            None => " none; p selects one".to_string(),
        };
        return vec![Line::raw(name), Line::default(), feed];
    };
    let part = done(view).clamp(0.0, 1.0);
    let (first, second) = if program.is_running {
        let bar = usize::from(width).saturating_sub(17).clamp(5, 40);
        (
            format!(" {}  line {}/{}", program.name, program.line, program.lines),
            format!(
                " {} {:>3.0} % {:>7}",
                from_left(part, bar),
                part * 100.0,
                clock(Duration::from_secs_f64(program.left_s.clamp(0.0, 1e9)))
            ),
        )
    } else {
        (
            format!(" {}", program.name),
            format!(" {} lines, {:.0} s", program.lines, program.left_s),
        )
    };
    vec![Line::raw(first), Line::raw(second), feed]
}

/// Latest messages under a heading.
pub(super) fn messages(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) {
    let title = Rect { height: 1, ..area };
    frame.render_widget(Paragraph::new(heading("Messages", area.width)), title);
    let rows = Rect {
        y: area.y + 1,
        height: area.height.saturating_sub(1),
        ..area
    };
    message_rows(frame, rows, view);
}

/// Latest messages, the newest at the bottom. Long messages take several rows.
pub(super) fn message_rows(frame: &mut Frame<'_>, area: Rect, view: &ViewModel) {
    let width = usize::from(area.width).max(12);
    let mut rows: Vec<Line<'_>> = Vec::new();
    // The overlay of the master has the newest message itself.
    let hidden = usize::from(matches!(view.overlay, Overlay::Master { .. }));
    let count = usize::from(area.height) + hidden;
    let entries: Vec<&LogEntry> = view.log.newest(count).collect();
    let shown = entries.len().saturating_sub(hidden);
    for entry in &entries[..shown] {
        let style = match entry.severity {
            Severity::Info => Style::new(),
            Severity::Warning => Style::new().fg(Color::Yellow),
            Severity::Alarm => Style::new().fg(Color::Red).add_modifier(Modifier::BOLD),
        };
        let times = match entry.times {
            1 => String::new(),
            times => format!(" ({times} times)"),
        };
        let text = format!(" {} {}{times}", clock(entry.at), entry.text);
        for row in wrapped(&text, width, 9) {
            rows.push(Line::styled(row, style));
        }
    }
    let surplus = rows.len().saturating_sub(usize::from(area.height));
    frame.render_widget(Paragraph::new(rows.split_off(surplus)), area);
}

/// Breaks a text at spaces and indents all rows but the first.
pub(super) fn wrapped(text: &str, width: usize, indent: usize) -> Vec<String> {
    let mut rows = vec![String::new()];
    for word in text.split_inclusive(' ') {
        let used = rows.last().map_or(0, |row| row.chars().count());
        if used > indent && used + word.trim_end().chars().count() > width {
            rows.push(" ".repeat(indent));
        }
        if let Some(row) = rows.last_mut() {
            row.push_str(word);
        }
    }
    rows
}

/// State of the link to the controller.
pub(super) fn link_line(view: &ViewModel) -> Paragraph<'static> {
    let counters = &view.counters;
    let (bad, lost) = view.telemetry.as_ref().map_or((0, 0), |telemetry| {
        (telemetry.bad_frames, telemetry.lost_bytes)
    });
    let age = if view.telemetry.is_some() {
        format!("report {} ms old", view.age.as_millis().min(99_999))
    } else {
        "no report".to_string()
    };
    Paragraph::new(Line::styled(
        format!(
            " link {:.1} ms  bad frames {bad}+{}  lost {lost}  resent {}  reconnects {}  {age}",
            f64::from(counters.round_trip_us) / 1000.0,
            counters.bad_frames,
            counters.resent,
            counters.reconnects
        ),
        Style::new().add_modifier(Modifier::DIM),
    ))
}
