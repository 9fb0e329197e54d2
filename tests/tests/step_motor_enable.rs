//! Enable of step motors: rotors that move to a detent, loads, lost steps, and a dead encoder.

use crate::setup;
use haptimill_firmware::safety::suspected;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::plant::JointCondition;
use haptimill_protocol::message::{Command, Fault, InputProblem, Refusal, State};
use setup::enable::{
    assert_position_true, emergency_stop_and_enable, jog_in_x, largest_error, step_machine,
};
use setup::{drives_off, jog, state};

#[test]
fn an_emergency_stop_in_motion_keeps_the_position_of_step_motors() {
    for seed in 1..=12 {
        let mut bench = step_machine(seed);
        let mut epoch = 0;
        for stop in 0..3 {
            epoch += 1;
            let rate = if (seed + stop) % 2 == 0 { 47.0 } else { -40.0 };
            bench
                .ask(jog(epoch, 1000, &[(0, rate), (1, 13.0)]))
                .expect("jogs");
            // Another phase of the motors in each run.
            bench.steps(900 + 137 * seed as usize + 61 * stop as usize);
            emergency_stop_and_enable(&mut bench, 2000);
            assert_position_true(&mut bench, 0.03);
            epoch += 1;
            jog_in_x(&mut bench, epoch, -rate / 2.0, 300);
            assert_position_true(&mut bench, 0.03);
        }
    }
}

#[test]
fn moved_or_loaded_step_motors_are_enabled_at_their_position() {
    for (seed, hand, load) in [
        (1, 70.0, 0.0),
        (2, -90.0, 0.0),
        (3, 120.0, 20.0),
        (4, 0.0, 250.0),
        (5, -60.0, -250.0),
    ] {
        let mut bench = step_machine(seed);
        bench.ask(Command::Disable).expect("off");
        for joint in 0..4 {
            bench.rig.plant_mut().set_load(joint, hand);
        }
        bench.steps(1000);
        for joint in 0..4 {
            bench.rig.plant_mut().set_load(joint, 0.0);
        }
        bench.steps(3000);
        // The load comes while the rotors still move to their detents.
        bench.send(Command::Enable).expect("room");
        bench.steps(30);
        bench.rig.plant_mut().set_load(0, load);
        bench.steps(4000);
        // 250 N wind up the screw by about 0.05 mm.
        let bound = 0.03 + load.abs() / 2500.0;
        assert_position_true(&mut bench, bound);
        jog_in_x(&mut bench, 1, 20.0, 500);
        assert_position_true(&mut bench, bound);
    }
}

/// The rotor of one joint cannot hold its load at enable.
#[test]
fn a_step_motor_that_does_not_lock_is_reported_and_keeps_its_position() {
    for (gain, load) in [(1.0, 1500.0), (0.0, 80.0), (0.05, -120.0)] {
        let mut bench = step_machine(1);
        bench.ask(Command::Disable).expect("off");
        bench.steps(1000);
        let weak = JointCondition {
            drive_gain: gain,
            ..JointCondition::default()
        };
        bench.rig.plant_mut().set_condition(1, weak);
        let asked = bench.send(Command::Enable).expect("room");
        bench.steps(20);
        bench.rig.plant_mut().set_load(1, load);
        for _ in 0..1000 {
            bench.step();
            if state(&bench) == State::Fault {
                break;
            }
        }
        bench.rig.plant_mut().set_load(1, 0.0);
        bench.steps(3000);
        let status = bench.status();
        assert!(
            matches!(status.fault, Some(Fault::NotLocked { joint: 1, .. })),
            "{gain} {load}: {:?}",
            status.fault
        );
        assert!(drives_off(&bench) && status.homed);
        let answers = bench.take_answers();
        let answer = answers.iter().find(|(id, _)| *id == asked);
        assert!(
            matches!(answer, Some((_, Err(Refusal::State(State::Fault))))),
            "{answers:?}"
        );
        bench
            .rig
            .plant_mut()
            .set_condition(1, JointCondition::default());
        bench.ask(Command::Reset).expect("reset");
        bench.ask(Command::Enable).expect("on");
        assert_position_true(&mut bench, 0.03);
    }
}

