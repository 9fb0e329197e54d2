//! Data of a completed pass.

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

/// Shares of the force in each control period, N.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Shares {
    pub radial: Vec<[f64; 3]>,
    pub tangential: Vec<[f64; 3]>,
    pub axial: Vec<[f64; 3]>,
}
