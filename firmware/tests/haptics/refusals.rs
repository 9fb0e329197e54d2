//! Faults of the haptic arm, and commands that are refused.

use super::bench::Bench;
use super::mill;
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_protocol::haptic::MasterProblem;
use haptimill_protocol::message::{Command, Event, Fault, Refusal, Source, State};

#[test]
fn wrong_arm_encoder_switches_the_arm_off_and_stops() {
    for (lie, name) in [
        ((|counts| counts + 2000) as fn(i32) -> i32, "jump"),
        (|_| 0, "stuck"),
        (|counts: i32| -counts, "reversed"),
    ] {
        for sensor in 0..3 {
            let mut bench = Bench::ready(mill());
            bench.master(0);
            bench.start_job();
            bench.inputs.haptic.enabling_switch = true;
            bench.move_master([2.0, 0.0, 0.0], 1000);
            assert!(bench.outputs.haptic.enabled);
            bench.lie = Some((1, sensor, lie));
            let mut periods = 0;
            while bench.outputs.haptic.enabled && periods < 40_000 {
                // 10 mm/s, all ways at once.
                bench.move_master([-0.0012, 0.0010, 0.0012], 1);
                periods += 1;
            }
            assert!(
                periods < 20_000 && bench.arm_off(),
                "{name} of sensor {sensor} is not found"
            );
            println!(
                "{name} of sensor {sensor}: found after {:.1} mm",
                f64::from(periods) * 0.00197
            );
            bench.steps(3000);
            let fault = bench.controller.safety().fault();
            assert!(
                matches!(
                    fault,
                    Some(Fault::Master(MasterProblem::Encoder { leg: 1, .. }))
                ),
                "{name} {sensor}: {fault:?}"
            );
            assert!(
                bench.controller.safety().drives_on() && bench.at(0).1 == 0.0,
                "stopped, holding"
            );
        }
    }
}

#[test]
fn other_arm_problems_are_named() {
    let mut bench = Bench::ready(mill());
    bench.inputs.haptic.drives_ready = false;
    bench.step();
    assert!(bench.arm_off());
    bench.inputs.haptic.drives_ready = true;
    bench.steps(100);
    // Nothing followed the arm: the fault is reported, and the arm stays off until reset.
    assert!(bench.arm_off() && bench.state() == State::Idle);
    assert!(bench.events.contains(&Event::Master(MasterProblem::Drive)));
    assert_eq!(bench.ask(Command::Reset), Ok(()));
    bench.steps(2);
    assert!(bench.outputs.haptic.enabled);
    bench.master(0);
    bench.inputs.haptic.legs[2].illegal[1] = 11;
    bench.step();
    assert!(bench.arm_off());
    let fault = bench.controller.safety().fault();
    assert_eq!(
        fault,
        Some(Fault::Master(MasterProblem::Illegal { leg: 2, sensor: 1 }))
    );
}

/// A broken arm latches its fault again after each reset, so its coordinates can get another source
/// before that.
#[test]
fn broken_arm_can_be_deselected() {
    let mut bench = Bench::ready(mill());
    bench.master(0);
    bench.lie = Some((1, 0, |counts| counts + 2000));
    bench.steps(5);
    assert_eq!(bench.state(), State::Fault);
    assert_eq!(bench.ask(Command::Reset), Ok(()));
    bench.steps(5);
    assert_eq!(bench.state(), State::Fault, "found again");
    let source = Source::Program;
    assert_eq!(
        bench.ask(Command::Source {
            coordinate: 0,
            source
        }),
        Ok(())
    );
    let before = bench.commanded();
    assert_eq!(bench.ask(Command::Reset), Ok(()));
    bench.steps(100);
    assert!(bench.arm_off() && bench.state() == State::Idle && bench.commanded() == before);
    bench.start_job();
    assert_eq!(bench.ask(Command::JobEnd { count: 0 }), Ok(()));
    bench.wait_for(State::Idle);
}

/// With the drives off a problem is an event, and it ends by itself.
#[test]
fn arm_problem_with_drives_off_is_an_event() {
    let mut bench = Bench::new(mill());
    assert_eq!(bench.configure(), Ok(()));
    bench.lie = Some((0, 0, |counts| counts + 3000));
    bench.steps(50);
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Master(MasterProblem::Encoder { leg: 0, .. }))),
        "{:?}",
        bench.events
    );
    bench.lie = None;
    bench.steps(5);
    assert_eq!(bench.ask(Command::Enable), Ok(()));
    bench.steps(5);
    assert!(bench.outputs.haptic.enabled && bench.state() == State::Idle);
}

#[test]
fn invalid_haptic_commands_are_refused() {
    let mut bench = Bench::ready(reference::h4_with_steps());
    let source = Source::Master;
    assert_eq!(
        bench.ask(Command::Source {
            coordinate: 0,
            source
        }),
        Err(Refusal::NoMaster)
    );
    assert_eq!(
        bench.ask(Command::PositionScale { scale: 4096 }),
        Err(Refusal::NoMaster)
    );
    assert_eq!(
        bench.ask(Command::VirtualFixture {
            axis: 0,
            upper: true,
            fixture: None
        }),
        Err(Refusal::NoMaster)
    );
    for change in [
        |config: &mut Config| config.haptic.as_mut().expect("one").geometry.link.0 = 0,
        |config: &mut Config| config.haptic.as_mut().expect("one").condition = 1,
        |config: &mut Config| config.haptic.as_mut().expect("one").step.0 = 4000,
        |config: &mut Config| config.haptic = None,
        |config: &mut Config| config.follow = Some(reference::follow()),
    ] {
        let mut config = reference::master();
        change(&mut config);
        assert!(config.check().is_err());
    }
    assert_eq!(reference::master().check(), Ok(()));
    assert_eq!(mill().check(), Ok(()));
}
