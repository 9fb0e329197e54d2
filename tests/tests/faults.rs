//! Faults of machine, drives and board: the right report, safe outputs in the same period, and the
//! distance that the machine moved.

use crate::setup;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::plant::JointCondition;
use haptimill_protocol::message::{
    Command, DriveAlarm, Event, Fault, InputProblem, Refusal, State,
};
use haptimill_tests::Bench;
use setup::joint_fault::{
    assert_position_kept, home_with_suspected_encoder, joint_fault, run_with_joint_fault,
};
use setup::{
    MM, commanded, distance, drives_off, following_error, line, moving, ready, recover, state, tool,
};

#[test]
fn a_dead_or_reversed_drive_and_a_jammed_slide_are_reported() {
    let well = JointCondition::default();
    for speed in [4.0, 40.0] {
        for (name, condition) in [
            (
                "dead",
                JointCondition {
                    drive_gain: 0.0,
                    ..well
                },
            ),
            (
                "reversed",
                JointCondition {
                    drive_gain: -1.0,
                    ..well
                },
            ),
            (
                "jammed",
                JointCondition {
                    jam: f64::INFINITY,
                    ..well
                },
            ),
        ] {
            let mut struck = run_with_joint_fault(0, 1, speed, joint_fault(1, condition));
            let joint = match struck.fault {
                Fault::EncoderStuck { joint }
                | Fault::EncoderReversed { joint }
                | Fault::FollowingError { joint, .. } => joint,
                other => panic!("{name}: {other:?}"),
            };
            assert_eq!(joint, 1);
            // A jammed slide lags by the limit of the following error plus the wind-up of the
            // screw.
            assert!(struck.off < 0.75, "{name}: {} mm", struck.off);
            struck.bench.rig.plant_mut().set_condition(1, well);
            assert!(home_with_suspected_encoder(&mut struck.bench), "{name}");
        }
    }
}

#[test]
fn the_limit_of_the_following_error_grows_with_the_speed() {
    for speed in [4.0, 10.0] {
        let held = JointCondition {
            jam: f64::INFINITY,
            ..JointCondition::default()
        };
        let struck = run_with_joint_fault(0, 0, speed, joint_fault(0, held));
        let Fault::FollowingError {
            joint: 0,
            error,
            limit,
        } = struck.fault
        else {
            panic!("{:?}", struck.fault)
        };
        let (error, limit) = (f64::from(error) / MM, f64::from(limit) / MM);
        assert!(
            (limit - 0.3 - 0.010 * speed).abs() < 1e-3,
            "{limit} at {speed} mm/s"
        );
        assert!(error > limit && error < limit + 0.01, "{error}");
    }
}

#[test]
fn a_tripped_drive_or_limit_switch_stops_all_drives_in_one_period() {
    let well = JointCondition::default();
    let stuck = |switch: usize| {
        let mut condition = well;
        condition.switches[switch].stuck = Some(true);
        condition
    };
    for (condition, fault) in [
        (
            JointCondition {
                drive_tripped: true,
                ..well
            },
            Fault::Drive {
                joint: 3,
                alarm: DriveAlarm::Input,
            },
        ),
        (stuck(1), Fault::LimitSwitch { joint: 3 }),
        (stuck(2), Fault::LimitSwitch { joint: 3 }),
    ] {
        let mut struck = run_with_joint_fault(0, 3, 20.0, joint_fault(3, condition));
        assert_eq!((struck.fault, struck.periods), (fault, 0));
        struck.bench.ask(Command::Reset).expect("reset");
        let problem = match fault {
            Fault::Drive { joint, alarm } => InputProblem::Drive { joint, alarm },
            _ => InputProblem::LimitSwitch { joint: 3 },
        };
        let refusal = Refusal::Input(problem);
        assert_eq!(struck.bench.ask(Command::Enable), Err(refusal));
        struck.bench.rig.plant_mut().set_condition(3, well);
        // A switch far from the measured end of the stroke contradicts the encoder.
        if matches!(fault, Fault::LimitSwitch { .. }) {
            assert!(home_with_suspected_encoder(&mut struck.bench));
        } else {
            assert_position_kept(&mut struck.bench);
        }
    }
}

