//! Kinematics of a SCARA arm: a shoulder and an elbow that turn about vertical axes, and a vertical
//! slide.
//!
//! The pose is `[x, y, z]`: the tip of the tool in the workpiece frame. The joints are `[theta1,
//! theta2, z]`: the angle of the upper arm from +x, the angle of the forearm from the upper arm,
//! and the slide, which is the coordinate of its name. With the lengths of [`ScaraGeometry`] and
//! (X, Y) = (x + x_off, y + y_off), from the shoulder:
//!
//! ```text
//! X = upper cos(theta1) + fore cos(theta1 + theta2)
//! Y = upper sin(theta1) + fore sin(theta1 + theta2)
//! ```
//!
//! With r^2 = X^2 + Y^2 the inverse is
//!
//! ```text
//! S = sqrt(((upper + fore)^2 - r^2) (r^2 - (upper - fore)^2))    four times the area
//! theta2 = +- atan2(S, r^2 - upper^2 - fore^2)
//! theta1 = atan2(Y, X) -+ atan2(S, r^2 + upper^2 - fore^2)
//! ```
//!
//! The upper sign is the branch with the elbow on the right of the line from shoulder to tip.
//!
//! The workspace is the annulus |upper - fore| < r < upper + fore. At both of its circles the arm
//! is straight, and a rate of the tip along it needs infinite rates of the joints. The singularity
//! distance is that of the tip from the line of the upper arm, fore sin|theta2| = S / (2 upper).

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::planar::{RADIAN, TWO_PI_Q28};
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::root::sqrt_rounded;
use haptimill_math::scale::{round_shift, saturate, scale};
use haptimill_math::trig::{atan2, sin_cos};
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 3;
/// Index of the slide in a pose and in the joints.
const Z: usize = 2;

/// Shortest and longest link, 2^-20 mm: 16 mm and 1000 mm.
const LINK: core::ops::RangeInclusive<i32> = 16 << 20..=1000 << 20;
/// Least singularity margin, 2^-20 mm: 1 mm. Quotients by the singularity distance fit then.
const MIN_MARGIN: i32 = 1 << 20;

/// Lengths of a SCARA arm, 2^-20 mm.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ScaraGeometry {
    /// From the axis of the shoulder to that of the elbow.
    pub upper: Length,
    /// From the axis of the elbow to the tip of the tool.
    pub fore: Length,
    /// x and y of the workpiece's origin, from the axis of the shoulder.
    pub origin: [Length; 2],
    /// The elbow is on the right of the line from shoulder to tip: theta2 is positive.
    pub right: bool,
    /// Least accepted singularity distance.
    pub singularity_margin: Length,
}

/// The SCARA arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Scara {
    upper: i64,
    fore: i64,
    origin: [i64; 2],
    right: bool,
    /// Least S; beyond every S for an unsound geometry.
    min: i64,
}

/// The triangle of shoulder, elbow and tip.
#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// r^2, below 2^62.
    square: i64,
    /// S: four times the area, positive, at most 2^61 + 2^31.
    area: i64,
}

/// A pose with its joint angles.
#[derive(Debug, Clone, Copy)]
struct SolvedPose {
    triangle: Triangle,
    theta: [Angle; 2],
}

/// Angle of a point; the larger coordinate is brought to 30 bits.
fn angle_of(y: i64, x: i64) -> Angle {
    let bits = 64 - (y.unsigned_abs() | x.unsigned_abs()).leading_zeros();
    let by = bits.saturating_sub(30);
    atan2((y >> by) as i32, (x >> by) as i32)
}

/// Upper 32 bits of a number, and the exponent of 2 that they lack.
const fn mantissa(value: u64) -> (u64, u32) {
    let exponent = (64 - value.leading_zeros()).saturating_sub(32);
    (value >> exponent, exponent)
}

/// Square root of a product, relative error below 2^-29 for a product from 2^59 upwards.
fn root_of_product(a: u64, b: u64) -> i64 {
    let ((a, by_a), (b, by_b)) = (mantissa(a), mantissa(b));
    let by = by_a + by_b;
    let odd = by & 1;
    i64::from(sqrt_rounded((a * b) >> odd)) << ((by + odd) / 2)
}

/// A length per radian as a length per turn.
fn per_turn(lever: i64) -> i64 {
    scale(lever, TWO_PI_Q28, 28)
}

