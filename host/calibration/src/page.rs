//! The page of the scenario.

use crate::comparison::squareness;
use crate::cut::MPE_P;
use crate::scenario::{ScenarioResult, State, Volume, WORN, omission_table};
use haptimill_report::chart::{COLOURS, Chart, Line};
use haptimill_report::markup::{card, escape, put};
use haptimill_viewer::{Layer, Map, Scale, Scene, Shape, Values};
use haptimill_volumetric::Vector;
use haptimill_volumetric::part::{
    CIRCLE_RADIUS, Features, HALF_SIDE, ProbePoint, SIDES, STRAIGHTNESS, probe_points,
};

/// Factor of the drawn length of an error arrow: 1 um is 4 mm.
const MAGNIFY: f32 = 4e3;

/// The same for what exact tables leave: 0.1 um is 20 mm.
const MAGNIFY_REST: f32 = 200e3;

const MORE_STYLE: &str = "
th{text-align:left;padding:7px 14px;border-bottom:1px solid #d5dae0;font-weight:600;color:#3b4754;font-size:13px}
td.n,th.n{text-align:right;white-space:nowrap}.bad{color:#b04a00}pre{background:#fff;border:1px solid #e0e4e9;border-radius:8px;padding:12px;overflow-x:auto;font-size:12px}";

/// The whole page.
#[must_use]
pub fn page(outcome: &ScenarioResult) -> String {
    let mut body = String::from(
        "<h1>Volumetric errors of a vertical mill</h1><p class=\"sub\">21 geometric \
         errors in the simulated machine, measured by a simulated laser through the controller's \
         protocol and compensated by the controller; the test piece A160 of ISO 10791-7 and the \
         circle test of ISO 230-4 before and after.</p>",
    );
    volumes(&mut body, outcome);
    body.push_str("<h2>Error of the tool over the part</h2>");
    card(
        &mut body,
        "Arrows: error of the tool at standstill, 1 um drawn as 4 mm. Switch the states on and off.",
        &scene(&outcome.states, MAGNIFY).fragment(),
    );
    if let Some(exact) = outcome.states.get(1..2) {
        card(
            &mut body,
            "What exact tables leave: 0.1 um drawn as 20 mm.",
            &scene(exact, MAGNIFY_REST).fragment(),
        );
    }
    characteristics(&mut body, &outcome.states);
    profiles(&mut body, &outcome.states);
    circles(&mut body, &outcome.states);
    body.push_str(
        "<h2>Sides before compensation: measured errors against the part (table 5.1 of the \
         thesis)</h2><pre>",
    );
    for line in &outcome.comparison {
        put(&mut body, format_args!("{}\n", escape(&line.to_string())));
    }
    put(
        &mut body,
        format_args!(
            "squareness of the two sides {:.1} urad\n\n{}</pre>",
            squareness(&outcome.sides) * 1e6,
            escape(&omission_table(outcome))
        ),
    );
    body.push_str("<h2>Calibration</h2><pre>");
    body.push_str(&escape(&outcome.calibration.report()));
    body.push_str("</pre>");
    haptimill_viewer::page(
        "Volumetric errors of a vertical mill",
        &format!("{}{MORE_STYLE}", haptimill_report::markup::STYLE),
        &body,
    )
}

fn volumes(body: &mut String, outcome: &ScenarioResult) {
    body.push_str(
        "<h2>Volumetric error of the tool at standstill</h2><table><tr><th>state</th>\
         <th class=\"n\">largest, um</th><th class=\"n\">rms, um</th>\
         <th class=\"n\">largest without the best-fitting rigid motion of the workpiece, um</th></tr>",
    );
    let mut row = |name: &str, volume: &Volume| {
        let (sizes, rest) = (volume.sizes(), volume.without_motion().sizes());
        put(
            body,
            format_args!(
                "<tr><td>{name}</td><td class=\"n\">{:.3}</td><td class=\"n\">{:.3}</td>\
                 <td class=\"n\">{:.3}</td></tr>",
                sizes.largest * 1e3,
                sizes.rms * 1e3,
                rest.largest * 1e3
            ),
        );
    };
    for state in &outcome.states {
        row(state.name, &state.volume);
    }
    for (name, volume) in WORN.iter().zip(&outcome.worn) {
        row(name, volume);
    }
    body.push_str("</table>");
}

/// Arrows of the error field of each state; the first one is shown at first.
#[must_use]
pub fn scene(states: &[State], magnify: f32) -> Scene {
    let largest = states
        .first()
        .map_or(0.0, |state| state.volume.sizes().largest * 1e3);
    let layers = states.iter().enumerate().map(|(index, state)| {
        let flat = |vectors: &[Vector]| -> Vec<[f32; 3]> {
            vectors
                .iter()
                .map(|v| [v.x as f32, v.y as f32, v.z as f32])
                .collect()
        };
        let shape = Shape::Arrows {
            points: flat(&state.volume.points),
            vectors: flat(&state.volume.errors),
            magnify,
            width: 1.5,
        };
        let values = state
            .volume
            .errors
            .iter()
            .map(|error| (error.norm() * 1e3) as f32);
        Layer {
            name: state.name.to_string(),
            colour: COLOURS[index % COLOURS.len()].to_string(),
            values: Some(Values {
                values: values.collect(),
                scale: Scale {
                    label: "error, um".to_string(),
                    low: 0.0,
                    high: largest,
                    map: Map::Sequential,
                },
            }),
            visible: index == 0,
            shape,
        }
    });
    Scene {
        layers: layers.collect(),
        ..Scene::default()
    }
}

fn characteristics(body: &mut String, states: &[State]) {
    let Some(first) = states.first() else {
        return;
    };
    body.push_str(
        "<h2>Test piece</h2><p class=\"sub\">um. Without noise of the measuring machine; in brackets \
         with its noise and set-up errors, mean of 3 runs. Tolerances are proposals except the \
         straightness of the square.</p><table><tr><th>characteristic</th>",
    );
    for state in states {
        put(body, format_args!("<th class=\"n\">{}</th>", state.name));
    }
    body.push_str("<th class=\"n\">minimum zone before</th><th class=\"n\">tolerance</th></tr>");
    for (index, [row, _]) in first.rows.iter().enumerate() {
        put(body, format_args!("<tr><td>{}</td>", escape(&row.name)));
        for state in states {
            let [exact, read] = &state.rows[index];
            let small = exact.value.abs() < MPE_P;
            put(
                body,
                format_args!(
                    "<td class=\"n{}\">{:.3} ({:.2}){}</td>",
                    if exact.passes() { "" } else { " bad" },
                    exact.value * 1e3,
                    read.value * 1e3,
                    if small { " *" } else { "" }
                ),
            );
        }
        let um = |value: Option<f64>| value.map_or(String::new(), |v| format!("{:.3}", v * 1e3));
        put(
            body,
            format_args!(
                "<td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
                um(row.zone),
                row.tolerance
                    .map_or(String::new(), |tolerance| format!("{:.0}", tolerance * 1e3))
            ),
        );
    }
    put(
        body,
        format_args!(
            "</table><p class=\"sub\">* below MPE_P = {:.1} um, for which the measuring machine is \
             specified.</p>",
            MPE_P * 1e3
        ),
    );
}

/// Profiles of the sides of the square and of the diamond.
fn profiles(body: &mut String, states: &[State]) {
    let nominal = probe_points();
    let um = STRAIGHTNESS * 1e3;
    body.push_str("<h2>Profiles of the sides of the square and of the diamond</h2>");
    body.push_str("<div class=\"pair\">");
    for (index, side) in SIDES.iter().enumerate() {
        let chart = profile(states, &nominal.sides[index], HALF_SIDE, |surface| {
            &surface.sides[index]
        });
        let caption = format!(
            "Side {side}: deviation along the normal; tolerance of straightness {um:.0} um"
        );
        card(body, &caption, &chart.svg());
    }
    for (index, side) in nominal.diamond.iter().enumerate() {
        let chart = profile(states, side, CIRCLE_RADIUS, |surface| {
            &surface.diamond[index]
        });
        let caption = format!(
            "Side {} of the diamond: deviation along the normal; tolerance of straightness {um:.0} um",
            index + 1
        );
        card(body, &caption, &chart.svg());
    }
    body.push_str("</div>");
}

/// Deviation of a side along its normal, um, for each state.
fn profile(
    states: &[State],
    nominal: &[ProbePoint],
    half: f64,
    of: impl Fn(&Features<Vector>) -> &Vec<Vector>,
) -> Chart {
    let line = |(index, state): (usize, &State)| {
        let points = nominal.iter().zip(of(&state.surface));
        let piece = points.map(|(point, cut)| {
            let along = Vector::z().cross(&point.normal);
            (
                along.dot(&point.surface),
                (cut - point.surface).dot(&point.normal) * 1e3,
            )
        });
        Line {
            label: state.name.to_string(),
            colour: COLOURS[index % COLOURS.len()],
            width: 1.6,
            pieces: vec![piece.collect()],
        }
    };
    let mut lines: Vec<Line> = states.iter().enumerate().map(line).collect();
    // The tolerance of straightness as a band about the nominal side.
    let limit = |at: f64| vec![(-half, at), (half, at)];
    let um = 0.5 * STRAIGHTNESS * 1e3;
    lines.push(Line {
        label: "tolerance".to_string(),
        colour: "#6b7684",
        width: 1.0,
        pieces: vec![limit(um), limit(-um)],
    });
    Chart {
        x_label: "along the side, mm".to_string(),
        y_label: "deviation, um".to_string(),
        lines,
        width: 640.0,
        height: 300.0,
        equal: false,
        from_zero: true,
        backdrop: None,
    }
}

fn circles(body: &mut String, states: &[State]) {
    body.push_str(
        "<h2>Circle test, 100 mm, with the dynamics of the machine</h2><table><tr><th>state</th>\
         <th class=\"n\">feed, mm/s</th><th class=\"n\">G ccw, um</th><th class=\"n\">G cw, um</th>\
         <th class=\"n\">H, um</th><th class=\"n\">F max, um</th><th class=\"n\">F min, um</th>\
         <th class=\"n\">squareness, urad</th></tr>",
    );
    for state in states {
        put(
            body,
            format_args!(
                "<tr><td>{}</td><td class=\"n\">at standstill</td><td class=\"n\">{:.2}</td>\
                 <td colspan=\"5\"></td></tr>",
                state.name,
                state.still * 1e3
            ),
        );
        for (feed, circle) in &state.circles {
            let [ccw, cw] = circle.deviation.map(|value| value * 1e3);
            let [max, min] = circle.radial.map(|value| value * 1e3);
            put(
                body,
                format_args!(
                    "<tr><td>{}</td><td class=\"n\">{feed}</td><td class=\"n\">{ccw:.2}</td>\
                     <td class=\"n\">{cw:.2}</td><td class=\"n\">{:.2}</td>\
                     <td class=\"n\">{max:.2}</td><td class=\"n\">{min:.2}</td>\
                     <td class=\"n\">{:.1}</td></tr>",
                    state.name,
                    circle.hysteresis * 1e3,
                    circle.squareness * 1e6
                ),
            );
        }
    }
    body.push_str("</table>");
}
