//! Dynamics of the haptic arm: masses, and their motion under forces.
//!
//! The six degrees of freedom are those of the platform: twist V = [v, omega] of its centre, base
//! frame. The kinetic energy of the arm is the sum over three kinds of mass:
//!
//! * Platform and handle are one rigid body with any centre of mass and any inertia. An operator
//!   that holds the handle adds its mass at the grip.
//! * Each slide and each turn has the inertia of the parts that its motor moves, m_d and J_3,
//!   referred to the joint: energy m_d d'^2 / 2 + J_3 theta3'^2 / 2.
//! * A link is two halves of its mass, one at each end: on the slide, and in the ball joint on the
//!   platform. A slender rod of that mass would have a third of this inertia about its own centre;
//!   at 60 g a link the difference is 0.2 kg cm^2, against 10 kg cm^2 of the handle.
//!
//! With g_i the rows of the joints' rates (d' or theta3' = g_i V) and b_i the remaining joint
//! accelerations at constant V in the base,
//!
//! ```text
//! (M_body + sum J_i g_i g_i^T) V' = W + sum f_i g_i - bias_body - sum J_i b_i g_i
//! ```
//!
//! This is Lagrange's equation of these energies, without omissions. [`Dynamics::kick`] solves it
//! for one step, with the bias at the mean of the old and the new velocity. Friction then reduces
//! the rate joint by joint, up to its bound and never beyond standstill (Gauss-Seidel from zero, so
//! that it can only remove energy).
//!
//! Units: mm, s, kg, kg mm^2, N, N mm; 1 N on 1 kg is 1000 mm/s^2, 1 N mm on 1 kg mm^2 is 1000
//! rad/s^2.

use super::geometry::{Actuated, Geometry, Leg, Matrix, Twist, turned};
use crate::vector::{Vector, cross, dot, plus, times};
use haptimill_firmware::io::LEGS;

/// Acceleration in mm/s^2 of 1 N on 1 kg.
const UNIT: f64 = 1000.0;

/// Iterations over all frictions in a step.
const ROUNDS: usize = 8;

/// Largest number of frictions in a step: six joints, the rail, two directions of the ball.
pub const FRICTIONS: usize = 9;

/// A rigid body in the platform's frame, about the platform's centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    mass: f64,
    /// Mass times centre of mass, kg mm.
    moment: Vector,
    inertia: Matrix,
}

impl Body {
    /// Body from its mass (kg), centre of mass (mm) and inertia about that centre (kg mm^2, axes of
    /// the platform).
    pub fn new(mass: f64, centre: Vector, inertia: [f64; 3]) -> Self {
        let mut body = Self {
            mass: 0.0,
            moment: [0.0; 3],
            inertia: [[0.0; 3]; 3],
        };
        for (axis, value) in inertia.into_iter().enumerate() {
            body.inertia[axis][axis] = value;
        }
        body.with(mass, centre)
    }

    /// The body with a point mass added.
    #[must_use]
    pub fn with(mut self, mass: f64, at: Vector) -> Self {
        self.mass += mass;
        self.moment = plus(self.moment, times(at, mass));
        let square = dot(at, at);
        for row in 0..3 {
            for column in 0..3 {
                let same = if row == column { square } else { 0.0 };
                self.inertia[row][column] += mass * (same - at[row] * at[column]);
            }
        }
        self
    }

    /// Mass, kg.
    pub const fn mass(&self) -> f64 {
        self.mass
    }

    /// First moment of mass and inertia in the base frame.
    fn in_base(&self, frame: &Matrix) -> (Vector, Matrix) {
        let half = self.inertia.map(|row| frame.map(|axis| dot(row, axis)));
        let inertia = core::array::from_fn(|i| {
            core::array::from_fn(|k| dot(frame[i], [half[0][k], half[1][k], half[2][k]]))
        });
        (turned(frame, self.moment), inertia)
    }
}

/// A friction: it reduces the rate along a row by at most its bound.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Friction {
    /// Rate per component of the twist.
    pub row: Twist,
    /// Largest force or moment, N or N mm.
    pub bound: f64,
}

/// All forces on the arm during a step.
#[derive(Debug, Clone, Copy, Default)]
pub struct Acting {
    /// Force and moment about the platform's centre, N and N mm.
    pub wrench: Twist,
    /// Efforts in the joints: N along the slides, N mm about them.
    pub joints: Actuated,
    /// Frictions; only the first `frictions` are valid.
    pub friction: [Friction; FRICTIONS],
    /// Number of valid frictions.
    pub frictions: usize,
}

impl Acting {
    /// Adds a force at a point `lever` from the platform's centre.
    pub fn push(&mut self, force: Vector, lever: Vector) {
        let moment = cross(lever, force);
        for axis in 0..3 {
            self.wrench[axis] += force[axis];
            self.wrench[3 + axis] += moment[axis];
        }
    }

