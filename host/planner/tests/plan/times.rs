//! Durations of single moves against the time-optimal profile.

use crate::h4::{HOME, settings};
use crate::properties::plan;
use proptest::prelude::*;

/// Shortest time from standstill to standstill over a length, with limits of speed, acceleration
/// and jerk: phases of maximum jerk, maximum acceleration and maximum speed.
fn shortest(length: f64, speed: f64, acceleration: f64, jerk: f64) -> f64 {
    let ramp = |peak: f64| {
        if peak <= acceleration * acceleration / jerk {
            2.0 * (peak / jerk).sqrt()
        } else {
            peak / acceleration + acceleration / jerk
        }
    };
    // Both ramps together cover the length of one ramp time at the peak speed.
    if speed * ramp(speed) <= length {
        return length / speed + ramp(speed);
    }
    let (mut low, mut high) = (0.0, speed);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if middle * ramp(middle) <= length {
            low = middle;
        } else {
            high = middle;
        }
    }
    2.0 * ramp(low)
}

#[test]
fn the_shortest_time_of_known_profiles() {
    // 2 mm with a jerk of 1 mm/s^3 alone: four phases of 1 s.
    assert!((shortest(2.0, 1e9, 1e9, 1.0) - 4.0).abs() < 1e-9);
    // Constant acceleration: 2 sqrt(s / a).
    assert!((shortest(1.0, 1e9, 4.0, 1e12) - 1.0).abs() < 1e-4);
    // Constant speed.
    assert!((shortest(10.0, 5.0, 1e12, 1e15) - 2.0).abs() < 1e-4);
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, cases: 300, ..ProptestConfig::default() })]

    /// Rapid moves and moves at feed in any direction take at most 10 % longer than the
    /// time-optimal profile within the limits of the axes.
    #[test]
    fn single_moves_are_nearly_time_optimal(
        length in prop_oneof![0.05..1.0f64, 1.0..30.0f64],
        angle in 0.0..std::f64::consts::TAU,
        rise in -1.0..1.0f64,
        feed in prop::option::of(60.0..3000.0f64),
    ) {
        let mut settings = settings();
        // The joints reach their limits later than the axes: the best time is known for these.
        for joint in &mut settings.joints {
            joint.rate *= 10.0;
            joint.acceleration *= 10.0;
            joint.jerk *= 10.0;
        }
        let flat = (1.0 - rise * rise).sqrt();
        let unit = [flat * angle.cos(), flat * angle.sin(), rise];
        let word = feed.map_or("G0".to_owned(), |feed| format!("G1 F{feed:.3}"));
        let to: Vec<f64> = (0..3).map(|axis| HOME[axis] + length * unit[axis]).collect();
        let text = format!("{word} X{:.6} Y{:.6} Z{:.6}\n", to[0], to[1], to[2]);
        let limit = |of: fn(&haptimill_planner::PoseLimits) -> f64| {
            let axes = settings.pose[..3].iter().zip(unit);
            axes.map(|(axis, share)| of(axis) / share.abs().max(1e-9)).fold(f64::INFINITY, f64::min)
        };
        let speed = limit(|axis| axis.rate).min(feed.unwrap_or(f64::INFINITY) / 60.0);
        let best = shortest(length, speed, limit(|axis| axis.acceleration), limit(|axis| axis.jerk));
        let (_, plan) = plan(&text, &settings);
        let ratio = plan.figures.duration_s / best;
        prop_assert!((0.999..=1.10).contains(&ratio), "{ratio} of {best} s\n{text}");
    }
}
