//! Encoder counts while the drives are off: coasting, motion by hand, counter jumps.
//!
//! The position is kept exactly if it is true.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::plant::JointCondition;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_machine_file::{BUILT_IN, MachineFile};
use haptimill_protocol::message::{Command, Fault, Refusal, State};
use haptimill_tests::Bench;
use setup::enable::{assert_position_true, emergency_stop_and_enable, machine_from, step_machine};
use setup::{drives_off, line, ready, state};

#[test]
fn an_emergency_stop_keeps_the_position_except_during_homing() {
    for seed in 1..=4 {
        let mut bench = step_machine(seed);
        let start = bench.status().commanded;
        bench.start_job(1, &line(&start, 0, 16.0, 28));
        bench.steps(3000 + 91 * seed as usize);
        assert_eq!(state(&bench), State::Run);
        emergency_stop_and_enable(&mut bench, 1000);
        assert_position_true(&mut bench, 0.03);
        let start = bench.status().commanded;
        bench.start_job(2, &line(&start, 0, -16.0, 20));
        assert!(bench.wait_for(State::Idle, 30_000), "{:?}", bench.status());
        assert_position_true(&mut bench, 0.03);
        // An aborted homing leaves the machine unhomed; the next one succeeds.
        bench.ask(Command::Home).expect("homes");
        bench.steps(700 + 130 * seed as usize);
        assert_eq!(state(&bench), State::Homing);
        emergency_stop_and_enable(&mut bench, 1000);
        let status = bench.status();
        assert_eq!((status.state, status.homed), (State::Idle, false));
        bench.ask(Command::Home).expect("homes");
        assert!(bench.wait_for(State::Idle, 30_000), "{:?}", bench.status());
        assert_position_true(&mut bench, 0.03);
    }
}

/// How the drives of a homed machine went off.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Off {
    Disabled,
    Stopped,
    Fault,
}

fn switch_off(how: Off) -> Bench {
    let mut bench = ready();
    match how {
        Off::Disabled => bench.ask(Command::Disable).expect("off"),
        Off::Stopped => bench.rig.plant_mut().set_emergency_stop(true),
        Off::Fault => bench.rig.plant_mut().set_condition(
            3,
            JointCondition {
                drive_tripped: true,
                ..JointCondition::default()
            },
        ),
    }
    bench.steps(1000);
    assert!(drives_off(&bench));
    bench
}

/// Removes the cause that took the drives off.
fn remove_cause(bench: &mut Bench) {
    bench.rig.plant_mut().set_emergency_stop(false);
    bench
        .rig
        .plant_mut()
        .set_condition(3, JointCondition::default());
    bench.steps(10);
}

#[test]
fn a_counter_jump_with_the_drives_off_loses_the_position() {
    for how in [Off::Disabled, Off::Stopped, Off::Fault] {
        for (joint, counts) in [(0, 32_000), (3, -700), (2, i32::MIN), (4, 8000)] {
            let mut bench = switch_off(how);
            bench.rig.plant_mut().slip_encoder(joint, counts);
            bench.steps(10);
            let status = bench.status();
            assert!(!status.homed, "{how:?} {joint}");
            remove_cause(&mut bench);
            if how != Off::Disabled {
                // The first fault stays latched; this one is reported after it.
                bench.ask(Command::Reset).expect("reset");
            }
            let status = bench.status();
            let named = matches!(
                status.fault,
                Some(Fault::CounterJump { joint: of, .. }) if usize::from(of) == joint
            );
            assert!(named, "{how:?} {joint}: {:?}", status.fault);
            assert_eq!(
                bench.ask(Command::Enable),
                Err(Refusal::State(State::Fault))
            );
            bench.ask(Command::Reset).expect("reset");
            bench.steps(100);
            assert_eq!(bench.status().fault, None, "named once");
            if bench.ask(Command::Enable).is_ok() {
                assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
            }
        }
    }
}

#[test]
fn a_jump_during_an_emergency_stop_survives_a_new_configuration() {
    let mut bench = switch_off(Off::Stopped);
    bench.rig.plant_mut().slip_encoder(0, 32_000);
    bench.steps(10);
    bench.machine.config.joints[0].law.kp.0 -= 256;
    bench.configure();
    remove_cause(&mut bench);
    bench.ask(Command::Reset).expect("reset");
    bench.steps(10);
    if state(&bench) == State::Fault {
        bench.ask(Command::Reset).expect("reset");
    }
    let status = bench.status();
    assert!(!status.homed);
    if bench.ask(Command::Enable).is_ok() {
        assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    }
}

