//! Results of experiments and passes; `summary.json` has these fields.

use super::comparison::{Comparison, rounded};
use super::definition::{Experiment, ForceControl};
use super::expected::ExpectedSource;
use super::measures;
use super::pass_data::PassData;
use super::sampled_trace::ForceSource;
use serde::Serialize;

/// Result of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExperimentResult {
    /// Name of the experiment.
    #[serde(rename = "scenario")]
    pub name: String,
    /// Title of the experiment.
    pub title: String,
    /// The cutting forces or the operator are fitted to it; the others are held out.
    pub fitted: bool,
    /// Why it was not run; the rest is empty then.
    pub not_run: Option<String>,
    /// Results of the passes.
    pub passes: Vec<PassResult>,
    /// Expected results beside those of the simulator.
    #[serde(rename = "claims")]
    pub comparisons: Vec<Comparison>,
}

/// Result of a pass.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PassResult {
    /// Name of its folder.
    pub name: String,
    /// Part program.
    pub program: String,
    /// Stock file.
    #[serde(rename = "work")]
    pub stock: String,
    /// Force control.
    #[serde(rename = "control")]
    pub force_control: Option<ForceControl>,
    /// Origin of the forces.
    pub forces: ForceSource,
    /// Duration of the job, s.
    pub duration_s: f64,
    /// Largest tool error at the same time, mm; none under force control.
    pub tool_error_max_mm: Option<f64>,
    /// Removed material, mm^3.
    pub removed_mm3: f64,
    /// SHA-256 of the recording.
    pub trace_sha256: String,
}

impl ExperimentResult {
    /// Measures the passes of an experiment and compares them with the expected results.
    #[must_use]
    pub fn new(experiment: &Experiment, data: &[PassData]) -> Self {
        let passes = experiment.passes.iter().zip(data);
        let passes = passes.map(|(pass, data)| PassResult {
            name: pass.name.clone(),
            program: pass.program_name().to_string(),
            stock: pass.stock.clone(),
            force_control: pass.force_control.clone(),
            forces: data.trace.source,
            duration_s: rounded(data.summary.duration_s),
            tool_error_max_mm: pass
                .force_control
                .is_none()
                .then(|| rounded(data.summary.tool_error_max_mm)),
            removed_mm3: rounded(data.stock.removed_mm3()),
            trace_sha256: data.summary.trace_sha256.clone(),
        });
        let comparisons = experiment.expected.iter().map(|expected| {
            let simulated = measures::evaluate(experiment, data, &expected.measure);
            let reason = experiment.reason_of(expected);
            Comparison::new(expected, simulated, reason.map(|reason| &reason.text[..]))
        });
        Self {
            passes: passes.collect(),
            comparisons: comparisons.collect(),
            ..Self::not_run_with(experiment, None)
        }
    }

    /// Result of an experiment that a machine cannot run, with the reason.
    #[must_use]
    pub fn not_run(experiment: &Experiment, reason: &str) -> Self {
        Self::not_run_with(experiment, Some(reason.to_string()))
    }

    fn not_run_with(experiment: &Experiment, not_run: Option<String>) -> Self {
        Self {
            name: experiment.name.clone(),
            title: experiment.title.clone(),
            fitted: experiment.fitted,
            not_run,
            passes: Vec::new(),
            comparisons: Vec::new(),
        }
    }

    /// Number of results inside their bands.
    #[must_use]
    pub fn inside(&self) -> usize {
        let inside = self.comparisons.iter().filter(|result| result.is_inside);
        inside.count()
    }

    /// Results that are no inputs, of a source: those inside their bands, and all.
    #[must_use]
    pub fn count_of(&self, source: ExpectedSource) -> (usize, usize) {
        self.count(|result| result.band.source == source && !result.is_input)
    }

    /// Results that are inputs: those inside their bands, and all.
    #[must_use]
    pub fn count_of_inputs(&self) -> (usize, usize) {
        self.count(|result| result.is_input)
    }

    fn count(&self, keep: impl Fn(&Comparison) -> bool) -> (usize, usize) {
        let results = || self.comparisons.iter().filter(|result| keep(result));
        (
            results().filter(|result| result.is_inside).count(),
            results().count(),
        )
    }
}
