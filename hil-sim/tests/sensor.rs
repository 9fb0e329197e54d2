//! The force sensor: its measurement, and each of its faults alone.

use haptimill_hil_sim::process::sensor::{End, FULL_CODE, Sensor, SensorCondition, SensorConfig};
use haptimill_hil_sim::random::Random;
use proptest::prelude::*;

const PERIOD: f64 = 200e-6;

/// Downwards in the frame of a level table.
const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

/// Downwards in the frame of a table turned by `alpha` degrees about x.
fn down(alpha: f64) -> [f64; 3] {
    let (sin, cos) = alpha.to_radians().sin_cos();
    [0.0, -sin, -cos]
}

fn sensor(config: &SensorConfig) -> Sensor {
    config.check().expect("a sensor");
    let mut sensor = Sensor::new(config, PERIOD, Random::new(7, 1));
    sensor.sample([0.0; 3], DOWN);
    sensor
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// An ideal sensor gives minus the force on the tool, to half a code.
    #[test]
    fn an_ideal_sensor_measures_the_force_on_the_workpiece(force in prop::array::uniform3(-99.0..99.0_f64), alpha in -45.0..45.0_f64) {
        let mut sensor = sensor(&SensorConfig::ideal());
        sensor.sample(force, down(alpha));
        for (i, force) in force.into_iter().enumerate() {
            let code = f64::from(sensor.codes()[i]);
            prop_assert!((code * 100.0 / 8192.0 + force).abs() <= 0.5 * 100.0 / 8192.0 + 1e-9);
            prop_assert!((sensor.signal()[i] + force).abs() < 1e-9);
        }
    }
}

#[test]
fn the_range_is_limited_by_amplifier_and_adc() {
    let mut config = SensorConfig::ideal();
    let mut open = sensor(&config);
    open.sample([-500.0, 500.0, -100.0], DOWN);
    assert_eq!(open.codes(), [FULL_CODE, -FULL_CODE - 1, FULL_CODE]);
    config.range_n = 50.0;
    let mut clipped = sensor(&config);
    clipped.sample([-500.0, 500.0, -49.0], DOWN);
    assert_eq!(clipped.codes(), [4096, -4096, 4014]);
    // The charge is kept: back in the range, the output is as before.
    clipped.sample([0.0; 3], DOWN);
    assert_eq!(clipped.codes(), [0; 3]);
}

#[test]
fn the_high_pass_decays_a_step_with_its_time_constant() {
    let config = SensorConfig {
        high_pass_s: 0.5,
        ..SensorConfig::ideal()
    };
    let mut sensor = sensor(&config);
    let mut worst = 0.0_f64;
    for step in 0..5000 {
        sensor.sample([-40.0, 0.0, 0.0], DOWN);
        let exact = 40.0 * (-f64::from(step) * PERIOD / 0.5).exp();
        worst = worst.max((sensor.signal()[0] - exact).abs());
    }
    assert!(worst < 1e-9, "{worst}");
}

#[test]
fn drift_continues_until_the_reset() {
    let config = SensorConfig {
        drift_n_s: [0.5, -0.25, 0.0],
        ..SensorConfig::ideal()
    };
    let mut sensor = sensor(&config);
    for _ in 0..9_999 {
        sensor.sample([0.0; 3], DOWN);
    }
    let signal = sensor.signal();
    assert!((signal[0] - 1.0).abs() < 1e-9 && (signal[1] + 0.5).abs() < 1e-9 && signal[2] == 0.0);
    sensor.reset();
    sensor.sample([-3.0, 0.0, 0.0], DOWN);
    assert!((sensor.signal()[0] - 3.0 - 1e-4).abs() < 1e-9);
    // A force that is present at the reset counts as zero.
    sensor.reset();
    sensor.sample([-3.0, 0.0, 0.0], DOWN);
    assert!((sensor.signal()[0] - 1e-4).abs() < 1e-9);
}

