//! Numbers that the thesis and its paper state, read from the data file.

use serde::Deserialize;

/// Numbers of the thesis and its paper: `data/thesis.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Stated {
    pub(super) figure_4_8_air_mm: [f64; 5],
    pub(super) cutting_test: Vec<CuttingTest>,
    pub(super) paper: Vec<PaperJob>,
    pub(super) from_rules: FromRules,
}

impl Stated {
    /// Reads the built-in numbers.
    pub(super) fn read() -> Result<Self, String> {
        toml::from_str(include_str!("../../data/thesis.toml"))
            .map_err(|error| format!("host/engrave/data/thesis.toml: {error}"))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CuttingTest {
    pub(super) figure: String,
    pub(super) job: String,
    /// The text and the height of its letters; none for a picture.
    pub(super) text: Option<String>,
    pub(super) height_mm: Option<f64>,
    pub(super) plain_min: f64,
    pub(super) analysed_min: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PaperJob {
    pub(super) figure: String,
    /// The text and the height of its letters; none for the five squares.
    pub(super) text: Option<String>,
    pub(super) height_mm: Option<f64>,
    pub(super) plain_s: f64,
    pub(super) analysed_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FromRules {
    pub(super) squares_air_mm: [String; 5],
    pub(super) pocket: [ExpectedPocket; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExpectedPocket {
    pub(super) name: String,
    pub(super) rows: usize,
    pub(super) plain: String,
    pub(super) analysed: String,
    pub(super) saved: String,
}
