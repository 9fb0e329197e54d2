//! Step pulses against overflow accumulators (DDA) and dual-modulus division.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002, section 3.1.3: a
//! time base of 1 MHz, for each axis an accumulator that overflows at a step of 0.005 mm, and
//! N_total = N P + A for the division of the time base.

use haptimill_firmware::config::AxisKind;
use haptimill_firmware::joint::step_gen::{PulseTiming, StepPlanner};
use haptimill_math::{Coordinate, Rate};

/// Feed, mm/s.
const FEED: f64 = 5.0;
/// Ticks of the thesis's time base per second.
const BASE: u64 = 1_000_000;
/// Axis units per mm.
const UNITS: f64 = 1_048_576.0;
/// Period of the controller, us.
const PERIOD_US: u16 = 200;
/// Ticks of the step clock per microsecond.
const CLOCK: u32 = 84;

/// Pulses of both axes, in microseconds. The accumulators count in units of `length` steps per tick
/// and begin half full, so that pulses come at the middles between steps. `feed_steps` is the feed
/// in steps per second.
fn overflow(steps: [u64; 2], length: f64, feed_steps: u64) -> [Vec<u64>; 2] {
    // Integers: a step is `scale`, an axis gets its share of the feed in every tick.
    let scale = 1_u64 << 40;
    let share = steps.map(|n| {
        (n as f64 / length * feed_steps as f64 / BASE as f64 * scale as f64).round() as u64
    });
    let mut sums = [scale / 2; 2];
    let mut pulses = [Vec::new(), Vec::new()];
    let ticks = (length / feed_steps as f64 * BASE as f64).round() as u64;
    for tick in 1..=ticks {
        for axis in 0..2 {
            sums[axis] += share[axis];
            if sums[axis] >= scale {
                sums[axis] -= scale;
                pulses[axis].push(tick);
            }
        }
    }
    pulses
}

/// Pulses of `width` microseconds of the controller's generator for the same line, in microseconds.
fn generated(steps: u64, length: f64, feed_steps: f64, step_mm: f64, width: u16) -> Vec<f64> {
    let per_step = step_mm * UNITS;
    let timing = PulseTiming {
        period: CLOCK * u32::from(PERIOD_US),
        pulse: CLOCK as u16 * width,
        setup: CLOCK as u16 * width,
        hold: CLOCK as u16 * width,
    };
    let scaled = (per_step * f64::from(1 << 24)).round() as i64;
    let mut planner = StepPlanner::new(AxisKind::Linear, scaled, timing, PERIOD_US);
    planner.start(Coordinate(0));
    let duration = length / feed_steps;
    let speed = steps as f64 / duration * per_step;
    let mut pulses = Vec::new();
    let periods = (duration * 1e6 / f64::from(PERIOD_US)).ceil() as u64;
    // The line begins at its rate, as the accumulators do: two periods of standstill are before it.
    for period in 1..=periods {
        let time = (period as f64 * f64::from(PERIOD_US) * 1e-6).min(duration);
        let planned = planner.plan(
            Coordinate((time * speed).round() as i32),
            Rate(speed.round() as i32),
        );
        assert_eq!(planned.lag, 0);
        let segment = planned.segment;
        for k in 0..i64::from(segment.count) {
            let within = i64::from(segment.delay)
                + k * i64::from(segment.interval)
                + i64::from(segment.ramp) * (k * (k - 1) / 2);
            let start = (period - 1) as f64 * f64::from(PERIOD_US);
            pulses.push(start + within as f64 / f64::from(CLOCK));
        }
    }
    pulses
}

fn spread(gaps: impl Iterator<Item = f64> + Clone) -> f64 {
    gaps.clone().fold(0.0, f64::max) - gaps.fold(f64::INFINITY, f64::min)
}

/// Section 3.1.3 of the thesis: 5 mm/s on one axis are 1000 pulses/s, and at 45 degrees 707.107 on
/// each axis.
#[test]
fn rates_of_5_mm_s() {
    let [x, y] = overflow([1000, 0], 1000.0, 1000);
    assert_eq!((x.len(), y.len()), (1000, 0));
    assert!(x.windows(2).all(|pair| pair[1] - pair[0] == 1000));
    let length = 1000.0 * 2_f64.sqrt();
    let [x, _] = overflow([1000, 1000], length, 1000);
    let rate = (x.len() - 1) as f64 / (x[x.len() - 1] - x[0]) as f64 * 1e6;
    assert!((rate - 707.107).abs() < 0.01, "{rate}");
}

