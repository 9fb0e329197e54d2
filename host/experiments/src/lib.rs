//! The experiments of the thesis in the simulator, compared with the numbers of the thesis.
//!
//! An experiment is defined by a file of `data` ([`Experiment`]): its passes, and its expected
//! results with their bands. A pass is one run of a part program ([`Pass`]) and leaves the files of
//! `haptimill run`. An experiment leaves a summary and a page with the charts of the thesis's
//! figures, the cut surface from above, and the table of [`Comparison`]s. E6, E8, E10 and E12 are
//! teleoperated by an operator model at the haptic arm.
//!
//! All experiments use one machine file with one plant. No band is fitted to a result; a result
//! outside its band is shown with the reason, its curve and a curve of the cause.
//!
//! Forces and geometry are those of a cutting model that is fitted to the forces of E1, E2 and E7
//! (docs/control.md 5.2); the operator is fitted to E6 and E8. That a run reproduces these shows
//! that the simulator implements the model, not that the model is the machine of the thesis. E3 to
//! E5 and E9 to E12 are held out.

mod comparison;
mod definition;
mod expected;
mod inputs;
mod measures;
mod obstacle;
mod page;
mod pass_data;
mod result;
mod run;
mod sampled_trace;
mod surface_image;
mod table;
mod teleoperation;

pub use comparison::Comparison;
pub use definition::{ExpectedResult, Experiment, Pass, all};
pub use expected::{Band, ExpectedSource};
pub use obstacle::{NO_FORCE_CONTROL, NO_HAPTIC_ARM};
pub use page::{index, page};
pub use pass_data::PassData;
pub use result::{ExperimentResult, PassResult};
pub use run::{Target, run_pass};
pub use sampled_trace::{ForceSource, Sample, SampledTrace};
pub use surface_image::cut_of;
pub use table::table;
