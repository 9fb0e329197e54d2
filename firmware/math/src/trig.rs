//! Sine, cosine and arc tangent in integers, without division.
//!
//! | function | result | largest error |
//! | --- | --- | --- |
//! | [`sin_cos`] | Q30 | 1.25 * 2^-30 (1.2e-9) |
//! | [`atan2`] | [`Angle`], 2^-32 turn | 1.0 raw unit (1.5e-9 rad) |
//! | [`unit_angle`] | [`Angle`], 2^-32 turn | 1.25 raw units, with the rounding of its arguments |
//!
//! The bounds include the final rounding and are verified by the tests below. Quarter turns are
//! exact. The compiler computes the tables (0.5 kB for the sine, 2 kB for the arc
//! tangent, 0.7 kB for the arc sine) from the series.
//!
//! Callers must not shift a sine left: 1 in Q30 is 2^30, which fits into `i32`; 1 in Q31 does not.

use super::Angle;
use super::root::reciprocal;
use super::scale::round_shift;

/// One in Q30.
pub const ONE: i32 = 1 << 30;

/// pi in Q60.
const PI_Q60: i128 = 3_622_009_729_038_561_421;

/// pi / 4 in Q31: a product with it, shifted by 31, converts 2^-32 turn to radians in Q29.
pub const QUARTER_PI_Q31: i32 = (PI_Q60 >> 31) as i32;

/// Product of two 32-bit numbers, divided by 2^shift (rounded down), that is known to fit 32 bits.
#[inline]
const fn high_word(a: i32, b: i32, shift: u32) -> i32 {
    ((a as i64 * b as i64) >> shift) as i32
}

/// sin(i * 90 degrees / 128) in Q31, i = 0..=128. The last, 1, saturates at 2^31 - 1; the rounding
/// to Q30 corrects it.
static SINE: [i32; 129] = sines();

const fn sines() -> [i32; 129] {
    let mut table = [0; 129];
    let mut i = 0;
    while i < table.len() {
        let angle = PI_Q60 * i as i128 / 256;
        let square = (angle * angle) >> 60;
        let mut term = angle;
        let mut sum = angle;
        let mut n = 2;
        while n < 30 {
            term = -((term * square) >> 60) / (n * (n + 1));
            sum += term;
            n += 2;
        }
        table[i] = super::scale::saturate(((sum + (1 << 28)) >> 29) as i64);
        i += 1;
    }
    table
}

/// Sine and cosine of an angle, in Q30. Error at most 1.25 * 2^-30; never beyond +-2^30.
///
/// The angle is split into the nearest of 512 points of the circle and a remainder of at most 0.35
/// degrees. The sine and cosine of the remainder are short series; the addition theorem combines
/// both.
#[inline]
#[must_use]
pub const fn sin_cos(angle: Angle) -> (i32, i32) {
    let raw = angle.0 as u32;
    let point = raw.wrapping_add(1 << 22) >> 23;
    let rest = raw.wrapping_sub(point << 23) as i32;
    let index = (point & 127) as usize;
    let (sine, cosine) = (SINE[index], SINE[128 - index]);

    // The remainder in radians, Q38: |rest| <= 2^22 units, so |radians| <= 0.00614, which fits 32
    // bits.
    const TWO_PI_Q28: i64 = (PI_Q60 >> 31) as i64;
    let radians = ((rest as i64 * TWO_PI_Q28 + (1 << 21)) >> 22) as i32;
    // Every factor below is a 32-bit number, so every product is one instruction and cannot
    // overflow.
    let square = high_word(radians, radians, 38);
    // r - r^3 / 6 (the next term is 7e-14) and r^2 / 2 - r^4 / 24 (the next is 7e-17).
    let small_sine = radians - high_word(high_word(radians, square, 38), 10_923, 16);
    let small_versine = (square >> 1) - high_word(high_word(square, square, 38), 171, 12);

    let sine_up = cosine as i64 * small_sine as i64 - sine as i64 * small_versine as i64;
    let cosine_down = sine as i64 * small_sine as i64 + cosine as i64 * small_versine as i64;
    // The sums are below 2^31 (the rounding to Q30 absorbs 1 in Q31 and its error); 64-bit numbers
    // need no check.
    let sine = ((sine as i64 + ((sine_up + (1 << 37)) >> 38) + 1) >> 1) as i32;
    let cosine = ((cosine as i64 - ((cosine_down + (1 << 37)) >> 38) + 1) >> 1) as i32;

    // Quarter turns swap and negate, with masks instead of branches: the sign of a pose's angles is
    // unpredictable.
    let quarter = (point >> 7) as i32;
    let swap = (sine ^ cosine) & -(quarter & 1);
    (
        negate_if(sine ^ swap, (quarter >> 1) & 1),
        negate_if(cosine ^ swap, ((quarter + 1) >> 1) & 1),
    )
}

