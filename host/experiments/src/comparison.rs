//! Comparison of expected results with the results of the simulator.

use super::definition::ExpectedResult;
use super::expected::Band;
use serde::Serialize;

/// An expected result beside the result of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the result.
    #[serde(rename = "what")]
    pub name: String,
    /// Statement of the thesis; empty when it makes none.
    #[serde(rename = "stated")]
    pub thesis: String,
    /// Range that reproduces it.
    pub band: Band,
    /// Value from the simulator, rounded to 1e-4.
    #[serde(rename = "ours")]
    pub simulated: f64,
    /// Unit of band and value.
    pub unit: String,
    /// The value is in the band.
    #[serde(rename = "inside")]
    pub is_inside: bool,
    /// Why it is not.
    pub reason: Option<String>,
    /// The result is an input: the pace of the operator was chosen for it.
    #[serde(rename = "input", skip_serializing_if = "std::ops::Not::not")]
    pub is_input: bool,
}

impl Comparison {
    /// Compares a simulated value with an expected result; `reason` is kept only when the value is
    /// outside the band.
    #[must_use]
    pub fn new(expected: &ExpectedResult, simulated: f64, reason: Option<&str>) -> Self {
        let simulated = rounded(simulated);
        let band = expected.band.range();
        let is_inside = band.contains(simulated);
        Self {
            name: expected.name.clone(),
            thesis: expected.thesis.clone(),
            band,
            simulated,
            unit: expected.band.unit.clone(),
            is_inside,
            reason: reason.filter(|_| !is_inside).map(str::to_string),
            is_input: expected.input,
        }
    }
}

/// Rounds to 1e-4, the resolution of all results.
pub(super) fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
