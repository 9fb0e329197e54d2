//! Kinematics of a linear delta: three vertical slides carry rods that hold one platform level.
//!
//! The pose is `[x, y, z]`: the tip of the tool in the workpiece frame. The joints are the slides
//! `[s1, s2, s3]`. Slide i has its column at the point T_i of the x-y plane, and its rod has the
//! length L_i. The platform does not turn, so all rods are drawn to the tip: T_i is the place of
//! the upper end of the rod, less that of its lower end on the platform. With d_i = (x, y) - T_i
//!
//! ```text
//! c_i = sqrt(L_i^2 - d_i^2)         height of the upper end of the rod above the lower one
//! s_i = z + c_i - height
//! ```
//!
//! The barycentric coordinates w_i of (x, y) in the triangle of the columns have the sum 1 and
//! constant gradients g_i, with the sum 0. The height of the plane of the upper ends above the tip,
//! along z, is
//!
//! ```text
//! v = sum of w_i c_i
//! ```
//!
//! Where c_i is 0 the rod is level, and the rate of its slide is infinite. Where v is 0 the rods
//! are in one plane, and the slides do not hold the platform. The singularity distance is the least
//! of the four heights; the branch is that with the platform below.
//!
//! The forward kinematics subtracts the equations of the three spheres, which gives (x, y) as a
//! linear function of z, and then a quadratic equation of z, with a resolution of 1/256 mm.
//! Newton's method on s_i makes it exact: with the residuals r_i
//!
//! ```text
//! dz = sum of w_i c_i r_i / v,   d(x, y) = sum of g_i c_i (r_i - dz)
//! ```

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::root::sqrt_rounded;
use haptimill_math::scale::saturate;
use haptimill_math::{Acceleration, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 3;
/// Index of z in a pose.
const Z: usize = 2;

/// Shortest and longest rod, 2^-20 mm: 50 mm and 600 mm.
const ROD: core::ops::RangeInclusive<i32> = 50 << 20..=600 << 20;
/// Largest coordinate of a column, 2^-20 mm: 400 mm.
const COLUMN: i32 = 400 << 20;
/// Least distance of two columns, 2^-20 mm: 80 mm.
const APART: i64 = 80 << 20;
/// Least singularity margin, 2^-20 mm: 1 mm.
const MIN_MARGIN: i32 = 1 << 20;

/// Weights are Q26, and their gradients Q56 per 2^-20 mm.
const WEIGHT: u32 = 26;
const GRADIENT: u32 = 56;
/// The first solution of the forward kinematics has 2^-8 mm.
const COARSE: u32 = 12;
/// Iterations of Newton's method; three are enough where the margin is kept.
const ITERATIONS: usize = 8;
/// Largest step of the last iteration, 2^-20 mm: the error after it is below its square over 1 mm.
const LAST_STEP: i64 = 64;

/// Lengths of a linear delta, 2^-20 mm.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LinearDeltaGeometry {
    /// The rods.
    pub rods: [Length; AXES],
    /// x and y of the columns, in a counter-clockwise order about the origin.
    pub columns: [[Length; 2]; AXES],
    /// Height of the upper ends of the rods above the lower ones at z = 0 with the slides at 0.
    pub height: Length,
    /// Least accepted singularity distance.
    pub singularity_margin: Length,
}

/// The linear delta.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct LinearDelta {
    rods: [i64; AXES],
    columns: [[i64; 2]; AXES],
    /// Gradients of the weights, and the weights of the origin.
    gradients: [[i64; 2]; AXES],
    weights: [i64; AXES],
    height: i64,
    /// Beyond every distance for an unsound geometry.
    margin: i64,
}

/// A rod at a place of the platform.
#[derive(Debug, Clone, Copy, Default)]
struct Rod {
    /// The platform from the column.
    away: [i64; 2],
    /// Height of the upper end above the lower one, positive.
    up: i64,
}

/// The rods at a place of the platform.
#[derive(Debug, Clone, Copy)]
struct SolvedPose {
    rods: [Rod; AXES],
    /// Weights of the columns.
    weights: [i64; AXES],
    /// Height of the plane of the upper ends above the tip.
    plane: i64,
}

impl SolvedPose {
    /// The singularity distance.
    fn singularity_distance(&self) -> i64 {
        let ups = self.rods.iter().map(|rod| rod.up);
        ups.fold(self.plane, i64::min)
    }
}

/// Square of the length of a vector.
const fn square([x, y]: [i64; 2]) -> i64 {
    x * x + y * y
}

