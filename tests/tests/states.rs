//! States, jobs and configurations: the effect of each command, without a jump of the tool.

use crate::setup;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_protocol::message::{
    AxisValues, Command, DriveAlarm, Event, Fault, InputProblem, Refusal, Source, State,
};
use haptimill_tests::Bench;
use setup::{commanded, drives_off, jog, line, moving, ready, state, step_smoothly};

#[test]
fn jobs_keep_their_boundary_conditions() {
    let mut bench = ready();
    let start = bench.status().commanded;
    // An empty job finishes at once.
    bench
        .ask(Command::JobStart {
            job: 1,
            pose: start.clone(),
        })
        .expect("started");
    bench.ask(Command::JobEnd { count: 0 }).expect("ended");
    bench.steps(20);
    assert_eq!(state(&bench), State::Idle);
    assert!(bench.events.contains(&Event::JobDone {
        job: 1,
        setpoints: 0
    }));
    // The next job begins without a period between.
    for job in 2..5 {
        let start = commanded(&bench)[..5]
            .iter()
            .copied()
            .collect::<AxisValues>();
        bench.start_job(job, &line(&start, 0, 4.0, 1));
        assert_eq!(
            bench.ask(Command::JobStart {
                job: 9,
                pose: start.clone()
            }),
            Err(Refusal::State(State::Run))
        );
        while state(&bench) != State::Idle {
            step_smoothly(&mut bench, 0.0011);
        }
        let there = commanded(&bench)[..5]
            .iter()
            .copied()
            .collect::<AxisValues>();
        assert_eq!(
            bench.ask(Command::JobStart {
                job: 9,
                pose: start.clone()
            }),
            Err(Refusal::StartPose { coordinate: 0 })
        );
        bench.start_job(job + 10, &line(&there, 0, -4.0, 1));
        while state(&bench) != State::Idle {
            step_smoothly(&mut bench, 0.0011);
        }
        // The machine is back, except for the rounding of the line's ends.
        assert!((commanded(&bench)[0] - start[0]).abs() <= 2);
    }
    // An override in a hold takes effect at the resume.
    let start = bench.status().commanded;
    bench.start_job(20, &line(&start, 0, 10.0, 20));
    bench.steps(2500);
    bench.ask(Command::Hold).expect("holds");
    bench.steps(2000);
    let held = commanded(&bench);
    bench
        .ask(Command::Override { percent: 50 })
        .expect("an answer");
    bench.steps(100);
    assert_eq!(commanded(&bench), held);
    bench.ask(Command::Resume).expect("goes on");
    bench.steps(2500);
    let status = bench.status();
    assert!(
        (i32::from(status.speed_factor) - 16384).abs() < 3,
        "{}",
        status.speed_factor
    );
    // A stop drops the job and stops the spindle. The next job begins at the present pose.
    bench.ask(Command::Stop).expect("stops");
    assert!(bench.wait_for(State::Idle, 3000));
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::JobDropped { job: 20, .. }))
    );
}

#[test]
fn a_pause_at_the_last_setpoint_delays_the_end() {
    let mut bench = ready();
    let start = bench.status().commanded;
    let mut points = line(&start, 0, 4.0, 3);
    points[4].action = haptimill_protocol::message::Action::Pause;
    bench.start_job(1, &points);
    assert!(bench.wait_for(State::Hold, 10_000));
    bench.steps(2000);
    assert_eq!(state(&bench), State::Hold);
    assert!(bench.events.contains(&Event::Paused { setpoint: 4 }));
    let done = Event::JobDone {
        job: 1,
        setpoints: 5,
    };
    assert!(!bench.events.contains(&done));
    bench.ask(Command::Resume).expect("goes on");
    bench.steps(100);
    assert_eq!(state(&bench), State::Idle);
    assert!(bench.events.contains(&done));
}

#[test]
fn a_coasting_machine_is_not_enabled() {
    let mut bench = moving(0, 40.0);
    bench.ask(Command::EmergencyStop).expect("off");
    bench.ask(Command::Reset).expect("reset");
    let coasts = Refusal::Input(InputProblem::Coasting);
    assert_eq!(bench.ask(Command::Enable), Err(coasts));
    bench.steps(1000);
    bench.ask(Command::Enable).expect("stands");
    bench.steps(1000);
    let status = bench.status();
    assert!(status.state == State::Idle && status.homed && status.fault.is_none());
}

#[test]
fn a_configuration_under_a_latched_fault_equals_one_after_the_reset() {
    let mut bench = moving(0, 4.0);
    bench.rig.plant_mut().set_encoder_condition(
        0,
        EncoderCondition {
            swapped: true,
            ..EncoderCondition::default()
        },
    );
    bench.steps(2000);
    assert!(matches!(
        bench.status().fault,
        Some(Fault::EncoderStuck { .. } | Fault::EncoderReversed { .. })
    ));
    bench
        .rig
        .plant_mut()
        .set_encoder_condition(0, EncoderCondition::default());
    // The operator sends the configuration before the reset. (Slides away from their presets get
    // the index pulse of the wrong turn: here they moved by two thirds of one.)
    bench.configure();
    bench.ask(Command::Reset).expect("reset");
    bench.ask(Command::Enable).expect("enabled");
    // The index pulse of a suspected encoder shows lost counts; the operator has to set the joints
    // to their presets.
    bench.ask(Command::Home).expect("asked");
    assert!(bench.wait_for(State::Fault, 30_000));
    let slip = bench.status().fault;
    assert!(matches!(slip, Some(Fault::EncoderSlip { joint: 0, .. })));
    bench.steps(1000);
    bench.ask(Command::Reset).expect("reset");
    bench.ask(Command::Enable).expect("enabled");
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    bench.ask(Command::Disable).expect("off");
    bench.configure_as(true);
    bench.ask(Command::Enable).expect("enabled");
    assert_eq!(bench.ask(Command::Home), Ok(()));
}

