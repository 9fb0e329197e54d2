//! Step pulses against an independent reconstruction of every pulse and direction edge.

use haptimill_firmware::config::AxisKind;
use haptimill_firmware::joint::step_gen::{Planned, PulseTiming, StepPlanner};
use haptimill_math::{Coordinate, Rate};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Axis units a step of 320 steps/mm: 3276.8.
const UNITS: f64 = 3276.8;
/// The same, Q24.
const PER_STEP: i64 = 54_975_581_389;
const PERIOD_US: u16 = 200;

/// Expands segments to pulses on one clock and checks what a drive needs.
#[derive(Default)]
struct Checker {
    period: i64,
    /// Rising edges with their direction.
    pulses: Vec<(i64, i64)>,
    direction: i64,
    direction_since: i64,
}

impl Checker {
    fn take(&mut self, planned: &Planned, timing: &PulseTiming) {
        let segment = planned.segment;
        let start = self.period * i64::from(timing.period);
        self.period += 1;
        let (pulse, setup, hold) = (
            i64::from(timing.pulse),
            i64::from(timing.setup),
            i64::from(timing.hold),
        );
        let direction = i64::from(segment.count.signum());
        if direction != 0 && direction != self.direction {
            if let Some(&(last, _)) = self.pulses.last() {
                assert!(
                    start - (last + pulse) >= hold,
                    "hold: {} after a pulse",
                    start - (last + pulse)
                );
            }
            self.direction = direction;
            self.direction_since = start;
        }
        for k in 0..i64::from(segment.count.unsigned_abs()) {
            let within = i64::from(segment.delay)
                + k * i64::from(segment.interval)
                + i64::from(segment.ramp) * (k * (k - 1) / 2);
            assert!(
                within >= 0 && within < i64::from(timing.period),
                "pulse {k} of {segment:?} begins outside the period"
            );
            let time = start + within;
            if let Some(&(last, _)) = self.pulses.last() {
                assert!(
                    time - last >= 2 * pulse,
                    "{} ticks between pulses, {segment:?}",
                    time - last
                );
            }
            assert!(time - self.direction_since >= setup, "set-up");
            self.pulses.push((time, direction));
        }
    }

    fn count(&self) -> i64 {
        self.pulses.iter().map(|&(_, direction)| direction).sum()
    }
}

fn timing(ticks_per_us: u32, pulse_us: f64, setup_us: f64, hold_us: f64) -> PulseTiming {
    let ticks = |us: f64| (us * f64::from(ticks_per_us)).max(1.0) as u16;
    let timing = PulseTiming {
        period: ticks_per_us * u32::from(PERIOD_US),
        pulse: ticks(pulse_us),
        setup: ticks(setup_us),
        hold: ticks(hold_us),
    };
    assert!(timing.fits());
    timing
}

