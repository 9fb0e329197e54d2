//! Statics of the haptic arm: motor efforts that exert a force on the operator's hand
//! (docs/control.md 2.4, (3.39)-(3.41)).
//!
//! A leg pushes the platform at joint 5 along its link (I_j) and across it (M_j). With the six
//! pushes lambda, B^T lambda = \[M; F\] and tau = A^T lambda. This needs no division by A, so a
//! link in line with its slide only loses one motor. Moments are about the platform's centre and
//! are divided by r_p, so all entries of B have the same unit.
//!
//! This is the only module of the firmware with floating point: the 6 x 6 system is solved in f32
//! by elimination with row pivots. It uses only additions, products, quotients and comparisons,
//! each rounded once, so every target gives the same bits (a check that runs on the chip verifies
//! it). The directions come from fixed-point sines. Virtual work balances to 1e-4 of the largest
//! term.
//!
//! The singularity check uses the determinant. det B is the product of the pivots, and for any
//! matrix cond_2(B) < 2 / |det B| (|B|_F^2 / 6)^3 (Guggenheimer, Edelman and Johnson, 1995). So a
//! limit for the right side also limits the condition number, at the cost of some thirty
//! instructions. The bound is never too small. In the workspace of the reference arm it is at most
//! twice the true condition number (5.7 for condition numbers up to 4.65).
//!
//! Callers must not pass forces that are NaN or beyond 10^4 N. The controller clamps them to a few
//! newtons.
#![allow(
    clippy::float_arithmetic,
    reason = "the 6 x 6 system of the haptic arm; nothing else in the controller"
)]

use haptimill_math::force::Force;

use super::{ArmPose, HapticArm, LEGS, Vector};

/// Force and moment on the operator's hand, about the platform's centre.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wrench {
    /// Force, N.
    pub force: [f32; 3],
    /// Moment, N mm.
    pub moment: [f32; 3],
}

impl Wrench {
    /// Wrench about the platform's centre of a force at the tip, 2^-16 N.
    ///
    /// The moment is that of the lever from the centre to the tip. So the force acts on the
    /// operator at its point, and the passivity observer counts the power of the tip's motion
    /// (docs/control.md, force feedback).
    #[must_use]
    pub fn at_tip(force: &[Force; 3], pose: &ArmPose) -> Self {
        let force = force.map(|part| part.0 as f32 * (1.0 / 65_536.0));
        let lever: [f32; 3] = core::array::from_fn(|axis| {
            pose.tip[axis].wrapping_sub(pose.centre[axis]) as f32 * (1.0 / 1_048_576.0)
        });
        Self {
            force,
            moment: [
                lever[1] * force[2] - lever[2] * force[1],
                lever[2] * force[0] - lever[0] * force[2],
                lever[0] * force[1] - lever[1] * force[0],
            ],
        }
    }
}

/// The arm is too near a pose in which it cannot exert a force in every direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Singular {
    /// Bound of the condition number of B; infinite at the singularity itself.
    pub condition: f32,
}

/// Efforts of the motors of the legs: force along the slide in N, torque about it in N mm.
pub type Efforts = [[f32; 2]; LEGS];

/// One number for each of the six equations.
type Column = [f32; 6];

/// Six equations, by columns: 0 to 5 belong to lambda, 6 is the right side.
type System = [Column; 7];

/// Index of the right side.
const RIGHT: usize = 6;

/// Factors from Q30 to a number, and from 2^-20 mm to mm.
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
    /// tau = A^T B^-T F, if the condition number of B is certainly below `limit`.
    ///
    /// # Errors
    /// [`Singular`] with the bound of the condition number.
    #[inline(never)]
    pub fn efforts(
        &self,
        pose: &ArmPose,
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
            let along = column(numbers(leg.link, -Q30), arm, &mut norm);
            let across = column(numbers(leg.normal, Q30), arm, &mut norm);
            (system[2 * index], system[2 * index + 1]) = (along, across);
        }
        let moment = wrench.moment.map(|part| part * inverse_radius);
        system[RIGHT] = join(moment, wrench.force);
        let determinant = eliminate(&mut system);
        let mean = norm * (1.0 / 6.0);
        let bound = 2.0 * mean * mean * mean;
        // The comparison is written so that NaN is refused.
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
            let (sine, cosine) = leg.hinge;
            effort[0] = -(cosine as f32 * Q30) * pushes[2 * index];
            effort[1] = -(sine as f32 * Q30) * length * pushes[2 * index + 1];
        }
        Ok(efforts)
    }
}

