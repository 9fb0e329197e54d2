//! Kinematics of the H-4 arm with its rotary table: four slides and the table give a pose of five
//! coordinates.
//!
//! The pose is `[x_w, y_w, z_w, theta, alpha]`, the joints are `[l1, l2, l3, l4, alpha]`. The arm
//! moves the tool in x, y, z and theta (tilt about y); the table turns the workpiece by alpha about
//! x. All formulas are those of docs/control.md 2.5 to 2.7, in the compact form. With x = x_w +
//! x_offset, y = Y cos(alpha) - Z_t sin(alpha), z = Y sin(alpha) + Z_t cos(alpha) - h in the base
//! frame:
//!
//! ```text
//! l_i = x + m_i sin(theta) + s_i (w + S_i),   S_i^2 = R^2 - U_i^2 - V_i^2      (3.23)-(3.26)
//! U_i = E - sigma_i y,   V_i = -z - m_i cos(theta) + sigma_i d - g_e,  m_i = T_L + c (1 + sigma_i)
//! ```
//!
//! s = (+, -, +, -), sigma = (+, +, -, -). Rods 1 and 2 share U, V and S, and so do rods 3 and 4:
//! these are the two *rod pairs*.
//!
//! The parallel singularity is the line through the centres +-(E, D), D = d - c cos(theta), of the
//! two circles on which the platform is suspended (see the forward kinematics). The signed distance
//! from it is +-(E Z - y D) / hypot(E, D) with Z = z + (c + T_L) cos(theta) + g_e. The sign is
//! positive on the side of the configured branch. This module calls it the *singularity distance*.
//!
//! Limits: every `i32` in every coordinate gives a correct result or an error. Accepted joints and
//! poses are within 0.1 um and 1 urad of real arithmetic. A geometry must satisfy [`H4::is_sound`];
//! an unsound one refuses every pose.
//!
//! Cost on one core of a current server: inverse 37 ns, forward 51 ns, motion 84 ns. A division
//! occurs only for a pose that is refused, or nearly refused, for its singularity distance. So a
//! chip without a 64-bit divider does not lose time.
//!
//! Strokes and soft limits are not known here. Callers that need the strokes must use
//! [`crate::BoundedKinematics`].

mod box_bounds;
mod errors;
mod forward;
mod machine;
mod motion;
mod statics;

pub use errors::{TILT, near_reach_limit};

pub use machine::H4Geometry;
pub use statics::ToolForce;

use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::root::{Root, hypot};
use haptimill_math::scale::{round_q30, saturate, total};
use haptimill_math::trig::sin_cos;
use haptimill_math::{Angle, Coordinate, Length};
use motion::quick_turn;

/// Number of pose coordinates, and of joints.
pub(super) const AXES: usize = 5;
/// Index of the tilt theta in a pose.
pub(super) const THETA: usize = 3;
/// Index of the table alpha in a pose and in the joints.
pub(super) const ALPHA: usize = 4;

/// Longest rod and lateral distance: 1024 mm.
const LONGEST: i32 = 1 << 30;
/// Shortest lateral distance and platform spacing, 1 mm; smallest singularity margin, 1/16 mm.
const SHORTEST: i32 = 1 << 20;
const MIN_MARGIN: i32 = 1 << 16;
/// Shortest rod: 16 mm.
const SHORTEST_ROD: i32 = 1 << 24;

/// The H-4 arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct H4 {
    /// The geometry is sound; an unsound one refuses every pose.
    pub(super) sound: bool,
    /// E.
    pub(super) lateral: i32,
    /// c.
    pub(super) half_spacing: i32,
    /// d.
    pub(super) half_height: i32,
    /// w.
    pub(super) joint_offset: i32,
    /// R.
    pub(super) rod: i32,
    /// R^2, 2^-40 mm^2.
    pub(super) rod_square: i64,
    /// 2 |E|.
    twice_lateral: i64,
    /// h - g_e.
    level: i64,
    /// Smallest accepted S^2: (0.1 R)^2.
    min_square: i64,
    /// Smallest 2 S at which the pose of measured slides is verified: 0.18 R.
    pub(super) min_measured: i32,
    /// m of rods 1 and 2: T_L + 2 c.
    pub(super) upper: i32,
    /// m of rods 3 and 4: T_L.
    pub(super) lower: i32,
    /// (c + T_L) / 4 c as `ratio / 2^ratio_shift`: converts sums of slides to the displacement of
    /// the tip by the tilt.
    pub(super) ratio: i32,
    pub(super) ratio_shift: u32,
    /// p + x_Ow^O1, y_Ow^O1, z_O1^O2.
    pub(super) offset: [i32; 3],
    /// h.
    pub(super) table_height: i32,
    /// g_e.
    pub(super) rail_offset: i32,
    /// +1 or -1: sign of E Z - y D on the configured branch.
    pub(super) branch: i64,
    /// Singularity margin.
    pub(super) margin: i32,
    /// Square of the margin.
    pub(super) margin_square: u64,
    /// Largest number of bits of angular rates that are multiplied as 32-bit numbers.
    pub(super) quick_turn: u32,
}

