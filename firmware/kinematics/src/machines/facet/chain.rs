//! The chain of lift, tilt and spin: its frames, and its joints from a frame.
//!
//! Modified D-H parameters; angles in degrees:
//!
//! | i | alpha of i-1 | a of i-1 | d of i | theta of i |
//! | --- | --- | --- | --- | --- |
//! | 1 | 0 | 0 | d1 | 0 |
//! | 2 | -90 | L2 | 0 | theta2 |
//! | 3 | 90 | L3 | 0 | theta3 |
//! | 4 | 0 | 0 | L4 | 0 |
//!
//! With c2 = cos theta2 and so on, frame 4 in frame 0 is
//!
//! ```text
//! R = |  c2 c3  -c2 s3   s2 |   p = | L2 + L3 c2 + L4 s2 |                                (C41)
//!     |  s3      c3      0  |       | 0                  |
//!     | -s2 c3   s2 s3   c2 |       | d1 - L3 s2 + L4 c2 |
//! ```
//!
//! A full pose has six numbers and the chain three joints, so most poses are out of its reach.
//! [`Chain::inverse`] checks all the others. The solution is unique up to whole turns. The pose map
//! has no singularity; the map from (d1, theta2) to (p_x, p_z) has two branches, which meet at the
//! [`Chain::singular_angles`].

use super::{FacetGeometry, MAX_ARM};
use crate::planar::per_turn;
use haptimill_math::scale::{round_shift, scale, total};
use haptimill_math::trig::{atan2, sin_cos, unit_angle};
use haptimill_math::{Angle, Coordinate, Length, root};

/// Largest residual of an entry of the rotation, Q30: 1e-6.
const ROTATION_TOLERANCE: u32 = 1074;
/// Largest residual of a position: 0.01 mm.
const POSITION_TOLERANCE: u32 = 10_486;

/// Joints of the chain.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ChainJoints {
    /// Lift d1.
    pub d1: Coordinate,
    /// Tilt theta2.
    pub theta2: Angle,
    /// Spin theta3.
    pub theta3: Angle,
}

/// A frame in the base: a rotation, by its rows in Q30, and a position.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ChainPose {
    /// Rotation matrix, Q30.
    pub rotation: [[i32; 3]; 3],
    /// Position, 2^-20 mm.
    pub position: [Coordinate; 3],
}

/// Reason why the chain cannot take a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutOfReach {
    /// An entry of the rotation differs from that of the chain by more than 1e-6: the row and
    /// column, from 0. A mirrored rotation is one of them.
    Rotation(u8, u8),
    /// A coordinate of the position differs by more than 0.01 mm: 0 for x, 1 for y.
    Position(u8),
    /// A result is beyond the range of a coordinate.
    Range,
    /// No tilt brings the tip to this x: it is farther from L2 than the length of the arm.
    Arm,
}

/// The chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chain {
    l2: i64,
    l3: i64,
    l4: i64,
}

/// Product of two numbers in Q30.
#[inline(always)]
const fn times(a: i32, b: i32) -> i32 {
    round_shift(a as i64 * b as i64, 30) as i32
}

/// The first number that differs by more than a tolerance from one within +-2^30. The largest
/// difference is computed first, without a branch, because a frame within reach has none above it.
#[inline(always)]
fn residual(is: &[i32], can: &[i32], tolerance: u32) -> Option<u8> {
    let pairs = || is.iter().zip(can);
    // From 0 to twice the tolerance if it is within; less than 0 wraps to a large number.
    let shifted = |(is, can): (&i32, &i32)| (is.wrapping_sub(*can) as u32).wrapping_add(tolerance);
    if pairs().map(shifted).fold(0, u32::max) <= 2 * tolerance {
        return None;
    }
    let differences = || pairs().map(|(is, can)| is.abs_diff(*can));
    differences()
        .position(|is| is > tolerance)
        .map(|entry| entry as u8)
}

