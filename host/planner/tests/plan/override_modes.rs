//! Override modes of the spans: the limits hold at the largest factor that a span allows, also on
//! what the motion reaches while the controller brakes.

use crate::h4::{H4, HOME, settings};
use crate::properties::{contour, plan, polyline};
use crate::spans::{Span, spans, unit};
use haptimill_gcode::{Options, Step, read};
use haptimill_planner::{Plan, Settings};
use haptimill_protocol::message::{Action, OverrideMode};
use proptest::prelude::*;

/// The override mode of each span.
fn modes(plan: &Plan) -> Vec<OverrideMode> {
    let mut mode = OverrideMode::FEED;
    let of_span = plan.setpoints.iter().map(|setpoint| {
        let before = mode;
        if let Action::OverrideMode(next) = setpoint.action {
            mode = next;
        }
        before
    });
    of_span.collect()
}

fn ends_at_rest(span: &Span) -> bool {
    span.axes.iter().all(|cubic| cubic.v[1] == 0.0)
}

/// Time on the path in which the controller changes the speed factor from a factor, by a
/// difference.
fn braking(settings: &Settings, factor: f64, change: f64) -> f64 {
    let [slope, ramp] = settings.braking_s;
    factor * (change * slope + 2.0 * ramp)
}

/// Checks the limits of the pose at a factor of the speed.
fn check_limits(span: &Span, settings: &Settings, factor: f64, text: &str) {
    for (k, (cubic, axis)) in span.axes.iter().zip(&settings.pose).enumerate() {
        let t = cubic.t;
        // Rounding to units, as in the test of the limits at the programmed speed.
        let (step, rate) = (unit(k), 128.0 * unit(k));
        let [a, b] = cubic.acceleration();
        let largest = [
            (cubic.peak_rate(), rate + step / t, axis.rate),
            (
                a.abs().max(b.abs()),
                6.0 * step / (t * t) + 6.0 * rate / t,
                axis.acceleration,
            ),
            (
                cubic.jerk().abs(),
                12.0 * step / (t * t * t) + 12.0 * rate / (t * t),
                axis.jerk,
            ),
        ];
        for (order, (value, rounding, limit)) in (1..).zip(largest) {
            let scaled = (value - rounding) * factor.powi(order);
            assert!(
                scaled <= limit * (1.0 + 1e-9),
                "derivative {order} of {k} is {scaled}, limit {limit}, at {factor}\n{text}"
            );
        }
    }
}

/// Checks every span, and all that follow it within the braking time; returns the number of spans
/// that allow more than the programmed speed.
fn check(text: &str) -> usize {
    let settings = settings();
    let (_, plan) = plan(text, &settings);
    let (spans, modes) = (spans(&plan), modes(&plan));
    let end = |span: &Span| span.start + span.axes[0].t;
    let mut fast = 0;
    for (index, (span, mode)) in spans.iter().zip(&modes).enumerate() {
        let factor = f64::from(mode.max_percent()) / 100.0;
        fast += usize::from(factor > 1.0);
        let (change, kinds): (f64, &[OverrideMode]) = match *mode {
            OverrideMode::RAPID => (1.0, &[OverrideMode::RAPID, OverrideMode::FEED_AND_RAPID]),
            _ => (factor - 1.0, &[]),
        };
        let horizon = end(span) + braking(&settings, factor, change) - 1e-9;
        for (ahead, next) in spans[index..].iter().zip(&modes[index..]) {
            if ahead.start >= horizon {
                break;
            }
            check_limits(ahead, &settings, factor, text);
            assert!(kinds.is_empty() || kinds.contains(next), "{next:?}\n{text}");
            if ends_at_rest(ahead) {
                break;
            }
        }
    }
    fast
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn limits_hold_at_the_largest_factor_of_polylines(text in polyline()) {
        check(&text);
    }

    #[test]
    fn limits_hold_at_the_largest_factor_of_contours(text in contour()) {
        check(&text);
    }
}

