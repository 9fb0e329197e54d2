//! Checks of trigonometry, roots and scaling: every documented bound, at all corners and over a
//! large sample.

use crate::Check;
use crate::kinematics::subject::Sequence;
use haptimill_math::root::{Root, hypot, isqrt, reciprocal, sqrt_rounded};
use haptimill_math::scale::{
    high_product, multiply_high, multiply_shift, round_shift, saturate, scale,
};
use haptimill_math::trig::{atan2, sin_cos};
use haptimill_math::{Angle, Coordinate, Length};

/// Number of random samples of a check.
const COUNT: usize = 20_000;

/// The checks of this module.
pub const CHECKS: &[Check] = &[
    Check {
        name: "units::sine_and_cosine_keep_their_bound",
        run: sines,
    },
    Check {
        name: "units::the_arc_tangent_keeps_its_bound",
        run: arc_tangents,
    },
    Check {
        name: "units::roots_are_exact",
        run: roots,
    },
    Check {
        name: "units::reciprocals_keep_their_bound",
        run: reciprocals,
    },
    Check {
        name: "units::scaling_rounds_to_nearest",
        run: scaling,
    },
    Check {
        name: "units::quantities_are_held_at_the_ends_of_their_range",
        run: quantities,
    },
];

/// Corner values of 32-bit arithmetic.
const CORNERS: [i32; 15] = [
    i32::MIN,
    i32::MIN + 1,
    -(1 << 30) - 1,
    -(1 << 30),
    -65_537,
    -2,
    -1,
    0,
    1,
    2,
    65_537,
    1 << 30,
    (1 << 30) + 1,
    i32::MAX - 1,
    i32::MAX,
];

const TURN: f64 = 4_294_967_296.0;

fn sines() {
    let check = |raw: i32| {
        let (sine, cosine) = sin_cos(Angle(raw));
        let angle = f64::from(raw) / TURN * core::f64::consts::TAU;
        let one = f64::from(1 << 30);
        for (got, want) in [(sine, libm::sin(angle)), (cosine, libm::cos(angle))] {
            assert!((f64::from(got) - want * one).abs() <= 1.25, "{raw}: {got}");
            assert!(got.unsigned_abs() <= 1 << 30, "{raw}: {got}");
        }
    };
    // Both ends and the middle of each of the 512 pieces of the circle.
    for piece in 0..512_u32 {
        for offset in [-1, 0, 1, (1 << 22) - 1, 1 << 22] {
            check((piece << 23).wrapping_add_signed(offset) as i32);
        }
    }
    CORNERS.into_iter().for_each(check);
    let mut sequence = Sequence(1);
    (0..COUNT).for_each(|_| check(sequence.next() as i32));
    for (quarter, want) in [
        (0, (0, 1 << 30)),
        (1, (1 << 30, 0)),
        (2, (0, -(1 << 30))),
        (3, (-(1 << 30), 0)),
    ] {
        assert_eq!(sin_cos(Angle(quarter << 30)), want);
    }
}

fn arc_tangents() {
    let check = |y: i32, x: i32| {
        let got = atan2(y, x);
        if (x, y) == (0, 0) {
            assert_eq!(got, Angle(0));
            return;
        }
        let want = libm::atan2(f64::from(y), f64::from(x)) / core::f64::consts::TAU * TURN;
        // The shorter way round: half a turn is its own opposite.
        let off = f64::from(got.0) - want;
        let off = off - libm::round(off / TURN) * TURN;
        assert!(off.abs() <= 1.0, "atan2({y}, {x}) is off by {off}");
    };
    for y in CORNERS {
        for x in CORNERS {
            check(y, x);
        }
    }
    let mut sequence = Sequence(2);
    for _ in 0..COUNT {
        let (y, x) = (sequence.next() as i32, sequence.next() as i32);
        // All ratios, and all magnitudes.
        check(y >> sequence.below(31), x >> sequence.below(31));
    }
}

/// Exact in integers: `whole` is the root if its square does not exceed the number and the square
/// of the next integer does.
fn root(square: u64) {
    let whole = u128::from(isqrt(square));
    assert!(whole * whole <= u128::from(square), "{square}");
    assert!((whole + 1) * (whole + 1) > u128::from(square), "{square}");
    let nearest = i128::from(sqrt_rounded(square));
    // |nearest - root| <= 1/2, doubled and squared.
    let four = 4 * i128::from(square);
    assert!((2 * nearest - 1) * (2 * nearest - 1) <= four || nearest == 0);
    assert!((2 * nearest + 1) * (2 * nearest + 1) >= four || nearest == i128::from(u32::MAX));
    if square == 0 {
        return;
    }
    let exact = libm::sqrt(square as f64);
    let root = Root::of(square);
    if square <= i32::MAX as u64 * i32::MAX as u64 {
        let error = (f64::from(root.rounded()) - exact).abs();
        assert!(error <= 0.5 + exact * libm::exp2(-30.5), "{square}");
    }
    let reciprocal = root.reciprocal();
    let value = f64::from(reciprocal.mantissa) / libm::exp2(f64::from(reciprocal.shift));
    assert!((value * exact - 1.0).abs() < libm::exp2(-29.5), "{square}");
}