/// Acceleration of the end of a lever that turns, towards its axis, 2^-12 mm/s^2.
fn centripetal(lever: i64, rate: Rate) -> i64 {
    let speed = scale(per_turn(lever), rate.0, 32);
    round_shift(scale(per_turn(speed), rate.0, 32), 8)
}

/// Component of a vector along a direction of this sine and cosine.
fn along([x, y]: [i64; 2], (sine, cosine): (i32, i32)) -> i64 {
    scale(x, cosine, 30) + scale(y, sine, 30)
}

/// Magnitude of a vector, rounded up.
fn magnitude([x, y]: [i64; 2]) -> i64 {
    let square = x.unsigned_abs().pow(2) + y.unsigned_abs().pow(2);
    match square {
        0 => 0,
        _ => i64::from(sqrt_rounded(square)) + 1,
    }
}

impl Scara {
    /// +1 for the elbow on the right, -1 for the left.
    const fn side(&self) -> i64 {
        if self.right { 1 } else { -1 }
    }

    /// The tip from the shoulder; `None` beyond a square about the workspace.
    fn tip(&self, pose: &Pose) -> Option<[i64; 2]> {
        let at = [0, 1].map(|axis| i64::from(pose.0[axis].0) + self.origin[axis]);
        let reach = self.upper + self.fore;
        (at[0].abs() <= reach && at[1].abs() <= reach).then_some(at)
    }

    /// The triangle with the tip at a distance of this square.
    fn triangle(&self, square: i64) -> Result<Triangle, PoseError> {
        let (outer, inner) = (self.upper + self.fore, self.upper - self.fore);
        let (outside, inside) = (outer * outer - square, square - inner * inner);
        if outside <= 0 || inside <= 0 {
            return Err(PoseError::Unreachable);
        }
        let area = root_of_product(outside.unsigned_abs(), inside.unsigned_abs());
        if area < self.min {
            return Err(PoseError::NearSingularity {
                distance: saturate(area / (2 * self.upper).max(1)),
            });
        }
        Ok(Triangle { square, area })
    }

    /// Magnitude of theta2.
    fn bend(&self, triangle: &Triangle) -> Angle {
        let across = triangle.square - self.upper * self.upper - self.fore * self.fore;
        angle_of(triangle.area, across)
    }

    /// The joint angles of a pose.
    fn solve_positions(&self, pose: &Pose) -> Result<SolvedPose, PoseError> {
        let [x, y] = self.tip(pose).ok_or(PoseError::Unreachable)?;
        let triangle = self.triangle(x * x + y * y)?;
        let ahead = triangle.square + self.upper * self.upper - self.fore * self.fore;
        let (bend, lead) = (self.bend(&triangle), angle_of(triangle.area, ahead));
        let towards = angle_of(y, x);
        let theta = if self.right {
            [towards.wrapping_sub(lead), bend]
        } else {
            [towards.wrapping_add(lead), bend.wrapping_neg()]
        };
        Ok(SolvedPose { triangle, theta })
    }

    fn joints(pose: &Pose, [theta1, theta2]: [Angle; 2]) -> Joints {
        let mut joints = Joints::default();
        joints.0[..AXES].copy_from_slice(&[theta1.into(), theta2.into(), pose.0[Z]]);
        joints
    }

    /// Levers of the upper arm and of both arms together, upper sin(theta2) and fore sin(theta2),
    /// without their sign.
    fn levers(&self, triangle: &Triangle) -> [i64; 2] {
        [self.fore, self.upper].map(|other| (triangle.area / (2 * other)).max(1))
    }

    /// Directions of the upper arm and of the forearm: sine and cosine, Q30.
    fn directions([theta1, theta2]: [Angle; 2]) -> [(i32, i32); 2] {
        [sin_cos(theta1), sin_cos(theta1.wrapping_add(theta2))]
    }

    /// Rates of the upper arm and of the forearm in the plane, 2^-32 turn/s, for a velocity of the
    /// tip in 2^-20 mm/s of at most 2^33; or accelerations, 2^-24 turn/s^2, for 2^-12 mm/s^2.
    ///
    /// The tip moves by w1 upper n1 + w12 fore n12, with n normal to the arms. Its component along
    /// the forearm is w1 upper sin(theta2), that along the upper arm is -w12 fore sin(theta2).
    fn turns(
        &self,
        velocity: [i64; 2],
        [arm, forearm]: [(i32, i32); 2],
        levers: [i64; 2],
    ) -> [i64; 2] {
        [
            self.side() * (along(velocity, forearm) * RADIAN / levers[0]),
            -self.side() * (along(velocity, arm) * RADIAN / levers[1]),
        ]
    }
}

