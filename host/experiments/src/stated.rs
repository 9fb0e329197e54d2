//! What the thesis states, the band that counts as reproduced, and what came out here.

use super::rounded;
use serde::Serialize;
use std::fmt;

/// Where a band comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// The thesis states the bound or the range itself.
    Stated,
    /// Derived from the stated numbers (docs/control.md 4.2).
    Derived,
    /// Not of the thesis: what this project asks of itself.
    Own,
}

impl fmt::Display for Source {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Stated => "stated",
            Self::Derived => "derived",
            Self::Own => "own",
        })
    }
}

/// A band; an open end is infinite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Band {
    /// Lower end.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// Where it comes from.
    pub source: Source,
}

impl Band {
    /// Whether a value lies in it; what is no number does not.
    #[must_use]
    pub fn holds(&self, value: f64) -> bool {
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

/// A number of the thesis, and ours.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Claim {
    /// What is measured.
    pub what: String,
    /// What the thesis says of it.
    pub stated: String,
    /// What counts as reproduced.
    pub band: Band,
    /// What came out here.
    pub ours: f64,
    /// Unit of band and value.
    pub unit: &'static str,
    /// Ours lies in the band.
    pub inside: bool,
    /// Why it does not.
    pub reason: Option<String>,
}

/// A claim whose band is still to come.
pub(super) struct Measured {
    what: String,
    stated: String,
    ours: f64,
    unit: &'static str,
}

/// Begins a claim: what is measured, what the thesis says, what came out.
pub(super) fn measured(
    what: impl Into<String>,
    stated: impl Into<String>,
    ours: f64,
    unit: &'static str,
) -> Measured {
    Measured {
        what: what.into(),
        stated: stated.into(),
        ours: rounded(ours),
        unit,
    }
}

impl Measured {
    fn claim(self, low: Option<f64>, high: Option<f64>, source: Source) -> Claim {
        let band = Band { low, high, source };
        Claim {
            inside: band.holds(self.ours),
            what: self.what,
            stated: self.stated,
            ours: self.ours,
            unit: self.unit,
            band,
            reason: None,
        }
    }

    /// Within a band.
    pub(super) fn within(self, low: f64, high: f64, source: Source) -> Claim {
        self.claim(Some(low), Some(high), source)
    }

    /// At most.
    pub(super) fn at_most(self, high: f64, source: Source) -> Claim {
        self.claim(None, Some(high), source)
    }

    /// At least.
    pub(super) fn at_least(self, low: f64, source: Source) -> Claim {
        self.claim(Some(low), None, source)
    }
}

impl Claim {
    /// The reason, told when it is outside.
    pub(super) fn because(mut self, why: &str) -> Self {
        if !self.inside {
            self.reason = Some(why.to_string());
        }
        self
    }
}