    /// Adds a moment.
    pub fn turn(&mut self, moment: Vector) {
        for (part, moment) in self.wrench[3..].iter_mut().zip(moment) {
            *part += moment;
        }
    }

    /// Adds a friction against the motion of a point along a direction.
    pub fn rub(&mut self, direction: Vector, lever: Vector, bound: f64) {
        let moment = cross(lever, direction);
        let [x, y, z] = direction;
        self.add(Friction {
            row: [x, y, z, moment[0], moment[1], moment[2]],
            bound,
        });
    }

    /// Adds a friction; ignores it if the list is full.
    pub fn add(&mut self, friction: Friction) {
        if let Some(slot) = self.friction.get_mut(self.frictions) {
            *slot = friction;
            self.frictions += 1;
        }
    }
}

/// Product A B.
#[inline(always)]
pub fn product(a: &Twist, b: &Twist) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
}

#[inline(always)]
fn add(to: &mut Twist, what: &Twist, factor: f64) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += what * factor;
    }
}

/// Cholesky factor of a symmetric positive definite matrix.
struct Triangle {
    rows: [Twist; 6],
    /// Reciprocals of the diagonal.
    over: Twist,
}

impl Triangle {
    fn of(matrix: &[Twist; 6]) -> Self {
        let mut rows = [[0.0; 6]; 6];
        let mut over = [0.0; 6];
        for row in 0..6 {
            for column in 0..=row {
                let done = (0..column).map(|k| rows[row][k] * rows[column][k]);
                let sum = done.fold(matrix[row][column], |sum, part| sum - part);
                if row == column {
                    // The root is real: the inertia of the body makes the mass matrix positive
                    // definite.
                    rows[row][row] = libm::sqrt(sum);
                    over[row] = 1.0 / rows[row][row];
                } else {
                    rows[row][column] = sum * over[column];
                }
            }
        }
        Self { rows, over }
    }

    fn solve(&self, right: &Twist) -> Twist {
        let mut x = *right;
        for row in 0..6 {
            for k in 0..row {
                x[row] -= self.rows[row][k] * x[k];
            }
            x[row] *= self.over[row];
        }
        for row in (0..6).rev() {
            for k in row + 1..6 {
                x[row] -= self.rows[k][row] * x[k];
            }
            x[row] *= self.over[row];
        }
        x
    }
}

/// Masses of the arm.
#[derive(Debug, Clone)]
pub struct Dynamics {
    /// Platform, handle and the links' upper halves; with the mass of the operator's hand while it
    /// holds the handle.
    pub body: Body,
    /// Inertias of the actuated joints: kg of a slide with its half of a link, kg mm^2 of a turn.
    pub joints: [f64; 2],
    /// Length of a link, mm.
    pub link: f64,
    /// Gravity on the part of the weight that is not balanced, mm/s^2, base frame.
    pub gravity: Vector,
}

impl Dynamics {
    /// Rows of the actuated joints' rates.
    pub fn rows(legs: &[Leg; LEGS]) -> [Twist; 6] {
        let mut rows = [[0.0; 6]; 6];
        for (index, leg) in legs.iter().enumerate() {
            rows[2 * index] = leg.slide_row();
            rows[2 * index + 1] = leg.turn_row();
        }
        rows
    }

    fn mass_matrix(&self, rows: &[Twist; 6], moment: &Vector, inertia: &Matrix) -> [Twist; 6] {
        let mut matrix = [[0.0; 6]; 6];
        for axis in 0..3 {
            matrix[axis][axis] = self.body.mass;
            for other in 0..3 {
                matrix[3 + axis][3 + other] = inertia[axis][other];
            }
        }
        // Moment of mass s: omega x s in the linear, s x v in the angular part.
        let [x, y, z] = *moment;
        let skew = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
        for axis in 0..3 {
            for other in 0..3 {
                matrix[3 + axis][other] = skew[axis][other];
                matrix[other][3 + axis] = skew[axis][other];
            }
        }
        for (index, row) in rows.iter().enumerate() {
            let inertia = self.joints[index % 2];
            for i in 0..6 {
                for k in 0..6 {
                    matrix[i][k] += inertia * row[i] * row[k];
                }
            }
        }
        matrix
    }

