//! Measures of the expected results, chosen by name, and the quantities that they measure.
//!
//! Positions are in mm, forces in N, times in s. Times of a programmed pass count from the first
//! motion along x or y, those of a teleoperated pass from the start of the operator trajectory.
//! Positions of a teleoperated pass count from where master and tool are at that time.
//! A measure is not a number when nothing can be measured; such a result is outside of every band.

mod admittance;
mod causes;
mod context;
mod laws;
mod revolution;
mod row_curve;
mod statistics;
mod surface;
#[cfg(test)]
mod tests;

pub(super) use causes::{CauseCurves, cause_curves, check_cause};
pub(super) use row_curve::{RowCurve, row_curve};

use super::definition::{Experiment, Measurement, Pass};
use super::pass_data::PassData;
use super::sampled_trace::Sample;
use context::Context;
use haptimill_client::session::HapticTraceSample;
use laws::{admittance_law_residual, feedback_ratio, mean_speed, opposed_fraction, time_after};
use statistics::{change_time, first_time, largest, mean, slope, smallest, time_of_max, worst};

/// Circle of E11 and E12: x of its centre and radius, mm.
const CIRCLE_MM: f64 = 15.0;

/// A quantity of a sample.
struct Quantity {
    name: &'static str,
    /// Label with unit; `@` stands for the axis.
    label: &'static str,
    /// It needs the key `axis`.
    has_axis: bool,
    programmed: Option<fn(&Sample, usize) -> f64>,
    teleoperated: Option<fn(&HapticTraceSample, usize) -> f64>,
}

const fn programmed(
    name: &'static str,
    label: &'static str,
    has_axis: bool,
    value: fn(&Sample, usize) -> f64,
) -> Quantity {
    Quantity {
        name,
        label,
        has_axis,
        programmed: Some(value),
        teleoperated: None,
    }
}

const fn teleoperated(
    name: &'static str,
    label: &'static str,
    has_axis: bool,
    value: fn(&HapticTraceSample, usize) -> f64,
) -> Quantity {
    Quantity {
        name,
        label,
        has_axis,
        programmed: None,
        teleoperated: Some(value),
    }
}

/// Deviation of the tool from commanded position plus compliant displacement.
fn following_error(sample: &HapticTraceSample, axis: usize) -> f64 {
    (sample.tool[axis] - sample.commanded[axis] - sample.displacement[axis]).abs()
}

const QUANTITIES: &[Quantity] = &[
    Quantity {
        name: "peak_force",
        label: "peak F@, N",
        has_axis: true,
        programmed: Some(|sample, axis| sample.peak_force[axis]),
        teleoperated: Some(|sample, axis| sample.high[axis]),
    },
    Quantity {
        name: "compliant_displacement",
        label: "p_c in @, mm",
        has_axis: true,
        programmed: Some(|sample, axis| sample.compliant_displacement[axis]),
        teleoperated: Some(|sample, axis| sample.displacement[axis]),
    },
    programmed("low_force", "low F@, N", true, |sample, axis| {
        sample.low_force[axis]
    }),
    programmed(
        "tool_position",
        "@ of the tool, mm",
        true,
        |sample, axis| sample.tool[axis],
    ),
    // By how much the tool is behind, towards the positive end, of the commanded position.
    programmed(
        "lag",
        "tool minus commanded @, mm",
        true,
        Sample::tool_error,
    ),
    programmed("tool_error_xy", "tool error, mm", false, |sample, _| {
        let error = |axis: usize| sample.tool_error(axis).abs();
        error(0).max(error(1))
    }),
    teleoperated(
        "tool_error",
        "tool minus commanded @, mm",
        true,
        |sample, axis| sample.tool[axis] - sample.commanded[axis],
    ),
    teleoperated(
        "following_error",
        "tool error less p_c in @, mm",
        true,
        following_error,
    ),
    teleoperated(
        "following_error_xy",
        "tool error less p_c, mm",
        false,
        |sample, _| following_error(sample, 0).max(following_error(sample, 1)),
    ),
    // Travels count towards the negative end.
    teleoperated(
        "tool_travel",
        "travel of the tool in @, mm",
        true,
        |sample, axis| -sample.tool[axis],
    ),
    teleoperated(
        "master_travel",
        "travel of the hand in @, mm",
        true,
        |sample, axis| -sample.master[axis],
    ),
    teleoperated(
        "master_position",
        "@ of the hand, mm",
        true,
        |sample, axis| sample.master[axis],
    ),
    teleoperated(
        "master_speed",
        "speed of the hand in @, mm/s",
        true,
        |sample, axis| sample.velocity[axis].abs(),
    ),
    teleoperated(
        "rail_deviation",
        "distance from the rail, mm",
        false,
        |sample, _| sample.master[1].abs().max(sample.master[2].abs()),
    ),
    teleoperated(
        "circle_deviation",
        "distance from the circle, mm",
        false,
        |sample, _| {
            let [x, y, _] = sample.master;
            (((x + CIRCLE_MM).powi(2) + y.powi(2)).sqrt() - CIRCLE_MM).abs()
        },
    ),
    teleoperated(
        "feedback_force",
        "force feedback in @, N",
        true,
        |sample, axis| sample.feedback[axis],
    ),
    teleoperated(
        "feedback_force_xy",
        "force feedback in X and Y, N",
        false,
        |sample, _| sample.feedback[0].hypot(sample.feedback[1]),
    ),
];

