//! Bounds of the joints and of their rates over a box of poses.
//!
//! A centred form: the pose in the middle, and how far U, V and S may be from theirs, by the
//! triangle inequality with terms of first and second order. The signs are left out, because
//! coordinates that decelerate stop at different times: terms that cancel at full speed do not
//! cancel during the whole deceleration. One pose and these bounds take a tenth of the instructions
//! that the corners of a box take, and hold between the corners as well.

use super::errors::near_reach_limit;
use super::motion::Slope;
use super::{ALPHA, AXES, H4, Pair, THETA, check_table, check_tilt};
use crate::{BoxBounds, Pose, PoseError, Rates};
use haptimill_math::Coordinate;
use haptimill_math::root::Root;
use haptimill_math::trig::QUARTER_PI_Q31;

/// A product of magnitudes, without so many bits, held at its end.
// Out of line: inlined in some forty places it takes more flash than instructions are worth here.
#[inline(never)]
fn times(a: u32, b: u32, shift: u32) -> u32 {
    ((u64::from(a) * u64::from(b)) >> shift).min(u64::from(u32::MAX)) as u32
}

/// Axis units of an angle to radians, Q30.
fn radians(angle: u32) -> u32 {
    times(angle, QUARTER_PI_Q31.unsigned_abs(), 30)
}

/// Sine and cosine of an angle (Q30), and bounds of their magnitudes over a range of it.
struct Turn {
    sine: u32,
    cosine: u32,
    max_sine: u32,
    max_cosine: u32,
    /// Half the range, and half its square, Q30.
    by: u32,
    bend: u32,
}

impl Turn {
    fn of((sine, cosine): (i32, i32), half: u32) -> Self {
        let (sine, cosine) = (sine.unsigned_abs(), cosine.unsigned_abs());
        let by = radians(half);
        Self {
            sine,
            cosine,
            max_sine: sine.saturating_add(times(cosine, by, 30)),
            max_cosine: cosine.saturating_add(times(sine, by, 30)),
            by,
            bend: times(by, by, 31),
        }
    }

    /// Bound of a |cos| + b |sin|, a coordinate of a rotated displacement.
    fn along(cosine: u32, a: u32, sine: u32, b: u32) -> u32 {
        times(cosine, a, 30).saturating_add(times(sine, b, 30))
    }

    /// Bound of the change of one coordinate of a point that rotates by up to half the range;
    /// `aside` is the other coordinate.
    fn bound_rotation(&self, along: u32, aside: u32) -> u32 {
        times(aside, self.by, 30).saturating_add(times(along, self.bend, 30))
    }
}

/// Rounding error of the bound of a length, or of a rate, axis units (per second).
const ROUNDED: u32 = 16;
const ROUNDED_RATE: u32 = 64;

