//! The linear delta as a subject. Its reference values follow from the theorem of Pythagoras for
//! each rod, and the pose of its joints from Newton's method with Cramer's rule.

use super::subject::{MM, Margin, Margins, Reals, Sequence, Subject};
use haptimill_kinematics::linear_delta::{LinearDelta, LinearDeltaGeometry};
use haptimill_kinematics::{Joints, Machine, PoseError};
use haptimill_math::{Coordinate, Length};
use heapless::Vec;

/// Lengths in mm.
#[derive(Clone, Copy)]
pub struct Lengths {
    /// Rods.
    pub rods: [f64; 3],
    /// Columns, counter-clockwise.
    pub columns: [[f64; 2]; 3],
    /// Height of the upper ends at z = 0.
    pub height: f64,
    /// Singularity margin.
    pub margin: f64,
}

/// Equal rods, columns on a circle.
pub const EVEN: Lengths = Lengths {
    rods: [265.0; 3],
    columns: [[-103.8125, -59.9375], [103.8125, -59.9375], [0.0, 119.875]],
    height: 250.0,
    margin: 40.0,
};

/// Unequal rods, columns not on a circle.
pub const UNEVEN: Lengths = Lengths {
    rods: [301.3125, 288.75, 342.0625],
    columns: [[-140.5, -61.25], [98.375, -95.5], [12.125, 151.6875]],
    height: -31.5,
    margin: 61.625,
};

/// A linear delta with its reference values and its kinematics.
pub struct Slides {
    lengths: Lengths,
    machine: LinearDelta,
}

fn unreachable(error: &PoseError) -> bool {
    *error == PoseError::Unreachable
}

fn singular(error: &PoseError) -> bool {
    matches!(error, PoseError::NearSingularity { .. })
}

fn determinant(rows: [[f64; 3]; 3]) -> f64 {
    let [[a, b, c], [d, e, f], [g, h, i]] = rows;
    a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
}

impl Slides {
    /// Creates the machine of these lengths.
    #[must_use]
    pub fn new(lengths: Lengths) -> Self {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        let geometry = LinearDeltaGeometry {
            rods: lengths.rods.map(raw),
            columns: lengths.columns.map(|at| at.map(raw)),
            height: raw(lengths.height),
            singularity_margin: raw(lengths.margin),
        };
        assert!(LinearDelta::is_sound(&geometry));
        Self {
            lengths,
            machine: LinearDelta::new(&geometry),
        }
    }

    /// The horizontal distance of each column from a pose.
    fn distances(&self, pose: &Reals) -> [f64; 3] {
        self.lengths
            .columns
            .map(|[x, y]| libm::hypot(pose[0] - x, pose[1] - y))
    }

    /// The height of the upper end of each rod above the tip.
    fn ups(&self, pose: &Reals) -> Option<[f64; 3]> {
        let distances = self.distances(pose);
        let mut ups = [0.0; 3];
        for index in 0..3 {
            let (rod, distance) = (self.lengths.rods[index], distances[index]);
            if distance >= rod {
                return None;
            }
            ups[index] = libm::sqrt((rod - distance) * (rod + distance));
        }
        Some(ups)
    }

    /// The height above the tip of the plane through three points above the columns: the quotient
    /// of two volumes.
    fn plane(&self, pose: &Reals, ups: [f64; 3]) -> f64 {
        let columns = self.lengths.columns;
        let row = |index: usize, last: f64| {
            let [x, y] = columns[index];
            [x - pose[0], y - pose[1], last]
        };
        let above = [0, 1, 2].map(|index| row(index, ups[index]));
        let ones = [0, 1, 2].map(|index| row(index, 1.0));
        determinant(above) / determinant(ones)
    }
}

impl Subject for Slides {
    type Machine = LinearDelta;

