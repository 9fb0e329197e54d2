//! Expected results, their bands, and the comparison with the results of the simulator.

use super::definition::ExpectedResult;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Origin of a band.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExpectedSource {
    /// The thesis states the bound or the range itself.
    Stated,
    /// Derived from the numbers of the thesis (docs/control.md 4.2).
    Derived,
    /// A requirement of this project.
    Own,
}

impl fmt::Display for ExpectedSource {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Stated => "stated",
            Self::Derived => "derived",
            Self::Own => "own",
        })
    }
}

/// Range of values that reproduce an expected result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Band {
    /// Lower end, or none.
    pub low: Option<f64>,
    /// Upper end, or none.
    pub high: Option<f64>,
    /// Origin.
    pub source: ExpectedSource,
}

impl Band {
    /// Whether a value is finite and within both ends.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        value.is_finite()
            && self.low.is_none_or(|low| value >= low)
            && self.high.is_none_or(|high| value <= high)
    }
}

impl fmt::Display for Band {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.low, self.high) {
            (Some(low), Some(high)) => write!(out, "{low} to {high}"),
            (None, Some(high)) => write!(out, "at most {high}"),
            (Some(low), None) => write!(out, "at least {low}"),
            (None, None) => write!(out, "any"),
        }
    }
}

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
        }
    }
}

/// Rounds to 1e-4, the resolution of all results.
pub(super) fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