/// Pose of the tool in the base frame, without table and offsets.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BasePose {
    /// Along the rails.
    pub x: Length,
    /// Across the rails.
    pub y: Length,
    /// Upwards.
    pub z: Length,
    /// Tilt about y.
    pub theta: Angle,
}

/// One rod pair at a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    /// U, |U| <= R.
    pub(super) u: i32,
    /// V, |V| <= R.
    pub(super) v: i32,
    /// S, 0.1 R to R.
    pub(super) root: Root,
}

/// Terms of a pose in the base frame that joints and rates share.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseTerms {
    /// x.
    pub(super) x: i64,
    /// y.
    pub(super) y: i64,
    /// z + h.
    pub(super) height: i64,
    /// Sine and cosine of theta, Q30.
    pub(super) tilt: (i32, i32),
    /// Sine and cosine of alpha, Q30.
    pub(super) table: (i32, i32),
    /// U, V of rods 1, 2.
    pub(super) upper: (i32, i32),
    /// U, V of rods 3, 4.
    pub(super) lower: (i32, i32),
}

impl H4 {
    /// The arm of a geometry.
    ///
    /// An unsound geometry is accepted, but refuses every pose as [`PoseError::Unreachable`].
    /// Callers must check it with [`H4::is_sound`] before a configuration becomes active.
    #[must_use]
    pub const fn new(geometry: &H4Geometry) -> Self {
        let rod = geometry.rod.0;
        let rod_square = rod as i64 * rod as i64;
        let spacing = geometry.half_spacing.0 as i64;
        let sound = Self::is_sound(geometry);
        let (ratio, ratio_shift) = if sound {
            scaled_ratio(spacing + geometry.tool.0 as i64, 4 * spacing)
        } else {
            (0, 1)
        };
        let below = if geometry.below { -1 } else { 1 };
        Self {
            sound,
            lateral: geometry.lateral.0,
            half_spacing: geometry.half_spacing.0,
            half_height: geometry.half_height.0,
            joint_offset: geometry.joint_offset.0,
            rod,
            rod_square,
            twice_lateral: 2 * geometry.lateral.magnitude() as i64,
            level: geometry.table_height.0 as i64 - geometry.rail_offset.0 as i64,
            min_square: rod_square / 100 + (rod_square % 100 != 0) as i64,
            // Rounded up.
            min_measured: ((18 * rod as i64 + 99) / 100) as i32,
            // Fits if the geometry is sound.
            upper: saturate(geometry.tool.0 as i64 + 2 * spacing),
            lower: geometry.tool.0,
            ratio,
            ratio_shift,
            offset: [
                geometry.x_offset.0,
                geometry.y_offset.0,
                geometry.z_offset.0,
            ],
            table_height: geometry.table_height.0,
            rail_offset: geometry.rail_offset.0,
            branch: if geometry.lateral.0 < 0 {
                -below
            } else {
                below
            },
            margin: geometry.singularity_margin.0,
            margin_square: {
                let margin = geometry.singularity_margin.magnitude() as u64;
                margin * margin
            },
            quick_turn: {
                let tool = geometry.tool.magnitude() as i64 + 2 * spacing.abs();
                let y =
                    geometry.lateral.magnitude() as i64 + geometry.rod.magnitude() as i64 + tool;
                let height = geometry.table_height.magnitude() as i64
                    + geometry.rail_offset.magnitude() as i64
                    + geometry.rod.magnitude() as i64
                    + geometry.half_height.magnitude() as i64
                    + tool;
                quick_turn(if y > height { y } else { height })
            },
        }
    }

