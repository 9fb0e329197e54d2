//! Charts of the passes.

use crate::definition::{Experiment, Pass};
use crate::pass_data::PassData;
use crate::sampled_trace::{ForceSource, Sample};
use crate::surface_image;
use haptimill_client::session::HapticTraceSample;
use haptimill_report::chart::{COLOURS, Chart, Line};
use haptimill_report::markup::{card, escape, put};
use haptimill_report::series::Columns;

pub(super) const GREY: &str = "#9aa5b1";
/// Colour of the commanded position, and of the master where it is the reference.
const REFERENCE: &str = "#b7c0ca";
const AXES: [&str; 3] = ["X", "Y", "Z"];

const PROGRAM_TIME: &str = "time since the start of the path, s";
const OPERATOR_TIME: &str = "time since the start of teleoperation, s";

/// Label of the time of the measures of a pass.
pub(super) const fn time_label(is_teleoperated: bool) -> &'static str {
    if is_teleoperated {
        OPERATOR_TIME
    } else {
        PROGRAM_TIME
    }
}

/// Size of a chart as wide as the page, and of one half as wide.
const WIDTH: f64 = 1120.0;
pub(super) const HALF: (f64, f64) = (560.0, 400.0);

/// Margins of a chart, and its largest height without them, in pixels.
const MARGINS: (f64, f64) = (82.0, 74.0);
const SURFACE_HEIGHT: f64 = 646.0;

/// Spacing of the points of a drawn path, mm.
const PATH_SPACING: f64 = 0.02;

pub(super) fn line(
    label: impl Into<String>,
    colour: &'static str,
    width: f64,
    points: Points,
) -> Line {
    Line {
        label: label.into(),
        colour,
        width,
        pieces: points,
    }
}

type Points = Vec<Vec<(f64, f64)>>;

/// A quantity over time, thinned to the resolution of a chart.
fn over_time<T>(samples: &[T], time: fn(&T) -> f64, value: impl Fn(&T) -> f64) -> Points {
    let begin = samples.first().map_or(0.0, time);
    let end = samples.last().map_or(1.0, time);
    let mut columns = Columns::new(begin, end);
    for sample in samples {
        columns.add(time(sample), value(sample));
    }
    let mut pieces = columns.line();
    for point in pieces.iter_mut().flatten() {
        point.0 += begin;
    }
    pieces
}

