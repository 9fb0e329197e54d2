//! The offline page that shows a job before it is cut.

mod labels;

use crate::drawing::Drawing;
use crate::geometry::Point;
use crate::job::{Job, Options};
use crate::plate::Plate;
pub use crate::times::Speeds;
use crate::toolpath::{Cut, PathStep};
use haptimill_viewer::{Layer, Scene, Shape, page};
use std::fmt::Write as _;

/// Largest distance of the drawn chords from arcs, mm.
const CHORD: f64 = 0.01;

/// Points of the surface along the longer side.
const SURFACE: f64 = 320.0;

/// Largest number of numbered starts; more would cover the plan.
const NUMBERS: usize = 300;

/// A row of the table of orders: name, air (mm), lifts, time (s).
pub type Row = (String, f64, usize, f64);

/// Polylines with a time for each point.
#[derive(Default)]
struct Lines {
    points: Vec<[f32; 3]>,
    starts: Vec<u32>,
    times: Vec<f32>,
}

impl Lines {
    fn begin(&mut self, at: [f64; 3], time: f64) {
        self.starts.push(self.points.len() as u32);
        self.add(at, time);
    }

    fn add(&mut self, at: [f64; 3], time: f64) {
        self.points.push(at.map(|value| value as f32));
        self.times.push(time as f32);
    }

    fn layer(self, name: &str, colour: &str, width: f32) -> Layer {
        let Self {
            points,
            starts,
            times,
        } = self;
        let shape = Shape::Lines {
            points,
            starts,
            times,
            lines: Vec::new(),
            width,
        };
        Layer::new(name, colour, shape)
    }
}

/// Points of a cut with Z, the plunge included.
#[must_use]
pub fn points_of(cut: &Cut, chord: f64) -> Vec<[f64; 3]> {
    let mut points = vec![[cut.start[0], cut.start[1], cut.z]];
    for step in &cut.steps {
        let [x, y, z] = points[points.len() - 1];
        match step {
            PathStep::Vertical(to) => points.push([x, y, *to]),
            PathStep::Along(segment, to) => {
                let count = segment
                    .arc()
                    .map_or(1, |arc| crate::geometry::chords(&arc, chord));
                for k in 1..=count {
                    let part = k as f64 / count as f64;
                    let at = if k == count {
                        segment.to
                    } else {
                        segment.point(part)
                    };
                    points.push([at[0], at[1], z + (to - z) * part]);
                }
            }
        }
    }
    points
}

/// Cuts a plate with the job as it is planned.
pub fn cut(plate: &mut Plate, job: &Job, tool_mm: f64) {
    for one in &job.toolpath.cuts {
        let points = points_of(one, CHORD);
        plate.sweep(tool_mm / 2.0, points[0], points[0]);
        for pair in points.windows(2) {
            plate.sweep(tool_mm / 2.0, pair[0], pair[1]);
        }
    }
}