/// Round half up of the exact position in steps.
fn rounded(travel: i64, per_step: i64) -> i64 {
    let twice = i128::from(travel) << 25;
    let (n, d) = if per_step < 0 {
        (-twice, -i128::from(per_step))
    } else {
        (twice, i128::from(per_step))
    };
    ((n + d).div_euclid(2 * d)) as i64
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, rng_seed: RngSeed::Fixed(3), failure_persistence: None, ..ProptestConfig::default() })]

    /// A random walk of rate with reversals, rests and runs at up to 1.3 times the ceiling.
    #[test]
    fn any_motion_keeps_pulse_timing_and_count(
        legs in prop::collection::vec((-1.0f64..1.0, 1u32..150, 0u8..4), 5..30),
        ticks_per_us in prop::sample::select(vec![1u32, 8, 72, 168, 1000]),
        pulse_us in 1.0f64..5.0,
        setup_us in 1.0f64..60.0,
        hold_us in 1.0f64..60.0,
        sign in prop::sample::select(vec![1i64, -1]),
        start: i32,
    ) {
        let timing = timing(ticks_per_us, pulse_us, setup_us, hold_us);
        let per_step = sign * PER_STEP;
        // Steps a period at the ceiling.
        let ceiling = f64::from(timing.period) / (2.0 * f64::from(timing.pulse));
        let mut planner = StepPlanner::new(AxisKind::Rotary, per_step, timing, PERIOD_US);
        planner.start(Coordinate(start));
        let mut checker = Checker::default();
        let (mut position, mut rate, mut travel, mut last_lag) = (0.0f64, 0.0f64, 0i64, 0);
        for (goal, periods, mode) in legs {
            // Steps per period: crawling, slow, fast, over the ceiling.
            let goal = goal * [0.05, 0.9, 0.8 * ceiling, 1.3 * ceiling][usize::from(mode)];
            for _ in 0..periods {
                rate += (goal - rate) * 0.05;
                position += rate * UNITS;
                travel = position.round() as i64;
                let target = start.wrapping_add(travel as i32);
                let planned = planner.plan(Coordinate(target), Rate((rate * UNITS * 5000.0).clamp(-2e9, 2e9) as i32));
                checker.take(&planned, &timing);
                prop_assert_eq!(checker.count(), planner.emitted());
                prop_assert_eq!(checker.count() + i64::from(planned.lag), rounded(travel, per_step));
                prop_assert_eq!(planned.ceiling, planned.lag != 0);
                last_lag = planned.lag;
            }
        }
        // Standing still, all pending steps are emitted, at the ceiling if need be, and the count
        // is exact.
        for _ in 0..2 + (f64::from(last_lag).abs() / (ceiling - 2.0 - setup_us / pulse_us).max(1.0)) as u32 * 2 {
            let planned = planner.plan(Coordinate(start.wrapping_add(travel as i32)), Rate(0));
            checker.take(&planned, &timing);
            last_lag = planned.lag;
        }
        prop_assert_eq!(last_lag, 0);
        prop_assert_eq!(checker.count(), rounded(travel, per_step));
    }

    /// At a constant rate the pulses are as evenly spaced as ticks allow, whatever the steps per
    /// period.
    #[test]
    fn constant_rate_is_evenly_spaced(per_period in prop_oneof![0.01f64..1.0, 1.0..30.0]) {
        let timing = timing(72, 2.0, 5.0, 5.0);
        let mut planner = StepPlanner::new(AxisKind::Linear, PER_STEP, timing, PERIOD_US);
        planner.start(Coordinate(-1_000_000_000));
        let mut checker = Checker::default();
        let units = per_period * UNITS;
        let periods = 400;
        for period in 1..=periods {
            let target = -1_000_000_000 + (units * f64::from(period)).round() as i32;
            let planned = planner.plan(Coordinate(target), Rate((units * 5000.0) as i32));
            checker.take(&planned, &timing);
            prop_assert!(!planned.ceiling);
        }
        let period = f64::from(timing.period);
        let ticks_per_step = period / per_period;
        // Targets are rounded to axis units, and so is the distance of a period.
        let rounding = 1.5 * period / units;
        let n = per_period.ceil();
        // In the first period the rate comes from rest, which is a bend; the first pulse waits for
        // the direction.
        for (k, &(time, _)) in checker.pulses.iter().enumerate() {
            if time >= i64::from(timing.period) && k > 0 {
                let ideal = (k as f64 + 0.5) * ticks_per_step;
                // Pulses of an interval that is rounded up may not leave the period.
                let end = ((ideal / period).floor() + 1.0) * period;
                let last = ((end / ticks_per_step - 0.5).floor() + 0.5) * ticks_per_step;
                let share = if end - last < 1.0 + n / 2.0 + rounding { n } else { n / 2.0 };
                let bound = 1.0 + share + rounding;
                prop_assert!((time as f64 - ideal).abs() <= bound, "pulse {k}: {time}, ideal {ideal}, bound {bound}");
            }
        }
    }

    /// Nothing overflows, and the timing holds, for inputs of any size.
    #[test]
    fn any_input_is_safe(
        targets in prop::collection::vec(any::<(i32, i32)>(), 1..60),
        per_step: i64,
        period in 20u32..1_000_000, pulse in 1u16..10, setup in 0u16..10, hold: u16,
    ) {
        for kind in [AxisKind::Linear, AxisKind::Rotary, AxisKind::MultiTurn] {
            let timing = PulseTiming { period, pulse, setup, hold };
            let mut planner = StepPlanner::new(kind, per_step, timing, 1000);
            let mut checker = Checker::default();
            for &(target, rate) in &targets {
                let planned = planner.plan(Coordinate(target), Rate(rate));
                checker.take(&planned, &timing);
                // The pulses themselves are many; only the last matters to the next check.
                prop_assert_eq!(checker.count() - planner.emitted(), 0);
            }
        }
    }
}

