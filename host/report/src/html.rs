//! The report: one self-contained HTML page with pictures.

use super::chart::{COLOURS, Chart, Line, escape};
use super::contour::Point;
use super::pictures::Pictures;
use super::series::Columns;
use super::{Statistics, Summary, duration};
use haptimill_firmware::config::AxisKind;
use haptimill_trace::{Recording, RecordingError};
use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::PathBuf;

/// Style sheet of all pages.
pub const STYLE: &str = "\
body{font:15px/1.45 system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;color:#1d2733;background:#f5f6f8;margin:0}
main{max-width:1180px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:25px;margin:0 0 2px}h2{font-size:17px;margin:34px 0 8px}
.sub{color:#5b6875;margin:0 0 20px}
.tiles{display:grid;grid-template-columns:repeat(4,1fr);gap:12px}
.tile{background:#fff;border:1px solid #e0e4e9;border-radius:8px;padding:11px 14px}
.tile b{display:block;font-size:21px;font-weight:600;font-variant-numeric:tabular-nums}
.tile span{color:#5b6875;font-size:13px}
.tile.bad,.card.bad{background:#fdecea;border-color:#f1b5ae}
.card{background:#fff;border:1px solid #e0e4e9;border-radius:8px;padding:12px 12px 4px;margin:0 0 14px}
.card p{margin:0 4px 6px;color:#5b6875;font-size:13px}
.pair{display:grid;grid-template-columns:1fr 1fr;gap:14px}
@media(max-width:800px){.tiles{grid-template-columns:1fr 1fr}.pair{grid-template-columns:1fr}}
svg{display:block;width:100%;height:auto}
svg path{fill:none;stroke-linejoin:round;stroke-linecap:round}
svg text{font-size:12px;fill:#3b4754;font-family:inherit}svg .label{fill:#1d2733;font-size:12.5px}
.grid{stroke:#e8ebef;stroke-width:1}.grid.faint{stroke-opacity:.25}.frame{fill:none;stroke:#b9c1ca;stroke-width:1}
table{border-collapse:collapse;background:#fff;border:1px solid #e0e4e9;border-radius:8px;width:100%;font-variant-numeric:tabular-nums}
td{padding:6px 14px;border-bottom:1px solid #eef0f3;vertical-align:top}td:first-child{color:#5b6875;width:40%}
code{font-size:12px;overflow-wrap:anywhere}";

/// Writes the report of a recording. `statistics` are those of [`Summary::of`].
///
/// # Errors
/// The recording cannot be read, or the report not written.
pub fn write_html(
    recording: &Recording,
    summary: &Summary,
    statistics: &Statistics,
    out: &mut dyn Write,
) -> Result<(), RecordingError> {
    let mut pictures = Pictures::new(recording, statistics);
    for record in recording.iter()? {
        pictures.add(&record?);
    }
    pictures.finish();
    let page = page(recording, summary, statistics, &pictures);
    let io = |error: io::Error| RecordingError::Io(PathBuf::from("report"), error);
    out.write_all(page.as_bytes()).map_err(io)
}

/// A line of a chart over time.
fn line(label: impl Into<String>, colour: &'static str, width: f64, columns: &Columns) -> Line {
    Line {
        label: label.into(),
        colour,
        width,
        pieces: columns.line(),
    }
}

fn over_time(y_label: impl Into<String>, lines: Vec<Line>, from_zero: bool) -> String {
    let chart = Chart {
        x_label: "time, s".into(),
        y_label: y_label.into(),
        lines,
        width: 1120.0,
        height: 290.0,
        equal: false,
        from_zero,
        backdrop: None,
    };
    chart.svg()
}

fn page(
    recording: &Recording,
    summary: &Summary,
    statistics: &Statistics,
    pictures: &Pictures,
) -> String {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{0}</title><style>{STYLE}</style></head><body><main><h1>{0}</h1><p class=\"sub\">{1}, control period {2} us</p>",
        escape(&summary.program),
        escape(&summary.machine),
        recording.config().period_us
    );
    tiles(&mut page, summary);
    list(
        &mut page,
        "Spoilt in the simulator",
        "card",
        &summary.injected,
    );
    list(&mut page, "Faults", "card bad", &summary.faults);
    paths(&mut page, summary, statistics, pictures);
    time_charts(&mut page, recording, statistics, pictures);
    table(&mut page, summary);
    page.push_str("</main></body></html>\n");
    page
}

/// Writing to a string cannot fail.
fn put(page: &mut String, what: std::fmt::Arguments<'_>) {
    let _ = page.write_fmt(what);
}

/// A list under a heading; nothing if it is empty.
fn list(page: &mut String, heading: &str, class: &str, items: &[String]) {
    if items.is_empty() {
        return;
    }
    put(
        page,
        format_args!("<h2>{heading}</h2><div class=\"{class}\"><ul>"),
    );
    for item in items {
        put(page, format_args!("<li>{}</li>", escape(item)));
    }
    page.push_str("</ul></div>");
}

fn card(page: &mut String, note: &str, svg: &str) {
    put(
        page,
        format_args!("<div class=\"card\"><p>{}</p>{svg}</div>", escape(note)),
    );
}

fn tiles(page: &mut String, summary: &Summary) {
    let um = |mm: f64| format!("{:.1} \u{b5}m", mm * 1000.0);
    let well = summary.faults.is_empty() && summary.completed;
    let tiles = [
        ("duration", duration(summary.duration_s), true),
        (
            "path length",
            format!("{:.1} mm", summary.path_length_mm),
            true,
        ),
        ("tool error, rms", um(summary.tool_error_rms_mm), true),
        ("tool error, largest", um(summary.tool_error_max_mm), true),
        (
            "contour error, largest",
            um(summary.contour_error_max_mm),
            true,
        ),
        ("slide error, largest", um(summary.slide_error_max_mm), true),
        (
            "underruns",
            summary.underruns.to_string(),
            summary.underruns == 0,
        ),
        ("final state", summary.final_state.clone(), well),
    ];
    page.push_str("<div class=\"tiles\">");
    for (name, value, good) in tiles {
        let class = if good { "tile" } else { "tile bad" };
        put(
            page,
            format_args!(
                "<div class=\"{class}\"><b>{}</b><span>{name}</span></div>",
                escape(&value)
            ),
        );
    }
    page.push_str("</div>");
}

/// The path in one plane, wanted against done, and the same with its error magnified.
fn paths(page: &mut String, summary: &Summary, statistics: &Statistics, pictures: &Pictures) {
    let points = &pictures.path.points;
    if points.is_empty() {
        return;
    }
    page.push_str("<h2>Path of the tool in the work</h2>");
    let spans: Vec<f64> = statistics
        .programmed
        .iter()
        .take(3)
        .map(super::Extent::span)
        .collect();
    let extent = spans.iter().copied().fold(1e-3, f64::max);
    let magnified = round_down(0.06 * extent / summary.tool_error_max_mm.max(1e-6)).max(1.0);
    let names = ["x", "y", "z"];
    let mut planes = vec![(0, 1)];
    if spans[2] > 0.01 {
        planes.push((0, 2));
    }
    for (h, v) in planes {
        let commanded: Vec<_> = points.iter().map(|[p, _]| (p[h], p[v])).collect();
        let done = |factor: f64| {
            let shift = |p: &Point, t: &Point, i: usize| p[i] + factor * (t[i] - p[i]);
            let points = points.iter().map(|[p, t]| (shift(p, t, h), shift(p, t, v)));
            vec![points.collect::<Vec<_>>()]
        };
        // As high as the path needs at this width, so that a long slot is no thin line in an empty square.
        let height = (70.0 + 520.0 * spans[v] / spans[h].max(1e-3)).clamp(260.0, 500.0);
        let chart = |label: String, colour, factor| Chart {
            x_label: format!("{}, mm", names[h]),
            y_label: format!("{}, mm", names[v]),
            lines: vec![
                Line {
                    label: "programmed".into(),
                    colour: "#b7c0ca",
                    width: 4.0,
                    pieces: vec![commanded.clone()],
                },
                Line {
                    label,
                    colour,
                    width: 1.3,
                    pieces: done(factor),
                },
            ],
            width: 560.0,
            height,
            equal: true,
            from_zero: false,
            backdrop: None,
        };
        page.push_str("<div class=\"pair\">");
        let done = chart("done".into(), COLOURS[0], 1.0).svg();
        card(page, "Programmed and done, true to scale", &done);
        let label = format!("done, error x {magnified}");
        let chart = chart(label, COLOURS[1], magnified).svg();
        let note = format!(
            "The error against the programmed point of the same time, {magnified} times as large"
        );
        card(page, &note, &chart);
        page.push_str("</div>");
    }
}

/// 1, 2 or 5 times a power of ten, at most the value.
fn round_down(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    let steps = [5.0, 2.0, 1.0].into_iter().map(|factor| factor * power);
    steps
        .into_iter()
        .find(|step| *step <= value)
        .unwrap_or(power)
}

fn time_charts(
    page: &mut String,
    recording: &Recording,
    statistics: &Statistics,
    pictures: &Pictures,
) {
    let names = &recording.header().joints;
    let config = recording.config();
    let colour = |axis: usize| COLOURS[axis % COLOURS.len()];
    let joints_of = |kind: AxisKind| -> Vec<usize> {
        let joints = config.joints.iter().enumerate();
        joints
            .filter(|(_, joint)| joint.kind == kind)
            .map(|(axis, _)| axis)
            .collect()
    };
    let lines = |axes: &[usize], series: &[Columns]| -> Vec<Line> {
        let axes = axes.iter().filter(|axis| **axis < names.len());
        axes.map(|axis| line(&names[*axis], colour(*axis), 1.2, &series[*axis]))
            .collect()
    };
    let slides = joints_of(AxisKind::Linear);
    let tables = joints_of(AxisKind::Rotary);
    let tables_move = tables
        .iter()
        .any(|axis| pictures.joints[*axis].largest() > 0.01);

    page.push_str("<h2>Errors</h2>");
    let errors = vec![
        line("at the same time", COLOURS[1], 1.2, &pictures.tool_error),
        line(
            "from the path (contour)",
            COLOURS[0],
            1.2,
            &pictures.contour_error,
        ),
    ];
    let whose = if statistics.tool_is_true {
        "Where the tool really was, against the program"
    } else {
        "Where the controller measured the tool, against the program"
    };
    card(page, whose, &over_time("tool error, \u{b5}m", errors, true));
    let following = over_time(
        "following error, \u{b5}m",
        lines(&slides, &pictures.following),
        false,
    );
    card(
        page,
        "Wanted less measured position of the slides",
        &following,
    );

    page.push_str("<h2>Motion</h2>");
    let slides_chart = over_time(
        "way from the start, mm",
        lines(&slides, &pictures.joints),
        false,
    );
    card(
        page,
        "Measured position of the slides, from where they stood at the start of the job",
        &slides_chart,
    );
    if tables_move {
        let chart = over_time(
            "way from the start, deg",
            lines(&tables, &pictures.joints),
            false,
        );
        card(page, "Measured position of the rotary joints", &chart);
    }
    for (axis, [commanded, done]) in pictures.angles.iter().enumerate() {
        let rotary = config
            .pose
            .get(axis)
            .is_some_and(|axis| axis.kind == AxisKind::Rotary);
        if !rotary || statistics.programmed[axis].span() < 0.01 {
            continue;
        }
        let name = recording
            .header()
            .pose
            .get(axis)
            .cloned()
            .unwrap_or_default();
        let both = vec![
            line("programmed", "#b7c0ca", 4.0, commanded),
            line("done", COLOURS[0], 1.3, done),
        ];
        card(
            page,
            &format!("Rotary coordinate {name}"),
            &over_time(format!("{name}, deg"), both, false),
        );
    }
    let speeds = vec![
        line("programmed", "#b7c0ca", 4.0, &pictures.tip_speed[0]),
        line("done", COLOURS[0], 1.2, &pictures.tip_speed[1]),
    ];
    let over = if statistics.tool_is_true {
        "averaged over 5 ms"
    } else {
        "from one report of the controller to the next"
    };
    card(
        page,
        &format!("Speed of the tip in the work, {over}"),
        &over_time("speed, mm/s", speeds, true),
    );
    let speeds = over_time("speed, mm/s", lines(&slides, &pictures.joint_speed), false);
    card(page, &format!("Speed of the slides, {over}"), &speeds);

    page.push_str("<h2>Drive commands</h2>");
    let units = recording.drive_units();
    for unit in ["n", "n_m", "steps"] {
        let axes: Vec<usize> = (0..units.len())
            .filter(|axis| units[*axis].1 == unit)
            .collect();
        let at_work = axes
            .iter()
            .any(|axis| pictures.drives[*axis].largest() > 0.0);
        if axes.is_empty() || !at_work {
            continue;
        }
        let label = match unit {
            "n" => "force, N",
            "n_m" => "torque, N m",
            _ => "steps since enable",
        };
        card(
            page,
            "What the drives were asked for",
            &over_time(label, lines(&axes, &pictures.drives), true),
        );
    }
}

fn table(page: &mut String, summary: &Summary) {
    let place = match summary.tool_error_max_line {
        0 => format!("{:.3} s", summary.tool_error_max_time_s),
        line => format!("{:.3} s, line {line}", summary.tool_error_max_time_s),
    };
    let rows = [
        ("Duration", format!("{:.4} s", summary.duration_s)),
        (
            "Length of the path",
            format!("{:.3} mm", summary.path_length_mm),
        ),
        (
            "Tool error at the same time, rms / largest",
            format!(
                "{:.5} / {:.5} mm",
                summary.tool_error_rms_mm, summary.tool_error_max_mm
            ),
        ),
        ("Largest tool error at", place),
        (
            "Contour error, rms / largest",
            format!(
                "{:.5} / {:.5} mm",
                summary.contour_error_rms_mm, summary.contour_error_max_mm
            ),
        ),
        (
            "Error of the rotary coordinates, largest",
            format!("{:.5} deg", summary.angle_error_max_deg),
        ),
        (
            "Following error of the slides, largest",
            format!(
                "{:.5} mm ({})",
                summary.slide_error_max_mm, summary.slide_error_max_joint
            ),
        ),
        ("Setpoints", summary.setpoints.to_string()),
        ("Underruns", summary.underruns.to_string()),
        (
            "Bytes to the controller for each setpoint: messages / all",
            format!(
                "{:.1} / {:.1}",
                summary.bytes_per_setpoint, summary.line_bytes_per_setpoint
            ),
        ),
        ("Control periods recorded", summary.periods.to_string()),
        (
            "Final state",
            format!(
                "{}, position {}",
                summary.final_state,
                match summary.final_state.as_str() {
                    "Unknown" => "not known",
                    _ if summary.position_kept => "kept",
                    _ => "lost",
                }
            ),
        ),
        ("SHA-256 of the recording", summary.trace_sha256.clone()),
    ];
    page.push_str("<h2>Figures</h2><table>");
    for (name, value) in rows {
        let value = escape(&value);
        let value = if name.starts_with("SHA") {
            format!("<code>{value}</code>")
        } else {
            value
        };
        put(
            page,
            format_args!("<tr><td>{name}</td><td>{value}</td></tr>"),
        );
    }
    page.push_str("</table>");
}
