//! Data of a completed pass.

use super::measures::Shares;
use super::sampled_trace::SampledTrace;
use haptimill_client::session::HapticTrace;
use haptimill_hil_sim::process::{CuttingConfig, Workpiece};
use haptimill_report::Summary;
use std::sync::OnceLock;

/// Data of a completed pass.
pub struct PassData {
    /// Sampled trace.
    pub trace: SampledTrace,
    /// Stock with its cut surface.
    pub stock: Workpiece,
    /// Cutter and uncut stock.
    pub cutting: CuttingConfig,
    /// Summary of the job.
    pub summary: Summary,
    /// Record of master and tool of a teleoperated pass.
    pub teleoperation: Option<HapticTrace>,
    /// Radial, tangential and axial share of the force, once they are needed.
    pub(super) shares: OnceLock<Shares>,
}