fn off(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

/// Box around the drawing with room for the tool.
#[must_use]
pub fn area(drawing: &Drawing, options: &Options) -> [Point; 2] {
    let [low, high] = drawing.bounds().unwrap_or([[0.0; 2], [1.0; 2]]);
    let room = 1.5 * options.tool_mm + options.lead_mm.unwrap_or(0.0) + 1.0;
    [
        low.map(|value| value - room),
        high.map(|value| value + room),
    ]
}

/// The page of a job.
#[must_use]
pub fn html(
    title: &str,
    drawing: &Drawing,
    job: &Job,
    options: &Options,
    speeds: Speeds,
    rows: &[Row],
) -> String {
    let mut body = format!("<h1>{}</h1>\n", escaped(title));
    let _ = writeln!(
        body,
        "<p>Tool {} mm, {} mm deep, feed {} mm/s, rapid {} mm/s. Cuts are blue, air moves orange; \
         numbers are the order of the first {NUMBERS} starts.</p>",
        options.tool_mm, options.depth_mm, speeds.feed, speeds.rapid
    );
    body.push_str("<table><tr><th>order<th>air, mm<th>lifts<th>time, s<th>saved</tr>\n");
    let first = rows.first().map_or(0.0, |row| row.3);
    for (name, air, lifts, time) in rows {
        let saved = if first > 0.0 {
            100.0 * (1.0 - time / first)
        } else {
            0.0
        };
        let _ = writeln!(
            body,
            "<tr><td>{}<td>{air:.3}<td>{lifts}<td>{time:.1}<td>{saved:.1} %</tr>",
            escaped(name)
        );
    }
    body.push_str("</table>\n");
    body.push_str(&plan(drawing, job, options));
    body.push_str(&scene(drawing, job, options, speeds).fragment());
    if !(drawing.notices.is_empty() && job.notices.is_empty()) {
        body.push_str("<h2>Notices</h2><ul>");
        for notice in drawing.notices.iter().chain(&job.notices) {
            let _ = write!(body, "<li>{}", escaped(notice));
        }
        body.push_str("</ul>");
    }
    let style = "body{margin:20px;max-width:1100px}\
        table{border-collapse:collapse}th,td{padding:2px 12px;text-align:right}\
        td:first-child,th:first-child{text-align:left}\
        .plan{width:100%;max-height:680px;background:#fff;border:1px solid #ccc;margin:12px 0}";
    page(title, style, &body)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn scene(drawing: &Drawing, job: &Job, options: &Options, speeds: Speeds) -> Scene {
    let (mut cuts, mut air, mut shapes) = (Lines::default(), Lines::default(), Lines::default());
    for path in &drawing.paths {
        for (index, at) in path.points(CHORD).into_iter().enumerate() {
            let at = [at[0], at[1], 0.0];
            if index == 0 {
                shapes.begin(at, 0.0)
            } else {
                shapes.add(at, 0.0)
            }
        }
    }
    shapes.times.clear();
    let (mut time, mut at) = (
        0.0,
        [options.reference[0], options.reference[1], speeds.lift_mm],
    );
    let (mut tails, mut heads) = (Vec::new(), Vec::new());
    for one in &job.toolpath.cuts {
        let above = [one.start[0], one.start[1], speeds.lift_mm];
        air.begin(at, time);
        if at[2] < speeds.lift_mm {
            let up = [at[0], at[1], speeds.lift_mm];
            time += off(at, up) / speeds.rise;
            air.add(up, time);
            at = up;
        }
        time += off(at, above) / speeds.rapid;
        air.add(above, time);
        let points = points_of(one, CHORD);
        time += off(above, points[0]) / speeds.plunge;
        air.add(points[0], time);
        cuts.begin(points[0], time);
        for pair in points.windows(2) {
            time += off(pair[0], pair[1]) / speeds.feed;
            cuts.add(pair[1], time);
        }
        if let Some(ahead) = points.iter().find(|point| off(points[0], **point) > 0.2) {
            let length = off(points[0], *ahead);
            let size = options.tool_mm.max(1.0) * 2.0;
            tails.push(points[0].map(|value| value as f32));
            heads.push(std::array::from_fn(|axis| {
                ((ahead[axis] - points[0][axis]) / length * size) as f32
            }));
        }
        at = points[points.len() - 1];
    }
    let home = [options.reference[0], options.reference[1], speeds.lift_mm];
    air.begin(at, time);
    let up = [at[0], at[1], speeds.lift_mm];
    time += off(at, up) / speeds.rise;
    air.add(up, time);
    air.add(home, time + off(up, home) / speeds.rapid);
    let starts = Shape::Arrows {
        points: tails,
        vectors: heads,
        magnify: 1.0,
        width: 2.0,
    };
    Scene {
        layers: vec![
            surface(drawing, job, options),
            shapes.layer("drawing", "#444444", 1.0),
            cuts.layer("cuts", "#2f6fb3", 2.0),
            air.layer("air moves", "#e07b1a", 1.0),
            Layer::new("starts", "#1a7a3a", starts),
        ],
        view: Some([-30.0, 50.0]),
        ..Scene::default()
    }
}

/// The surface of the plate after the cut.
fn surface(drawing: &Drawing, job: &Job, options: &Options) -> Layer {
    let [low, high] = area(drawing, options);
    let cell = ((high[0] - low[0]).max(high[1] - low[1]) / SURFACE).max(options.tool_mm / 12.0);
    let mut plate = Plate::new([low, high], cell);
    cut(&mut plate, job, options.tool_mm);
    let [columns, rows] = plate.size();
    let mut points = Vec::with_capacity(columns * rows);
    let mut triangles = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let [x, y] = plate.at(column, row);
            let z = plate.heights()[row * columns + column];
            points.push([x as f32, y as f32, z]);
            if row + 1 < rows && column + 1 < columns {
                let a = (row * columns + column) as u32;
                let (b, c, d) = (a + 1, a + columns as u32, a + columns as u32 + 1);
                triangles.push([a, b, d]);
                triangles.push([a, d, c]);
            }
        }
    }
    Layer::new(
        "plate",
        "#d9c8a0",
        Shape::Mesh {
            points,
            triangles,
            opacity: 1.0,
        },
    )
}

