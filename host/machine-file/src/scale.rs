//! Conversion from engineering units to the controller's integers.
//!
//! A conversion is one multiplication in f64 and one rounding to the nearest integer (halves away
//! from zero). Its error is at most half a unit of the target type, plus the relative error of f64,
//! 1.1e-16. NaN becomes 0; NaN is a value that has been reported already.

use haptimill_firmware::config::AxisKind;

/// Axis units per millimetre.
pub const PER_MM: f64 = (1 << 20) as f64;
/// Axis units per degree; 2^32 per turn.
pub const PER_DEG: f64 = 4_294_967_296.0 / 360.0;
/// Effort units per newton or newton metre.
pub const PER_EFFORT: f64 = 65_536.0;
/// Scale of axis units per count or step, with 24 fraction bits.
pub const PER_COUNT: f64 = 16_777_216.0;
/// Scale of gains, with 8 fraction bits.
pub const PER_GAIN: f64 = 256.0;

/// Returns the axis units per millimetre or degree.
pub fn per_unit(kind: AxisKind) -> f64 {
    let units = (1_u64 << kind.unit_bits()) as f64;
    if kind.is_rotary() {
        units / 360.0
    } else {
        units
    }
}

/// Rounds to the nearest i32; saturates.
pub fn to_i32(value: f64) -> i32 {
    value.round() as i32
}

/// Rounds to the nearest u32; saturates.
pub fn to_u32(value: f64) -> u32 {
    value.round() as u32
}

/// Rounds to the nearest u16; saturates.
pub fn to_u16(value: f64) -> u16 {
    value.round() as u16
}

/// Rounds to the nearest i64; saturates.
pub fn to_i64(value: f64) -> i64 {
    value.round() as i64
}

/// Converts an acceleration to 256 axis units per second squared.
pub fn acceleration(value: f64, kind: AxisKind) -> i32 {
    to_i32(value * per_unit(kind) / 256.0)
}

/// Converts a jerk to 2^16 axis units per second cubed.
pub fn jerk(value: f64, kind: AxisKind) -> u32 {
    to_u32(value * per_unit(kind) / 65_536.0)
}

/// Converts an inertia in kg or kg m^2 to effort units per acceleration unit, times 2^20.
///
/// Linear: 1 kg at 2^-12 mm/s^2 takes 2^-12 * 1e-3 N = 0.016 effort units. Rotary: 1 kg m^2 at
/// 2^-24 turn/s^2 takes 2^-24 * 2 pi N m = 2 pi / 256 effort units; of a multi-turn joint the
/// acceleration unit is 2^10 times as large.
pub fn inertia(value: f64, kind: AxisKind) -> u32 {
    let effort_per_acceleration = match kind {
        AxisKind::Linear => 0.016,
        AxisKind::Rotary => std::f64::consts::TAU / 256.0,
        AxisKind::MultiTurn => std::f64::consts::TAU * 4.0,
    };
    to_u32(value * effort_per_acceleration * PER_MM)
}

/// Converts a viscous friction in N per mm/s or N m per deg/s to effort units per rate unit, times
/// 2^24.
pub fn viscous(value: f64, kind: AxisKind) -> u32 {
    to_u32(value * PER_EFFORT / per_unit(kind) * PER_COUNT)
}