/// `-value` if `condition` is 1, `value` if it is 0, without a branch. `i32::MIN` stays `i32::MIN`.
#[inline]
const fn negate_if(value: i32, condition: i32) -> i32 {
    (value ^ -condition).wrapping_add(condition)
}

/// Coefficients of the cubic for atan(c + x) about c = i / 128, in turns.
struct ArcTangent {
    /// atan(c), 2^-34 turn.
    value: u32,
    /// 1 / (1 + c^2) / 2 pi, Q33.
    slope: i32,
    /// Second coefficient of the series, Q33.
    bend: i32,
    /// Third coefficient of the series, Q33.
    third: i32,
}

/// The cubics for c = i / 128, i = 0..=128.
static ARC_TANGENT: [ArcTangent; 129] = arc_tangents();

const fn arc_tangents() -> [ArcTangent; 129] {
    const ONE: i128 = 1 << 60;
    let mut table = [const {
        ArcTangent {
            value: 0,
            slope: 0,
            bend: 0,
            third: 0,
        }
    }; 129];
    let mut value: i128 = 0;
    let mut i = 0;
    while i < table.len() {
        let c = ONE * i as i128 / 128;
        let w = ONE * 128 * 128 / (128 * 128 + (i * i) as i128);
        let w2 = (w * w) >> 60;
        let w3 = (w2 * w) >> 60;
        let c2 = (c * c) >> 60;
        // Q60 in radians to Q33 in turns: divide by 2 pi and by 2^27.
        table[i] = ArcTangent {
            value: (((value << 34) / PI_Q60 + 1) >> 1) as u32,
            slope: (((w << 33) / PI_Q60 + 1) >> 1) as i32,
            bend: ((-((c * w2) >> 60) << 32) / PI_Q60) as i32,
            third: (((w3 * (c2 - ONE / 3)) >> 60 << 32) / PI_Q60) as i32,
        };
        // atan((i + 1) / 128) - atan(i / 128) = atan(128 / (128^2 + i (i + 1))), a small argument
        // with a short series.
        let step = ONE * 128 / (128 * 128 + (i * (i + 1)) as i128);
        let square = (step * step) >> 60;
        let mut power = step;
        let mut n = 1;
        let mut sign = 1;
        while n < 12 {
            value += sign * power / n;
            power = (power * square) >> 60;
            sign = -sign;
            n += 2;
        }
        i += 1;
    }
    table
}

/// Angle of the point (x, y), measured from the x axis, for any two `i32`. Error at most 1.0 raw
/// unit; (0, 0) gives 0.
///
/// The half turn is always [`Angle::HALF`], from both sides.
#[inline]
#[must_use]
pub const fn atan2(y: i32, x: i32) -> Angle {
    let (abs_x, abs_y) = (x.unsigned_abs(), y.unsigned_abs());
    let steep = abs_y > abs_x;
    let swap = (abs_x ^ abs_y) & (steep as u32).wrapping_neg();
    let (short, long) = (abs_y ^ swap, abs_x ^ swap);
    // 0 / 0 becomes 0 / 1.
    let zeros = (long | 1).leading_zeros();
    let long = (long | (long == 0) as u32) << zeros;
    let short = short << zeros;

    // short / long in Q32, at most 1.
    let ratio = (short as u64 * reciprocal(long) as u64 + (1 << 30)) >> 31;
    let index = (ratio + (1 << 24)) >> 25;
    let rest = ratio.wrapping_sub(index << 25) as i32;
    let cubic = &ARC_TANGENT[if index < 128 { index as usize } else { 128 }];
    let third = cubic.bend.wrapping_add(high_word(cubic.third, rest, 32));
    let second = cubic.slope.wrapping_add(high_word(third, rest, 32));
    let turn = cubic.value as i64 + ((second as i64 * rest as i64 + (1 << 30)) >> 31);
    let eighth = round_shift(turn, 2) as i32;

    octant(eighth, steep, x, y)
}

/// An angle whose sine is i / 128.
struct ArcSine {
    /// The angle, 2^-34 turn.
    value: u32,
    /// Its cosine, Q31.
    cosine: u32,
}

/// The arc sines of i / 128, from 0 to an eighth of a turn and the half step beyond it.
static ARC_SINE: [ArcSine; 92] = arc_sines();

