//! Geometry of the haptic arm: positions and rates of its legs for a pose of the handle.
//!
//! The simulator does not use the closed formulas of the controller, because a shared error would
//! cancel out. The only input is the construction of a leg (docs/control.md 2.2): a rod slides by d
//! along a tilted axis and turns by theta3 about it; a link of length L is hinged to its end by
//! theta4; the other end of the link is a ball joint on the platform. The joint of leg j is on a
//! circle of radius r_b at azimuth theta1; the axis leans inwards by theta2; the ball joint is on
//! the platform's circle of radius r_p at the same azimuth.
//!
//! In cylindrical coordinates about the leg's axis (radial e_r, around e_t, along u) the ball joint
//! is at radius rho = L sin theta4 and height d + L cos theta4. One vector therefore determines all
//! joints: its part across the axis gives rho and theta3, its part along the axis gives d.
//!
//! Units: mm and radians; the base frame is the controller's (z from the base to the handle). The
//! link points upwards along its axis (cos theta4 > 0).
//!
//! Near theta4 = 0 the turn theta3 is undefined; near theta4 = 90 degrees the slide loses its
//! effect. [`Geometry::legs`] returns an error for both; the arm has stops before them.

use crate::check::Check;
use crate::vector::{Vector, cross, dot, length, minus, plus, times};
use core::fmt;
use haptimill_firmware::io::LEGS;
use serde::{Deserialize, Serialize};

/// A 3 x 3 matrix, row by row.
pub type Matrix = [[f64; 3]; 3];

/// One value for each actuated joint: d (mm), theta3 (rad) of leg 1, of leg 2, of leg 3.
pub type Actuated = [f64; 2 * LEGS];

/// Linear velocity, then angular velocity; or force, then moment.
pub type Twist = [f64; 6];

/// Smallest sine and cosine of theta4 of a valid leg.
const MARGIN: f64 = 1e-3;

/// Lengths of the haptic arm in mm, and its angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HapticGeometry {
    /// Radius r_b of the circle of the legs on the base.
    pub base_radius_mm: f64,
    /// Length L of a link.
    pub link_mm: f64,
    /// Radius r_p of the circle of the ball joints on the platform.
    pub platform_radius_mm: f64,
    /// Azimuths theta1 of the legs.
    pub azimuth_deg: [f64; LEGS],
    /// Inward lean theta2 of the legs' axes.
    pub tilt_deg: f64,
    /// Centre of the platform at the home pose, where the platform is not rotated.
    pub home_mm: [f64; 3],
    /// Tip relative to the centre of the platform, in the platform's frame.
    pub tip_mm: [f64; 3],
}

impl Default for HapticGeometry {
    /// The reference geometry REF-M (docs/control.md 7.2) with the distances of the thesis:
    /// platform 450 mm from the base, tip 150 mm further.
    fn default() -> Self {
        Self {
            base_radius_mm: 150.0,
            link_mm: 200.0,
            platform_radius_mm: 50.0,
            azimuth_deg: [0.0, 120.0, 240.0],
            tilt_deg: 30.0,
            home_mm: [0.0, 0.0, 450.0],
            tip_mm: [0.0, 0.0, 150.0],
        }
    }
}

impl HapticGeometry {
    /// The arm as polylines in the base frame, mm, for a picture: each leg from its foot over the
    /// end of its rod to its ball joint, the base, the platform, and the handle from the centre of
    /// the platform to the tip. `tip` is in mm, `x` and `z` are directions of the handle. None
    /// where a leg does not reach the handle.
    #[must_use]
    pub fn links(&self, tip: Vector, [x, z]: [Vector; 2]) -> Vec<Vec<Vector>> {
        let columns = [x, cross(z, x), z];
        let frame = [0, 1, 2].map(|row| columns.map(|column| column[row]));
        let centre = minus(tip, turned(&frame, self.tip_mm));
        let geometry = Geometry::new(self);
        let Ok(legs) = geometry.legs(&HandlePose { centre, frame }) else {
            return Vec::new();
        };
        let feet = [0, 1, 2, 0].map(|leg| geometry.foot(leg));
        let joints = [0, 1, 2, 0].map(|leg: usize| plus(centre, legs[leg].lever));
        let mut lines: Vec<Vec<Vector>> = legs
            .iter()
            .enumerate()
            .map(|(index, leg)| {
                let rod = plus(feet[index], times(leg.axis, leg.slide));
                vec![feet[index], rod, joints[index]]
            })
            .collect();
        lines.extend([feet.to_vec(), joints.to_vec(), vec![centre, tip]]);
        lines
    }

