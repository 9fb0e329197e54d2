//! The curve of a result: its quantity in the window of its measure, with the band, the stated
//! value and the simulated value on the axes of that curve.

use super::context::Context;
use super::laws::opposed;
use super::statistics::{Point, largest, mean, slope, smallest, time_of_max};
use super::{quantity, references, single};
use crate::definition::{ExpectedResult, Experiment};
use crate::pass_data::PassData;

/// A longer gap between samples separates two windows, s.
const GAP_S: f64 = 0.05;

/// What a curve shows on either side of its windows: a part of their length, and at least this, s.
const BESIDE: f64 = 0.08;
const BESIDE_S: f64 = 2.0;

/// What a curve shows beside a time that is a result: at least this much, s.
const BESIDE_TIME_S: f64 = 0.5;

/// What a curve shows on either side of a change, s.
const BESIDE_CHANGE_S: f64 = 0.15;

/// Everything; the chart cuts it off at its axes.
const ALL: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

/// The curve of a result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RowCurve {
    /// Label of the vertical axis, with the unit.
    pub y_label: String,
    /// Range of the horizontal axis, s.
    pub x: (f64, f64),
    /// The quantity in the whole range.
    pub all: Vec<Point>,
    /// The quantity in the windows of the measure.
    pub measured_pieces: Vec<Vec<Point>>,
    /// The quantity where the reference of the measure is taken.
    pub reference: Vec<Vec<Point>>,
    /// Ranges of x and y of the band.
    pub band: [(f64, f64); 2],
    /// Line of the value that the thesis states.
    pub stated: Vec<Point>,
    /// Line of the simulated value.
    pub simulated: Vec<Point>,
    /// Point of the simulated value.
    pub mark: Option<Point>,
    /// Start and end of the windows, s.
    pub measured: (f64, f64),
    /// The stated value, or else the end of the band nearest to the simulated one.
    pub goal: Option<f64>,
    /// The quantity is a displacement that (3.30) gives.
    pub is_displacement: bool,
}

/// How a measure is shown on its curve.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    /// A level over the windows.
    Level,
    /// A point of the curve.
    Extreme(f64),
    /// The largest less the smallest value.
    Spread,
    /// Increase from the start to the end of the windows, for each second.
    Slope,
    /// A value at a time.
    At,
    /// A time.
    Time,
    /// A time from 10 % of a change on.
    Change,
    /// A time from an event on.
    After,
    /// Part of the time in which a condition holds.
    Fraction,
    /// A value without a curve over time.
    Value,
}

fn shape(measure: &str) -> Shape {
    match measure {
        "mean" | "abs_mean" | "mean_abs" => Shape::Level,
        "max" | "max_abs" => Shape::Extreme(1.0),
        "min" => Shape::Extreme(-1.0),
        "spread" => Shape::Spread,
        "slope" | "mean_speed" => Shape::Slope,
        "at" | "at_abs" => Shape::At,
        "time_of_max" | "time_of_min" | "first_below" | "rise_time" | "event_time"
        | "start_time" | "end_time" => Shape::Time,
        "change_time" => Shape::Change,
        "time_after" => Shape::After,
        "opposed_fraction" => Shape::Fraction,
        _ => Shape::Value,
    }
}

/// The number of a statement of the thesis that is one number with its unit, perhaps after words
/// such as "about".
fn stated_value(thesis: &str, unit: &str) -> Option<f64> {
    let mut text = thesis.trim();
    for word in [
        "about ",
        "near ",
        "at most ",
        "at least ",
        "above ",
        "below ",
    ] {
        text = text.strip_prefix(word).unwrap_or(text);
    }
    let number = text.strip_suffix(unit).unwrap_or(text).trim();
    number.trim_start_matches('+').parse().ok()
}

/// Pieces between gaps.
fn pieces(values: &[Point]) -> Vec<Vec<Point>> {
    let near = |a: &Point, b: &Point| (0.0..GAP_S).contains(&(b.0 - a.0));
    values.chunk_by(near).map(<[Point]>::to_vec).collect()
}

/// The smallest range of these values and of those that are finite.
fn hull(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let finite = values.into_iter().filter(|value| value.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    })
}

fn widened((low, high): (f64, f64), by: f64) -> (f64, f64) {
    (low - by, high + by)
}

const fn level((from, to): (f64, f64), value: f64) -> [Point; 2] {
    [(from, value), (to, value)]
}

