//! Definitions of the experiments: the TOML files of `data`, one for each experiment.
//!
//! A file has the description, the passes (part program, stock, force control, operator), named
//! events and windows of time, and the expected results. Each result names its measure in
//! [`super::measures`]. All references are checked when a file is loaded.

mod load;
#[cfg(test)]
mod tests;

pub use load::all;

use super::expected::{Band, ExpectedSource};
use super::inputs::input;
use haptimill_hil_sim::operator::Trajectory;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Axis of the workpiece frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WorkAxis {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z.
    Z,
}

impl WorkAxis {
    /// All axes.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// Index in poses and forces.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// An experiment.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Short name: e1 to e12.
    pub name: String,
    /// Title.
    pub title: String,
    /// Description of the experiment, in a sentence or two.
    pub setting: String,
    /// Figures and pages of the thesis.
    pub figures: String,
    /// The cutting forces of the machine file are fitted to this experiment (docs/control.md 5.2),
    /// or the operator model is.
    #[serde(default)]
    pub fitted: bool,
    /// Passes, in order.
    #[serde(rename = "pass")]
    pub passes: Vec<Pass>,
    /// Events of teleoperated passes, by name.
    #[serde(default)]
    pub events: BTreeMap<String, Event>,
    /// Windows of samples, by name.
    #[serde(default)]
    pub windows: BTreeMap<String, Window>,
    /// Reasons for results outside their bands, by name.
    #[serde(default)]
    pub reasons: BTreeMap<String, Reason>,
    /// Expected results, in the order of the tables.
    pub expected: Vec<ExpectedResult>,
}

/// Reason for results outside their bands.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reason {
    /// The reason, as pages and table show it.
    pub text: String,
    /// Curves that show it, by name: see [`super::measures`].
    pub cause: Option<String>,
    /// Force that the thesis states, over time: s and N, with straight lines between. The cause
    /// `admittance` integrates it.
    #[serde(default)]
    pub stated_force: Vec<[f64; 2]>,
}

/// One run of a part program.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pass {
    /// Name of its folder.
    pub name: String,
    /// Title that distinguishes it from the other passes; empty for a single one.
    #[serde(default)]
    pub title: String,
    /// Path of the part program in the repository.
    pub program: String,
    /// Path of the stock file in the repository.
    pub stock: String,
    /// Force control, if it is on.
    pub force_control: Option<ForceControl>,
    /// Teleoperation, if an operator moves the tool or the handle.
    pub teleoperation: Option<Teleoperation>,
}

impl Pass {
    /// Name of the part program, without its folder.
    #[must_use]
    pub fn program_name(&self) -> &str {
        self.program.rsplit('/').next().unwrap_or(&self.program)
    }

    /// Text of the part program.
    #[must_use]
    pub fn program_text(&self) -> &'static str {
        input(&self.program).unwrap_or_default()
    }

    /// Text of the stock file.
    #[must_use]
    pub fn stock_text(&self) -> &'static str {
        input(&self.stock).unwrap_or_default()
    }

    /// Whether the tool cuts; in E6 only the handle moves.
    #[must_use]
    pub fn has_cutting(&self) -> bool {
        let moves_tool = |master: &Teleoperation| !master.axes.is_empty();
        self.teleoperation.as_ref().is_none_or(moves_tool)
    }
}

/// Force control of a pass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceControl {
    /// Axes of the workpiece frame under force control.
    #[serde(skip_serializing)]
    pub axes: Vec<WorkAxis>,
    /// f_d, N.
    pub setpoint_n: f64,
    /// K_A, N s^2/mm.
    #[serde(rename(serialize = "mass"))]
    pub virtual_mass: f64,
    /// K_V, N s/mm.
    #[serde(rename(serialize = "damping"))]
    pub virtual_damping: f64,
}

impl ForceControl {
    /// Indices of the axes, as messages have them.
    #[must_use]
    pub fn axis_indices(&self) -> Vec<u8> {
        self.axes.iter().map(|axis| *axis as u8).collect()
    }
}

/// Force feedback along an axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeedbackAxis {
    /// Percentage of the force on the tool.
    pub percent: u8,
    /// Largest force on the operator, N.
    pub limit_n: f64,
}

/// Force feedback of a pass.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Feedback {
    /// Along x.
    pub x: FeedbackAxis,
    /// Along y.
    pub y: FeedbackAxis,
    /// Along z.
    pub z: FeedbackAxis,
}

impl Feedback {
    /// By axis.
    #[must_use]
    pub const fn axes(&self) -> [FeedbackAxis; 3] {
        [self.x, self.y, self.z]
    }
}

/// Teleoperation in a pass: what the master moves, its force feedback, and the operator.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Teleoperation {
    /// Pose coordinates that the master moves.
    pub axes: Vec<WorkAxis>,
    /// Direction of the rail under the handle, if it is mounted.
    pub rail: Option<[f64; 3]>,
    /// The reference part is mounted at the tip.
    #[serde(default)]
    pub reference_part: bool,
    /// Force feedback.
    #[serde(default)]
    pub feedback: Feedback,
    /// Velocity-proportional damping term where the feedback is weak, N s/mm; 0 for none.
    #[serde(default)]
    pub damping: f64,
    /// Rate of a virtual fixture that moves along x from the position of the handle, mm/s.
    pub fixture_mm_s: Option<f64>,
    /// Motion that the operator intends.
    pub operator: Trajectory,
}

