//! Rates and accelerations of the H-4 arm's joints, and its Jacobian, by the chain rule without
//! differences.
//!
//! The formulas of [`super`] are differentiated twice along a moving pose. With s, c the sine and
//! cosine of alpha and ' the derivative by time:
//!
//! ```text
//! y'  = (Y' c - Z' s) - alpha' (z + h)            z'  = (Y' s + Z' c) + alpha' y
//! y'' = (Y'' c - Z'' s) - alpha'' (z + h) - 2 alpha' (Y' s + Z' c) - alpha'^2 y
//! z'' = (Y'' s + Z'' c) + alpha'' y + 2 alpha' (Y' c - Z' s) - alpha'^2 (z + h)
//! S'  = -(U U' + V V') / S            S'' = -(U'^2 + V'^2 + S'^2 + U U'' + V V'') / S
//! ```
//!
//! Scales: lengths 2^-20 mm, rates 2^-20 mm/s, accelerations 2^-12 mm/s^2; U / S and V / S are at
//! most 10, in Q27. Angular rates are radians per second in Q30, angular accelerations radians per
//! second squared in Q22. All factors are 32-bit numbers, so a product is one instruction and
//! cannot overflow. A motion too fast for that is calculated at a half, a quarter or an eighth of
//! its speed.
//!
//! Limits: a rate or acceleration of a joint beyond its type saturates (2048 mm/s, 524 m/s^2), far
//! above the capability of a drive.

use super::{ALPHA, AXES, H4, Pair, PoseTerms, THETA};
use crate::planar::TWO_PI_Q28;
use crate::{Accelerations, Jacobian, JointMotion, Rates};
use haptimill_math::root::Reciprocal;
use haptimill_math::scale::{
    multiply_high, multiply_shift, round_shift, scale, shift_right, total,
};
use haptimill_math::trig::QUARTER_PI_Q31;
use haptimill_math::{Acceleration, Rate};

/// U / S and V / S of a pair, Q27, and 1 / S.
pub(super) struct Slope {
    pub(super) u: i32,
    pub(super) v: i32,
    inverse: Reciprocal,
}

impl Slope {
    #[inline]
    pub(super) fn of(pair: &Pair) -> Self {
        // S is 0.1 R to R, so both ratios are at most 10 and fit Q27. S >= 1.6 mm makes the shift
        // 24 or more.
        let inverse = pair.root.reciprocal();
        // A mantissa of 2^31 counts as 2^31 - 1.
        let mantissa = inverse.mantissa.min(i32::MAX as u32) as i32;
        let spare = inverse.shift.wrapping_sub(27 + 31);
        Self {
            u: ratio(pair.u, mantissa, spare),
            v: ratio(pair.v, mantissa, spare),
            inverse,
        }
    }
}

/// A length over S in Q27, from the mantissa of 1 / S; the product has 58 bits of fraction, and
/// `spare`.
#[inline(always)]
const fn ratio(length: i32, mantissa: i32, spare: u32) -> i32 {
    if spare < 32 {
        // S is 64 mm or more: the upper 32 bits of the product suffice. |U| is below 2^30.
        word(length.wrapping_shl(1) as i64 * mantissa as i64, 32).wrapping_shr(spare)
    } else {
        word(length as i64 * mantissa as i64, spare.wrapping_add(31))
    }
}

/// `value / 2^shift` of a result that is known to fit 32 bits.
#[inline(always)]
const fn word(value: i64, shift: u32) -> i32 {
    value.wrapping_shr(shift) as i32
}

/// Bits of linear rates (below 2^28, 256 mm/s) and accelerations (below 2^28, 65 m/s^2) at which
/// every derivative of U and V fits 32 bits. The angular limit depends on the geometry. Faster
/// motions are halved as often as needed.
const QUICK: u32 = 28;

/// Bits of the largest angular rates (2^QUICK_TURN / 2^32 turn/s: 1.57 rad/s) and angular
/// accelerations (402 rad/s^2) that are calculated without halving.
const QUICK_TURN: u32 = 30;