/// A pair in Q30 at the length 1, if its length differs from 1 by less than 1.9e-6. Error at most
/// 1 unit. Every pair that is within the tolerance of a sine and a cosine has such a length.
#[inline(always)]
const fn unit(sine: i32, cosine: i32) -> Option<(i32, i32)> {
    // Each square is at most 2^62.
    let square = (sine as i64 * sine as i64) as u64 + (cosine as i64 * cosine as i64) as u64;
    // 2 (length - 1) in Q30, without the square of length - 1, which is below 2^-37.
    let excess = square.wrapping_sub(1 << 60) as i64 >> 30;
    if excess.abs() >= 1 << 12 {
        return None;
    }
    Some((
        sine - round_shift(sine as i64 * excess, 31) as i32,
        cosine - round_shift(cosine as i64 * excess, 31) as i32,
    ))
}

/// The angle of a sine and a cosine, with the pair at the length 1. A frame within reach has such
/// pairs; those of another frame are computed from the angle.
#[inline(always)]
const fn angle_and_pair(sine: i32, cosine: i32) -> (Angle, (i32, i32)) {
    match unit(sine, cosine) {
        Some(pair) => (unit_angle(pair.0, pair.1), pair),
        None => angle_of_other_pair(sine, cosine),
    }
}

/// Out of line: no frame within reach needs it.
#[cold]
#[inline(never)]
const fn angle_of_other_pair(sine: i32, cosine: i32) -> (Angle, (i32, i32)) {
    let angle = atan2(sine, cosine);
    (angle, sin_cos(angle))
}

/// A coordinate, if it is within its range.
const fn coordinate(value: i64) -> Result<Coordinate, OutOfReach> {
    if value == value as i32 as i64 {
        Ok(Coordinate(value as i32))
    } else {
        Err(OutOfReach::Range)
    }
}

impl Chain {
    /// The chain of a machine.
    #[must_use]
    pub fn new(geometry: &FacetGeometry) -> Self {
        let arm = |length: Length| i64::from(length.0).clamp(-MAX_ARM, MAX_ARM);
        Self {
            l2: i64::from(geometry.l2.0),
            l3: arm(geometry.l3),
            l4: arm(geometry.l4),
        }
    }

    /// (p_x - L2, p_z - d1) at a tilt.
    #[inline(always)]
    fn arm(&self, (sine, cosine): (i32, i32)) -> [i64; 2] {
        [
            total(scale(self.l3, cosine, 30), scale(self.l4, sine, 30)),
            total(scale(self.l4, cosine, 30), scale(self.l3, -sine, 30)),
        ]
    }

    /// Frame 4 in frame 0 (C41).
    ///
    /// # Errors
    /// [`OutOfReach::Range`].
    pub fn forward(&self, joints: &ChainJoints) -> Result<ChainPose, OutOfReach> {
        self.frame(
            i64::from(joints.d1.0),
            sin_cos(joints.theta2),
            sin_cos(joints.theta3),
        )
    }

    /// Frame 4 in frame 0 (C41), from d1 and the sines and cosines of the angles.
    #[inline(always)]
    fn frame(
        &self,
        d1: i64,
        (s2, c2): (i32, i32),
        (s3, c3): (i32, i32),
    ) -> Result<ChainPose, OutOfReach> {
        let [across, along] = self.arm((s2, c2));
        Ok(ChainPose {
            rotation: [
                [times(c2, c3), -times(c2, s3), s2],
                [s3, c3, 0],
                [-times(s2, c3), times(s2, s3), c2],
            ],
            position: [
                coordinate(total(self.l2, across))?,
                Coordinate::ZERO,
                coordinate(total(d1, along))?,
            ],
        })
    }

    /// Joints of a frame: theta2 = atan2(r13, r33), theta3 = atan2(r21, r22), and d1 from p_z.
    ///
    /// # Errors
    /// The part of the frame that the chain cannot take.
    pub fn inverse(&self, frame: &ChainPose) -> Result<ChainJoints, OutOfReach> {
        let [[_, _, r13], [r21, r22, _], [_, _, r33]] = frame.rotation;
        let (theta2, tilt) = angle_and_pair(r13, r33);
        let (theta3, spin) = angle_and_pair(r21, r22);
        let along = self.arm(tilt)[1];
        let d1 = coordinate(total(i64::from(frame.position[2].0), -along))?;
        let joints = ChainJoints { d1, theta2, theta3 };
        let reached = self.frame(i64::from(d1.0), tilt, spin)?;
        let [is, can] = [frame, &reached].map(|of| of.rotation.as_flattened());
        if let Some(entry) = residual(is, can, ROTATION_TOLERANCE) {
            return Err(OutOfReach::Rotation(entry / 3, entry % 3));
        }
        for axis in 0..2 {
            let [is, can] = [frame, &reached].map(|of| of.position[axis].0);
            if is.abs_diff(can) > POSITION_TOLERANCE {
                return Err(OutOfReach::Position(axis as u8));
            }
        }
        Ok(joints)
    }

