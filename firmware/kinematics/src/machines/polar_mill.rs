//! Kinematics of a polar mill: a slide r that moves the tool along a line through the axis of a
//! table, a table theta that turns the workpiece about that vertical axis, and a vertical slide z.
//!
//! The pose is `[x, y, z]`: the tip of the tool in the workpiece frame. The joints are `[r, theta,
//! z]`: the distance of the tip from the axis of the table, the angle by which the table turns the
//! workpiece, right-handed about +z, and the slide, which is the coordinate of its name. With the
//! offsets of [`PolarMillGeometry`] and (X, Y) = (x + x_off, y + y_off), from the table's axis:
//!
//! ```text
//! (r, 0) = R(theta) (X, Y)
//! r = sqrt(X^2 + Y^2),   theta = atan2(-Y, X)
//! X = r cos(theta),      Y = -r sin(theta)
//! ```
//!
//! The table turns the workpiece, so the tool goes round it in the other direction.
//!
//! At r = 0 the angle of the table is not defined, and near it the table turns at any rate. The
//! singularity distance is r. The branch is r > 0: the tool never crosses the axis.
//!
//! The table is a joint that may wrap around. theta is the angle modulo a turn; the arc of
//! [`Kinematics::box_bounds`] goes from its lower end upwards.

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::planar::{RADIAN, held, tangential_rate, turned};
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::root::sqrt_rounded;
use haptimill_math::scale::{round_shift, saturate, scale, total};
use haptimill_math::trig::{atan2, sin_cos};
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 3;
/// Index of the radial slide in the joints.
const R: usize = 0;
/// Index of the table in the joints.
const THETA: usize = 1;
/// Index of the vertical slide in a pose and in the joints.
const Z: usize = 2;

/// Least singularity margin, 2^-20 mm: 1 mm. Quotients by r fit then.
const MIN_MARGIN: i32 = 1 << 20;
/// Rounding error of the bound of an angle, or of its rate, raw units.
const ROUNDED: i64 = 16;

/// Offsets of a polar mill, 2^-20 mm.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PolarMillGeometry {
    /// x and y of the workpiece's origin, from the axis of the table, with the table at 0.
    pub origin: [Length; 2],
    /// Least accepted singularity distance.
    pub singularity_margin: Length,
}

/// The polar mill.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PolarMill {
    origin: [i64; 2],
    /// Least r; beyond every r for an unsound geometry.
    margin: i64,
}

/// A pose on the table.
#[derive(Debug, Clone, Copy)]
struct SolvedPose {
    /// At least the margin, at most 2^31 - 1.
    r: i64,
    theta: Angle,
}

/// Angle of the table at which a point, whose coordinates are at most 2^31, is under the slide.
fn turn_of([x, y]: [i64; 2]) -> Angle {
    // Only the ends of the range do not fit: half of them have the same angle.
    let part = |value: i64| (value / 2) as i32;
    if x.abs().max(y.abs()) >> 30 == 0 {
        atan2(-(y as i32), x as i32)
    } else {
        atan2(-part(y), part(x))
    }
}

impl PolarMill {
    /// The tip from the axis of the table; `None` beyond a square about the workspace.
    fn tip(&self, pose: &Pose) -> Option<[i64; 2]> {
        let at = [0, 1].map(|axis| total(i64::from(pose.0[axis].0), self.origin[axis]));
        at.iter().all(|part| part.abs() <= 1 << 31).then_some(at)
    }

    /// r at a distance with this square, if the slide takes it.
    fn radius(&self, [x, y]: [i64; 2]) -> Result<i64, PoseError> {
        let square = x.unsigned_abs().pow(2) + y.unsigned_abs().pow(2);
        let r = i64::from(sqrt_rounded(square));
        if r > i64::from(i32::MAX) {
            return Err(PoseError::Unreachable);
        }
        if r < self.margin {
            return Err(PoseError::NearSingularity { distance: r as i32 });
        }
        Ok(r)
    }