impl Machine for Scara {
    type Geometry = ScaraGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::{Linear, Rotary};
        Descriptor {
            code: "scara",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("z", Linear, 'Z', Role::ToolZ),
            ],
            joints: &[
                JointDescriptor::new("theta1", Rotary),
                JointDescriptor::new("theta2", Rotary),
                JointDescriptor::new("z", Linear),
            ],
            errors: &[],
        }
    };

    fn new(geometry: &ScaraGeometry) -> Self {
        let origin = geometry.origin.map(|length| i64::from(length.0));
        let right = geometry.right;
        if !Self::is_sound(geometry) {
            // No pose is within links without length.
            return Self {
                upper: 0,
                fore: 0,
                origin,
                right,
                min: i64::MAX,
            };
        }
        let upper = i64::from(geometry.upper.0);
        Self {
            upper,
            fore: i64::from(geometry.fore.0),
            origin,
            right,
            min: 2 * upper * i64::from(geometry.singularity_margin.0),
        }
    }

    fn is_sound(geometry: &ScaraGeometry) -> bool {
        let margin = geometry.singularity_margin.0;
        LINK.contains(&geometry.upper.0)
            && LINK.contains(&geometry.fore.0)
            && (MIN_MARGIN..geometry.fore.0).contains(&margin)
    }

    fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        let distance = |area: i64| Length(saturate(area / (2 * self.upper).max(1)));
        Some(match self.solve_positions(pose) {
            Ok(solved) => Ok(distance(solved.triangle.area)),
            Err(PoseError::NearSingularity { distance }) => Ok(Length(distance)),
            Err(error) => Err(error),
        })
    }

    /// One joint turns, the others are at rest: the tip moves on a circle about the joint.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        let turn = Rate(saturate(rate));
        let tangential_rate = |lever: i64| scale(per_turn(lever), turn.0, 32);
        let Ok(solved) = self.solve_positions(pose) else {
            return rates;
        };
        let [(arm_sine, arm_cosine), (sine, cosine)] = Self::directions(solved.theta);
        let fore = [cosine, sine].map(|part| scale(self.fore, part, 30));
        let upper = [arm_cosine, arm_sine].map(|part| scale(self.upper, part, 30));
        match joint {
            0 => {
                rates[0] = -tangential_rate(upper[1] + fore[1]);
                rates[1] = tangential_rate(upper[0] + fore[0]);
            }
            1 => {
                rates[0] = -tangential_rate(fore[1]);
                rates[1] = tangential_rate(fore[0]);
            }
            _ => rates[Z] = rate,
        }
        rates
    }
}

