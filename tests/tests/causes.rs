//! What is named is the cause, not what it leads to: periods that were missed, and counters that jumped.

mod scene;

use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::safety::suspected;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_protocol::message::{AxisValues, Command, Fault, Refusal, State};
use haptimill_tests::Bench;
use scene::{commanded, drives_off, joint_off, line, moving, ready, recover, state};

/// A bench like this one at which the fault happens in 10 ms, and where its job began: the same machine again, with the fault in its schedule. It is
/// deterministic.
fn faulty(like: &Bench, speed: f64, fault: &str) -> (Bench, AxisValues) {
    let at = like.rig.time_ns() as f64 * 1e-9 + 0.01;
    let periods = like.rig.time_ns() / 200_000;
    let fault = format!("{fault} at={at}s").parse().expect("a fault");
    let mut bench = Bench::with_options(&RigOptions {
        faults: vec![fault],
        ..RigOptions::default()
    });
    bench.make_ready();
    bench.steps(500);
    let start = bench.status().commanded;
    bench.start_job(
        1,
        &line(&start, 0, speed, if speed == 8.0 { 50 } else { 28 }),
    );
    while bench.rig.time_ns() / 200_000 < periods {
        bench.step();
    }
    (bench, start)
}

#[test]
fn what_missed_periods_lead_to_is_named_after_them() {
    // A drive that keeps its last torque for so long takes its slide along; no encoder is to blame.
    for missed in [15, 50, 100, 200] {
        for speed in [4.0, 16.0] {
            let (mut bench, _) = faulty(
                &moving(0, speed),
                speed,
                &format!("missed-periods count={missed}"),
            );
            bench.steps(3000);
            let status = bench.status();
            assert_eq!(status.fault, Some(Fault::LatePeriod { missed }));
            assert!(status.position_kept);
        }
    }
}

#[test]
fn a_counter_that_jumps_farther_than_a_joint_can_go_leaves_no_position() {
    for counts in [700, -1000, i32::MIN] {
        let (mut bench, _) = faulty(
            &moving(0, 4.0),
            4.0,
            &format!("encoder-slip axis=l1 counts={counts}"),
        );
        bench.steps(1000);
        let status = bench.status();
        assert!(
            matches!(status.fault, Some(Fault::EncoderIllegal { axis: 0, .. })),
            "{:?}",
            status.fault
        );
        assert!(!status.position_kept && !status.homed && drives_off(&bench));
    }
}

/// A machine whose counter slips while it stands (at once) or goes along, until its index pulses tell: the fault, and how far the slide went.
fn slipped(counts: i32, standing: bool) -> (Bench, Fault, f64) {
    let slip = format!("encoder-slip axis=l1 counts={counts}");
    let mut bench = if standing {
        let like = ready();
        let at = like.rig.time_ns() as f64 * 1e-9;
        let fault = format!("{slip} at={at}s").parse().expect("a fault");
        let mut bench = Bench::with_options(&RigOptions {
            faults: vec![fault],
            ..RigOptions::default()
        });
        bench.make_ready();
        bench.steps(2000);
        let start = bench.status().commanded;
        bench.start_job(1, &line(&start, 0, 8.0, 50));
        bench
    } else {
        faulty(&moving(0, 8.0), 8.0, &slip).0
    };
    bench.steps(200);
    let began = bench.rig.truth().joints[0];
    let off = f64::from(counts.abs()) * 10.0 / 8000.0;
    loop {
        bench.step();
        if let Some(fault) = bench.rig.control().safety().fault() {
            let went = bench.rig.truth().joints[0] - began;
            return (bench, fault, went.abs());
        }
        assert_eq!(state(&bench), State::Run, "{counts} were not found");
        assert!((joint_off(&bench, 0) - off).abs() < 0.02);
    }
}