    /// Whether the lengths are within the range of the arithmetic: R from 16 to 1024 mm, |E| from 1
    /// to 1024 mm, c from 1 mm to below 512 mm, d up to +-1024 mm, T_L from 0 to 1024 mm,
    /// singularity margin from 1/16 to 1024 mm. The other lengths are unrestricted.
    #[must_use]
    pub const fn is_sound(geometry: &H4Geometry) -> bool {
        let lateral = geometry.lateral.magnitude();
        geometry.rod.0 >= SHORTEST_ROD
            && geometry.rod.0 <= LONGEST
            && lateral >= SHORTEST as u32
            && lateral <= LONGEST as u32
            && geometry.half_spacing.0 >= SHORTEST
            && geometry.half_spacing.0 < LONGEST / 2
            && geometry.half_height.magnitude() <= LONGEST as u32
            && geometry.tool.0 >= 0
            && geometry.tool.0 <= LONGEST
            && geometry.singularity_margin.0 >= MIN_MARGIN
            && geometry.singularity_margin.0 <= LONGEST
    }

    /// Signed distance from the parallel singularity, positive on the side of the configured
    /// branch. The margin is not checked.
    ///
    /// # Errors
    /// [`TILT`], [`PoseError::Unreachable`]: the arm cannot take this pose.
    pub fn singularity_distance(&self, pose: &Pose) -> Result<Length, PoseError> {
        let terms = self.frame(pose)?;
        if self.square(terms.upper) < 0 || self.square(terms.lower) < 0 {
            return Err(PoseError::Unreachable);
        }
        Ok(Length(self.distance(&terms)))
    }

    /// Converts a pose to the base frame: the inverse of (3.14)-(3.16).
    #[inline(always)]
    pub(super) fn frame(&self, pose: &Pose) -> Result<PoseTerms, PoseError> {
        let [x_w, y_w, z_w, theta, alpha, _] = pose.0;
        check_tilt(theta)?;
        check_table(alpha)?;
        let tilt = sin_cos(theta.angle());
        let table = sin_cos(alpha.angle());

        let (across, up) = (
            y_w.0.checked_add(self.offset[1]),
            z_w.0.checked_add(self.offset[2]),
        );
        let (Some(across), Some(up)) = (across, up) else {
            return Err(PoseError::Unreachable);
        };
        let (y, height) = turn(across, up, table);

        // The others are 32-bit numbers, y and the height are below 2^33: no sum exceeds 36 bits.
        let less = |a: i64, b: i64| total(a, b.wrapping_neg());
        // A length is below 2^31, a cosine at most 1.
        let drop = |length: i32| round_q30(length as i64 * tilt.1 as i64) as i64;
        let below = less(self.level, height);
        let half_height = self.half_height as i64;
        let upper = (
            less(self.lateral as i64, y),
            less(total(below, half_height), drop(self.upper)),
        );
        let lower = (
            total(self.lateral as i64, y),
            less(less(below, half_height), drop(self.lower)),
        );
        // A value that exceeds 32 bits is out of reach. If both U fit into 32 bits, y does too:
        // their sum is 2 E.
        let leaves = |value: i64| value ^ value as i32 as i64;
        let beyond = leaves(upper.0) | leaves(upper.1) | leaves(lower.0) | leaves(lower.1);
        if beyond | leaves(height) != 0 || !self.sound {
            return Err(PoseError::Unreachable);
        }
        Ok(PoseTerms {
            x: total(x_w.0 as i64, self.offset[0] as i64),
            y,
            height,
            tilt,
            table,
            upper: (upper.0 as i32, upper.1 as i32),
            lower: (lower.0 as i32, lower.1 as i32),
        })
    }

