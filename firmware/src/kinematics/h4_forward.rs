//! Forward kinematics of the H-4 arm: the crossing of two circles, no iteration, no division.
//!
//! With S12 = (l1 - l2) / 2 - w, S34 = (l3 - l4) / 2 - w, sin(theta) = (l1 + l2 - l3 - l4) / 4 c, D = d - c cos(theta), Z = z_c + g_e:
//!
//! ```text
//! (y - E)^2 + (Z - D)^2 = R^2 - S12^2     and     (y + E)^2 + (Z + D)^2 = R^2 - S34^2
//! ```
//!
//! which is (3.17)-(3.19) of spec h4-milling without their cancellation. The centres are +-(E, D). Along the line through them the crossing
//! lies at t = (S12^2 - S34^2) / 4 H, H = hypot(E, D); across it at +-q, q^2 = R^2 - (S12^2 + S34^2) / 2 - H^2 - t^2. q is the distance from the
//! parallel singularity, its sign the assembly branch. Squaring loses the signs of S12 and S34, so a pose is certified by four conditions
//! together: S12 >= 0.1 R, S34 >= 0.1 R, |sin(theta)| < 1, q >= the margin.
//!
//! N = 4 c sin(theta) is a sum of slides and 4 c cos(theta) = sqrt((4 c - N) (4 c + N)) is one root, so no sine is evaluated; the angle itself
//! is their arc tangent, which is well conditioned up to the quarter turn.

use super::h4::{BasePose, H4};
use super::{Joints, PoseError};
use crate::units::root::Root;
use crate::units::scale::{multiply_high, multiply_shift, round_shift};
use crate::units::trig::atan2;
use crate::units::{Angle, Length};

/// The tool in the frame of the slave base, raw.
pub(super) struct Base {
    pub(super) x: i32,
    pub(super) y: i32,
    pub(super) z: i32,
    pub(super) theta: Angle,
}

impl H4 {
    /// The tool in the frame of the slave base: x, y, z and theta of (3.17)-(3.19), without the table.
    ///
    /// # Errors
    /// [`PoseError::Unreachable`], [`PoseError::NearReachLimit`], [`PoseError::NearSingularity`]: the slides hold no certified pose.
    pub fn base_pose(&self, joints: &Joints) -> Result<BasePose, PoseError> {
        let base = self.base(joints)?;
        Ok(BasePose {
            x: Length(base.x),
            y: Length(base.y),
            z: Length(base.z),
            theta: base.theta,
        })
    }

    #[inline]
    pub(super) fn base(&self, joints: &Joints) -> Result<Base, PoseError> {
        let [l1, l2, l3, l4, ..] = joints.0.map(|joint| joint.0 as i64);

        // 2 S of both pairs: exact, and with their sign before it is lost.
        let upper = l1 - l2 - 2 * self.joint_offset;
        let lower = l3 - l4 - 2 * self.joint_offset;
        let twice_rod = 2 * self.rod as i64;
        let width = 4 * self.half_spacing as i64;
        let sum = l1 + l2 - l3 - l4;
        if sum.abs() >= width || upper > twice_rod || lower > twice_rod || !self.sound {
            return Err(PoseError::Unreachable);
        }
        if 10 * upper < twice_rod || 10 * lower < twice_rod {
            let pair = (10 * upper >= twice_rod) as u8;
            return Err(PoseError::NearReachLimit { pair });
        }

        // The tilt: N and 4 c cos(theta), both below 2^31.
        let sum = sum as i32;
        let cosine = Root::of(((width - sum as i64) * (width + sum as i64)) as u64).rounded();
        let theta = atan2(sum, cosine);
        let drop = self.half_height as i64 - round_shift(cosine as i64, 2);

        // The line through the centres: H and its direction, Q30. |drop| < 2^30 + 2^29, so H^2 < 2^62.
        let lateral = self.lateral as i64;
        let base_square = lateral * lateral + drop * drop;
        let inverse = Root::of(base_square as u64).reciprocal();
        // 2^62 / H is mantissa << (62 - shift) and H >= 1 mm: the shifts below are positive.
        let along_y = round_shift(lateral * inverse.mantissa as i64, inverse.shift - 30);
        let along_z = round_shift(drop * inverse.mantissa as i64, inverse.shift - 30);

        // t = (upper^2 - lower^2) / 16 H in 2^-28 mm: eight more bits than a length, because the root below magnifies its error.
        let difference = (upper - lower) * (upper + lower);
        let fine = round_shift(
            multiply_high(difference, inverse.mantissa),
            inverse.shift - 36,
        );
        let along = round_shift(fine, 8);
        if along.abs() > twice_rod {
            return Err(PoseError::Unreachable);
        }
        // t^2 = whole^2 + whole * rest / 128 + rest^2 / 65536, the last below a quarter unit.
        let rest = fine - (along << 8);
        let along_square = along * along + round_shift(along * rest, 7);
        let radii = self.rod_square - round_shift(upper * upper + lower * lower, 3);
        let across_square = radii - base_square - along_square;
        if across_square < 0 {
            return Err(PoseError::Unreachable);
        }
        let across = Root::of(across_square as u64).rounded();
        if across < self.margin {
            return Err(PoseError::NearSingularity { distance: across });
        }

        let across = self.branch * across as i64;
        let y = round_shift(along * along_y - across * along_z, 30);
        let centre = round_shift(along * along_z + across * along_y, 30);
        let x =
            round_shift(l1 + l2 + l3 + l4, 2) - multiply_shift(sum, self.ratio, self.ratio_shift);
        let z = centre - self.rail_offset - multiply_shift(cosine, self.ratio, self.ratio_shift);
        let narrow = |value: i64| i32::try_from(value).map_err(|_| PoseError::Unreachable);
        Ok(Base {
            x: narrow(x)?,
            y: narrow(y)?,
            z: narrow(z)?,
            theta,
        })
    }
}
