//! Statics of the haptic arm: what its six motors must do so that the hand feels a force (spec h4-milling 2.4, (3.39)-(3.41)).
//!
//! A leg pushes the platform at joint 5 along its link (I_j) and across it (M_j). With the six pushes lambda, B^T lambda = \[M; F\] and tau = A^T lambda: no division by A, so a link in line with its
//! slide only loses one motor. Moments are about the platform's centre and divided by r_p, so all entries of B are numbers of the same kind.
//!
//! The one place of the firmware with floating point: the 6 x 6 system in f32, by elimination with row pivots. Only additions, products, quotients and comparisons occur, each
//! rounded once, so every target gives the same bits (held by a check that runs on the chip). The directions come from fixed-point sines. Virtual work balances to 1e-4 of the largest term.
//!
//! The guard: det B is the product of the pivots, and for any matrix cond_2(B) < 2 / |det B| (|B|_F^2 / 6)^3 (Guggenheimer, Edelman and Johnson, 1995). So a bound on the right side is one on the
//! condition, at the price of some thirty instructions; it is never too small, and in the workspace of the
//! reference arm at most twice the truth (5.7 for conditions up to 4.65).
//!
//! Misuse: a force of NaN or beyond 10^4 N. What reaches this is clamped to a few newtons.
#![allow(
    clippy::float_arithmetic,
    reason = "the 6 x 6 system of the haptic arm; nothing else in the controller"
)]

use super::haptic::{HandPose, HapticArm, LEGS, Vector};

/// What the hand shall feel, about the platform's centre.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wrench {
    /// Force, N.
    pub force: [f32; 3],
    /// Moment, N mm.
    pub moment: [f32; 3],
}

/// The arm is too near a pose in which it cannot hold the hand in every direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Singular {
    /// The bound on the condition number of B; infinite at the singularity itself.
    pub condition: f32,
}

/// What the motors of the legs do: force along the slide in N, torque about it in N mm.
pub type Efforts = [[f32; 2]; LEGS];

/// Six equations: parts 0 to 5 belong to lambda, part 6 is the right side.
type System = [[f32; 7]; 6];

/// Q30 to a number, and 2^-20 mm to mm.
const Q30: f32 = 1.0 / (1 << 30) as f32;
const MILLIMETRE: f32 = 1.0 / (1 << 20) as f32;

fn numbers(vector: Vector, scale: f32) -> [f32; 3] {
    vector.map(|part| part as f32 * scale)
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

impl HapticArm {
    /// tau = A^T B^-T F, for a condition of B that is certainly below `limit`.
    ///
    /// # Errors
    /// [`Singular`], with the bound.
    #[inline(never)]
    pub fn efforts(
        &self,
        pose: &HandPose,
        wrench: &Wrench,
        limit: f32,
    ) -> Result<Efforts, Singular> {
        let radius = self.platform_radius().0 as f32 * MILLIMETRE;
        let inverse_radius = 1.0 / radius;
        let mut system = System::default();
        let mut norm = 0.0;
        for (index, leg) in pose.legs.iter().enumerate() {
            let arm = core::array::from_fn(|axis| pose.centre[axis].wrapping_sub(leg.joint[axis]));
            let arm = numbers(arm, MILLIMETRE * inverse_radius);
            let along = numbers(leg.link, -Q30);
            let across = numbers(leg.normal, Q30);
            for (push, part) in [(along, 2 * index), (across, 2 * index + 1)] {
                let moment = cross(push, arm);
                for axis in 0..3 {
                    system[axis][part] = moment[axis];
                    system[axis + 3][part] = push[axis];
                    norm += moment[axis] * moment[axis] + push[axis] * push[axis];
                }
            }
        }
        for axis in 0..3 {
            system[axis][6] = wrench.moment[axis] * inverse_radius;
            system[axis + 3][6] = wrench.force[axis];
        }
        let determinant = eliminate(&mut system);
        let mean = norm * (1.0 / 6.0);
        let bound = 2.0 * mean * mean * mean;
        // Not below, so that whatever is no number is refused.
        let regular = bound < limit * determinant;
        if !regular {
            return Err(Singular {
                condition: bound / determinant,
            });
        }
        let pushes = substitute(&system);
        let length = self.link_length().0 as f32 * MILLIMETRE;
        let mut efforts = Efforts::default();
        for (index, (effort, leg)) in efforts.iter_mut().zip(&pose.legs).enumerate() {
            let (sine, cosine) = leg.lean;
            effort[0] = -(cosine as f32 * Q30) * pushes[2 * index];
            effort[1] = -(sine as f32 * Q30) * length * pushes[2 * index + 1];
        }
        Ok(efforts)
    }
}

/// Makes the system triangular; gives the magnitude of its determinant.
fn eliminate(system: &mut System) -> f32 {
    let mut determinant = 1.0;
    for step in 0..6 {
        let mut best = step;
        for row in step + 1..6 {
            if system[row][step].abs() > system[best][step].abs() {
                best = row;
            }
        }
        if best != step {
            system.swap(step, best);
        }
        let pivot = system[step][step];
        determinant *= pivot.abs();
        if pivot == 0.0 {
            return 0.0;
        }
        let inverse = 1.0 / pivot;
        let (above, below) = system.split_at_mut(step + 1);
        let equation = &above[step];
        for row in below {
            let factor = row[step] * inverse;
            for (part, of) in row.iter_mut().zip(equation).skip(step + 1) {
                *part -= factor * of;
            }
        }
    }
    determinant
}

/// The solution of a triangular system without a zero on its diagonal.
fn substitute(system: &System) -> [f32; 6] {
    let mut solution = [0.0; 6];
    for row in (0..6).rev() {
        let mut rest = system[row][6];
        for part in row + 1..6 {
            rest -= system[row][part] * solution[part];
        }
        solution[row] = rest / system[row][row];
    }
    solution
}
