//! Conversion of an effort to the code of a 14-bit digital-to-analogue converter in front of a
//! current-mode amplifier.
//!
//! Callers must pass efforts within the drive's limit; the servo law ensures that
//! ([`crate::joint::servo::ServoLaw::effort`]).
//!
//! Codes are symmetric, -8191 to 8191. With -8192 the amplifier would make slightly more effort in
//! one direction than in the other.
//!
//! The rounding error is carried into the next period (first-order error feedback). One code is
//! worth 0.06 N on a 500 N joint. Without the carry, a loop without an integrator would keep such
//! an error permanently, and a slow change of effort would come in steps that excite the screw.
//! With the carry the mean of the codes is exact, and the rounding error lies at half the control
//! rate, where the mass attenuates it. The carry is dropped when the code is clamped, so nothing
//! winds up.

use crate::digest::impl_digest;
use haptimill_math::Effort;
use haptimill_math::reciprocal::{Factor, Scale};

/// Largest magnitude of a code.
pub const CODE_LIMIT: i16 = 8191;

/// Output of one torque joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TorqueOutput {
    /// Codes per effort, Q16; negative if the drive is wired in reverse.
    scale: Scale,
    /// Rounding error that is carried over, 2^-16 codes.
    carry: i32,
}

impl_digest!(TorqueOutput { fields { scale }, nested {}, skip { carry } });

impl TorqueOutput {
    /// Output with the effort `full_scale` at code 8192. A negative `full_scale` means that the
    /// drive is wired in reverse; zero counts as the smallest effort.
    pub const fn new(full_scale: Effort) -> Self {
        // 2^13 codes with 16 bits of fraction: 2^29 / full_scale.
        let scale = Factor::of(1 << 29)
            .over(Factor::of(full_scale.0.unsigned_abs() as u64))
            .scale();
        Self {
            scale: if full_scale.0 < 0 {
                scale.reversed()
            } else {
                scale
            },
            carry: 0,
        }
    }

    /// Drops the carried rounding error.
    pub const fn reset(&mut self) {
        self.carry = 0;
    }

    /// Returns the code of an effort and whether it was clamped. The code is within 1 of the exact
    /// quotient (0.5 for rounding, 0.5 for the carry) and exact in the mean.
    #[inline]
    pub fn code(&mut self, effort: Effort) -> (i16, bool) {
        // Full scale is 2^29; larger values saturate below 2^30. The carry is below 2^16.
        let exact = self.scale.apply(effort.0).wrapping_add(self.carry);
        let code = exact.wrapping_add(1 << 15) >> 16;
        let limit = i32::from(CODE_LIMIT);
        if code > limit || code < -limit {
            self.carry = 0;
            return (if code > 0 { CODE_LIMIT } else { -CODE_LIMIT }, true);
        }
        self.carry = exact.wrapping_sub(code << 16);
        (code as i16, false)
    }
}
