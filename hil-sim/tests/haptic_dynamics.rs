//! Masses and friction of the haptic arm against conservation laws and closed formulas.

use haptimill_firmware::io::HapticOutputs;
use haptimill_hil_sim::haptics::{HapticArm, HapticConfig};
use haptimill_hil_sim::operator::OperatorConfig;

const PERIOD: f64 = 200e-6;

fn free() -> HapticConfig {
    let mut config = HapticConfig::default();
    for actuator in [&mut config.slide, &mut config.turn] {
        actuator.coulomb = 0.0;
        actuator.viscous = 0.0;
    }
    config
}

fn arm(config: &HapticConfig) -> HapticArm {
    HapticArm::new(config, 200, 20, 1).expect("fine")
}

fn run(arm: &mut HapticArm, seconds: f64, mut each: impl FnMut(&HapticArm)) {
    for _ in 0..(seconds / PERIOD) as usize {
        arm.advance(&HapticOutputs::default(), true);
        each(arm);
    }
}

/// An impulse sends the handle through its whole workspace: without force and friction its energy
/// is constant to 20 ppm.
#[test]
fn energy_is_constant_without_friction() {
    for twist in [
        [300.0, -200.0, 150.0, 2.0, -3.0, 4.0],
        [-100.0, 250.0, -50.0, -4.0, 1.0, -6.0],
        [20.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ] {
        let mut arm = arm(&free());
        arm.strike(twist);
        let start = arm.energy();
        let (mut worst, mut farthest) = (0.0_f64, 0.0_f64);
        // The stops are springs whose energy is not counted, so the run ends near one.
        run(&mut arm, 0.15, |arm| {
            worst = worst.max((arm.energy() / start - 1.0).abs());
            farthest = arm
                .truth()
                .tip
                .iter()
                .fold(farthest, |far, x| far.max(x.abs()));
        });
        println!(
            "energy {start:.1} N mm, off by {:.4} ppm, tip up to {farthest:.0} mm",
            worst * 1e6
        );
        assert!(worst < 20e-6, "{worst}");
        assert_eq!(arm.truth().jammed, 0);
    }
}

/// The same with weight: potential energy becomes kinetic energy.
#[test]
fn energy_is_constant_under_weight() {
    let mut config = free();
    config.balance = 0.5;
    let mut arm = arm(&config);
    let start = arm.energy();
    let mut motion = 0.0_f64;
    let mut worst = 0.0_f64;
    run(&mut arm, 0.12, |arm| {
        worst = worst.max((arm.energy() - start).abs());
        motion = motion.max(arm.truth().twist[2].abs());
    });
    assert!(motion > 300.0, "falls: {motion} mm/s");
    // Relative to the kinetic energy, about 80 N mm.
    assert!(worst < 2e-3, "{worst} N mm");
}

#[test]
fn friction_only_reduces_the_energy() {
    for twist in [
        [100.0, -70.0, 50.0, 0.7, -1.0, 1.5],
        [-30.0, 20.0, 5.0, 0.4, -0.1, 0.6],
    ] {
        let mut arm = arm(&HapticConfig::default());
        arm.strike(twist);
        let mut before = arm.energy();
        run(&mut arm, 1.5, |arm| {
            let now = arm.energy();
            // The integration itself varies by some ppm.
            assert!(now <= before * (1.0 + 2e-5) + 1e-12, "{before} {now}");
            before = now;
        });
        assert!(before < 1e-9, "comes to rest: {before}");
    }
}

/// Coulomb friction holds a handle against a smaller force, and releases it at a larger one.
#[test]
fn friction_holds_below_the_coulomb_force() {
    let mut config = free();
    config.balance = 1.0 - 0.02;
    config.slide.coulomb = 0.15;
    let weight =
        0.02 * 9.80665 * (0.35 + 0.09 + 3.0 * 0.18 * libm::cos(30f64.to_radians()).powi(2));
    let mut held = arm(&config);
    run(&mut held, 0.5, |_| {});
    let sag = held.truth().tip[2];
    println!("weight {weight:.3} N, sag {sag:.2e} mm");
    assert!(sag.abs() < 1e-3, "{sag}");
    config.slide.coulomb = 0.01;
    let mut falls = arm(&config);
    run(&mut falls, 0.5, |_| {});
    assert!(falls.truth().tip[2] < -1.0, "{}", falls.truth().tip[2]);
}

/// Straight up from home all three legs move alike: the effective mass is body, links and three
/// slides, each with its ratio.
#[test]
fn a_force_accelerates_the_effective_mass() {
    let mut config = free();
    config.balance = 1.0 - 1e-3;
    let mut arm = arm(&config);
    let legs = arm.geometry().legs(&arm.geometry().home()).expect("home");
    let ratio = legs[0].slide_row()[2];
    let slide = 0.15 + 0.03;
    let body = 0.35 + 3.0 * 0.03;
    let mass = body + 3.0 * slide * ratio * ratio;
    let pull = 9.80665 * 1e-3 * (body + 3.0 * slide * ratio * 30f64.to_radians().cos());
    let expected = -pull / mass * 1000.0;
    let seconds = 0.01;
    run(&mut arm, seconds, |_| {});
    let ours = arm.truth().twist[2] / seconds;
    println!("mass {mass:.3} kg, {ours:.5} mm/s^2, by hand {expected:.5}");
    assert!((ours / expected - 1.0).abs() < 1e-4, "{ours} {expected}");
}

#[test]
fn the_same_impulse_gives_the_same_motion() {
    let final_state = || {
        let mut arm = arm(&HapticConfig::default());
        arm.take(Some(&OperatorConfig::default())).expect("fine");
        arm.strike([100.0, 50.0, -30.0, 1.0, 2.0, 3.0]);
        run(&mut arm, 0.3, |_| {});
        (*arm.truth(), arm.inputs())
    };
    let (first, second) = (final_state(), final_state());
    assert_eq!(first, second);
    assert!(first.0.tip.iter().all(|x| x.is_finite()));
}

/// An arm at rest without input is no longer stepped; it wakes at once.
#[test]
fn an_arm_at_rest_sleeps_and_wakes() {
    let mut arm = arm(&HapticConfig::default());
    arm.take(Some(&OperatorConfig::default())).expect("fine");
    run(&mut arm, 1.0, |_| {});
    let before = *arm.truth();
    assert_eq!(before.twist, [0.0; 6]);
    let mut outputs = HapticOutputs {
        enabled: true,
        ..HapticOutputs::default()
    };
    for _ in 0..10 {
        arm.advance(&outputs, true);
    }
    assert_eq!(*arm.truth(), before);
    outputs.currents[1] = [1500, 500];
    for _ in 0..500 {
        arm.advance(&outputs, true);
    }
    assert!(arm.truth().tip.iter().any(|x| x.abs() > 0.5));
}

/// Any motor torques leave the loops of the arm closed.
#[test]
fn full_torque_in_any_direction_ends_at_the_stops() {
    for pattern in 0..64_u32 {
        let mut arm = arm(&HapticConfig::default());
        let mut outputs = HapticOutputs {
            enabled: true,
            ..HapticOutputs::default()
        };
        for motor in 0..6 {
            let code = if pattern >> motor & 1 == 1 {
                8191
            } else {
                -8192
            };
            outputs.currents[motor / 2][motor % 2] = code;
        }
        for _ in 0..2500 {
            arm.advance(&outputs, true);
        }
        let truth = arm.truth();
        assert!(
            truth
                .centre
                .iter()
                .chain(&truth.twist)
                .all(|x| x.is_finite())
        );
        assert!(
            truth.centre.iter().all(|x| x.abs() < 1000.0),
            "{:?}",
            truth.centre
        );
    }
}