/// Number of bits that angular rates and accelerations may have so that their effect on a `lever`
/// (the longest y and tool, or z + h; 2^-20 mm), plus the linear rates and the products of two
/// rates, is below 2^31.
pub(super) const fn quick_turn(lever: i64) -> u32 {
    let lever = if lever >= 1 << 32 { 1 << 32 } else { lever };
    let mut bits = QUICK_TURN;
    // At 2^27, 0.196 rad/s, 2^32 becomes 8.5e8.
    while bits > 27 {
        // 2^28.5 of two linear coordinates, and 2^26: 2 Z' alpha', y alpha'^2, T theta'^2, all over
        // 2^8.
        let turned = ((lever >> 2) * QUARTER_PI_Q31 as i64) >> (58 - bits);
        if turned + 380_000_000 < (1 << 31) - (1 << 26) {
            break;
        }
        bits -= 1;
    }
    bits
}

/// `value / 2^shift` to nearest, of a result that is known to fit 32 bits.
#[inline(always)]
const fn nearest(value: i64, shift: u32) -> i32 {
    word(value.wrapping_add(1 << (shift - 1)), shift)
}

/// The sum of the products a b and c d: two instructions of a 32-bit processor. Callers must make
/// sure that it fits.
#[inline(always)]
fn sum(a: i32, b: i32, c: i32, d: i32) -> i64 {
    total(a as i64 * b as i64, c as i64 * d as i64)
}

/// S' and S'' from the derivatives of U and V, all 32-bit numbers.
#[inline]
fn root_jet(slope: &Slope, u: (i32, i32), v: (i32, i32)) -> (i64, i64) {
    // Below 2^63: slopes up to 10 in Q27 are 2^30.4 each, times 2^31 at most.
    let first = sum(slope.u, u.0, slope.v, v.0);
    // Squares of rates in 2^-12 mm/s: each below 2^56.
    let coarse = word(first, 35);
    let squares = total(
        sum(u.0 >> 8, u.0 >> 8, v.0 >> 8, v.0 >> 8),
        coarse as i64 * coarse as i64,
    );
    // 2^-24 (mm/s)^2 over 2^-20 mm, to 2^-12 mm/s^2: times 2^8.
    let bent = shift_right(
        multiply_high(squares, slope.inverse.mantissa),
        slope.inverse.shift.wrapping_sub(40),
    );
    let second = total(bent, sum(slope.u, u.1, slope.v, v.1) >> 27);
    ((first >> 27).wrapping_neg(), second.wrapping_neg())
}

/// The magnitude for a value from 0 up, the magnitude minus one below 0.
#[inline(always)]
const fn size(value: i32) -> u32 {
    (value ^ (value >> 31)) as u32
}

/// Bits of the largest magnitude; a negative power of two counts as one bit less.
const fn bits([a, b, c]: [i32; 3]) -> u32 {
    32 - (size(a) | size(b) | size(c)).leading_zeros()
}

/// Rates and accelerations of a pair of slides: the mean of both, and the lead of the first over
/// the mean.
type PairJet = [(i64, i64); 2];

/// Saturates rates and accelerations that exceed 32 bits, and restores those of a slowed motion.
#[cold]
#[inline(never)]
fn hold(jets: &[PairJet; 2], excess: u32, motion: &mut JointMotion) {
    for (index, [middle, ahead]) in jets.iter().enumerate() {
        for (joint, sign) in [(2 * index, 1), (2 * index + 1, -1)] {
            // Below 2^45, and at most 3 and 6 bits more.
            let first = (middle.0 + sign * ahead.0) << excess;
            let second = (middle.1 + sign * ahead.1) << (2 * excess);
            motion.rates[joint] = Rate::saturating_from(first);
            motion.accelerations[joint] = Acceleration::saturating_from(second);
        }
    }
}

