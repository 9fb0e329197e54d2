//! Forward kinematics of the haptic arm: poses of handle and tip from nine encoders
//! (docs/control.md 2.2).
//!
//! Three legs are on a circle at 0, 120 and 240 degrees. Each leg has a slide d along an axis that
//! is inclined inwards by theta2. The leg turns about that axis (theta3) and carries a link that is
//! inclined to the axis by theta4. The end of the link (joint 5) holds the platform of the handle.
//! Nine readings give six degrees of freedom. The three sides of the platform have known lengths,
//! and a side with a wrong length shows an encoder fault.
//!
//! The arithmetic is fixed point: lengths 2^-20 mm, directions Q30. Against f64 the error of the
//! tip is below 20 nm and that of a direction below 50 nrad (verified by a test); f32 would give
//! 1.4 urad.
//!
//! A [`ArmPose`] is only as good as the readings. Callers must obtain it from [`HapticArm::pose`]
//! or [`HapticArm::find`], which check the sides of the platform.

pub mod statics;

use haptimill_math::root::{Root, sqrt_rounded};
use haptimill_math::scale::{multiply_shift, round_q30, shift_right};
use haptimill_math::trig::sin_cos;
use haptimill_math::{Angle, Length};
use serde::{Deserialize, Serialize};

/// Number of legs of the arm.
pub const LEGS: usize = 3;

/// A vector: lengths in 2^-20 mm, or a direction in Q30.
pub type Vector = [i32; 3];

/// Lengths of the arm (docs/control.md 2.2, 7.2 REF-M).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HapticGeometry {
    /// r_b: radius of the circle of the legs, 10 to 400 mm.
    pub base_radius: Length,
    /// r_p: radius of the circle of the platform's joints, 10 to 400 mm.
    pub platform_radius: Length,
    /// L: length of the links, 10 to 400 mm.
    pub link: Length,
    /// theta2: inward inclination of the slides, below 80 degrees.
    pub tilt: Angle,
    /// Vector from the platform's centre to the tip, in the frame of the platform; each part up to
    /// 400 mm.
    pub tip: [Length; 3],
    /// Largest accepted error of a side of the platform; above 0 and below an eighth of
    /// `platform_radius`.
    pub side_tolerance: Length,
}

impl HapticGeometry {
    /// Whether all lengths are within their ranges.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let within = |length: Length| (10 << 20..=LENGTH_MAX).contains(&length.0);
        within(self.base_radius)
            && within(self.platform_radius)
            && within(self.link)
            && self.tilt.0.unsigned_abs() < Angle::degrees(80).0 as u32
            && self
                .tip
                .iter()
                .all(|part| part.magnitude() <= LENGTH_MAX as u32)
            && self.side_tolerance.0 > 0
            && i64::from(self.side_tolerance.0) * 8 < i64::from(self.platform_radius.0)
    }
}

/// Longest length of the arm that the arithmetic supports: 400 mm.
const LENGTH_MAX: i32 = 400 << 20;

/// Largest travel of a slide, in both directions: 800 mm.
pub const SLIDE_MAX: Length = Length(800 << 20);

/// Readings of the encoders of a leg.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LegReading {
    /// d.
    pub slide: Length,
    /// theta3.
    pub turn: Angle,
    /// theta4.
    pub hinge: Angle,
}

/// Reason why the readings give no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArmError {
    /// A slide is out by more than 800 mm.
    Slide {
        /// The leg.
        leg: u8,
    },
    /// A side of the platform has a wrong length.
    Side {
        /// Leg whose readings do not fit the other two: the one opposite the side with the smallest
        /// error.
        leg: u8,
        /// Error of the worst side; positive if it is too long.
        by: Length,
    },
}

/// Pose of a leg, for the statics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LegPose {
    /// Joint 5 in the frame of the base, (3.9).
    pub joint: Vector,
    /// The direction of the link from joint 4 to joint 5, Q30: -I_j of (3.41).
    pub link: Vector,
    /// The normal of the plane of link and slide, Q30: M_j of (3.41).
    pub normal: Vector,
    /// sin and cos of theta4, Q30.
    pub hinge: (i32, i32),
}

/// Pose of the handle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ArmPose {
    /// The legs.
    pub legs: [LegPose; LEGS],
    /// The platform's centre, (3.10).
    pub centre: Vector,
    /// n, o and a of (3.11), Q30: the columns of the rotation.
    pub axes: [Vector; 3],
    /// The tip, (3.12).
    pub tip: Vector,
}

/// Haptic arm: the geometry with its derived constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct HapticArm {
    legs: [Stand; LEGS],
    link: i32,
    platform_radius: i32,
    tip: Vector,
    /// Length of a side, and its square at both ends of the tolerance.
    side: i32,
    squares: (u64, u64),
}