/// The loop takes a joint to wherever its counter says: that a counter lost some counts is not to be seen from the motion (more than 20 give a jolt that is). Two index pulses tell.
#[test]
fn counts_that_are_lost_are_found_within_two_turns() {
    for (counts, standing) in [(-6, false), (8, false), (-12, true), (14, true)] {
        let (mut bench, fault, went) = slipped(counts, standing);
        assert!(went < 20.0, "two turns of the motor");
        let Fault::EncoderSlip {
            axis: 0,
            counts: said,
        } = fault
        else {
            panic!("{counts}: {fault:?}");
        };
        // A count more or less for the side that the pulse is come to from.
        assert!((said - counts).abs() <= 1, "{said} of {counts}");
        assert!(drives_off(&bench));
        let status = bench.status();
        assert!(!status.position_kept && !status.homed);
        // Where the slide is, nobody knows to the turn: somebody has to look.
        recover(&mut bench, State::Disabled);
        assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    }
}

/// Who pushes a slide makes it look like one whose encoder is dead or wired the wrong way. The encoder saw all of it, and its next index pulse says so: no
/// more is to be done than to home.
#[test]
fn a_slide_that_was_pushed_is_only_homed() {
    for effort in [-300, -150, 100, 200, 400] {
        let push = format!("push axis=l1 effort={effort} for=12ms");
        let (mut bench, _) = faulty(&moving(0, 4.0), 4.0, &push);
        bench.steps(1000);
        let status = bench.status();
        let fault = status.fault.expect("a fault");
        assert_eq!(suspected(&fault), Some(0), "{effort} N: {fault:?}");
        assert!(!status.position_kept && !status.homed);
        recover(&mut bench, State::Disabled);
        bench.ask(Command::Home).expect("homes");
        assert!(bench.wait_for(State::Idle, 30_000), "{:?}", bench.status());
        let status = bench.status();
        assert!(status.homed && status.position_kept);
        assert!(joint_off(&bench, 0) < 0.03);
    }
}

/// As it is when the host has sent the configuration again, which is a new machinery.
#[test]
fn an_encoder_is_asked_beyond_a_new_configuration() {
    for (fault, honest) in [
        ("push axis=l1 effort=300 for=12ms", true),
        (
            "encoder-stuck axis=l1 channel=a level=high for=300ms",
            false,
        ),
    ] {
        let (mut bench, _) = faulty(&moving(0, 4.0), 4.0, fault);
        bench.steps(3000);
        bench.ask(Command::Reset).expect("reset");
        bench.configure();
        bench.ask(Command::Enable).expect("on");
        bench.ask(Command::Home).expect("asked");
        let found = bench.wait_for(State::Idle, 30_000);
        let status = bench.status();
        assert_eq!((found, status.homed), (honest, honest), "{status:?}");
        if !honest {
            let slip = matches!(status.fault, Some(Fault::EncoderSlip { axis: 0, .. }));
            assert!(slip, "{status:?}");
        }
    }
}

/// As many as an encoder may be off by itself are let pass, and no healthy one is ever blamed.
#[test]
fn a_line_of_the_encoder_is_tolerated() {
    let (mut bench, _) = faulty(&moving(0, 8.0), 8.0, "encoder-slip axis=l1 counts=3");
    bench.steps(30_000);
    let status = bench.status();
    assert_eq!((status.state, status.fault), (State::Idle, None));
    assert!(status.position_kept);
}

#[test]
fn missed_periods_brake_along_the_path_and_the_drives_hold() {
    for (missed, fault) in [(2, None), (3, Some(3)), (20, Some(20))] {
        let bench = moving(0, 4.0);
        let (mut bench, start) = faulty(&bench, 4.0, &format!("missed-periods count={missed}"));
        bench.steps(3000);
        let status = bench.status();
        assert_eq!(
            status.fault,
            fault.map(|missed| Fault::LatePeriod { missed })
        );
        assert!(status.position_kept);
        if fault.is_some() {
            assert_eq!(status.state, State::Fault);
            assert!(!drives_off(&bench));
            assert_eq!(
                (commanded(&bench)[1], commanded(&bench)[2]),
                (start[1], start[2])
            );
            recover(&mut bench, State::Idle);
        } else {
            assert_eq!(status.state, State::Run);
        }
    }
}

