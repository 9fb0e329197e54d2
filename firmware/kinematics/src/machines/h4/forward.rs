//! Forward kinematics of the H-4 arm: intersection of two circles, without iteration and without
//! division.
//!
//! With S12 = (l1 - l2) / 2 - w, S34 = (l3 - l4) / 2 - w, sin(theta) = (l1 + l2 - l3 - l4) / 4 c, D
//! = d - c cos(theta), Z = z_c + g_e:
//!
//! ```text
//! (y - E)^2 + (Z - D)^2 = R^2 - S12^2     and     (y + E)^2 + (Z + D)^2 = R^2 - S34^2
//! ```
//!
//! These are (3.17)-(3.19) of docs/control.md without their cancellation. The centres are +-(E, D).
//! Along the line through them the intersection is at t = (S12^2 - S34^2) / 4 H, H = hypot(E, D).
//! Across it the intersection is at +-q, q^2 = R^2 - (S12^2 + S34^2) / 2 - H^2 - t^2. q is the
//! distance from the parallel singularity, its sign is the assembly branch. Squaring loses the
//! signs of S12 and S34, so four conditions together verify a pose: S12 >= 0.09 R, S34 >= 0.09
//! R, |sin(theta)| < 1, q >= the margin.
//!
//! N = 4 c sin(theta) is a sum of slides and 4 c cos(theta) = sqrt((4 c - N) (4 c + N)) is one
//! root, so no sine is evaluated. The angle is the arc tangent of both, which is well conditioned
//! up to the quarter turn.
//!
//! H is never computed. With v = H^2 scaled into 1/4 to 1, sqrt(v) t and sqrt(v) q need no
//! division. Turning them by (E, D) leaves a division by v, which is a 32-bit reciprocal. The total
//! cost is two roots, one reciprocal and one arc tangent.

use super::{BasePose, H4, near_reach_limit};
use crate::{Joints, PoseError};
use haptimill_math::root::{Root, reciprocal};
use haptimill_math::scale::{
    high_product, multiply_high, round_shift, saturate, shift_left, shift_right, total,
};
use haptimill_math::trig::atan2;
use haptimill_math::{Coordinate, Length};

impl H4 {
    /// Pose of the tool in the base frame: x, y, z and theta of (3.17)-(3.19), without
    /// the table.
    ///
    /// # Errors
    /// [`PoseError::Unreachable`], [`near_reach_limit`], [`PoseError::NearSingularity`]:
    /// the slides have no verified pose.
    pub fn base_pose(&self, joints: &Joints) -> Result<BasePose, PoseError> {
        self.base(joints)
    }

