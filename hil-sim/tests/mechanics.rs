//! Masses, screws and friction against conservation laws and closed formulas.

use crate::machine;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};
use haptimill_hil_sim::joint::mechanics::{Bodies, Mechanics};
use haptimill_hil_sim::joint::{DriveConfig, SwitchConfig, SwitchSide};
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_hil_sim::{Plant, PlantConfig};
use proptest::prelude::*;

const STEP: f64 = 20e-6;
const NONE: [f64; 6] = [0.0; 6];

fn torque(code: i16) -> Outputs {
    let mut outputs = Outputs::default();
    outputs.joints[0] = DriveCommand::Torque(code);
    outputs
}

fn mechanics(config: &PlantConfig) -> Mechanics {
    Mechanics::new(&config.joint, STEP)
}

#[test]
fn the_screw_mode_has_its_configured_frequency() {
    for expected in [40.0, 80.0, 200.0] {
        let mut config = machine::ideal_slide();
        config.joint[0].mode_hz = expected;
        config.joint[0].motor_share = 0.3;
        let mechanics = mechanics(&config);
        let mut bodies = Bodies::default();
        bodies.motor[0] = 0.01;
        // Time of 40 half periods, from one change of sign of the twist to the 41st.
        let (mut first, mut last, mut crossings) = (None, 0.0, 0);
        let mut before = bodies.motor[0] - bodies.slide[0];
        for step in 0.. {
            mechanics.step(&mut bodies, &NONE, &NONE);
            let twist = bodies.motor[0] - bodies.slide[0];
            if twist * before < 0.0 {
                last = (f64::from(step) + before / (before - twist)) * STEP;
                first.get_or_insert(last);
                crossings += 1;
                if crossings == 41 {
                    break;
                }
            }
            before = twist;
        }
        let measured = 20.0 / (last - first.expect("swings"));
        assert!(
            (measured / expected - 1.0).abs() < 0.002,
            "{measured} Hz, not {expected}"
        );
    }
}

#[test]
fn the_screw_mode_has_its_configured_damping() {
    let mut config = machine::ideal_slide();
    config.joint[0].mode_damping = 0.05;
    let mechanics = mechanics(&config);
    let mut bodies = Bodies::default();
    bodies.motor[0] = 0.01;
    let start = mechanics.energy(&bodies, 0);
    let periods = 4.0;
    let damped = 80.0 * (1.0_f64 - 0.05 * 0.05).sqrt();
    for _ in 0..(periods / damped / STEP).round() as u32 {
        mechanics.step(&mut bodies, &NONE, &NONE);
    }
    // The energy decays by exp(-2 zeta omega t); the centre of mass does not move.
    let ratio = (mechanics.energy(&bodies, 0) / start).ln();
    let expected = -2.0 * 0.05 * std::f64::consts::TAU * 80.0 * periods / damped;
    assert!((ratio / expected - 1.0).abs() < 0.02, "{ratio} {expected}");
}

#[test]
fn a_joint_sticks_below_the_coulomb_force_and_moves_above() {
    let config = machine::slide();
    let mut plant = Plant::new(&config, 200).expect("a slide");
    // The motor side alone holds 20 N: 19.9 N never moves it, to the last bit.
    let code = (19.9 / 800.0 * 8192.0) as i16;
    for _ in 0..5000 {
        plant.advance(&torque(code));
    }
    assert_eq!(plant.bodies().motor_rate[0], 0.0);
    assert_eq!(plant.bodies().motor[0], 0.0);
    // Raised slowly to 39 N, the motor takes up the backlash and winds the screw against the slide,
    // which still sticks.
    for step in 0..20_000 {
        let newton = 19.9 + 19.1 * f64::from(step) / 20_000.0;
        plant.advance(&torque((newton / 800.0 * 8192.0) as i16));
    }
    for _ in 0..2000 {
        plant.advance(&torque((39.0 / 800.0 * 8192.0) as i16));
    }
    assert_eq!(plant.bodies().slide[0], 0.0);
    assert_eq!(plant.bodies().slide_rate[0], 0.0);
    assert_eq!(plant.bodies().motor_rate[0], 0.0);
    assert!(plant.bodies().motor[0] > 0.005);
    // 45 N moves it.
    let code = (45.0 / 800.0 * 8192.0) as i16;
    for _ in 0..5000 {
        plant.advance(&torque(code));
    }
    assert!(plant.bodies().slide[0] > 1.0);
    // With the drive off it comes to standstill and stays.
    for _ in 0..5000 {
        plant.advance(&Outputs::default());
    }
    let rest = plant.bodies().clone();
    plant.advance(&Outputs::default());
    assert_eq!(&rest, plant.bodies());
}

