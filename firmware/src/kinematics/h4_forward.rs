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
        let upper = l1 - l2 - 2 * self.joint_offset as i64;
        let lower = l3 - l4 - 2 * self.joint_offset as i64;
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
        // Now N and 2 S are words, below 2^31 and at most 2^31: the casts cut nothing, and products of words need no check.
        let (upper, lower) = (upper as u32, lower as u32);
        let square = |value: u32| (value as u64 * value as u64) as i64;
        let (upper_square, lower_square) = (square(upper), square(lower));

        // The tilt: N and 4 c cos(theta), both below 2^31.
        let (less, more) = ((width - sum) as u32, (width + sum) as u32);
        let cosine = Root::of(less as u64 * more as u64).rounded();
        let sum = sum as i32;
        let theta = atan2(sum, cosine);
        // |drop| < 2^30 + 2^29.
        let drop = (self.half_height as i64 - round_shift(cosine as i64, 2)) as i32;

        // The line through the centres: H and its direction, Q30. H^2 < 2^62 and H >= 1 mm: the shifts below are 14 or more.
        let base_square = (square(self.lateral.unsigned_abs()) as u64)
            .wrapping_add(square(drop.unsigned_abs()) as u64);
        let inverse = Root::of(base_square).reciprocal();
        let scale = inverse.shift.wrapping_sub(30);
        let along_y = multiply_shift(self.lateral, inverse.mantissa as i32, scale) as i32;
        let along_z = multiply_shift(drop, inverse.mantissa as i32, scale) as i32;

        // t = (upper^2 - lower^2) / 16 H in 2^-28 mm: eight more bits than a length, because the root below magnifies its error.
        let difference = upper_square.wrapping_sub(lower_square);
        let fine = round_shift(
            multiply_high(difference, inverse.mantissa),
            inverse.shift.wrapping_sub(36),
        );
        let along = round_shift(fine, 8);
        if along.unsigned_abs() > twice_rod as u64 {
            return Err(PoseError::Unreachable);
        }
        // t^2 = whole^2 + whole * rest / 128 + rest^2 / 65536, the last below a quarter unit. |t| <= 2^31, so t^2 <= 2^62.
        let rest = (fine - (along << 8)) as i32;
        let along_square = along
            .wrapping_mul(along)
            .wrapping_add(round_shift(along.wrapping_mul(rest as i64), 7));
        // R^2 <= 2^60, the others up to 2^62: the sum stays within 2^63 + 2^61 below zero and cannot come near the other end.
        let radii = self
            .rod_square
            .wrapping_sub(round_shift(upper_square.wrapping_add(lower_square), 3));
        let across_square = radii
            .wrapping_sub(base_square as i64)
            .wrapping_sub(along_square);
        if across_square < 0 {
            return Err(PoseError::Unreachable);
        }
        let across = Root::of(across_square as u64).rounded();
        if across < self.margin {
            return Err(PoseError::NearSingularity { distance: across });
        }

        // |q| <= R; t and q are words and the direction is at most 2^30: sums below 2^62.
        let across = self.branch.wrapping_mul(across as i64);
        let along_y = along_y as i64;
        let along_z = along_z as i64;
        let y = round_shift(
            along
                .wrapping_mul(along_y)
                .wrapping_sub(across.wrapping_mul(along_z)),
            30,
        );
        let centre = round_shift(
            along
                .wrapping_mul(along_z)
                .wrapping_add(across.wrapping_mul(along_y)),
            30,
        );
        let x =
            round_shift(l1 + l2 + l3 + l4, 2) - multiply_shift(sum, self.ratio, self.ratio_shift);
        let z =
            centre - self.rail_offset as i64 - multiply_shift(cosine, self.ratio, self.ratio_shift);
        let narrow = |value: i64| i32::try_from(value).map_err(|_| PoseError::Unreachable);
        Ok(Base {
            x: narrow(x)?,
            y: narrow(y)?,
            z: narrow(z)?,
            theta,
        })
    }
}