/// Foot of a leg: its position, and the matrix R_z(theta1) R_y(-theta2) by rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Stand {
    base: Vector,
    rows: [Vector; 3],
}

/// 1 / sqrt(3) in Q30.
const INVERSE_ROOT_3: i32 = 619_925_131;

impl HapticArm {
    /// The arm of a geometry. Callers must pass a sound geometry.
    #[must_use]
    #[cold]
    #[inline(never)]
    pub fn new(geometry: &HapticGeometry) -> Self {
        let (s2, c2) = sin_cos(geometry.tilt);
        let legs = [0, 120, 240].map(|azimuth| {
            let (s1, c1) = sin_cos(Angle::degrees(azimuth));
            let radius = geometry.base_radius.0;
            let product = |a: i32, b: i32| multiply_shift(a, b, 30) as i32;
            Stand {
                base: [product(radius, c1), product(radius, s1), 0],
                rows: [
                    [product(c1, c2), -s1, -product(c1, s2)],
                    [product(s1, c2), c1, -product(s1, s2)],
                    [s2, 0, c2],
                ],
            }
        });
        // r_p sqrt(3): the root of 3 r_p^2, which is below 2^60.
        let radius = i64::from(geometry.platform_radius.0);
        let side = sqrt_rounded((3 * radius * radius) as u64);
        let square = |length: u32| u64::from(length) * u64::from(length);
        let tolerance = geometry.side_tolerance.magnitude();
        Self {
            legs,
            link: geometry.link.0,
            platform_radius: geometry.platform_radius.0,
            tip: geometry.tip.map(|part| part.0),
            side: side as i32,
            squares: (square(side - tolerance.min(side)), square(side + tolerance)),
        }
    }

    /// r_p, the scale of the moments.
    #[must_use]
    pub const fn platform_radius(&self) -> Length {
        Length(self.platform_radius)
    }

    /// L: length of the links.
    #[must_use]
    pub const fn link_length(&self) -> Length {
        Length(self.link)
    }

    /// Pose of the handle, (3.9)-(3.12).
    ///
    /// # Errors
    /// See [`ArmError`].
    pub fn pose(&self, readings: &[LegReading; LEGS]) -> Result<ArmPose, ArmError> {
        let mut pose = ArmPose::default();
        self.find(readings, &mut pose)?;
        Ok(pose)
    }

    /// Pose of the handle, (3.9)-(3.12), written to `pose`. After an error the content of `pose` is
    /// invalid.
    ///
    /// # Errors
    /// See [`ArmError`].
    pub fn find(&self, readings: &[LegReading; LEGS], pose: &mut ArmPose) -> Result<(), ArmError> {
        let legs = self.legs.iter().zip(readings).zip(&mut pose.legs);
        for (index, ((stand, reading), leg)) in legs.enumerate() {
            if reading.slide.magnitude() > SLIDE_MAX.0 as u32 {
                return Err(ArmError::Slide { leg: index as u8 });
            }
            stand.leg(reading, self.link, leg);
        }
        let [first, second, third] = [pose.legs[0].joint, pose.legs[1].joint, pose.legs[2].joint];
        let (min, max) = self.squares;
        let fits = |to: Vector, from: Vector| {
            let side = short(to, from)?;
            let square = dot(side, side) as u64;
            (min <= square && square <= max).then_some(side)
        };
        let sides = (fits(third, second), fits(first, third), fits(second, first));
        let (Some(opposite), Some(third_back), Some(second_out)) = sides else {
            return Err(self.find_faulty_leg(&[(third, second), (first, third), (second, first)]));
        };
        // The first joint plus a third of the vectors to the other two.
        let middle = |axis: usize| {
            first[axis].wrapping_add(second_out[axis].wrapping_sub(third_back[axis]) / 3)
        };
        pose.centre = [middle(0), middle(1), middle(2)];
        // The plane of the joints is the plane of the platform. In it, n of (3.11) and o (turned by
        // a quarter and scaled to the length of n) are equal when all readings are right. The mean
        // of both halves the error of one wrong reading.
        let a = unit(cross(third_back, second_out));
        let turned = cross(a, opposite).map(round_q30);
        let sum = |axis: usize| {
            let radial = i64::from(first[axis]) - i64::from(pose.centre[axis]);
            radial + i64::from(product_q30(turned[axis], INVERSE_ROOT_3))
        };
        let n = unit([sum(0), sum(1), sum(2)]);
        let o = cross(a, n).map(round_q30);
        let tip = |axis: usize| {
            let row = [n[axis], o[axis], a[axis]];
            pose.centre[axis].wrapping_add(round_q30(dot(row, self.tip)))
        };
        pose.tip = [tip(0), tip(1), tip(2)];
        pose.axes = [n, o, a];
        Ok(())
    }