impl Kinematics for Scara {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        Ok(Self::joints(pose, self.solve_positions(pose)?.theta))
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let SolvedPose { triangle, theta } = self.solve_positions(pose)?;
        let levers = self.levers(&triangle);
        let directions = Self::directions(theta);
        let velocity = [0, 1].map(|axis| i64::from(rates[axis].0));
        let [arm, both] = self.turns(velocity, directions, levers);
        // What the arms need to stay on their circles adds to the acceleration of the tip. A rate
        // or acceleration beyond the range is held at its end, which is above every limit.
        let mut push = [0, 1].map(|axis| i64::from(accelerations[axis].0));
        let turning = [(self.upper, arm), (self.fore, both)];
        for ((length, rate), (sine, cosine)) in turning.into_iter().zip(directions) {
            let pull = centripetal(length, Rate(saturate(rate)));
            push[0] += scale(pull, cosine, 30);
            push[1] += scale(pull, sine, 30);
        }
        let [arm_push, both_push] = self.turns(push, directions, levers);
        let mut motion = JointMotion {
            joints: Self::joints(pose, theta),
            ..JointMotion::default()
        };
        motion.rates[..AXES].copy_from_slice(&[
            Rate(saturate(arm)),
            Rate(saturate(both - arm)),
            rates[Z],
        ]);
        motion.accelerations[..AXES].copy_from_slice(&[
            Acceleration(saturate(arm_push)),
            Acceleration(saturate(both_push - arm_push)),
            accelerations[Z],
        ]);
        Ok(motion)
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let theta = [joints.0[0].angle(), joints.0[1].angle()];
        let (bend, _) = sin_cos(theta[1]);
        let distance = self.side() * scale(self.fore, bend, 30);
        if 2 * self.upper * distance < self.min {
            return Err(PoseError::NearSingularity {
                distance: saturate(distance),
            });
        }
        let [(arm_sine, arm_cosine), (sine, cosine)] = Self::directions(theta);
        let tip = |arm: i32, forearm: i32, origin: i64| {
            let at = scale(self.upper, arm, 30) + scale(self.fore, forearm, 30) - origin;
            i32::try_from(at)
                .map(Coordinate)
                .map_err(|_| PoseError::Unreachable)
        };
        let mut pose = Pose::default();
        pose.0[0] = tip(arm_cosine, cosine, self.origin[0])?;
        pose.0[1] = tip(arm_sine, sine, self.origin[1])?;
        pose.0[Z] = joints.0[Z];
        Ok(pose)
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        let SolvedPose { triangle, theta } = self.solve_positions(pose)?;
        let levers = self.levers(&triangle);
        let directions = Self::directions(theta);
        let mut jacobian = Jacobian([[0; MAX_AXES]; MAX_AXES]);
        for column in 0..2 {
            // A millimetre along the coordinate, Q30 and twice more, to Q32.
            let mut way = [0; 2];
            way[column] = 1_i64 << 32;
            let [arm, both] = self.turns(way, directions, levers);
            jacobian.0[0][column] = arm;
            jacobian.0[1][column] = both - arm;
        }
        jacobian.0[Z][Z] = 1 << 32;
        Ok(jacobian)
    }

    /// The distances from the shoulder bound theta2, which grows with them in one direction. They
    /// bound the slopes of both angles, too: S is least at one of the ends. theta1 is within its
    /// slope times half the diagonal of that in the middle.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let width = |axis: usize| i64::from(high.0[axis].0) - i64::from(low.0[axis].0);
        let mut middle = *low;
        for axis in 0..2 {
            middle.0[axis] = Coordinate((i64::from(low.0[axis].0) + width(axis) / 2) as i32);
        }
        let solved = self.solve_positions(&middle)?;
        let half = magnitude([0, 1].map(|axis| (width(axis) + 1) / 2));
        let r = magnitude(self.tip(&middle).ok_or(PoseError::Unreachable)?);
        let (near, far) = (r - half - 2, r + half + 2);
        if near <= 0 || far > self.upper + self.fore {
            return Err(PoseError::Unreachable);
        }
        let ends = if half == 0 {
            [solved.triangle; 2]
        } else {
            [self.triangle(near * near)?, self.triangle(far * far)?]
        };
        let min = ends[0].area.min(ends[1].area);
        let flattest = Triangle {
            area: min - (min >> 28),
            ..ends[0]
        };
        let [lever, _] = self.levers(&flattest);
        // upper fore sin(theta2) / r: the lever of theta2 for a motion towards the shoulder.
        let fold = (flattest.area / (2 * far)).max(1);
        let turned = |way: i64, lever: i64| way * RADIAN / lever + 16;

        let mut bounds = BoxBounds::default();
        let sweep = if half == 0 { 0 } else { turned(half, lever) };
        let [theta1, theta2] = solved.theta;
        let bends = if half == 0 {
            [theta2; 2].map(|angle| i64::from(angle.0))
        } else {
            let bends = ends.map(|end| self.side() * i64::from(self.bend(&end).0));
            [
                bends[0].min(bends[1]) - ROUNDED,
                bends[0].max(bends[1]) + ROUNDED,
            ]
        };
        let signs = [-1, 1];
        for (index, ends) in bounds.joints.iter_mut().enumerate() {
            let shoulder = i64::from(theta1.0) + signs[index] * sweep;
            // Beyond half a turn from +x no stroke goes on.
            let angle = |value: i64| i32::try_from(value).map_err(|_| PoseError::Unreachable);
            ends.0[0] = Coordinate(angle(shoulder)?);
            ends.0[1] = Coordinate(angle(bends[index])?);
        }
        bounds.joints[0].0[Z] = low.0[Z];
        bounds.joints[1].0[Z] = high.0[Z];
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            let speed = magnitude([0, 1].map(|axis| i64::from(rates[axis].0)));
            let narrow = |rate: i64| u32::try_from(rate).unwrap_or(u32::MAX);
            bound[0] = narrow(turned(speed, lever));
            bound[1] = narrow(turned(speed, fold));
            bound[Z] = rates[Z].0.unsigned_abs();
        }
        Ok(bounds)
    }
}

/// Rounding error of the bound of an angle, raw units.
const ROUNDED: i64 = 16;
