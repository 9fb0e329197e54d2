//! Cause of a fault: a missed period or a counter jump is reported, not its consequence.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::safety::suspected;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_protocol::message::{AxisValues, Command, Fault, Refusal, State};
use haptimill_tests::Bench;
use setup::{commanded, drives_off, following_error, line, moving, ready, recover, state};

/// Returns the same machine with the faults, separated by `; `, in its schedule in 10 ms, and the
/// start of its job.
///
/// The simulation is deterministic, so the machine is in the same state.
fn bench_with_fault(like: &Bench, speed: f64, faults: &str) -> (Bench, AxisValues) {
    let at = like.rig.time_ns() as f64 * 1e-9 + 0.01;
    let periods = like.rig.time_ns() / 200_000;
    let faults = (faults.split("; "))
        .map(|fault| format!("{fault} at={at}s").parse().expect("a fault"))
        .collect();
    let mut bench = Bench::with_options(&RigOptions {
        faults,
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
fn missed_periods_are_reported_before_their_consequences() {
    // A drive that keeps its last torque for so many periods moves its slide. No encoder is
    // defective.
    for missed in [15, 50, 100, 200] {
        for speed in [4.0, 16.0] {
            let (mut bench, _) = bench_with_fault(
                &moving(0, speed),
                speed,
                &format!("missed-periods count={missed}"),
            );
            bench.steps(3000);
            let status = bench.status();
            assert_eq!(status.fault, Some(Fault::MissedPeriods { missed }));
            // Off drives mean that a joint did not follow: its encoder is suspected.
            assert_eq!(status.homed, !drives_off(&bench));
        }
    }
}

/// An encoder that is reversed in the same period in which periods were missed. The fault that is
/// reported is the missed periods, but the position is wrong.
#[test]
fn missed_periods_do_not_keep_the_position_of_a_reversed_encoder() {
    for missed in [3, 15, 50] {
        for speed in [4.0, 16.0] {
            let faults = format!("missed-periods count={missed}; encoder-swapped joint=l1");
            let (mut bench, _) = bench_with_fault(&moving(0, speed), speed, &faults);
            bench.steps(3000);
            let status = bench.status();
            let off = bench.rig.plant().bodies().motor[0] - f64::from(status.joints[0]) / setup::MM;
            println!("{missed} at {speed}: {:?}, {off:.3} mm off", status.fault);
            assert!(!status.homed, "{status:?}");
            assert!(drives_off(&bench));
        }
    }
}

#[test]
fn a_counter_jump_loses_the_position() {
    for counts in [700, -1000, i32::MIN] {
        let (mut bench, _) = bench_with_fault(
            &moving(0, 4.0),
            4.0,
            &format!("encoder-slip joint=l1 counts={counts}"),
        );
        bench.steps(1000);
        let status = bench.status();
        assert!(
            matches!(status.fault, Some(Fault::CounterJump { joint: 0, .. })),
            "{:?}",
            status.fault
        );
        assert!(!status.homed && drives_off(&bench));
    }
}

/// Slips a counter at standstill or in motion. Returns the fault, and the travel until it.
fn slip_until_fault(counts: i32, standing: bool) -> (Bench, Fault, f64) {
    let slip = format!("encoder-slip joint=l1 counts={counts}");
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
        bench_with_fault(&moving(0, 8.0), 8.0, &slip).0
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
        assert!((following_error(&bench, 0) - off).abs() < 0.02);
    }
}

/// The servo moves a joint to the position that its counter shows, so lost counts are not visible
/// in the motion. (More than 20 cause a jolt.) Two index pulses reveal them.
#[test]
fn lost_counts_are_found_within_two_turns() {
    for (counts, standing) in [(-6, false), (8, false), (-12, true), (14, true)] {
        let (mut bench, fault, went) = slip_until_fault(counts, standing);
        assert!(went < 20.0, "two turns of the motor");
        let Fault::EncoderSlip {
            joint: 0,
            counts: reported,
        } = fault
        else {
            panic!("{counts}: {fault:?}");
        };
        // The index pulse has two positions, one count apart, by direction.
        assert!((reported - counts).abs() <= 1, "{reported} of {counts}");
        assert!(drives_off(&bench));
        let status = bench.status();
        assert!(!status.homed);
        // The turn of the slide is unknown: the operator has to look.
        recover(&mut bench, State::Disabled);
        assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    }
}

/// A pushed slide looks like one with a dead or reversed encoder. The encoder counted the motion,
/// and its next index pulse confirms that: homing is enough.
#[test]
fn a_pushed_slide_needs_only_homing() {
    for effort in [-300, -150, 150, 200, 400] {
        let push = format!("push joint=l1 effort={effort} for=12ms");
        let (mut bench, _) = bench_with_fault(&moving(0, 4.0), 4.0, &push);
        bench.steps(1000);
        let status = bench.status();
        let fault = status
            .fault
            .unwrap_or_else(|| panic!("{effort} N: no fault"));
        assert_eq!(suspected(&fault), Some(0), "{effort} N: {fault:?}");
        assert!(!status.homed);
        recover(&mut bench, State::Disabled);
        bench.ask(Command::Home).expect("homes");
        assert!(bench.wait_for(State::Idle, 30_000), "{:?}", bench.status());
        let status = bench.status();
        assert!(status.homed);
        assert!(following_error(&bench, 0) < 0.03);
    }
}

/// A configuration that is sent again builds the machine anew.
#[test]
fn a_suspected_encoder_stays_suspected_with_a_new_configuration() {
    for (fault, position_confirmed) in [
        ("push joint=l1 effort=300 for=12ms", true),
        (
            "encoder-stuck joint=l1 channel=a level=high for=300ms",
            false,
        ),
    ] {
        let (mut bench, _) = bench_with_fault(&moving(0, 4.0), 4.0, fault);
        bench.steps(3000);
        bench.ask(Command::Reset).expect("reset");
        bench.configure();
        bench.ask(Command::Enable).expect("on");
        bench.ask(Command::Home).expect("asked");
        let found = bench.wait_for(State::Idle, 30_000);
        let status = bench.status();
        assert_eq!(
            (found, status.homed),
            (position_confirmed, position_confirmed),
            "{status:?}"
        );
        if !position_confirmed {
            let slip = matches!(status.fault, Some(Fault::EncoderSlip { joint: 0, .. }));
            assert!(slip, "{status:?}");
        }
    }
}

/// An encoder may be off by this many counts itself. A healthy one is never reported.
#[test]
fn an_offset_of_one_encoder_line_is_tolerated() {
    let (mut bench, _) = bench_with_fault(&moving(0, 8.0), 8.0, "encoder-slip joint=l1 counts=3");
    bench.steps(30_000);
    let status = bench.status();
    assert_eq!((status.state, status.fault), (State::Idle, None));
    assert!(status.homed);
}

#[test]
fn missed_periods_stop_the_machine_along_its_path_with_drives_on() {
    for (missed, fault) in [(2, None), (3, Some(3)), (20, Some(20))] {
        let bench = moving(0, 4.0);
        let (mut bench, start) =
            bench_with_fault(&bench, 4.0, &format!("missed-periods count={missed}"));
        bench.steps(3000);
        let status = bench.status();
        assert_eq!(
            status.fault,
            fault.map(|missed| Fault::MissedPeriods { missed })
        );
        assert!(status.homed);
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

/// A controller whose calls take longer than a period while `slow` is set.
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

/// At half the control rate the servo gains are wrong, and a job would take twice as long without a
/// report.
#[test]
fn missing_every_second_period_is_reported() {
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
        // The deceleration takes two or three times as long as well.
        bench.steps(7500);
        bench.rig.control_mut().missed = 0;
        let status = bench.status();
        assert_eq!(status.fault, Some(Fault::MissedPeriods { missed }));
        assert!(status.homed);
    }
}

/// A new configuration does not repair an encoder: its suspicion stays, and the flank of its screw
/// stays known.
#[test]
fn an_encoder_record_survives_a_new_configuration() {
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
        assert!(!status.homed, "{reconfigure}");
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
    assert!(after.homed);
    for (joint, (one, other)) in before.joints.iter().zip(&after.joints).enumerate() {
        // The encoder may have moved by a count.
        assert!((one - other).abs() <= 1400, "{joint}: {one} {other}");
    }
}

/// A new index slack does not lift the suspicion; the new slack applies.
#[test]
fn a_new_index_slack_keeps_the_position() {
    let mut bench = ready();
    bench.ask(Command::Disable).expect("off");
    setup::encoder(&mut bench, 0).index_slack = 9;
    bench.configure();
    bench.ask(Command::Enable).expect("on");
    bench.steps(5000);
    let status = bench.status();
    assert_eq!((status.state, status.fault), (State::Idle, None));
    assert!(status.homed);
}

/// A reset in the period of the fault hides neither the fault nor the lost position.
#[test]
fn a_reset_in_the_period_of_a_fault_does_not_hide_it() {
    let slip = "encoder-slip joint=l1 counts=700";
    let (mut like, _) = bench_with_fault(&moving(0, 4.0), 4.0, slip);
    while like.rig.control().safety().fault().is_none() {
        like.step();
    }
    let latched = like.rig.time_ns() / 200_000;
    for early in 0..12 {
        let (mut bench, _) = bench_with_fault(&moving(0, 4.0), 4.0, slip);
        while bench.rig.time_ns() / 200_000 < latched - early {
            bench.step();
        }
        bench.send(Command::Reset);
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
