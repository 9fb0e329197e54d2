//! Vectors in a plane that a rotary axis turns: positions, rates, accelerations, and bounds over a
//! range of angles.

use crate::PoseError;
use haptimill_math::scale::{multiply_high, round_shift, scale, total};
use haptimill_math::trig::{ONE, QUARTER_PI_Q31, sin_cos};
use haptimill_math::{Acceleration, Angle, Coordinate, Rate};

/// Raw units of an angle in a radian: 2^32 / 2 pi.
pub(crate) const RADIAN: i64 = 683_565_276;

/// 2 pi, Q28.
pub(crate) const TWO_PI_Q28: i32 = 1_686_629_713;

/// A vector in the plane that a rotary axis turns, with its derivatives: 2^-20 mm, mm/s and 2^-12
/// mm/s^2.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Moving {
    pub(crate) at: [i64; 2],
    pub(crate) rate: [i64; 2],
    pub(crate) push: [i64; 2],
}

/// A vector turned by an angle of this sine and cosine.
#[inline(always)]
pub(crate) fn turned([a, b]: [i64; 2], (sine, cosine): (i32, i32)) -> [i64; 2] {
    [
        total(scale(a, cosine, 30), scale(b, -sine, 30)),
        total(scale(a, sine, 30), scale(b, cosine, 30)),
    ]
}

/// A length per radian as a length per turn.
#[inline(always)]
pub(crate) fn per_turn(lever: i64) -> i64 {
    scale(lever, TWO_PI_Q28, 28)
}

/// Speed of a lever that turns at a rate, and of a speed the acceleration.
#[inline(always)]
pub(crate) fn tangential_rate(lever: i64, rate: Rate) -> i64 {
    scale(per_turn(lever), rate.0, 32)
}

impl Moving {
    /// The vector turned by an angle that moves: with r' = R r, rate R v + w x r', and acceleration
    /// R a + w' x r' + w x (2 R v + w x r').
    #[inline(always)]
    pub(crate) fn turned(self, angle: (i32, i32), rate: Rate, push: Acceleration) -> Self {
        let at = turned(self.at, angle);
        let along = turned(self.rate, angle);
        let [ahead, aside] = at.map(|lever| tangential_rate(lever, rate));
        let speed = [
            total(along[0], aside.wrapping_neg()),
            total(along[1], ahead),
        ];
        // Speeds are below 2^36, accelerations in 2^-20 mm/s^2 below 2^45.
        let [ahead, aside] = [total(speed[0], along[0]), total(speed[1], along[1])]
            .map(|speed| tangential_rate(speed, rate));
        let [spin, spin_aside] = at.map(|lever| scale(per_turn(lever), push.0, 24));
        let along = turned(self.push, angle);
        Self {
            at,
            rate: speed,
            push: [
                total(along[0], -round_shift(total(aside, spin_aside), 8)),
                total(along[1], round_shift(total(ahead, spin), 8)),
            ],
        }
    }
}

/// The coordinates, or the error if one is beyond its range.
#[inline(always)]
pub(crate) fn held([x, y, z]: [i64; 3]) -> Result<[Coordinate; 3], PoseError> {
    let leaves = |value: i64| value ^ value as i32 as i64;
    if leaves(x) | leaves(y) | leaves(z) != 0 {
        return Err(PoseError::Unreachable);
    }
    Ok([x, y, z].map(|value| Coordinate(value as i32)))
}

/// Rounding error of the bound of a length, or of a rate, axis units (per second).
pub(crate) const ROUNDED: i64 = 16;
pub(crate) const ROUNDED_RATE: i64 = 64;

/// A range of angles about its middle: Q30.
pub(crate) struct Turn {
    pub(crate) angle: (i32, i32),
    /// Largest sine, and 1 less the least cosine, of an angle within half the range.
    pub(crate) sine: u32,
    pub(crate) versine: u32,
    /// Bounds of the magnitudes of sine and cosine over the range.
    pub(crate) max_sine: u32,
    pub(crate) max_cosine: u32,
}

/// Box about a vector of a plane.
pub(crate) struct Swept {
    pub(crate) middle: [i64; 2],
    pub(crate) half: [i64; 2],
}

/// Product of a magnitude with a number in Q30 of at most 2, rounded up.
#[inline(always)]
pub(crate) fn share(value: i64, part: u32) -> i64 {
    total(multiply_high(value << 2, part), 1)
}

impl Turn {
    pub(crate) fn of(angle: Angle, half: u32) -> Self {
        let angle = sin_cos(angle);
        // Radians, rounded up.
        let by = ((u64::from(half) * u64::from(QUARTER_PI_Q31.unsigned_abs())) >> 30) + 1;
        let one = ONE.unsigned_abs();
        // Below 2^32, so its square fits.
        let versine = ((by * by) >> 31).min(u64::from(2 * one)) as u32;
        let sine = by.min(u64::from(one)) as u32;
        let (sine, versine) = if half == 0 { (0, 0) } else { (sine, versine) };
        let max = |value: i32| value.unsigned_abs().saturating_add(sine).min(one);
        Self {
            angle,
            sine,
            versine,
            max_sine: max(angle.0),
            max_cosine: max(angle.1),
        }
    }

    /// The box of the vectors of a box, turned by all angles of the range.
    pub(crate) fn swept(&self, middle: [i64; 2], [a, b]: [i64; 2]) -> Swept {
        let middle = turned(middle, self.angle);
        let (sine, cosine) = (self.angle.0.unsigned_abs(), self.angle.1.unsigned_abs());
        let moved = a | b | i64::from(self.sine) != 0;
        let half = [
            total(share(a, cosine), share(b, sine)),
            total(share(a, sine), share(b, cosine)),
        ];
        let max = [
            total(middle[0].abs(), half[0]),
            total(middle[1].abs(), half[1]),
        ];
        let swung =
            |along: i64, aside: i64| total(share(aside, self.sine), share(along, self.versine));
        let half = [
            total(total(half[0], swung(max[0], max[1])), ROUNDED),
            total(total(half[1], swung(max[1], max[0])), ROUNDED),
        ];
        Swept {
            middle,
            half: if moved { half } else { [0; 2] },
        }
    }

    /// Bounds of the speeds of the vectors of a box, which move with these speeds before they are
    /// turned, and turn at this rate.
    pub(crate) fn speeds(&self, swept: &Swept, [a, b]: [i64; 2], rate: u32) -> [i64; 2] {
        let round = |axis: usize| {
            let lever = total(swept.middle[axis].abs(), swept.half[axis]);
            multiply_high(per_turn(lever), rate)
        };
        let along = [
            total(share(a, self.max_cosine), share(b, self.max_sine)),
            total(share(a, self.max_sine), share(b, self.max_cosine)),
        ];
        [
            total(total(along[0], round(1)), ROUNDED_RATE),
            total(total(along[1], round(0)), ROUNDED_RATE),
        ]
    }
}