    /// The joints r and theta of a pose.
    fn solve_positions(&self, pose: &Pose) -> Result<SolvedPose, PoseError> {
        let at = self.tip(pose).ok_or(PoseError::Unreachable)?;
        Ok(SolvedPose {
            r: self.radius(at)?,
            theta: turn_of(at),
        })
    }

    fn joints(pose: &Pose, solved: &SolvedPose) -> Joints {
        let mut joints = Joints::default();
        joints.0[R] = Coordinate(solved.r as i32);
        joints.0[THETA] = solved.theta.into();
        joints.0[Z] = pose.0[Z];
        joints
    }

    /// Rate of the table, 2^-32 turn/s, that takes away a speed across the slide, 2^-20 mm/s; or
    /// acceleration, 2^-24 turn/s^2, for 2^-12 mm/s^2. The speed is below 2^33.
    const fn turn(across: i64, r: i64) -> i64 {
        -(across * RADIAN / r)
    }
}

impl Machine for PolarMill {
    type Geometry = PolarMillGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::{Linear, Rotary};
        Descriptor {
            code: "polar_mill",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("z", Linear, 'Z', Role::ToolZ),
            ],
            joints: &[
                JointDescriptor::new("r", Linear),
                JointDescriptor::new("theta", Rotary).wrapping(),
                JointDescriptor::new("z", Linear),
            ],
            errors: &[],
        }
    };

    fn new(geometry: &PolarMillGeometry) -> Self {
        let margin = if Self::is_sound(geometry) {
            i64::from(geometry.singularity_margin.0)
        } else {
            // No pose is that far from the axis.
            i64::MAX
        };
        Self {
            origin: geometry.origin.map(|length| i64::from(length.0)),
            margin,
        }
    }

    fn is_sound(geometry: &PolarMillGeometry) -> bool {
        geometry.singularity_margin.0 >= MIN_MARGIN
    }

    fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        Some(match self.solve_positions(pose) {
            Ok(solved) => Ok(Length(solved.r as i32)),
            Err(PoseError::NearSingularity { distance }) => Ok(Length(distance)),
            Err(error) => Err(error),
        })
    }

    /// One joint moves, the others are at rest. The turning table carries the workpiece along under
    /// the tip.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        let (Some([x, y]), Ok(solved)) = (self.tip(pose), self.solve_positions(pose)) else {
            return rates;
        };
        match joint {
            R => {
                let (sine, cosine) = sin_cos(solved.theta);
                rates[0] = scale(rate, cosine, 30);
                rates[1] = -scale(rate, sine, 30);
            }
            THETA => {
                let turn = Rate(saturate(rate));
                rates[0] = tangential_rate(y, turn);
                rates[1] = -tangential_rate(x, turn);
            }
            _ => rates[Z] = rate,
        }
        rates
    }
}