#[test]
fn noise_has_its_amplitude_and_no_mean() {
    let config = SensorConfig {
        noise_n: 0.5,
        ..SensorConfig::ideal()
    };
    let mut sensor = sensor(&config);
    let (mut sum, mut square, count) = (0.0, 0.0, 40_000);
    let mut cross = 0.0;
    for _ in 0..count {
        sensor.sample([0.0; 3], DOWN);
        let signal = sensor.signal();
        sum += signal[0];
        square += signal[0] * signal[0];
        cross += signal[0] * signal[1];
    }
    let count = f64::from(count);
    assert!((sum / count).abs() < 0.01, "{}", sum / count);
    assert!(((square / count).sqrt() - 0.5).abs() < 0.01);
    assert!((cross / count).abs() < 0.005);
}

#[test]
fn the_weight_of_the_vise_turns_with_the_table() {
    let config = SensorConfig {
        vise_kg: 3.0,
        ..SensorConfig::ideal()
    };
    let mut sensor = sensor(&config);
    assert_eq!(sensor.codes(), [0; 3], "the first sample is the reset");
    let weight = 3.0 * 9.80665;
    for alpha in [-40.0_f64, -10.0, 0.0, 25.0] {
        sensor.sample([0.0; 3], down(alpha));
        let radian = alpha.to_radians();
        let signal = sensor.signal();
        assert!(signal[0].abs() < 1e-9);
        // In the frame of the table gravity points towards -y for a positive tilt about x.
        assert!(
            (signal[1] + weight * radian.sin()).abs() < 1e-9,
            "{signal:?}"
        );
        assert!((signal[2] - weight * (1.0 - radian.cos())).abs() < 1e-9);
    }
}

#[test]
fn each_fault_has_its_effect() {
    let run = |condition: SensorCondition| {
        let mut sensor = sensor(&SensorConfig::ideal());
        sensor.sample([-20.0; 3], DOWN);
        sensor.set_condition(1, condition);
        for _ in 0..5000 {
            sensor.sample([-30.0; 3], DOWN);
        }
        let codes = sensor.codes();
        assert_eq!((codes[0], codes[2]), (2458, 2458), "the others are well");
        codes[1]
    };
    let well = SensorCondition::default();
    assert_eq!(run(well), 2458);
    assert_eq!(run(SensorCondition { gain: -1.0, ..well }), -2458);
    assert_eq!(
        run(SensorCondition {
            stuck: true,
            ..well
        }),
        1638
    );
    assert_eq!(
        run(SensorCondition {
            dropped: true,
            ..well
        }),
        0
    );
    assert_eq!(
        run(SensorCondition {
            saturated: Some(End::High),
            ..well
        }),
        FULL_CODE
    );
    assert_eq!(
        run(SensorCondition {
            saturated: Some(End::Low),
            ..well
        }),
        -FULL_CODE - 1
    );
    // 5 N/s for a second.
    assert_eq!(
        run(SensorCondition {
            drift_n_s: 5.0,
            ..well
        }),
        2867
    );
}

#[test]
fn the_same_seed_gives_the_same_codes() {
    let run = || {
        let mut sensor = sensor(&SensorConfig::default());
        let mut codes = Vec::new();
        for step in 0..1000 {
            let wave = (f64::from(step) * 0.05).sin();
            sensor.sample([-8.0 * wave, 3.0 * wave, -wave], down(10.0 * wave));
            codes.push(sensor.codes());
        }
        codes
    };
    assert_eq!(run(), run());
}

#[test]
fn an_invalid_configuration_is_refused() {
    for config in [
        SensorConfig {
            full_scale_n: 0.0,
            ..SensorConfig::default()
        },
        SensorConfig {
            range_n: f64::NAN,
            ..SensorConfig::default()
        },
        SensorConfig {
            high_pass_s: -1.0,
            ..SensorConfig::default()
        },
        SensorConfig {
            noise_n: f64::INFINITY,
            ..SensorConfig::default()
        },
    ] {
        assert_eq!(config.check().expect_err("invalid").len(), 1, "{config:?}");
    }
    assert!(SensorConfig::default().check().is_ok() && SensorConfig::ideal().check().is_ok());
}
