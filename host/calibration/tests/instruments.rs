//! Instruments: targets and evaluation of ISO 230-2, laser, circle test, measuring machine.

use haptimill_calibration::ball_bar::{CircleTest, evaluate as evaluate_circle};
use haptimill_calibration::calibrate::{Conditions, of_readings};
use haptimill_calibration::cut::{Cmm, MPE_P, mpe_e};
use haptimill_calibration::laser::{Channel, Environment, Laser, LaserOptions};
use haptimill_calibration::noise::Noise;
use haptimill_calibration::observed::Sample;
use haptimill_calibration::targets::{RUNS, evaluate, mean_and_deviation, targets};
use haptimill_volumetric::Vector;
use haptimill_volumetric::chain::Model;
use haptimill_volumetric::errors::{Axis, ErrorSet, Function, Kind, Shape, Squareness};
use haptimill_volumetric::part::{Row, probe_points};
use haptimill_volumetric::readings::{FunctionReadings, Readings};

fn deviation(values: &[f64]) -> f64 {
    mean_and_deviation(values).1
}

/// Row 13: five targets a metre at least, the interval of 250 mm beyond 2 m, a random part of 30 %
/// of the interval at each target, within the travel.
#[test]
fn target_positions() {
    for (low, high, interval) in [
        (-325.0, 325.0, 20.0),
        (0.0, 1000.0, 900.0),
        (0.0, 3000.0, 50.0),
    ] {
        for seed in 0..50 {
            let places = targets((low, high), interval, &mut Noise::new(seed, 0));
            let travel = high - low;
            if travel <= 2000.0 {
                assert!(places.len() as f64 >= 5.0 * travel / 1000.0);
            }
            assert!(places.windows(2).all(|pair| pair[0] < pair[1]));
            assert!(low <= places[0] && places[places.len() - 1] <= high);
            let spans = places.len() - 1;
            let margin = 0.3 / (spans as f64 + 0.6);
            let pitch = travel * (1.0 - 2.0 * margin) / spans as f64;
            for (index, place) in places.iter().enumerate() {
                let even = low + travel * margin + pitch * index as f64;
                assert!((place - even).abs() <= 0.3 * pitch + 1e-6);
            }
            if travel > 2000.0 {
                assert!((200.0..260.0).contains(&pitch), "{pitch}");
            }
        }
    }
    // The random part is uniform within 30 % of the interval: its deviation is 0.3 p / sqrt(3).
    // One part for all targets of a cycle would have the deviation 0 within each seed.
    let mut parts = Vec::new();
    for seed in 0..200 {
        let places = targets((-325.0, 325.0), 20.0, &mut Noise::new(seed, 0));
        let spans = (places.len() - 1) as f64;
        let margin = 0.3 / (spans + 0.6);
        let pitch = 650.0 * (1.0 - 2.0 * margin) / spans;
        let even = places.iter().enumerate();
        let own: Vec<f64> = even
            .map(|(index, place)| (place + 325.0 - 650.0 * margin - pitch * index as f64) / pitch)
            .collect();
        assert!(deviation(&own) > 0.1, "{seed}: {own:?}");
        parts.extend(own);
    }
    let expected = 0.3 / 3.0_f64.sqrt();
    assert!((deviation(&parts) / expected - 1.0).abs() < 0.05);
    let one = targets((-325.0, 325.0), 20.0, &mut Noise::new(1, 0));
    let other = targets((-325.0, 325.0), 20.0, &mut Noise::new(2, 0));
    assert_ne!(one, other);
}

/// The evaluation of ISO 230-2 against numbers computed by hand.
#[test]
fn evaluation() {
    let up = vec![vec![1.0, 2.0, 3.0], vec![0.0, 0.0, 0.0]];
    let down = vec![vec![4.0, 5.0, 6.0], vec![-1.0, -1.0, -1.0]];
    let result = evaluate(&up, &down);
    // Means 2 and 5, 0 and -1; deviations 1 and 1, 0 and 0.
    assert_eq!(result.reversal, 3.0);
    assert_eq!(result.repeatability, 7.0);
    assert_eq!(result.accuracy, 7.0 - -1.0);
    assert_eq!(result.systematic, 6.0);
    assert_eq!(result.range, 3.5 - -0.5);
}