impl H4 {
    /// Rates and accelerations of the joints at a solved pose that moves.
    #[inline(always)]
    pub(super) fn derivatives(
        &self,
        terms: &PoseTerms,
        pairs: &[Pair; 2],
        rates: &Rates,
        accelerations: &Accelerations,
        motion: &mut JointMotion,
    ) {
        let [Rate(x), Rate(y), Rate(z), Rate(tilt), Rate(turn), _] = *rates;
        let linear = size(x) | size(y) | size(z);
        let angular = size(tilt) | size(turn);
        let [
            Acceleration(x),
            Acceleration(y),
            Acceleration(z),
            Acceleration(tilt),
            Acceleration(turn),
            _,
        ] = *accelerations;
        let linear = linear | size(x) | size(y) | size(z);
        let angular = angular | size(tilt) | size(turn);
        let excess = if linear >> QUICK | angular.wrapping_shr(self.quick_turn) == 0 {
            0
        } else {
            self.excess(rates, accelerations)
        };
        let slow;
        let (slow_rates, slow_accelerations) = if excess == 0 {
            (rates, accelerations)
        } else {
            slow = (
                rates.map(|rate| Rate(rate.0 >> excess)),
                accelerations.map(|value| Acceleration(value.0 >> (2 * excess))),
            );
            (&slow.0, &slow.1)
        };
        let jets = self.jets(terms, pairs, slow_rates, slow_accelerations);
        // One check for all values that exceed 32 bits.
        let mut beyond = u64::from(excess);
        let mut narrow = |value: i64| {
            beyond |= (value ^ i64::from(value as i32)) as u64;
            value as i32
        };
        let [[middle, ahead], [rear_middle, rear_ahead]] = jets;
        motion.rates = [
            Rate(narrow(total(middle.0, ahead.0))),
            Rate(narrow(total(middle.0, ahead.0.wrapping_neg()))),
            Rate(narrow(total(rear_middle.0, rear_ahead.0))),
            Rate(narrow(total(rear_middle.0, rear_ahead.0.wrapping_neg()))),
            rates[ALPHA],
            Rate::ZERO,
        ];
        motion.accelerations = [
            Acceleration(narrow(total(middle.1, ahead.1))),
            Acceleration(narrow(total(middle.1, ahead.1.wrapping_neg()))),
            Acceleration(narrow(total(rear_middle.1, rear_ahead.1))),
            Acceleration(narrow(total(rear_middle.1, rear_ahead.1.wrapping_neg()))),
            accelerations[ALPHA],
            Acceleration::ZERO,
        ];
        if beyond != 0 {
            hold(&jets, excess, motion);
        }
    }

    /// Number of times a motion must be halved.
    #[cold]
    #[inline(never)]
    fn excess(&self, rates: &Rates, accelerations: &Accelerations) -> u32 {
        let linear = bits([rates[0].0, rates[1].0, rates[2].0]);
        let angular = bits([rates[THETA].0, rates[ALPHA].0, 0]);
        let by_rate = linear
            .saturating_sub(QUICK)
            .max(angular.saturating_sub(self.quick_turn));
        let linear = bits([accelerations[0].0, accelerations[1].0, accelerations[2].0]);
        let angular = bits([accelerations[THETA].0, accelerations[ALPHA].0, 0]);
        let by_acceleration = linear
            .saturating_sub(QUICK)
            .max(angular.saturating_sub(self.quick_turn));
        // Accelerations scale with the square of the time.
        by_rate.max(by_acceleration.div_ceil(2))
    }

