//! Faults of one joint in motion: the travel until the drives are off, and the knowledge of the
//! position afterwards.

use super::{DEGREE, MM, drives_off, following_error, moving, recover, reported_faults, state};
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::plant::{JointCondition, Plant};
use haptimill_protocol::message::{Command, Event, Fault, Refusal, State};
use haptimill_tests::Bench;

/// Deceleration of a slide by Coulomb friction with its drive off, mm/s^2.
const FRICTION: f64 = 1000.0;
/// The same for the table, degrees/s^2: 2 N m on 0.2 kg m^2.
const TABLE_FRICTION: f64 = 573.0;

/// Result of a fault of one joint.
pub struct JointFault {
    /// The machine.
    pub bench: Bench,
    /// The latched fault.
    pub fault: Fault,
    /// Periods from the fault to the drives off.
    pub periods: usize,
    /// Following error of the joint when the drives went off, mm or degrees.
    pub off: f64,
}

/// Injects a fault into a joint of a moving machine. Runs until the drives are off and friction has
/// stopped the joint.
pub fn run_with_joint_fault(
    axis: usize,
    joint: usize,
    speed: f64,
    inject: impl FnOnce(&mut Plant),
) -> JointFault {
    let mut bench = moving(axis, speed);
    inject(bench.rig.plant_mut());
    let mut off = 0.0_f64;
    for period in 0..5000 {
        let kept_on = bench.rig.control().safety().drives_on();
        bench.step();
        off = off.max(following_error(&bench, joint));
        // The outputs are safe in the period in which the fault is found.
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
            // The energy of both sides of the joint and of the screw's spring goes into friction.
            // The spring oscillates at 80 Hz: its energy is that of the reduced mass, at most a
            // quarter of the whole, at its rate of wind-up.
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
            assert_eq!(reported_faults(&bench), [&Event::Fault(fault)]);
            return JointFault {
                bench,
                fault,
                periods: period,
                off,
            };
        }
    }
    panic!("no fault was detected");
}

/// Returns a fault of an encoder.
pub fn encoder_fault(joint: usize, condition: EncoderCondition) -> impl FnOnce(&mut Plant) {
    move |plant| plant.set_encoder_condition(joint, condition)
}

/// Returns a fault of a joint.
pub fn joint_fault(joint: usize, condition: JointCondition) -> impl FnOnce(&mut Plant) {
    move |plant| plant.set_condition(joint, condition)
}

/// Asserts that the position is lost: homing is refused until the operator sets the joints to their
/// presets.
pub fn assert_position_lost(bench: &mut Bench) {
    let status = bench.status();
    assert!(!status.homed);
    recover(bench, State::Disabled);
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    let pose = bench.status().commanded;
    assert_eq!(
        bench.ask(Command::JobStart { job: 9, pose }),
        Err(Refusal::NotHomed)
    );
}

/// Homes a machine with a suspected encoder, whose index pulse shows whether it lost counts.
///
/// Returns whether the position is kept. It must not be kept if counts were lost.
pub fn home_with_suspected_encoder(bench: &mut Bench) -> bool {
    let status = bench.status();
    assert!(!status.homed);
    recover(bench, State::Disabled);
    let lost = largest_position_error(bench);
    bench.ask(Command::Home).expect("asked");
    assert!(bench.wait_for(State::Idle, 30_000) || state(bench) == State::Fault);
    let status = bench.status();
    if let Some(fault) = status.fault {
        assert!(matches!(fault, Fault::EncoderSlip { .. }), "{fault:?}");
        assert_position_lost(bench);
        return false;
    }
    assert!(status.homed);
    assert_measured_true(bench);
    assert!(
        lost < 0.03,
        "kept, although {lost} mm or degrees were not counted"
    );
    true
}

/// Asserts that the position is kept, and true.
pub fn assert_position_kept(bench: &mut Bench) {
    let status = bench.status();
    assert!(status.homed);
    recover(bench, State::Disabled);
    assert_measured_true(bench);
}

/// Asserts that the measured pose is the true one except for backlash, friction and a count.
fn assert_measured_true(bench: &mut Bench) {
    let status = bench.status();
    for axis in 0..3 {
        let off = f64::from(status.measured[axis]) / MM - bench.rig.truth().pose[axis];
        assert!(off.abs() < 0.03, "axis {axis} off by {off} mm");
    }
}

/// Returns the largest difference between a measured and a true joint, mm or degrees.
fn largest_position_error(bench: &Bench) -> f64 {
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