#[test]
fn the_emergency_stop_by_circuit_or_command_switches_the_drives_off() {
    for wire in [true, false] {
        let mut bench = moving(0, 40.0);
        let here = tool(&bench);
        if wire {
            bench.rig.plant_mut().set_emergency_stop(true);
            bench.step();
        } else {
            bench.send(Command::EmergencyStop).expect("room");
            bench.steps(2);
        }
        assert_eq!(state(&bench), State::EmergencyStop);
        assert!(drives_off(&bench));
        bench.steps(2000);
        // 40 mm/s against friction alone gives 0.8 mm; 8 um per period before.
        let gone = distance(&bench, here);
        assert!(gone < 0.9, "{gone} mm");
        assert!(
            bench.events.contains(&Event::JobDropped {
                job: 1,
                setpoints: 6
            }),
            "{:?}",
            bench.events
        );
        if wire {
            let pressed = Refusal::Input(InputProblem::EmergencyStop);
            assert_eq!(bench.ask(Command::Reset), Err(pressed));
            bench.rig.plant_mut().set_emergency_stop(false);
        }
        assert_position_kept(&mut bench);
    }
}

#[test]
fn an_emergency_stop_during_homing_leaves_no_joint_homed() {
    let mut bench = Bench::new();
    bench.steps(500);
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    bench.ask(Command::Home).expect("homing");
    bench.steps(1000);
    bench.ask(Command::EmergencyStop).expect("stopped");
    assert_eq!(state(&bench), State::EmergencyStop);
    assert!(drives_off(&bench));
    let status = bench.status();
    assert!(!status.homed);
    recover(&mut bench, State::Disabled);
    // The encoders went on counting: the presets hold, and homing starts again.
    bench.ask(Command::Home).expect("homing");
    bench.steps(12_000);
    assert!(bench.status().homed);
}

#[test]
fn a_silent_host_stops_the_machine_along_its_path() {
    let mut bench = moving(0, 20.0);
    let (line_y, line_z) = (commanded(&bench)[1], commanded(&bench)[2]);
    let (mut begun, mut mark) = (None, None);
    for period in 0..6000 {
        // The host sends nothing, and its received bytes are dropped.
        bench.step_with_fault(Vec::clear);
        assert_eq!(
            (commanded(&bench)[1], commanded(&bench)[2]),
            (line_y, line_z)
        );
        let safety = bench.rig.control().safety();
        if begun.is_none() && safety.pending().is_some() {
            begun = Some(period);
        }
        if mark.is_none() && state(&bench) == State::Fault {
            mark = Some(period);
        }
    }
    // 70 ms between keep-alive frames, 500 ms heartbeat, 300 ms deceleration, 2 ms rounding.
    let (begun, mark) = (begun.expect("noticed"), mark.expect("latched"));
    eprintln!(
        "silent host: braking after {} ms, at rest {} ms later",
        begun / 5,
        (mark - begun) / 5
    );
    assert!((2150..=2510).contains(&begun), "{begun}");
    assert!(mark - begun <= 1550, "{}", mark - begun);
    let safety = bench.rig.control().safety();
    assert!(
        matches!(
            safety.fault(),
            Some(Fault::LostHost {
                silent_ms: 501..=502
            })
        ),
        "{:?}",
        safety.fault()
    );
    assert!(safety.homed() && safety.drives_on() && !drives_off(&bench));
    // A new host takes over.
    let now = bench.rig.time_ns() / 1000;
    bench.link.open(78, now);
    bench.steps(200);
    assert_eq!(bench.status().state, State::Fault);
    recover(&mut bench, State::Idle);
}