/// A controller whose every call takes longer than a period, while it is told to.
struct Slow {
    control: Controller,
    missed: u16,
}

impl Control for Slow {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.control.tick(inputs, outputs, &mut ());
    }

    fn overrun(&self) -> u16 {
        self.missed
    }
}

/// Loops that were tuned for a period would run at two of them, and the job would take twice as long, without a word.
#[test]
fn a_chip_that_misses_every_second_period_is_told_of() {
    for missed in [1, 2] {
        let slow = Slow {
            control: Controller::new(200),
            missed: 0,
        };
        let mut bench = Bench::with(&RigOptions::default(), slow);
        bench.make_ready();
        bench.steps(500);
        let start = bench.status().commanded;
        bench.start_job(1, &line(&start, 0, 8.0, 28));
        bench.rig.control_mut().missed = missed;
        // Braking takes twice or three times as long as well.
        bench.steps(7500);
        bench.rig.control_mut().missed = 0;
        let status = bench.status();
        assert_eq!(status.fault, Some(Fault::LatePeriod { missed }));
        assert!(status.position_kept);
    }
}

/// A new configuration does not make an encoder better: what was counted against it holds, and where its slides lie in their play is known.
#[test]
fn what_is_known_of_an_encoder_outlives_a_configuration() {
    for reconfigure in [false, true] {
        let mut bench = ready();
        bench.ask(Command::Disable).expect("off");
        let noise = EncoderCondition {
            noise_hz: 20_000.0,
            ..EncoderCondition::default()
        };
        bench.rig.plant_mut().set_encoder_condition(0, noise);
        bench.steps(2000);
        bench
            .rig
            .plant_mut()
            .set_encoder_condition(0, EncoderCondition::default());
        bench.steps(200);
        if reconfigure {
            bench.configure();
        }
        bench.ask(Command::Enable).expect("on");
        let status = bench.status();
        assert!(!status.homed && !status.position_kept, "{reconfigure}");
        assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    }
    let mut bench = moving(0, 8.0);
    assert!(bench.wait_for(State::Idle, 30_000));
    bench.ask(Command::Disable).expect("off");
    bench.steps(2000);
    let before = bench.status();
    bench.configure();
    bench.ask(Command::Enable).expect("on");
    let after = bench.status();
    assert!(after.homed && after.position_kept);
    for (joint, (one, other)) in before.joints.iter().zip(&after.joints).enumerate() {
        // The encoder may have gone on by a count.
        assert!((one - other).abs() <= 1400, "{joint}: {one} {other}");
    }
}

/// Nor does another slack for its index pulses, which is the new one then.
#[test]
fn another_slack_of_the_index_keeps_the_position() {
    let mut bench = ready();
    bench.ask(Command::Disable).expect("off");
    bench.machine.config.joints[0].index_slack = 9;
    bench.configure();
    bench.ask(Command::Enable).expect("on");
    bench.steps(5000);
    let status = bench.status();
    assert_eq!((status.state, status.fault), (State::Idle, None));
    assert!(status.homed && status.position_kept);
}

/// The fault is told, and what it means for the position holds, also where somebody presses reset in the same moment.
#[test]
fn a_reset_in_the_period_of_a_fault_hides_nothing() {
    let slip = "encoder-slip axis=l1 counts=700";
    let (mut like, _) = faulty(&moving(0, 4.0), 4.0, slip);
    while like.rig.control().safety().fault().is_none() {
        like.step();
    }
    let latched = like.rig.time_ns() / 200_000;
    for early in 0..12 {
        let (mut bench, _) = faulty(&moving(0, 4.0), 4.0, slip);
        while bench.rig.time_ns() / 200_000 < latched - early {
            bench.step();
        }
        bench.say(Command::Reset);
        bench.steps(500);
        if state(&bench) == State::Fault {
            bench.ask(Command::Reset).expect("reset");
        }
        bench.steps(2500);
        bench.ask(Command::Enable).expect("on");
        let home = bench.ask(Command::Home);
        assert_eq!(home, Err(Refusal::PresetLost), "{early} periods before");
    }
}
