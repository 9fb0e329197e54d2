//! Force control in the whole machine: the admittance law, its settings and its limits.
//!
//! The arm has friction and backlash, the sensor has noise. The contact is a cutter or an elastic
//! wall.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::RigOptions;
use haptimill_machine_file::{BUILT_IN, MachineFile};
use haptimill_protocol::force::{EnableCondition, ForceLoop, ForceParameter, ForceRefusal};
use haptimill_protocol::message::{Command, Event, Refusal, State};
use haptimill_tests::Bench;
use setup::force::{
    NEWTON, PERIOD, block, control, displacement, displacement_rate, force_settings, job, levels,
    peak, sensor_alone, tare, tared_machine, turn_table, wall,
};
use setup::{MM, distance, line, reported_faults, state, tool};

/// The integral of F - f_d is K_V times the change of p_c plus K_A times that of its rate. Then the
/// tool returns.
#[test]
fn the_displacement_follows_the_admittance_law_and_returns() {
    for (mass, damping) in [(1.0, 5.0), (0.25, 0.5)] {
        let mut bench = setup::ready();
        // At a level table and three times the force the contact-stability monitor would damp this
        // cut.
        turn_table(&mut bench, 3.6);
        let process = block(tool(&bench), 3.0);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        tare(&mut bench);
        control(
            &mut bench,
            0,
            force_settings(mass, damping, EnableCondition::AgainstMotion),
        );
        let end = job(&mut bench, -4.0, 40, 20.0);
        let mut before = 0.0;
        while displacement(&bench) < 0.02 {
            before = peak(&bench);
            bench.step();
            assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
        }
        assert!(before > 5.0);
        let (from, rate_from) = (displacement(&bench), displacement_rate(&bench));
        let (mut pushed, mut max) = (0.0, 0.0_f64);
        for _ in 0..7500 {
            bench.step();
            pushed += (peak(&bench) - 5.0) * PERIOD;
            max = max.max(peak(&bench));
        }
        let expected = damping * (displacement(&bench) - from)
            + mass * (displacement_rate(&bench) - rate_from);
        println!(
            "K_A {mass}, K_V {damping}: pushed {pushed:.4} N s, expected {expected:.4} N s, peak {max:.2} N, p_c {:.3} mm",
            displacement(&bench)
        );
        assert!(pushed.abs() > 0.2, "no force on the tool");
        assert!(
            (pushed - expected).abs() <= 0.01 * pushed.abs(),
            "{pushed} and {expected}"
        );
        // The damping levels are for stiff contacts: this cut follows the equation alone.
        let levels = levels(&bench);
        assert_eq!(levels[0], 0, "{levels:?}");
        while state(&bench) == State::Run {
            bench.step();
        }
        assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
        let commanded = [0, 1, 2].map(|axis| f64::from(end[axis]) / MM);
        let off = distance(&bench, commanded);
        println!("20 s after the stop the tool is {off:.4} mm from where it is commanded");
        assert!(off <= 0.05, "{off}");
    }
}