    /// Finds the leg whose readings do not fit.
    #[cold]
    #[inline(never)]
    fn find_faulty_leg(&self, sides: &[(Vector, Vector); LEGS]) -> ArmError {
        let off = sides.map(|(to, from)| {
            let length =
                short(to, from).map_or(u32::MAX, |side| sqrt_rounded(dot(side, side) as u64));
            Length::saturating_from(i64::from(length) - i64::from(self.side))
        });
        let (mut best, mut worst) = (0, 0);
        for (index, by) in off.iter().enumerate() {
            if by.magnitude() < off[best].magnitude() {
                best = index;
            }
            if by.magnitude() > off[worst].magnitude() {
                worst = index;
            }
        }
        ArmError::Side {
            leg: best as u8,
            by: off[worst],
        }
    }
}

impl Stand {
    #[inline(always)]
    fn leg(&self, reading: &LegReading, length: i32, pose: &mut LegPose) {
        let (s3, c3) = sin_cos(reading.turn);
        let (s4, c4) = sin_cos(reading.hinge);
        let direction = [product_q30(c3, s4), product_q30(s3, s4), c4];
        for axis in 0..3 {
            let row = self.rows[axis];
            let link = round_q30(dot(row, direction));
            let along = product_q30(reading.slide.0, row[2]);
            // Below 1600 mm, so it fits.
            let joint = along.wrapping_add(product_q30(length, link));
            pose.link[axis] = link;
            pose.joint[axis] = self.base[axis].wrapping_add(joint);
            pose.normal[axis] = round_q30(dot(row, [s3, c3.wrapping_neg(), 0]));
        }
        pose.hinge = (s4, c4);
    }
}

/// Product with a direction, scaled back from Q30.
#[inline(always)]
fn product_q30(a: i32, b: i32) -> i32 {
    round_q30(i64::from(a) * i64::from(b))
}

/// Vector between two points; `None` if a part is 1024 mm or more. Its square is below 2^62.
#[inline(always)]
fn short(to: Vector, from: Vector) -> Option<Vector> {
    let mut way = [0; 3];
    for (axis, part) in way.iter_mut().enumerate() {
        *part = to[axis].checked_sub(from[axis])?;
        if part.unsigned_abs() >= 1 << 30 {
            return None;
        }
    }
    Some(way)
}

/// Scalar product, below 2^62: the parts of each vector are at most 2^30, or one vector is a
/// direction.
#[inline]
fn dot(a: Vector, b: Vector) -> i64 {
    let product = |axis: usize| i64::from(a[axis]) * i64::from(b[axis]);
    product(0).wrapping_add(product(1)).wrapping_add(product(2))
}

/// Vector product of vectors with parts of at most 2^30.
#[inline]
fn cross(a: Vector, b: Vector) -> [i64; 3] {
    let product = |i: usize, j: usize| {
        let (plus, minus) = (
            i64::from(a[i]) * i64::from(b[j]),
            i64::from(a[j]) * i64::from(b[i]),
        );
        plus.wrapping_sub(minus)
    };
    [product(1, 2), product(2, 0), product(0, 1)]
}

/// Direction of a vector with parts below 2^62, Q30.
#[inline(never)]
fn unit(vector: [i64; 3]) -> Vector {
    let all = vector.iter().fold(1, |all, part| all | part.unsigned_abs());
    // The longest part is between 2^29 and 2^30.
    let bits = 64 - all.leading_zeros();
    let scaled = if bits > 30 {
        vector.map(|part| shift_right(part, bits - 30) as i32)
    } else {
        vector.map(|part| (part as i32).wrapping_shl(30 - bits))
    };
    // At most 3 * 2^60. The root is 2^29 to 2^31, so its reciprocal has a shift of 60 or 61; minus
    // the scaling to Q30 that leaves 30 or 31. (The root of a zero vector is that of 1, and the
    // shift is 1.)
    let reciprocal = Root::of(dot(scaled, scaled) as u64).reciprocal();
    let shift = reciprocal.shift.saturating_sub(30).clamp(1, 31);
    let half = i64::from(1_u32 << (shift - 1));
    // Below 2^61, and the direction fits 32 bits.
    scaled.map(|part| {
        let part = i64::from(part) * i64::from(reciprocal.mantissa) + half;
        ((part as u32) >> shift | ((part >> 32) as u32) << (32 - shift)) as i32
    })
}