/// The controller's generator and the accumulators emit the same pulses: equal counts on both axes,
/// and equal times within the tick of 1 us, after two periods in which the generator speeds up. The
/// jitter is at most that tick. With `--nocapture` the test prints both jitters.
#[test]
fn the_generator_counts_as_the_accumulators_do() {
    // For each width: largest jitter of the accumulators and of the generator, us.
    let mut largest = [(1_u16, [0.0_f64; 2]), (10, [0.0; 2])];
    let lines = [
        [200, 100],
        [67, 180],
        [150, 150],
        [240, 2],
        [0, 300],
        [999, 331],
    ];
    for ([x, y], width) in lines
        .into_iter()
        .flat_map(|line| [(line, 1_u16), (line, 10)])
    {
        let length = (x as f64).hypot(y as f64);
        let pulses = overflow([x, y], length, (FEED / 0.005) as u64);
        for (steps, theirs) in [x, y].into_iter().zip(&pulses) {
            let ours = generated(steps, length, FEED / 0.005, 0.005, width);
            assert_eq!(theirs.len() as u64, steps, "{x} {y}");
            assert_eq!(ours.len() as u64, steps, "{x} {y}");
            let settled = |time: &f64| *time > 2.0 * f64::from(PERIOD_US);
            // The commanded position has a resolution of 2^-20 mm, which takes this time.
            let unit_us = 1e6 / (steps as f64 / length * FEED / 0.005 * 0.005 * UNITS).max(1.0);
            for (a, b) in ours.iter().zip(theirs).filter(|(time, _)| settled(time)) {
                // The accumulators are up to a tick late.
                assert!((a - *b as f64).abs() <= 1.5 + unit_us, "{x} {y}: {a} {b}");
            }
            if steps > 2 {
                let jitter = spread(theirs.windows(2).map(|two| (two[1] - two[0]) as f64));
                assert!(jitter <= 1.0, "{jitter}");
                let ours: Vec<f64> = ours.iter().copied().filter(settled).collect();
                let ours = spread(ours.windows(2).map(|two| two[1] - two[0]));
                assert!(ours <= 1.0 + unit_us, "{x} {y}: {ours}");
                if let Some((_, seen)) = largest.iter_mut().find(|one| one.0 == width) {
                    *seen = [seen[0].max(jitter), seen[1].max(ours)];
                }
            }
        }
        // Both axes end within a step period of the slower of them.
        if x > 0 && y > 0 {
            let ends = pulses.map(|one| one[one.len() - 1] as f64);
            let slow = length / (FEED / 0.005) * 1e6 / x.min(y) as f64;
            assert!((ends[0] - ends[1]).abs() <= slow, "{ends:?}");
        }
    }
    for (width, [theirs, ours]) in largest {
        println!(
            "pulses of {width} us: jitter of the accumulators {theirs:.3} us, of the generator \
             {ours:.3} us"
        );
    }
}

/// Z of the engraver: 0.001 mm a step, 0.5 mm down at 1 mm/s are 500 pulses at 1000 Hz, of ours as
/// of the accumulators.
#[test]
fn a_plunge_of_half_a_millimetre_has_500_pulses() {
    let [theirs, _] = overflow([500, 0], 500.0, 1000);
    let ours = generated(500, 500.0, 1000.0, 0.001, 10);
    assert_eq!((theirs.len(), ours.len()), (500, 500));
    let settled = ours.iter().zip(&theirs).skip(1);
    for (a, b) in settled {
        assert!((a - *b as f64).abs() <= 2.0, "{a} {b}");
    }
}

/// Positions (mm) after each pulse of the controller's generators of both axes, which follow `at`
/// (position and speed at a time, mm and s) for `duration` s.
fn walked(at: impl Fn(f64) -> [[f64; 2]; 2], duration: f64) -> Vec<[f64; 2]> {
    const STEP: f64 = 0.005;
    let timing = PulseTiming {
        period: CLOCK * u32::from(PERIOD_US),
        pulse: CLOCK as u16,
        setup: CLOCK as u16,
        hold: CLOCK as u16,
    };
    let scaled = (STEP * UNITS * f64::from(1 << 24)).round() as i64;
    let units = |value: f64| (value * UNITS).round() as i32;
    let [begin, _] = at(0.0);
    let mut pulses: Vec<(f64, usize, f64)> = Vec::new();
    for axis in 0..2 {
        let mut planner = StepPlanner::new(AxisKind::Linear, scaled, timing, PERIOD_US);
        planner.start(Coordinate(units(begin[axis])));
        let periods = (duration * 1e6 / f64::from(PERIOD_US)).ceil() as u64;
        // Two periods at the end: a pulse may wait for the setup time of its direction.
        for period in 1..=periods + 2 {
            let start = (period - 1) as f64 * f64::from(PERIOD_US);
            let time = (start + f64::from(PERIOD_US)) * 1e-6;
            let is_past = time >= duration;
            let [position, speed] = at(time.min(duration));
            let speed = if is_past { 0.0 } else { speed[axis] };
            let planned = planner.plan(Coordinate(units(position[axis])), Rate(units(speed)));
            let segment = planned.segment;
            let sign = f64::from(segment.count.signum());
            for k in 0..i64::from(segment.count.unsigned_abs()) {
                let within = i64::from(segment.delay)
                    + k * i64::from(segment.interval)
                    + i64::from(segment.ramp) * (k * (k - 1) / 2);
                pulses.push((start + within as f64 / f64::from(CLOCK), axis, sign));
            }
        }
    }
    pulses.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut position = begin;
    let walk = pulses.into_iter().map(|(_, axis, sign)| {
        position[axis] += sign * STEP;
        position
    });
    walk.collect()
}