/// Acceleration from rest to 40 steps a period and back to rest and beyond: pulses are where the
/// parabola of the motion is.
#[test]
fn ramp_pulses_follow_the_parabola() {
    let timing = timing(72, 2.0, 5.0, 5.0);
    let mut planner = StepPlanner::new(AxisKind::Linear, PER_STEP, timing, PERIOD_US);
    planner.start(Coordinate(0));
    let mut checker = Checker::default();
    // 2 m/s^2, up to 0.1 m/s: 6.4 steps a period; position as a function of time in s.
    let (a, t1) = (2000.0, 0.05);
    let place = |t: f64| {
        if t < t1 {
            a * t * t / 2.0
        } else {
            a * t1 * t1 / 2.0 + a * t1 * (t - t1) - a * (t - t1) * (t - t1) / 2.0
        }
    };
    let rate = |t: f64| if t < t1 { a * t } else { a * t1 - a * (t - t1) };
    for period in 1..=700 {
        let t = f64::from(period) * 200e-6;
        let planned = planner.plan(
            Coordinate((place(t) * 1048576.0).round() as i32),
            Rate((rate(t) * 1048576.0) as i32),
        );
        checker.take(&planned, &timing);
    }
    // The true position at each pulse is half-way between steps, within the stated bound turned
    // into steps.
    let mut position = 0.0;
    let mut worst = 0.0f64;
    for &(time, direction) in &checker.pulses {
        let t = time as f64 / 72e6;
        let crossing = position + 0.5 * direction as f64;
        position += direction as f64;
        let error = place(t) * 320.0 - crossing;
        let steps_per_tick = rate(t).abs() * 320.0 / 72e6;
        let moved = if (time % i64::from(timing.period)) < i64::from(timing.setup) + 2 {
            360.0
        } else {
            1.0 + 4.0 + 144.0 + 3.0
        };
        assert!(
            error.abs() <= 0.002 + steps_per_tick * moved,
            "at {t} s: {error} steps"
        );
        if rate(t).abs() > 1.0 {
            worst = worst.max(error.abs());
        }
    }
    assert!(worst < 0.06, "{worst}");
    assert!(checker.pulses.iter().any(|&(_, direction)| direction < 0));
    assert_eq!(checker.count(), (place(0.14) * 320.0).round() as i64);
}

/// A reversal right after a pulse waits for hold, then for set-up, and loses no step.
#[test]
fn reversal_waits_for_hold_and_setup() {
    let timing = timing(1, 2.0, 30.0, 250.0);
    let mut planner = StepPlanner::new(AxisKind::Linear, 1 << 24, timing, PERIOD_US);
    planner.start(Coordinate(0));
    let mut checker = Checker::default();
    let mut waited = 0;
    for target in [3, 6, 5, 5, 5, 5, 4, 4, 7, 7, 7, 7] {
        let planned = planner.plan(Coordinate(target), Rate(0));
        checker.take(&planned, &timing);
        waited += i32::from(planned.ceiling);
    }
    assert!(waited >= 2);
    assert_eq!(checker.count(), 7);
    assert!(checker.pulses.iter().any(|&(_, direction)| direction < 0));
}

/// Endless rotation in one direction: the count is exact after 117 million steps.
#[test]
fn endless_rotation_loses_no_step() {
    let timing = PulseTiming {
        period: 1_000_000,
        pulse: 1,
        setup: 0,
        hold: 0,
    };
    let per_step = 1_200_000_000_007i64;
    let mut planner = StepPlanner::new(AxisKind::Rotary, per_step, timing, 1000);
    planner.start(Coordinate(0));
    let (mut travel, mut count) = (0i64, 0i64);
    for period in 0..4000 {
        travel += 2_100_000_017;
        let planned = planner.plan(Coordinate(travel as i32), Rate(0));
        count += i64::from(planned.segment.count);
        assert_eq!(
            count + i64::from(planned.lag),
            rounded(travel, per_step),
            "period {period}"
        );
        assert_eq!(planner.emitted(), count);
    }
    assert!(count > 117_000_000);
}