/// A dead channel makes the count alternate between two values while the joint moves.
#[test]
fn a_joint_that_is_moved_with_a_dead_channel_and_the_drives_off_leaves_no_position() {
    let dead = |a, b| EncoderCondition {
        stuck_a: a,
        stuck_b: b,
        ..EncoderCondition::default()
    };
    let channels = [dead(None, Some(true)), dead(Some(false), None)];
    for how in [Off::Disabled, Off::Stopped, Off::Fault] {
        for (condition, effort) in channels.iter().zip([-60.0, 300.0]) {
            for joint in [0, 2] {
                let case = format!("{how:?} {condition:?} {joint}");
                let mut bench = switch_off(how);
                let plant = bench.rig.plant_mut();
                plant.set_encoder_condition(joint, *condition);
                let start = plant.bodies().motor[joint];
                plant.set_load(joint, effort);
                bench.steps(500);
                bench.rig.plant_mut().set_load(joint, 0.0);
                bench.steps(3000);
                bench
                    .rig
                    .plant_mut()
                    .set_encoder_condition(joint, EncoderCondition::default());
                let went = bench.rig.plant().bodies().motor[joint] - start;
                assert!(went.abs() > 1.0, "{case}: {went} mm");
                let status = bench.status();
                assert!(
                    !status.homed,
                    "{case}: {went:.3} mm were not counted, and the position is said to be kept"
                );
                remove_cause(&mut bench);
                if how != Off::Disabled {
                    // The first fault is latched; this one is named after it.
                    bench.ask(Command::Reset).expect("reset");
                }
                assert_eq!(
                    bench.status().fault,
                    Some(Fault::EncoderStuck { joint: joint as u8 }),
                    "{case}"
                );
                bench.ask(Command::Reset).expect("reset");
                bench.steps(100);
                assert_eq!(bench.status().fault, None, "{case}: named once");
                if bench.ask(Command::Enable).is_ok() {
                    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost), "{case}");
                }
            }
        }
    }
}

/// Motion by hand, fast and slow, in every state with the drives off, and during missed periods.
#[test]
fn a_joint_moved_by_hand_keeps_its_position() {
    for how in [Off::Disabled, Off::Stopped, Off::Fault] {
        for (effort, periods) in [(60.0, 2000), (-400.0, 250), (1500.0, 80), (-1500.0, 80)] {
            let mut bench = switch_off(how);
            for joint in 0..4 {
                bench.rig.plant_mut().set_load(joint, effort);
            }
            let mut max = 0.0_f64;
            for _ in 0..periods {
                bench.step();
                max = max.max(bench.rig.plant().bodies().slide_rate[0].abs());
            }
            for joint in 0..4 {
                bench.rig.plant_mut().set_load(joint, 0.0);
            }
            bench.steps(5000);
            println!("by hand at {max:.0} mm/s");
            remove_cause(&mut bench);
            if how != Off::Disabled {
                bench.ask(Command::Reset).expect("reset");
            }
            bench.ask(Command::Enable).expect("on");
            assert_position_true(&mut bench, 0.03);
        }
    }
}

/// During many missed periods a joint may move far; that is no counter jump.
#[test]
fn a_coasting_joint_may_move_far_in_missed_periods() {
    for missed in [1, 20, 300] {
        let faults = [1, 2, 3, 4].map(|slide| {
            let push = format!("push joint=l{slide} effort=-300 at=9s for=50ms");
            push.parse().expect("a fault")
        });
        let late = format!("missed-periods count={missed} at=9.045s");
        let options = RigOptions {
            faults: faults
                .into_iter()
                .chain([late.parse().expect("a fault")])
                .collect(),
            ..RigOptions::default()
        };
        let mut bench = Bench::with_options(&options);
        bench.make_ready();
        bench.ask(Command::Disable).expect("off");
        assert!(bench.rig.time_ns() < 9_000_000_000);
        let before = bench.rig.truth().joints[0];
        while bench.rig.time_ns() < 11_000_000_000 {
            bench.step();
        }
        let went = bench.rig.truth().joints[0] - before;
        println!("{missed} missed: {went:.1} mm");
        assert!((-150.0..-20.0).contains(&went));
        bench.ask(Command::Enable).expect("on");
        assert_position_true(&mut bench, 0.03);
    }
}

/// Per period of 200 us: 0.3 mm following error and ten times 100 mm/s; the same for each missed
/// one. A count is 1.25 um.
#[test]
fn the_threshold_of_a_counter_jump_follows_the_configuration() {
    for missed in [0, 1, 20] {
        let bound = (0.3 + 10.0 * 100.0 * 200e-6) * f64::from(missed + 1) / 0.00125;
        for (counts, kept) in [(bound - 2.0, true), (bound + 24.0, false)] {
            for sign in [1.0, -1.0] {
                let counts = (sign * counts) as i32;
                let mut faults = vec![format!("encoder-slip joint=l1 counts={counts} at=9s")];
                if missed > 0 {
                    faults.push(format!("missed-periods count={missed} at=9s"));
                }
                let faults = faults.iter().map(|fault| fault.parse().expect("a fault"));
                let mut bench = Bench::with_options(&RigOptions {
                    faults: faults.collect(),
                    ..RigOptions::default()
                });
                bench.make_ready();
                bench.ask(Command::Disable).expect("off");
                assert!(bench.rig.time_ns() < 8_900_000_000);
                while bench.rig.time_ns() < 9_100_000_000 {
                    bench.step();
                }
                let status = bench.status();
                let named = matches!(status.fault, Some(Fault::CounterJump { joint: 0, .. }));
                let known = status.homed;
                assert_eq!((known, named), (kept, !kept), "{missed} {counts}");
            }
        }
    }
}

