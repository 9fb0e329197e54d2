//! Supervision of one joint against the true motion of its plant.

use crate::setup;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::random::Random;
use setup::single_joint::{Friction, PERIOD, Slide};

/// A commanded motion of one joint with a continuous rate.
#[derive(Debug, Clone, Copy)]
struct Course {
    speed: f64,
    /// Time between reversals; pauses of the same length where `rests`.
    half_s: f64,
    rests: bool,
    smooth: bool,
}

impl Course {
    fn rate(&self, time: f64) -> f64 {
        let phase = time / self.half_s;
        let part = phase as u64 % if self.rests { 4 } else { 2 };
        let sign = match (part, self.rests) {
            (0, _) => 1.0,
            (1, false) | (2, true) => -1.0,
            _ => 0.0,
        };
        let within = phase.fract();
        if self.smooth {
            return sign * self.speed * (core::f64::consts::PI * within).sin();
        }
        // A ramp of 20 ms at both ends.
        let ramp = (0.02 / self.half_s).min(0.4);
        sign * self.speed * (within / ramp).min((1.0 - within) / ramp).min(1.0)
    }
}

/// A slide whose encoder counts is never reported as an encoder stuck, however it sticks.
///
/// Breakaway forces of half to twice the compensated friction, creep rates, reversals, pauses, loop
/// gains, an integrator, an oscillating force.
#[test]
fn a_sticking_slide_is_not_reported_as_encoder_stuck() {
    let mut blamed = vec![];
    for seed in 0..400 {
        let mut random = Random::new(5, seed);
        let mut between = |low: f64, high: f64| low * (high / low).powf(random.fraction());
        let coulomb = 32.0 * between(0.5, 1.25);
        let friction = Friction {
            coulomb,
            breakaway: coulomb.max(32.0 * between(0.5, 2.0)),
            stribeck: between(0.2, 5.0),
            slide_share: between(0.3, 0.8),
        };
        let gain = between(0.3, 1.2);
        let integral = if seed % 3 == 0 {
            between(1e4, 1e6)
        } else {
            0.0
        };
        let course = Course {
            speed: between(0.005, 0.5),
            half_s: between(0.2, 4.0),
            rests: seed % 4 == 0,
            smooth: seed % 5 < 2,
        };
        let load = if seed % 2 == 0 {
            between(0.1, 10.0)
        } else {
            0.0
        };
        let hz = between(1.0, 300.0);
        let mut slide = Slide::new(friction, gain, integral, between(1.0, 5.0));
        let (mut commanded, mut before) = (0.0, 0.0);
        for period in 0..40_000 {
            let time = f64::from(period) * PERIOD;
            let rate = course.rate(time);
            let push = load * (time * hz * core::f64::consts::TAU).sin();
            let fault = slide.step([commanded, rate, (rate - before) / PERIOD], push);
            commanded += rate * PERIOD;
            before = rate;
            if let Some(fault) = fault {
                blamed.push(format!(
                    "{seed} at {time:.3} s: {fault:?}, {friction:?}, {course:?}"
                ));
                break;
            }
        }
    }
    assert!(blamed.is_empty(), "{} of 400: {blamed:#?}", blamed.len());
}

/// Returns the following error of the slide when its encoder is found dead, mm; from standstill, or
/// after 2 s of motion.
fn found_after(speed: f64, condition: EncoderCondition, standing: bool, breakaway: f64) -> f64 {
    let friction = Friction {
        coulomb: 40.0,
        breakaway,
        stribeck: 1.0,
        slide_share: 0.5,
    };
    let mut max = 0.0_f64;
    for phase in 0..8 {
        let mut slide = Slide::new(friction, 1.0, 0.0, f64::from(phase) / 2.0 + 0.1);
        let mut commanded = 0.0;
        let start = if standing { 0 } else { 10_000 + phase * 37 };
        let found = (0..60_000).any(|period| {
            if period == start {
                slide.set_encoder_condition(condition);
            }
            let ramp = (f64::from(period) / 500.0).min(1.0);
            let acceleration = if ramp < 1.0 { speed / 0.1 } else { 0.0 };
            let fault = slide.step([commanded, speed * ramp, acceleration], 0.0);
            commanded += speed * ramp * PERIOD;
            fault.is_some()
        });
        assert!(found, "{speed} mm/s {condition:?}");
        max = max.max((slide.travel() - commanded).abs());
    }
    max
}

/// A stuck channel is found by the reversals of the other one, at any friction.
///
/// The bounds include half of the compensated lost motion, 0.013 mm.
#[test]
fn a_stuck_channel_is_found_whatever_the_friction() {
    for (speed, max) in [
        (0.005, 0.15),
        (0.02, 0.11),
        (0.05, 0.1),
        (0.2, 0.1),
        (0.5, 0.1),
        (1.0, 0.1),
        (4.0, 0.1),
        (40.0, 0.1),
    ] {
        for standing in [false, true] {
            for breakaway in [40.0, 64.0] {
                for (stuck_a, stuck_b) in [(Some(true), None), (None, Some(false))] {
                    let condition = EncoderCondition {
                        stuck_a,
                        stuck_b,
                        ..EncoderCondition::default()
                    };
                    let off = found_after(speed, condition, standing, breakaway);
                    assert!(off < max, "{speed} mm/s: {off} mm");
                }
            }
        }
    }
}

/// With both channels dead only the effort reveals it, compared with earlier friction: at once in
/// fast motion, late at creep rates.
#[test]
fn a_dead_encoder_is_found_by_the_effort() {
    for (speed, standing, max) in [
        (0.2, false, 4.0),
        (0.5, false, 1.0),
        (1.0, false, 0.33),
        (4.0, false, 0.04),
        (10.0, false, 0.021),
        (40.0, false, 0.012),
        (0.5, true, 6.6),
        (1.0, true, 3.4),
        (4.0, true, 1.15),
        (10.0, true, 0.68),
        (40.0, true, 0.18),
    ] {
        let condition = EncoderCondition {
            stuck_a: Some(true),
            stuck_b: Some(false),
            ..EncoderCondition::default()
        };
        let off = found_after(speed, condition, standing, 40.0);
        assert!(off < max, "{speed} mm/s, standing {standing}: {off} mm");
    }
}