/// Rows 14 to 16: readings scatter as the data sheet says, about the truth.
#[test]
fn noise_of_the_channels() {
    let options = LaserOptions::default();
    let readings = |channel, truth, path| -> Vec<f64> {
        let read = |run| {
            Laser::new(&options, run)
                .read(channel, truth, path)
                .unwrap()
        };
        (0..4000).map(read).collect()
    };
    let check = |channel, truth: f64, path, two: f64| {
        let all = readings(channel, truth, path);
        let (mean, s) = mean_and_deviation(&all);
        assert!((mean - truth).abs() < two / 20.0, "{channel:?} {mean}");
        assert!((2.0 * s / two - 1.0).abs() < 0.06, "{channel:?} {s}");
    };
    let linear = (0.05e-3_f64.powi(2) + (0.7e-6 * 500.0_f64).powi(2)).sqrt();
    check(Channel::Linear, 2e-3, 500.0, linear);
    check(Channel::Straightness, 0.0, 0.0, 0.5e-3);
    check(Channel::Angle, 0.0, 0.0, 0.5e-6);
    check(Channel::Roll, 3e-6, 0.0, 1e-6);
}

/// Row 17: no laser measures roll.
#[test]
fn roll_needs_its_own_instrument() {
    let options = LaserOptions {
        roll: None,
        ..LaserOptions::default()
    };
    let refused = Laser::new(&options, 0)
        .read(Channel::Roll, 1e-6, 0.0)
        .unwrap_err();
    assert!(
        refused
            .to_string()
            .contains("a laser does not measure roll")
    );
}

/// Row 19: a kelvin without correction is 0.93 ppm.
#[test]
fn refractive_index() {
    let warm = Environment {
        air_c: 21.0,
        ..Environment::default()
    };
    assert!((warm.wavelength_change() - 0.93e-6).abs() < 1e-12);
    let options = LaserOptions {
        environment: warm,
        corrects_wavelength: false,
        ..LaserOptions::ideal()
    };
    let read = |options: &LaserOptions| {
        Laser::new(options, 0)
            .read(Channel::Linear, 0.0, 500.0)
            .unwrap()
    };
    assert!((read(&options) + 0.465e-3).abs() < 1e-9);
    let corrected = LaserOptions {
        corrects_wavelength: true,
        ..options
    };
    assert_eq!(read(&corrected), 0.0);
    // Row 18: 2 um per metre and kelvin.
    let hot = Environment {
        machine_c: 23.0,
        ..Environment::default()
    };
    assert!((hot.expansion_uncertainty(1000.0) - 6e-3).abs() < 1e-12);
}

/// Row 18: the coefficient of expansion adds 2 um per metre and kelvin, two standard deviations, to
/// lengths alone. It is the same in all runs of a calibration, so their mean keeps it.
#[test]
fn expansion_of_the_machine() {
    let at = |machine_c: f64, seed: u64| LaserOptions {
        expansion: LaserOptions::default().expansion,
        environment: Environment {
            machine_c,
            ..Environment::default()
        },
        seed,
        ..LaserOptions::ideal()
    };
    let read = |channel, options: &LaserOptions, run| {
        Laser::new(options, run).read(channel, 0.0, 1000.0).unwrap()
    };
    let warm: Vec<f64> = (0..4000)
        .map(|seed| read(Channel::Linear, &at(23.0, seed), 0))
        .collect();
    let (mean, s) = mean_and_deviation(&warm);
    assert!(
        (2.0 * s / 6e-3 - 1.0).abs() < 0.05 && mean.abs() < 0.2e-3,
        "{mean} {s}"
    );
    for seed in 0..20 {
        assert_eq!(read(Channel::Linear, &at(20.0, seed), 0), 0.0);
        let runs = [1, 2, 105].map(|run| read(Channel::Linear, &at(23.0, seed), run));
        assert!(
            runs.iter().all(|run| *run == runs[0] && *run != 0.0),
            "{runs:?}"
        );
        // Below 20 degrees the same coefficient has the opposite effect.
        let cold = read(Channel::Linear, &at(17.0, seed), 1);
        assert!((cold + runs[0]).abs() < 1e-15);
        for channel in [Channel::Straightness, Channel::Angle, Channel::Roll] {
            assert_eq!(read(channel, &at(23.0, seed), 1), 0.0);
        }
    }
}