impl Kinematics for PolarMill {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        Ok(Self::joints(pose, &self.solve_positions(pose)?))
    }

    /// In the frame of the machine the tip has the rate (r', -r theta') with the table at rest, and
    /// the acceleration (r'' - r theta'^2, -r theta'' - 2 r' theta').
    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let solved = self.solve_positions(pose)?;
        let direction = sin_cos(solved.theta);
        let [along, across] = turned([0, 1].map(|axis| i64::from(rates[axis].0)), direction);
        // A rate or acceleration beyond the range is held at its end, which is above every limit.
        let turn = Rate(saturate(Self::turn(across, solved.r)));
        let push = [0, 1].map(|axis| i64::from(accelerations[axis].0));
        let [push, aside] = turned(push, direction);
        let spin = round_shift(tangential_rate(tangential_rate(solved.r, turn), turn), 8);
        let coriolis = round_shift(2 * tangential_rate(along, turn), 8);
        let mut motion = JointMotion {
            joints: Self::joints(pose, &solved),
            ..JointMotion::default()
        };
        motion.rates[..AXES].copy_from_slice(&[Rate(saturate(along)), turn, rates[Z]]);
        motion.accelerations[..AXES].copy_from_slice(&[
            Acceleration(saturate(push + spin)),
            Acceleration(saturate(Self::turn(aside + coriolis, solved.r))),
            accelerations[Z],
        ]);
        Ok(motion)
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let r = i64::from(joints.0[R].0);
        if r < self.margin {
            return Err(PoseError::NearSingularity {
                distance: saturate(r),
            });
        }
        let (sine, cosine) = sin_cos(joints.0[THETA].angle());
        let [x, y, z] = held([
            scale(r, cosine, 30) - self.origin[0],
            -scale(r, sine, 30) - self.origin[1],
            i64::from(joints.0[Z].0),
        ])?;
        let mut pose = Pose::default();
        pose.0[..AXES].copy_from_slice(&[x, y, z]);
        Ok(pose)
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        let solved = self.solve_positions(pose)?;
        let (sine, cosine) = sin_cos(solved.theta);
        // Q30 to Q32.
        let wide = |value: i32| i64::from(value) << 2;
        let mut jacobian = Jacobian([[0; MAX_AXES]; MAX_AXES]);
        jacobian.0[R][0] = wide(cosine);
        jacobian.0[R][1] = -wide(sine);
        jacobian.0[THETA][0] = Self::turn(wide(sine), solved.r);
        jacobian.0[THETA][1] = Self::turn(wide(cosine), solved.r);
        jacobian.0[Z][Z] = 1 << 32;
        Ok(jacobian)
    }

    /// r is least at the nearest point of the box and greatest at a corner. The box does not hold
    /// the axis, so it is seen from there under less than half a turn, between two of its corners.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let ends = [low, high].map(|pose| self.tip(pose));
        let [Some(from), Some(to)] = ends else {
            return Err(PoseError::Unreachable);
        };
        let near = [0, 1].map(|axis| 0_i64.clamp(from[axis], to[axis]));
        let far = [0, 1].map(|axis| from[axis].abs().max(to[axis].abs()));
        let (min, max) = (self.radius(near)?, self.radius(far)?);
        let mut bounds = BoxBounds::default();
        let joints = &mut bounds.joints;
        (joints[0].0[R], joints[1].0[R]) = (Coordinate(min as i32), Coordinate(max as i32));
        (joints[0].0[Z], joints[1].0[Z]) = (low.0[Z], high.0[Z]);
        let first = turn_of(from);
        let (mut down, mut up) = (0_i32, 0_i32);
        if from != to {
            for corner in [[from[0], to[1]], [to[0], from[1]], to] {
                let by = turn_of(corner).wrapping_sub(first).0;
                (down, up) = (down.min(by), up.max(by));
            }
            (down, up) = (down - ROUNDED as i32, up + ROUNDED as i32);
        }
        for (joints, by) in joints.iter_mut().zip([down, up]) {
            joints.0[THETA] = Coordinate(first.0.wrapping_add(by));
        }
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            let [x, y] = [0, 1].map(|axis| u64::from(rates[axis].0.unsigned_abs()));
            let [far_x, far_y] = far.map(i64::unsigned_abs);
            // Below 2^32.5; the direction of the slide bounds the speeds in a small box.
            let whole = u64::from(sqrt_rounded(x * x + y * y)) + 1;
            let speed = |a: u64, b: u64| {
                let speed = ((x * a + y * b) / min.unsigned_abs() + 1).min(whole);
                (speed + (speed >> 28) + 2) as i64
            };
            let (along, across) = (speed(far_x, far_y), speed(far_y, far_x));
            let narrow = |rate: i64| u32::try_from(rate).unwrap_or(u32::MAX);
            bound[R] = narrow(along);
            bound[THETA] = narrow(across * RADIAN / min + ROUNDED);
            bound[Z] = rates[Z].0.unsigned_abs();
        }
        Ok(bounds)
    }
}
