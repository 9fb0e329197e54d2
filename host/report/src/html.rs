//! Report of a job: one self-contained HTML page with charts.

use super::chart::{COLOURS, Chart, Line};
use super::chart_data::ChartData;
use super::contour::Point;
use super::markup::{self, escape, put};
use super::series::Columns;
use super::{Cut, Statistics, Summary, duration};
use haptimill_firmware::config::JointSettings;
use haptimill_trace::{Recording, RecordingError};
use std::io::{self, Write};
use std::path::PathBuf;

/// Largest width and height of the picture of a cut surface, and what its axes take.
const SURFACE: (f64, f64) = (900.0, 600.0);
const SURFACE_MARGINS: (f64, f64) = (90.0, 70.0);

/// Colour of the programmed values.
const REFERENCE: &str = "#b7c0ca";

/// Writes the report of a recording. `statistics` are those of [`Summary::of`]; `cut` is what
/// was cut from a simulated stock.
///
/// # Errors
/// The recording cannot be read, or the report not written.
pub fn write_html(
    recording: &Recording,
    summary: &Summary,
    statistics: &Statistics,
    cut: Option<&Cut>,
    out: &mut dyn Write,
) -> Result<(), RecordingError> {
    let mut data = ChartData::new(recording, statistics);
    for record in recording.iter()? {
        data.add(&record?);
    }
    data.finish();
    let page = page(recording, summary, statistics, cut, &data);
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
    cut: Option<&Cut>,
    data: &ChartData,
) -> String {
    let mut page = markup::head(&summary.program, "");
    put(
        &mut page,
        format_args!(
            "<h1>{}</h1><p class=\"sub\">{}, control period {} us</p>",
            escape(&summary.program),
            escape(&summary.machine),
            recording.config().period_us
        ),
    );
    tiles(&mut page, summary);
    list(&mut page, "Injected faults", "card", &summary.injected);
    list(&mut page, "Faults", "card bad", &summary.faults);
    paths(&mut page, summary, statistics, data);
    process(&mut page, recording, statistics, data);
    if let Some(cut) = cut {
        let tool = data.path.points.iter();
        cut_surface(
            &mut page,
            cut,
            tool.map(|[_, tool]| (tool[0], tool[1])).collect(),
        );
    }
    time_charts(&mut page, recording, summary, statistics, data);
    table(&mut page, summary);
    page.push_str(markup::END);
    page
}

/// Force, compliance and spindle; nothing where the job has none.
fn process(page: &mut String, recording: &Recording, statistics: &Statistics, data: &ChartData) {
    let names = ["x", "y", "z"];
    let three = |series: [&Columns; 3]| -> Vec<Line> {
        let all = names.iter().zip(series).zip(COLOURS);
        all.map(|((name, series), colour)| line(*name, colour, 1.2, series))
            .collect()
    };
    let has_force = statistics.force.max > 0.0;
    let has_spindle = data.spindle.largest() > 0.0;
    if !has_force && !has_spindle {
        return;
    }
    page.push_str("<h2>Force and spindle</h2>");
    if recording.config().force.is_some() && has_force {
        let sensor = three(data.force.each_ref().map(|[sensor, _]| sensor));
        let caption = "Peak force of the sensor in the last spindle revolution";
        card(page, caption, &over_time("force, N", sensor, false));
    }
    if statistics.tool_is_true && has_force {
        let actual = three(data.force.each_ref().map(|[_, actual]| actual));
        let caption = "Force on the simulated tool";
        card(page, caption, &over_time("force, N", actual, false));
    }
    if statistics.displacement.max > 0.0 {
        let displacement = three(data.displacement.each_ref());
        let caption = "Compliant displacement: displacement of the tool by the force";
        card(
            page,
            caption,
            &over_time("displacement, mm", displacement, false),
        );
    }
    if has_spindle {
        let spindle = vec![line("speed", COLOURS[0], 1.2, &data.spindle)];
        card(
            page,
            "Spindle",
            &over_time("spindle, rev/min", spindle, true),
        );
    }
}

/// Adds the cut surface from above to a page, with the path of the tool, mm; nothing where nothing
/// was cut.
pub fn cut_surface(page: &mut String, cut: &Cut, path: Vec<(f64, f64)>) {
    let Some(surface) = &cut.surface else { return };
    let (x_mm, y_mm) = (surface.x.1 - surface.x.0, surface.y.1 - surface.y.0);
    let scale = (SURFACE.0 / x_mm).min(SURFACE.1 / y_mm);
    let image = Chart {
        x_label: "x, mm".into(),
        y_label: "y, mm".into(),
        lines: vec![Line {
            label: "path of the tool".into(),
            colour: COLOURS[1],
            width: 1.0,
            pieces: vec![path],
        }],
        width: scale * x_mm + SURFACE_MARGINS.0,
        height: scale * y_mm + SURFACE_MARGINS.1,
        equal: true,
        from_zero: false,
        backdrop: Some(surface.clone()),
    };
    let caption = format!(
        "Seen from above, light from the upper left; blue is deep. {:.1} mm^3 removed, {:.2} mm \
         deep at most",
        cut.removed_mm3, cut.depth_mm
    );
    page.push_str("<h2>Cut surface</h2>");
    card(page, &caption, &image.svg());
}