/// A board whose counters have any value at power-on.
struct Shifted {
    control: Controller,
    by: i32,
}

impl Control for Shifted {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let mut inputs = inputs.clone();
        for axis in &mut inputs.joints {
            axis.counts = axis.counts.wrapping_add(self.by);
            axis.index_counts = axis.index_counts.wrapping_add(self.by);
        }
        self.control.tick(&inputs, outputs, &mut ());
    }
}

/// Pushes all slides.
fn push_all<C: Control>(bench: &mut Bench<C>, effort: f64) {
    let before = bench.rig.plant().truth().joints[0];
    for joint in 0..4 {
        bench.rig.plant_mut().set_load(joint, effort);
    }
    bench.steps(600);
    for joint in 0..4 {
        bench.rig.plant_mut().set_load(joint, 0.0);
    }
    bench.steps(2000);
    let went = bench.rig.plant().truth().joints[0] - before;
    assert!(went.abs() > 8.0, "{went} mm");
}

#[test]
fn slides_moved_before_the_configuration_are_homed_at_the_right_turn() {
    let reversed = [
        ("direction = 1\nbacklash_mm", "direction = -1\nbacklash_mm"),
        (
            "direction = 1\nbacklash_deg",
            "direction = -1\nbacklash_deg",
        ),
        (
            "counts_per_turn = 8000, index",
            "counts_per_turn = 8000, reversed = true, index",
        ),
    ];
    for (changes, from) in [
        (&[][..], 0),
        (&[][..], i32::MAX - 3000),
        (&[][..], i32::MIN + 3000),
        (&reversed[..], 7),
        (&reversed[..], i32::MAX - 3000),
    ] {
        for (effort, twice) in [(140.0, false), (-140.0, false), (110.0, true)] {
            let control = Shifted {
                control: Controller::new(200),
                by: from,
            };
            let mut bench = machine_from(BUILT_IN, changes, control);
            bench.steps(100);
            push_all(&mut bench, effort);
            bench.configure();
            if twice {
                push_all(&mut bench, -effort);
                push_all(&mut bench, effort);
                bench.configure();
            }
            bench.ask(Command::Enable).expect("enabled");
            bench.ask(Command::Home).expect("homing");
            assert!(bench.wait_for(State::Idle, 30_000), "{:?}", bench.status());
            assert_position_true(&mut bench, 0.03);
        }
    }
}

#[test]
fn an_invalid_preset_is_refused() {
    type Injection = fn(&mut Bench);
    let injections: [Injection; 4] = [
        // A jump before there is a configuration.
        |bench| {
            bench.rig.plant_mut().slip_encoder(0, 32_000);
            bench.steps(100);
            bench.configure();
        },
        // Noise.
        |bench| {
            let noise = EncoderCondition {
                noise_hz: 5000.0,
                ..EncoderCondition::default()
            };
            bench.rig.plant_mut().set_encoder_condition(1, noise);
            bench.steps(200);
            bench
                .rig
                .plant_mut()
                .set_encoder_condition(1, EncoderCondition::default());
            bench.configure();
        },
        // A stuck channel while the slides move.
        |bench| {
            let stuck = EncoderCondition {
                stuck_a: Some(true),
                ..EncoderCondition::default()
            };
            bench.rig.plant_mut().set_encoder_condition(0, stuck);
            push_all(bench, 100.0);
            bench
                .rig
                .plant_mut()
                .set_encoder_condition(0, EncoderCondition::default());
            bench.configure();
        },
        // Counts of another scale than before.
        |bench| {
            bench.configure();
            push_all(bench, 100.0);
            setup::encoder(bench, 0).per_count *= 2;
            bench.configure();
        },
    ];
    for inject in injections {
        let mut bench = Bench::new();
        bench.steps(500);
        inject(&mut bench);
        if state(&bench) == State::Fault {
            bench.ask(Command::Reset).expect("reset");
        }
        bench.ask(Command::Enable).expect("on");
        assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
        // After a set-up at the presets the encoder is trusted again.
        bench.ask(Command::Disable).expect("off");
        bench.machine = MachineFile::built_in().expect("sound");
        bench.configure_as(true);
        bench.ask(Command::Enable).expect("on");
        assert_eq!(bench.ask(Command::Home), Ok(()));
    }
}
