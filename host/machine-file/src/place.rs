//! Unit, stroke and motor turn of an axis, which the readers of its parts share.

use haptimill_firmware::config::AxisKind;

/// Returns the unit of an axis.
pub(super) fn unit(kind: AxisKind) -> &'static str {
    if kind.is_rotary() { "deg" } else { "mm" }
}

/// What the parts of a joint need to know about it.
pub(super) struct Place {
    pub(super) kind: AxisKind,
    /// The stroke, mm or deg.
    pub(super) low: f64,
    pub(super) high: f64,
    /// Travel of a motor turn, mm or deg.
    pub(super) turn: f64,
    /// The preset, mm or deg.
    pub(super) preset: f64,
}
