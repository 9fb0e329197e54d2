//! Rates and accelerations of the H-4 arm's joints, and its Jacobian: the chain rule, never a difference.
//!
//! The formulas of [`super::h4`] are differentiated twice along a moving pose. With s, c the sine and cosine of alpha and ' the derivative by time:
//!
//! ```text
//! y'  = (Y' c - Z' s) - alpha' (z + h)            z'  = (Y' s + Z' c) + alpha' y
//! y'' = (Y'' c - Z'' s) - alpha'' (z + h) - 2 alpha' (Y' s + Z' c) - alpha'^2 y
//! z'' = (Y'' s + Z'' c) + alpha'' y + 2 alpha' (Y' c - Z' s) - alpha'^2 (z + h)
//! S'  = -(U U' + V V') / S            S'' = -(U'^2 + V'^2 + S'^2 + U U'' + V V'') / S
//! ```
//!
//! Scales: lengths 2^-20 mm, rates 2^-20 mm/s, accelerations 2^-12 mm/s^2, all in `i64` because a sum of what fits an `i32` need not; U / S and V / S
//! are at most 10, in Q27. Angular rates are radians per second in Q29 (at most pi), angular accelerations radians per second squared in Q21
//! (at most 814).
//!
//! Limits: a joint's rate or acceleration that leaves its type is held at its end (2048 mm/s, 524 m/s^2), far above what a drive does.

use super::h4::{ALPHA, AXES, H4, Pair, Placed, THETA};
use super::{Accelerations, Jacobian, Rates};
use crate::units::root::Reciprocal;
use crate::units::scale::{multiply_high, multiply_shift, round_shift, scale};
use crate::units::trig::QUARTER_PI_Q31;
use crate::units::{Acceleration, Rate};

/// 2 pi in Q28.
const TWO_PI_Q28: i32 = QUARTER_PI_Q31;

/// U / S and V / S of a pair, Q27, and 1 / S.
struct Slope {
    u: i32,
    v: i32,
    inverse: Reciprocal,
}

impl Slope {
    #[inline]
    fn of(pair: &Pair) -> Self {
        // S is 0.1 R to R, so both ratios are at most 10 and fit Q27. S >= 1.6 mm makes the shift 24 or more.
        let inverse = pair.root.reciprocal();
        let ratio = |length: i32| {
            round_shift(length as i64 * inverse.mantissa as i64, inverse.shift - 27) as i32
        };
        Self {
            u: ratio(pair.u),
            v: ratio(pair.v),
            inverse,
        }
    }
}

/// First and second derivative by time: a rate and an acceleration.
#[derive(Clone, Copy)]
struct Jet {
    first: i64,
    second: i64,
}

/// S' and S'' from the derivatives of U and V.
#[inline]
fn root_jet(slope: &Slope, u: Jet, v: Jet) -> Jet {
    // |U'|, |V'| < 2^35, so |S'| < 2^39.4.
    let first = -(scale(u.first, slope.u, 27) + scale(v.first, slope.v, 27));
    // Squares of rates in 2^-12 mm/s: their sum stays below 2^63.
    let squares = [u.first, v.first, first].map(|rate| {
        let coarse = round_shift(rate, 8);
        coarse * coarse
    });
    let sum = squares[0] + squares[1] + squares[2];
    // 2^-24 (mm/s)^2 over 2^-20 mm, to 2^-12 mm/s^2: times 2^8.
    let bent = round_shift(
        multiply_high(sum, slope.inverse.mantissa),
        slope.inverse.shift - 40,
    );
    let second = -(bent + scale(u.second, slope.u, 27) + scale(v.second, slope.v, 27));
    Jet { first, second }
}