/// Limit, gains, f_d and mask change during a cut. The step per period changes by no more than the
/// acceleration of the law.
#[test]
fn the_tool_does_not_jump_when_parameters_change() {
    let mut bench = setup::ready();
    let process = block(tool(&bench), 3.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(
        &mut bench,
        0,
        force_settings(1.0, 5.0, EnableCondition::AgainstMotion),
    );
    job(&mut bench, -4.0, 80, 0.0);
    while displacement(&bench) < 0.3 {
        bench.step();
        assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
    }
    let soft = force_settings(0.25, 0.5, EnableCondition::AgainstMotion);
    let stiff = force_settings(4.0, 40.0, EnableCondition::Any);
    let eager = ForceLoop {
        setpoint: (2.0 * NEWTON) as i32,
        ..force_settings(1.0, 5.0, EnableCondition::Any)
    };
    let short = ForceLoop {
        limit: (0.1 * MM) as i32,
        ..force_settings(1.0, 5.0, EnableCondition::AgainstMotion)
    };
    let changes = [
        // The tool is beyond this limit, and returns.
        Command::ForceLoop {
            axis: 0,
            settings: short,
        },
        Command::ForceLoop {
            axis: 0,
            settings: soft,
        },
        Command::ForceLoop {
            axis: 0,
            settings: stiff,
        },
        Command::ForceLoop {
            axis: 0,
            settings: eager,
        },
        Command::ForceMask { mask: 0 },
        Command::ForceMask { mask: 5 },
    ];
    let mut worst = 0.0_f64;
    for change in changes {
        let id = bench.send(change.clone()).expect("room");
        let (mut before, mut step_before) = (displacement(&bench), f64::NAN);
        for _ in 0..1500 {
            bench.step();
            let step = displacement(&bench) - before;
            if step_before.is_finite() {
                worst = worst.max((step - step_before).abs());
            }
            (before, step_before) = (displacement(&bench), step);
            assert_eq!(state(&bench), State::Run, "{change:?}: {:?}", bench.events);
        }
        let answers = bench.take_answers();
        assert!(answers.contains(&(id, Ok(()))), "{change:?}: {answers:?}");
    }
    // 30 N on the smallest mass give 120 mm/s^2: 4.8e-6 mm per period squared.
    println!(
        "largest change of the step between two periods: {:.2} nm",
        worst * 1e6
    );
    assert!(worst < 1e-5, "{worst} mm");
}

#[test]
fn invalid_settings_are_refused_with_their_bound() {
    let mut bench = tared_machine(&sensor_alone());
    let good = force_settings(1.0, 5.0, EnableCondition::AgainstMotion);
    let newtons = |value: f64| ForceLoop {
        setpoint: (value * NEWTON) as i32,
        ..good
    };
    let cases = [
        (newtons(0.0), ForceParameter::SetpointTooSmall, 0.5),
        (newtons(-5.0), ForceParameter::SetpointTooSmall, 0.5),
        (
            newtons(90.0),
            ForceParameter::SetpointTooLarge,
            0.75 * 0.95 * 100.0,
        ),
        // K_V >= 20 N/mm * (15 ms + 5 ms + 0.3 ms).
        (
            force_settings(1.0, 0.2, EnableCondition::Any),
            ForceParameter::DampingTooSmall,
            20.0 * 0.0203,
        ),
        (
            force_settings(0.001, 5.0, EnableCondition::Any),
            ForceParameter::MassTooSmall,
            f64::NAN,
        ),
        (
            ForceLoop {
                mass: u32::MAX,
                ..good
            },
            ForceParameter::MassTooLarge,
            f64::NAN,
        ),
        (
            ForceLoop {
                damping: u32::MAX,
                ..good
            },
            ForceParameter::DampingTooLarge,
            1024.0,
        ),
    ];
    for (settings, parameter, bound) in cases {
        let refused = bench.ask(Command::ForceLoop { axis: 0, settings });
        let Err(Refusal::Force {
            axis: 0,
            refusal:
                ForceRefusal {
                    parameter: what,
                    bound: found,
                },
        }) = refused
        else {
            panic!("{settings:?}: {refused:?}")
        };
        assert_eq!(what, parameter);
        let found = f64::from(found) / NEWTON;
        assert!(
            bound.is_nan() || (found - bound).abs() < 0.02 * bound,
            "{parameter:?}: {found} and {bound}"
        );
    }
    let limit = ForceLoop { limit: 0, ..good };
    let rate = ForceLoop { rate: 0, ..good };
    for (settings, parameter) in [(limit, ForceParameter::Limit), (rate, ForceParameter::Rate)] {
        let refused = bench.ask(Command::ForceLoop { axis: 2, settings });
        assert!(
            matches!(refused, Err(Refusal::Force { axis: 2, refusal }) if refusal.parameter == parameter),
            "{refused:?}"
        );
    }
    let refused = bench.ask(Command::ForceLoop {
        axis: 3,
        settings: good,
    });
    assert!(
        matches!(refused, Err(Refusal::Force { axis: 3, refusal }) if refusal.parameter == ForceParameter::Axis),
        "{refused:?}"
    );
    assert_eq!(
        bench.ask(Command::ForceMask { mask: 8 }),
        Err(Refusal::Range)
    );
}

/// A tare needs a machine at standstill without contact. A job under force control needs a tared
/// sensor.
#[test]
fn a_tare_needs_standstill_and_a_job_needs_a_tare() {
    let mut bench = setup::ready();
    bench.rig.plant_mut().fit(&sensor_alone()).expect("sound");
    bench.ask(Command::ForceMask { mask: 1 }).expect("accepted");
    let start = bench.status().commanded;
    let begin = Command::JobStart {
        job: 1,
        pose: start.clone(),
    };
    assert_eq!(bench.ask(begin.clone()), Err(Refusal::NotTared));
    tare(&mut bench);
    bench.start_job(1, &line(&start, 0, -1.0, 20));
    bench.steps(200);
    assert_eq!(bench.ask(Command::Tare), Err(Refusal::State(State::Run)));
    bench.ask(Command::Stop).expect("stopped");
    assert!(bench.wait_for(State::Idle, 5000));
    // A motion aborts a tare without a new zero.
    bench.events.clear();
    bench.ask(Command::Tare).expect("begun");
    let rates = [4096, 0, 0, 0, 0].into_iter().collect();
    bench
        .ask(Command::Jog {
            epoch: 1,
            timeout_ms: 100,
            rates,
        })
        .expect("jogged");
    bench.steps(2000);
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::TareRefused(_))),
        "{:?}",
        bench.events
    );
    let status = bench.status();
    let force = status.force.expect("has a sensor");
    assert!(force.tared && force.mask == 1);
}

