//! Encoder faults in motion: the fault that is reported, safe outputs in the same period, and the
//! distance that the joint moved.

use crate::setup;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_protocol::message::{Command, Fault, Refusal};
use setup::joint_fault::{
    assert_position_lost, encoder_fault, home_with_suspected_encoder, run_with_joint_fault,
};
use setup::ready;

#[test]
fn a_reversed_encoder_does_not_run_away() {
    for joint in 0..4 {
        for speed in [0.2, 4.0, 40.0, -40.0] {
            let swapped = EncoderCondition {
                swapped: true,
                ..EncoderCondition::default()
            };
            let mut struck = run_with_joint_fault(0, joint, speed, encoder_fault(joint, swapped));
            let named = struck.fault == Fault::EncoderReversed { joint: joint as u8 }
                || struck.fault == Fault::EncoderStuck { joint: joint as u8 };
            assert!(named, "{:?}", struck.fault);
            assert!(
                struck.off < 0.1 && struck.periods < 100,
                "{} mm, {} periods",
                struck.off,
                struck.periods
            );
            struck
                .bench
                .rig
                .plant_mut()
                .set_encoder_condition(joint, EncoderCondition::default());
            home_with_suspected_encoder(&mut struck.bench);
        }
    }
}

#[test]
fn a_reversed_encoder_of_the_table_does_not_run_away() {
    for speed in [1.0, 10.0] {
        let swapped = EncoderCondition {
            swapped: true,
            ..EncoderCondition::default()
        };
        let struck = run_with_joint_fault(4, 4, speed, encoder_fault(4, swapped));
        assert!(
            struck.off < 0.3 && struck.periods < 100,
            "{} degrees, {} periods",
            struck.off,
            struck.periods
        );
    }
}

#[test]
fn a_stuck_channel_is_found_before_the_slide_is_fast() {
    let clean = EncoderCondition::default();
    for (speed, max) in [
        // The error includes that at rest after homing, which keeps the effort of each drive.
        (0.02, 0.105),
        (-0.02, 0.105),
        (0.05, 0.1),
        (0.2, 0.1),
        (-0.5, 0.15),
        (1.0, 0.35),
        (4.0, 0.05),
        (40.0, 0.05),
        (-40.0, 0.05),
    ] {
        for (joint, condition) in [
            (
                0,
                EncoderCondition {
                    stuck_a: Some(true),
                    ..clean
                },
            ),
            (
                3,
                EncoderCondition {
                    stuck_b: Some(false),
                    ..clean
                },
            ),
        ] {
            let mut struck = run_with_joint_fault(0, joint, speed, encoder_fault(joint, condition));
            assert_eq!(struck.fault, Fault::EncoderStuck { joint: joint as u8 });
            assert!(struck.off < max, "{speed} mm/s: {} mm", struck.off);
            struck
                .bench
                .rig
                .plant_mut()
                .set_encoder_condition(joint, clean);
            home_with_suspected_encoder(&mut struck.bench);
        }
    }
}

#[test]
fn illegal_transitions_lose_the_position() {
    let noise = EncoderCondition {
        noise_hz: 5000.0,
        ..EncoderCondition::default()
    };
    let mut struck = run_with_joint_fault(0, 2, 4.0, encoder_fault(2, noise));
    assert!(matches!(
        struck.fault,
        Fault::EncoderIllegal {
            joint: 2,
            count: 9..
        }
    ));
    assert!(struck.off < 0.03, "{}", struck.off);
    struck
        .bench
        .rig
        .plant_mut()
        .set_encoder_condition(2, EncoderCondition::default());
    assert_position_lost(&mut struck.bench);
}

#[test]
fn illegal_transitions_with_the_drives_off_lose_the_position_as_well() {
    let mut bench = ready();
    bench.ask(Command::Disable).expect("off");
    let noise = EncoderCondition {
        noise_hz: 5000.0,
        ..EncoderCondition::default()
    };
    bench.rig.plant_mut().set_encoder_condition(1, noise);
    bench.steps(100);
    bench
        .rig
        .plant_mut()
        .set_encoder_condition(1, EncoderCondition::default());
    bench.ask(Command::Enable).expect("on");
    let status = bench.status();
    assert!(!status.homed);
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
}
