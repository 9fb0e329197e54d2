//! States, homing, jogs and sources in the whole machine: what each command does, and that nothing jumps.

mod scene;

use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::{BUILT_IN, MachineFile};
use haptimill_protocol::message::{
    AxisValues, Command, Event, Fault, HomingProblem, InputProblem, Refusal, Source, State,
};
use haptimill_tests::Bench;
use scene::{
    DEGREE, MM, commanded, distance, drives_off, jog, line, moving, ready, recover, state,
    step_smoothly, told, tool,
};

/// The built-in machine with some lines of its file changed.
fn changed(changes: &[(&str, &str)]) -> Bench {
    let mut text = BUILT_IN.to_string();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let machine = MachineFile::parse("changed.toml", &text).expect("sound");
    Bench::of_machine(machine, &RigOptions::default(), Controller::new(200))
}

fn enabled(mut bench: Bench) -> Bench {
    bench.steps(500);
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    bench
}

/// Largest distance of the measured from the true pose: mm, and degrees for tilt and table.
fn pose_off(bench: &mut Bench) -> (f64, f64) {
    let status = bench.status();
    let off = |axis: usize, unit: f64| {
        (f64::from(status.measured[axis]) / unit - bench.rig.truth().pose[axis]).abs()
    };
    let linear = (0..3).map(|axis| off(axis, MM)).fold(0.0, f64::max);
    (linear, off(3, DEGREE).max(off(4, DEGREE)))
}