/// The steps of a line are nowhere farther from it than a step, end at its end, and an axis that
/// does not move has none.
#[test]
fn the_steps_of_a_line_stay_within_a_step() {
    for [x, y] in [
        [1.0, 0.5],
        [0.335, 0.9],
        [-0.75, 0.75],
        [1.2, -0.01],
        [0.0, 1.5],
    ] {
        let length = f64::hypot(x, y);
        let speed = [x / length * FEED, y / length * FEED];
        let at = |time: f64| [speed.map(|rate| rate * time), speed];
        let walk = walked(at, length / FEED);
        let mut before = [0.0; 2];
        for &[u, v] in &walk {
            let off = (u * y - v * x).abs() / length;
            assert!(off <= 0.005, "{x} {y}: {off}");
            assert!(
                x != 0.0 || u == before[0],
                "a pulse of x on the way along y"
            );
            before = [u, v];
        }
        assert!(
            (before[0] - x).hypot(before[1] - y) < 0.0026,
            "{before:?} {x} {y}"
        );
    }
}

/// A circle of 10 mm, counter-clockwise and clockwise, is nowhere farther from its radius than a
/// step and ends at its start. `the_time_of_a_circle_is_that_of_its_length` has the planned circle.
#[test]
fn the_steps_of_a_circle_stay_within_a_step() {
    const RADIUS: f64 = 10.0;
    let round = std::f64::consts::TAU * RADIUS;
    for turn in [1.0, -1.0] {
        let at = |time: f64| {
            let (sin, cos) = (turn * FEED / RADIUS * time).sin_cos();
            let speed = [-turn * FEED * sin, turn * FEED * cos];
            [[RADIUS * cos, RADIUS * sin], speed]
        };
        let walk = walked(at, round / FEED);
        let off = walk.iter().map(|[x, y]| (x.hypot(*y) - RADIUS).abs());
        let off = off.fold(0.0, f64::max);
        assert!(off <= 0.005 && off > 0.0, "{off}");
        let [x, y] = walk[walk.len() - 1];
        assert!((x - RADIUS).hypot(y) < 0.0026, "{x} {y}");
        // Four times the radius in each axis, to and fro.
        assert_eq!(walk.len(), 2 * 4 * 2000);
        let first = walk.iter().find(|at| at[1] != 0.0).map_or(0.0, |at| at[1]);
        assert_eq!(first.signum(), turn);
    }
}

/// Input pulses for one output pulse of a dual-modulus divider: P + X while A counts, then P.
fn dual_modulus(p: u64, x: u64, n: u64, a: u64) -> u64 {
    let (mut a, mut pulses) = (a, 0);
    for _ in 0..n {
        pulses += if a > 0 { p + x } else { p };
        a = a.saturating_sub(1);
    }
    pulses
}

#[test]
fn a_dual_modulus_divider_divides_by_np_plus_xa() {
    for p in [4, 8, 10, 16] {
        for n in 0..60 {
            for a in 0..=n.min(p) {
                for x in [1, 2] {
                    assert_eq!(dual_modulus(p, x, n, a), n * p + x * a);
                }
            }
        }
        // Every division of at least P (P - 1) is possible with A below P, and not the one below.
        let possible = |total: u64| total / p >= total % p;
        assert!((p * (p - 1)..5000).all(possible) && !possible(p * (p - 1) - 1));
    }
    // 5 mm/s: 1 MHz / 1000 Hz = 1000 = 125 x 8 + 0; at 45 degrees 1414 = 176 x 8 + 6.
    assert_eq!(
        (dual_modulus(8, 1, 125, 0), dual_modulus(8, 1, 176, 6)),
        (1000, 1414)
    );
}

/// Two dividers of their own instead of one time base end apart: the reason for the accumulators.
#[test]
fn separate_dividers_end_apart() {
    let (x, y) = (21_999_u64, 50_000_u64);
    let length = (x as f64).hypot(y as f64);
    let divider = |n: u64| (BASE as f64 / (1000.0 * n as f64 / length)).round() as u64;
    let ends = [x * divider(x), y * divider(y)];
    assert!(ends[0].abs_diff(ends[1]) > 1000, "{ends:?}");
}