/// The compliant displacement ends at its limit, which is reported once. Soft limits hold for the
/// reference.
#[test]
fn the_compliant_displacement_stays_within_its_limit() {
    let mut bench = setup::ready();
    let at = tool(&bench);
    bench
        .rig
        .plant_mut()
        .fit(&wall(at, 0.2, 20.0))
        .expect("sound");
    bench.steps(100);
    tare(&mut bench);
    let short = ForceLoop {
        limit: (0.5 * MM) as i32,
        ..force_settings(1.0, 5.0, EnableCondition::AgainstMotion)
    };
    control(&mut bench, 0, short);
    bench.events.clear();
    job(&mut bench, -1.0, 15, 1.0);
    let mut max = 0.0_f64;
    for _ in 0..20_000 {
        bench.step();
        max = max.max(displacement(&bench));
    }
    let limited = bench
        .events
        .iter()
        .filter(|event| **event == Event::ComplianceLimited { axis: 0 })
        .count();
    println!(
        "displaced by at most {max:.4} mm, reported {limited} times: {:?}",
        bench.events
    );
    assert!((0.49..=0.5).contains(&max), "{max}");
    assert_eq!(limited, 1);
    assert!(reported_faults(&bench).is_empty());
}

/// A force pushes the tool towards a soft limit at standstill. The reference stops at the limit,
/// and returns when the force ends.
#[test]
fn soft_limits_hold_for_the_reference() {
    let (mut bench, at) = pushed_to_the_limit(0.0);
    assert_eq!(bench.ask(Command::Tare), Err(Refusal::Compliant));
    let process = bench.rig.plant_mut().process_mut().expect("there");
    process.set_wall(None);
    bench.steps(15_000);
    assert_eq!(displacement(&bench), 0.0);
    assert!((tool(&bench)[0] - at[0]).abs() < 0.03);
}

/// The program is half a micrometre beyond the limit, within its tolerance.
#[test]
fn soft_limits_hold_for_the_reference_of_a_pose_beyond_them() {
    let (bench, _) = pushed_to_the_limit(1.0005);
    assert_eq!(displacement(&bench), 0.0);
}

/// Pushes the tool towards a soft limit at 1 mm, from this place, and checks that the reference
/// stops there. Returns the place of the tool before, too.
fn pushed_to_the_limit(from: f64) -> (Bench, [f64; 3]) {
    let text = BUILT_IN.replacen("high_mm = 200.0", "high_mm = 1.0", 1);
    let machine = MachineFile::parse("machine.toml", &text).expect("sound");
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    bench.make_ready();
    // From the pose after homing.
    let start = bench.status().commanded;
    let distance = from - f64::from(start[0]) / MM;
    bench.start_job(1, &line(&start, 0, distance / 2.0, 19));
    assert!(bench.wait_for(State::Idle, 20_000));
    let at = tool(&bench);
    bench.rig.plant_mut().fit(&sensor_alone()).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(
        &mut bench,
        0,
        force_settings(1.0, 5.0, EnableCondition::Any),
    );
    bench.events.clear();
    let face = |x: f64| wall([x, at[1], at[2]], 0.0, 10.0).wall;
    let process = bench.rig.plant_mut().process_mut().expect("there");
    // A soft contact first: the sensor has to show its sign before a force may push without motion.
    process.set_wall(face(at[0] + 0.95));
    bench.steps(5000);
    let process = bench.rig.plant_mut().process_mut().expect("there");
    process.set_wall(face(at[0] + 3.0));
    let mut max = f64::NEG_INFINITY;
    for _ in 0..20_000 {
        bench.step();
        let reference = bench.rig.control().machine().expect("there").reference();
        max = max.max(f64::from(reference.pose.0[0].0) / MM);
    }
    let commanded = f64::from(bench.status().commanded[0]) / MM;
    assert!((commanded - from).abs() < 1e-4, "{commanded}");
    assert_eq!(max, commanded.max(1.0));
    // 20 N deflect the servo by some hundredths of a millimetre.
    assert!((tool(&bench)[0] - 1.0).abs() < 0.1, "{}", tool(&bench)[0]);
    assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
    assert_eq!(bench.events, [Event::ComplianceLimited { axis: 0 }]);
    (bench, at)
}
