//! Kinematics of a five-bar arm: two motors on one line turn two arms of two links each, which meet
//! in the tool, and a vertical slide.
//!
//! The pose is `[x, y, z]`: the tip of the tool in the workpiece frame. The joints are `[theta1,
//! theta2, z]`: the angles of the left and the right proximal link from +y, right-handed about +z,
//! and the slide, which is the coordinate of its name. The motors are on the x axis, at -d and d
//! from the middle between them. With the lengths of [`FiveBarGeometry`] and (X, Y) = (x + x_off,
//! y + y_off), from that middle, the elbows are
//!
//! ```text
//! P1 = (-d - proximal sin(theta1), proximal cos(theta1))
//! P2 = ( d - proximal sin(theta2), proximal cos(theta2))
//! ```
//!
//! and the tip has the distance `distal` from both. Each arm with its motor is a SCARA arm
//! ([`super::scara`]), in a frame that is turned by 90 degrees: its x is along Y and its y along
//! -X. The elbow of the left arm is on the left of the line from its motor to the tip, that of the
//! right arm on the right. That and what an arm reaches are the inverse kinematics.
//!
//! With D = P2 - P1 the forward kinematics is
//!
//! ```text
//! (X, Y) = (P1 + P2) / 2 + n sqrt(distal^2 - |D|^2 / 4)
//! ```
//!
//! with n normal to D, on its left. The tip on the right of D is the other assembly.
//!
//! With the directions u1 and u2 of the distal links three distances are zero in a singularity:
//! those of the tip from the lines of the two proximal links, where the rates of a joint are
//! infinite, and distal (u1 x u2), where the joints do not hold the tip. All three are positive on
//! the branch of this model, and the singularity distance is the least of them.

use super::scara::{Scara, ScaraGeometry};
use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::root::sqrt_rounded;
use haptimill_math::scale::{saturate, scale};
use haptimill_math::trig::sin_cos;
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 3;
/// Index of the slide in a pose and in the joints.
const Z: usize = 2;

/// Largest half of the distance of the motors, 2^-20 mm: 500 mm.
const HALF_BASE: i32 = 500 << 20;
/// Largest offsets of the workpiece's origin, 2^-20 mm: 1500 mm and 2000 mm. With half the distance
/// of the motors the first is within a coordinate.
const ORIGIN: [i32; 2] = [1500 << 20, 2000 << 20];

/// Lengths of a five-bar arm, 2^-20 mm.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FiveBarGeometry {
    /// Half the distance of the axes of the motors.
    pub half_base: Length,
    /// From the axis of a motor to that of its elbow.
    pub proximal: Length,
    /// From the axis of an elbow to the tip of the tool.
    pub distal: Length,
    /// x and y of the workpiece's origin, from the middle between the motors.
    pub origin: [Length; 2],
    /// Least accepted singularity distance.
    pub singularity_margin: Length,
}

/// The five-bar arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FiveBar {
    /// The left and the right arm.
    arms: [Scara; 2],
    half_base: i64,
    proximal: i64,
    distal: i64,
    origin: [i64; 2],
    /// Least singularity distance; beyond every one for an unsound geometry.
    margin: i64,
}

/// A pose in the frame of the arms.
fn turned(pose: &Pose) -> Pose {
    let mut turned = *pose;
    // The end of the range has no negative; one unit beside it nothing else is near.
    turned.0[0] = pose.0[1];
    turned.0[1] = Coordinate(pose.0[0].0.saturating_neg());
    turned
}

/// Rates in the frame of the arms.
fn turned_rates(rates: &Rates) -> Rates {
    let mut turned = *rates;
    turned[0] = rates[1];
    turned[1] = Rate(rates[0].0.saturating_neg());
    turned
}

/// Accelerations in the frame of the arms.
fn turned_accelerations(accelerations: &Accelerations) -> Accelerations {
    let mut turned = *accelerations;
    turned[0] = accelerations[1];
    turned[1] = Acceleration(accelerations[0].0.saturating_neg());
    turned
}

/// Angle of the distal link of an arm, from +y.
fn distal_angle(arm: &Joints) -> Angle {
    arm.0[0].angle().wrapping_add(arm.0[1].angle())
}

const fn cross(a: [i64; 2], b: [i64; 2]) -> i64 {
    a[0] * b[1] - a[1] * b[0]
}

impl FiveBar {
    /// Distance of the singularity in which the distal links are in line.
    fn opening(&self, arms: &[Joints; 2]) -> i64 {
        let between = distal_angle(&arms[1]).wrapping_sub(distal_angle(&arms[0]));
        scale(self.distal, sin_cos(between).0, 30)
    }

    /// Whether a singularity distance is enough.
    fn certify(&self, distance: i64) -> Result<(), PoseError> {
        if distance < self.margin {
            return Err(PoseError::NearSingularity {
                distance: saturate(distance),
            });
        }
        Ok(())
    }

