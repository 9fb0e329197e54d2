//! The five-bar arm as a subject. Its reference values follow from the law of cosines in the
//! triangle of each motor, its elbow and the tip; the pose of its joints from Newton's method on
//! the lengths of the distal links.

use super::subject::{MM, Margin, Margins, RADIAN, Reals, Sequence, Subject};
use core::f64::consts::{FRAC_PI_2, PI, TAU};
use haptimill_kinematics::five_bar::{FiveBar, FiveBarGeometry};
use haptimill_kinematics::{Joints, Machine, PoseError};
use haptimill_math::{Coordinate, Length};
use heapless::Vec;

/// Lengths in mm.
#[derive(Clone, Copy)]
pub struct Lengths {
    /// Half the distance of the motors.
    pub half_base: f64,
    /// Proximal links.
    pub proximal: f64,
    /// Distal links.
    pub distal: f64,
    /// Origin of the workpiece, from the middle between the motors.
    pub origin: [f64; 2],
    /// Singularity margin.
    pub margin: f64,
}

/// Longer distal links, motors apart.
pub const APART: Lengths = Lengths {
    half_base: 80.1875,
    proximal: 219.6875,
    distal: 281.3125,
    origin: [12.5, 301.25],
    margin: 60.125,
};

/// Longer proximal links, motors on one axis.
pub const ON_ONE_AXIS: Lengths = Lengths {
    half_base: 0.0,
    proximal: 251.5625,
    distal: 190.0625,
    origin: [-205.625, 87.75],
    margin: 70.5,
};

/// A five-bar arm with its reference values and its kinematics.
pub struct Arms {
    lengths: Lengths,
    machine: FiveBar,
}

/// Sides of the arms: that of the elbow, and of the motor.
const SIDES: [f64; 2] = [-1.0, 1.0];

fn unreachable(error: &PoseError) -> bool {
    *error == PoseError::Unreachable
}

fn singular(error: &PoseError) -> bool {
    matches!(error, PoseError::NearSingularity { .. })
}

/// The angle from +y of a direction from +x, from -pi to pi.
fn from_y(angle: f64) -> f64 {
    let angle = angle - FRAC_PI_2;
    angle - TAU * libm::round(angle / TAU)
}

impl Arms {
    /// Creates the arm of these lengths.
    #[must_use]
    pub fn new(lengths: Lengths) -> Self {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        let geometry = FiveBarGeometry {
            half_base: raw(lengths.half_base),
            proximal: raw(lengths.proximal),
            distal: raw(lengths.distal),
            origin: lengths.origin.map(raw),
            singularity_margin: raw(lengths.margin),
        };
        assert!(FiveBar::is_sound(&geometry));
        Self {
            lengths,
            machine: FiveBar::new(&geometry),
        }
    }

    /// Distance and direction from +x of the tip, from each motor.
    fn polar(&self, pose: &Reals) -> [(f64, f64); 2] {
        let Lengths {
            half_base, origin, ..
        } = self.lengths;
        SIDES.map(|side| {
            let (x, y) = (pose[0] + origin[0] - side * half_base, pose[1] + origin[1]);
            (libm::hypot(x, y), libm::atan2(y, x))
        })
    }

    /// Cosines of the angles of the triangle at the elbow (from the straight arm) and the motor.
    fn cosines(&self, r: f64) -> [f64; 2] {
        let Lengths {
            proximal, distal, ..
        } = self.lengths;
        [
            (r * r - proximal * proximal - distal * distal) / (2.0 * proximal * distal),
            (r * r + proximal * proximal - distal * distal) / (2.0 * proximal * r),
        ]
    }

    /// Directions from +x of the proximal links, and of the distal ones.
    fn directions(&self, pose: &Reals) -> Option<[[f64; 2]; 2]> {
        let polar = self.polar(pose);
        let mut links = [[0.0; 2]; 2];
        for arm in 0..2 {
            let (r, direction) = polar[arm];
            let [elbow, motor] = self.cosines(r);
            if !(-1.0..=1.0).contains(&elbow) {
                return None;
            }
            let proximal = direction - SIDES[arm] * libm::acos(motor);
            links[0][arm] = proximal;
            links[1][arm] = proximal + SIDES[arm] * libm::acos(elbow);
        }
        Some(links)
    }

    fn pose(&self, tip: [f64; 2], z: f64) -> Reals {
        let [x_off, y_off] = self.lengths.origin;
        [tip[0] - x_off, tip[1] - y_off, z, 0.0, 0.0, 0.0]
    }

    /// A place at which the distal links have this angle between them, or any place.
    fn opened(&self, sequence: &mut Sequence, between: f64) -> [f64; 2] {
        let Lengths {
            half_base,
            proximal,
            distal,
            ..
        } = self.lengths;
        let first = sequence.between(-0.5, PI);
        let (sine, cosine) = libm::sincos(first);
        let (other_sine, other_cosine) = libm::sincos(first + between);
        // From the left elbow to the right one, drawn back to the left one: both motors have the
        // distance of a proximal link from there.
        let way = [
            distal * (cosine - other_cosine),
            distal * (sine - other_sine),
        ];
        let to_motor = [2.0 * half_base - way[0], -way[1]];
        let apart = libm::hypot(to_motor[0], to_motor[1]);
        let height = libm::sqrt((proximal * proximal - 0.25 * apart * apart).max(0.0));
        let side = if sequence.below(2) == 0 { 1.0 } else { -1.0 };
        let aside = side * height / apart.max(1e-9);
        [
            -half_base + 0.5 * to_motor[0] - aside * to_motor[1] + distal * cosine,
            0.5 * to_motor[1] + aside * to_motor[0] + distal * sine,
        ]
    }
}