impl H4 {
    /// Bounds of joints and joint rates, see [`crate::Kinematics::box_bounds`].
    #[inline(always)]
    pub(super) fn bounds_of_box(
        &self,
        low: &Pose,
        high: &Pose,
        rates: &[Rates],
    ) -> Result<BoxBounds, PoseError> {
        let mut middle = Pose::default();
        let mut half = [0_u32; AXES];
        for (axis, half) in half.iter_mut().enumerate() {
            let (low, high) = (low.0[axis], high.0[axis]);
            let width = high.wrapping_sub(low).0 as u32;
            *half = width.div_ceil(2);
            middle.0[axis] = Coordinate(low.0.wrapping_add((width / 2) as i32));
        }
        // With the middle, which `place` checks: an arc whose ends and middle are within a quarter
        // turn is so as a whole.
        for end in [low, high] {
            check_tilt(end.0[THETA])?;
            check_table(end.0[ALPHA])?;
        }
        let (terms, pairs) = self.solve_positions(&middle)?;
        let joints = self.joints(&terms, &pairs, middle.0[ALPHA])?;
        let [by_x, by_across, by_up, by_theta, by_alpha] = half;
        let moved = half != [0; AXES];
        let table = Turn::of(terms.table, by_alpha);
        let tilt = Turn::of(terms.tilt, by_theta);
        // Both are words, so their magnitudes are.
        let (y, height) = (terms.y as i32, terms.height as i32);
        let line_y = Turn::along(table.cosine, by_across, table.sine, by_up);
        let line_height = Turn::along(table.cosine, by_up, table.sine, by_across);
        let max_y = y.unsigned_abs().saturating_add(line_y);
        let max_height = height.unsigned_abs().saturating_add(line_height);
        let rounded = if moved { ROUNDED } else { 0 };
        let by_y = line_y
            .saturating_add(table.bound_rotation(max_y, max_height))
            .saturating_add(rounded);
        let by_height = line_height
            .saturating_add(table.bound_rotation(max_height, max_y))
            .saturating_add(rounded);
        let arms = [self.upper, self.lower].map(i32::unsigned_abs);
        let by_v = arms.map(|arm| {
            by_height.saturating_add(
                tilt.bound_rotation(times(arm, tilt.cosine, 30), times(arm, tilt.sine, 30)),
            )
        });
        if moved {
            self.stays_regular(&terms, by_y, by_v)?;
        }
        let mut slopes = [(0, 0); 2];
        let mut ends = [joints; 2];
        for (index, pair) in pairs.iter().enumerate() {
            let near = near_reach_limit(index as u8);
            let u = pair.u.unsigned_abs().saturating_add(by_y);
            let v = pair.v.unsigned_abs().saturating_add(by_v[index]);
            if u.max(v) >= 1 << 30 {
                return Err(near);
            }
            let square = self.square((u as i32, v as i32));
            if square < self.min_square() {
                return Err(near);
            }
            let far = Pair {
                u: u as i32,
                v: v as i32,
                root: Root::of(square as u64),
            };
            // S is concave in U and V: it is never farther above than it is below.
            let shorter = (pair.root.rounded() - far.root.rounded()).unsigned_abs();
            let lean = tilt.bound_rotation(
                times(arms[index], tilt.sine, 30),
                times(arms[index], tilt.cosine, 30),
            );
            let by = by_x.saturating_add(shorter).saturating_add(lean);
            let by = by.saturating_add(rounded).min(i32::MAX as u32) as i32;
            for slide in 2 * index..2 * index + 2 {
                ends[0].0[slide].0 = ends[0].0[slide].0.saturating_sub(by);
                ends[1].0[slide].0 = ends[1].0[slide].0.saturating_add(by);
            }
            let slope = Slope::of(&far);
            slopes[index] = (slope.u.unsigned_abs(), slope.v.unsigned_abs());
        }
        ends[0].0[ALPHA] = low.0[ALPHA];
        ends[1].0[ALPHA] = high.0[ALPHA];
        let max_y = max_y.saturating_add(by_y);
        let max_height = max_height.saturating_add(by_height);
        let mut bounds = BoxBounds {
            joints: ends,
            ..BoxBounds::default()
        };
        for (bounds, rates) in bounds.rates.iter_mut().zip(rates) {
            let [x, across, up, spin, turn, _] = rates.map(|rate| rate.0.unsigned_abs());
            // Radians per second, Q28.
            let [turn, spin] =
                [turn, spin].map(|rate| times(rate, QUARTER_PI_Q31.unsigned_abs(), 32));
            let y_rate = Turn::along(table.max_cosine, across, table.max_sine, up)
                .saturating_add(times(max_height, turn, 28));
            let z_rate = Turn::along(table.max_cosine, up, table.max_sine, across)
                .saturating_add(times(max_y, turn, 28));
            bounds[ALPHA] = rates[ALPHA].0.unsigned_abs();
            for ((bound, slope), arm) in bounds.chunks_exact_mut(2).zip(&slopes).zip(arms) {
                let arm = times(arm, spin, 28);
                let v_rate = z_rate.saturating_add(times(arm, tilt.max_sine, 30));
                // Both slides of a pair have one bound.
                bound.fill(
                    x.saturating_add(times(arm, tilt.max_cosine, 30))
                        .saturating_add(times(slope.0, y_rate, 27))
                        .saturating_add(times(slope.1, v_rate, 27))
                        .saturating_add(ROUNDED_RATE),
                );
            }
        }
        Ok(bounds)
    }
}