/// Row 20: the table of five runs in both directions scatters less than that of one, by the root of
/// five. The machine has no errors.
#[test]
fn runs_are_averaged() {
    let targets: Vec<f64> = (0..2000)
        .map(|place| f64::from(place) * 0.3 - 300.0)
        .collect();
    let straightness = Function::all()
        .find(|function| function.moving == Axis::X && function.kind() == Kind::Straightness)
        .unwrap();
    let table = |runs: u64, set: u64| {
        let read = |laser: u64| -> Vec<Vec<f64>> {
            let mut lasers: Vec<Laser> = (0..runs)
                .map(|run| {
                    Laser::new(
                        &LaserOptions::default(),
                        1000 * set + 100 * runs + 2 * run + laser,
                    )
                })
                .collect();
            let read = |laser: &mut Laser, at| laser.read(Channel::Straightness, 0.0, at).unwrap();
            targets
                .iter()
                .map(|at| lasers.iter_mut().map(|laser| read(laser, *at)).collect())
                .collect()
        };
        let function = FunctionReadings {
            function: straightness,
            targets: targets.clone(),
            lines: vec![1; targets.len()],
            up: read(0),
            down: read(1),
        };
        let readings = Readings {
            functions: vec![function],
            squareness: Squareness::default(),
        };
        let travel = [(-300.0, 300.0); 3];
        let (errors, _) = of_readings(&readings, &travel, &Conditions::default());
        let Shape::Table(table) = errors.function(straightness) else {
            panic!("a table");
        };
        deviation(&table.up)
    };
    let scatter = |runs| (0..8).map(|set| table(runs, set)).sum::<f64>();
    let ratio = scatter(1) / scatter(RUNS as u64);
    assert!((ratio / 5.0_f64.sqrt() - 1.0).abs() < 0.03, "{ratio}");
}

/// A circle of a machine whose only error is a squareness, and whose path is exact: the test finds
/// the angle, and twice its effect on the radius as deviation.
#[test]
fn circle_test_finds_squareness() {
    let mut set = ErrorSet::default();
    set.squareness = Squareness {
        c0y: 25e-6,
        ..Squareness::default()
    };
    let test = CircleTest {
        noise: 0.0,
        ..CircleTest::at(30.0)
    };
    let mut samples = Vec::new();
    for direction in [1.0, -1.0] {
        for step in 0..=7200 {
            let angle = direction * f64::from(step) / 3600.0 * std::f64::consts::TAU + 3.0;
            let commanded = [100.0 * angle.cos(), 100.0 * angle.sin(), 0.0, 0.0, 0.0, 0.0];
            let place = Vector::new(commanded[0], commanded[1], 0.0);
            let error = Model::default().error(&set, place);
            let tool = std::array::from_fn(|axis| {
                commanded[axis] + if axis < 3 { error[axis] } else { 0.0 }
            });
            samples.push(Sample {
                time: 0.0,
                commanded,
                reported: commanded,
                tool,
                carriages: commanded,
            });
        }
    }
    let result = evaluate_circle(&samples, &test).unwrap();
    assert!((result.squareness - 25e-6).abs() < 0.1e-6, "{result:?}");
    // The radius changes by +-c0y r / 2.
    assert!((result.deviation[0] - 2.5e-3).abs() < 0.01e-3);
    assert!(result.hysteresis < 0.05e-3);
    // Half of the circle is no circle test.
    assert!(evaluate_circle(&samples[..1500], &test).is_none());
}

/// A circle whose x is behind by 1 um in the direction of its motion, 2 um of lost motion: the
/// radius is 1 um |cos| smaller where x moves inwards in one direction and 1 um |cos| larger in the
/// other, so H and the range of F are 2 um. A radius that is 3 um too large adds to F alone.
#[test]
fn circle_test_finds_hysteresis() {
    let test = CircleTest {
        noise: 0.0,
        ..CircleTest::at(30.0)
    };
    for larger in [0.0, 3e-3] {
        let mut samples = Vec::new();
        for direction in [1.0, -1.0] {
            for step in 0..=7200 {
                let angle = direction * f64::from(step) / 3600.0 * std::f64::consts::TAU + 3.0;
                let (sine, cosine) = angle.sin_cos();
                let place = |radius: f64| [radius * cosine, radius * sine, 0.0, 0.0, 0.0, 0.0];
                let mut tool = place(100.0 + larger);
                // x moves by -sine times the direction.
                tool[0] -= 1e-3 * (-sine * direction).signum();
                samples.push(Sample {
                    time: 0.0,
                    commanded: place(100.0),
                    reported: place(100.0),
                    tool,
                    carriages: place(100.0),
                });
            }
        }
        let result = evaluate_circle(&samples, &test).unwrap();
        assert!((result.hysteresis - 2e-3).abs() < 0.005e-3, "{result:?}");
        let [max, min] = result.radial;
        assert!((max - larger - 1e-3).abs() < 0.005e-3, "{max}");
        assert!((min - larger + 1e-3).abs() < 0.005e-3, "{min}");
    }
}