/// Twice the area of a triangle, counter-clockwise.
const fn doubled_area(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

impl LinearDelta {
    /// A machine without a pose.
    const NONE: Self = Self {
        rods: [0; AXES],
        columns: [[0; 2]; AXES],
        gradients: [[0; 2]; AXES],
        weights: [0; AXES],
        height: 0,
        margin: i64::MAX,
    };

    /// The rods with the platform at a place, whatever the margin.
    fn rods_at(&self, at: [i64; 2]) -> Result<SolvedPose, PoseError> {
        let mut solved = SolvedPose {
            rods: Default::default(),
            weights: self.weights,
            plane: 0,
        };
        for (index, rod) in solved.rods.iter_mut().enumerate() {
            let length = self.rods[index];
            let column = self.columns[index];
            rod.away = [at[0] - column[0], at[1] - column[1]];
            if rod.away.iter().any(|part| part.abs() >= length) {
                return Err(PoseError::Unreachable);
            }
            let left = length * length - square(rod.away);
            if left <= 0 {
                return Err(PoseError::Unreachable);
            }
            rod.up = i64::from(sqrt_rounded(left.unsigned_abs()));
            let [gx, gy] = self.gradients[index];
            solved.weights[index] += (gx * at[0] + gy * at[1]) >> (GRADIENT - WEIGHT);
        }
        let rods = solved.rods.iter().zip(solved.weights);
        let plane: i64 = rods.map(|(rod, weight)| rod.up * weight).sum();
        solved.plane = plane >> WEIGHT;
        Ok(solved)
    }

    /// The rods at a pose.
    fn solve_positions(&self, pose: &Pose) -> Result<SolvedPose, PoseError> {
        let at = [0, 1].map(|axis| i64::from(pose.0[axis].0));
        let solved = self.rods_at(at)?;
        let min = solved.singularity_distance();
        if min < self.margin {
            return Err(PoseError::NearSingularity {
                distance: saturate(min),
            });
        }
        Ok(solved)
    }

    /// The slides at a pose.
    fn joints(&self, pose: &Pose, solved: &SolvedPose) -> Result<Joints, PoseError> {
        let mut joints = Joints::default();
        let z = i64::from(pose.0[Z].0) - self.height;
        for (joint, rod) in joints.0.iter_mut().zip(&solved.rods) {
            let at = i32::try_from(z + rod.up).map_err(|_| PoseError::Unreachable)?;
            *joint = Coordinate(at);
        }
        Ok(joints)
    }

    /// The motion of the platform that changes the slides by `changes`.
    fn moved(&self, solved: &SolvedPose, changes: [i64; AXES]) -> [i64; AXES] {
        let rods = solved.rods.iter().zip(solved.weights);
        let along: i128 = rods
            .zip(changes)
            .map(|((rod, weight), change)| {
                i128::from((rod.up * weight) >> WEIGHT) * i128::from(change)
            })
            .sum();
        let dz = (along / i128::from(solved.plane.max(1))) as i64;
        let mut at = [0_i128; 2];
        for ((rod, gradient), change) in solved.rods.iter().zip(self.gradients).zip(changes) {
            let lever = i128::from(rod.up) * i128::from(change - dz);
            for (at, part) in at.iter_mut().zip(gradient) {
                *at += lever * i128::from(part);
            }
        }
        let half = 1_i128 << (GRADIENT - 1);
        let [x, y] = at.map(|part| ((part + half) >> GRADIENT) as i64);
        [x, y, dz]
    }

    /// A pose near that of the slides at these heights above the origin, by the three spheres.
    fn solve_spheres(&self, heights: [i64; AXES]) -> Result<[i64; AXES], PoseError> {
        let middle = heights.iter().sum::<i64>() / 3;
        let up = heights.map(|height| (height - middle) >> COARSE);
        // The upper ends of two rods with a common lower one are within both lengths.
        if up.iter().any(|up| up.abs() > (1200 << 20) >> COARSE) {
            return Err(PoseError::Unreachable);
        }
        let gradients = self.gradients.map(|it| it.map(|part| part >> 8));
        let (mut at, mut slope, mut power, mut mean) = ([0_i64; 2], [0_i64; 2], 0_i64, 0_i64);
        for index in 0..AXES {
            let column = self.columns[index].map(|part| part >> COARSE);
            let rod = self.rods[index] >> COARSE;
            let half = (square(column) + up[index] * up[index] - rod * rod) / 2;
            for axis in 0..2 {
                at[axis] += gradients[index][axis] * half;
                slope[axis] += gradients[index][axis] * up[index];
            }
            power += self.weights[index] * half;
            mean += self.weights[index] * up[index];
        }
        // Gradients are Q36 per 2^-8 mm here; the slope of the plane is Q20.
        let (at, slope) = (at.map(|part| part >> 36), slope.map(|part| part >> 16));
        let (power, mean) = (power >> WEIGHT, mean >> WEIGHT);
        let a = (1 << 20) + (square(slope) >> 20);
        let b = mean + ((at[0] * slope[0] + at[1] * slope[1]) >> 20);
        let c = 2 * power + square(at);
        let left = i128::from(b) * i128::from(b) - ((i128::from(a) * i128::from(c)) >> 20);
        let left = u64::try_from(left).map_err(|_| PoseError::Unreachable)?;
        let z = ((b - i64::from(sqrt_rounded(left))) << 20) / a;
        let [x, y] = [0, 1].map(|axis| at[axis] - ((slope[axis] * z) >> 20));
        Ok([x << COARSE, y << COARSE, (z << COARSE) + middle])
    }
}

impl Machine for LinearDelta {
    type Geometry = LinearDeltaGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::Linear;
        Descriptor {
            code: "linear_delta",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("z", Linear, 'Z', Role::ToolZ),
            ],
            joints: &[
                JointDescriptor::new("s1", Linear),
                JointDescriptor::new("s2", Linear),
                JointDescriptor::new("s3", Linear),
            ],
            errors: &[],
        }
    };

    fn new(geometry: &LinearDeltaGeometry) -> Self {
        if !Self::is_sound(geometry) {
            return Self::NONE;
        }
        let columns = geometry.columns.map(|at| at.map(|part| i64::from(part.0)));
        let area = i128::from(doubled_area(columns[0], columns[1], columns[2]));
        let mut machine = Self {
            rods: geometry.rods.map(|rod| i64::from(rod.0)),
            columns,
            height: i64::from(geometry.height.0),
            margin: i64::from(geometry.singularity_margin.0),
            ..Self::NONE
        };
        for index in 0..AXES {
            let [next, last] = [columns[(index + 1) % AXES], columns[(index + 2) % AXES]];
            let part = |way: i64| ((i128::from(way) << GRADIENT) / area) as i64;
            machine.gradients[index] = [part(next[1] - last[1]), part(last[0] - next[0])];
            let own = i128::from(doubled_area([0; 2], next, last));
            machine.weights[index] = ((own << WEIGHT) / area) as i64;
        }
        machine
    }

    /// The origin is within the triangle of the columns, which has no angle below 30 degrees or so.
    fn is_sound(geometry: &LinearDeltaGeometry) -> bool {
        let columns = geometry.columns.map(|at| at.map(|part| i64::from(part.0)));
        let lengths = geometry.rods.iter().all(|rod| ROD.contains(&rod.0));
        let near = geometry.columns.iter().flatten();
        let near = near
            .into_iter()
            .all(|part| part.0.unsigned_abs() <= COLUMN as u32);
        let height = geometry.height.0.unsigned_abs() <= 2000 << 20;
        let shortest = geometry.rods.iter().map(|rod| rod.0).min().unwrap_or(0);
        let margin = (MIN_MARGIN..shortest).contains(&geometry.singularity_margin.0);
        if !(lengths && near && height && margin) {
            return false;
        }
        let area = doubled_area(columns[0], columns[1], columns[2]);
        (0..AXES).all(|index| {
            let [next, last] = [columns[(index + 1) % AXES], columns[(index + 2) % AXES]];
            let side = square([next[0] - last[0], next[1] - last[1]]);
            let inside = doubled_area([0; 2], next, last) > 0;
            inside && side >= APART * APART && area >= side / 2
        })
    }

    fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        Some(match self.solve_positions(pose) {
            Ok(solved) => Ok(Length(saturate(solved.singularity_distance()))),
            Err(PoseError::NearSingularity { distance }) => Ok(Length(distance)),
            Err(error) => Err(error),
        })
    }

    /// One slide moves, the others are at rest.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        let Ok(solved) = self.solve_positions(pose) else {
            return rates;
        };
        let mut changes = [0; AXES];
        if let Some(change) = changes.get_mut(joint) {
            *change = rate;
        }
        rates[..AXES].copy_from_slice(&self.moved(&solved, changes));
        rates
    }
}

