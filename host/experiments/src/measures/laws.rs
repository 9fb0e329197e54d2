//! Measures of motion and of the laws of the controller.

use super::CIRCLE_MM;
use super::context::Context;
use super::statistics::{Point, mean};
use crate::sampled_trace::Sample;
use haptimill_client::session::HapticTraceSample;

/// Samples on either side over which a rate is taken.
const RATE_SAMPLES: usize = 5;

/// Feed of E11, mm/s, and the speed along an axis above which the direction of a force counts.
const CIRCLE_FEED: f64 = 4.0;
const CLEAR_SPEED: f64 = 2.0;

pub(super) fn mean_speed(context: &Context) -> f64 {
    let (from, to) = context.bounds(&context.windows()[0]);
    (context.value_at(to) - context.value_at(from)).abs() / (to - from)
}

pub(super) fn time_after(context: &Context) -> f64 {
    let event = context.event_time();
    let threshold = context.measurement.threshold.unwrap_or(f64::NAN);
    let values = context.magnitudes();
    let last = values.iter().rev().find(|(_, value)| *value > threshold);
    let after = last.map_or(0.0, |(time, _)| *time) - event;
    if after < 0.0 { 0.0 } else { after }
}

/// Difference of both sides of equation (3.30) along x, integrated over the window from the start
/// of compliance on, in percent.
pub(super) fn admittance_law_residual(context: &Context) -> f64 {
    let Some(control) = &context.pass.force_control else {
        return f64::NAN;
    };
    let samples = context.programmed_samples();
    let displacement = |index: usize| samples[index].compliant_displacement[0];
    let rate = |index: usize| {
        let (before, after) = (index - RATE_SAMPLES, index + RATE_SAMPLES);
        (displacement(after) - displacement(before)) / (samples[after].time - samples[before].time)
    };
    let first = (0..samples.len()).position(|index| displacement(index) > 0.05);
    let last = samples.len().saturating_sub(1 + RATE_SAMPLES);
    let Some(first) = first.map(|first| first.max(RATE_SAMPLES)) else {
        return f64::NAN;
    };
    if last <= first {
        return f64::NAN;
    }
    let (a, b) = (&samples[first], &samples[last]);
    let force = b.impulse - a.impulse - control.setpoint_n * (b.time - a.time);
    let motion = control.virtual_damping * (displacement(last) - displacement(first))
        + control.virtual_mass * (rate(last) - rate(first));
    100.0 * (force / motion - 1.0)
}

/// Force feedback along an axis in percent of the force on the tool, mean over the samples in
/// which it is at least 0.5 N and below 90 % of its limit.
pub(super) fn feedback_ratio(context: &Context) -> f64 {
    let axis = context.axis();
    let Some(teleoperation) = &context.pass.teleoperation else {
        return f64::NAN;
    };
    let feedback = teleoperation.feedback.axes()[axis];
    let (percent, limit) = (f64::from(feedback.percent), feedback.limit_n);
    let counts = |sample: &HapticTraceSample| {
        let force = sample.high[axis].abs() * percent / 100.0;
        (0.5..limit * 0.9).contains(&force)
    };
    let mut samples = context.teleoperated_samples();
    samples.retain(counts);
    let sum = |value: &dyn Fn(&HapticTraceSample) -> f64| samples.iter().map(value).sum::<f64>();
    100.0 * sum(&|s| s.feedback[axis]) / sum(&|s| s.high[axis])
}

/// Fraction of the samples of E11 with a clear motion along an axis in which the peak force is
/// opposite to it. The speed is that of the circle x = -15 + 15 cos wt, y = -15 sin wt.
pub(super) fn opposed_fraction(context: &Context) -> f64 {
    mean(&opposed(context))
}

/// Time of these samples, and 1 where the force is opposite to the motion, else 0.
pub(super) fn opposed(context: &Context) -> Vec<Point> {
    let axis = context.axis();
    let speed = |sample: &Sample| match axis {
        0 => CIRCLE_FEED / CIRCLE_MM * sample.commanded[1],
        _ => -CIRCLE_FEED / CIRCLE_MM * (sample.commanded[0] + CIRCLE_MM),
    };
    let samples = context.programmed_samples();
    let fast = samples.iter().filter(|s| speed(s).abs() > CLEAR_SPEED);
    let opposed = fast.map(|s| (s.time, f64::from(s.peak_force[axis] * speed(s) < 0.0)));
    opposed.collect()
}
