//! The loops of the haptic arm: where its legs are for a pose of the handle, and how they move with it.
//!
//! The controller has the closed formulas of the thesis. These are not used here, on purpose: a shared mistake would cancel out. All that goes in is how a leg is
//! built (docs/control.md 2.2): a rod slides by d along a tilted axis and turns by theta3 about it; on its end sits, hinged by theta4, a link of
//! length L; the link's other end is a ball joint on the platform. The joint of leg j sits on a circle of radius r_b at azimuth theta1; the axis leans inwards by theta2;
//! the ball joint sits on the platform's circle of radius r_p at the same azimuth.
//!
//! In cylindrical coordinates about the leg's axis (radial e_r, around e_t, along u) the ball joint is at radius rho = L sin theta4 and height d + L cos theta4.
//! So all follows from one vector: what lies across the axis is rho and theta3, what lies along it is d.
//!
//! Units: mm and radians; the base frame is the controller's (z from the base to the handle). The link points upwards along its axis (cos theta4 > 0).
//!
//! Misuse: near theta4 = 0 the turn theta3 is not defined, near theta4 = 90 degrees the slide leads nothing. [`Geometry::legs`] refuses both; the arm has stops before.

use crate::check::Check;
use crate::vector::{Vector, cross, dot, length, minus, plus, times};
use core::fmt;
use haptimill_firmware::io::LEGS;
use serde::{Deserialize, Serialize};

/// Rows of a matrix.
pub type Matrix = [[f64; 3]; 3];

/// One value for each actuated joint: d (mm), theta3 (rad) of leg 1, of leg 2, of leg 3.
pub type Actuated = [f64; 2 * LEGS];

/// Linear velocity, then angular velocity; or force, then moment.
pub type Twist = [f64; 6];

/// Least sine and cosine of theta4 for which a leg can be reckoned with.
const MARGIN: f64 = 1e-3;

/// Lengths of the haptic arm in mm, and its angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HapticGeometry {
    /// Radius of the circle of the legs on the base, r_b.
    pub base_radius_mm: f64,
    /// Length of a link, L.
    pub link_mm: f64,
    /// Radius of the circle of the ball joints on the platform, r_p.
    pub platform_radius_mm: f64,
    /// Azimuths of the legs, theta1.
    pub azimuth_deg: [f64; LEGS],
    /// Lean of the legs' axes inwards, theta2.
    pub tilt_deg: f64,
    /// Centre of the platform at home; it is not turned there.
    pub home_mm: [f64; 3],
    /// The tip, from the centre of the platform, in the platform's frame.
    pub tip_mm: [f64; 3],
}

impl Default for HapticGeometry {
    /// The reference geometry REF-M (docs/control.md 7.2) with the distances of the thesis: platform 450 mm from the base, tip 150 mm further.
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

/// The handle is where no leg reaches, or where one is stretched out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OutOfReach {
    /// The leg, from 0.
    pub leg: usize,
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let leg = self.leg + 1;
        write!(f, "leg {leg} of the haptic arm does not reach the handle")
    }
}

impl core::error::Error for OutOfReach {}

/// Where the platform is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandlePose {
    /// Its centre, mm.
    pub centre: Vector,
    /// Its frame in the base: columns are its axes.
    pub frame: Matrix,
}

impl HandlePose {
    /// A point of the platform's frame in the base.
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
    /// Its axis.
    pub axis: Vector,
    /// Radially from the axis towards the ball joint.
    pub radial: Vector,
    /// Around the axis.
    pub around: Vector,
    /// Along the link, from its hinge to the ball joint.
    pub link: Vector,
    /// From the centre of the platform to the ball joint, mm.
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
    /// The row by which a rate along `direction` of the ball joint depends on the twist of the platform, divided by `by`.
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

    /// d' for each part of the platform's twist [v, omega]: along the link nothing but the slide moves.
    pub fn slide_row(&self) -> Twist {
        self.row(self.link, self.cos)
    }

    /// theta3' for each part of the platform's twist, 1/mm and 1.
    pub fn turn_row(&self) -> Twist {
        self.row(self.around, self.radius)
    }

    /// theta4' for each part of the platform's twist: radially nothing but the hinge moves.
    pub fn hinge_row(&self, link_mm: f64) -> Twist {
        self.row(self.radial, link_mm * self.cos)
    }
}

#[derive(Debug, Clone, Copy)]
struct Fixed {
    /// The leg's foot on the base circle.
    foot: Vector,
    axis: Vector,
    /// Where theta3 is 0, and 90 degrees.
    zero: Vector,
    quarter: Vector,
    /// The ball joint in the platform's frame.
    joint: Vector,
}

/// The haptic arm's geometry, ready for use.
#[derive(Debug, Clone)]
pub struct Geometry {
    fixed: [Fixed; LEGS],
    link: f64,
    home: Vector,
    tip: Vector,
}

impl Geometry {
    /// Prepares the constants.
    pub fn new(config: &HapticGeometry) -> Self {
        let degree = core::f64::consts::PI / 180.0;
        let (sin_tilt, cos_tilt) = libm::sincos(config.tilt_deg * degree);
        let fixed = config.azimuth_deg.map(|azimuth| {
            let (sin, cos) = libm::sincos(azimuth * degree);
            let (outwards, sideways) = ([cos, sin, 0.0], [-sin, cos, 0.0]);
            // Upwards, leaning towards the middle.
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

    /// The tip in the platform's frame, mm.
    pub const fn tip(&self) -> Vector {
        self.tip
    }

    /// The ball joint of a leg in the platform's frame, mm.
    pub fn joint(&self, leg: usize) -> Vector {
        self.fixed[leg].joint
    }

    /// The foot of a leg on the base circle, mm.
    pub fn foot(&self, leg: usize) -> Vector {
        self.fixed[leg].foot
    }

    /// The pose at home.
    pub const fn home(&self) -> HandlePose {
        HandlePose {
            centre: self.home,
            frame: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        }
    }

    /// All legs at a pose.
    ///
    /// # Errors
    /// The first leg that does not reach, or that is within a milliradian of a stretched or a folded link.
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
            // A root of a negative number is not a number, and not above the margin either.
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

    /// The pose at which the actuated joints stand so: Newton's method on the closed loops from a first guess. The hinges are free.
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
            // A whole step, or the longest of its halves that leads nearer.
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

    /// By how much the loops are open at a pose: rows of the joints' rates, errors of the joints, and the largest as a length, mm.
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

/// A frame turned by a rotation vector of the base, rad (Rodrigues' formula).
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

/// The solution of six linear equations; `None` when they are singular for all that matters.
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