    /// The rates of frame 4 for the rates of d1, theta2 and theta3 (C43). The rows are v_x, v_y,
    /// v_z and the turning rates about x, y and z of the base.
    ///
    /// Q32 per ratio of units: a speed per rate of an angle is in 2^-20 mm per 2^-32 turn.
    #[must_use]
    pub fn jacobian(&self, theta2: Angle) -> [[i64; 3]; 6] {
        let (s2, c2) = sin_cos(theta2);
        let [across, along] = self.arm((s2, c2));
        let one = 1_i64 << 32;
        let q32 = |q30: i32| i64::from(q30) << 2;
        [
            [0, per_turn(along), 0],
            [0, 0, 0],
            [one, -per_turn(across), 0],
            [0, 0, q32(s2)],
            [0, one, 0],
            [0, 0, q32(c2)],
        ]
    }

    /// Lift and tilt that bring the tip to (p_x, p_z): both branches, theta2 = phi +- arccos((p_x -
    /// L2) / R) with R^2 = L3^2 + L4^2 and phi = atan2(L4, L3). At a singular angle they are one.
    ///
    /// Near a singular angle the tilt has the error of a square root: 1 nm of p_x is sqrt(2 nm / R)
    /// there.
    ///
    /// # Errors
    /// [`OutOfReach::Arm`], [`OutOfReach::Range`].
    pub fn branches(&self, x: Coordinate, z: Coordinate) -> Result<[ChainJoints; 2], OutOfReach> {
        let away = i64::from(x.0) - self.l2;
        let max = self.l3.unsigned_abs() + self.l4.unsigned_abs();
        // Scaled up so that the root keeps 30 bits.
        let shift = max.max(1).leading_zeros().saturating_sub(34);
        let [l3, l4] = [self.l3 << shift, self.l4 << shift];
        if away.unsigned_abs() > max {
            return Err(OutOfReach::Arm);
        }
        let away = away << shift;
        // L3 and L4 are at most 2^30 and their sum 2^31, so each square fits.
        let square = l3 * l3 + l4 * l4 - away * away;
        let Ok(square) = u64::try_from(square) else {
            return Err(OutOfReach::Arm);
        };
        let aside = root::sqrt_rounded(square) as i32;
        let spread = atan2(aside, away as i32);
        let middle = atan2(l4 as i32, l3 as i32);
        let branch = |theta2: Angle| {
            let along = self.arm(sin_cos(theta2))[1];
            Ok(ChainJoints {
                d1: coordinate(i64::from(z.0) - along)?,
                theta2,
                theta3: Angle::ZERO,
            })
        };
        Ok([
            branch(middle.wrapping_add(spread))?,
            branch(middle.wrapping_sub(spread))?,
        ])
    }

    /// Tilts at which p_x has its extremes, so that both branches meet: atan2(L4, L3), and half a
    /// turn farther.
    #[must_use]
    pub fn singular_angles(&self) -> [Angle; 2] {
        let max = self.l3.unsigned_abs().max(self.l4.unsigned_abs());
        let shift = max.max(1).leading_zeros().saturating_sub(34);
        let angle = atan2((self.l4 << shift) as i32, (self.l3 << shift) as i32);
        [angle, angle.wrapping_add(Angle::HALF)]
    }
}

/// The spin nearest to the present one, in turns of 2^-32, of which the lower 32 bits are the
/// angle: several turns in one direction stay in that direction.
#[must_use]
pub const fn unwrap(present: i64, angle: Angle) -> i64 {
    let step = (angle.0).wrapping_sub(present as i32);
    present.wrapping_add(step as i64)
}