/// The plan from above with numbered starts; the cuts have the width of the tool.
#[must_use]
pub fn plan(drawing: &Drawing, job: &Job, options: &Options) -> String {
    let [low, high] = area(drawing, options);
    let low = [
        low[0].min(options.reference[0]) - 1.0,
        low[1].min(options.reference[1]) - 1.0,
    ];
    let size = [high[0] - low[0], high[1] - low[1]];
    let unit = size[0].max(size[1]) / 100.0;
    let mut svg = format!(
        "<svg class=\"plan\" xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{:.3} {:.3} {:.3} \
         {:.3}\" font-family=\"sans-serif\">\n<defs><marker id=\"a\" viewBox=\"0 0 6 6\" refX=\"5\" \
         refY=\"3\" markerWidth=\"5\" markerHeight=\"5\" orient=\"auto\"><path d=\"M0 0L6 3L0 6z\" \
         fill=\"#e07b1a\"/></marker></defs>\n",
        low[0], -high[1], size[0], size[1]
    );
    let (mut wide, mut thin, mut air, mut numbers) =
        (String::new(), String::new(), String::new(), String::new());
    let mut starts: Vec<Point> = Vec::new();
    let mut at = options.reference;
    for (index, one) in job.toolpath.cuts.iter().enumerate() {
        let start = one.start;
        let _ = writeln!(
            air,
            "<path d=\"M{:.3} {:.3}L{:.3} {:.3}\"/>",
            at[0], -at[1], start[0], -start[1]
        );
        at = one.end();
        let points = points_of(one, CHORD);
        let mut data = String::new();
        for (k, [x, y, _]) in points.iter().enumerate() {
            let _ = write!(data, "{}{x:.3} {:.3}", if k == 0 { 'M' } else { 'L' }, -y);
        }
        if points.len() == 1 {
            data.push('z');
        }
        let _ = writeln!(wide, "<path d=\"{data}\"/>");
        let _ = writeln!(thin, "<path d=\"{data}\"/>");
        if index < NUMBERS {
            let _ = writeln!(
                numbers,
                "<circle cx=\"{:.3}\" cy=\"{:.3}\" r=\"{:.3}\" fill=\"#1a7a3a\"/>",
                start[0],
                -start[1],
                0.35 * unit
            );
            starts.push(start);
        }
    }
    let view = [[low[0], -high[1]], [low[0] + size[0], size[1] - high[1]]];
    numbers.push_str(&labels::texts(&starts, view));
    let home = options.reference;
    let _ = writeln!(
        air,
        "<path d=\"M{:.3} {:.3}L{:.3} {:.3}\"/>",
        at[0], -at[1], home[0], -home[1]
    );
    let _ = write!(
        svg,
        "<g fill=\"none\" stroke-linecap=\"round\" stroke-linejoin=\"round\">\n\
         <g stroke=\"#b9d3ec\" stroke-width=\"{}\">{wide}</g>\n\
         <g stroke=\"#2f6fb3\" stroke-width=\"{:.3}\">{thin}</g>\n\
         <g stroke=\"#e07b1a\" stroke-width=\"{:.3}\" stroke-dasharray=\"{:.3}\" \
         marker-end=\"url(#a)\">{air}</g></g>\n\
         <g fill=\"#111\">{numbers}</g></svg>\n",
        options.tool_mm,
        0.15 * unit,
        0.2 * unit,
        0.8 * unit
    );
    svg
}