    /// The joints of both arms at a pose.
    fn solve_positions(&self, pose: &Pose) -> Result<[Joints; 2], PoseError> {
        let pose = turned(pose);
        let [left, right] = &self.arms;
        let arms = [left.inverse(&pose)?, right.inverse(&pose)?];
        self.certify(self.opening(&arms))?;
        Ok(arms)
    }

    /// The joints of the machine: the shoulders of both arms, and the slide.
    fn joints([left, right]: &[Joints; 2]) -> Joints {
        let mut joints = *left;
        joints.0[1] = right.0[0];
        joints
    }
}

impl Machine for FiveBar {
    type Geometry = FiveBarGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::{Linear, Rotary};
        Descriptor {
            code: "five_bar",
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

    fn new(geometry: &FiveBarGeometry) -> Self {
        if !Self::is_sound(geometry) {
            // No pose is within links without length.
            return Self {
                arms: [Scara::new(&ScaraGeometry::default()); 2],
                half_base: 0,
                proximal: 0,
                distal: 0,
                origin: [0; 2],
                margin: i64::MAX,
            };
        }
        let [x, y] = geometry.origin.map(|length| length.0);
        let half = geometry.half_base.0;
        let arms = [(-half - x, false), (half - x, true)].map(|(aside, right)| {
            Scara::new(&ScaraGeometry {
                upper: geometry.proximal,
                fore: geometry.distal,
                origin: [Length(y), Length(aside)],
                right,
                singularity_margin: geometry.singularity_margin,
            })
        });
        Self {
            arms,
            half_base: i64::from(geometry.half_base.0),
            proximal: i64::from(geometry.proximal.0),
            distal: i64::from(geometry.distal.0),
            origin: geometry.origin.map(|length| i64::from(length.0)),
            margin: i64::from(geometry.singularity_margin.0),
        }
    }

    fn is_sound(geometry: &FiveBarGeometry) -> bool {
        let mut within = geometry.origin.iter().zip(ORIGIN);
        (0..=HALF_BASE).contains(&geometry.half_base.0)
            && within.all(|(part, max)| part.0.unsigned_abs() <= max.unsigned_abs())
            && Scara::is_sound(&ScaraGeometry {
                upper: geometry.proximal,
                fore: geometry.distal,
                singularity_margin: geometry.singularity_margin,
                ..ScaraGeometry::default()
            })
    }

    fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        Some(match self.solve_positions(pose) {
            Ok(arms) => {
                let mut min = Length(saturate(self.opening(&arms)));
                for arm in &self.arms {
                    if let Some(Ok(distance)) = arm.singularity_distance(&turned(pose)) {
                        min = min.min(distance);
                    }
                }
                Ok(min)
            }
            Err(PoseError::NearSingularity { distance }) => Ok(Length(distance)),
            Err(error) => Err(error),
        })
    }

    /// One joint moves, the others stand still: a column of the inverse of the Jacobian.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        let Ok(jacobian) = self.jacobian(pose) else {
            return rates;
        };
        let [a, b, ..] = jacobian.0[0].map(i128::from);
        let [c, d, ..] = jacobian.0[1].map(i128::from);
        let column = match joint {
            0 => [d, -c],
            1 => [-b, a],
            _ => {
                rates[Z] = rate;
                return rates;
            }
        };
        // The Jacobian is Q32, below 2^43; its determinant is not 0 within the margin.
        let determinant = a * d - b * c;
        for (slot, part) in rates.iter_mut().zip(column) {
            let moved = ((i128::from(rate) << 32) * part).checked_div(determinant);
            *slot = moved.unwrap_or(0) as i64;
        }
        rates
    }
}