fn roots() {
    (0..500).for_each(root);
    for bits in 0..64 {
        for offset in [-3_i64, -2, -1, 0, 1, 2, 3] {
            root((1_u64 << bits).wrapping_add_signed(offset));
        }
    }
    for whole in (0..=u64::from(u32::MAX)).step_by(16_777_259) {
        for offset in -1_i64..=1 {
            root((whole * whole).wrapping_add_signed(offset));
        }
    }
    root(u64::MAX);
    let mut sequence = Sequence(3);
    for _ in 0..COUNT {
        let square = sequence.next();
        root(square >> sequence.below(64));
    }
    for x in CORNERS {
        for y in CORNERS {
            let square = |value: i32| u128::from(value.unsigned_abs()).pow(2);
            let (sum, long) = (square(x) + square(y), u128::from(hypot(x, y)));
            // |long - root| <= 1/2.
            assert!((2 * long + 1).pow(2) >= 4 * sum, "{x} {y}");
            assert!(long == 0 || (2 * long - 1).pow(2) <= 4 * sum, "{x} {y}");
        }
    }
}

fn reciprocals() {
    let check = |value: u32| {
        let exact = libm::exp2(63.0) / f64::from(value);
        let error = f64::from(reciprocal(value)) / exact - 1.0;
        assert!(error.abs() < libm::exp2(-31.0), "{value} {error}");
    };
    // Both ends of every cell of the table.
    for cell in 256_u32..512 {
        for offset in [0, 1, 2, (1 << 23) - 2, (1 << 23) - 1] {
            check((cell << 23) + offset);
        }
    }
    let mut sequence = Sequence(4);
    (0..COUNT).for_each(|_| check(sequence.next() as u32 | 1 << 31));
}

/// Returns the integer nearest to `value / 2^shift`, halves upwards.
fn nearest(value: i128, shift: u32) -> i128 {
    (value + (1 << (shift - 1))) >> shift
}

fn scaling() {
    let check = |a: i32, b: i32, wide: i64, shift: u32| {
        let product = i128::from(a) * i128::from(b);
        assert_eq!(
            i128::from(multiply_shift(a, b, shift)),
            nearest(product, shift),
            "{a} {b} {shift}"
        );
        let wide = wide >> 1;
        assert_eq!(
            i128::from(round_shift(wide, shift)),
            nearest(i128::from(wide), shift),
            "{wide} {shift}"
        );
        let short = shift.min(32);
        // A value whose result fits the type.
        let small = wide >> (33 - short.min(32)).max(1);
        assert_eq!(
            i128::from(scale(small, a, short)),
            nearest(i128::from(small) * i128::from(a), short),
            "{small} {a} {short}"
        );
        let factor = (b as u32).min(1 << 31);
        let exact = (i128::from(wide) * i128::from(factor)) >> 32;
        assert_eq!(
            i128::from(multiply_high(wide, factor)),
            exact,
            "{wide} {factor}"
        );
        let (p, q) = (wide as u64, i64::from(a) as u64);
        let exact = (u128::from(p) * u128::from(q)) >> 64;
        let off = exact - u128::from(high_product(p, q));
        assert!(off < 3, "{p} {q}: off by {off}");
    };
    for a in CORNERS {
        for b in CORNERS {
            for shift in [1, 2, 16, 31, 32, 33, 62] {
                check(a, b, i64::from(a) << 32 | i64::from(b), shift);
            }
        }
    }
    let mut sequence = Sequence(5);
    for _ in 0..COUNT {
        let (a, b) = (sequence.next() as i32, sequence.next() as i32);
        let wide = sequence.next() as i64;
        check(a, b, wide, 1 + sequence.below(62) as u32);
    }
}

fn quantities() {
    let hold = |value: i64| value.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
    for a in CORNERS {
        for b in CORNERS {
            let (wide_a, wide_b) = (i64::from(a), i64::from(b));
            let (x, y) = (Coordinate(a), Coordinate(b));
            assert_eq!(x.saturating_add(y).0, hold(wide_a + wide_b));
            assert_eq!(x.saturating_sub(y).0, hold(wide_a - wide_b));
            assert_eq!(
                x.checked_add(y).map(|sum| i64::from(sum.0)),
                fits(wide_a + wide_b)
            );
            assert_eq!(
                x.checked_sub(y).map(|rest| i64::from(rest.0)),
                fits(wide_a - wide_b)
            );
            assert_eq!(saturate(wide_a * wide_b), hold(wide_a * wide_b));
            assert_eq!(Angle(a).wrapping_add(Angle(b)).0, (wide_a + wide_b) as i32);
        }
        assert_eq!(Coordinate(a).saturating_neg().0, hold(-i64::from(a)));
        assert_eq!(Length::millimetres(a).0, hold(i64::from(a) << 20));
        let exact = f64::from(a) * 1.048_576;
        let got = f64::from(Length::nanometres(a).0);
        let held = exact.clamp(f64::from(i32::MIN), f64::from(i32::MAX));
        assert!((got - held).abs() <= 0.5 + 1e-6, "{a} nm");
    }
}

fn fits(value: i64) -> Option<i64> {
    i32::try_from(value).ok().map(i64::from)
}