    /// [`Kinematics::inverse_motion`], written to `motion`.
    #[inline(always)]
    pub(super) fn solve_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
        motion: &mut JointMotion,
    ) -> Result<(), PoseError> {
        let (terms, pairs) = self.solve_positions(pose)?;
        motion.joints = self.joints(&terms, &pairs, pose.0[ALPHA])?;
        self.derivatives(&terms, &pairs, rates, accelerations, motion);
        Ok(())
    }

    /// The pose with both pairs of rods, every condition but the strokes fulfilled.
    #[inline(always)]
    pub(super) fn solve_positions(&self, pose: &Pose) -> Result<(PoseTerms, [Pair; 2]), PoseError> {
        let terms = self.frame(pose)?;
        let upper = self.square(terms.upper);
        let lower = self.square(terms.lower);
        if upper < self.min_square || lower < self.min_square {
            return Err(if upper < 0 || lower < 0 {
                PoseError::Unreachable
            } else {
                let pair = (upper >= self.min_square) as u8;
                near_reach_limit(pair)
            });
        }
        // hypot(E, D) <= |E| + |D|: a pose that is far enough by this bound needs no root and no
        // division.
        let (cross, height) = self.cross(&terms);
        let width = total(self.twice_lateral, height);
        // margin <= 2^30, width <= 2^32.
        if cross < (self.margin as i64).wrapping_mul(width) {
            let distance = self.distance(&terms);
            if distance < self.margin {
                return Err(PoseError::NearSingularity { distance });
            }
        }
        let pair = |(u, v), square: i64| Pair {
            u,
            v,
            root: Root::of(square as u64),
        };
        Ok((terms, [pair(terms.upper, upper), pair(terms.lower, lower)]))
    }

    /// R^2 - U^2 - V^2; from -2^63 to 2^60.
    #[inline(always)]
    pub(super) fn square(&self, (u, v): (i32, i32)) -> i64 {
        // Squares of words are at most 2^62, R^2 is above 0: nothing wraps.
        let (u, v) = (u as i64 * u as i64, v as i64 * v as i64);
        self.rod_square.wrapping_sub(u).wrapping_sub(v)
    }

    /// 2 (E Z - y D) with the sign of the branch, and |2 D|. With U and V of both pairs, E Z - y D
    /// = -(U1 V3 + U3 V1) / 2 and D = (V1 - V3) / 2.
    ///
    /// U and V must not be longer than a rod.
    #[inline(always)]
    fn cross(&self, terms: &PoseTerms) -> (i64, i64) {
        let (u1, v1) = terms.upper;
        let (u3, v3) = terms.lower;
        // All four are at most 2^30 in magnitude: nothing wraps.
        let twice = (u1 as i64 * v3 as i64).wrapping_add(u3 as i64 * v1 as i64);
        let sign = !(self.branch >> 63);
        (
            (twice ^ sign).wrapping_sub(sign),
            v1.wrapping_sub(v3).unsigned_abs() as i64,
        )
    }

    /// The smallest S^2 of a pose that may be taken.
    pub(super) const fn min_square(&self) -> i64 {
        self.min_square
    }

    /// Whether the machine stays away from the parallel singularity if U is up to `by_u` and V up
    /// to `by_v` of its pair away from those of a pose.
    #[inline]
    pub(super) fn stays_regular(
        &self,
        terms: &PoseTerms,
        by_u: u32,
        by_v: [u32; 2],
    ) -> Result<(), PoseError> {
        let (cross, height) = self.cross(terms);
        // U1 + U3 is constant: what one gains the other one loses.
        let [by_v1, by_v3] = by_v.map(|by| i64::from(by.min(1 << 30)));
        let by_height = total(by_v1, by_v3);
        let less = i64::from(by_u.min(1 << 30)) * total(height, by_height)
            + i64::from(terms.upper.0).abs() * by_v3
            + i64::from(terms.lower.0).abs() * by_v1;
        let min = cross.saturating_sub(less);
        if min < i64::from(self.margin) * total(self.twice_lateral, total(height, by_height)) {
            let distance = self.distance_of(min, total(height, by_height));
            if distance < self.margin {
                return Err(PoseError::NearSingularity { distance });
            }
        }
        Ok(())
    }

    /// Signed distance from the parallel singularity, rounded towards zero.
    #[cold]
    fn distance(&self, terms: &PoseTerms) -> i32 {
        let (cross, height) = self.cross(terms);
        self.distance_of(cross, height)
    }

    #[cold]
    fn distance_of(&self, cross: i64, height: i64) -> i32 {
        let base = hypot(self.lateral, (height / 2) as i32).max(1);
        // |cross| <= 2^61, base >= 1 mm = 2^20: above 32 bits only if the geometry is absurd.
        saturate(cross / (2 * base as i64))
    }

    /// Joints of a solved pose, (3.23)-(3.26).
    #[inline(always)]
    pub(super) fn joints(
        &self,
        terms: &PoseTerms,
        pairs: &[Pair; 2],
        alpha: Coordinate,
    ) -> Result<Joints, PoseError> {
        let sine = terms.tilt.0;
        // x is below 2^32, all others are 32-bit numbers: no sum exceeds 36 bits.
        let lean = |length: i32| round_q30(length as i64 * sine as i64) as i64;
        let upper = total(terms.x, lean(self.upper));
        let lower = total(terms.x, lean(self.lower));
        let ahead = self.joint_offset as i64;
        let front = total(ahead, pairs[0].root.rounded() as i64);
        let rear = total(ahead, pairs[1].root.rounded() as i64);
        let first = total(upper, front);
        let second = total(upper, front.wrapping_neg());
        let third = total(lower, rear);
        let fourth = total(lower, rear.wrapping_neg());
        // One check for all values that exceed 32 bits.
        let leaves = |slide: i64| slide ^ slide as i32 as i64;
        if leaves(first) | leaves(second) | leaves(third) | leaves(fourth) != 0 {
            return Err(PoseError::Unreachable);
        }
        let slide = |value: i64| Coordinate(value as i32);
        Ok(Joints([
            slide(first),
            slide(second),
            slide(third),
            slide(fourth),
            alpha,
            Coordinate::ZERO,
        ]))
    }
}