/// A list under a heading; nothing when it is empty.
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

/// Appends a chart with a caption in plain text.
fn card(page: &mut String, caption: &str, svg: &str) {
    markup::card(page, &escape(caption), svg);
}

fn tiles(page: &mut String, summary: &Summary) {
    let um = |mm: f64| format!("{:.1} \u{b5}m", mm * 1000.0);
    let is_completed = summary.faults.is_empty() && summary.completed;
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
        ("following error, largest", summary.following_error(3), true),
        (
            "underruns",
            summary.underruns.to_string(),
            summary.underruns == 0,
        ),
        (
            "final state",
            summary.final_state_text.clone(),
            is_completed,
        ),
    ];
    let force = summary.process.tile(summary.tool_is_true);
    let force = force.map(|(name, value)| (name, value, true));
    page.push_str("<div class=\"tiles\">");
    for (name, value, good) in tiles.into_iter().chain(force) {
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

/// Programmed and actual path in each plane, true to scale and with the error magnified.
fn paths(page: &mut String, summary: &Summary, statistics: &Statistics, data: &ChartData) {
    let points = &data.path.points;
    if points.is_empty() {
        return;
    }
    page.push_str("<h2>Path of the tool in workpiece coordinates</h2>");
    let spans = data.tip.spans(&statistics.programmed);
    let extent = spans.iter().copied().fold(1e-3, f64::max);
    let magnified = round_down(0.06 * extent / summary.tool_error_max_mm.max(1e-6)).max(1.0);
    let names = data.tip.names;
    let (reference, caption) = if summary.is_compliant() {
        (
            "compliant path",
            "Compliant path (the programmed one, moved by the compliant displacement) and actual \
             path, true to scale",
        )
    } else {
        ("programmed", "Programmed and actual path, true to scale")
    };
    let mut planes = vec![(0, 1)];
    if spans[2] > 0.01 {
        planes.push((0, 2));
    }
    for (h, v) in planes {
        let commanded: Vec<_> = points.iter().map(|[p, _]| (p[h], p[v])).collect();
        let actual = |factor: f64| {
            let shift = |p: &Point, t: &Point, i: usize| p[i] + factor * (t[i] - p[i]);
            let points = points.iter().map(|[p, t]| (shift(p, t, h), shift(p, t, v)));
            vec![points.collect::<Vec<_>>()]
        };
        // The height follows the path, so that the chart of a long slot is not mostly empty.
        let height = (70.0 + 520.0 * spans[v] / spans[h].max(1e-3)).clamp(260.0, 500.0);
        let chart = |label: String, colour, factor| Chart {
            x_label: format!("{}, mm", names[h]),
            y_label: format!("{}, mm", names[v]),
            lines: vec![
                Line {
                    label: reference.into(),
                    colour: REFERENCE,
                    width: 4.0,
                    pieces: vec![commanded.clone()],
                },
                Line {
                    label,
                    colour,
                    width: 1.3,
                    pieces: actual(factor),
                },
            ],
            width: 560.0,
            height,
            equal: true,
            from_zero: false,
            backdrop: None,
        };
        page.push_str("<div class=\"pair\">");
        let actual = chart("actual".into(), COLOURS[0], 1.0).svg();
        card(page, caption, &actual);
        // An error of the size of the path is not magnified.
        if magnified > 1.0 {
            let label = format!("actual, error x {magnified}");
            let chart = chart(label, COLOURS[1], magnified).svg();
            let note = format!("Error at the same time, magnified {magnified} times");
            card(page, &note, &chart);
        }
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
    summary: &Summary,
    statistics: &Statistics,
    data: &ChartData,
) {
    let names = &recording.header().joints;
    let config = recording.config();
    let colour = |axis: usize| COLOURS[axis % COLOURS.len()];
    let joints_of = |rotary: bool| -> Vec<usize> {
        let joints = config.joints.iter().enumerate();
        joints
            .filter(|(_, joint)| joint.kind.is_rotary() == rotary)
            .map(|(axis, _)| axis)
            .collect()
    };
    let label = |axis: usize| {
        let open_loop = config
            .joints
            .get(axis)
            .is_some_and(JointSettings::is_open_loop);
        let note = if open_loop { " (open loop)" } else { "" };
        format!("{}{note}", names[axis])
    };
    let lines = |axes: &[usize], series: &[Columns]| -> Vec<Line> {
        let axes = axes.iter().filter(|axis| **axis < names.len());
        axes.map(|axis| line(label(*axis), colour(*axis), 1.2, &series[*axis]))
            .collect()
    };
    // Linear joints, and rotary ones if they move: name, axes, units of travel and of errors.
    let mut groups = vec![("linear joints", joints_of(false), ["mm", "\u{b5}m"])];
    let rotary = joints_of(true);
    if rotary
        .iter()
        .any(|axis| data.joints[*axis].largest() > 0.01)
    {
        groups.push(("rotary joints", rotary, ["deg", "deg/1000"]));
    }
    groups.retain(|(_, axes, _)| !axes.is_empty());

    page.push_str("<h2>Errors</h2>");
    let mut errors = vec![line("at the same time", COLOURS[1], 1.2, &data.tool_error)];
    if data.has_whole_path {
        let name = "from the path (contour)";
        errors.push(line(name, COLOURS[0], 1.2, &data.contour_error));
    }
    let position = if statistics.tool_is_true {
        "True position of the tool"
    } else {
        "Position of the tool measured by the controller,"
    };
    let against = match summary.is_compliant() {
        true => "the compliant path",
        false => "the program",
    };
    card(
        page,
        &format!("{position} against {against}"),
        &over_time("tool error, \u{b5}m", errors, true),
    );
    for (name, axes, [_, unit]) in &groups {
        let label = format!("following error, {unit}");
        let following = over_time(label, lines(axes, &data.following), false);
        let caption = format!("Commanded minus measured position of the {name}");
        card(page, &caption, &following);
    }

    page.push_str("<h2>Motion</h2>");
    for (name, axes, [unit, _]) in &groups {
        let label = format!("travel from the start, {unit}");
        let chart = over_time(label, lines(axes, &data.joints), false);
        let caption = format!("Measured position of the {name}, relative to the start of the job");
        card(page, &caption, &chart);
    }
    for (axis, [programmed, actual]) in data.angles.iter().enumerate() {
        let rotary = config
            .pose
            .get(axis)
            .is_some_and(|axis| axis.kind.is_rotary());
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
            line("programmed", REFERENCE, 4.0, programmed),
            line("actual", COLOURS[0], 1.3, actual),
        ];
        card(
            page,
            &format!("Rotary coordinate {name}"),
            &over_time(format!("{name}, deg"), both, false),
        );
    }
    let speeds = vec![
        line("programmed", REFERENCE, 4.0, &data.tip_speed[0]),
        line("actual", COLOURS[0], 1.2, &data.tip_speed[1]),
    ];
    let over = if statistics.tool_is_true {
        "averaged over 5 ms"
    } else {
        "between reports of the controller"
    };
    card(
        page,
        &format!("Speed of the tip in workpiece coordinates, {over}"),
        &over_time("speed, mm/s", speeds, true),
    );
    for (name, axes, [unit, _]) in &groups {
        let label = format!("speed, {unit}/s");
        let speeds = over_time(label, lines(axes, &data.joint_speed), false);
        card(page, &format!("Speed of the {name}, {over}"), &speeds);
    }

    page.push_str("<h2>Drive commands</h2>");
    let units = recording.drive_units();
    for unit in ["n", "n_m", "steps"] {
        let axes: Vec<usize> = (0..units.len())
            .filter(|axis| units[*axis].1 == unit)
            .collect();
        let has_output = axes.iter().any(|axis| data.drives[*axis].largest() > 0.0);
        if axes.is_empty() || !has_output {
            continue;
        }
        let label = match unit {
            "n" => "force, N",
            "n_m" => "torque, N m",
            _ => "steps since enable",
        };
        card(
            page,
            "Drive commands",
            &over_time(label, lines(&axes, &data.drives), true),
        );
    }
}

fn table(page: &mut String, summary: &Summary) {
    let location = match summary.tool_error_max_line {
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
            match summary.is_compliant() {
                true => "Tool error against the compliant path at the same time, rms / largest",
                false => "Tool error at the same time, rms / largest",
            },
            format!(
                "{:.5} / {:.5} mm",
                summary.tool_error_rms_mm, summary.tool_error_max_mm
            ),
        ),
        ("Largest tool error at", location),
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
            "Following error of the joints, largest",
            summary.following_error(5),
        ),
        (
            "Volumetric compensation",
            summary.volumetric_compensation.clone().unwrap_or_default(),
        ),
    ];
    let process = summary.process.rows(summary.tool_is_true);
    let rest = [
        ("Setpoints", summary.setpoints.to_string()),
        ("Underruns", summary.underruns.to_string()),
        (
            "Bytes to the controller per setpoint: messages / all",
            format!(
                "{:.1} / {:.1}",
                summary.bytes_per_setpoint, summary.line_bytes_per_setpoint
            ),
        ),
        ("Control periods recorded", summary.periods.to_string()),
        (
            "Recorded part; the figures are of all control periods",
            summary.recorded_part.clone().unwrap_or_default(),
        ),
        (
            "Final state",
            format!(
                "{}, position {}{}",
                summary.final_state_text,
                match summary.final_state.as_str() {
                    "Unknown" => "not known",
                    _ if summary.position_kept => "kept",
                    _ => "lost",
                },
                summary.counted()
            ),
        ),
        ("SHA-256 of the recording", summary.trace_sha256.clone()),
    ];
    page.push_str("<h2>Figures</h2><table>");
    let rows = rows.into_iter().chain(process).chain(rest);
    for (name, value) in rows.filter(|(_, value)| !value.is_empty()) {
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
