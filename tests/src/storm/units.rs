//! Units of the wire in engineering units.

/// Axis units of a millimetre.
pub const MM: f64 = (1 << 20) as f64;
/// Axis units of a degree.
pub const DEGREE: f64 = 4_294_967_296.0 / 360.0;
/// A control period, s.
pub const PERIOD: f64 = 2e-4;

/// Returns the axis units of a millimetre or of a degree, by coordinate.
#[must_use]
pub const fn unit(axis: usize) -> f64 {
    if axis < 3 { MM } else { DEGREE }
}

/// Returns the axis units of a millimetre or of a degree, by joint of the H-4 machines.
#[must_use]
pub const fn joint_unit(joint: usize) -> f64 {
    if joint < 4 { MM } else { DEGREE }
}

/// Returns the index of a joint's bound in the lists of [`super::checks::bounds`]: slide or table.
#[must_use]
pub const fn class(joint: usize) -> usize {
    if joint < 4 { 0 } else { 1 }
}