    pub(super) fn check(&self, check: &mut Check) {
        for (name, value) in [
            ("base_radius_mm", self.base_radius_mm),
            ("link_mm", self.link_mm),
            ("platform_radius_mm", self.platform_radius_mm),
        ] {
            check.within(format!("haptic: geometry: {name}"), value, 1.0, 2000.0);
        }
        for (leg, azimuth) in self.azimuth_deg.into_iter().enumerate() {
            let field = format!("haptic: geometry: azimuth_deg {leg}");
            check.within(field, azimuth, -360.0, 360.0);
        }
        let field = "haptic: geometry: tilt_deg".to_owned();
        check.within(field, self.tilt_deg, -80.0, 80.0);
        for (name, place) in [("home_mm", self.home_mm), ("tip_mm", self.tip_mm)] {
            for (axis, value) in place.into_iter().enumerate() {
                let field = format!("haptic: geometry: {name} {axis}");
                check.within(field, value, -2000.0, 2000.0);
            }
        }
    }
}

/// A leg does not reach the handle, or is stretched out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutOfReach {
    /// Index of the leg, from 0.
    pub leg: usize,
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let leg = self.leg + 1;
        write!(f, "leg {leg} of the haptic arm does not reach the handle")
    }
}

impl core::error::Error for OutOfReach {}

/// Pose of the platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandlePose {
    /// Centre, mm.
    pub centre: Vector,
    /// Frame in the base; its columns are the axes of the platform.
    pub frame: Matrix,
}

impl HandlePose {
    /// Transforms a point from the platform's frame to the base.
    pub fn point(&self, local: Vector) -> Vector {
        plus(self.centre, turned(&self.frame, local))
    }
}

/// A matrix times a vector.
#[inline(always)]
pub fn turned(matrix: &Matrix, vector: Vector) -> Vector {
    [
        dot(matrix[0], vector),
        dot(matrix[1], vector),
        dot(matrix[2], vector),
    ]
}

/// One leg at a pose.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Leg {
    /// Unit vector along the leg's axis.
    pub axis: Vector,
    /// Unit vector from the axis towards the ball joint.
    pub radial: Vector,
    /// Unit vector around the axis.
    pub around: Vector,
    /// Unit vector along the link, from its hinge to the ball joint.
    pub link: Vector,
    /// Vector from the centre of the platform to the ball joint, mm.
    pub lever: Vector,
    /// Distance of the ball joint from the axis, mm.
    pub radius: f64,
    /// Slide d, mm.
    pub slide: f64,
    /// sin theta4.
    pub sin: f64,
    /// cos theta4.
    pub cos: f64,
}

impl Leg {
    /// Row that maps the twist of the platform to the rate of the ball joint along `direction`,
    /// divided by `by`.
    fn row(&self, direction: Vector, by: f64) -> Twist {
        let turning = cross(self.lever, direction);
        let scale = 1.0 / by;
        [
            direction[0] * scale,
            direction[1] * scale,
            direction[2] * scale,
            turning[0] * scale,
            turning[1] * scale,
            turning[2] * scale,
        ]
    }

    /// Row that maps the platform's twist [v, omega] to d'. Along the link only the slide moves the
    /// ball joint.
    pub fn slide_row(&self) -> Twist {
        self.row(self.link, self.cos)
    }

    /// Row that maps the platform's twist to theta3', 1/mm and 1.
    pub fn turn_row(&self) -> Twist {
        self.row(self.around, self.radius)
    }

    /// Row that maps the platform's twist to theta4'. Radially only the hinge moves the ball joint.
    pub fn hinge_row(&self, link_mm: f64) -> Twist {
        self.row(self.radial, link_mm * self.cos)
    }
}

