//! Feed hold and door.

use super::*;

#[test]
fn a_feed_hold_holds_the_job_until_resume() {
    let mut bench = above_block(|_| (), 60.0);
    let input = FEED_HOLD as u8;
    let setpoints = down(&mut bench, 5.0, 10);
    bench.start_job(4, &setpoints);
    bench.steps(1500);
    force(&mut bench, FEED_HOLD, Some(true));
    bench.steps(11 + 1500 + 50);
    assert_eq!(state(&bench), State::Hold);
    assert!(bench.events.contains(&Event::InputHold { input }));
    let still = bench.status().commanded;
    let refused = Err(Refusal::Input(InputProblem::FeedHold { input }));
    assert_eq!(bench.ask(Command::Resume), refused);
    assert_eq!(bench.status().commanded, still);
    force(&mut bench, FEED_HOLD, None);
    bench.steps(20);
    assert_eq!(
        state(&bench),
        State::Hold,
        "the release alone moves nothing"
    );
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    assert!(bench.wait_for(State::Idle, 20_000));
    let done = |event: &Event| matches!(event, Event::JobDone { job: 4, .. });
    assert!(bench.events.iter().any(done));
}

#[test]
fn an_open_door_stops_motion_and_spindle() {
    let mut bench = above_block(|_| (), 60.0);
    let input = DOOR as u8;
    let mut setpoints = down(&mut bench, 5.0, 10);
    setpoints[0].action = Action::Spindle(-3000);
    bench.start_job(5, &setpoints);
    bench.steps(1500);
    assert_eq!(bench.rig.outputs().spindle_rpm, -3000);
    assert!(is_on(&bench, REVERSE));
    force(&mut bench, DOOR, Some(false));
    bench.steps(12);
    assert_eq!(bench.rig.outputs().spindle_rpm, 0);
    assert!(!is_on(&bench, REVERSE));
    bench.steps(1600);
    assert_eq!(state(&bench), State::Hold);
    let refused = Err(Refusal::Input(InputProblem::DoorOpen { input }));
    assert_eq!(bench.ask(Command::Resume), refused);
    // The spindle turns again with the resume: the clamp stays shut.
    let release = Command::SetOutput {
        output: CLAMP,
        on: false,
    };
    let turns = Refusal::Output {
        output: CLAMP,
        problem: OutputProblem::SpindleTurns,
    };
    assert_eq!(bench.ask(release), Err(turns));
    force(&mut bench, DOOR, None);
    bench.steps(50);
    assert_eq!(bench.rig.outputs().spindle_rpm, 0, "closing starts nothing");
    let still = bench.status().commanded;
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    // The spindle has 1500 ms before the motion; a second command does not shorten it.
    bench.steps(3000);
    assert_eq!(bench.rig.outputs().spindle_rpm, -3000);
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    assert_eq!(bench.status().commanded, still);
    assert_eq!(state(&bench), State::Hold);
    assert!(bench.wait_for(State::Idle, 20_000));
    let done = |event: &Event| matches!(event, Event::JobDone { job: 5, .. });
    assert!(bench.events.iter().any(done));

    // Nothing starts while it is open, and a jog and homing stop.
    let rates: AxisValues = [0, 0, 4096].into_iter().collect();
    let jog = |epoch| Command::Jog {
        epoch,
        timeout_ms: 1000,
        rates: rates.clone(),
    };
    assert_eq!(bench.ask(jog(1)), Ok(()));
    bench.steps(100);
    force(&mut bench, DOOR, Some(false));
    bench.steps(2500);
    assert_eq!(state(&bench), State::Idle);
    let setpoints = down(&mut bench, 5.0, 1);
    assert_eq!(bench.try_job(6, &setpoints), refused);
    assert_eq!(bench.ask(jog(2)), refused);
    assert_eq!(bench.ask(Command::Home), refused);
    force(&mut bench, DOOR, None);
    bench.steps(20);
    assert_eq!(bench.ask(Command::Home), Ok(()));
    bench.steps(200);
    force(&mut bench, DOOR, Some(false));
    assert!(bench.wait_for(State::Idle, 5000));
    assert!(!bench.rig.control().safety().homed());
}

/// The door opens while the restarted spindle runs up: the job stays on hold, the spindle stops.
#[test]
fn the_door_may_open_again_during_the_wait_for_the_spindle() {
    let mut bench = above_block(|_| (), 60.0);
    let mut setpoints = down(&mut bench, 5.0, 10);
    setpoints[0].action = Action::Spindle(3000);
    bench.start_job(5, &setpoints);
    bench.steps(1500);
    force(&mut bench, DOOR, Some(false));
    bench.steps(2000);
    force(&mut bench, DOOR, None);
    bench.steps(50);
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    bench.steps(1000);
    force(&mut bench, DOOR, Some(false));
    bench.steps(50);
    force(&mut bench, DOOR, None);
    bench.steps(10_000);
    assert_eq!(state(&bench), State::Hold);
    assert_eq!(bench.rig.outputs().spindle_rpm, 0);
    assert_eq!(bench.ask(Command::Stop), Ok(()));
    assert!(bench.wait_for(State::Idle, 5000));
}