#[test]
fn a_slow_line_or_arc_may_be_faster_and_a_fast_one_not() {
    let cases = [
        ("G1 X40 F600", 200),
        ("G1 X40 F1900", 175),
        ("G1 X40 F3400", 100),
        ("G1 X1 F600", 100),
        ("G2 X40 I20 F300", 200),
    ];
    for (block, max) in cases {
        let text = format!("G0 X0 Y0 Z30\nG4 P0.1\n{block}\n");
        check(&text);
        let (_, plan) = plan(&text, &settings());
        let fastest = modes(&plan).iter().map(|mode| mode.max_percent()).max();
        assert_eq!(fastest, Some(max), "{block}");
    }
}

/// Small corners of a chain of short blocks: the roundings leave room, too.
#[test]
fn a_polygon_of_short_blocks_may_be_faster() {
    let mut text = String::from("G0 X30 Y0 Z30\nG64 P0.02\nG1 F200\n");
    for step in 1..=720 {
        let angle = f64::from(step).to_radians();
        text += &format!("X{:.4} Y{:.4}\n", 30.0 * angle.cos(), 30.0 * angle.sin());
    }
    assert!(check(&text) > 100);
}

#[test]
fn rapid_moves_and_moves_at_feed_are_told_apart() {
    let text =
        "G0 X20 Y0 Z30\nG4 P0.1\nG1 X-20 F300\nG0 X-40\nM3 S500\nG1 X-20\nG0 X0\nM5\nG0 X1\n";
    check(text);
    let program = read(
        "test.ngc",
        text.as_bytes(),
        &Options::of_letters("XYZBA", HOME),
    )
    .expect("read");
    let plan = Plan::new(&program, &settings(), &H4).expect("planned");
    let moves = program.steps.iter().filter_map(|step| match step {
        Step::Move(step) => Some((step.place.line, step.feed == haptimill_gcode::Feed::Rapid)),
        _ => None,
    });
    let kinds: std::collections::BTreeMap<u32, bool> = moves.collect();
    let mut seen = std::collections::BTreeSet::new();
    for (index, (mode, span)) in modes(&plan).iter().zip(spans(&plan)).enumerate() {
        if span.axes.iter().all(|cubic| cubic.p[0] == cubic.p[1]) {
            continue;
        }
        let line = plan.line_of(index);
        let is_rapid = kinds[&line];
        // The first span of the program has no setpoint before it.
        if index > 0 && *mode != OverrideMode::FEED_AND_RAPID {
            assert_eq!(
                *mode == OverrideMode::RAPID,
                is_rapid,
                "line {line}, setpoint {index}"
            );
            seen.insert((line, is_rapid));
        }
    }
    assert!(seen.len() >= 5, "{seen:?}");
}

/// Moves without overrides have the fixed override mode over their whole path, and begin and end at
/// standstill, where the speed factor changes at once.
#[test]
fn moves_without_overrides_are_fixed_from_standstill_to_standstill() {
    let text = "G64 P0.1 F900\nG1 X5\nX10 Y4\nM49\nX15\nX20 Y8\nG0 X22\nG4 P0.1\nG1 X25\nM48\nX30 Y2\n\
                X33\nM49\nX36 Y5\nX38\n";
    let (program, plan) = plan(text, &settings());
    let fixed: std::collections::BTreeSet<u32> = (program.steps.iter())
        .filter_map(|step| match step {
            Step::Move(step) => step.fixed.then_some(step.place.line),
            _ => None,
        })
        .collect();
    assert_eq!(fixed.iter().copied().collect::<Vec<_>>(), [5, 6, 9, 14, 15]);
    let (mut seen, mut changes) = (std::collections::BTreeSet::new(), 0);
    let all = spans(&plan);
    for (index, (mode, span)) in modes(&plan).iter().zip(&all).enumerate() {
        let is_fixed = fixed.contains(&plan.line_of(index));
        if span.axes.iter().all(|cubic| cubic.p[0] == cubic.p[1]) {
            continue;
        }
        assert_eq!(
            *mode == OverrideMode::FIXED,
            is_fixed,
            "line {}",
            plan.line_of(index)
        );
        if is_fixed {
            seen.insert(plan.line_of(index));
        }
        let before = index.checked_sub(1).map(|before| plan.line_of(before));
        if before.is_some_and(|before| fixed.contains(&before) != is_fixed) {
            changes += 1;
            assert!(
                ends_at_rest(&all[index - 1]),
                "line {}",
                plan.line_of(index)
            );
        }
    }
    assert_eq!((seen, changes), (fixed, 5));
}