#[derive(Debug, Clone, Copy)]
struct Fixed {
    /// Foot of the leg on the base circle.
    foot: Vector,
    axis: Vector,
    /// Directions at which theta3 is 0 and 90 degrees.
    zero: Vector,
    quarter: Vector,
    /// Ball joint in the platform's frame.
    joint: Vector,
}

/// The haptic arm's geometry, with its constants.
#[derive(Debug, Clone)]
pub struct Geometry {
    fixed: [Fixed; LEGS],
    link: f64,
    home: Vector,
    tip: Vector,
}

impl Geometry {
    /// Computes the constants.
    pub fn new(config: &HapticGeometry) -> Self {
        let degree = core::f64::consts::PI / 180.0;
        let (sin_tilt, cos_tilt) = libm::sincos(config.tilt_deg * degree);
        let fixed = config.azimuth_deg.map(|azimuth| {
            let (sin, cos) = libm::sincos(azimuth * degree);
            let (outwards, sideways) = ([cos, sin, 0.0], [-sin, cos, 0.0]);
            // The axis points upwards and leans towards the middle.
            let axis = plus(times([0.0, 0.0, 1.0], cos_tilt), times(outwards, -sin_tilt));
            Fixed {
                foot: times(outwards, config.base_radius_mm),
                axis,
                zero: cross(sideways, axis),
                quarter: sideways,
                joint: times(outwards, config.platform_radius_mm),
            }
        });
        Self {
            fixed,
            link: config.link_mm,
            home: config.home_mm,
            tip: config.tip_mm,
        }
    }

    /// Length of a link, mm.
    pub const fn link(&self) -> f64 {
        self.link
    }

    /// Tip in the platform's frame, mm.
    pub const fn tip(&self) -> Vector {
        self.tip
    }

    /// Ball joint of a leg in the platform's frame, mm.
    pub fn joint(&self, leg: usize) -> Vector {
        self.fixed[leg].joint
    }

    /// Foot of a leg on the base circle, mm.
    pub fn foot(&self, leg: usize) -> Vector {
        self.fixed[leg].foot
    }

    /// Home pose.
    pub const fn home(&self) -> HandlePose {
        HandlePose {
            centre: self.home,
            frame: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        }
    }

    /// Computes all legs at a pose.
    ///
    /// # Errors
    /// The first leg that does not reach, or whose link is within a milliradian of stretched or
    /// folded.
    #[inline]
    pub fn legs(&self, pose: &HandlePose) -> Result<[Leg; LEGS], OutOfReach> {
        let mut legs = [Leg::default(); LEGS];
        for (index, (leg, fixed)) in legs.iter_mut().zip(&self.fixed).enumerate() {
            let lever = turned(&pose.frame, fixed.joint);
            let reach = minus(plus(pose.centre, lever), fixed.foot);
            let along = dot(reach, fixed.axis);
            let across = minus(reach, times(fixed.axis, along));
            let radius = length(across);
            let sin = radius / self.link;
            let cos = libm::sqrt(1.0 - sin * sin);
            // The root of a negative number is NaN, which also fails this comparison.
            if !(sin > MARGIN && cos > MARGIN) {
                return Err(OutOfReach { leg: index });
            }
            let radial = times(across, 1.0 / radius);
            *leg = Leg {
                axis: fixed.axis,
                radial,
                around: cross(fixed.axis, radial),
                link: plus(times(radial, sin), times(fixed.axis, cos)),
                lever,
                radius,
                slide: along - self.link * cos,
                sin,
                cos,
            };
        }
        Ok(legs)
    }

    /// theta3 and theta4 of a leg, rad.
    pub fn angles(&self, index: usize, leg: &Leg) -> [f64; 2] {
        let fixed = &self.fixed[index];
        let turn = libm::atan2(dot(leg.radial, fixed.quarter), dot(leg.radial, fixed.zero));
        [turn, libm::atan2(leg.sin, leg.cos)]
    }

    /// d, theta3 and theta4 of each leg at a pose.
    ///
    /// # Errors
    /// As [`Geometry::legs`].
    pub fn inverse(&self, pose: &HandlePose) -> Result<[[f64; 3]; LEGS], OutOfReach> {
        let legs = self.legs(pose)?;
        Ok(core::array::from_fn(|index| {
            let [turn, hinge] = self.angles(index, &legs[index]);
            [legs[index].slide, turn, hinge]
        }))
    }

