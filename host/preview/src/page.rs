//! The page.

use super::trace::{Point, Trace};
use super::{Joint, Preview};
use haptimill_planner::{Figures, MachineModel};
use haptimill_report::chart::{Chart, Line};
use haptimill_report::duration;
use haptimill_report::markup::{self, escape, put};
use haptimill_viewer::{Layer, Map, Scale, Scene, Shape};

/// Colours of motion at feed and of rapid moves.
const CUT: &str = "#0072b2";
const RAPID: &str = "#b0b7bf";
/// Most stops and commands in the table.
const LISTED_EVENTS: usize = 200;
/// Parts of the time in the chart; the chart has the extremes of each.
const CHART_PARTS: usize = 800;

pub(super) fn page<M: MachineModel>(
    preview: &Preview<M>,
    program: &str,
    machine: &str,
    figures: &Figures,
) -> String {
    let mut body = String::new();
    put(
        &mut body,
        format_args!(
            "<h1>{}</h1><p class=\"sub\">{}</p>",
            escape(program),
            escape(machine)
        ),
    );
    let rapid_s: f64 = time_of(&preview.rapid);
    let tiles = [
        ("duration, without pauses", duration(figures.duration_s)),
        ("of it rapid moves", duration(rapid_s)),
        ("path length", format!("{:.1} mm", figures.path_length_mm)),
        ("moves", figures.blocks.to_string()),
    ];
    body.push_str("<div class=\"tiles\">");
    for (name, value) in tiles {
        put(
            &mut body,
            format_args!("<div class=\"tile\"><b>{value}</b><span>{name}</span></div>"),
        );
    }
    body.push_str("</div><h2>Path of the tool tip in the workpiece</h2>");
    body.push_str(&scene(preview).fragment());
    body.push_str("<h2>Speed of the tip</h2>");
    markup::card(
        &mut body,
        "Motion at feed, and rapid moves.",
        &speeds(preview),
    );
    joints(&mut body, preview);
    events(&mut body, preview);
    haptimill_viewer::page(program, markup::STYLE, &body)
}

fn time_of(trace: &Trace) -> f64 {
    polylines(trace)
        .map(|points| match points {
            [first, .., last] => last.time_s - first.time_s,
            _ => 0.0,
        })
        .sum()
}

fn polylines(trace: &Trace) -> impl Iterator<Item = &[Point]> {
    let ends = trace.starts.iter().skip(1).map(|end| *end as usize);
    let ends = ends.chain([trace.points.len()]);
    let starts = trace.starts.iter().map(|start| *start as usize);
    starts
        .zip(ends)
        .map(|(start, end)| &trace.points[start..end])
}

fn layer(name: &str, colour: &str, trace: &Trace, width: f32) -> Layer {
    Layer::new(
        name,
        colour,
        Shape::Lines {
            points: trace
                .points
                .iter()
                .map(|point| point.place.map(|part| part as f32))
                .collect(),
            starts: trace.starts.clone(),
            times: trace
                .points
                .iter()
                .map(|point| point.time_s as f32)
                .collect(),
            lines: trace.points.iter().map(|point| point.line).collect(),
            width,
        },
    )
}

pub(super) fn scene<M: MachineModel>(preview: &Preview<M>) -> Scene {
    let feeds = preview.cut.points.iter().map(|point| point.speed * 60.0);
    let feeds: Vec<f64> = feeds.collect();
    let high = feeds.iter().fold(0.0_f64, |max, feed| max.max(*feed));
    let scale = Scale {
        label: "feed, mm/min".into(),
        low: 0.0,
        high: (high * 10.0).round() / 10.0,
        map: Map::Sequential,
    };
    let cut = layer("at feed", CUT, &preview.cut, 2.0)
        .with_values(feeds.iter().map(|feed| *feed as f32).collect(), scale);
    Scene {
        layers: vec![cut, layer("rapid moves", RAPID, &preview.rapid, 1.0)],
        ..Scene::default()
    }
}

/// Chart of the speed over time: of each part of the time the lowest and highest speed.
fn speeds<M: MachineModel>(preview: &Preview<M>) -> String {
    let end = preview.time_s();
    let line = |label: &str, colour, trace: &Trace| Line {
        label: label.into(),
        colour,
        width: 1.3,
        pieces: polylines(trace)
            .map(|points| thinned(points, end))
            .collect(),
    };
    Chart {
        x_label: "time, s".into(),
        y_label: "speed, mm/min".into(),
        lines: vec![
            line("rapid moves", "#8a939c", &preview.rapid),
            line("at feed", CUT, &preview.cut),
        ],
        width: 1120.0,
        height: 260.0,
        equal: false,
        from_zero: true,
        backdrop: None,
    }
    .svg()
}

fn thinned(points: &[Point], end: f64) -> Vec<(f64, f64)> {
    let pair = |point: &Point| (point.time_s, point.speed * 60.0);
    let part = end / CHART_PARTS as f64;
    let by_part = points.chunk_by(|a, b| (a.time_s / part).floor() == (b.time_s / part).floor());
    let mut kept = Vec::new();
    for group in by_part {
        let by_speed = |a: &&Point, b: &&Point| a.speed.total_cmp(&b.speed);
        let extremes = [
            group.first(),
            group.iter().min_by(by_speed),
            group.iter().max_by(by_speed),
            group.last(),
        ];
        let mut extremes: Vec<&Point> = extremes.into_iter().flatten().collect();
        extremes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        extremes.dedup();
        kept.extend(extremes.into_iter().map(pair));
    }
    kept
}

fn joints<M: MachineModel>(body: &mut String, preview: &Preview<M>) {
    body.push_str(
        "<h2>Joints</h2><table><tr><td>joint</td><td>lowest</td><td>highest</td><td>stroke</td>\
         <td>nearest to an end</td></tr>",
    );
    for (joint, extent) in preview.joints.iter().zip(&preview.extents) {
        let Some(extent) = extent else { continue };
        let Joint {
            name,
            unit,
            low,
            high,
        } = joint;
        let (lowest, highest) = (extent.low, extent.high);
        let (stroke, nearest) = if low.is_finite() && high.is_finite() {
            let nearest = (lowest.0 - low).min(high - highest.0);
            (
                format!("{low:.3} to {high:.3} {unit}"),
                format!("{nearest:.3} {unit}"),
            )
        } else {
            ("without end".into(), String::new())
        };
        put(
            body,
            format_args!(
                "<tr><td>{}</td><td>{:.3} {unit}, line {}</td><td>{:.3} {unit}, line {}</td>\
                 <td>{stroke}</td><td>{nearest}</td></tr>",
                escape(name),
                lowest.0,
                lowest.1,
                highest.0,
                highest.1
            ),
        );
    }
    body.push_str("</table>");
}

fn events<M: MachineModel>(body: &mut String, preview: &Preview<M>) {
    if preview.events.is_empty() {
        return;
    }
    body.push_str("<h2>Stops and commands</h2><table><tr><td>time</td><td>line</td><td></td></tr>");
    for event in preview.events.iter().take(LISTED_EVENTS) {
        put(
            body,
            format_args!(
                "<tr><td>{:.2} s</td><td>{}</td><td>{}</td></tr>",
                event.time_s,
                event.line,
                escape(&event.what)
            ),
        );
    }
    let more = preview.events.len().saturating_sub(LISTED_EVENTS);
    if more > 0 {
        put(
            body,
            format_args!("<tr><td></td><td></td><td>{more} more</td></tr>"),
        );
    }
    body.push_str("</table>");
}