#[test]
fn homing_finds_the_references_wherever_the_slides_were_set_up() {
    let (mut worst, mut worst_angle) = (0.0_f64, 0.0_f64);
    for seed in 1..=25 {
        // Up to 2.2 mm off the preset, each slide its own way.
        let mut bench = enabled(changed(&[
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
        let (linear, angle) = pose_off(&mut bench);
        worst = worst.max(linear);
        worst_angle = worst_angle.max(angle);
        assert!(
            linear < 0.03 && angle < 0.02,
            "seed {seed}: {linear} mm, {angle} degrees"
        );
        // The search goes at 5 mm/s: 1 um a period, and what the slides swing.
        assert!(jump < 0.004, "{jump} mm in a period");
    }
    println!("25 homings: at worst {worst:.4} mm, {worst_angle:.4} degrees");
}

#[test]
fn homing_is_one_transaction() {
    for joint in 0..5 {
        let mut bench = enabled(Bench::new());
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
            axis: joint as u8,
            problem: HomingProblem::NoIndex,
        };
        assert_eq!(told(&bench), [&Event::Fault(fault)]);
        let status = bench.status();
        assert!(!status.homed && !status.position_kept);
        // Nothing was corrected: it can begin anew when the line is mended.
        bench
            .rig
            .plant_mut()
            .set_encoder_condition(joint, EncoderCondition::default());
        recover(&mut bench, State::Disabled);
        bench.ask(Command::Home).expect("homing");
        bench.steps(20_000);
        assert!(bench.status().homed);
        let (linear, angle) = pose_off(&mut bench);
        assert!(
            linear < 0.03 && angle < 0.02,
            "{linear} mm, {angle} degrees"
        );
    }
}

#[test]
fn an_index_that_cannot_be_is_refused() {
    // The encoder of slide 3 was mounted anew: its index is half a turn away from what the machine file says.
    let mut bench = enabled(changed(&[("index = 1133.9 ", "index = 1138.9 ")]));
    bench.ask(Command::Home).expect("homing");
    bench.steps(20_000);
    let implausible = Fault::Homing {
        axis: 2,
        problem: HomingProblem::Implausible,
    };
    assert_eq!(bench.rig.control().safety().fault(), Some(implausible));
    assert!(drives_off(&bench));
}

#[test]
fn homing_can_be_stopped_and_done_again() {
    let mut bench = enabled(Bench::new());
    for stop in [Command::Stop, Command::Hold] {
        bench.ask(Command::Home).expect("homing");
        bench.steps(700);
        bench.ask(stop).expect("stopped");
        assert!(bench.wait_for(State::Idle, 3000));
        let status = bench.status();
        assert!(!status.homed && !status.position_kept && status.fault.is_none());
    }
    for _ in 0..3 {
        bench.ask(Command::Home).expect("homing");
        assert!(bench.wait_for(State::Idle, 40_000));
        assert!(bench.status().homed);
        let (linear, angle) = pose_off(&mut bench);
        assert!(
            linear < 0.03 && angle < 0.02,
            "{linear} mm, {angle} degrees"
        );
    }
}

#[test]
fn a_jog_lives_until_its_deadline() {
    let mut bench = ready();
    let before = commanded(&bench);
    bench.ask(jog(1, 100, &[(0, 10.0)])).expect("jogs");
    let mut moving_for = 0;
    for _ in 0..3000 {
        step_smoothly(&mut bench, 0.0021);
        moving_for += usize::from(state(&bench) == State::Jog);
    }
    assert_eq!(state(&bench), State::Idle);
    // 100 ms, and what 10 mm/s takes to brake at 200 mm/s^2 and 5000 mm/s^3: 90 ms.
    assert!((500..=1000).contains(&moving_for), "{moving_for} periods");
    assert!(commanded(&bench)[0] > before[0]);
    assert_eq!(commanded(&bench)[1..], before[1..]);
}

#[test]
fn a_cancelled_jog_is_over_whatever_comes_late() {
    // The cancel overtakes or follows: it is broken at every byte, so that it comes again later; jogs of its epoch come after it.
    for offset in 0..20 {
        let mut bench = ready();
        bench.ask(jog(5, 1000, &[(1, 20.0)])).expect("jogs");
        bench.steps(300);
        bench.say(Command::JogCancel { epoch: 5 }).expect("room");
        bench.step_with_fault(|bytes| {
            if let Some(byte) = bytes.get_mut(offset) {
                *byte ^= 0x55;
            }
        });
        assert_eq!(
            bench.ask(jog(5, 1000, &[(1, 20.0)])),
            Err(Refusal::OldEpoch)
        );
        assert_eq!(
            bench.ask(jog(4, 1000, &[(1, 20.0)])),
            Err(Refusal::OldEpoch)
        );
        bench.steps(1500);
        assert_eq!(state(&bench), State::Idle);
        bench.ask(jog(6, 10, &[(1, 1.0)])).expect("a new epoch");
    }
}

#[test]
fn a_stop_ends_the_epoch_of_jogs() {
    for stop in [Command::Stop, Command::Hold] {
        let mut bench = ready();
        bench.ask(jog(1, 200, &[(0, 10.0)])).expect("jogs");
        bench.steps(300);
        bench.say(stop).expect("room");
        // The jogger has not heard of it and goes on.
        for _ in 0..60 {
            bench.say(jog(1, 200, &[(0, 10.0)]));
            bench.steps(50);
        }
        assert_eq!(state(&bench), State::Idle);
        let standing = commanded(&bench);
        bench.steps(500);
        assert_eq!(commanded(&bench), standing);
    }
}

#[test]
fn a_jog_stops_before_soft_limits_strokes_and_the_reach() {
    let mut bench = ready();
    let mut limited = 0;
    for (epoch, of) in [
        [(0, 50.0), (0, 50.0)],
        [(2, -50.0), (2, -50.0)],
        [(1, 50.0), (3, 30.0)],
        [(0, -50.0), (4, -30.0)],
        [(3, -30.0), (1, -50.0)],
        [(2, 50.0), (0, 50.0)],
    ]
    .into_iter()
    .enumerate()
    {
        for _ in 0..100 {
            let _ = bench.ask(jog(epoch as u16, 300, &of));
            for _ in 0..500 {
                step_smoothly(&mut bench, 0.0101);
                let now = commanded(&bench);
                let config = &bench.machine.config;
                for (axis, limits) in config.pose.iter().enumerate() {
                    assert!(
                        now[axis] >= limits.low.0 && now[axis] <= limits.high.0,
                        "axis {axis}"
                    );
                }
            }
            if state(&bench) == State::Idle {
                break;
            }
        }
        bench.steps(3000);
        assert_eq!(
            state(&bench),
            State::Idle,
            "{:?}",
            bench.rig.control().safety().fault()
        );
        limited += usize::from(
            bench
                .events
                .iter()
                .any(|event| matches!(event, Event::JogLimited { .. })),
        );
        bench.events.clear();
    }
    assert!(limited >= 5, "{limited} were limited");
}

#[test]
fn small_questions_of_jobs() {
    let mut bench = ready();
    let start = bench.status().commanded;
    // An empty job is done at once.
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
    // The next one begins right after the last one's end, without a period of rest.
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
            Err(Refusal::StartPose { axis: 0 })
        );
        bench.start_job(job + 10, &line(&there, 0, -4.0, 1));
        while state(&bench) != State::Idle {
            step_smoothly(&mut bench, 0.0011);
        }
        // Back, but for what the line's ends were rounded by.
        assert!((commanded(&bench)[0] - start[0]).abs() <= 2);
    }
    // Override while it holds: heard, and of effect when it goes on.
    let start = bench.status().commanded;
    bench.start_job(20, &line(&start, 0, 10.0, 20));
    bench.steps(2500);
    bench.ask(Command::Hold).expect("holds");
    bench.steps(2000);
    let held = commanded(&bench);
    bench.ask(Command::Override { percent: 50 }).expect("heard");
    bench.steps(100);
    assert_eq!(commanded(&bench), held);
    bench.ask(Command::Resume).expect("goes on");
    bench.steps(2500);
    let status = bench.status();
    assert!(
        (i32::from(status.path_rate) - 32767).abs() < 3,
        "{}",
        status.path_rate
    );
    // A stop drops the job and the spindle; where it is, is where the next one begins.
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
fn a_pause_at_the_last_setpoint_is_waited_for() {
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
fn a_machine_that_coasts_is_not_enabled() {
    let mut bench = moving(0, 40.0);
    bench.ask(Command::EmergencyStop).expect("off");
    bench.ask(Command::Reset).expect("reset");
    let coasts = Refusal::Input(InputProblem::Coasting);
    assert_eq!(bench.ask(Command::Enable), Err(coasts));
    bench.steps(1000);
    bench.ask(Command::Enable).expect("stands");
    bench.steps(1000);
    let status = bench.status();
    assert!(status.state == State::Idle && status.position_kept && status.fault.is_none());
}

#[test]
fn a_configuration_that_is_activated_under_a_latched_fault_is_as_good_as_one_after_its_reset() {
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
    // The operator sends the configuration first and resets then. (Slides that are not at their presets are found by their indexes at the
    // wrong turn: here they moved by two thirds of one.)
    bench.configure();
    bench.ask(Command::Reset).expect("reset");
    bench.ask(Command::Enable).expect("enabled");
    // An encoder that is suspected is asked at its index: it did not count right, and where the joints are is for the operator to say.
    bench.ask(Command::Home).expect("asked");
    assert!(bench.wait_for(State::Fault, 30_000));
    let slip = bench.status().fault;
    assert!(matches!(slip, Some(Fault::EncoderSlip { axis: 0, .. })));
    bench.steps(1000);
    bench.ask(Command::Reset).expect("reset");
    bench.ask(Command::Enable).expect("enabled");
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    bench.ask(Command::Disable).expect("off");
    bench.configure_as(true);
    bench.ask(Command::Enable).expect("enabled");
    assert_eq!(bench.ask(Command::Home), Ok(()));
}

/// A new gain must not make the machine forget, or believe wrongly, where it is.
#[test]
fn a_new_configuration_keeps_the_position_or_gives_it_up() {
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
    assert!(after.homed && after.position_kept);
    for axis in 0..5 {
        assert!(
            (after.measured[axis] - before.measured[axis]).abs() < 21_000,
            "{axis}: {after:?}"
        );
    }
    bench.ask(Command::Disable).expect("off");
    bench.machine.config.joints[1].per_count -= 1;
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    let status = bench.status();
    assert!(!status.homed && !status.position_kept);
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
}

#[test]
fn missed_periods_while_it_holds_are_told_as_well() {
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
    assert_eq!(status.fault, Some(Fault::LatePeriod { missed: 50 }));
    assert!(status.position_kept && !drives_off(&bench));
    // A drive that fails now takes them all off, and is the fault that stays.
    bench.rig.plant_mut().set_condition(
        2,
        haptimill_hil_sim::plant::JointCondition {
            drive_tripped: true,
            ..Default::default()
        },
    );
    bench.steps(2);
    assert!(drives_off(&bench));
    assert_eq!(bench.status().fault, Some(Fault::Drive { axis: 2 }));
}

#[test]
fn the_spindle_ends_with_the_job() {
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
fn what_nobody_heard_does_not_hide_what_came_last() {
    let mut bench = ready();
    // More events than the queue holds, while the host is away; the last one is the fault.
    for _ in 0..12 {
        bench.say(Command::Disable);
        bench.say(Command::Enable);
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
fn a_corrected_pose_does_not_move_the_tool() {
    // The correction at the end of homing changes all coordinates by up to millimetres; the machine stands still.
    let mut bench = enabled(changed(&[("start_spread = 0.3", "start_spread = 2.0")]));
    bench.ask(Command::Home).expect("homing");
    while state(&bench) == State::Homing {
        bench.step();
    }
    let before = tool(&bench);
    let mut most = 0.0_f64;
    for _ in 0..1000 {
        bench.step();
        most = most.max(distance(&bench, before));
    }
    println!("correction: the tool moved {most:.4} mm");
    assert!(most < 0.02, "{most} mm");
}

#[test]
fn a_moving_machine_refuses_what_needs_rest() {
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
            axis: 0,
            source: Source::Jog
        }),
        run
    );
    assert_eq!(bench.ask(jog(1, 100, &[(0, 1.0)])), run);
    assert_eq!(state(&bench), State::Run);
}

/// The host says half of a job and no more: the setpoint that is missing has a name, also when it never comes.
#[test]
fn a_setpoint_that_never_comes_is_named() {
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