/// An event of a teleoperated pass: its first sample that meets the condition.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// Start of the search, s.
    pub from_s: Option<f64>,
    /// End of the search, s.
    pub to_s: Option<f64>,
    /// The master is within 0.5 mm of this x, mm from its start.
    pub master_x_mm: Option<f64>,
    /// The operator trajectory is complete.
    #[serde(default)]
    pub completed: bool,
}

/// A selection of samples. Without any key: the cut path of a programmed pass, or all samples of a
/// teleoperated pass.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// Start, s.
    pub from_s: Option<f64>,
    /// Start as a fraction of the time of `to_event`.
    pub from_fraction: Option<f64>,
    /// End, s.
    pub to_s: Option<f64>,
    /// End at an event.
    pub to_event: Option<String>,
    /// Programmed passes: samples of the cut path at this height of the tip, mm.
    pub z_mm: Option<f64>,
    /// Programmed passes: samples of the cut path along x at this y, mm.
    pub y_mm: Option<f64>,
    /// Programmed passes: samples of the cut path in which the program moves this axis.
    pub moving: Option<WorkAxis>,
    /// Teleoperated passes: samples with a force feedback along x in this range, N.
    pub feedback_n: Option<[f64; 2]>,
}

/// How a result is measured. Which keys a measure needs is stated in [`super::measures`].
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measurement {
    /// Name of the measure.
    pub name: String,
    /// Pass; the first one without this key.
    pub pass: Option<String>,
    /// Name of the quantity.
    pub quantity: Option<String>,
    /// Axis of the quantity.
    pub axis: Option<WorkAxis>,
    /// Windows of samples, joined in this order.
    #[serde(default)]
    pub windows: Vec<String>,
    /// The first and last 0.3 s of each window are left out.
    #[serde(default)]
    pub settled: bool,
    /// Time of the sample, s.
    pub at_s: Option<f64>,
    /// Event.
    pub event: Option<String>,
    /// Threshold of the quantity.
    pub threshold: Option<f64>,
    /// Nominal depth of the cut, mm.
    pub depth_mm: Option<f64>,
    /// Distance of the outer paths of the tool centre across a groove, mm; 0 without this key.
    pub path_width_mm: Option<f64>,
    /// Points of the surface, mm.
    #[serde(default)]
    pub points_mm: Vec<[f64; 2]>,
    /// Sections of the surface: start and end, mm.
    #[serde(default)]
    pub sections_mm: Vec<[[f64; 2]; 2]>,
    /// The same measure elsewhere; the largest of these is subtracted.
    #[serde(default)]
    pub less: Vec<Elsewhere>,
    /// The same measure elsewhere; it divides the result.
    pub over: Option<Elsewhere>,
}

/// Keys of a [`Measurement`] that differ in a comparison.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Elsewhere {
    /// Pass.
    pub pass: Option<String>,
    /// Windows of samples.
    #[serde(default)]
    pub windows: Vec<String>,
    /// Time of the sample, s.
    pub at_s: Option<f64>,
}

impl Measurement {
    /// The same measure with the keys of `elsewhere`.
    #[must_use]
    pub fn moved_to(&self, elsewhere: &Elsewhere) -> Self {
        let mut moved = Self {
            less: Vec::new(),
            over: None,
            ..self.clone()
        };
        if elsewhere.pass.is_some() {
            moved.pass.clone_from(&elsewhere.pass);
        }
        if !elsewhere.windows.is_empty() {
            moved.windows.clone_from(&elsewhere.windows);
        }
        moved.at_s = elsewhere.at_s.or(self.at_s);
        moved
    }
}

/// Band of an expected result as the file has it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BandDefinition {
    /// Lower end.
    pub min: Option<f64>,
    /// Upper end.
    pub max: Option<f64>,
    /// Unit; empty for a ratio.
    #[serde(default)]
    pub unit: String,
    /// Origin.
    pub source: ExpectedSource,
}

impl BandDefinition {
    /// The band.
    #[must_use]
    pub const fn range(&self) -> Band {
        Band {
            low: self.min,
            high: self.max,
            source: self.source,
        }
    }
}

/// A number that the simulator must reproduce.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpectedResult {
    /// Name, as the tables show it.
    pub name: String,
    /// Statement of the thesis; empty when it makes none.
    #[serde(default)]
    pub thesis: String,
    /// Band.
    pub band: BandDefinition,
    /// Measure.
    pub measure: Measurement,
    /// Key of the reason that is shown when the result is outside.
    pub reason: Option<String>,
    /// The result is an input: the pace of the operator was chosen for it. It is counted apart.
    #[serde(default)]
    pub input: bool,
}

impl Experiment {
    /// Index of the pass of a measurement.
    #[must_use]
    pub fn pass_of(&self, measure: &Measurement) -> Option<usize> {
        match &measure.pass {
            None => Some(0),
            Some(name) => self.passes.iter().position(|pass| pass.name == *name),
        }
    }

    /// The reason of a result that is outside.
    #[must_use]
    pub fn reason_of(&self, expected: &ExpectedResult) -> Option<&Reason> {
        expected
            .reason
            .as_ref()
            .and_then(|key| self.reasons.get(key))
    }

    /// Whether it needs force control.
    #[must_use]
    pub fn needs_force_control(&self) -> bool {
        self.passes.iter().any(|pass| pass.force_control.is_some())
    }

    /// Whether it needs a haptic arm.
    #[must_use]
    pub fn needs_haptic_arm(&self) -> bool {
        self.passes.iter().any(|pass| pass.teleoperation.is_some())
    }
}