/// The curve of a result; none if its pass was not run.
pub fn row_curve(
    experiment: &Experiment,
    passes: &[PassData],
    expected: &ExpectedResult,
) -> Option<RowCurve> {
    let measurement = &expected.measure;
    let context = Context::new(experiment, passes, measurement)?;
    let value = single(experiment, passes, measurement);
    let (less, over) = references(experiment, passes, measurement);
    let shape = shape(&measurement.name);
    // A value of the table on the scale of the measure.
    let on_scale = |value: f64| value * over + less;
    let band = (
        expected.band.min.map_or(f64::NEG_INFINITY, on_scale),
        expected.band.max.map_or(f64::INFINITY, on_scale),
    );
    let stated = stated_value(&expected.thesis, &expected.band.unit).map(on_scale);
    let nearest = if value < band.0 { band.0 } else { band.1 };
    let goal = stated.filter(|stated| *stated != 0.0);
    let goal = goal.or(Some(nearest).filter(|end| end.is_finite()));

    let name = measurement.quantity.as_deref();
    let default = match &context.pass.teleoperation {
        Some(_) => "master_position",
        None => "tool_position",
    };
    let quantity = quantity(name.unwrap_or(default))?;
    // The sign of a magnitude: that of the value for the magnitude of a mean.
    let magnitude = matches!(
        &measurement.name[..],
        "mean_abs" | "max_abs" | "at_abs" | "time_after"
    );
    let sign = match &measurement.name[..] {
        "abs_mean" => mean(&context.values()).signum(),
        _ => 1.0,
    };
    let shown = |(time, value): Point| {
        let value = if magnitude { value.abs() } else { sign * value };
        (time, value)
    };
    let label = quantity.label.replace('@', ["x", "y", "z"][context.axis()]);
    let y_label = match (magnitude, shape) {
        (_, Shape::Fraction) => "part of the time so far".to_string(),
        (_, Shape::Value) => format!("result, {}", expected.band.unit),
        (true, _) => label.split_once(", ").map_or_else(
            || label.clone(),
            |(quantity, unit)| format!("|{quantity}|, {unit}"),
        ),
        (false, _) => label,
    };

    let values: Vec<Point> = match shape {
        Shape::Fraction => running_mean(&opposed(&context)),
        _ if name.is_none() => context.times().iter().map(|time| (*time, value)).collect(),
        _ => context.values().into_iter().map(shown).collect(),
    };
    let measured = hull(values.iter().map(|(time, _)| *time));
    let mut row = RowCurve {
        y_label,
        measured,
        goal,
        is_displacement: matches!(name, Some("compliant_displacement" | "lag" | "tool_error"))
            && matches!(shape, Shape::At | Shape::Extreme(_)),
        band: [ALL, band],
        x: widened(measured, BESIDE_S.max(BESIDE * (measured.1 - measured.0))),
        ..RowCurve::default()
    };
    let at_level = |row: &mut RowCurve, range: (f64, f64), mark: Point, base: f64| {
        row.simulated = level(range, mark.1).to_vec();
        row.mark = Some(mark);
        row.band[1] = (base + band.0, base + band.1);
        row.stated = stated
            .map(|stated| level(range, base + stated).to_vec())
            .unwrap_or_default();
    };
    let middle = (measured.0 + measured.1) / 2.0;
    match shape {
        Shape::Level => {
            // Two windows may have a gap in the middle between them.
            let times = values.iter().map(|(time, _)| *time);
            let inside = times.min_by(|a, b| (a - middle).abs().total_cmp(&(b - middle).abs()));
            at_level(&mut row, measured, (inside.unwrap_or(middle), value), 0.0);
        }
        Shape::Extreme(sign) => {
            let mark = (time_of_max(&values, sign), value);
            at_level(&mut row, measured, mark, 0.0);
        }
        Shape::Spread => {
            let mark = (time_of_max(&values, 1.0), largest(&values));
            at_level(&mut row, measured, mark, smallest(&values));
        }
        Shape::Slope => {
            let duration = measured.1 - measured.0;
            let sign = slope(&values).signum();
            let start = mean(&values) - slope(&values) * duration / 2.0;
            let end = |rate: f64| start + sign * rate * duration;
            row.simulated = vec![(measured.0, start), (measured.1, end(value))];
            row.mark = Some((measured.1, end(value)));
            let ends = (end(band.0), end(band.1));
            row.band[1] = (ends.0.min(ends.1), ends.0.max(ends.1));
        }
        Shape::At => {
            let at = measurement.at_s.unwrap_or(f64::NAN);
            row.x = (0.0, at * (1.0 + 2.0 * BESIDE));
            row.measured = (at, at);
            let x = row.x;
            at_level(&mut row, x, (at, value), 0.0);
        }
        Shape::Time => {
            row.band = [band, ALL];
            let times = [band.0, band.1, value, stated.unwrap_or(f64::NAN)];
            let range = hull(times);
            row.x = widened(range, BESIDE_TIME_S.max(0.5 * (range.1 - range.0)));
            row.mark = mark_on(&context.curve(quantity, row.x.0, row.x.1), value).map(shown);
            row.stated = stated.map(vertical).unwrap_or_default();
            row.simulated = vertical(value);
        }
        Shape::Change | Shape::After => {
            let (start, beside) = if shape == Shape::Change {
                let first = values.first().map_or(f64::NAN, |(_, value)| *value);
                let at_10 = first + 0.1 * (largest(&values) - first);
                let start = values.iter().find(|(_, value)| *value >= at_10);
                (start.map_or(f64::NAN, |(time, _)| *time), BESIDE_CHANGE_S)
            } else {
                (context.event_time(), 1.0)
            };
            row.band = [(start + band.0.max(0.0), start + band.1), ALL];
            let times = [
                start,
                start + value,
                start + band.0.max(0.0),
                start + band.1,
            ];
            row.x = widened(hull(times), beside);
            row.mark = mark_on(&context.curve(quantity, row.x.0, row.x.1), start + value);
            row.mark = row.mark.map(shown);
            row.stated = stated
                .map(|stated| vertical(start + stated))
                .unwrap_or_default();
            row.simulated = vertical(start + value);
        }
        Shape::Fraction | Shape::Value => {
            at_level(&mut row, measured, (measured.1, value), 0.0);
        }
    }
    if !row.x.0.is_finite() || !row.x.1.is_finite() || row.x.0 >= row.x.1 {
        row.x = (0.0, 1.0);
    }
    row.measured_pieces = pieces(&values);
    if !matches!(shape, Shape::Fraction | Shape::Value) {
        let all = context.curve(quantity, row.x.0, row.x.1);
        row.all = all.into_iter().map(shown).collect();
    }
    for elsewhere in measurement.less.iter().chain(&measurement.over) {
        let moved = measurement.moved_to(elsewhere);
        let context = Context::new(experiment, passes, &moved)?;
        if shape == Shape::At {
            row.reference
                .push(context.curve(quantity, row.x.0, row.x.1));
            continue;
        }
        let values: Vec<Point> = context.values().into_iter().map(shown).collect();
        let range = hull(values.iter().map(|(time, _)| *time));
        row.x = (row.x.0.min(range.0), row.x.1.max(range.1));
        row.reference.extend(pieces(&values));
    }
    Some(row)
}