#[test]
fn late_setpoints_slow_the_machine_along_its_path_and_are_reported() {
    let mut bench = ready();
    let start = bench.status().commanded;
    let points = line(&start, 0, 10.0, 28);
    bench
        .ask(Command::JobStart {
            job: 4,
            pose: start.clone(),
        })
        .expect("started");
    let mut coder = haptimill_protocol::setpoint::SetpointCoder::new(200, &start);
    let mut send = |bench: &mut Bench, range: core::ops::Range<usize>| {
        for index in range {
            let items = [coder.encode(&points[index]).expect("codes")]
                .into_iter()
                .collect();
            bench
                .ask(Command::Setpoints(
                    haptimill_protocol::message::SetpointBatch {
                        first: index as u32,
                        items,
                    },
                ))
                .expect("accepted");
        }
    };
    send(&mut bench, 0..15);
    bench.steps(9000);
    let status = bench.status();
    assert_eq!((status.state, status.speed_factor), (State::Run, 0));
    // The machine stopped on the line, before the last setpoint.
    assert!(status.commanded[0] < points[14].pose[0]);
    assert_eq!(
        (status.commanded[1], status.commanded[2]),
        (start[1], start[2])
    );
    assert!(status.homed && status.fault.is_none());
    send(&mut bench, 15..30);
    bench.ask(Command::JobEnd { count: 30 }).expect("ended");
    assert!(bench.wait_for(State::Idle, 20_000));
    let underrun: Vec<_> = bench
        .events
        .iter()
        .filter(|event| matches!(event, Event::Underrun { .. }))
        .collect();
    let [
        Event::Underrun {
            setpoint: 15,
            late_periods,
        },
    ] = underrun[..]
    else {
        panic!("{underrun:?}")
    };
    // 1.5 s of setpoints, deceleration from 0.15 s before their end, then standstill until period
    // 9000.
    assert!((1500..4000).contains(late_periods), "{late_periods}");
    assert!(bench.events.contains(&Event::JobDone {
        job: 4,
        setpoints: 30
    }));
    assert_eq!(commanded(&bench)[0], points[29].pose[0]);
}

/// Returns the homed machine with step motors in the middle of a line in x.
fn step_machine(speed: f64) -> Bench {
    let text = include_str!("../../machines/h4-step.toml");
    let machine = haptimill_machine_file::MachineFile::parse("h4-step.toml", text).expect("sound");
    let options = haptimill_hil_sim::rig::RigOptions::default();
    let controller = haptimill_firmware::controller::Controller::new(200);
    let mut bench = Bench::of_machine(machine, &options, controller);
    bench.make_ready();
    bench.steps(500);
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 0, speed, 28));
    bench.steps(3000);
    assert_eq!(state(&bench), State::Run);
    bench
}

#[test]
fn a_stalled_step_motor_or_wrong_encoder_stops_the_whole_path() {
    let clean = EncoderCondition::default();
    let well = JointCondition::default();
    let cases: [(&str, EncoderCondition, JointCondition); 6] = [
        (
            "jammed",
            clean,
            JointCondition {
                jam: f64::INFINITY,
                ..well
            },
        ),
        (
            "dead",
            clean,
            JointCondition {
                drive_gain: 0.0,
                ..well
            },
        ),
        (
            "stuck a",
            EncoderCondition {
                stuck_a: Some(true),
                ..clean
            },
            well,
        ),
        (
            "stuck b",
            EncoderCondition {
                stuck_b: Some(false),
                ..clean
            },
            well,
        ),
        (
            "swapped",
            EncoderCondition {
                swapped: true,
                ..clean
            },
            well,
        ),
        (
            "tripped",
            clean,
            JointCondition {
                drive_tripped: true,
                ..well
            },
        ),
    ];
    for speed in [4.0, -10.0] {
        for (name, encoder, joint) in &cases {
            let mut bench = step_machine(speed);
            bench.rig.plant_mut().set_encoder_condition(1, *encoder);
            bench.rig.plant_mut().set_condition(1, *joint);
            let mut off = 0.0_f64;
            let period = (0..2000).find(|_| {
                off = off.max(following_error(&bench, 1));
                bench.step();
                drives_off(&bench)
            });
            let fault = bench.rig.control().safety().fault();
            println!(
                "{name} at {speed} mm/s: {fault:?}, off {off:.3} mm, after {period:?} periods"
            );
            let kept = match fault {
                Some(
                    Fault::StepsLost { joint: 1, .. }
                    | Fault::EncoderStuck { joint: 1 }
                    | Fault::EncoderReversed { joint: 1 }
                    | Fault::FollowingError { joint: 1, .. },
                ) => false,
                Some(Fault::Drive { joint: 1, .. }) => true,
                other => panic!("{name}: {other:?}"),
            };
            assert_eq!(bench.rig.control().safety().homed(), kept);
            // Steps and encoder may differ by 0.05 mm. A motor under a jam also winds up its screw:
            // 1200 N on 2500 N/mm.
            assert!(off < 0.06 + 1200.0 / 2500.0, "{name}: {off} mm");
        }
    }
}