impl Subject for Arms {
    type Machine = FiveBar;

    fn machine(&self) -> &FiveBar {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let Lengths {
            half_base,
            proximal,
            distal,
            ..
        } = self.lengths;
        let reach = proximal + distal;
        loop {
            let tip = [
                sequence.between(-reach, reach),
                sequence.between(-0.3 * reach, 1.05 * reach),
            ];
            let pose = self.pose(tip, sequence.between(-2000.0, 2000.0));
            // A joint jumps by a turn at half a turn.
            let jumps = self
                .close(&pose)
                .is_some_and(|joints| joints[..2].iter().any(|joint| joint.abs() > PI - 0.01));
            if !jumps && libm::hypot(tip[0], tip[1]) < 1.05 * (reach + half_base) {
                return pose;
            }
        }
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let Lengths {
            half_base,
            proximal,
            distal,
            margin,
            ..
        } = self.lengths;
        loop {
            let step = sequence.logarithmic(-7.0, 1.0);
            let (sine, cosine) = libm::sincos(sequence.between(-0.3, PI + 0.3));
            let tip = match sequence.below(3) {
                0 => {
                    let min = libm::asin(margin / distal);
                    let between = [min, PI - min][sequence.below(2) as usize];
                    let [x, y] = self.opened(sequence, between);
                    [x + step * cosine, y + step * sine]
                }
                // An arm straight or folded, or bent by as little as the margin allows.
                arm => {
                    let bend = libm::sqrt(1.0 - (margin / distal) * (margin / distal));
                    let bend = [1.0, -1.0, bend, -bend][sequence.below(4) as usize];
                    let square = proximal * proximal + distal * distal;
                    let bound = libm::sqrt(square + 2.0 * proximal * distal * bend);
                    let r = (bound + step).abs();
                    let motor = SIDES[arm as usize - 1] * half_base;
                    [motor + r * cosine, r * sine]
                }
            };
            let pose = self.pose(tip, sequence.between(-2000.0, 2000.0));
            let jumps = self
                .close(&pose)
                .is_some_and(|joints| joints[..2].iter().any(|joint| joint.abs() > PI - 0.01));
            if !jumps {
                return pose;
            }
        }
    }

    /// Half of them from the workspace.
    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        let pose = self.random_pose(sequence);
        let placed = match sequence.below(2) {
            0 => self.close(&pose),
            _ => None,
        };
        for (index, joint) in joints.0[..3].iter_mut().enumerate() {
            *joint = match (placed, index) {
                (Some(placed), 0..2) => Coordinate(libm::round(placed[index] / RADIAN) as i32),
                _ => Coordinate(sequence.next() as i32),
            };
        }
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        let Lengths {
            proximal,
            distal,
            margin,
            ..
        } = self.lengths;
        let mut margins: Vec<Margin, 12> = Vec::new();
        for (r, _) in self.polar(pose) {
            let [elbow, _] = self.cosines(r);
            let distance = distal * libm::sqrt((1.0 - elbow * elbow).max(0.0));
            margins.extend([
                Margin::mm(proximal + distal - r, unreachable),
                Margin::mm(r - libm::fabs(proximal - distal), unreachable),
                Margin::mm(distance - margin, singular),
            ]);
        }
        if let Some([_, [left, right]]) = self.directions(pose) {
            let opening = distal * libm::sin(right - left);
            margins.extend([Margin::mm(opening - margin, singular)]);
        }
        Margins(margins)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        let [proximal, _] = self.directions(pose)?;
        let [left, right] = proximal.map(from_y);
        Some([left, right, pose[2], 0.0, 0.0, 0.0])
    }

    fn solve(&self, joints: &Reals, guess: &Reals) -> Option<Reals> {
        let Lengths {
            half_base,
            proximal,
            distal,
            origin,
            ..
        } = self.lengths;
        let elbows = [0, 1].map(|arm| {
            let (sine, cosine) = libm::sincos(joints[arm]);
            [SIDES[arm] * half_base - proximal * sine, proximal * cosine]
        });
        let mut tip = [guess[0] + origin[0], guess[1] + origin[1]];
        for _ in 0..30 {
            let [a, b] = elbows.map(|elbow| [tip[0] - elbow[0], tip[1] - elbow[1]]);
            let [left, right] =
                [a, b].map(|link| 0.5 * (distal * distal - link[0] * link[0] - link[1] * link[1]));
            let determinant = a[0] * b[1] - a[1] * b[0];
            let step = [
                (left * b[1] - right * a[1]) / determinant,
                (right * a[0] - left * b[0]) / determinant,
            ];
            tip = [tip[0] + step[0], tip[1] + step[1]];
            if step.iter().all(|step| step.abs() < 1e-10) {
                return Some(self.pose(tip, joints[2]));
            }
        }
        None
    }
}
