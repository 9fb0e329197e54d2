//! Bands of expected results and their origin.

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
