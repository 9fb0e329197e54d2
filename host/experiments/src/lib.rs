//! The experiments of the thesis as scenarios that anyone can run: cut in the simulator, measured, and held against every number that the thesis states.
//!
//! A scenario is one or more [`Pass`]es: a part program, a work, a scale of the forces, and the settings of the force loop. Each pass leaves what
//! `haptimill run` leaves (recording, trace, summary, report); each scenario a summary and a page with the curves of the thesis's figures, the cut
//! surface seen from above, and a table of [`Claim`]s: what the thesis states, the band that counts as reproduced, and what came out here.
//!
//! E6, E8, E10 and E12 have a person at the haptic arm ([`Led`]): one hand for all four.
//!
//! One machine file, with one plant, serves all scenarios. The scale of the forces is the one exception (docs/control.md 5.2: the forces on the incline are not stated and
//! need about twice the coefficients P1), and it is shown. A band is never fitted to what comes out: what is outside is shown as outside, with the reason.
//!
//! Misuse: forces and geometry are those of a fitted cutting model (docs/control.md 5.2 fits P1 to the forces of E1, E2 and E9). That its numbers
//! come back out of a run shows that the simulator is the model, not that the model is the machine of the thesis; E3 to E5, E7 and E11 were not fitted.

mod bench;
mod course;
mod felt;
mod incline;
mod led;
mod led_page;
mod list;
mod page;
mod picture;
mod programmed;
mod stated;
mod table;

pub use bench::{Cut, NO_FORCE_CONTROL, On, carry};
pub use course::{Course, ForceSource, Sample};
pub use led::{Led, NO_HAPTIC_ARM};
pub use list::{all, named};
pub use page::{index, page};
pub use stated::{Band, Claim};
pub use table::table;

use haptimill_machine_file::MachineFile;
use serde::Serialize;

/// What a pass cuts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// examples/block.toml.
    Block,
    /// examples/incline.toml.
    Incline,
}

impl Work {
    /// Name and text of its file.
    #[must_use]
    pub const fn file(self) -> (&'static str, &'static str) {
        match self {
            Self::Block => (
                "examples/block.toml",
                include_str!("../../../examples/block.toml"),
            ),
            Self::Incline => (
                "examples/incline.toml",
                include_str!("../../../examples/incline.toml"),
            ),
        }
    }
}

/// Force control along x of the work.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Control {
    /// f_d, N.
    pub desired_n: f64,
    /// K_A, N s^2/mm.
    pub mass: f64,
    /// K_V, N s/mm.
    pub damping: f64,
}

/// One cut of a scenario.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pass {
    /// Name of its folder.
    pub name: &'static str,
    /// What tells it from the other passes.
    pub title: &'static str,
    /// Name of the part program.
    pub program: &'static str,
    /// Text of the part program.
    pub text: &'static str,
    /// What is cut.
    pub work: Work,
    /// All forces of the cut are multiplied by this.
    pub force_scale: f64,
    /// Force control, if there is any.
    pub control: Option<Control>,
    /// What a hand does in it, if there is one.
    pub led: Option<Led>,
}

impl Pass {
    /// Whether the tool does anything: at the wall of E6 only the hand moves.
    #[must_use]
    pub fn cuts(&self) -> bool {
        self.led.is_none_or(|led| !led.axes.is_empty())
    }
}

/// An experiment.
#[derive(Clone)]
pub struct Scenario {
    /// Short name: e1 to e12.
    pub name: &'static str,
    /// What it is.
    pub title: &'static str,
    /// What the thesis did, in a sentence or two.
    pub setting: &'static str,
    /// Figures and pages of the thesis.
    pub figures: &'static str,
    /// The cuts.
    pub passes: Vec<Pass>,
    /// What the thesis states, measured on the cuts (in the order of the passes).
    pub claims: fn(&[Cut]) -> Vec<Claim>,
}

impl Scenario {
    /// Whether it needs the force loop.
    #[must_use]
    pub fn needs_force_control(&self) -> bool {
        self.passes.iter().any(|pass| pass.control.is_some())
    }

    /// Whether it needs a haptic arm.
    #[must_use]
    pub fn needs_hand(&self) -> bool {
        self.passes.iter().any(|pass| pass.led.is_some())
    }

    /// What a machine lacks to run it.
    #[must_use]
    pub fn lacks(&self, machine: &MachineFile) -> Option<&'static str> {
        if self.needs_force_control() && machine.config.force.is_none() {
            return Some(NO_FORCE_CONTROL);
        }
        (self.needs_hand() && !Led::fits(machine)).then_some(NO_HAPTIC_ARM)
    }
}

/// What a scenario came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Result {
    /// Its name.
    pub scenario: &'static str,
    /// What it is.
    pub title: &'static str,
    /// Why it was not run; the rest is empty then.
    pub not_run: Option<String>,
    /// Its cuts.
    pub passes: Vec<PassResult>,
    /// What the thesis states, and ours.
    pub claims: Vec<Claim>,
}

/// What a pass came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PassResult {
    /// Name of its folder.
    pub name: &'static str,
    /// The part program.
    pub program: &'static str,
    /// The work.
    pub work: &'static str,
    /// All forces of the cut were multiplied by this.
    pub force_scale: f64,
    /// Force control.
    pub control: Option<Control>,
    /// Where "high" and "low" forces are from.
    pub forces: ForceSource,
    /// Duration of the job, s.
    pub duration_s: f64,
    /// Tool against the program at the same time, largest, mm; without force control.
    pub tool_error_max_mm: Option<f64>,
    /// Material removed, mm^3.
    pub removed_mm3: f64,
    /// SHA-256 of the recording.
    pub trace_sha256: String,
}

impl Result {
    /// The result of a scenario whose passes were cut.
    #[must_use]
    pub fn of(scenario: &Scenario, cuts: &[Cut]) -> Self {
        let passes = scenario
            .passes
            .iter()
            .zip(cuts)
            .map(|(pass, cut)| PassResult {
                name: pass.name,
                program: pass.program,
                work: pass.work.file().0,
                force_scale: pass.force_scale,
                control: pass.control,
                forces: cut.course.source,
                duration_s: rounded(cut.summary.duration_s),
                tool_error_max_mm: pass
                    .control
                    .is_none()
                    .then(|| rounded(cut.summary.tool_error_max_mm)),
                removed_mm3: rounded(cut.work.removed_mm3()),
                trace_sha256: cut.summary.trace_sha256.clone(),
            });
        Self {
            scenario: scenario.name,
            title: scenario.title,
            not_run: None,
            passes: passes.collect(),
            claims: (scenario.claims)(cuts),
        }
    }

    /// The result of a scenario that this machine cannot run.
    #[must_use]
    pub fn not_run(scenario: &Scenario, why: &str) -> Self {
        Self {
            scenario: scenario.name,
            title: scenario.title,
            not_run: Some(why.to_string()),
            passes: Vec::new(),
            claims: Vec::new(),
        }
    }

    /// Claims inside their bands.
    #[must_use]
    pub fn inside(&self) -> usize {
        self.claims.iter().filter(|claim| claim.inside).count()
    }
}

/// To a ten thousandth: beyond that no figure of a scenario means anything.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