    #[inline]
    pub(super) fn base(&self, joints: &Joints) -> Result<BasePose, PoseError> {
        let [l1, l2, l3, l4, ..] = joints.0;
        // Sums of a few 32-bit numbers: no more than 36 bits.
        let plus = |a: Coordinate, b: Coordinate| total(a.0 as i64, b.0 as i64);
        let minus = |a: Coordinate, b: Coordinate| total(a.0 as i64, -(b.0 as i64));
        let less = |a: i64, b: i64| total(a, b.wrapping_neg());

        // 2 S of both pairs: exact, with the sign that squaring loses.
        let twice_offset = (self.joint_offset as i64) << 1;
        let upper = less(minus(l1, l2), twice_offset);
        let lower = less(minus(l3, l4), twice_offset);
        let twice_rod = (self.rod as i64) << 1;
        let width = (self.half_spacing as i64) << 2;
        let sum = less(plus(l1, l2), plus(l3, l4));
        if sum.abs() >= width || upper > twice_rod || lower > twice_rod || !self.sound {
            return Err(PoseError::Unreachable);
        }
        // The bound for measured slides is wider than the planned one: a machine with a following
        // error must keep its pose at the planned bound.
        let min = self.min_measured as i64;
        if upper < min || lower < min {
            let pair = (upper >= min) as u8;
            return Err(near_reach_limit(pair));
        }
        // N and 2 S now fit 32 bits, below 2^31 and at most 2^31: the casts cut nothing, and the
        // products need no check.
        let (upper, lower) = (upper as u32, lower as u32);
        let square = |value: u32| (value as u64 * value as u64) as i64;
        let (upper_square, lower_square) = (square(upper), square(lower));

        // The tilt: N and 4 c cos(theta), both below 2^31.
        let (below, above) = (less(width, sum) as u32, total(width, sum) as u32);
        let cosine = Root::of(below as u64 * above as u64).rounded();
        let sum = sum as i32;
        let theta = atan2(sum, cosine);
        // |drop| < 2^30 + 2^29.
        let drop = (self.half_height as i64 - round_shift(cosine as i64, 2)) as i32;

        // H^2 < 2^62, and H >= 1 mm. Scaled by an even shift to v, 1/4 to 1 in Q64, and the
        // direction E, D with half that shift to Q31.
        let base_square = (square(self.lateral.unsigned_abs()) as u64)
            .wrapping_add(square(drop.unsigned_abs()) as u64);
        let half_shift = base_square.leading_zeros() / 2;
        let scaled = shift_left(base_square, 2 * half_shift);
        let grow = half_shift.saturating_sub(1);
        let (along_y, along_z) = (self.lateral << grow, drop << grow);

        // sqrt(v) t, and v q^2 = v (R^2 - (S12^2 + S34^2) / 2 - H^2) - v t^2: the division by H^2
        // follows at the end, where it only scales.
        let difference = round_shift(upper_square.wrapping_sub(lower_square), 4);
        let fine = shift_left(difference as u64, half_shift) as i64;
        if shift_right(fine, half_shift) != difference {
            return Err(PoseError::Unreachable);
        }
        let along_square = high_product(fine.unsigned_abs(), fine.unsigned_abs());
        // R^2 and the mean of the S^2 are 0 to 2^60, H^2 below 2^62: this fits.
        let free = self
            .rod_square
            .wrapping_sub(round_shift(upper_square.wrapping_add(lower_square), 3))
            .wrapping_sub(base_square as i64);
        let across_square =
            (high_product(free.max(0) as u64, scaled) as i64).wrapping_sub(along_square as i64);
        if across_square < 0 {
            return Err(PoseError::Unreachable);
        }
        let across = Root::of(across_square as u64).rounded();
        if (across_square as u64) < high_product(self.margin_square, scaled) {
            return Err(self.too_near(across, base_square, half_shift));
        }

        // (sqrt(v) t, sqrt(v) q) turned by the direction, over v: the numerators are below 2^61,
        // because t^2 + q^2 <= R^2.
        let along = round_shift(fine, 32);
        let across = self.branch.wrapping_mul(across as i64);
        let product = |a: i64, b: i32| a.wrapping_mul(b as i64);
        let numerator_y = product(along, along_y).wrapping_sub(product(across, along_z));
        let numerator_z = product(along, along_z).wrapping_add(product(across, along_y));
        let top = (scaled >> 32) as u32;
        let odd = top.leading_zeros() & 1;
        let inverse = reciprocal(top << odd) >> 1;
        let y = round_shift(multiply_high(numerator_y, inverse), 29 - odd);
        let centre = round_shift(multiply_high(numerator_z, inverse), 29 - odd);
        // To nearest; the shift is 1 to 32.
        let by_ratio = |value: i32| {
            let twice = shift_right(
                value as i64 * self.ratio as i64,
                self.ratio_shift.wrapping_sub(1),
            );
            total(twice, 1) >> 1
        };
        let x = less(
            round_shift(total(plus(l1, l2), plus(l3, l4)), 2),
            by_ratio(sum),
        );
        let z = less(less(centre, self.rail_offset as i64), by_ratio(cosine));
        let leaves = |value: i64| value ^ value as i32 as i64;
        if leaves(x) | leaves(y) | leaves(z) != 0 {
            return Err(PoseError::Unreachable);
        }
        Ok(BasePose {
            x: Length(x as i32),
            y: Length(y as i32),
            z: Length(z as i32),
            theta,
        })
    }

    /// Error for slides whose intersection is nearer to the singularity than the margin: q from
    /// sqrt(v) q.
    #[cold]
    fn too_near(&self, across: i32, base_square: u64, half_shift: u32) -> PoseError {
        // sqrt(v) = H 2^half_shift / 2^32.
        let base = (Root::of(base_square).rounded() as i64).max(1);
        let distance = ((across as i64) << (32 - half_shift)) / base;
        PoseError::NearSingularity {
            distance: saturate(distance).min(self.margin - 1),
        }
    }
}