impl Kinematics for FiveBar {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        Ok(Self::joints(&self.solve_positions(pose)?))
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let (pose, rates) = (turned(pose), turned_rates(rates));
        let accelerations = turned_accelerations(accelerations);
        let [left, right] = &self.arms;
        let mut motion = left.inverse_motion(&pose, &rates, &accelerations)?;
        let other = right.inverse_motion(&pose, &rates, &accelerations)?;
        let arms = [motion.joints, other.joints];
        self.certify(self.opening(&arms))?;
        motion.joints = Self::joints(&arms);
        motion.rates[1] = other.rates[0];
        motion.accelerations[1] = other.accelerations[0];
        Ok(motion)
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        // In the frame of the arms: the proximal links, and the way from elbow to elbow.
        let links = [0, 1].map(|arm| {
            let (sine, cosine) = sin_cos(joints.0[arm].angle());
            [cosine, sine].map(|part| scale(self.proximal, part, 30))
        });
        let [left, right] = links;
        let across = [right[0] - left[0], right[1] - left[1] - 2 * self.half_base];
        let square = across[0] * across[0] + across[1] * across[1];
        let left_over = 4 * self.distal * self.distal - square;
        if left_over <= 0 || square <= 0 {
            return Err(PoseError::NearSingularity { distance: 0 });
        }
        let apart = i64::from(sqrt_rounded(square.unsigned_abs())).max(1);
        let ahead = i64::from(sqrt_rounded(left_over.unsigned_abs()));
        // The distal links from the elbows: half the way across, and the height over it.
        let normal = [-across[1], across[0]].map(|part| part * ahead / (2 * apart));
        let distal = [
            [across[0] / 2 + normal[0], across[1] / 2 + normal[1]],
            [normal[0] - across[0] / 2, normal[1] - across[1] / 2],
        ];
        let [bend_left, bend_right] = [0, 1].map(|arm| cross(links[arm], distal[arm]));
        self.certify(-bend_left / self.proximal)?;
        self.certify(bend_right / self.proximal)?;
        self.certify(cross(distal[0], distal[1]) / self.distal)?;

        let [ahead, aside] = [
            left[0] + distal[0][0] - self.origin[1],
            left[1] + self.half_base + distal[0][1] + self.origin[0],
        ];
        let tip = |at: i64| {
            let at = i32::try_from(at).map(Coordinate);
            at.map_err(|_| PoseError::Unreachable)
        };
        let mut pose = Pose::default();
        pose.0[0] = tip(-aside)?;
        pose.0[1] = tip(ahead)?;
        pose.0[Z] = joints.0[Z];
        Ok(pose)
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        self.solve_positions(pose)?;
        let pose = turned(pose);
        let mut jacobian = Jacobian([[0; MAX_AXES]; MAX_AXES]);
        for (row, arm) in jacobian.0.iter_mut().zip(&self.arms) {
            let [shoulder, ..] = arm.jacobian(&pose)?.0;
            row[0] = -shoulder[1];
            row[1] = shoulder[0];
        }
        jacobian.0[Z][Z] = 1 << 32;
        Ok(jacobian)
    }

    /// The arms bound their joints. Their bound of theta1 is a slope, 1 / (proximal sin(bend)),
    /// times a distance from the middle of the box; the direction of the distal link has the slope
    /// 1 / (distal sin(bend)). The angle between the distal links is within both of them from that
    /// in the middle; between two angles with positive sines, less than half a turn apart, no sine
    /// is below both.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let mut ends = [turned(low), turned(high)];
        let (min, max) = (ends[1].0[1], ends[0].0[1]);
        (ends[0].0[1], ends[1].0[1]) = (min, max);
        let mut turned_limits = [Rates::default(); 2];
        for (turned, rates) in turned_limits.iter_mut().zip(rates) {
            *turned = turned_rates(rates);
        }
        let limits = turned_limits.get(..rates.len()).unwrap_or(&turned_limits);
        let [left, right] = &self.arms;
        let mut bounds = left.box_bounds(&ends[0], &ends[1], limits)?;
        let other = right.box_bounds(&ends[0], &ends[1], limits)?;

        let mut middle = ends[0];
        for axis in 0..2 {
            let width = i64::from(ends[1].0[axis].0) - i64::from(ends[0].0[axis].0);
            middle.0[axis] = Coordinate((i64::from(ends[0].0[axis].0) + width / 2) as i32);
        }
        let arms = [left.inverse(&middle)?, right.inverse(&middle)?];
        let between = distal_angle(&arms[1]).wrapping_sub(distal_angle(&arms[0]));
        let sweeps = [&bounds, &other].map(|bounds| {
            let [low, high] = [0, 1].map(|end| i64::from(bounds.joints[end].0[0].0));
            (high - low) / 2 * self.proximal / self.distal
        });
        let sweep = match sweeps {
            [0, 0] => 0,
            [left, right] => left + right + ROUNDED,
        };
        let sweep = i32::try_from(sweep).map_err(|_| PoseError::Unreachable)?;
        if sweep >= QUARTER_TURN {
            return Err(PoseError::Unreachable);
        }
        for end in [
            between.wrapping_sub(Angle(sweep)),
            between.wrapping_add(Angle(sweep)),
        ] {
            self.certify(scale(self.distal, sin_cos(end).0, 30))?;
        }

        for (bound, other) in bounds.joints.iter_mut().zip(&other.joints) {
            bound.0[1] = other.0[0];
        }
        for (bound, other) in bounds.rates.iter_mut().zip(&other.rates) {
            bound[1] = other[0];
        }
        Ok(bounds)
    }
}

/// Rounding error of the bound of an angle, raw units.
const ROUNDED: i64 = 64;
/// A quarter of a turn, raw units.
const QUARTER_TURN: i32 = 1 << 30;
