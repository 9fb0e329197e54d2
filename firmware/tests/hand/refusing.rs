//! Its arm lies or is not ready, and what is asked of it cannot be.

use crate::bed::Bed;
use crate::mill;
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_protocol::haptic::MasterProblem;
use haptimill_protocol::message::{Command, Event, Fault, Refusal, Source, State};

#[test]
fn a_lying_encoder_frees_the_hand_and_stops_the_mill() {
    for (lie, name) in [
        ((|counts| counts + 2000) as fn(i32) -> i32, "jump"),
        (|_| 0, "stuck"),
        (|counts: i32| -counts, "reversed"),
    ] {
        for sensor in 0..3 {
            let mut bed = Bed::ready(mill());
            bed.master(0);
            bed.start_job();
            bed.inputs.haptic.engaged = true;
            bed.lead([2.0, 0.0, 0.0], 1000);
            assert!(bed.outputs.haptic.enabled);
            bed.lie = Some((1, sensor, lie));
            let mut periods = 0;
            while bed.outputs.haptic.enabled && periods < 40_000 {
                // 10 mm/s, all ways at once.
                bed.lead([-0.0012, 0.0010, 0.0012], 1);
                periods += 1;
            }
            assert!(
                periods < 20_000 && bed.arm_off(),
                "{name} of sensor {sensor} is not found"
            );
            println!(
                "{name} of sensor {sensor}: found after {:.1} mm",
                f64::from(periods) * 0.00197
            );
            bed.steps(3000);
            let fault = bed.controller.safety().fault();
            assert!(
                matches!(
                    fault,
                    Some(Fault::Master(MasterProblem::Encoder { leg: 1, .. }))
                ),
                "{name} {sensor}: {fault:?}"
            );
            assert!(
                bed.controller.safety().drives_on() && bed.at(0).1 == 0.0,
                "stopped, holding"
            );
        }
    }
}

#[test]
fn other_problems_of_the_arm_have_their_words() {
    let mut bed = Bed::ready(mill());
    bed.inputs.haptic.drives_ready = false;
    bed.step();
    assert!(bed.arm_off());
    bed.inputs.haptic.drives_ready = true;
    bed.steps(100);
    // Nothing was led: told, and the arm stays off until reset.
    assert!(bed.arm_off() && bed.state() == State::Idle);
    assert!(bed.events.contains(&Event::Master(MasterProblem::Drive)));
    assert_eq!(bed.ask(Command::Reset), Ok(()));
    bed.steps(2);
    assert!(bed.outputs.haptic.enabled);
    bed.master(0);
    bed.inputs.haptic.legs[2].illegal[1] = 11;
    bed.step();
    assert!(bed.arm_off());
    let fault = bed.controller.safety().fault();
    assert_eq!(
        fault,
        Some(Fault::Master(MasterProblem::Illegal { leg: 2, sensor: 1 }))
    );
}

/// An arm that stays broken would latch the fault again after each reset: what it led can be given to something else before that.
#[test]
fn a_mill_whose_arm_stays_broken_can_be_used_without_it() {
    let mut bed = Bed::ready(mill());
    bed.master(0);
    bed.lie = Some((1, 0, |counts| counts + 2000));
    bed.steps(5);
    assert_eq!(bed.state(), State::Fault);
    assert_eq!(bed.ask(Command::Reset), Ok(()));
    bed.steps(5);
    assert_eq!(bed.state(), State::Fault, "found again");
    let source = Source::Program;
    assert_eq!(bed.ask(Command::Source { axis: 0, source }), Ok(()));
    let before = bed.commanded();
    assert_eq!(bed.ask(Command::Reset), Ok(()));
    bed.steps(100);
    assert!(bed.arm_off() && bed.state() == State::Idle && bed.commanded() == before);
    bed.start_job();
    assert_eq!(bed.ask(Command::JobEnd { count: 0 }), Ok(()));
    bed.wait_for(State::Idle);
}

/// While the drives are off a problem is told, and gone when it is gone.
#[test]
fn a_problem_without_power_is_only_told() {
    let mut bed = Bed::new(mill());
    assert_eq!(bed.configure(), Ok(()));
    bed.lie = Some((0, 0, |counts| counts + 3000));
    bed.steps(50);
    assert!(
        bed.events
            .iter()
            .any(|event| matches!(event, Event::Master(MasterProblem::Encoder { leg: 0, .. }))),
        "{:?}",
        bed.events
    );
    bed.lie = None;
    bed.steps(5);
    assert_eq!(bed.ask(Command::Enable), Ok(()));
    bed.steps(5);
    assert!(bed.outputs.haptic.enabled && bed.state() == State::Idle);
}

#[test]
fn what_cannot_be_is_refused() {
    let mut bed = Bed::ready(reference::h4_with_steps());
    let source = Source::Master;
    assert_eq!(
        bed.ask(Command::Source { axis: 0, source }),
        Err(Refusal::NoMaster)
    );
    assert_eq!(
        bed.ask(Command::PositionScale { scale: 4096 }),
        Err(Refusal::NoMaster)
    );
    assert_eq!(
        bed.ask(Command::VirtualFixture {
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
