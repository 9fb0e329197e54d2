//! Position loop against f64: equation, poles, friction, limits.

use haptimill_firmware::config::{ServoConfig, ServoForm};
use haptimill_firmware::joint::friction::Friction;
use haptimill_firmware::joint::servo::ServoLaw;
use haptimill_firmware::rate_filter::{RATE_FRACTION, RateFilter, approach};
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const MM: f64 = 1048576.0;
const NEWTON: f64 = 65536.0;
const MASS: f64 = 40.0;
/// Newton for kg mm/s^2.
const MILLI: f64 = 1e-3;

/// Effort units per acceleration unit for 1 kg: 2^-12 mm/s^2 is 2^-12 * 1e-3 N.
fn law(form: ServoForm, kp: f64, kd: f64, filter_us: u16) -> ServoConfig {
    ServoConfig {
        form,
        kp: Gain((kp * 256.0) as u32),
        kd: Gain((kd * 256.0) as u32),
        rate_filter_us: filter_us,
        inertia: (MASS * MILLI * 65536.0 / 4096.0 * 1048576.0) as u32,
        viscous: 0,
        coulomb: Effort(0),
        coulomb_rate: Rate(0),
        ki: Gain(0),
        friction_adaptation_ms: 0,
    }
}

fn coordinate(mm: f64) -> Coordinate {
    Coordinate((mm * MM).round() as i32)
}

fn rate(mm_s: f64) -> Rate {
    Rate((mm_s * MM).round() as i32)
}

/// A mass on a guideway, exactly integrated under a constant force, mm, mm/s.
#[derive(Clone, Copy, Default)]
struct Slide {
    position: f64,
    rate: f64,
}

