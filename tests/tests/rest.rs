//! A joint at rest does not hunt: with an integrator and friction that sticks, a loop without a
//! dead band creeps across its target again and again.

use crate::setup;
use haptimill_hil_sim::random::Random;
use setup::single_joint::{Friction, PERIOD, Slide};

/// Minutes of rest that are checked, after a first one.
const MINUTES: usize = 2;

/// The loop of the built-in machine after a move, with Coulomb friction of half to twice the 40 N
/// that the plant of the machine file has, and breakaway forces of up to twice that. Neither motor
/// nor slide moves in the two minutes after the first one; a count is 1.25 um.
#[test]
fn a_joint_at_rest_does_not_hunt() {
    let mut moved = Vec::new();
    for seed in 0..24 {
        let mut random = Random::new(7, seed);
        let mut between = |low: f64, high: f64| low * (high / low).powf(random.fraction());
        let coulomb = 40.0 * [0.5, 1.0, 2.0][seed as usize % 3];
        let friction = Friction {
            coulomb,
            breakaway: coulomb * between(1.0, 2.0),
            stribeck: between(0.2, 5.0),
            slide_share: between(0.3, 0.8),
        };
        let (distance, time) = (between(0.01, 10.0), between(0.2, 2.0));
        let load = between(0.1, 20.0);
        let mut slide = Slide::new(friction, 1.0, 1e6, between(1.0, 5.0));
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let minute = (60.0 / PERIOD) as usize;
        for period in 0..(1 + MINUTES) * minute {
            // A smooth move, then rest under a constant load.
            let part = (period as f64 * PERIOD / time).min(1.0);
            let place =
                distance * (part - (std::f64::consts::TAU * part).sin() / std::f64::consts::TAU);
            let rate = distance / time * (1.0 - (std::f64::consts::TAU * part).cos());
            let acceleration = distance / (time * time)
                * std::f64::consts::TAU
                * (std::f64::consts::TAU * part).sin();
            let motion = match part < 1.0 {
                true => [place, rate, acceleration],
                false => [distance, 0.0, 0.0],
            };
            let fault = slide.step(motion, load);
            assert_eq!(fault, None, "{seed}: {friction:?}");
            if period >= minute {
                for (body, at) in [slide.motor[0], slide.slide[0]].into_iter().enumerate() {
                    low[body] = low[body].min(at);
                    high[body] = high[body].max(at);
                }
            }
        }
        let span = [0, 1].map(|body| high[body] - low[body]);
        println!(
            "{seed}: motor {:.2e} mm, slide {:.2e} mm, {friction:?}",
            span[0], span[1]
        );
        if span.iter().any(|span| *span > 1e-4) {
            moved.push((seed, span));
        }
    }
    assert!(moved.is_empty(), "{moved:?}");
}
