//! Figures of a plan: times, path, largest speeds.

/// Figures of a plan.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Figures {
    /// Duration, seconds, without pauses.
    pub duration_s: f64,
    /// Part of it in rapid moves.
    pub rapid_s: f64,
    /// Length of the programmed path of the tool tip in the workpiece, mm, rapid moves included.
    pub path_length_mm: f64,
    /// Number of moves.
    pub blocks: usize,
    /// Number of moves that the limits of the machine keep below their feed.
    pub slowed: usize,
    /// Slowest and fastest speed of the turning spindle, rev/min; `None` if it stands.
    pub spindle_rpm: Option<[u16; 2]>,
    /// Number of setpoints; 0 in a check.
    pub setpoints: usize,
    /// Largest path speed of the tip, mm/s.
    pub peak_tip_mm_s: f64,
    /// Largest rate of each joint at the setpoints, mm/s or deg/s; 0 in a check.
    pub peak_joint_rates: [f64; 6],
}