/// An oscillating rotor is not accepted as locked.
#[test]
fn motion_starts_after_the_step_motors_have_locked() {
    let mut bench = step_machine(2);
    let pose = bench.status().commanded;
    bench.ask(jog(1, 1000, &[(0, 40.0)])).expect("jogs");
    bench.steps(1337);
    bench.rig.plant_mut().set_emergency_stop(true);
    bench.steps(2000);
    bench.rig.plant_mut().set_emergency_stop(false);
    bench.steps(5);
    bench.ask(Command::Reset).expect("reset");
    let enable = bench.send(Command::Enable).expect("room");
    let settling = Err(Refusal::Input(InputProblem::Settling));
    assert_eq!(bench.ask(jog(2, 100, &[(0, 1.0)])), settling);
    assert_eq!(bench.ask(Command::Home), settling);
    assert_eq!(bench.ask(Command::JobStart { job: 1, pose }), settling);
    let waited = (0..5000).find(|_| {
        bench.step();
        bench.take_answers().contains(&(enable, Ok(())))
    });
    // At least the 50 ms in which nothing may move.
    assert!(waited.is_some_and(|periods| (200..2500).contains(&periods)));
    bench.ask(jog(3, 100, &[(0, 1.0)])).expect("jogs");
    // A disable meanwhile answers the pending enable.
    bench.steps(3000);
    bench.ask(Command::Disable).expect("off");
    bench.steps(500);
    let enable = bench.send(Command::Enable).expect("room");
    bench.ask(Command::Disable).expect("off");
    bench.steps(100);
    let refusal = Err(Refusal::State(State::Disabled));
    assert!(bench.take_answers().contains(&(enable, refusal)));
    bench.ask(Command::Enable).expect("on");
    assert_position_true(&mut bench, 0.03);
}

#[test]
fn steps_lost_after_an_emergency_stop_are_found_and_homing_checks_the_encoder() {
    for seed in 1..=4 {
        let mut bench = step_machine(seed);
        jog_in_x(&mut bench, 1, 40.0, 900);
        bench.ask(jog(2, 1000, &[(0, -40.0)])).expect("jogs");
        bench.steps(1500 + 97 * seed as usize);
        emergency_stop_and_enable(&mut bench, 1000);
        bench.ask(jog(3, 1000, &[(0, 20.0)])).expect("jogs");
        bench.steps(1000);
        let dead = JointCondition {
            drive_gain: 0.0,
            ..JointCondition::default()
        };
        bench.rig.plant_mut().set_condition(0, dead);
        bench.steps(100);
        bench
            .rig
            .plant_mut()
            .set_condition(0, JointCondition::default());
        bench.steps(1500);
        let status = bench.status();
        let lost = Some(Fault::StepsLost {
            joint: 0,
            by: status.fault.map_or(0, |fault| match fault {
                Fault::StepsLost { by, .. } => by,
                _ => 0,
            }),
        });
        assert_eq!(status.fault, lost);
        assert!(!status.homed);
        // The encoder counted all of it, and its index pulses confirm that.
        bench.ask(Command::Reset).expect("reset");
        bench.ask(Command::Enable).expect("on");
        bench.ask(Command::Home).expect("homes");
        assert!(bench.wait_for(State::Idle, 30_000), "{:?}", bench.status());
        assert_position_true(&mut bench, 0.03);
    }
}

/// The rotor moves to its detent, and its encoder does not count that.
#[test]
fn an_encoder_that_is_dead_during_locking_loses_the_position() {
    for seed in 1..=6 {
        let mut bench = step_machine(seed);
        jog_in_x(&mut bench, 1, 40.0, 900);
        bench.ask(jog(2, 1000, &[(0, -40.0)])).expect("jogs");
        bench.steps(1500 + 97 * seed as usize);
        bench.rig.plant_mut().set_emergency_stop(true);
        bench.steps(2000);
        bench.rig.plant_mut().set_emergency_stop(false);
        bench.steps(5);
        let dead = EncoderCondition {
            stuck_a: Some(true),
            stuck_b: Some(true),
            ..EncoderCondition::default()
        };
        bench.rig.plant_mut().set_encoder_condition(0, dead);
        bench.ask(Command::Reset).expect("reset");
        bench.ask(Command::Enable).expect("on");
        bench.ask(jog(3, 1000, &[(0, 10.0)])).expect("jogs");
        bench.steps(3000);
        let status = bench.status();
        let fault = status.fault.expect("a fault");
        assert_eq!(suspected(&fault), Some(0), "{fault:?}");
        assert!(!status.homed);
        bench
            .rig
            .plant_mut()
            .set_encoder_condition(0, EncoderCondition::default());
        bench.steps(100);
        bench.ask(Command::Reset).expect("reset");
        bench.ask(Command::Enable).expect("on");
        let lost = largest_error(&mut bench);
        if bench.ask(Command::Home).is_ok() && bench.wait_for(State::Idle, 30_000) {
            // The lost counts are within the index slack.
            assert_position_true(&mut bench, 0.03);
        } else {
            let status = bench.status();
            assert!(!status.homed);
            assert!(lost > 0.003, "{lost} mm");
        }
    }
}