const fn arc_sines() -> [ArcSine; 92] {
    const fn cosine(i: i128) -> i128 {
        // sqrt(1 - (i / 128)^2) in Q60, as the root of a number of 120 bits.
        (((128 * 128 - i * i) as u128) << 106).isqrt() as i128
    }
    let mut table = [const {
        ArcSine {
            value: 0,
            cosine: 0,
        }
    }; 92];
    let mut value: i128 = 0;
    let mut i = 0;
    while i < table.len() {
        let here = cosine(i as i128);
        table[i] = ArcSine {
            value: (((value << 34) / PI_Q60 + 1) >> 1) as u32,
            cosine: ((here + (1 << 28)) >> 29) as u32,
        };
        // sin(a - b) of neighbours is small: a short series of the arc sine.
        let n = i as i128;
        let step = ((n + 1) * here - n * cosine(n + 1)) / 128;
        let square = (step * step) >> 60;
        let mut term = step;
        let mut k = 1;
        while k < 14 {
            value += term / k;
            term = ((term * square) >> 60) * k / (k + 1);
            k += 2;
        }
        i += 1;
    }
    table
}

/// Angle of a point on the unit circle, from its sine and cosine in Q30. Unlike [`atan2`] it needs
/// no reciprocal.
///
/// Error at most 1.25 raw units where sine and cosine are those of an angle, rounded to their unit.
/// The result for a vector of another length is not an angle of it.
#[inline]
#[must_use]
pub const fn unit_angle(sine: i32, cosine: i32) -> Angle {
    let (abs_x, abs_y) = (cosine.unsigned_abs(), sine.unsigned_abs());
    let steep = abs_y > abs_x;
    let swap = (abs_x ^ abs_y) & (steep as u32).wrapping_neg();
    let (short, long) = (abs_y ^ swap, abs_x ^ swap);

    // The nearest i / 128, and the sine of the remainder by the addition theorem, Q38.
    let index = short.wrapping_add(1 << 22) >> 23;
    let point = &ARC_SINE[if index < 91 { index as usize } else { 91 }];
    let rest = (short as u64)
        .wrapping_mul(point.cosine as u64)
        .wrapping_sub((long as u64).wrapping_mul(index as u64) << 24) as i64
        >> 23;
    let rest = rest as i32;
    // r + r^3 / 6 (the next term is 4e-13), then 2^-34 turn.
    let radians = rest.wrapping_add(high_word(
        high_word(high_word(rest, rest, 38), rest, 38),
        10_923,
        16,
    ));
    const PER_RADIAN: i64 = ((1 << 93) / PI_Q60) as i64;
    let turn = point.value as i64 + ((radians as i64 * PER_RADIAN + (1 << 37)) >> 38);
    octant(round_shift(turn, 2) as i32, steep, cosine, sine)
}

