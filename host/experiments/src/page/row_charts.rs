//! Charts of the results outside their bands: the measured quantity, and its cause.

use super::charts::{GREY, HALF, chart, line, time_label};
use crate::definition::{ExpectedResult, Experiment};
use crate::measures::{self, RowCurve};
use crate::pass_data::PassData;
use haptimill_report::chart::{COLOURS, SHADED, View};
use haptimill_report::markup::{card, escape, put};
use haptimill_report::series::Columns;

const HEIGHT: f64 = 270.0;

/// Colour of the stated value.
const STATED: &str = "#1d2733";

/// Width of the swatch of the band in the legend.
const SWATCH: f64 = 9.0;

/// Part of the range of a cause that its chart shows beyond it.
const MARGIN: f64 = 0.08;

type Points = Vec<(f64, f64)>;

/// Points within a range of x, thinned to the resolution of a chart.
fn thinned(points: &[(f64, f64)], (from, to): (f64, f64)) -> Vec<Points> {
    let mut columns = Columns::new(from, to);
    let inside = points.iter().filter(|(x, _)| (from..=to).contains(x));
    // A line between two points is not interrupted.
    if points.len() <= 3 {
        return vec![points.to_vec()];
    }
    for (x, y) in inside {
        columns.add(*x, *y);
    }
    let mut pieces = columns.line();
    for point in pieces.iter_mut().flatten() {
        point.0 += from;
    }
    pieces
}

/// A line whose ends may be those of the vertical axis.
fn clamped(points: &[(f64, f64)], (low, high): (f64, f64)) -> Vec<Points> {
    let points = points.iter().map(|(x, y)| (*x, y.clamp(low, high)));
    vec![points.collect()]
}

/// The charts of a result in a row of the table; `number` is that of the result, from 1 on.
pub(super) fn row(
    page: &mut String,
    experiment: &Experiment,
    data: &[PassData],
    expected: &ExpectedResult,
    number: usize,
) {
    let Some(curve) = measures::row_curve(experiment, data, expected) else {
        return;
    };
    let pass = experiment.pass_of(&expected.measure);
    let pass = pass.and_then(|index| experiment.passes.get(index));
    let x_label = time_label(pass.is_some_and(|pass| pass.teleoperation.is_some()));
    page.push_str("<tr class=\"charts\"><td colspan=\"5\"><div class=\"pair\">");
    let id = format!("row-{number}");
    card(
        page,
        &escape(&expected.name),
        &result_chart(&curve, x_label, &id),
    );
    if let Some(cause) = measures::cause_curves(experiment, data, expected, &curve) {
        let id = format!("{id}-cause");
        card(
            page,
            &escape(&cause.caption),
            &cause_chart(&cause, x_label, &id),
        );
    }
    put(page, format_args!("</div></td></tr>"));
}

fn result_chart(curve: &RowCurve, x_label: &str, id: &str) -> String {
    let y = curve.y();
    let mut lines = vec![line("band", SHADED, SWATCH, Vec::new())];
    if !curve.all.is_empty() {
        let all = thinned(&curve.all, curve.x);
        lines.push(line("beside", GREY, 1.0, all));
    }
    let joined = |pieces: &[Points]| {
        let pieces = pieces.iter().flat_map(|piece| thinned(piece, curve.x));
        pieces.collect()
    };
    if !curve.reference.is_empty() {
        let reference = joined(&curve.reference);
        lines.push(line("compared with", COLOURS[4], 1.4, reference));
    }
    let measured = joined(&curve.measured_pieces);
    lines.push(line("measured", COLOURS[0], 1.6, measured));
    if !curve.stated.is_empty() {
        lines.push(line("thesis", STATED, 1.2, clamped(&curve.stated, y)));
    }
    let simulated = clamped(&curve.simulated, y);
    lines.push(line("simulated", COLOURS[1], 1.4, simulated));
    let view = View {
        id,
        x: curve.x,
        y,
        shaded: vec![curve.band],
        points: curve
            .mark
            .map(|mark| (mark, COLOURS[1]))
            .into_iter()
            .collect(),
    };
    chart(x_label, &curve.y_label, lines, (HALF.0, HEIGHT)).svg_of(&view)
}

fn cause_chart(cause: &measures::CauseCurves, x_label: &str, id: &str) -> String {
    let points = cause.lines.iter().flat_map(|(_, points)| points);
    let shown = points.filter(|(x, y)| (cause.x.0..=cause.x.1).contains(x) && y.is_finite());
    let (low, high) = shown.fold((0.0_f64, 0.0_f64), |range, (_, y)| {
        (range.0.min(*y), range.1.max(*y))
    });
    let margin = MARGIN * (high - low).max(1e-3);
    let lines = cause.lines.iter().zip(COLOURS);
    let lines = lines.map(|((label, points), colour)| {
        line(label.clone(), colour, 1.4, thinned(points, cause.x))
    });
    let view = View {
        id,
        x: cause.x,
        y: (low - margin, high + margin),
        shaded: Vec::new(),
        points: Vec::new(),
    };
    let x_label = cause.x_label.unwrap_or(x_label);
    chart(x_label, &cause.y_label, lines.collect(), (HALF.0, HEIGHT)).svg_of(&view)
}