/// Key of a [`Measurement`] that a measure needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Key {
    Quantity,
    Axis,
    Windows,
    AtS,
    Event,
    Threshold,
    DepthMm,
    PointsMm,
    SectionsMm,
}

/// A measure.
struct Measure {
    name: &'static str,
    needs: &'static [Key],
    evaluate: fn(&Context) -> f64,
}

const fn measure(
    name: &'static str,
    needs: &'static [Key],
    evaluate: fn(&Context) -> f64,
) -> Measure {
    Measure {
        name,
        needs,
        evaluate,
    }
}

/// All measures. `windows` and `settled` select the samples of those that take samples.
const MEASURES: &[Measure] = &[
    // Statistics of a quantity.
    measure("mean", &[Key::Quantity], |c| mean(&c.values())),
    measure("abs_mean", &[Key::Quantity], |c| mean(&c.values()).abs()),
    measure("mean_abs", &[Key::Quantity], |c| mean(&c.magnitudes())),
    measure("max", &[Key::Quantity], |c| largest(&c.values())),
    measure("min", &[Key::Quantity], |c| smallest(&c.values())),
    measure("max_abs", &[Key::Quantity], |c| largest(&c.magnitudes())),
    measure("spread", &[Key::Quantity], |c| {
        largest(&c.values()) - smallest(&c.values())
    }),
    // Slope of the least-squares line, per second.
    measure("slope", &[Key::Quantity], |c| slope(&c.values())),
    // Value at a time, and its magnitude.
    measure("at", &[Key::Quantity, Key::AtS], |c| c.at()),
    measure("at_abs", &[Key::Quantity, Key::AtS], |c| c.at().abs()),
    // Change of a quantity over a window, divided by its duration.
    measure("mean_speed", &[Key::Quantity, Key::Windows], mean_speed),
    // Times.
    measure("start_time", &[], |c| {
        c.times().first().copied().unwrap_or(f64::NAN)
    }),
    measure("end_time", &[], |c| {
        c.times().last().copied().unwrap_or(f64::NAN)
    }),
    measure("time_of_max", &[Key::Quantity], |c| {
        time_of_max(&c.values(), 1.0)
    }),
    measure("time_of_min", &[Key::Quantity], |c| {
        time_of_max(&c.values(), -1.0)
    }),
    measure("first_below", &[Key::Quantity, Key::Threshold], |c| {
        let threshold = c.measurement.threshold.unwrap_or(f64::NAN);
        first_time(&c.values(), |value| value < threshold)
    }),
    // First time above 95 % of the largest value.
    measure("rise_time", &[Key::Quantity], |c| {
        let values = c.values();
        let peak = largest(&values);
        first_time(&values, |value| value > 0.95 * peak)
    }),
    // Time in which a rising quantity goes from 10 to 90 % of the way from its start to its largest
    // value.
    measure("change_time", &[Key::Quantity, Key::Windows], |c| {
        change_time(&c.values())
    }),
    measure("event_time", &[Key::Event], |c| c.event_time()),
    // How long after an event the magnitude is above a threshold for the last time; 0 for never.
    measure(
        "time_after",
        &[Key::Quantity, Key::Event, Key::Threshold],
        time_after,
    ),
    // Laws of the controller.
    measure(
        "admittance_law_residual",
        &[Key::Windows],
        admittance_law_residual,
    ),
    measure("feedback_ratio", &[Key::Axis], feedback_ratio),
    measure("opposed_fraction", &[Key::Axis], opposed_fraction),
    // The cut surface.
    measure("surface_depth", &[Key::PointsMm], surface::depth),
    measure("depth_gradient", &[Key::PointsMm], surface::depth_gradient),
    measure(
        "depth_error",
        &[Key::PointsMm, Key::DepthMm],
        surface::depth_error,
    ),
    measure("groove_length", &[Key::DepthMm], surface::groove_length),
    measure(
        "groove_width_error",
        &[Key::SectionsMm, Key::DepthMm],
        surface::groove_width_error,
    ),
    measure(
        "groove_depth_error",
        &[Key::SectionsMm, Key::DepthMm],
        surface::groove_depth_error,
    ),
    measure("ring_extent", &[Key::Axis], surface::ring_extent),
    measure("ring_roundness", &[], surface::ring_roundness),
    measure(
        "ring_width_error",
        &[Key::DepthMm],
        surface::ring_width_error,
    ),
];

