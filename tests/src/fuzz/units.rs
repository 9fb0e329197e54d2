//! Units of the wire in engineering units.

use haptimill_firmware::config::{AxisKind, JointSettings};

/// Axis units of a millimetre.
pub const MM: f64 = (1 << 20) as f64;
/// Axis units of a degree.
pub const DEGREE: f64 = 4_294_967_296.0 / 360.0;
/// A control period, s.
pub const PERIOD: f64 = 2e-4;

/// Returns the axis units of a millimetre or of a degree, by coordinate of the H-4 machines.
#[must_use]
pub const fn unit(axis: usize) -> f64 {
    if axis < 3 { MM } else { DEGREE }
}

/// Returns the axis units of a millimetre or of a degree of a coordinate or joint.
#[must_use]
pub const fn kind_unit(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => MM,
        AxisKind::Rotary => DEGREE,
        AxisKind::MultiTurn => DEGREE / 1024.0,
    }
}

/// Returns the axis units of a millimetre or of a degree of a joint.
#[must_use]
pub const fn joint_unit(joint: &JointSettings) -> f64 {
    kind_unit(joint.kind)
}

/// Returns the index of a joint's bound in the lists of [`super::checks::bounds`]: slide or table.
#[must_use]
pub const fn class(joint: &JointSettings) -> usize {
    match joint.kind {
        AxisKind::Linear => 0,
        AxisKind::Rotary | AxisKind::MultiTurn => 1,
    }
}
