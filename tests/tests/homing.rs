//! Homing: one transaction that finds the references, without a jump of the tool.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, Event, Fault, HomingProblem, State};
use haptimill_tests::Bench;
use setup::enable::{enabled_machine, machine_with};
use setup::{DEGREE, MM, distance, drives_off, recover, reported_faults, state, tool};

/// Returns the largest difference between measured and true pose: mm, and degrees for tilt and
/// table.
fn largest_pose_error(bench: &mut Bench) -> (f64, f64) {
    let status = bench.status();
    let off = |axis: usize, unit: f64| {
        (f64::from(status.measured[axis]) / unit - bench.rig.truth().pose[axis]).abs()
    };
    let linear = (0..3).map(|axis| off(axis, MM)).fold(0.0, f64::max);
    (linear, off(3, DEGREE).max(off(4, DEGREE)))
}

#[test]
fn homing_finds_the_references_from_any_set_up_of_the_slides() {
    let (mut worst, mut worst_angle) = (0.0_f64, 0.0_f64);
    for seed in 1..=25 {
        // Up to 2.2 mm off the preset, different for each slide.
        let mut bench = enabled_machine(machine_with(&[
            ("seed = 1\n", &format!("seed = {seed}\n")),
            ("start_spread = 0.3", "start_spread = 2.2"),
            ("start_spread = 0.2", "start_spread = 1.0"),
        ]));
        bench.ask(Command::Home).expect("homing");
        let mut jump = 0.0_f64;
        for _ in 0..40_000 {
            let before = tool(&bench);
            bench.step();
            jump = jump.max(distance(&bench, before));
            if state(&bench) != State::Homing {
                break;
            }
        }
        bench.steps(500);
        assert_eq!(
            state(&bench),
            State::Idle,
            "seed {seed}: {:?}",
            bench.rig.control().safety().fault()
        );
        let (linear, angle) = largest_pose_error(&mut bench);
        worst = worst.max(linear);
        worst_angle = worst_angle.max(angle);
        assert!(
            linear < 0.03 && angle < 0.02,
            "seed {seed}: {linear} mm, {angle} degrees"
        );
        // The search moves at 5 mm/s: 1 um per period, plus the oscillation of the slides.
        assert!(jump < 0.004, "{jump} mm in a period");
    }
    println!("25 homings: at worst {worst:.4} mm, {worst_angle:.4} degrees");
}

#[test]
fn homing_without_an_index_corrects_no_joint() {
    for joint in 0..5 {
        let mut bench = enabled_machine(Bench::new());
        bench.rig.plant_mut().set_encoder_condition(
            joint,
            EncoderCondition {
                index_missing: true,
                ..EncoderCondition::default()
            },
        );
        bench.ask(Command::Home).expect("homing");
        for _ in 0..30_000 {
            bench.step();
            assert_eq!(drives_off(&bench), state(&bench) == State::Fault);
            if state(&bench) == State::Fault {
                break;
            }
        }
        bench.steps(300);
        let fault = Fault::Homing {
            joint: joint as u8,
            problem: HomingProblem::NoIndex,
        };
        assert_eq!(reported_faults(&bench), [&Event::Fault(fault)]);
        let status = bench.status();
        assert!(!status.homed);
        // Nothing was corrected: homing can start again when the index line works.
        bench
            .rig
            .plant_mut()
            .set_encoder_condition(joint, EncoderCondition::default());
        recover(&mut bench, State::Disabled);
        bench.ask(Command::Home).expect("homing");
        bench.steps(20_000);
        assert!(bench.status().homed);
        let (linear, angle) = largest_pose_error(&mut bench);
        assert!(
            linear < 0.03 && angle < 0.02,
            "{linear} mm, {angle} degrees"
        );
    }
}

#[test]
fn a_wrong_index_position_fails_homing() {
    // The encoder of slide 3 was mounted anew: its index is half a turn off the machine file.
    // A file that says so is refused, so only the simulated machine is changed.
    let mut machine = MachineFile::built_in().expect("sound");
    machine.text = machine.text.replace("index = 1133.9 ", "index = 1138.9 ");
    let controller = Controller::new(200);
    let mut bench = enabled_machine(Bench::of_machine(
        machine,
        &RigOptions::default(),
        controller,
    ));
    bench.ask(Command::Home).expect("homing");
    bench.steps(20_000);
    let implausible = Fault::Homing {
        joint: 2,
        problem: HomingProblem::Implausible,
    };
    assert_eq!(bench.rig.control().safety().fault(), Some(implausible));
    assert!(drives_off(&bench));
}

#[test]
fn homing_can_be_stopped_and_repeated() {
    let mut bench = enabled_machine(Bench::new());
    for stop in [Command::Stop, Command::Hold] {
        bench.ask(Command::Home).expect("homing");
        bench.steps(700);
        bench.ask(stop).expect("stopped");
        assert!(bench.wait_for(State::Idle, 3000));
        let status = bench.status();
        assert!(!status.homed && status.fault.is_none());
    }
    for _ in 0..3 {
        bench.ask(Command::Home).expect("homing");
        assert!(bench.wait_for(State::Idle, 40_000));
        assert!(bench.status().homed);
        let (linear, angle) = largest_pose_error(&mut bench);
        assert!(
            linear < 0.03 && angle < 0.02,
            "{linear} mm, {angle} degrees"
        );
    }
}

#[test]
fn the_homing_correction_does_not_move_the_tool() {
    // The correction at the end of homing changes all coordinates by up to millimetres; the machine
    // does not move.
    let mut bench = enabled_machine(machine_with(&[(
        "start_spread = 0.3",
        "start_spread = 2.0",
    )]));
    bench.ask(Command::Home).expect("homing");
    while state(&bench) == State::Homing {
        bench.step();
    }
    let before = tool(&bench);
    let mut max = 0.0_f64;
    for _ in 0..1000 {
        bench.step();
        max = max.max(distance(&bench, before));
    }
    println!("correction: the tool moved {max:.4} mm");
    assert!(max < 0.02, "{max} mm");
}
