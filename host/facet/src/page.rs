//! The report of a stone: a page with the stone in 3D, the design with its pictures, the facets
//! against the design, and the job.

mod design;

use crate::forces;
use crate::gem::{Gem, MEET_MM};
use crate::job::Job;
use crate::measure::ANGLE_DEG;
use crate::run::Cutting;
use core::fmt::Write as _;
use haptimill_hil_sim::polyhedron::Polyhedron;
use haptimill_viewer::{Layer, Map, Scale, Scene, Shape, page};

const CSS: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:24px auto;\
padding:0 16px;color:#1d2733}h1{font-size:24px}h2{font-size:18px;margin-top:32px}\
table{border-collapse:collapse;font-size:13px}td,th{padding:2px 10px;text-align:right;\
border-bottom:1px solid #e3e6ea}td:first-child,th:first-child{text-align:left}\
.sum{display:flex;flex-wrap:wrap;gap:24px}.sum div{min-width:120px}.sum b{display:block;\
font-size:20px}.over{color:#a3191f;font-weight:600}.views{display:flex;flex-wrap:wrap;\
gap:20px;align-items:flex-end}figure{margin:0;text-align:center;font-size:13px}\
svg text{font:11px system-ui,sans-serif;text-anchor:middle;dominant-baseline:central}\
.tiers{width:100%}.tiers td,.tiers th{text-align:left;vertical-align:top}\
.tiers th[colspan]{padding-top:12px;color:#4a5a6a}.remark{margin:4px 0;color:#4a5a6a}";

pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// The report page. `other` is another run of the same design, to show beside.
#[must_use]
pub fn report(gem: &Gem, job: &Job, cutting: &Cutting, other: Option<(&Job, &Cutting)>) -> String {
    let measured = &cutting.measured;
    let design = &gem.design;
    let title = if design.title.is_empty() {
        "Stone"
    } else {
        &design.title
    };
    let mut body = String::new();
    let _ = write!(body, "<h1>{}</h1>", escape(title));
    for remark in &design.remarks {
        let _ = write!(body, "<p class=remark>{}</p>", escape(remark));
    }
    let seconds: f64 = cutting.operations.iter().map(|it| it.seconds).sum();
    let _ = write!(
        body,
        "<div class=sum><div><b>{}</b>facets</div><div><b>{:.4} deg</b>largest angle error</div>\
         <div><b>{:.1} um</b>largest depth error</div><div><b>{}</b>largest meet error</div>\
         <div><b>{:.1} %</b>of the rough</div><div><b>{:.2} ct</b>quartz</div>\
         <div><b>{}</b>on the machine</div></div>",
        measured.facets.len(),
        measured.worst_angle_deg(),
        1e3 * measured.worst_depth_mm(),
        micrometres(measured.worst_meet_mm()),
        1e2 * measured.yield_part,
        // 2.65 g/cm^3; a carat is 0.2 g.
        measured.volume_mm3 * 2.65e-3 / 0.2,
        minutes(seconds)
    );
    problems(&mut body, gem, cutting);
    lost(&mut body, gem, cutting);
    let _ = write!(body, "<h2>The stone</h2>{}", scene(gem, cutting).fragment());
    design::section(&mut body, gem);
    facets(&mut body, gem, cutting);
    meets(&mut body, gem, cutting);
    forces::stages(&mut body, (job, cutting));
    if let Some(other) = other {
        forces::beside(&mut body, [(job, cutting), other], [ANGLE_DEG, MEET_MM]);
    }
    page(title, CSS, &body)
}

pub fn micrometres(mm: f64) -> String {
    format!("{:.1} um", 1e3 * mm)
}

pub fn minutes(seconds: f64) -> String {
    let whole = seconds.round();
    format!("{:.0} min {:02.0} s", (whole / 60.0).floor(), whole % 60.0)
}

fn problems(body: &mut String, gem: &Gem, cutting: &Cutting) {
    let measured = &cutting.measured;
    if let Some(error) = &cutting.stopped {
        let error = escape(&error.message);
        let _ = write!(
            body,
            "<p class=over>The job ended before its last facet: {error}. The stone is as it was \
             then.</p>"
        );
    }
    if !measured.missing.is_empty() {
        let names: Vec<&str> = measured
            .missing
            .iter()
            .map(|facet| gem.design.facets[*facet].name.as_str())
            .collect();
        let names = escape(&names.join(", "));
        let _ = write!(body, "<p class=over>The stone lacks facets: {names}.</p>");
    }
    if measured.strange > 0 {
        let _ = write!(
            body,
            "<p class=over>{} faces of the stone are no facet of the design.</p>",
            measured.strange
        );
    }
}

/// Says of which meet points the stone has no vertex.
fn lost(body: &mut String, gem: &Gem, cutting: &Cutting) {
    let lost = cutting.measured.lost_meets().count();
    if lost > 0 {
        let _ = write!(
            body,
            "<p class=over>Of {lost} of {} meet points the stone has no vertex; the table shows the \
             distance of the nearest vertex with two of the facets.</p>",
            gem.meets.len()
        );
    }
}

/// Triangles of a body, flat for each face, with a value for each face.
fn triangles(body: &Polyhedron, value: impl Fn(usize) -> f32) -> (Shape, Vec<f32>) {
    let (mut points, mut triangles, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for (number, face) in body.faces().iter().enumerate() {
        let first = points.len() as u32;
        for at in body.corners(face) {
            points.push(at.map(|value| value as f32));
            values.push(value(number));
        }
        for corner in 2..face.ring.len() as u32 {
            triangles.push([first, first + corner - 1, first + corner]);
        }
    }
    let shape = Shape::Mesh {
        points,
        triangles,
        opacity: 1.0,
    };
    (shape, values)
}

/// Edges of a body.
fn edges(body: &Polyhedron, width: f32) -> Shape {
    let (mut points, mut starts) = (Vec::new(), Vec::new());
    for face in body.faces() {
        starts.push(points.len() as u32);
        let mut ring: Vec<[f32; 3]> = body
            .corners(face)
            .map(|at| at.map(|value| value as f32))
            .collect();
        ring.extend(ring.first().copied());
        points.extend(ring);
    }
    Shape::Lines {
        points,
        starts,
        times: Vec::new(),
        lines: Vec::new(),
        width,
    }
}

fn scene(gem: &Gem, cutting: &Cutting) -> Scene {
    let stone = &cutting.stone;
    let measured = &cutting.measured;
    let depth = |number: usize| {
        let plane = stone.faces()[number].plane;
        let near = measured.facets.iter().min_by(|a, b| {
            let away =
                |facet: usize| crate::job::angle_between(gem.plane(facet).normal, plane.normal);
            away(a.facet).total_cmp(&away(b.facet))
        });
        near.map_or(0.0, |facet| (1e3 * facet.depth_mm) as f32)
    };
    let (mesh, values) = triangles(stone, depth);
    let max = (1e3 * measured.worst_depth_mm()).max(0.1);
    let scale = Scale {
        label: "depth error, um".into(),
        low: -max,
        high: max,
        map: Map::Diverging,
    };
    let plain = triangles(stone, |_| 0.0).0;
    let mut errors = Layer::new("depth errors", "#9db8d2", mesh).with_values(values, scale);
    errors.visible = false;
    Scene {
        layers: vec![
            // The first one of two equal faces is seen: the errors, where they are shown.
            errors,
            Layer::new("stone", "#a8c8e4", plain),
            Layer::new("edges", "#16324f", edges(stone, 1.6)),
            Layer {
                visible: false,
                ..Layer::new("design", "#a3191f", edges(&gem.body, 1.0))
            },
            // The rough is in the pictures of the design: the viewer would print its size for that
            // of the stone.
        ],
        view: Some([-35.0, 28.0]),
        ..Scene::default()
    }
}

pub fn class(is_over: bool) -> &'static str {
    if is_over { " class=over" } else { "" }
}

fn facets(body: &mut String, gem: &Gem, cutting: &Cutting) {
    body.push_str(
        "<h2>Facets</h2><p>Measured less designed. The error of the normal is the angle between \
         both.</p><table><tr><th>facet<th>stage<th>angle, deg<th>error, deg<th>azimuth, deg\
         <th>normal, deg<th>depth, um<th>hard spot, um<th>area, mm^2",
    );
    for result in &cutting.measured.facets {
        let facet = &gem.design.facets[result.facet];
        let _ = write!(
            body,
            "<tr><td>{}<td>{}<td>{:.2}<td>{:+.4}<td>{:+.4}<td{}>{:.4}<td>{:+.2}<td>{:.2}<td>{:.3}",
            escape(&facet.name),
            facet.stage.name(),
            facet.angle_deg,
            result.angle_deg,
            result.azimuth_deg,
            class(result.error_deg > ANGLE_DEG),
            result.error_deg,
            1e3 * result.depth_mm,
            1e3 * result.proud_mm,
            result.area_mm2
        );
    }
    body.push_str("</table>");
}

fn meets(body: &mut String, gem: &Gem, cutting: &Cutting) {
    body.push_str(
        "<h2>Meet points</h2><p>Largest distance of a vertex of the stone from the point. The gain \
         is the displacement of the point when its facets are off by 1 um in depth.</p>\
         <table><tr><th>facets<th>x, mm<th>y, mm<th>z, mm<th>gain<th>error, um",
    );
    for result in &cutting.measured.meets {
        let meet = &gem.meets[result.meet];
        let names: Vec<&str> = meet
            .facets
            .iter()
            .filter_map(|facet| gem.design.facets.get(*facet))
            .map(|facet| facet.name.as_str())
            .collect();
        let [x, y, z] = meet.at;
        let error = result.error_mm;
        let _ = write!(
            body,
            "<tr><td>{}<td>{x:.3}<td>{y:.3}<td>{z:.3}<td>{:.1}<td{}>{}",
            escape(&names.join(" ")),
            meet.gain,
            class(error > MEET_MM || !result.is_found),
            micrometres(error)
        );
        if !result.is_found {
            body.push_str(", nearest vertex");
        }
    }
    body.push_str("</table>");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::Measured;
    use crate::thesis::{SMALL, SMALL_MM};

    /// The viewer draws opaque meshes in the order of the layers and keeps the nearest points, of
    /// equal ones the first. The faces of the errors are those of the stone, so they must come
    /// first to be seen.
    #[test]
    fn depth_errors_are_in_front_of_the_stone() {
        let design = crate::read("small.asc", SMALL.as_bytes()).unwrap();
        let gem = Gem::new("small.asc", design, SMALL_MM, None).unwrap();
        let stone = gem.body.clone();
        let cutting = Cutting {
            measured: Measured::new(&gem, &stone, &[]),
            stone,
            ground: Vec::new(),
            operations: Vec::new(),
            wear: Vec::new(),
            stopped: None,
        };
        let scene = scene(&gem, &cutting);
        let place = |name: &str| {
            let mut layers = scene.layers.iter();
            layers.position(|layer| layer.name == name).unwrap()
        };
        assert!(place("depth errors") < place("stone"));
    }
}