impl RowCurve {
    /// Range of the vertical axis: curves, ends of the band, stated and simulated value.
    pub fn y(&self) -> (f64, f64) {
        let pieces = self.measured_pieces.iter().chain(&self.reference);
        let curves = pieces.flatten().chain(&self.all);
        let inside = curves.filter(|(time, _)| (self.x.0..=self.x.1).contains(time));
        let lines = self.stated.iter().chain(&self.simulated).chain(&self.mark);
        let [_, band] = self.band;
        let values = inside.chain(lines).map(|(_, value)| *value);
        // The lines of a time have the whole height.
        let (low, high) = hull(values.chain([band.0, band.1]));
        if low > high {
            return (0.0, 1.0);
        }
        widened((low, high), BESIDE * (high - low).max(1e-6))
    }
}

/// The point of a curve at a time.
fn mark_on(curve: &[Point], time: f64) -> Option<Point> {
    let index = curve.partition_point(|(at, _)| *at < time);
    curve.get(index).copied()
}

/// A line at a time over the whole height.
fn vertical(time: f64) -> Vec<Point> {
    vec![(time, f64::NEG_INFINITY), (time, f64::INFINITY)]
}

/// Mean of the values so far.
fn running_mean(values: &[Point]) -> Vec<Point> {
    let mut sum = 0.0;
    let so_far = (1_u32..).zip(values).map(|(count, (time, value))| {
        sum += value;
        (*time, sum / f64::from(count))
    });
    so_far.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_statement_that_is_one_number_is_a_value() {
        for (thesis, unit, value) in [
            ("6 mm", "mm", 6.0),
            ("about 0.2 s", "s", 0.2),
            ("+6 N", "N", 6.0),
            ("-3 N", "N", -3.0),
            ("about 0", "mm", 0.0),
            ("at most 5 N", "N", 5.0),
        ] {
            assert_eq!(stated_value(thesis, unit), Some(value), "{thesis}");
        }
        for thesis in [
            "3 to 7 N",
            "+",
            "opposes",
            "",
            "oscillates at 5 mm",
            "to -7 N",
        ] {
            assert_eq!(stated_value(thesis, "N"), None, "{thesis}");
        }
    }

    #[test]
    fn windows_are_separate_pieces() {
        let values = [(0.0, 1.0), (0.001, 1.0), (1.0, 2.0), (0.5, 3.0)];
        let lengths: Vec<usize> = pieces(&values).iter().map(Vec::len).collect();
        assert_eq!(lengths, [2, 1, 1]);
    }

    #[test]
    fn a_running_mean_ends_at_the_mean() {
        let values = [(0.0, 1.0), (1.0, 0.0), (2.0, 1.0), (3.0, 1.0)];
        let means = running_mean(&values);
        assert_eq!(means.last(), Some(&(3.0, mean(&values))));
        assert_eq!(means[1], (1.0, 0.5));
    }
}