    /// Derivatives of both pairs, for motions within [`QUICK`].
    #[inline(always)]
    fn jets(
        &self,
        terms: &PoseTerms,
        pairs: &[Pair; 2],
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> [PairJet; 2] {
        let [Rate(x), Rate(across), Rate(up), Rate(tilt), Rate(turn), _] = *rates;
        let [
            Acceleration(x_push),
            Acceleration(across_push),
            Acceleration(up_push),
            Acceleration(tilt_push),
            Acceleration(turn_push),
            _,
        ] = *accelerations;
        // The factors are 32-bit numbers, so no negation below overflows. Radians: rate * 2 pi /
        // 2^32 in Q30, acceleration * 2 pi / 2^24 in Q22; both are the value times pi / 2.
        let radians = |value: i32| nearest(value as i64 * QUARTER_PI_Q31 as i64, 30);

        // The table. Sums of products in Q30; rates 2^-20 mm/s, accelerations 2^-12 mm/s^2.
        let (sine, cosine) = terms.table;
        let (y, height) = (terms.y as i32, terms.height as i32);
        let (omega, spin) = (radians(turn), radians(turn_push));
        // Q28.
        let bend = word(omega as i64 * omega as i64, 32);
        let y_along = sum(across, cosine, up.wrapping_neg(), sine);
        let z_along = sum(across, sine, up, cosine);
        let y_rate = total(y_along, (height as i64 * omega as i64).wrapping_neg());
        let z_rate = total(z_along, y as i64 * omega as i64);
        // 2 alpha' Z' + alpha'^2 y, with 48 bits: a rate, halved, times Q30, and a length times
        // Q28. The others have 30 more than 2^-12 mm/s^2, which is 42.
        let (y_along, z_along) = (word(y_along, 31), word(z_along, 31));
        let y_push = total(
            total(
                sum(across_push, cosine, up_push.wrapping_neg(), sine),
                (height as i64 * spin as i64).wrapping_neg(),
            ),
            (sum(z_along, omega, y, bend) >> 6).wrapping_neg(),
        );
        let z_push = total(
            total(
                sum(across_push, sine, up_push, cosine),
                y as i64 * spin as i64,
            ),
            sum(y_along, omega, height.wrapping_neg(), bend) >> 6,
        );
        let u = (nearest(y_rate, 30), word(y_push, 30));

        // The tilt: derivatives of sin(theta) and cos(theta), Q30 and Q22, the latter negated.
        let (sine, cosine) = terms.tilt;
        let (omega, spin) = (radians(tilt), radians(tilt_push));
        let bend = word(omega as i64 * omega as i64, 38);
        let sine_rate = nearest(cosine as i64 * omega as i64, 30);
        let drop_rate = nearest(sine as i64 * omega as i64, 30);
        let sine_push = word(sum(cosine, spin, sine.wrapping_neg(), bend), 30);
        let drop_push = word(sum(sine, spin, cosine, bend), 30);

        // U' = -+y', V' = -z' + m sin(theta) theta'. U' enters squared and with U / S, so its sign
        // is applied to U / S.
        let jet = move |pair: &Pair, length: i32, side: i32| -> PairJet {
            let arm = |value: i32| length as i64 * value as i64;
            let v = (
                nearest(total(arm(drop_rate), z_rate.wrapping_neg()), 30),
                word(total(arm(drop_push), z_push.wrapping_neg()), 30),
            );
            let slope = Slope::of(pair);
            let slope = Slope {
                u: slope.u.wrapping_mul(side),
                ..slope
            };
            [
                (
                    total(x as i64, arm(sine_rate) >> 30),
                    total(x_push as i64, arm(sine_push) >> 30),
                ),
                root_jet(&slope, u, v),
            ]
        };
        [
            jet(&pairs[0], self.upper, -1),
            jet(&pairs[1], self.lower, 1),
        ]
    }

    /// The Jacobian in table coordinates: docs/control.md 2.7, chained with the table.
    pub(super) fn slopes(&self, terms: &PoseTerms, pairs: &[Pair; 2]) -> Jacobian {
        let mut rows = Jacobian([[0; crate::MAX_AXES]; crate::MAX_AXES]);
        let (table_sine, table_cosine) = (terms.table.0 as i64, terms.table.1 as i64);
        let (sine, cosine) = terms.tilt;
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
            let table = scale(terms.y, up, 27) - scale(terms.height, across, 27);
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