impl Slide {
    fn push(&mut self, newton: f64, time: f64) {
        let acceleration = newton / MASS / MILLI;
        self.position += self.rate * time + acceleration * time * time / 2.0;
        self.rate += acceleration * time;
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(4), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn filter_pole_is_the_exponential(period in 50u16..=1000, time in 1u16..) {
        let exact = -libm::expm1(-f64::from(period) / f64::from(time));
        let given = f64::from(approach(period, time)) / 4294967296.0;
        prop_assert!((given - exact).abs() < f64::exp2(-28.0), "{given} {exact}");
    }

    #[test]
    fn filtered_rates_sum_to_the_change(period in 50u16..=1000, time: u16, signal in prop::collection::vec(any::<i32>(), 1..40)) {
        let mut filter = RateFilter::new(period, time);
        filter.rest(0);
        let (mut sum, mut last) = (0.0, 0);
        for value in signal {
            // Not faster than the maximum rate: 2^36 a second, 3.4e6 in 50 us.
            last = value >> 12;
            sum += filter.rate(last) as f64 / f64::from(1 << RATE_FRACTION) * f64::from(period) * 1e-6;
        }
        for _ in 0..(f64::from(time) / f64::from(period) * 40.0) as u32 + 3 {
            sum += filter.rate(last) as f64 / f64::from(1 << RATE_FRACTION) * f64::from(period) * 1e-6;
        }
        // What is left is the rounding of the frequency and of each rate.
        prop_assert!((sum - f64::from(last)).abs() < 2.0, "{sum} {last}");
    }

    #[test]
    fn friction_is_tanh(coulomb in 0i32.., knee in 1i32.., commanded: i32, fine in -6.0f64..6.0) {
        let friction = Friction::new(Effort(coulomb), Rate(knee));
        for commanded in [commanded, (f64::from(knee) * fine) as i32] {
            let exact = f64::from(coulomb) * libm::tanh(f64::from(commanded) / f64::from(knee));
            let given = friction.effort(Rate(commanded), Effort(0)).0;
            prop_assert!((f64::from(given) - exact).abs() <= 4e-4 * f64::from(coulomb) + 1.0, "{given} {exact}");
            prop_assert_eq!(given, -friction.effort(Rate(commanded.saturating_neg()), Effort(0)).0);
            if commanded < i32::MAX {
                prop_assert!(friction.effort(Rate(commanded + 1), Effort(0)).0 >= given);
            }
        }
    }

    /// Fixed point against the same law in f64, over a smooth error with encoder steps on it.
    #[test]
    fn fixed_point_matches_the_f64_law(
        form in prop::sample::select(vec![ServoForm::Pd, ServoForm::ModelBased]),
        kp in 100.0f64..60000.0, kd in 5.0f64..800.0, ki in 0.0f64..1e6, filter_us in 0u16..6000, period in 50u16..=1000,
        viscous in 0.0f64..2.0, coulomb in 0.0f64..60.0, knee in 0.05f64..3.0,
        amplitude in 0.0f64..0.05, frequency in 0.1f64..40.0, speed in -60.0f64..60.0, pull in -500.0f64..500.0,
    ) {
        let mut config = law(form, kp, kd, filter_us);
        // N per mm/s to effort units per rate unit.
        config.viscous = (viscous * NEWTON / MM * 16777216.0) as u32;
        config.coulomb = Effort((coulomb * NEWTON) as i32);
        config.coulomb_rate = rate(knee);
        config.ki = Gain((ki * 256.0) as u32);
        let mut fixed = ServoLaw::new(&config, Effort(i32::MAX), period, Coordinate(0));
        fixed.reset(Coordinate(0));
        let step = f64::from(period) * 1e-6;
        let pole = if filter_us == 0 { 0.0 } else { libm::exp(-step / (f64::from(filter_us) * 1e-6)) };
        let inertia = f64::from(config.inertia) / 1048576.0 * 4096.0 / 65536.0;
        let (mut low, mut integral) = (0.0, 0.0);
        for k in 0..300 {
            let time = f64::from(k) * step;
            let error = amplitude * libm::sin(frequency * time);
            let error = coordinate((error / 0.00125).round() * 0.00125);
            let (commanded_rate, wanted_acceleration) = (rate(speed * libm::cos(time)), Acceleration((pull * 4096.0) as i32));
            let (effort, saturated) = fixed.effort(error, commanded_rate, wanted_acceleration);

            let e = f64::from(error.0) / MM;
            let change = (1.0 - pole) * (e - low);
            low += change;
            let v = f64::from(commanded_rate.0) / MM;
            let mut a = f64::from(config.kp.0) / 256.0 * e + f64::from(config.kd.0) / 256.0 * change / step + integral;
            let mut exact = coulomb * libm::tanh(v / knee);
            if form == ServoForm::ModelBased {
                a += f64::from(wanted_acceleration.0) / 4096.0;
                exact += viscous * v;
            }
            exact += inertia * a;
            integral += f64::from(config.ki.0) / 256.0 * step * e;
            let given = f64::from(effort.0) / NEWTON;
            let bound = 2e-3 + 4e-4 * coulomb + 1e-6 * inertia * a.abs() + 1e-4 * inertia * integral.abs() + 1e-4 * (viscous * v).abs();
            prop_assert!((given - exact).abs() <= bound, "{given} {exact} bound {bound}");
            prop_assert!(!saturated);
        }
    }

    #[test]
    fn output_stays_within_its_limit(
        kp: u32, kd: u32, ki: u32, rate_filter_us: u16, inertia: u32, viscous: u32, coulomb: i32, coulomb_rate: i32, limit: i32, period: u16, friction_adaptation_ms: u16, count: i32,
        frames in prop::collection::vec(any::<(i32, i32, i32)>(), 1..60),
    ) {
        for form in [ServoForm::Pd, ServoForm::ModelBased] {
            let config = ServoConfig { form, kp: Gain(kp), kd: Gain(kd), rate_filter_us, inertia, viscous, coulomb: Effort(coulomb), coulomb_rate: Rate(coulomb_rate), ki: Gain(ki), friction_adaptation_ms };
            let mut law = ServoLaw::new(&config, Effort(limit), period, Coordinate(count));
            for &(error, rate, acceleration) in &frames {
                let (effort, _) = law.effort(Coordinate(error), Rate(rate), Acceleration(acceleration));
                prop_assert!(effort.0.unsigned_abs() <= limit.unsigned_abs());
            }
        }
    }
}

/// (3.38): from 1 mm off, at rest, the error is that of e'' + K_D e' + K_P e = 0, for three
/// dampings.
#[test]
fn error_decays_with_the_designed_poles() {
    let period = 50u16;
    let step = f64::from(period) * 1e-6;
    for (omega, zeta) in [(60.0, 1.0), (60.0, 0.5), (100.0, 0.7)] {
        let config = law(ServoForm::ModelBased, omega * omega, 2.0 * zeta * omega, 0);
        let mut law = ServoLaw::new(&config, Effort(i32::MAX), period, Coordinate(0));
        law.reset(coordinate(1.0));
        let mut slide = Slide {
            position: -1.0,
            rate: 0.0,
        };
        let mut worst = 0.0f64;
        for k in 0..12_000 {
            let t = f64::from(k) * step;
            let damped = omega * (1.0f64 - zeta * zeta).sqrt();
            let exact = if zeta == 1.0 {
                (1.0 + omega * t) * (-omega * t).exp()
            } else {
                (-zeta * omega * t).exp()
                    * ((damped * t).cos() + zeta * omega / damped * (damped * t).sin())
            };
            worst = worst.max((-slide.position - exact).abs());
            let (effort, _) = law.effort(coordinate(-slide.position), Rate(0), Acceleration(0));
            slide.push(f64::from(effort.0) / NEWTON, step);
        }
        // A period of hold and difference is a delay of one period: omega T / 2 of the error's
        // size.
        assert!(worst < omega * step, "{omega} {zeta}: {worst}");
        assert!(slide.position.abs() < 1e-4);
    }
}

/// The derivative is on the rate of the error: a ramp leaves no lag, where -K_D l' alone would
/// trail by K_D / K_P of travel.
#[test]
fn ramp_has_no_steady_error() {
    for form in [ServoForm::Pd, ServoForm::ModelBased] {
        let config = law(form, 40_000.0, 400.0, 1500);
        let mut law = ServoLaw::new(&config, Effort(i32::MAX), 200, Coordinate(0));
        law.reset(Coordinate(0));
        let mut slide = Slide::default();
        let speed = 20.0;
        for k in 0..5000 {
            let error = speed * f64::from(k) * 200e-6 - slide.position;
            let (effort, _) = law.effort(coordinate(error), rate(speed), Acceleration(0));
            slide.push(f64::from(effort.0) / NEWTON, 200e-6);
            if k > 1000 {
                assert!(
                    error.abs() < 1e-4,
                    "{form:?}: {error} mm, lag of the other form {}",
                    speed * 400.0 / 40_000.0
                );
            }
        }
    }
}

/// The printed sign of (3.29) would push a slide that already moves; this one brakes it, and a kick
/// dies away.
#[test]
fn derivative_term_damps() {
    let config = law(ServoForm::Pd, 3600.0, 120.0, 1500);
    let mut law = ServoLaw::new(&config, Effort(i32::MAX), 200, Coordinate(0));
    law.reset(Coordinate(0));
    let mut slide = Slide {
        position: 0.0,
        rate: 10.0,
    };
    let mut first = None;
    let mut largest = 0.0f64;
    for k in 0..5000 {
        let (effort, _) = law.effort(coordinate(-slide.position), Rate(0), Acceleration(0));
        if k == 5 {
            first = Some(effort.0);
        }
        slide.push(f64::from(effort.0) / NEWTON, 200e-6);
        largest = largest.max(slide.position.abs());
    }
    assert!(first.unwrap() < 0);
    assert!(slide.position.abs() < 1e-5 && slide.rate.abs() < 1e-3);
    // v / (e omega_n), a little more for the filter and the delay.
    assert!(
        largest < 1.1 * 10.0 / (60.0 * core::f64::consts::E),
        "{largest}"
    );
}

/// The integrator cancels a constant load, is held at its limit, and leaves the limit at once.
#[test]
fn integrator_does_not_wind_up() {
    let mut config = law(ServoForm::Pd, 40_000.0, 400.0, 1500);
    config.ki = Gain(1_000_000 * 256);
    let limit = 400.0;
    let mut law = ServoLaw::new(&config, Effort((limit * NEWTON) as i32), 200, Coordinate(0));
    law.reset(Coordinate(0));
    let mut slide = Slide::default();
    for _ in 0..10_000 {
        let (effort, _) = law.effort(coordinate(-slide.position), Rate(0), Acceleration(0));
        slide.push(f64::from(effort.0) / NEWTON - 100.0, 200e-6);
    }
    assert!(
        slide.position.abs() < 1e-5,
        "{} mm left under a load of 100 N",
        slide.position
    );

    // Jammed 5 mm away for 2 s, at the limit all the time.
    let settled = law.clone();
    for _ in 0..10_000 {
        let (effort, saturated) = law.effort(coordinate(5.0), Rate(0), Acceleration(0));
        assert!(saturated && f64::from(effort.0) == limit * NEWTON);
    }
    // With the error gone and its rate died away, what is left is the integrator: what it was
    // before.
    let left = |mut law: ServoLaw| {
        (0..200)
            .map(|_| law.effort(Coordinate(0), Rate(0), Acceleration(0)).0.0)
            .last()
            .unwrap()
    };
    let wound = f64::from(left(law) - left(settled)) / NEWTON;
    assert!(wound.abs() < 1.0, "wound up by {wound} N");
}

#[test]
fn reset_is_bumpless() {
    let mut law = ServoLaw::new(
        &law(ServoForm::ModelBased, 40_000.0, 400.0, 1500),
        Effort(i32::MAX),
        200,
        Coordinate(0),
    );
    for k in 0..100 {
        law.effort(Coordinate(k * 100_000), Rate(0), Acceleration(0));
    }
    law.reset(Coordinate(0));
    assert_eq!(
        law.effort(Coordinate(0), Rate(0), Acceleration(0)),
        (Effort(0), false)
    );
    // Where it starts with an error, only K_P answers.
    law.reset(Coordinate(1 << 20));
    let (effort, _) = law.effort(Coordinate(1 << 20), Rate(0), Acceleration(0));
    assert!((f64::from(effort.0) / NEWTON - 40_000.0 * MASS * MILLI).abs() < 0.01);
}

/// A slide with Coulomb friction that follows a sine, and then rests. Returns the largest error in
/// the second half of the sine in mm, and the reversals of its motion at rest.
fn follow_sine(adaptation_ms: u16, count: f64) -> (f64, usize) {
    const PERIOD: f64 = 200e-6;
    let mut config = law(ServoForm::ModelBased, 40_000.0, 400.0, 1500);
    config.ki = Gain(1_000_000 * 256);
    config.coulomb = Effort((30.0 * NEWTON) as i32);
    config.coulomb_rate = rate(0.02);
    config.friction_adaptation_ms = adaptation_ms;
    let limit = Effort((750.0 * NEWTON) as i32);
    let mut law = ServoLaw::new(&config, limit, 200, coordinate(count));
    law.reset(Coordinate(0));
    // The true friction is a third larger than the configured one.
    let friction = 40.0;
    let (mut position, mut speed) = (0.0f64, 0.0f64);
    let (amplitude, turn) = (15.0, 4.0 / 15.0);
    let moving = 2.0 * core::f64::consts::TAU / turn;
    let (mut largest, mut reversals, mut last) = (0.0f64, 0, (0i64, 0i64));
    for k in 0..((moving + 20.0) / PERIOD) as u32 {
        let time = f64::from(k) * PERIOD;
        let angle = turn * time.min(moving);
        let running = f64::from(u8::from(time < moving));
        let target = amplitude * (1.0 - libm::cos(angle));
        let target_rate = running * amplitude * turn * libm::sin(angle);
        let target_acceleration = running * amplitude * turn * turn * libm::cos(angle);
        let counted = (position / count).floor() as i64;
        let (effort, _) = law.effort(
            coordinate(target - counted as f64 * count),
            rate(target_rate),
            Acceleration((target_acceleration * 4096.0) as i32),
        );
        // Coulomb friction as an impulse that ends at rest.
        let pushed = speed + f64::from(effort.0) / NEWTON / MASS / MILLI * PERIOD;
        let max = friction / MASS / MILLI * PERIOD;
        speed = pushed - pushed.clamp(-max, max);
        position += speed * PERIOD;
        if time > moving / 2.0 && time < moving {
            largest = largest.max((target - position).abs());
        }
        if time > moving + 2.0 && counted != last.0 {
            let direction = (counted - last.0).signum();
            reversals += usize::from(direction == -last.1);
            last.1 = direction;
        }
        last.0 = counted;
    }
    (largest, reversals)
}

/// The friction estimate removes the spike at a reversal that the integrator alone leaves, and the
/// dead band keeps the slide at rest.
#[test]
fn friction_adaptation_removes_reversal_spikes() {
    let count = 0.00125;
    let (integrator_alone, _) = follow_sine(0, count);
    let (adapted, reversals) = follow_sine(300, count);
    assert!(
        adapted < integrator_alone / 2.0,
        "{adapted} mm, with the integrator alone {integrator_alone} mm"
    );
    assert!(adapted < 2.5 * count, "{adapted} mm");
    assert_eq!(reversals, 0, "the slide hunts at rest");
}
