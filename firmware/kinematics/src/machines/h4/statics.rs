//! Statics of the H-4 arm: slide forces that correspond to a force on the tool (docs/control.md
//! 2.7).
//!
//! By virtual work J^T f = W with W = [F_x, F_y, F_z, M_theta] at the tip, in the base
//! frame. The structure of J splits the four equations into two pairs, solved in closed form.
//! With p = f1 - f2, r = f3 - f4, P = f1 + f2, Q = f3 + f4 and X = E Z - y D:
//!
//! ```text
//! p = -S12 (V3 F_y + U3 F_z) / 2 X          r = -S34 (U1 F_z - V1 F_y) / 2 X
//! P + Q = F_x
//! 2 c cos(theta) P = M_theta - T_L cos(theta) F_x + sin(theta) (m_1 p V1 / S12 + m_3 r V3 / S34)
//! ```
//!
//! S cancels in the last line. Callers should keep it out of a chip's control period: it divides
//! 128-bit numbers.

use super::H4;
use crate::{Pose, PoseError};
use haptimill_math::Effort;

/// Force and moment on the tool, in the base frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ToolForce {
    /// F_x, F_y, F_z at the tip.
    pub force: [Effort; 3],
    /// M_theta: moment about the y axis, positive in the direction in which theta grows.
    pub moment: Effort,
}

/// Newton metres to newton millimetres.
const MILLIMETRES_PER_METRE: i128 = 1000;

impl H4 {
    /// Forces of slides 1 to 4 that do the same work as the tool force: f = J^-T [F_x, F_y, F_z,
    /// M_theta].
    ///
    /// To hold the tool against a force, the drives must exert the opposite. The result is within 2
    /// raw units (3e-5 N) and 2^-30 of the largest of its terms. A force beyond 32,768 N saturates
    /// (it is infinite at a quarter turn of theta).
    ///
    /// # Errors
    /// As [`crate::Kinematics::inverse`].
    pub fn slide_forces(&self, pose: &Pose, tool: &ToolForce) -> Result<[Effort; 4], PoseError> {
        let (terms, pairs) = self.solve_positions(pose)?;
        let wide = |value: i32| value as i128;
        let [fx, fy, fz] = tool.force.map(|force| wide(force.0));
        let ((u1, v1), (u3, v3)) = (terms.upper, terms.lower);
        let [u1, v1, u3, v3] = [u1, v1, u3, v3].map(wide);
        let (sine, cosine) = (wide(terms.tilt.0), wide(terms.tilt.1));
        let roots = pairs.map(|pair| wide(pair.root.rounded()));

        // -2 X, at least 2 * margin * |E| in magnitude: not 0. Numerators stay below 2^95.
        let cross = u1 * v3 + u3 * v1;
        let upper = v3 * fy + u3 * fz;
        let lower = u1 * fz - v1 * fy;
        let divide = |numerator: i128, denominator: i128| {
            if denominator == 0 {
                0
            } else {
                numerator / denominator
            }
        };
        let difference = [
            divide(2 * roots[0] * upper, cross),
            divide(2 * roots[1] * lower, cross),
        ];

        // 2^-16 N * 2^-20 mm: the moment about the lower platform joint, minus the contribution of
        // the slides' differences. sin and cos are Q30.
        let moment = wide(tool.moment.0) * MILLIMETRES_PER_METRE * (1 << 20);
        let lean = divide(
            self.upper as i128 * v1 * upper + self.lower as i128 * v3 * lower,
            cross,
        );
        let denominator = 2 * wide(self.half_spacing) * cosine;
        let numerator = (moment << 30) + lean * sine - self.lower as i128 * fx * cosine;
        // Twice the sums P and Q, because the differences are twice p and r.
        let upper_sum = divide(2 * numerator, denominator);
        let lower_sum = 2 * fx - upper_sum;
        let quarter = |value: i128| {
            let rounded = (value + 2) >> 2;
            let held = rounded.clamp(i32::MIN as i128, i32::MAX as i128);
            Effort(held as i32)
        };
        Ok([
            quarter(upper_sum + difference[0]),
            quarter(upper_sum - difference[0]),
            quarter(lower_sum + difference[1]),
            quarter(lower_sum - difference[1]),
        ])
    }
}