/// The angle of (x, y) from its angle within an eighth of a turn, without branches: a quarter turn
/// minus the angle, a half turn minus the angle, the negative angle.
#[inline(always)]
const fn octant(eighth: i32, steep: bool, x: i32, y: i32) -> Angle {
    let steep = steep as i32;
    let quadrant = negate_if(eighth, steep).wrapping_add(steep << 30);
    let left = (x < 0) as i32;
    let half = negate_if(quadrant, left).wrapping_add(left << 31);
    Angle(negate_if(half, (y < 0) as i32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    const TURN: f64 = 4_294_967_296.0;
    const RADIANS: f64 = 2.0 * core::f64::consts::PI / TURN;

    /// Largest error of sine and cosine at an angle, in units of 2^-30.
    fn sine_error(raw: i32) -> f64 {
        let (sine, cosine) = sin_cos(Angle(raw));
        let angle = raw as f64 * RADIANS;
        let one = ONE as f64;
        assert!(sine.abs() <= ONE && cosine.abs() <= ONE);
        f64::max(
            (sine as f64 - one * libm::sin(angle)).abs(),
            (cosine as f64 - one * libm::cos(angle)).abs(),
        )
    }

    /// Error of the arc tangent in raw units, around the turn.
    fn arc_error(y: i32, x: i32) -> f64 {
        let exact = libm::atan2(y as f64, x as f64) / RADIANS;
        let error = atan2(y, x).0 as f64 - exact;
        (error - TURN * libm::round(error / TURN)).abs()
    }

    #[test]
    fn the_angle_of_a_unit_vector_keeps_its_bound() {
        let one = ONE as f64;
        let mut worst: f64 = 0.0;
        let mut check = |angle: f64| {
            let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
            let round = |value: f64| libm::round(one * value) as i32;
            let exact = angle / RADIANS;
            let error = unit_angle(round(sine), round(cosine)).0 as f64 - exact;
            worst = worst.max((error - TURN * libm::round(error / TURN)).abs());
        };
        for step in 0..1_000_003 {
            check(step as f64 * (2.0 * core::f64::consts::PI / 1_000_003.0));
        }
        // Both sides of every seam of the table, in every octant.
        for seam in 0..=182 {
            let angle = libm::asin((seam as f64 / 256.0).min(core::f64::consts::FRAC_1_SQRT_2));
            for octant in 0..4 {
                for offset in -3..=3 {
                    let quarter = octant as f64 * core::f64::consts::FRAC_PI_2;
                    let near = offset as f64 * 1e-9;
                    check(quarter + angle + near);
                    check(quarter - angle + near);
                }
            }
        }
        assert!(worst <= 1.25, "{worst}");
    }

    #[test]
    fn quarter_turns_are_exact() {
        for (sine, cosine) in [(0, ONE), (ONE, 0), (0, -ONE), (-ONE, 0)] {
            assert_eq!(unit_angle(sine, cosine), atan2(sine, cosine));
        }
        assert_eq!(sin_cos(Angle::ZERO), (0, ONE));
        assert_eq!(sin_cos(Angle::QUARTER), (ONE, 0));
        assert_eq!(sin_cos(Angle::HALF), (0, -ONE));
        assert_eq!(sin_cos(Angle::QUARTER.wrapping_neg()), (-ONE, 0));
        for size in [1, 2, 3, 1000, i32::MAX] {
            assert_eq!(atan2(0, size), Angle::ZERO);
            assert_eq!(atan2(size, 0), Angle::QUARTER);
            assert_eq!(atan2(0, -size), Angle::HALF);
            assert_eq!(atan2(-size, 0), Angle::QUARTER.wrapping_neg());
            assert_eq!(atan2(size, size), Angle(1 << 29));
            assert_eq!(atan2(-size, size), Angle(-1 << 29));
            assert_eq!(atan2(size, -size), Angle(3 << 29));
        }
        assert_eq!(atan2(i32::MIN, i32::MIN), Angle(-(3 << 29)));
        assert_eq!(atan2(i32::MIN, i32::MAX), Angle(-1 << 29));
        assert_eq!(atan2(0, 0), Angle::ZERO);
    }

    #[test]
    fn sine_and_cosine_keep_their_bound_over_the_turn() {
        let mut worst: f64 = 0.0;
        // A prime step visits every residue of the rest and every point of the table.
        let mut raw = i32::MIN as i64;
        while raw <= i32::MAX as i64 {
            worst = worst.max(sine_error(raw as i32));
            raw += 2003;
        }
        // The seams between two points of the table, densely.
        for point in 0..512u32 {
            let seam = (point << 23).wrapping_add(1 << 22);
            for offset in -40i32..40 {
                worst = worst.max(sine_error(seam.wrapping_add_signed(offset) as i32));
                worst = worst.max(sine_error((point << 23).wrapping_add_signed(offset) as i32));
            }
        }
        assert!(worst <= 1.25, "{worst}");
    }

    #[test]
    fn arc_tangent_keeps_its_bound() {
        let mut worst: f64 = 0.0;
        // Around the circle at several radii.
        for radius in [2e9, 4.2e8, 1e6] {
            for step in 0..400_000 {
                let angle = step as f64 * (2.0 * core::f64::consts::PI / 400_000.0);
                let y = libm::round(radius * libm::sin(angle)) as i32;
                let x = libm::round(radius * libm::cos(angle)) as i32;
                worst = worst.max(arc_error(y, x));
            }
        }
        // Both sides of every seam of the table, and every cell of the reciprocal.
        for seam in 0..=256i64 {
            for offset in -3i64..=3 {
                let x = 0x7fff_ff00i64;
                let y = (x * seam) / 256 + offset;
                worst = worst.max(arc_error(y as i32, x as i32));
                worst = worst.max(arc_error(x as i32, -y as i32));
                let x = (256 + seam) << 22;
                let x = (x + offset).min(i32::MAX as i64);
                worst = worst.max(arc_error((x - 1 - seam * 1000) as i32, x as i32));
            }
        }
        let corners = [
            i32::MIN,
            i32::MIN + 1,
            -2,
            -1,
            0,
            1,
            2,
            3,
            i32::MAX - 1,
            i32::MAX,
        ];
        for y in corners {
            for x in corners {
                worst = worst.max(arc_error(y, x));
            }
        }
        for y in -300..300 {
            for x in -300..300 {
                worst = worst.max(arc_error(y, x));
            }
        }
        assert!(worst <= 1.0, "{worst}");
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: 200_000,
            rng_seed: RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]

        #[test]
        fn any_angle(raw: i32) {
            prop_assert!(sine_error(raw) <= 1.25);
        }

        #[test]
        fn any_numbers_have_an_angle(sine: i32, cosine: i32) {
            let _ = unit_angle(sine, cosine);
        }

        #[test]
        fn any_point(y: i32, x: i32, small_y in 0u32..31, small_x in 0u32..31) {
            prop_assert!(arc_error(y >> small_y, x >> small_x) <= 1.0);
        }
    }
}