/// A new gain must neither lose the position nor keep a wrong one.
#[test]
fn a_new_configuration_keeps_the_true_position_or_loses_it() {
    let mut bench = Bench::new();
    bench.make_ready();
    let start = bench.status().commanded;
    bench.start_job(1, &haptimill_tests::line_in_x(&start, -4.0, 20));
    assert!(bench.wait_for(State::Idle, 20_000));
    let before = bench.status();
    bench.ask(Command::Disable).expect("off");
    bench.machine.config.joints[0].law.kp.0 -= 256;
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    let after = bench.status();
    assert!(after.homed);
    for axis in 0..5 {
        assert!(
            (after.measured[axis] - before.measured[axis]).abs() < 21_000,
            "{axis}: {after:?}"
        );
    }
    bench.ask(Command::Disable).expect("off");
    setup::encoder(&mut bench, 1).per_count -= 1;
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    let status = bench.status();
    assert!(!status.homed);
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
}

#[test]
fn missed_periods_in_a_hold_are_reported() {
    let options = RigOptions {
        faults: vec!["missed-periods count=50 at=9s".parse().expect("a fault")],
        ..RigOptions::default()
    };
    let mut bench = Bench::with_options(&options);
    bench.make_ready();
    while bench.rig.time_ns() < 9_100_000_000 {
        bench.step();
    }
    let status = bench.status();
    assert_eq!(status.fault, Some(Fault::MissedPeriods { missed: 50 }));
    assert!(status.homed && !drives_off(&bench));
    // A drive that fails now takes all drives off, and is the latched fault.
    bench.rig.plant_mut().set_condition(
        2,
        haptimill_hil_sim::plant::JointCondition {
            drive_tripped: true,
            ..Default::default()
        },
    );
    bench.steps(2);
    assert!(drives_off(&bench));
    assert_eq!(
        bench.status().fault,
        Some(Fault::Drive {
            joint: 2,
            alarm: DriveAlarm::Input
        })
    );
}

#[test]
fn the_spindle_stops_with_the_job() {
    let mut bench = ready();
    let start = bench.status().commanded;
    let mut points = line(&start, 0, 4.0, 10);
    points[2].action = haptimill_protocol::message::Action::Spindle(12_000);
    bench.start_job(1, &points);
    bench.steps(3500);
    assert_eq!(bench.rig.outputs().spindle_rpm, 12_000);
    assert!(bench.wait_for(State::Idle, 10_000));
    assert_eq!(bench.rig.outputs().spindle_rpm, 0);
}

#[test]
fn an_event_queue_overflow_keeps_the_last_event() {
    let mut bench = ready();
    // More events than the queue holds while the host is silent; the last one is the fault.
    for _ in 0..12 {
        bench.send(Command::Disable);
        bench.send(Command::Enable);
        bench.steps(20);
    }
    bench.events.clear();
    for _ in 0..20 {
        bench.rig.plant_mut().set_emergency_stop(true);
        bench.step_with_fault(Vec::clear);
        bench.rig.plant_mut().set_emergency_stop(false);
        for _ in 0..300 {
            bench.step_with_fault(Vec::clear);
        }
    }
    bench.link.open(99, bench.rig.time_ns() / 1000);
    bench.steps(1000);
    assert!(
        matches!(
            bench.events.last(),
            Some(Event::State {
                to: State::EmergencyStop,
                ..
            })
        ),
        "{:?}",
        bench.events
    );
}

#[test]
fn a_moving_machine_refuses_commands_that_need_standstill() {
    let mut bench = moving(0, 4.0);
    let pose = bench.status().commanded;
    let run = Err(Refusal::State(State::Run));
    assert_eq!(bench.ask(Command::Disable), run);
    assert_eq!(bench.ask(Command::Enable), run);
    assert_eq!(bench.ask(Command::Home), run);
    assert_eq!(bench.ask(Command::JobStart { job: 2, pose }), run);
    assert_eq!(
        bench.ask(Command::Activate {
            length: 1,
            crc: 0,
            at_preset: false
        }),
        run
    );
    assert_eq!(
        bench.ask(Command::Source {
            coordinate: 0,
            source: Source::Jog
        }),
        run
    );
    assert_eq!(bench.ask(jog(1, 100, &[(0, 1.0)])), run);
    assert_eq!(state(&bench), State::Run);
}

/// The host sends half of a job: the missing setpoint is reported, also when it never comes.
#[test]
fn a_missing_setpoint_is_reported() {
    let mut bench = Bench::new();
    bench.make_ready();
    let start = bench.status().commanded;
    let points = haptimill_tests::line_in_x(&start, -4.0, 20);
    bench.start_part(1, &start, &points[..12]);
    bench.steps(10_000);
    bench.ask(Command::Stop).expect("stops");
    bench.steps(500);
    let named = |event: &Event| matches!(event, Event::Underrun { setpoint: 12, late_periods } if *late_periods > 1000);
    assert!(bench.events.iter().any(named), "{:?}", bench.events);
}
