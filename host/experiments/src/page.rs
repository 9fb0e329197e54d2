//! Pages: one for each scenario with the curves of the thesis's figures, and an index.

use super::course::Sample;
use super::table::{band, value, verdict};
use super::{Cut, ForceSource, Pass, Result, Scenario, led_page, picture};
use haptimill_report::chart::{COLOURS, Chart, Line, escape};
use haptimill_report::html::STYLE;
use haptimill_report::series::Columns;
use std::fmt::Write as _;

const MORE_STYLE: &str = "\
th{text-align:left;padding:7px 14px;border-bottom:1px solid #d5dae0;font-weight:600;color:#3b4754;font-size:13px}
table.claims td{padding:6px 14px}table.claims td:first-child{color:#1d2733;width:auto}table.claims td:nth-child(2){min-width:5em}
td.n{white-space:nowrap}tr.out td{background:#fdf3e7}
.in{color:#00704a;font-weight:600}.outside{color:#b04a00;font-weight:600}.why{display:block;color:#5b6875;font-size:13px;max-width:720px}
.source{color:#7a8691;font-size:12px}h3{font-size:15px;margin:20px 0 8px;color:#3b4754}
a{color:#0060a0;text-decoration:none}a:hover{text-decoration:underline}
.depth{display:inline-block;width:120px;height:10px;margin:0 6px;vertical-align:middle;border:1px solid #b9c1ca}";

const GREY: &str = "#9aa5b1";
const WANTED: &str = "#b7c0ca";
const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Writing to a string cannot fail.
fn put(page: &mut String, what: std::fmt::Arguments<'_>) {
    let _ = page.write_fmt(what);
}

fn head(title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{0}</title><style>{STYLE}\n{MORE_STYLE}</style></head><body><main>",
        escape(title)
    )
}

/// The page of a scenario.
#[must_use]
pub fn page(scenario: &Scenario, cuts: &[Cut], result: &Result) -> String {
    let name = scenario.name.to_uppercase();
    let mut page = head(&format!("{name}: {}", scenario.title));
    put(
        &mut page,
        format_args!(
            "<p class=\"sub\" style=\"margin:0\"><a href=\"../index.html\">all scenarios</a></p><h1>{name}: {}</h1><p class=\"sub\">{} The thesis: {}.</p>",
            escape(scenario.title),
            escape(scenario.setting),
            escape(scenario.figures)
        ),
    );
    claims(&mut page, result);
    // One pass has these curves among its own.
    if scenario.needs_force_control() && cuts.len() > 1 {
        yielding(&mut page, scenario, cuts);
    }
    // Several surfaces stand side by side, each half as wide.
    let (open, close, room) = match cuts {
        [_] => ("<div>", "</div>", 1038.0),
        _ => ("<div class=\"pair\">", "</div>", 440.0),
    };
    page.push_str(open);
    let passes = || scenario.passes.iter().zip(cuts);
    for (pass, cut) in passes().filter(|(pass, _)| pass.cuts()) {
        let of = if pass.title.is_empty() {
            String::new()
        } else {
            format!(", {}", escape(pass.title))
        };
        page.push_str("<div>");
        surface(&mut page, cut, &of, room);
        page.push_str("</div>");
    }
    page.push_str(close);
    for (pass, cut) in passes() {
        led_page::curves(&mut page, pass, cut);
    }
    for (pass, cut) in passes().filter(|(pass, _)| pass.cuts()) {
        curves(&mut page, pass, cut);
    }
    files(&mut page, scenario, result);
    page.push_str("</main></body></html>\n");
    page
}

fn claims(page: &mut String, result: &Result) {
    put(
        page,
        format_args!(
            "<h2>What the thesis states, and what came out: {} of {} inside</h2><table class=\"claims\"><tr><th>what</th><th>stated</th><th>band</th><th>ours</th><th></th></tr>",
            result.inside(),
            result.claims.len()
        ),
    );
    for claim in &result.claims {
        let (row, class) = if claim.inside {
            ("", "in")
        } else {
            (" class=\"out\"", "outside")
        };
        let why = claim.reason.as_ref().map_or(String::new(), |why| {
            format!("<span class=\"why\">{}</span>", escape(why))
        });
        let band = band(&claim.band, claim.unit);
        let (band, source) = band.rsplit_once(" (").unwrap_or((&band, ""));
        put(
            page,
            format_args!(
                "<tr{row}><td>{}{why}</td><td>{}</td><td class=\"n\">{} <span class=\"source\">{}</span></td><td class=\"n\">{} {}</td><td class=\"n {class}\">{}</td></tr>",
                escape(&claim.what),
                stated(&claim.stated),
                escape(band),
                source.trim_end_matches(')'),
                value(claim.ours),
                claim.unit,
                verdict(claim).to_lowercase(),
            ),
        );
    }
    page.push_str("</table><p class=\"sub\" style=\"margin:8px 2px\">Bands: <i>stated</i> by the thesis itself; <i>derived</i> from its numbers; <i>own</i>: what this project asks of itself.</p>");
}

/// What the thesis says, or that it says nothing.
fn stated(text: &str) -> String {
    match text {
        "" => "<span class=\"source\">not stated</span>".to_string(),
        other => escape(other),
    }
}

pub(super) fn card(page: &mut String, note: &str, svg: &str) {
    put(
        page,
        format_args!("<div class=\"card\"><p>{note}</p>{svg}</div>"),
    );
}

/// The cut surface from above, with the desired path, in so many pixels of width.
fn surface(page: &mut String, cut: &Cut, of: &str, room: f64) {
    let Some(backdrop) = picture::surface(&cut.work) else {
        return;
    };
    let (wide, high) = (backdrop.x.1 - backdrop.x.0, backdrop.y.1 - backdrop.y.0);
    // As wide as there is room, or 720 pixels high; margins of a chart are 82 and 74 pixels.
    let scale = (room / wide).min(646.0 / high);
    let (width, height) = (scale * wide + 82.0, scale * high + 74.0);
    let desired = |samples: &[Sample]| thinned(samples, |s| (s.desired[0], s.desired[1]));
    let path = match &cut.hand {
        None => desired(&cut.course.way()),
        Some(_) => desired(shown(cut)),
    };
    let chart = Chart {
        x_label: "x, mm".into(),
        y_label: "y, mm".into(),
        lines: vec![Line {
            label: "desired path of the tip".into(),
            colour: COLOURS[1],
            width: 1.2,
            pieces: vec![path],
        }],
        width,
        height,
        equal: true,
        from_zero: false,
        backdrop: Some(backdrop),
    };
    let colour = |c: [f64; 3]| format!("rgb({},{},{})", c[0], c[1], c[2]);
    let note = format!(
        "Seen from above, light from the upper left. Depth below the uncut top: 0 <span class=\"depth\" style=\"background:linear-gradient(90deg,{},{})\"></span> {:.2} mm",
        colour(picture::TOP),
        colour(picture::DEEP),
        picture::deepest(&cut.work)
    );
    put(page, format_args!("<h2>The cut surface{of}</h2>"));
    let centred = format!(
        "<div style=\"max-width:{width:.0}px;margin:0 auto\">{}</div>",
        chart.svg()
    );
    card(page, &note, &centred);
}

/// Points of a path that are 0.02 mm apart.
fn thinned(samples: &[Sample], point: impl Fn(&Sample) -> (f64, f64)) -> Vec<(f64, f64)> {
    let mut points: Vec<(f64, f64)> = Vec::new();
    for sample in samples {
        let (x, y) = point(sample);
        let near = |last: &(f64, f64)| (last.0 - x).abs() + (last.1 - y).abs() < 0.02;
        if !points.last().is_some_and(near) {
            points.push((x, y));
        }
    }
    points
}

fn columns(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> Vec<Vec<(f64, f64)>> {
    let begin = samples.first().map_or(0.0, |sample| sample.time);
    let end = samples.last().map_or(1.0, |sample| sample.time);
    let mut columns = Columns::new(begin, end);
    for sample in samples {
        columns.add(sample.time, value(sample));
    }
    let mut pieces = columns.line();
    for point in pieces.iter_mut().flatten() {
        point.0 += begin;
    }
    pieces
}

fn line(
    label: impl Into<String>,
    colour: &'static str,
    width: f64,
    pieces: Vec<Vec<(f64, f64)>>,
) -> Line {
    Line {
        label: label.into(),
        colour,
        width,
        pieces,
    }
}

fn over_time(y_label: impl Into<String>, lines: Vec<Line>, height: f64, from_zero: bool) -> String {
    over(
        "time since the way began, s",
        y_label,
        lines,
        height,
        from_zero,
    )
}

pub(super) fn over(
    x_label: &str,
    y_label: impl Into<String>,
    lines: Vec<Line>,
    height: f64,
    from_zero: bool,
) -> String {
    Chart {
        x_label: x_label.into(),
        y_label: y_label.into(),
        lines,
        width: 1120.0,
        height,
        equal: false,
        from_zero,
        backdrop: None,
    }
    .svg()
}

/// What the curves show: from a second before the way until the tool is lifted.
fn shown(cut: &Cut) -> &[Sample] {
    let samples = &cut.course.samples;
    let first = samples.partition_point(|sample| sample.time < -1.0);
    let depth = cut.course.at(0.0).desired[2] + 0.5;
    let begun = samples.partition_point(|sample| sample.time < 0.0);
    let lifted = samples[begun..].partition_point(|sample| sample.desired[2] < depth);
    &samples[first..begun + lifted]
}

/// p_c and Fx of all passes together.
fn yielding(page: &mut String, scenario: &Scenario, cuts: &[Cut]) {
    let all = |value: &dyn Fn(&Sample) -> f64, to: f64| -> Vec<Line> {
        let pairs = scenario.passes.iter().zip(cuts).enumerate();
        pairs
            .map(|(index, (pass, cut))| {
                let samples = cut.course.between(0.0, to);
                let colour = COLOURS[index % COLOURS.len()];
                line(pass.title, colour, 1.4, columns(samples, value))
            })
            .collect()
    };
    page.push_str("<h2>Yielding</h2>");
    card(
        page,
        "By how much the tool yields along X (p_c); the thesis watched it to 15 s",
        &over_time("p_c in X, mm", all(&|s| s.yielded[0], 30.0), 320.0, true),
    );
    card(
        page,
        "High force along X",
        &over_time("Fx high, N", all(&|s| s.high[0], 15.0), 320.0, true),
    );
}

fn curves(page: &mut String, pass: &Pass, cut: &Cut) {
    let samples = shown(cut);
    let title = if pass.title.is_empty() {
        "Curves".to_string()
    } else {
        format!("Curves, {}", pass.title)
    };
    put(page, format_args!("<h2>{}</h2>", escape(&title)));
    let mut lines = Vec::new();
    for (axis, name) in AXES.iter().enumerate().take(2) {
        let desired = columns(samples, |s| s.desired[axis]);
        lines.push(line(format!("{name} desired"), WANTED, 4.0, desired));
        let tool = columns(samples, |s| s.tool[axis]);
        lines.push(line(
            format!("{name} of the tool"),
            COLOURS[axis],
            1.4,
            tool,
        ));
    }
    card(
        page,
        "Position of the tool in X and Y",
        &over_time("position, mm", lines, 290.0, false),
    );
    let source = match cut.course.source {
        ForceSource::Controller => "",
        ForceSource::TrueForce => {
            " (true force of the simulated cut over a revolution; this controller measures none)"
        }
    };
    for (axis, name) in AXES.iter().enumerate() {
        let lines = vec![
            line("low", GREY, 1.0, columns(samples, |s| s.low[axis])),
            line(
                "high",
                COLOURS[axis],
                1.3,
                columns(samples, |s| s.high[axis]),
            ),
        ];
        card(
            page,
            &format!("Force on the tool along {name}, high and low{source}"),
            &over_time(format!("F{}, N", name.to_lowercase()), lines, 250.0, true),
        );
    }
    page.push_str("<div class=\"pair\">");
    let error = |axis: usize| columns(samples, move |s| 1000.0 * (s.tool[axis] - s.desired[axis]));
    if pass.control.is_some() {
        let lines = (0..3)
            .map(|axis| {
                line(
                    AXES[axis],
                    COLOURS[axis],
                    1.4,
                    columns(samples, |s| s.yielded[axis]),
                )
            })
            .collect();
        let mut chart = half("p_c, mm", lines);
        chart.from_zero = true;
        card(page, "By how much the tool yields", &chart.svg());
    } else {
        let lines = (0..2)
            .map(|axis| line(AXES[axis], COLOURS[axis], 1.2, error(axis)))
            .collect();
        let mut chart = half("tool less desired, \u{b5}m", lines);
        chart.from_zero = true;
        card(
            page,
            "Error of the tool; the width of the bands is the ripple of the teeth",
            &chart.svg(),
        );
    }
    let chart = Chart {
        x_label: "x, mm".into(),
        y_label: "y, mm".into(),
        lines: vec![
            line(
                "desired",
                WANTED,
                4.0,
                vec![thinned(samples, |s| (s.desired[0], s.desired[1]))],
            ),
            line(
                "tool",
                COLOURS[0],
                1.4,
                vec![thinned(samples, |s| (s.tool[0], s.tool[1]))],
            ),
        ],
        equal: true,
        ..half("", Vec::new())
    };
    card(page, "Path seen from above", &chart.svg());
    page.push_str("</div>");
}

fn half(y_label: &str, lines: Vec<Line>) -> Chart {
    Chart {
        x_label: "time since the way began, s".into(),
        y_label: y_label.into(),
        lines,
        width: 560.0,
        height: 400.0,
        equal: false,
        from_zero: false,
        backdrop: None,
    }
}

fn files(page: &mut String, scenario: &Scenario, result: &Result) {
    page.push_str("<h2>Passes</h2><table class=\"claims\"><tr><th>pass</th><th>program, work</th><th>scale of the forces</th><th>force control in X</th><th>high and low forces</th><th>files</th></tr>");
    for (pass, done) in scenario.passes.iter().zip(&result.passes) {
        let control = pass.control.map_or("none".to_string(), |control| {
            format!(
                "f_d {} N, K_A {}, K_V {}",
                control.desired_n, control.mass, control.damping
            )
        });
        put(
            page,
            format_args!(
                "<tr><td class=\"n\">{0}</td><td>{1}, {2}</td><td>{3}</td><td class=\"n\">{control}</td><td>{4}</td><td class=\"n\"><a href=\"{0}/report.html\">report</a> <a href=\"{0}/trace.csv\">trace</a></td></tr>",
                pass.name,
                pass.program,
                done.work,
                pass.force_scale,
                done.forces.words(),
            ),
        );
    }
    page.push_str("</table>");
}

/// The index of all scenarios.
#[must_use]
pub fn index(machine: &str, results: &[Result]) -> String {
    let mut page = head("Scenarios");
    let (inside, all) = results.iter().fold((0, 0), |(inside, all), result| {
        (inside + result.inside(), all + result.claims.len())
    });
    put(
        &mut page,
        format_args!(
            "<h1>The thesis's experiments in the simulator</h1><p class=\"sub\">Machine: {}. {inside} of {all} numbers inside their bands. One plant for all; the forces on the incline (E3 to E5) are twice as large, as their page says.</p>",
            escape(machine)
        ),
    );
    page.push_str("<table class=\"claims\"><tr><th></th><th>scenario</th><th>inside</th><th>outside</th></tr>");
    for result in results {
        let name = result.scenario.to_uppercase();
        if let Some(why) = &result.not_run {
            put(
                &mut page,
                format_args!(
                    "<tr class=\"out\"><td>{name}</td><td>{}</td><td colspan=\"2\" class=\"outside\">not run: {}</td></tr>",
                    escape(result.title),
                    escape(why)
                ),
            );
            continue;
        }
        let outside: Vec<String> = result
            .claims
            .iter()
            .filter(|claim| !claim.inside)
            .map(|claim| {
                format!(
                    "{}: {} {}, band {}",
                    escape(&claim.what),
                    value(claim.ours),
                    claim.unit,
                    escape(&band(&claim.band, claim.unit))
                )
            })
            .collect();
        put(
            &mut page,
            format_args!(
                "<tr><td><a href=\"{0}/index.html\">{name}</a></td><td><a href=\"{0}/index.html\">{1}</a></td><td class=\"n\">{2} of {3}</td><td>{4}</td></tr>",
                result.scenario,
                escape(result.title),
                result.inside(),
                result.claims.len(),
                outside.join("<br>")
            ),
        );
    }
    page.push_str("</table></main></body></html>\n");
    page
}