    fn machine(&self) -> &LinearDelta {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let reach = 0.9 * self.lengths.rods[0];
        [
            sequence.between(-reach, reach),
            sequence.between(-reach, reach),
            sequence.between(-1500.0, 1400.0),
            0.0,
            0.0,
            0.0,
        ]
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let Lengths {
            rods,
            columns,
            margin,
            ..
        } = self.lengths;
        let mut pose = self.random_pose(sequence);
        if sequence.below(3) == 0 {
            // Along a ray from the origin to the height of the plane, by bisection.
            let (mut near, mut far) = (0.0, 1.0);
            let ray = [pose[0], pose[1]].map(|part| 4.0 * part);
            let at = |part: f64, pose: &Reals| {
                let mut pose = *pose;
                (pose[0], pose[1]) = (part * ray[0], part * ray[1]);
                pose
            };
            for _ in 0..60 {
                let middle = 0.5 * (near + far);
                let there = at(middle, &pose);
                let inside = self.ups(&there).is_some_and(|ups| {
                    let min = ups.iter().copied().fold(self.plane(&there, ups), f64::min);
                    min > margin
                });
                if inside {
                    near = middle;
                } else {
                    far = middle;
                }
            }
            let step = sequence.logarithmic(-7.0, 1.0) / libm::hypot(ray[0], ray[1]);
            return at(near + step, &pose);
        }
        // A rod level, or at the margin.
        let index = sequence.below(3) as usize;
        let max = if sequence.below(2) == 0 {
            rods[index]
        } else {
            libm::sqrt(rods[index] * rods[index] - margin * margin)
        };
        let distance = max + sequence.logarithmic(-7.0, 1.0);
        // From the column towards the others.
        let [x, y] = columns[index];
        let direction = libm::atan2(-y, -x) + sequence.between(-0.9, 0.9);
        let (sine, cosine) = libm::sincos(direction);
        (pose[0], pose[1]) = (x + distance * cosine, y + distance * sine);
        pose
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        let middle = sequence.between(-1500.0, 1500.0);
        for joint in &mut joints.0[..3] {
            let at = middle + sequence.between(-250.0, 250.0);
            *joint = Coordinate(libm::round(at / MM) as i32);
        }
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        let Lengths { rods, margin, .. } = self.lengths;
        let mut margins: Vec<Margin, 12> = Vec::new();
        for (rod, distance) in rods.into_iter().zip(self.distances(pose)) {
            let reach = Margin::mm(rod - distance, unreachable);
            margins.push(reach).expect("twelve");
        }
        if let Some(ups) = self.ups(pose) {
            for height in ups.into_iter().chain([self.plane(pose, ups)]) {
                let above = Margin::mm(height - margin, singular);
                margins.push(above).expect("twelve");
            }
        }
        Margins(margins)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        let ups = self.ups(pose)?;
        let [a, b, c] = ups.map(|up| pose[2] + up - self.lengths.height);
        Some([a, b, c, 0.0, 0.0, 0.0])
    }

    fn solve(&self, joints: &Reals, guess: &Reals) -> Option<Reals> {
        let Lengths {
            rods,
            columns,
            height,
            ..
        } = self.lengths;
        let mut at = [guess[0], guess[1], guess[2]];
        for _ in 0..30 {
            let rows = [0, 1, 2].map(|index| {
                let [x, y] = columns[index];
                [at[0] - x, at[1] - y, at[2] - joints[index] - height]
            });
            let left = [0, 1, 2].map(|index| {
                let [x, y, z] = rows[index];
                0.5 * (rods[index] * rods[index] - x * x - y * y - z * z)
            });
            let all = determinant(rows);
            let step = [0, 1, 2].map(|column| {
                let mut replaced = rows;
                for index in 0..3 {
                    replaced[index][column] = left[index];
                }
                determinant(replaced) / all
            });
            for axis in 0..3 {
                at[axis] += step[axis];
            }
            if step.iter().all(|step| step.abs() < 1e-10) {
                return Some([at[0], at[1], at[2], 0.0, 0.0, 0.0]);
            }
        }
        None
    }
}