#[test]
fn the_speed_under_viscous_friction_is_exact() {
    let mut config = machine::slide();
    config.joint[0].viscous = 2.0;
    let mut plant = Plant::new(&config, 200).expect("a slide");
    for _ in 0..4000 {
        plant.advance(&torque(1024));
    }
    let expected = (100.0 - 40.0) / 2.0;
    assert!((plant.bodies().slide_rate[0] / expected - 1.0).abs() < 1e-6);
}

#[test]
fn backlash_is_the_lost_motion_of_a_reversal() {
    for backlash in [0.0, 0.010, 0.050] {
        let mut config = machine::slide();
        config.joint[0].backlash = backlash;
        config.joint[0].viscous = 2.0;
        let mut plant = Plant::new(&config, 200).expect("a slide");
        // At a steady (60 - 40) / 2 = 10 mm/s the screw carries the slide's share: 20 N and 1 N
        // s/mm.
        let mut wind = |newton: f64| {
            for _ in 0..5000 {
                plant.advance(&torque((newton / 800.0 * 8192.0).round() as i16));
            }
            let bodies = plant.bodies();
            assert!((bodies.slide_rate[0].abs() - 10.0).abs() < 0.05);
            bodies.motor[0] - bodies.slide[0]
        };
        let lost = wind(60.0) - wind(-60.0);
        let elastic = 2.0 * 30.0 / config.joint[0].stiffness();
        assert!(
            (lost - elastic - backlash).abs() < 1e-4,
            "lost motion {lost}, of which elastic {elastic}"
        );
    }
}

#[test]
fn a_hard_stop_holds_and_dissipates_energy() {
    let mut config = machine::slide();
    config.joint[0].high = 2.0;
    let mut plant = Plant::new(&config, 200).expect("a slide");
    let mut worst = 0.0_f64;
    for _ in 0..5000 {
        plant.advance(&torque(2000));
        worst = worst.max(plant.bodies().slide[0]);
    }
    assert!(worst < 2.2, "through the stop: {worst}");
    assert!((plant.bodies().slide[0] - 2.0).abs() < 0.02);
    assert!(plant.bodies().slide_rate[0].abs() < 1e-6);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Nothing creates energy, and without friction only the drive changes momentum.
    #[test]
    fn energy_and_momentum_are_conserved(
        share in 0.1..0.9_f64,
        mode in 20.0..400.0_f64,
        backlash in prop_oneof![Just(0.0), 0.001..0.1_f64],
        motor_rate in -50.0..50.0_f64,
        slide_rate in -50.0..50.0_f64,
    ) {
        let mut config = machine::ideal_slide();
        config.joint[0].motor_share = share;
        config.joint[0].mode_hz = mode;
        config.joint[0].backlash = backlash;
        let mechanics = mechanics(&config);
        let mut bodies = Bodies::default();
        bodies.motor_rate[0] = motor_rate;
        bodies.slide_rate[0] = slide_rate;
        let (energy, momentum) = (mechanics.energy(&bodies, 0), mechanics.momentum(&bodies, 0));
        // A quarter of (omega step)^2 is the oscillation of the integrator on the spring. An edge
        // of the backlash falls somewhere within a step, which adds or removes about as much each
        // time: a random walk over the contacts.
        let swing = (std::f64::consts::TAU * mode * STEP).powi(2);
        let (mut contacts, mut touched) = (1.0_f64, false);
        for _ in 0..10_000 {
            mechanics.step(&mut bodies, &NONE, &NONE);
            let touches = (bodies.motor[0] - bodies.slide[0]).abs() > backlash / 2.0;
            contacts += f64::from(u8::from(touches != touched));
            touched = touches;
            let bound = if backlash > 0.0 { contacts.sqrt() * swing } else { 0.2501 * swing };
            prop_assert!((mechanics.energy(&bodies, 0) - energy).abs() <= bound * energy + 1e-12);
        }
        prop_assert!((mechanics.momentum(&bodies, 0) - momentum).abs() < 1e-9 * (1.0 + momentum.abs()));
    }

    /// With friction and damping the energy only falls.
    #[test]
    fn friction_only_dissipates(
        coulomb in 1.0..100.0_f64,
        viscous in 0.0..1.0_f64,
        damping in 0.0..0.3_f64,
        backlash in 0.0..0.05_f64,
        motor_rate in -50.0..50.0_f64,
        slide_rate in -50.0..50.0_f64,
    ) {
        let mut config = machine::slide();
        let joint = &mut config.joint[0];
        joint.coulomb = coulomb;
        joint.viscous = viscous;
        joint.mode_damping = damping;
        joint.backlash = backlash;
        let mechanics = mechanics(&config);
        let mut bodies = Bodies::default();
        bodies.motor_rate[0] = motor_rate;
        bodies.slide_rate[0] = slide_rate;
        let start = mechanics.energy(&bodies, 0);
        let mut min = start;
        // With 1 N on 40 kg at 50 mm/s it takes 2 s to standstill.
        for _ in 0..150_000 {
            mechanics.step(&mut bodies, &NONE, &NONE);
            let energy = mechanics.energy(&bodies, 0);
            // Kinetic and elastic energy are exchanged with the oscillation of the integrator.
            prop_assert!(energy <= min * (1.0 + 2e-3) + 1e-12 * start, "{energy} after {min}");
            min = min.min(energy);
        }
        prop_assert_eq!(bodies.motor_rate[0], 0.0);
        prop_assert_eq!(bodies.slide_rate[0], 0.0);
    }
}