/// Column of a push: its moment at an arm, and the push itself. Adds the squares of its parts to
/// the norm.
#[inline(always)]
fn column(push: [f32; 3], arm: [f32; 3], norm: &mut f32) -> Column {
    let moment = cross(push, arm);
    for axis in 0..3 {
        *norm += moment[axis] * moment[axis] + push[axis] * push[axis];
    }
    join(moment, push)
}

#[inline(always)]
fn join(moment: [f32; 3], force: [f32; 3]) -> Column {
    let ([a, b, c], [d, e, f]) = (moment, force);
    [a, b, c, d, e, f]
}

/// Makes the system triangular and returns the magnitude of its determinant.
#[inline(always)]
fn eliminate(system: &mut System) -> f32 {
    let mut determinant = 1.0;
    let mut regular = |pivot: f32| {
        determinant *= pivot.abs();
        pivot != 0.0
    };
    // Each step is written out, so that the compiler knows the length of its loops: counting them
    // took half of all instructions.
    let regular = regular(step::<0>(system))
        && regular(step::<1>(system))
        && regular(step::<2>(system))
        && regular(step::<3>(system))
        && regular(step::<4>(system))
        && regular(step::<5>(system));
    if regular { determinant } else { 0.0 }
}

/// Brings the largest number of a column to its diagonal, clears the numbers below it, and returns
/// it.
#[inline(always)]
fn step<const STEP: usize>(system: &mut System) -> f32 {
    let mut best = STEP;
    for row in STEP + 1..6 {
        if system[STEP][row].abs() > system[STEP][best].abs() {
            best = row;
        }
    }
    if best != STEP {
        for column in &mut system[STEP..] {
            column.swap(STEP, best);
        }
    }
    let pivot = system[STEP][STEP];
    let inverse = 1.0 / pivot;
    let factors: Column = system[STEP].map(|part| part * inverse);
    for column in &mut system[STEP + 1..] {
        for row in STEP + 1..6 {
            column[row] -= factors[row] * column[STEP];
        }
    }
    pivot
}

/// Solution of a triangular system without a zero on its diagonal.
#[inline(always)]
fn substitute(system: &System) -> Column {
    let mut solution = [0.0; 6];
    for row in (0..6).rev() {
        let mut rest = system[RIGHT][row];
        for part in row + 1..6 {
            rest -= system[part][row] * solution[part];
        }
        solution[row] = rest / system[row][row];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    /// Textbook elimination: by rows, with counted loops.
    fn textbook(mut rows: [[f32; 7]; 6]) -> (f32, Option<Column>) {
        let mut determinant = 1.0;
        for step in 0..6 {
            let mut best = step;
            for row in step + 1..6 {
                if rows[row][step].abs() > rows[best][step].abs() {
                    best = row;
                }
            }
            rows.swap(step, best);
            let pivot = rows[step];
            determinant *= pivot[step].abs();
            if pivot[step] == 0.0 {
                return (0.0, None);
            }
            let inverse = 1.0 / pivot[step];
            for row in &mut rows[step + 1..] {
                let factor = row[step] * inverse;
                for part in step + 1..7 {
                    row[part] -= factor * pivot[part];
                }
            }
        }
        let mut solution = [0.0; 6];
        for row in (0..6).rev() {
            let mut rest = rows[row][6];
            for part in row + 1..6 {
                rest -= rows[row][part] * solution[part];
            }
            solution[row] = rest / rows[row][row];
        }
        (determinant, Some(solution))
    }

    fn bits(column: Column) -> [u32; 6] {
        column.map(f32::to_bits)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 5_000, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

        /// The bits are equal, also where numbers are equal or zero, or the system has no solution.
        #[test]
        fn the_unrolled_elimination_is_the_textbooks(
            rows in prop::array::uniform6(prop::array::uniform7(prop_oneof![
                3 => -2.0_f32..2.0,
                1 => prop::sample::select(&[0.0_f32, 1.0, -1.0, 0.5][..]),
            ]))
        ) {
            let mut system: System = core::array::from_fn(|part| rows.map(|row| row[part]));
            let determinant = eliminate(&mut system);
            let (expected, solution) = textbook(rows);
            prop_assert_eq!(determinant.to_bits(), expected.to_bits());
            if let Some(solution) = solution {
                prop_assert_eq!(bits(substitute(&system)), bits(solution));
            }
        }
    }
}
