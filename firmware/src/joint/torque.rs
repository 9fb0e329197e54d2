//! From an effort to the code of a 14-bit digital-to-analogue converter in front of a current-mode amplifier.
//!
//! Misuse: efforts are taken to be within what the drive may make; the position loop sees to that ([`crate::joint::servo::PositionLaw::effort`]).
//!
//! Codes are symmetric, -8191 to 8191: an amplifier that sees -8192 would be asked for a little more one way than the other.
//! What rounding leaves over is carried into the next period (first-order error feedback). A lone code is worth 0.06 N on a 500 N axis; a
//! loop without an integrator would keep such an error for ever, and a slow change of effort would come in stairs that excite the screw. With the
//! carry the mean of the codes is exact and the error of rounding lies at half the control rate, where the mass swallows it. At a clamp the carry is
//! dropped, so nothing winds up.

use crate::config::digest::constants;
use haptimill_math::Effort;
use haptimill_math::reciprocal::{Factor, Scale};

/// Largest code, both ways.
pub const CODE_LIMIT: i16 = 8191;

/// Output of one torque axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TorqueOutput {
    /// Codes per effort, Q16; negative where the drive is wired the other way round.
    scale: Scale,
    /// Left over from rounding, 2^-16 codes.
    carry: i32,
}

constants!(TorqueOutput { scale } of {} but { carry });

impl TorqueOutput {
    /// Scale: `full_scale` is the effort at code 8192 (negative: wired the other way round; zero is taken for the smallest).
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

    /// Forgets what was left over.
    pub const fn reset(&mut self) {
        self.carry = 0;
    }

    /// The code of an effort, within 1 code of the exact quotient (0.5 for rounding, 0.5 for the carry) and right in the mean; and whether it was clamped.
    #[inline]
    pub fn code(&mut self, effort: Effort) -> (i16, bool) {
        // Full scale is 2^29, what is beyond is held below 2^30; the carry is below 2^16.
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