impl H4 {
    /// Rates and accelerations of the joints at a placed pose that moves.
    pub(super) fn derivatives(
        &self,
        placed: &Placed,
        pairs: &[Pair; 2],
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> (Rates, Accelerations) {
        let rate = |axis: usize| rates.get(axis).map_or(0, |rate| rate.0);
        let acceleration = |axis: usize| {
            accelerations
                .get(axis)
                .map_or(0, |acceleration| acceleration.0)
        };
        // Radians: rate * 2 pi / 2^32 in Q29, acceleration * 2 pi / 2^24 in Q21; squares of rates in Q27 (at most pi^2).
        let omega = |axis| multiply_shift(rate(axis), QUARTER_PI_Q31, 31) as i32;
        let spin = |axis| multiply_shift(acceleration(axis), QUARTER_PI_Q31, 31);

        // The table.
        let (sine, cosine) = (placed.table.0 as i64, placed.table.1 as i64);
        let turn = |across: i32, up: i32| {
            let (across, up) = (across as i64, up as i64);
            (
                round_shift(across * cosine - up * sine, 30),
                round_shift(across * sine + up * cosine, 30),
            )
        };
        let (y, height) = (placed.y, placed.height);
        let alpha = omega(ALPHA);
        let alpha_square = multiply_shift(alpha, alpha, 31) as i32;
        let alpha_spin = spin(ALPHA) as i32;
        let (y_rate, z_rate) = turn(rate(1), rate(2));
        let (y_acceleration, z_acceleration) = turn(acceleration(1), acceleration(2));
        // scale() takes shifts up to 32: the products below are brought from Q29 2^-20 to 2^-12 by shifts of 28 + 8.
        let across = Jet {
            first: y_rate - scale(height, alpha, 29),
            second: y_acceleration
                - scale(height, alpha_spin, 29)
                - round_shift(scale(z_rate, alpha, 28), 8)
                - round_shift(scale(y, alpha_square, 27), 8),
        };
        let up = Jet {
            first: z_rate + scale(y, alpha, 29),
            second: z_acceleration
                + scale(y, alpha_spin, 29)
                + round_shift(scale(y_rate, alpha, 28), 8)
                - round_shift(scale(height, alpha_square, 27), 8),
        };

        // The tilt: derivatives of sin(theta) and cos(theta), Q29 and Q21.
        let theta = omega(THETA);
        let theta_square = multiply_shift(theta, theta, 31);
        let theta_spin = spin(THETA);
        let (sine, cosine) = (placed.tilt.0 as i64, placed.tilt.1 as i64);
        let sine_jet = (
            round_shift(cosine * theta as i64, 30) as i32,
            (round_shift(cosine * theta_spin, 30) - round_shift(sine * theta_square, 36)) as i32,
        );
        let cosine_jet = (
            -round_shift(sine * theta as i64, 30) as i32,
            -(round_shift(sine * theta_spin, 30) + round_shift(cosine * theta_square, 36)) as i32,
        );
        let arm = |length: i32, jet: (i32, i32)| Jet {
            first: multiply_shift(length, jet.0, 29),
            second: multiply_shift(length, jet.1, 29),
        };

        let mut out_rates = Rates::default();
        let mut out_accelerations = Accelerations::default();
        let slides = [(self.upper, 1), (self.lower, -1)];
        let outputs = out_rates
            .chunks_exact_mut(2)
            .zip(out_accelerations.chunks_exact_mut(2));
        for (((length, side), pair), (rates, accelerations)) in
            slides.into_iter().zip(pairs).zip(outputs)
        {
            let along = arm(length, sine_jet);
            let drop = arm(length, cosine_jet);
            let u = Jet {
                first: -side * across.first,
                second: -side * across.second,
            };
            let v = Jet {
                first: -up.first - drop.first,
                second: -up.second - drop.second,
            };
            let root = root_jet(&Slope::of(pair), u, v);
            let middle = Jet {
                first: rate(0) as i64 + along.first,
                second: acceleration(0) as i64 + along.second,
            };
            for ((rate, acceleration), sign) in rates.iter_mut().zip(accelerations).zip([1, -1]) {
                *rate = Rate::saturating_from(middle.first + sign * root.first);
                *acceleration = Acceleration::saturating_from(middle.second + sign * root.second);
            }
        }
        if let (Some(to), Some(from)) = (out_rates.get_mut(ALPHA), rates.get(ALPHA)) {
            *to = *from;
        }
        if let (Some(to), Some(from)) = (out_accelerations.get_mut(ALPHA), accelerations.get(ALPHA))
        {
            *to = *from;
        }
        (out_rates, out_accelerations)
    }

    /// The Jacobian in table coordinates: spec h4-milling 2.7, chained with the table.
    pub(super) fn slopes(&self, placed: &Placed, pairs: &[Pair; 2]) -> Jacobian {
        let mut rows = Jacobian([[0; super::MAX_AXES]; super::MAX_AXES]);
        let (table_sine, table_cosine) = (placed.table.0 as i64, placed.table.1 as i64);
        let (sine, cosine) = placed.tilt;
        let one = 1i64 << 32;
        // Lengths per radian, 2^-20 mm, to 2^-20 mm per 2^-32 turn in Q32: times 2 pi.
        let per_turn = |length: i64| scale(length, TWO_PI_Q28, 28);
        let sides = [
            (self.upper, 1, 1),
            (self.upper, 1, -1),
            (self.lower, -1, 1),
            (self.lower, -1, -1),
        ];
        let slopes = [Slope::of(&pairs[0]), Slope::of(&pairs[1])];
        for (i, (row, (length, side, sign))) in rows.0.iter_mut().zip(sides).enumerate() {
            let slope = &slopes[i / 2];
            // dl/dy and dl/dz, Q27.
            let across = sign * side * slope.u;
            let up = sign * slope.v;
            let tilt = multiply_shift(length, cosine, 30)
                - scale(multiply_shift(length, sine, 30), up, 27);
            let table = scale(placed.y, up, 27) - scale(placed.height, across, 27);
            *row = [
                one,
                // Q27 * Q30 to Q32.
                round_shift(across as i64 * table_cosine + up as i64 * table_sine, 25),
                round_shift(up as i64 * table_cosine - across as i64 * table_sine, 25),
                per_turn(tilt),
                per_turn(table),
                0,
            ];
        }
        rows.0[AXES - 1][ALPHA] = one;
        rows
    }
}