    /// Pose for given positions of the actuated joints, by Newton's method on the closed loops from
    /// a first guess. The hinges are free.
    ///
    /// # Errors
    /// The loops do not close from there.
    pub fn forward(
        &self,
        actuated: &Actuated,
        guess: &HandlePose,
    ) -> Result<HandlePose, OutOfReach> {
        let mut pose = *guess;
        let (mut rows, mut errors, mut worst) = self.open(actuated, &pose)?;
        for _ in 0..60 {
            if worst < 1e-12 * self.link {
                return Ok(pose);
            }
            let step = solved(rows, errors).ok_or(OutOfReach { leg: 0 })?;
            // A full step, or the first halved step that reduces the error.
            let nearer = (0..8).find_map(|halved| {
                let share = 1.0 / f64::from(1 << halved);
                let [x, y, z, a, b, c] = step.map(|part| part * share);
                let there = HandlePose {
                    centre: plus(pose.centre, [x, y, z]),
                    frame: rotated(&pose.frame, [a, b, c]),
                };
                let opened = self.open(actuated, &there).ok()?;
                (opened.2 < worst).then_some((there, opened))
            });
            let Some((there, opened)) = nearer else {
                break;
            };
            pose = there;
            (rows, errors, worst) = opened;
        }
        Err(OutOfReach { leg: 0 })
    }

    /// Loop errors at a pose: rows of the joints' rates, errors of the joints, and the largest
    /// error as a length, mm.
    fn open(
        &self,
        actuated: &Actuated,
        pose: &HandlePose,
    ) -> Result<([Twist; 6], Actuated, f64), OutOfReach> {
        let legs = self.legs(pose)?;
        let mut rows = [[0.0; 6]; 6];
        let mut errors = [0.0; 6];
        let mut worst = 0.0_f64;
        for (index, leg) in legs.iter().enumerate() {
            let [turn, _] = self.angles(index, leg);
            rows[2 * index] = leg.slide_row();
            rows[2 * index + 1] = leg.turn_row();
            errors[2 * index] = actuated[2 * index] - leg.slide;
            errors[2 * index + 1] = actuated[2 * index + 1] - turn;
            worst = worst
                .max(errors[2 * index].abs())
                .max(errors[2 * index + 1].abs() * self.link);
        }
        Ok((rows, errors, worst))
    }
}

/// Frame after a rotation by a rotation vector of the base, rad (Rodrigues' formula).
pub fn rotated(frame: &Matrix, by: Vector) -> Matrix {
    let angle = length(by);
    if angle == 0.0 {
        return *frame;
    }
    let axis = times(by, 1.0 / angle);
    let (sin, cos) = libm::sincos(angle);
    let mut result = [[0.0; 3]; 3];
    for column in 0..3 {
        let vector = [frame[0][column], frame[1][column], frame[2][column]];
        let along = times(axis, dot(axis, vector) * (1.0 - cos));
        let turned = plus(
            plus(times(vector, cos), times(cross(axis, vector), sin)),
            along,
        );
        for row in 0..3 {
            result[row][column] = turned[row];
        }
    }
    result
}

/// Solution of six linear equations; `None` for a numerically singular system.
pub fn solved(mut rows: [Twist; 6], mut right: Twist) -> Option<Twist> {
    for column in 0..6 {
        let pivot = (column..6).fold(column, |best, row| {
            if rows[row][column].abs() > rows[best][column].abs() {
                row
            } else {
                best
            }
        });
        rows.swap(column, pivot);
        right.swap(column, pivot);
        if rows[column][column].abs() < 1e-12 {
            return None;
        }
        for row in column + 1..6 {
            let factor = rows[row][column] / rows[column][column];
            let pivot = rows[column];
            for (part, pivot) in rows[row].iter_mut().zip(pivot) {
                *part -= factor * pivot;
            }
            right[row] -= factor * right[column];
        }
    }
    for column in (0..6).rev() {
        for k in column + 1..6 {
            right[column] -= rows[column][k] * right[k];
        }
        right[column] /= rows[column][column];
    }
    Some(right)
}
