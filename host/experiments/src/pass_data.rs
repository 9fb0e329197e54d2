//! Data of a completed pass.

use super::sampled_trace::SampledTrace;
use haptimill_client::session::HapticTrace;
use haptimill_hil_sim::process::Workpiece;
use haptimill_report::Summary;

/// Data of a completed pass.
pub struct PassData {
    /// Sampled trace.
    pub trace: SampledTrace,
    /// Stock with its cut surface.
    pub stock: Workpiece,
    /// Summary of the job.
    pub summary: Summary,
    /// Record of master and tool of a teleoperated pass.
    pub teleoperation: Option<HapticTrace>,
}
