//! Tracker of a coordinate that follows a master: bounded, exact at a constant target, without
//! overshoot.

use haptimill_firmware::config::{AxisKind, PoseAxis};
use haptimill_firmware::motion::PoseCommand;
use haptimill_firmware::motion::tracker::{Tracker, TrackerLimits};
use haptimill_math::{Acceleration, Coordinate, Rate};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const MM: i32 = 1 << 20;
const PERIOD_US: u16 = 200;

fn axis(acceleration: i32, rate: i32) -> PoseAxis {
    PoseAxis {
        kind: AxisKind::Linear,
        low: Coordinate(-200 * MM),
        high: Coordinate(200 * MM),
        rate: Rate(rate * MM),
        acceleration: Acceleration(acceleration << 12),
        jerk: 1 << 20,
    }
}

fn limits(acceleration: i32, rate: i32, gain: u16) -> TrackerLimits {
    TrackerLimits::new(&axis(acceleration, rate), gain, PERIOD_US).expect("sound")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Acceleration and rate, commanded and reported, for any targets.
    #[test]
    fn tracker_is_bounded_for_any_target(
        acceleration in 50_i32..3000, rate in 1_i32..150, gain in 5_u16..400,
        targets in prop::collection::vec((prop::option::of(-300 * MM..300 * MM), 1_usize..3000), 1..8),
    ) {
        let limits = limits(acceleration, rate, gain);
        let mut tracker = Tracker::at(Coordinate(5 * MM), Rate::ZERO, &limits);
        let mut before = PoseCommand::default();
        tracker.write_to(0, &limits, &mut before);
        let max = f64::from(acceleration) * 2e-4 * f64::from(MM);
        for (target, periods) in targets {
            for _ in 0..periods {
                let within = tracker.envelope(target.map(Coordinate), 0, &limits);
                tracker.advance(target.map(Coordinate), &limits);
                let mut commanded = PoseCommand::default();
                tracker.write_to(0, &limits, &mut commanded);
                let change = f64::from(commanded.rates[0].0) - f64::from(before.rates[0].0);
                prop_assert!(change.abs() <= max + 2.0, "{change} {max}");
                prop_assert!(commanded.rates[0].0.abs() <= rate * MM + 1);
                let reported = f64::from(commanded.accelerations[0].0) * 256.0 * 2e-4;
                prop_assert!((reported - change).abs() <= 2.0 + max * 1e-3, "{reported} {change}");
                // The place is the integral of the rate, to the last bits.
                let way = f64::from(commanded.pose.0[0].0) - f64::from(before.pose.0[0].0);
                let mean = (f64::from(commanded.rates[0].0) + f64::from(before.rates[0].0)) / 2.0 * 2e-4;
                prop_assert!((way - mean).abs() <= 1.6, "{way} {mean}");
                prop_assert!((within.low..=within.high).contains(&i64::from(commanded.pose.0[0].0)));
                prop_assert!(i64::from(commanded.rates[0].0).abs() <= within.rate);
                before = commanded;
            }
        }
    }

    /// A constant target is reached to the bit and never passed.
    #[test]
    fn tracker_arrives_exactly_without_overshoot(acceleration in 50_i32..3000, rate in 1_i32..150, gain in 10_u16..400, from in -100 * MM..100 * MM, way in -50 * MM..50 * MM) {
        let limits = limits(acceleration, rate, gain);
        let mut tracker = Tracker::at(Coordinate(from), Rate::ZERO, &limits);
        let target = Coordinate(from + way);
        for period in 0..2_000_000 {
            tracker.advance(Some(target), &limits);
            let past = (i64::from(tracker.place().0) - i64::from(target.0)) * i64::from(way.signum());
            prop_assert!(past <= 0, "passed by {past} in {period}");
            if tracker.is_at_standstill() && period > 10 {
                break;
            }
        }
        prop_assert!(tracker.is_at_standstill());
        prop_assert_eq!(tracker.place(), target);
    }

    /// It stops within its stopping envelope.
    #[test]
    fn tracker_stops_within_its_envelope(acceleration in 50_i32..3000, rate in 1_i32..150, gain in 5_u16..400, start in -150 * MM..150 * MM, target in -200 * MM..200 * MM, periods in 1_usize..2000) {
        let limits = limits(acceleration, rate, gain);
        let mut tracker = Tracker::at(Coordinate(0), Rate(start.clamp(-rate * MM, rate * MM)), &limits);
        for _ in 0..periods {
            tracker.advance(Some(Coordinate(target)), &limits);
        }
        let within = tracker.envelope(None, 0, &limits);
        let rest = tracker.standstill_position(&limits);
        for _ in 0..2_000_000 {
            tracker.advance(None, &limits);
            prop_assert!((within.low..=within.high).contains(&i64::from(tracker.place().0)));
            if tracker.is_at_standstill() { break; }
        }
        prop_assert!(tracker.is_at_standstill());
        // Nor does it stop far short of it: two periods' way.
        let off = (i64::from(rest.0) - i64::from(tracker.place().0)).abs();
        prop_assert!(off <= i64::from(rate * MM) / 2500 + 2, "{off}");
    }
}

/// Tracking lag: 2 / k below a' / k, more above.
#[test]
fn tracking_lag_is_as_documented() {
    for (rate, k, acceleration) in [
        (1.0, 100.0, 200.0),
        (10.0, 100.0, 200.0),
        (30.0, 50.0, 500.0),
        (20.0, 200.0, 1000.0),
    ] {
        let limits = limits(acceleration as i32, 60, k as u16);
        let mut tracker = Tracker::at(Coordinate(0), Rate::ZERO, &limits);
        let mut target = 0.0;
        for _ in 0..20_000 {
            target += rate * 2e-4;
            tracker.advance(Some(Coordinate((target * f64::from(MM)) as i32)), &limits);
        }
        let lag = (target - f64::from(tracker.place().0) / f64::from(MM)) / rate;
        let gentle = acceleration * 7.0 / 8.0;
        let stated = 1.0 / k
            + if rate <= gentle / k {
                1.0 / k
            } else {
                rate / (2.0 * gentle) + gentle / (2.0 * k * k * rate)
            };
        println!(
            "{rate} mm/s: lag {:.1} ms, stated {:.1} ms",
            lag * 1e3,
            stated * 1e3
        );
        assert!(
            (lag - stated).abs() < 4e-4 + 0.02 * stated,
            "{lag} {stated}"
        );
    }
}

#[test]
fn invalid_tracker_limits_are_refused() {
    assert!(TrackerLimits::new(&axis(200, 50), 0, PERIOD_US).is_none());
    assert!(TrackerLimits::new(&axis(200, 50), 1001, PERIOD_US).is_none());
    assert!(TrackerLimits::new(&axis(0, 50), 100, PERIOD_US).is_none());
    assert!(TrackerLimits::new(&axis(200, 50), 1000, 1000).is_none());
}