/// Rows 23 and 24: without errors and noise nothing deviates; with noise and set-up errors the
/// points scatter, and the characteristics stay near zero because they do not depend on the set-up.
#[test]
fn measuring_machine() {
    let exact = probe_points().map(|point| point.surface);
    for row in Cmm::ideal().measure(&exact).unwrap() {
        assert!(row.value.abs() < 1e-9, "{row:?}");
    }
    let runs = Cmm::default().probe(&exact);
    assert_eq!((runs.len(), runs[0].sides[0].len()), (3, 15));
    assert!(runs[0].sides[0] != runs[1].sides[0]);
    for row in Cmm::default().measure(&exact).unwrap() {
        assert!(row.value.abs() < 4e-3, "{row:?}");
    }
    // A set-up error without noise leaves nothing.
    let turned = Cmm {
        noise: [0.0; 2],
        ..Cmm::default()
    };
    for row in turned.measure(&exact).unwrap() {
        assert!(row.value.abs() < 1e-6, "{row:?}");
    }
    // A tolerance of 10 um: 12 um fail.
    let row = |value| Row {
        name: String::new(),
        value,
        zone: None,
        tolerance: Some(0.010),
    };
    assert!(row(2.42e-3).passes() && row(1.41e-3).passes() && !row(12e-3).passes());
    // The scatter along the normal is that of the published tables.
    let many = Cmm {
        runs: 100,
        set_up: (0.0, 0.0),
        ..Cmm::default()
    };
    for (side, expected) in [(0, 0.455e-3), (3, 0.389e-3)] {
        let runs = many.probe(&exact);
        let points = runs
            .iter()
            .flat_map(|run| run.sides[side].iter().zip(&exact.sides[side]));
        let off: Vec<f64> = points.map(|(read, exact)| (read - exact).sum()).collect();
        assert!((deviation(&off) / expected - 1.0).abs() < 0.05);
    }
    // Row 40: capability.
    assert!((mpe_e(160.0) - 2.38e-3).abs() < 1e-9 && MPE_P < mpe_e(1.0));
}

/// Index of refraction of air by Edlen's equation as revised by Birch and Downs (Metrologia 30,
/// 1993), at 0.633 um: temperature in degrees Celsius, pressures of air and of water vapour in Pa.
fn index_of_air(celsius: f64, pascal: f64, vapour: f64) -> f64 {
    let wave_number = 1.0 / (0.633 * 0.633);
    let standard =
        1e-8 * (8342.54 + 2_406_147.0 / (130.0 - wave_number) + 15_998.0 / (38.9 - wave_number));
    let dry = standard * pascal / 96_095.43 * (1.0 + 1e-8 * (0.601 - 0.00972 * celsius) * pascal)
        / (1.0 + 0.003_661 * celsius);
    1.0 + dry - vapour * (3.7345 - 0.0401 * wave_number) * 1e-10
}

/// The wavelength in the air changes with temperature, pressure and humidity as the index of
/// refraction tells, in sign and size.
#[test]
fn the_wavelength_follows_the_index_of_refraction() {
    let stated = Environment::default();
    let change = |air_c: f64, pressure_hpa: f64, humidity_percent: f64| {
        // Pressure of saturated vapour at 20 degrees, at which the humidity changes alone.
        let index = |air: f64, hpa: f64, humidity: f64| {
            index_of_air(air, 100.0 * hpa, 2339.0 * humidity / 100.0)
        };
        let [air, hpa, humidity] = [stated.air_c, stated.pressure_hpa, stated.humidity_percent];
        let expected = index(air, hpa, humidity) / index(air_c, pressure_hpa, humidity_percent);
        let environment = Environment {
            air_c,
            pressure_hpa,
            humidity_percent,
            ..stated
        };
        (environment.wavelength_change(), expected - 1.0)
    };
    for (air_c, hpa, humidity, tolerance) in [
        (
            stated.air_c + 3.0,
            stated.pressure_hpa,
            stated.humidity_percent,
            0.04,
        ),
        (
            stated.air_c,
            stated.pressure_hpa + 20.0,
            stated.humidity_percent,
            0.04,
        ),
        (
            stated.air_c,
            stated.pressure_hpa,
            stated.humidity_percent + 30.0,
            0.2,
        ),
    ] {
        let (ours, expected) = change(air_c, hpa, humidity);
        assert!(
            (ours / expected - 1.0).abs() < tolerance,
            "{air_c} {hpa} {humidity}: {ours:e}, {expected:e}"
        );
    }
}
