//! Faults of the force sensor, and a spindle that stalls, under force control.

use crate::setup;
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::{End, SensorCondition};
use haptimill_protocol::force::{EnableCondition, ForceProblem};
use haptimill_protocol::message::{Command, Event, Fault, State};
use haptimill_tests::Bench;
use setup::force::{
    block, control, displacement, displacement_rate, force_settings, job, sensor_alone, tare,
    tared_machine, wall,
};
use setup::{MM, distance, line, reported_faults, state, tool};

/// A fault of the sensor, and the problem that must be reported.
fn broken(bench: &mut Bench, condition: SensorCondition) {
    let process = bench.rig.plant_mut().process_mut().expect("there");
    process
        .sensor_mut()
        .expect("there")
        .set_condition(0, condition);
}

/// Waits for the end, which must be a controlled stop: drives on, position kept, no jump, tool in
/// place.
fn controlled_stop(bench: &mut Bench) -> ForceProblem {
    let mut fastest = 0.0_f64;
    // A saturated channel may be a real force: the machine first retracts slowly along its path.
    for _ in 0..50_000 {
        let before = tool(bench);
        bench.step();
        fastest = fastest.max(distance(bench, before));
        if state(bench) == State::Fault {
            break;
        }
    }
    assert_eq!(state(bench), State::Fault, "{:?}", bench.events);
    assert!(fastest < 0.02, "{fastest} mm in a period");
    let latched = tool(bench);
    bench.steps(5000);
    assert!(distance(bench, latched) < 0.05, "the tool went on");
    assert!(bench.rig.control().safety().homed());
    assert!(bench.rig.control().safety().drives_on());
    let faults = reported_faults(bench);
    let [Event::Fault(Fault::Force(problem))] = faults[..] else {
        panic!("{faults:?}")
    };
    *problem
}

#[test]
fn every_sensor_fault_causes_a_controlled_stop_and_is_reported() {
    let healthy = SensorCondition::default();
    let setup = |gap: f64, enable_condition: EnableCondition| {
        let mut bench = setup::ready();
        let process = wall(tool(&bench), gap, 100.0);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        tare(&mut bench);
        control(&mut bench, 0, force_settings(1.0, 5.0, enable_condition));
        job(&mut bench, -1.0, 40, 0.0);
        // The spindle reaches its speed, and the tool the contact.
        bench.steps(6000);
        assert_eq!(state(&bench), State::Run);
        bench
    };
    let mut bench = setup(0.2, EnableCondition::AgainstMotion);
    broken(
        &mut bench,
        SensorCondition {
            saturated: Some(End::High),
            ..healthy
        },
    );
    let problem = controlled_stop(&mut bench);
    assert!(
        matches!(problem, ForceProblem::Overload { .. }),
        "{problem:?}"
    );

    let mut bench = setup(0.2, EnableCondition::AgainstMotion);
    broken(
        &mut bench,
        SensorCondition {
            stuck: true,
            ..healthy
        },
    );
    assert_eq!(
        controlled_stop(&mut bench),
        ForceProblem::Stuck { component: 0 }
    );

    // A lost signal gives the code of zero force again and again.
    let mut bench = setup(0.2, EnableCondition::AgainstMotion);
    broken(
        &mut bench,
        SensorCondition {
            dropped: true,
            ..healthy
        },
    );
    assert_eq!(
        controlled_stop(&mut bench),
        ForceProblem::Stuck { component: 0 }
    );

    // The converter gives no more codes.
    let mut bench = setup(0.2, EnableCondition::AgainstMotion);
    bench
        .rig
        .plant_mut()
        .fit(&ProcessConfig::default())
        .expect("sound");
    assert_eq!(controlled_stop(&mut bench), ForceProblem::Silent);

    for enable_condition in [EnableCondition::AgainstMotion, EnableCondition::Any] {
        let mut bench = setup(3.0, enable_condition);
        broken(
            &mut bench,
            SensorCondition {
                gain: -1.0,
                ..healthy
            },
        );
        assert_eq!(
            controlled_stop(&mut bench),
            ForceProblem::WrongSign { component: 0 },
            "{enable_condition:?}"
        );
    }

    // The tool is in the air, the spindle is off.
    let mut bench = tared_machine(&sensor_alone());
    control(
        &mut bench,
        0,
        force_settings(1.0, 5.0, EnableCondition::AgainstMotion),
    );
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 0, -1.0, 60));
    bench.steps(3000);
    broken(
        &mut bench,
        SensorCondition {
            drift_n_s: 2.0,
            ..healthy
        },
    );
    let problem = controlled_stop(&mut bench);
    assert!(
        matches!(problem, ForceProblem::Drift { component: 0, force } if force.abs() >= 3 << 15),
        "{problem:?}"
    );
}