    /// Bias of the motion at a twist, kg mm/s^2 and kg mm^2/s^2.
    fn bias(
        &self,
        legs: &[Leg; LEGS],
        rows: &[Twist; 6],
        state: (&Vector, &Matrix),
        twist: &Twist,
    ) -> Twist {
        let (moment, inertia) = state;
        let spin = [twist[3], twist[4], twist[5]];
        let pull = cross(spin, cross(spin, *moment));
        let turn = cross(spin, turned(inertia, spin));
        let mut bias = [pull[0], pull[1], pull[2], turn[0], turn[1], turn[2]];
        for (index, leg) in legs.iter().enumerate() {
            let (sin, cos) = (leg.sin * self.link, leg.cos * self.link);
            let turning = product(&rows[2 * index + 1], twist);
            let hinging = product(&leg.hinge_row(self.link), twist);
            let toward = cross(spin, cross(spin, leg.lever));
            // Cylindrical coordinates of the ball joint, without the platform's acceleration.
            let radius = dot(toward, leg.radial) + leg.radius * turning * turning;
            let hinge = (radius + sin * hinging * hinging) / cos;
            let slide = dot(toward, leg.axis) + sin * hinge + cos * hinging * hinging;
            let around = (dot(toward, leg.around) - 2.0 * cos * hinging * turning) / leg.radius;
            add(&mut bias, &rows[2 * index], self.joints[0] * slide);
            add(&mut bias, &rows[2 * index + 1], self.joints[1] * around);
        }
        bias
    }

    /// Twist after a step of `dt` seconds under the acting forces, at this pose.
    pub fn kick(
        &self,
        legs: &[Leg; LEGS],
        frame: &Matrix,
        twist: &Twist,
        acting: &Acting,
        dt: f64,
    ) -> Twist {
        let rows = Self::rows(legs);
        let (moment, inertia) = self.body.in_base(frame);
        let triangle = Triangle::of(&self.mass_matrix(&rows, &moment, &inertia));
        let mut force = acting.wrench.map(|part| part * UNIT);
        for (index, row) in rows.iter().enumerate() {
            add(&mut force, row, acting.joints[index] * UNIT);
        }
        if self.gravity != [0.0; 3] {
            let weight = times(self.gravity, self.body.mass);
            let turning = cross(moment, self.gravity);
            add(
                &mut force,
                &[
                    weight[0], weight[1], weight[2], turning[0], turning[1], turning[2],
                ],
                1.0,
            );
            for (leg, row) in legs.iter().zip(rows.iter().step_by(2)) {
                add(
                    &mut force,
                    row,
                    self.joints[0] * dot(self.gravity, leg.axis),
                );
            }
        }
        let mut after = *twist;
        for _ in 0..2 {
            let mean = core::array::from_fn(|i| 0.5 * (twist[i] + after[i]));
            let mut right = force;
            add(
                &mut right,
                &self.bias(legs, &rows, (&moment, &inertia), &mean),
                -1.0,
            );
            let change = triangle.solve(&right);
            after = core::array::from_fn(|i| twist[i] + dt * change[i]);
        }
        rub(&triangle, &mut after, acting, dt);
        after
    }

    /// Kinetic energy and energy of the weight that is not balanced, N mm.
    pub fn energy(
        &self,
        geometry: &Geometry,
        legs: &[Leg; LEGS],
        centre: &Vector,
        frame: &Matrix,
        twist: &Twist,
    ) -> f64 {
        let rows = Self::rows(legs);
        let (moment, inertia) = self.body.in_base(frame);
        let matrix = self.mass_matrix(&rows, &moment, &inertia);
        let motion: f64 = (0..6)
            .map(|i| 0.5 * twist[i] * product(&matrix[i], twist))
            .sum();
        let held = dot(self.gravity, plus(times(*centre, self.body.mass), moment));
        let slides: f64 = (0..LEGS)
            .map(|leg| {
                let at = times(legs[leg].axis, legs[leg].slide);
                dot(self.gravity, plus(geometry.foot(leg), at)) * self.joints[0]
            })
            .sum();
        (motion - held - slides) / UNIT
    }
}

/// Applies the frictions to the twist.
fn rub(triangle: &Triangle, twist: &mut Twist, acting: &Acting, dt: f64) {
    let frictions = &acting.friction[..acting.frictions];
    let mut answers = [[0.0; 6]; FRICTIONS];
    let mut ease = [0.0; FRICTIONS];
    let mut given = [0.0; FRICTIONS];
    for (index, friction) in frictions.iter().enumerate() {
        answers[index] = triangle.solve(&friction.row);
        ease[index] = product(&friction.row, &answers[index]);
    }
    for _ in 0..ROUNDS {
        let mut changed = 0.0_f64;
        for (index, friction) in frictions.iter().enumerate() {
            let bound = friction.bound * UNIT * dt;
            let commanded = given[index] - product(&friction.row, twist) / ease[index];
            let now = commanded.clamp(-bound, bound);
            add(twist, &answers[index], now - given[index]);
            changed = changed.max((now - given[index]).abs() * ease[index]);
            given[index] = now;
        }
        // In mm/s and rad/s; a smaller change is convergence.
        if changed < 1e-9 {
            break;
        }
    }
}