fn of_trace(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> Points {
    over_time(samples, |sample| sample.time, value)
}

fn of_master(samples: &[HapticTraceSample], value: impl Fn(&HapticTraceSample) -> f64) -> Points {
    over_time(samples, |sample| sample.time, value)
}

pub(super) fn chart(
    x_label: &str,
    y_label: &str,
    lines: Vec<Line>,
    (width, height): (f64, f64),
) -> Chart {
    Chart {
        x_label: x_label.into(),
        y_label: y_label.into(),
        lines,
        width,
        height,
        equal: false,
        from_zero: true,
        backdrop: None,
    }
}

/// A path seen from above, with points [`PATH_SPACING`] apart.
fn thinned(samples: &[Sample], position: impl Fn(&Sample) -> [f64; 3]) -> Points {
    let mut points: Vec<(f64, f64)> = Vec::new();
    for sample in samples {
        let [x, y, _] = position(sample);
        let is_near = |last: &(f64, f64)| (last.0 - x).abs() + (last.1 - y).abs() < PATH_SPACING;
        if !points.last().is_some_and(is_near) {
            points.push((x, y));
        }
    }
    vec![points]
}

/// Samples from 1 s before the path until the tool is retracted.
fn drawn(data: &PassData) -> &[Sample] {
    let samples = &data.trace.samples;
    let first = samples.partition_point(|sample| sample.time < -1.0);
    let retracted = data.trace.at(0.0).commanded[2] + 0.5;
    let start = samples.partition_point(|sample| sample.time < 0.0);
    let length = samples[start..].partition_point(|sample| sample.commanded[2] < retracted);
    &samples[first..start + length]
}

/// The title of a section, with that of its pass if it has one.
fn heading(page: &mut String, text: &str, pass: &str) {
    let separator = if pass.is_empty() { "" } else { ", " };
    put(
        page,
        format_args!("<h2>{text}{separator}{}</h2>", escape(pass)),
    );
}

/// The cut surface from above, with the commanded path, in an image of this width.
pub(super) fn surface(page: &mut String, data: &PassData, pass: &str, width: f64) {
    let Some(backdrop) = surface_image::render(&data.stock) else {
        return;
    };
    let (x_mm, y_mm) = (backdrop.x.1 - backdrop.x.0, backdrop.y.1 - backdrop.y.0);
    let scale = (width / x_mm).min(SURFACE_HEIGHT / y_mm);
    let size = (scale * x_mm + MARGINS.0, scale * y_mm + MARGINS.1);
    let commanded = |sample: &Sample| sample.commanded;
    let path = match &data.teleoperation {
        None => thinned(&data.trace.cut_path(), commanded),
        Some(_) => thinned(drawn(data), commanded),
    };
    let lines = vec![line("commanded path of the tip", COLOURS[1], 1.2, path)];
    let image = Chart {
        equal: true,
        from_zero: false,
        backdrop: Some(backdrop),
        ..chart("x, mm", "y, mm", lines, size)
    };
    let colour = |c: [f64; 3]| format!("rgb({},{},{})", c[0], c[1], c[2]);
    let caption = format!(
        "Seen from above, light from the upper left. Depth below the uncut top: 0 \
         <span class=\"depth\" style=\"background:linear-gradient(90deg,{},{})\"></span> {:.2} mm",
        colour(surface_image::TOP),
        colour(surface_image::DEEP),
        surface_image::greatest_depth(&data.stock)
    );
    heading(page, "Cut surface", pass);
    let centred = format!(
        "<div style=\"max-width:{:.0}px;margin:0 auto\">{}</div>",
        size.0,
        image.svg()
    );
    card(page, &caption, &centred);
}

/// p_c and peak force along x of all passes.
pub(super) fn compliance(page: &mut String, experiment: &Experiment, data: &[PassData]) {
    let all = |value: &dyn Fn(&Sample) -> f64, to: f64| -> Vec<Line> {
        let passes = experiment.passes.iter().zip(data).zip(COLOURS);
        passes
            .map(|((pass, data), colour)| {
                let points = of_trace(data.trace.between(0.0, to), value);
                line(&pass.title, colour, 1.4, points)
            })
            .collect()
    };
    let size = (WIDTH, 320.0);
    page.push_str("<h2>Compliance</h2>");
    let lines = all(&|s| s.compliant_displacement[0], 30.0);
    card(
        page,
        "Compliant displacement p_c along X; the thesis shows it to 15 s",
        &chart(PROGRAM_TIME, "p_c in X, mm", lines, size).svg(),
    );
    let lines = all(&|s| s.peak_force[0], 15.0);
    card(
        page,
        "Peak force along X",
        &chart(PROGRAM_TIME, "peak Fx, N", lines, size).svg(),
    );
}

/// Master, tool and force feedback of a teleoperated pass; nothing for another pass.
pub(super) fn teleoperation(page: &mut String, pass: &Pass, data: &PassData) {
    let (Some(settings), Some(record)) = (&pass.teleoperation, &data.teleoperation) else {
        return;
    };
    let samples = &record.samples[..];
    heading(page, "Teleoperation", &pass.title);
    let mut axes: Vec<usize> = settings.axes.iter().map(|axis| axis.index()).collect();
    let moves_tool = !axes.is_empty();
    if axes.is_empty() {
        axes.push(0);
    }
    let mut lines = Vec::new();
    for &axis in &axes {
        let name = AXES[axis];
        let master = of_master(samples, |s| s.master[axis]);
        lines.push(line(
            format!("{name} of the master"),
            REFERENCE,
            4.0,
            master,
        ));
        if moves_tool {
            let tool = of_master(samples, |s| s.tool[axis]);
            lines.push(line(
                format!("{name} of the tool"),
                COLOURS[axis],
                1.4,
                tool,
            ));
        }
    }
    card(
        page,
        "Position of master and tool from the start of teleoperation",
        &chart(OPERATOR_TIME, "travel, mm", lines, (WIDTH, 290.0)).svg(),
    );
    let feedback = settings.feedback.axes();
    let has_fixture = settings.fixture_mm_s.is_some();
    let feedback = (0..3).filter(|axis| feedback[*axis].percent > 0 || has_fixture && *axis == 0);
    let along =
        |axis: usize, points| line(format!("along {}", AXES[axis]), COLOURS[axis], 1.4, points);
    let lines = feedback.map(|axis| along(axis, of_master(samples, |s| s.feedback[axis])));
    card(
        page,
        "Force of the haptic arm's motors on the handle",
        &chart(OPERATOR_TIME, "force, N", lines.collect(), (WIDTH, 250.0)).svg(),
    );
    let lines = axes
        .iter()
        .map(|&axis| along(axis, of_master(samples, |s| s.push[axis])));
    card(
        page,
        "Force of the operator on the handle, friction of the arm included",
        &chart(OPERATOR_TIME, "force, N", lines.collect(), (WIDTH, 220.0)).svg(),
    );
}

/// Position, forces, error and path of a pass.
pub(super) fn pass(page: &mut String, pass: &Pass, data: &PassData) {
    let samples = drawn(data);
    heading(page, "Curves", &pass.title);
    let mut lines = Vec::new();
    for (axis, name) in AXES.iter().enumerate().take(2) {
        let commanded = of_trace(samples, |s| s.commanded[axis]);
        lines.push(line(format!("{name} commanded"), REFERENCE, 4.0, commanded));
        let tool = of_trace(samples, |s| s.tool[axis]);
        lines.push(line(
            format!("{name} of the tool"),
            COLOURS[axis],
            1.4,
            tool,
        ));
    }
    let position = Chart {
        from_zero: false,
        ..chart(PROGRAM_TIME, "position, mm", lines, (WIDTH, 290.0))
    };
    card(page, "Position of the tool in X and Y", &position.svg());
    let source = match data.trace.source {
        ForceSource::Controller => String::new(),
        source @ ForceSource::TrueForce => format!(" ({})", source.description()),
    };
    for (axis, name) in AXES.iter().enumerate() {
        let low = of_trace(samples, |s| s.low_force[axis]);
        let peak = of_trace(samples, |s| s.peak_force[axis]);
        let lines = vec![
            line("low", GREY, 1.0, low),
            line("peak", COLOURS[axis], 1.3, peak),
        ];
        let label = format!("F{}, N", name.to_lowercase());
        card(
            page,
            &format!("Force on the tool along {name}, peak and low{source}"),
            &chart(PROGRAM_TIME, &label, lines, (WIDTH, 250.0)).svg(),
        );
    }
    page.push_str("<div class=\"pair\">");
    let coordinate = |axis: usize, width, points| line(AXES[axis], COLOURS[axis], width, points);
    if pass.force_control.is_some() {
        let displacement = |axis: usize| of_trace(samples, |s| s.compliant_displacement[axis]);
        let lines = (0..3).map(|axis| coordinate(axis, 1.4, displacement(axis)));
        card(
            page,
            "Compliant displacement",
            &chart(PROGRAM_TIME, "p_c, mm", lines.collect(), HALF).svg(),
        );
    } else {
        let error = |axis: usize| of_trace(samples, |s| 1000.0 * s.tool_error(axis));
        let lines = (0..2).map(|axis| coordinate(axis, 1.2, error(axis)));
        card(
            page,
            "Tool error; the width of the bands is the ripple at the tooth passing frequency",
            &chart(
                PROGRAM_TIME,
                "tool minus commanded, \u{b5}m",
                lines.collect(),
                HALF,
            )
            .svg(),
        );
    }
    let commanded = thinned(samples, |s| s.commanded);
    let lines = vec![
        line("commanded", REFERENCE, 4.0, commanded),
        line("tool", COLOURS[0], 1.4, thinned(samples, |s| s.tool)),
    ];
    let path = Chart {
        equal: true,
        from_zero: false,
        ..chart("x, mm", "y, mm", lines, HALF)
    };
    card(page, "Path seen from above", &path.svg());
    page.push_str("</div>");
}