#[test]
fn codes_give_efforts_up_to_the_amplifier_limit() {
    // Slide: 40 kg at 400 N for 10 ms. Table: 0.5 kg m^2 at 20 N m, then at the amplifier's limit
    // of 10 N m.
    for (index, limit, expected) in [
        (0, 800.0, 400.0 / 40.0 * 1000.0 * 0.01),
        (0, 100.0, 100.0 / 40.0 * 1000.0 * 0.01),
        (4, 40.0, (20.0_f64 / 0.5 * 0.01).to_degrees()),
        (4, 10.0, (10.0_f64 / 0.5 * 0.01).to_degrees()),
    ] {
        let mut config = machine::reference();
        config.geometry = Some(GeometryConfig::Joints(Default::default()));
        let mut joint = config.joint[index].clone();
        joint.coulomb = 0.0;
        joint.viscous = 0.0;
        if let DriveConfig::Torque(drive) = &mut joint.drive {
            drive.limit = limit;
        }
        config.joint = vec![joint];
        for sign in [1, -1] {
            let mut plant = Plant::new(&config, 200).expect("a joint");
            for _ in 0..50 {
                plant.advance(&torque(4096 * sign));
            }
            // Screw and backlash do not change the momentum.
            let momentum = plant.mechanics().momentum(plant.bodies(), 0);
            let inertia = config.joint[0].inertia / config.joint[0].kind.acceleration_unit();
            let rate = f64::from(sign) * momentum / inertia;
            assert!((rate / expected - 1.0).abs() < 1e-9, "{rate} {expected}");
        }
    }
}

#[test]
fn limit_switches_follow_the_slide() {
    let mut config = machine::slide();
    let joint = &mut config.joint[0];
    joint.limit_low = Some(-0.5);
    joint.limit_high = Some(0.5);
    joint.home = Some(SwitchConfig {
        at: 0.1,
        active: SwitchSide::Above,
        hysteresis: 0.0,
        bounce_ms: 0.0,
    });
    let mut plant = Plant::new(&config, 200).expect("a slide");
    let mut inputs = Inputs::default();
    let mut seen = [false; 3];
    for period in 0..8000 {
        plant.advance(&torque(if (500..3000).contains(&period) {
            -600
        } else {
            600
        }));
        plant.latch(&mut inputs);
        let slide = plant.truth().joints[0];
        let axis = &inputs.joints[0];
        assert_eq!(axis.home, slide >= 0.1);
        assert_eq!(axis.limit_low, slide <= -0.5);
        assert_eq!(axis.limit_high, slide >= 0.5);
        for (seen, now) in seen
            .iter_mut()
            .zip([axis.home, axis.limit_low, axis.limit_high])
        {
            *seen |= now;
        }
    }
    assert_eq!(seen, [true; 3], "the test went everywhere");
}