impl Kinematics for LinearDelta {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let solved = self.solve_positions(pose)?;
        self.joints(pose, &solved)
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let solved = self.solve_positions(pose)?;
        let mut motion = JointMotion {
            joints: self.joints(pose, &solved)?,
            ..JointMotion::default()
        };
        let rate = [0, 1].map(|axis| i64::from(rates[axis].0));
        let acceleration = [0, 1].map(|axis| i64::from(accelerations[axis].0));
        // A rate or acceleration beyond the range is held at its end, which is above every limit.
        for (joint, Rod { away, up }) in solved.rods.iter().enumerate() {
            let closing = -(away[0] * rate[0] + away[1] * rate[1]) / up;
            motion.rates[joint] = Rate(saturate(closing + i64::from(rates[Z].0)));
            // The squares have 2^-40 mm^2/s^2, the products 2^-32.
            let closing = i64::from(saturate(closing));
            let squares = [rate[0], rate[1], closing].map(|rate| (rate * rate) >> 8);
            let turning = away[0] * acceleration[0] + away[1] * acceleration[1];
            let pull = -(squares.iter().sum::<i64>() + turning) / up;
            let pull = pull + i64::from(accelerations[Z].0);
            motion.accelerations[joint] = Acceleration(saturate(pull));
        }
        Ok(motion)
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let heights = [0, 1, 2].map(|joint| i64::from(joints.0[joint].0) + self.height);
        let mut at = self.solve_spheres(heights)?;
        for _ in 0..ITERATIONS {
            let solved = self.rods_at([at[0], at[1]])?;
            if solved.plane <= 0 {
                break;
            }
            let mut left = heights;
            for (left, rod) in left.iter_mut().zip(&solved.rods) {
                *left -= at[Z] + rod.up;
            }
            let by = self.moved(&solved, left);
            for (at, by) in at.iter_mut().zip(by) {
                *at += by;
            }
            if by.iter().all(|by| by.abs() <= LAST_STEP) {
                let mut pose = Pose::default();
                for (slot, at) in pose.0.iter_mut().zip(at) {
                    *slot = Coordinate(i32::try_from(at).map_err(|_| PoseError::Unreachable)?);
                }
                self.solve_positions(&pose)?;
                return Ok(pose);
            }
        }
        Err(PoseError::NearSingularity { distance: 0 })
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        let solved = self.solve_positions(pose)?;
        let mut jacobian = Jacobian([[0; MAX_AXES]; MAX_AXES]);
        for (row, Rod { away, up }) in jacobian.0.iter_mut().zip(&solved.rods) {
            row[0] = -(away[0] << 32) / up;
            row[1] = -(away[1] << 32) / up;
            row[Z] = 1 << 32;
        }
        Ok(jacobian)
    }

    /// A rod is lowest where the platform is farthest from its column, at a corner of the box, and
    /// highest where it is nearest.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let ends = [low, high].map(|pose| [0, 1, 2].map(|axis| i64::from(pose.0[axis].0)));
        let mut bounds = BoxBounds::default();
        let mut plane = 0;
        for index in 0..AXES {
            let length = self.rods[index];
            let (mut near, mut far, mut weights) = ([0; 2], [0; 2], [self.weights[index]; 2]);
            for axis in 0..2 {
                let column = self.columns[index][axis];
                let [from, to] = [0, 1].map(|end| ends[end][axis] - column);
                near[axis] = 0_i64.clamp(from, to);
                far[axis] = from.abs().max(to.abs());
                let gradient = self.gradients[index][axis];
                let steps = [0, 1].map(|end| (gradient * ends[end][axis]) >> (GRADIENT - WEIGHT));
                weights[0] += steps[0].min(steps[1]) - 1;
                weights[1] += steps[0].max(steps[1]) + 1;
            }
            if far.iter().any(|part| *part >= length) || square(far) >= length * length {
                return Err(PoseError::Unreachable);
            }
            let up = |away| {
                i64::from(sqrt_rounded(
                    (length * length - square(away)).unsigned_abs(),
                ))
            };
            let (min, max) = (up(far), up(near));
            if min < self.margin {
                return Err(PoseError::NearSingularity {
                    distance: saturate(min),
                });
            }
            let weight = weights[0];
            plane += weight * if weight < 0 { max } else { min };
            let joint = |at: i64| {
                let at = i32::try_from(at - self.height);
                at.map(Coordinate).map_err(|_| PoseError::Unreachable)
            };
            bounds.joints[0].0[index] = joint(ends[0][Z] + min)?;
            bounds.joints[1].0[index] = joint(ends[1][Z] + max)?;
            for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
                let [x, y, z] = [0, 1, Z].map(|axis| i64::from(rates[axis].0.unsigned_abs()));
                let closing = (far[0] * x + far[1] * y) / min + 1;
                bound[index] = u32::try_from(closing + z).unwrap_or(u32::MAX);
            }
        }
        if plane >> WEIGHT < self.margin {
            return Err(PoseError::NearSingularity {
                distance: saturate(plane >> WEIGHT),
            });
        }
        Ok(bounds)
    }
}
