//! From people's units to the controller's integers.
//!
//! Every conversion is one multiplication in f64 and one rounding to the nearest integer (halves away from zero). The result is
//! within half a step of the target type; the greatest relative error is that of f64, 1.1e-16. NaN becomes 0: it stands for a value that
//! has been reported already.

use haptimill_firmware::config::AxisKind;

/// 2^20 steps to the millimetre.
pub const PER_MM: f64 = (1 << 20) as f64;
/// 2^32 steps to the turn, per degree.
pub const PER_DEG: f64 = 4_294_967_296.0 / 360.0;
/// Effort steps to the newton or newton metre.
pub const PER_EFFORT: f64 = 65_536.0;
/// 2^24: the fraction bits of axis units per count or step.
pub const PER_COUNT: f64 = 16_777_216.0;
/// 2^8: the fraction bits of gains.
pub const PER_GAIN: f64 = 256.0;

/// Axis units to the millimetre or degree.
pub fn per_unit(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => PER_MM,
        AxisKind::Rotary => PER_DEG,
    }
}

/// The nearest i32, saturated.
pub fn to_i32(value: f64) -> i32 {
    value.round() as i32
}

/// The nearest u32, saturated.
pub fn to_u32(value: f64) -> u32 {
    value.round() as u32
}

/// The nearest u16, saturated.
pub fn to_u16(value: f64) -> u16 {
    value.round() as u16
}

/// The nearest i64, saturated.
pub fn to_i64(value: f64) -> i64 {
    value.round() as i64
}

/// Accelerations are in 256 axis units per second squared.
pub fn acceleration(value: f64, kind: AxisKind) -> i32 {
    to_i32(value * per_unit(kind) / 256.0)
}

/// Jerks are in 2^16 axis units per second cubed.
pub fn jerk(value: f64, kind: AxisKind) -> u32 {
    to_u32(value * per_unit(kind) / 65_536.0)
}

/// Effort steps per acceleration step, times 2^20, of an inertia in kg or kg m^2.
///
/// Linear: 1 kg at 2^-12 mm/s^2 takes 2^-12 * 1e-3 N = 0.016 effort steps. Rotary: 1 kg m^2 at 2^-24 turn/s^2 takes
/// 2^-24 * 2 pi N m = 2 pi / 256 effort steps.
pub fn inertia(value: f64, kind: AxisKind) -> u32 {
    let effort_per_acceleration = match kind {
        AxisKind::Linear => 0.016,
        AxisKind::Rotary => std::f64::consts::TAU / 256.0,
    };
    to_u32(value * effort_per_acceleration * PER_MM)
}

/// Effort steps per rate step, times 2^24, of a viscous friction in N per mm/s or N m per deg/s.
pub fn viscous(value: f64, kind: AxisKind) -> u32 {
    to_u32(value * PER_EFFORT / per_unit(kind) * PER_COUNT)
}