/// After a force fault the tool keeps its compliant displacement. A reset moves nothing, and a jog
/// moves out of it.
#[test]
fn after_a_force_fault_the_tool_stays_and_can_be_jogged() {
    let mut bench = setup::ready();
    let process = wall(tool(&bench), 0.2, 100.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(
        &mut bench,
        0,
        force_settings(1.0, 5.0, EnableCondition::AgainstMotion),
    );
    job(&mut bench, -1.0, 60, 0.0);
    while displacement(&bench) < 0.5 {
        bench.step();
    }
    bench
        .rig
        .plant_mut()
        .process_mut()
        .expect("there")
        .sensor_mut()
        .expect("there")
        .set_condition(
            0,
            SensorCondition {
                stuck: true,
                ..SensorCondition::default()
            },
        );
    controlled_stop(&mut bench);
    assert!(displacement(&bench) > 0.4);
    let before = tool(&bench);
    broken(&mut bench, SensorCondition::default());
    bench.steps(1000);
    bench.ask(Command::Reset).expect("reset");
    bench.steps(2500);
    assert_eq!(state(&bench), State::Idle);
    assert!(
        distance(&bench, before) < 0.02,
        "the tool moved by {} mm",
        distance(&bench, before)
    );
    assert_eq!(displacement(&bench), 0.0);
    let rates = [4096, 0, 0, 0, 0].into_iter().collect();
    bench
        .ask(Command::Jog {
            epoch: 1,
            timeout_ms: 1000,
            rates,
        })
        .expect("jogged");
    bench.steps(7500);
    assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
    assert!(tool(&bench)[0] - before[0] > 0.5);
}

/// The contact is lost and the tool returns. A reset after a lost host, or homing, must not stop
/// the reference within a period.
#[test]
fn a_returning_tool_is_not_stopped_within_a_period() {
    for reset in [true, false] {
        let mut bench = setup::ready();
        let process = wall(tool(&bench), 0.5, 20.0);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        tare(&mut bench);
        let mut settings = force_settings(1.0, 2.0, EnableCondition::AgainstMotion);
        settings.setpoint *= if reset { 3 } else { 1 };
        control(&mut bench, 0, settings);
        job(&mut bench, -4.0, 30, if reset { 3.0 } else { 0.05 });
        while displacement(&bench) < 5.0 {
            bench.step();
            assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
        }
        let process = bench.rig.plant_mut().process_mut().expect("there");
        process.set_wall(None);
        let command = if reset {
            for _ in 0..6000 {
                bench.step_with_fault(Vec::clear);
                if state(&bench) == State::Fault {
                    break;
                }
            }
            bench.link.open(78, bench.rig.time_ns() / 1000);
            bench.steps(50);
            Command::Reset
        } else {
            while state(&bench) == State::Run {
                bench.step();
            }
            Command::Home
        };
        assert!(displacement(&bench) > 0.5 && displacement_rate(&bench) < -1.0);
        bench.send(command);
        let rate = |bench: &Bench| {
            let machine = bench.rig.control().machine().expect("configured");
            f64::from(machine.reference().rates[0].0) / MM
        };
        let mut before = rate(&bench);
        for _ in 0..5000 {
            bench.step();
            let now = rate(&bench);
            assert!((now - before).abs() < 0.25, "{before} -> {now} mm/s");
            before = now;
        }
        let reached = if reset { State::Idle } else { State::Homing };
        assert_eq!(state(&bench), reached, "{:?}", bench.events);
    }
}

/// The spindle stalls in the cut without force control: the force limit trips, and the tool
/// retracts along its path.
#[test]
fn a_stalled_spindle_trips_the_force_limit() {
    let mut bench = setup::ready();
    let process = block(tool(&bench), 1.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    job(&mut bench, -4.0, 80, 0.0);
    bench.steps(20_000);
    assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
    bench
        .rig
        .plant_mut()
        .process_mut()
        .expect("there")
        .spindle_mut()
        .set_stalled(true);
    let mut max = 0.0_f64;
    let mut farthest = f64::INFINITY;
    for _ in 0..40_000 {
        bench.step();
        max = max.max(bench.rig.truth().force[0].abs());
        farthest = farthest.min(tool(&bench)[0]);
        if state(&bench) == State::Fault {
            break;
        }
    }
    bench.steps(500);
    let faults = reported_faults(&bench);
    assert!(
        matches!(
            faults[..],
            [Event::Fault(Fault::Force(ForceProblem::Limit { .. }))]
        ),
        "{faults:?}"
    );
    let left = bench.rig.truth().force[0].abs();
    let back = tool(&bench)[0] - farthest;
    println!("at most {max:.1} N; {back:.3} mm back, {left:.1} N left");
    assert!(back > 0.5 && left < 40.0);
    assert!(bench.rig.control().safety().homed());
}
