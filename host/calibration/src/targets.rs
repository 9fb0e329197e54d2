//! Target positions of ISO 230-2, and the evaluation of its cycles.

use crate::noise::Noise;

/// Part of the interval within which a target is displaced at random, so that periodic errors of
/// the screw show.
pub const RANDOM: f64 = 0.3;

/// Runs in each direction.
pub const RUNS: usize = 5;

/// Least number of targets per metre of travel, and the interval beyond 2 m.
const PER_METRE: f64 = 5.0;
const LONG_TRAVEL: f64 = 2000.0;
const LONG_INTERVAL: f64 = 250.0;

/// Target positions over a travel, mm, ascending: P_i = (i - 1) p + r, with the interval p as near
/// to `interval` as the travel allows, and another r at each target. At most 200 mm apart up to 2 m
/// of travel, 250 mm beyond.
#[must_use]
pub fn targets((low, high): (f64, f64), interval: f64, noise: &mut Noise) -> Vec<f64> {
    let travel = high - low;
    let interval = if travel > LONG_TRAVEL {
        LONG_INTERVAL
    } else {
        interval.min(1000.0 / PER_METRE)
    };
    // The outermost targets keep within the travel.
    let spans = (travel / (interval * (1.0 + 2.0 * RANDOM / 10.0)))
        .round()
        .max(4.0) as usize;
    let margin = RANDOM / (spans as f64 + 2.0 * RANDOM);
    let interval = travel * (1.0 - 2.0 * margin) / spans as f64;
    (0..=spans)
        .map(|index| {
            let even = low + travel * margin + interval * index as f64;
            let placed = even + RANDOM * interval * noise.uniform();
            // To the nanometre, as a part program writes it.
            (placed.clamp(low, high) * 1e6).round() / 1e6
        })
        .collect()
}

/// Deviations at one target, in one direction: one value for each run.
pub type Deviations = Vec<f64>;

/// Result of ISO 230-2 for one axis, in the unit of the deviations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Positioning {
    /// Accuracy A, bidirectional.
    pub accuracy: f64,
    /// Repeatability R, bidirectional: the largest R_i.
    pub repeatability: f64,
    /// Reversal value B: the largest difference between the directions.
    pub reversal: f64,
    /// Systematic deviation E, bidirectional.
    pub systematic: f64,
    /// Range M of the mean deviations of both directions.
    pub range: f64,
}

/// Mean and standard deviation (n - 1) of the values of one target.
#[must_use]
pub fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values
        .iter()
        .map(|value| (value - mean) * (value - mean))
        .sum();
    (mean, (squares / (count - 1.0).max(1.0)).sqrt())
}

/// Evaluates an axis from its deviations upwards and downwards at every target.
#[must_use]
pub fn evaluate(up: &[Deviations], down: &[Deviations]) -> Positioning {
    let mut result = Positioning::default();
    let mut extremes = [f64::INFINITY, f64::NEG_INFINITY];
    let mut means = extremes;
    let mut both = extremes;
    let widen = |limits: &mut [f64; 2], value: f64| {
        *limits = [limits[0].min(value), limits[1].max(value)];
    };
    for (up, down) in up.iter().zip(down) {
        let (mean_up, s_up) = mean_and_deviation(up);
        let (mean_down, s_down) = mean_and_deviation(down);
        let reversal = mean_up - mean_down;
        result.reversal = result.reversal.max(reversal.abs());
        let bidirectional = 2.0 * s_up + 2.0 * s_down + reversal.abs();
        let repeatability = bidirectional.max(4.0 * s_up).max(4.0 * s_down);
        result.repeatability = result.repeatability.max(repeatability);
        for (mean, s) in [(mean_up, s_up), (mean_down, s_down)] {
            widen(&mut extremes, mean + 2.0 * s);
            widen(&mut extremes, mean - 2.0 * s);
            widen(&mut means, mean);
        }
        widen(&mut both, 0.5 * (mean_up + mean_down));
    }
    result.accuracy = (extremes[1] - extremes[0]).max(0.0);
    result.systematic = (means[1] - means[0]).max(0.0);
    result.range = (both[1] - both[0]).max(0.0);
    result
}