/// `numerator / denominator` (at least 1/4, below 2^10) as a 31-bit number and its scale.
const fn scaled_ratio(numerator: i64, denominator: i64) -> (i32, u32) {
    let mut shift = 32;
    // numerator <= 2^31, so the product stays below 2^63.
    while ((numerator << shift) / denominator) > i32::MAX as i64 {
        shift -= 1;
    }
    (((numerator << shift) / denominator) as i32, shift)
}

/// The point (across, up) turned by the angle with this sine and cosine in Q30.
#[inline(always)]
fn turn(across: i32, up: i32, (sine, cosine): (i32, i32)) -> (i64, i64) {
    // Products of an i32 and a Q30 stay below 2^61, their sums below 2^62.
    let product = |a: i32, b: i32| a as i64 * b as i64;
    let round = |sum: i64| total(sum, 1 << 29) >> 30;
    (
        round(product(across, cosine).wrapping_sub(product(up, sine))),
        round(product(across, sine).wrapping_add(product(up, cosine))),
    )
}

/// Checks the tilt of the tool, which must be less than a quarter turn.
#[inline]
pub(super) fn check_tilt(theta: Coordinate) -> Result<(), PoseError> {
    if theta.magnitude() >= Angle::QUARTER.0 as u32 {
        return Err(TILT);
    }
    Ok(())
}

/// Checks the table, which may turn up to a quarter turn.
#[inline]
pub(super) fn check_table(alpha: Coordinate) -> Result<(), PoseError> {
    if alpha.magnitude() > Angle::QUARTER.0 as u32 {
        return Err(TILT);
    }
    Ok(())
}

impl Kinematics for H4 {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let (terms, pairs) = self.solve_positions(pose)?;
        self.joints(&terms, &pairs, pose.0[ALPHA])
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let mut motion = JointMotion::default();
        self.solve_motion(pose, rates, accelerations, &mut motion)?;
        Ok(motion)
    }

    #[inline]
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let alpha = joints.0[ALPHA];
        check_table(alpha)?;
        let base = self.base(joints)?;
        let (sine, cosine) = sin_cos(alpha.angle());
        // (3.14)-(3.16); h may be large, so the height is checked before the multiplication.
        let height = i32::try_from(base.z.0 as i64 + self.table_height as i64)
            .map_err(|_| PoseError::Unreachable)?;
        let (across, up) = turn(base.y.0, height, (-sine, cosine));
        // A 32-bit number is subtracted from one below 2^32.
        let [x, y, z] = self.offset;
        let x = total(base.x.0 as i64, -(x as i64));
        let y = total(across, -(y as i64));
        let z = total(up, -(z as i64));
        let leaves = |value: i64| value ^ value as i32 as i64;
        if leaves(x) | leaves(y) | leaves(z) != 0 {
            return Err(PoseError::Unreachable);
        }
        Ok(Pose([
            Coordinate(x as i32),
            Coordinate(y as i32),
            Coordinate(z as i32),
            base.theta.into(),
            alpha,
            Coordinate::ZERO,
        ]))
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        let (terms, pairs) = self.solve_positions(pose)?;
        Ok(self.slopes(&terms, &pairs))
    }

    #[inline]
    fn solve(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
        motion: &mut JointMotion,
    ) -> Result<(), PoseError> {
        self.solve_motion(pose, rates, accelerations, motion)
    }

    #[inline]
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        self.bounds_of_box(low, high, rates)
    }
}
