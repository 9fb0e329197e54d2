//! A joint that is spoilt while the machine moves, how far it got, and what is known of its position afterwards.

use super::{DEGREE, MM, drives_off, joint_off, moving, recover, state, told};
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::plant::{JointCondition, Plant};
use haptimill_protocol::message::{Command, Event, Fault, Refusal, State};
use haptimill_tests::Bench;

/// Coulomb friction of a slide over its mass: what stops it when its drive is off, mm/s^2.
const FRICTION: f64 = 1000.0;
/// The same of the table, degrees/s^2: 2 N m on 0.2 kg m^2.
const TABLE_FRICTION: f64 = 573.0;

/// What came of a fault of one joint.
pub struct Struck {
    /// The machine.
    pub bench: Bench,
    /// What was latched.
    pub fault: Fault,
    /// Periods from the fault to the drives off.
    pub periods: usize,
    /// Distance of the joint from where it was wanted when the drives went off, mm or degrees.
    pub off: f64,
}

/// Spoils a joint of a moving machine, and goes on until the drives are off; then until friction has stopped the joint.
pub fn strike(axis: usize, joint: usize, speed: f64, spoil: impl FnOnce(&mut Plant)) -> Struck {
    let mut bench = moving(axis, speed);
    spoil(bench.rig.plant_mut());
    let mut off = 0.0_f64;
    for period in 0..5000 {
        let kept_on = bench.rig.control().safety().drives_on();
        bench.step();
        off = off.max(joint_off(&bench, joint));
        // Safe in the period in which the fault was seen, not in the next one.
        assert_eq!(
            drives_off(&bench),
            !bench.rig.control().safety().drives_on()
        );
        if kept_on && drives_off(&bench) {
            let fault = bench.rig.control().safety().fault().expect("a fault");
            assert_eq!(state(&bench), State::Fault);
            let friction = if joint == 4 { TABLE_FRICTION } else { FRICTION };
            bench.step();
            let here = bench.rig.plant().bodies().clone();
            bench.steps(2000);
            let coasted = (bench.rig.plant().truth().joints[joint] - here.slide[joint]).abs();
            // Both sides of the joint and the spring of the screw between them give their energy to friction. The spring swings at 80 Hz:
            // its energy is that of the joint's reduced mass, a quarter of the whole at most, at the rate of its winding.
            let rate = here.slide_rate[joint]
                .abs()
                .max(here.motor_rate[joint].abs());
            let wound =
                (here.motor[joint] - here.slide[joint]).abs() * core::f64::consts::TAU * 80.0;
            let bound = (rate * rate + wound * wound / 4.0) / (2.0 * friction) * 1.3 + 0.02;
            assert!(coasted < bound, "coasted {coasted}, energy allows {bound}");
            eprintln!(
                "{fault:?}: off {off:.3}, at {rate:.1}/s, coasted {coasted:.3}, after {period} periods"
            );
            assert_eq!(told(&bench), [&Event::Fault(fault)]);
            return Struck {
                bench,
                fault,
                periods: period,
                off,
            };
        }
    }
    panic!("nobody noticed");
}

/// A fault of an encoder.
pub fn spoil_encoder(joint: usize, condition: EncoderCondition) -> impl FnOnce(&mut Plant) {
    move |plant| plant.set_encoder_condition(joint, condition)
}

/// A fault of a joint.
pub fn spoil_joint(joint: usize, condition: JointCondition) -> impl FnOnce(&mut Plant) {
    move |plant| plant.set_condition(joint, condition)
}

/// After a fault that loses the position: the references cannot be trusted until the operator sets the joints up at their presets.
pub fn position_is_lost(bench: &mut Bench) {
    let status = bench.status();
    assert!(!status.position_kept && !status.homed);
    recover(bench, State::Disabled);
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    let pose = bench.status().commanded;
    assert_eq!(
        bench.ask(Command::JobStart { job: 9, pose }),
        Err(Refusal::NotHomed)
    );
}

/// After a fault in which an encoder is only suspected: while the references are looked for its index pulse says whether it lost counts. It is never believed wrongly.
/// Says whether it was believed.
pub fn encoder_is_asked(bench: &mut Bench) -> bool {
    let status = bench.status();
    assert!(!status.position_kept && !status.homed);
    recover(bench, State::Disabled);
    let lost = most_lost(bench);
    bench.ask(Command::Home).expect("asked");
    assert!(bench.wait_for(State::Idle, 30_000) || state(bench) == State::Fault);
    let status = bench.status();
    if let Some(fault) = status.fault {
        assert!(matches!(fault, Fault::EncoderSlip { .. }), "{fault:?}");
        position_is_lost(bench);
        return false;
    }
    assert!(status.position_kept && status.homed);
    measured_is_true(bench);
    assert!(
        lost < 0.03,
        "believed, and {lost} mm or degrees were not counted"
    );
    true
}

/// After a fault that keeps the position: it is the true one.
pub fn position_is_kept(bench: &mut Bench) {
    let status = bench.status();
    assert!(status.position_kept && status.homed);
    recover(bench, State::Disabled);
    measured_is_true(bench);
}

/// The measured pose is the true one, but for backlash, friction and a count.
fn measured_is_true(bench: &mut Bench) {
    let status = bench.status();
    for axis in 0..3 {
        let off = f64::from(status.measured[axis]) / MM - bench.rig.truth().pose[axis];
        assert!(off.abs() < 0.03, "axis {axis} off by {off} mm");
    }
}

/// How far the joint whose encoder lost most is from where it is measured, mm or degrees.
fn most_lost(bench: &Bench) -> f64 {
    let joints = bench.rig.control().machine().expect("configured").joints();
    joints
        .zip(bench.rig.truth().joints)
        .enumerate()
        .map(|(joint, (snapshot, truth))| {
            let unit = if joint == 4 { DEGREE } else { MM };
            (f64::from(snapshot.measured.0) / unit - truth).abs()
        })
        .fold(0.0, f64::max)
}