fn find<'a, T>(table: &'a [T], name: &str, name_of: fn(&T) -> &'static str) -> Option<&'a T> {
    table.iter().find(|entry| name_of(entry) == name)
}

fn quantity(name: &str) -> Option<&'static Quantity> {
    find(QUANTITIES, name, |quantity| quantity.name)
}

/// Checks that a measurement names a measure and a quantity, and has the keys that they need.
///
/// # Errors
/// The key, and what is wrong with it.
pub(super) fn check(measurement: &Measurement, pass: &Pass) -> Result<(), String> {
    let measure = find(MEASURES, &measurement.name, |measure| measure.name);
    let measure =
        measure.ok_or_else(|| format!("name: there is no measure \"{}\"", measurement.name))?;
    let is_teleoperated = pass.teleoperation.is_some();
    for key in measure.needs {
        let (name, is_present) = match key {
            Key::Quantity => ("quantity", measurement.quantity.is_some()),
            Key::Axis => ("axis", measurement.axis.is_some()),
            Key::Windows => ("windows", !measurement.windows.is_empty()),
            Key::AtS => ("at_s", measurement.at_s.is_some()),
            Key::Event => ("event", measurement.event.is_some()),
            Key::Threshold => ("threshold", measurement.threshold.is_some()),
            Key::DepthMm => ("depth_mm", measurement.depth_mm.is_some()),
            Key::PointsMm => ("points_mm", !measurement.points_mm.is_empty()),
            Key::SectionsMm => ("sections_mm", !measurement.sections_mm.is_empty()),
        };
        if !is_present {
            return Err(format!("{name} is missing"));
        }
    }
    if measurement.event.is_some() && !is_teleoperated {
        return Err("event: programmed passes have no events".to_string());
    }
    let Some(name) = &measurement.quantity else {
        return Ok(());
    };
    let quantity =
        quantity(name).ok_or_else(|| format!("quantity: there is no quantity \"{name}\""))?;
    let (is_recorded, passes) = if is_teleoperated {
        (quantity.teleoperated.is_some(), "teleoperated")
    } else {
        (quantity.programmed.is_some(), "programmed")
    };
    if !is_recorded {
        let problem = format!("\"{name}\" is not recorded in {passes} passes");
        return Err(format!("quantity: {problem}"));
    }
    match (quantity.has_axis, measurement.axis) {
        (true, None) => Err("axis is missing".to_string()),
        (false, Some(_)) => Err(format!("axis: quantity \"{name}\" has no axis")),
        _ => Ok(()),
    }
}

/// Measures a result on the passes of an experiment.
pub(super) fn evaluate(
    experiment: &Experiment,
    passes: &[PassData],
    measurement: &Measurement,
) -> f64 {
    let (less, over) = references(experiment, passes, measurement);
    (single(experiment, passes, measurement) - less) / over
}

/// What is subtracted from a measure, and what divides it.
fn references(
    experiment: &Experiment,
    passes: &[PassData],
    measurement: &Measurement,
) -> (f64, f64) {
    let elsewhere = |at| single(experiment, passes, &measurement.moved_to(at));
    let less = match &measurement.less[..] {
        [] => 0.0,
        less => worst(less.iter().map(elsewhere)),
    };
    (less, measurement.over.as_ref().map_or(1.0, elsewhere))
}

/// A measure without its references.
fn single(experiment: &Experiment, passes: &[PassData], measurement: &Measurement) -> f64 {
    let measure = find(MEASURES, &measurement.name, |measure| measure.name);
    match (Context::new(experiment, passes, measurement), measure) {
        (Some(context), Some(measure)) => (measure.evaluate)(&context),
        _ => f64::NAN,
    }
}
