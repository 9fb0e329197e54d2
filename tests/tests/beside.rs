//! A program with another hand beside it: coordinates that are jogged or held while the program leads the others.

mod scene;

use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Command, Event, Refusal, Source, State};
use haptimill_tests::Bench;
use scene::{DEGREE, MM, commanded, jog, line, ready, rest, state, step_smoothly};

#[test]
fn sources_change_without_a_jump() {
    let mut bench = ready();
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 0, 4.0, 60));
    let pause = |bench: &mut Bench| {
        bench.ask(Command::Hold).expect("holds");
        for _ in 0..2000 {
            step_smoothly(bench, 0.0011);
        }
    };
    let resume = |bench: &mut Bench, periods: usize| {
        bench.ask(Command::Resume).expect("goes on");
        for _ in 0..periods {
            step_smoothly(bench, 0.0011);
        }
    };
    for _ in 0..2000 {
        step_smoothly(&mut bench, 0.0011);
    }
    // y by hand beside the program.
    pause(&mut bench);
    bench
        .ask(Command::Source {
            axis: 1,
            source: Source::Jog,
        })
        .expect("chosen");
    step_smoothly(&mut bench, 1e-6);
    resume(&mut bench, 500);
    bench
        .ask(jog(1, 200, &[(1, 3.0), (0, 40.0)]))
        .expect("jogs");
    for _ in 0..2500 {
        step_smoothly(&mut bench, 0.0011);
    }
    let jogged = commanded(&bench)[1];
    assert!(jogged > start[1] + (0.3 * MM) as i32);
    // x is the program's: the jog of it was not heard. Now x holds while the program goes on.
    pause(&mut bench);
    bench
        .ask(Command::Source {
            axis: 0,
            source: Source::Hold,
        })
        .expect("chosen");
    let held = commanded(&bench)[0];
    resume(&mut bench, 1500);
    assert_eq!(commanded(&bench)[0], held);
    // Both are the program's again: they go on from where they stand, with what happened meanwhile as their offset.
    pause(&mut bench);
    for axis in [0, 1] {
        bench
            .ask(Command::Source {
                axis,
                source: Source::Program,
            })
            .expect("chosen");
        step_smoothly(&mut bench, 1e-6);
    }
    assert_eq!((commanded(&bench)[0], commanded(&bench)[1]), (held, jogged));
    resume(&mut bench, 1000);
    assert!(commanded(&bench)[0] > held);
    assert_eq!(commanded(&bench)[1], jogged);
    assert!(bench.wait_for(State::Idle, 60_000));
    let end = commanded(&bench);
    assert!(end[0] < start[0] + (24.0 * MM) as i32 && end[0] > held);
    // The next job begins where the machine stands, without offsets.
    let start = bench.status().commanded;
    bench.start_job(2, &line(&start, 1, -4.0, 3));
    assert!(bench.wait_for(State::Idle, 10_000));
    let gone = f64::from(start[1] - commanded(&bench)[1]) / MM;
    assert!((gone - 1.6).abs() < 0.001, "{gone}");
}

#[test]
fn setpoints_are_checked_where_they_will_be_with_their_offset() {
    let mut bench = ready();
    let start = bench.status().commanded;
    bench
        .ask(Command::JobStart {
            job: 1,
            pose: start.clone(),
        })
        .expect("started");
    bench.ask(Command::Hold).expect("holds");
    bench
        .ask(Command::Source {
            axis: 1,
            source: Source::Jog,
        })
        .expect("chosen");
    bench.ask(jog(1, 1000, &[(1, 30.0)])).expect("jogs");
    bench.steps(8000);
    bench
        .ask(Command::Source {
            axis: 1,
            source: Source::Program,
        })
        .expect("chosen");
    let offset = commanded(&bench)[1] - start[1];
    assert!(offset > (20.0 * MM) as i32);
    // Within the soft limits by itself, beyond them with the offset.
    let mut far = rest(&start, 40_000);
    far.pose[1] = bench.machine.config.pose[1].high.0 - offset / 2;
    far.periods = 5000;
    let mut coder = haptimill_protocol::setpoint::SetpointCoder::new(200, &start);
    let items = [coder.encode(&far).expect("codes")].into_iter().collect();
    let refused = bench.ask(Command::Setpoints(
        haptimill_protocol::message::SetpointBatch { first: 0, items },
    ));
    assert_eq!(
        refused,
        Err(Refusal::SoftLimit {
            setpoint: 0,
            axis: 1
        })
    );
}

/// A program that leads one coordinate while another is jogged outwards. Says at which setpoint it was held, if it was; it then made room by jogging back
/// and went on to its end.
fn beside(axis: usize, speed: f64, hand: usize, rate: f64) -> Option<u32> {
    let mut bench = ready();
    let start = bench.status().commanded;
    let points = line(&start, axis, speed, 70);
    let end = points.last().expect("some").pose[axis];
    bench.start_job(1, &points);
    bench.ask(Command::Hold).expect("holds");
    bench.steps(3000);
    let source = Command::Source {
        axis: hand as u8,
        source: Source::Jog,
    };
    bench.ask(source).expect("chosen");
    bench.ask(Command::Resume).expect("goes on");
    let mut epoch = 1;
    let case = format!("axis {axis} at {speed}, axis {hand} jogged at {rate}");
    let mut held = None;
    for period in 0..60_000 {
        if period % 400 == 0 && period < 40_000 && held.is_none() {
            // What is refused here is a jog after the end.
            let _ = bench.ask(jog(epoch, 200, &[(hand, rate)]));
            epoch += 1;
        }
        step_smoothly(&mut bench, 0.02);
        assert_ne!(
            state(&bench),
            State::Fault,
            "{case}: {:?}",
            bench.rig.control().safety().fault()
        );
        if state(&bench) == State::Idle {
            return held;
        }
        let blocked = bench.events.iter().find_map(|event| match event {
            Event::Blocked { setpoint } => Some(*setpoint),
            _ => None,
        });
        if let Some(setpoint) = blocked {
            held = Some(setpoint);
            bench.events.clear();
            for _ in 0..3000 {
                step_smoothly(&mut bench, 0.02);
            }
            assert_eq!(state(&bench), State::Hold, "{case}");
            // It was held for a reason: the end of the way cannot be taken with what was jogged.
            let mut pose = Pose::default();
            for (slot, value) in pose.0.iter_mut().zip(commanded(&bench)) {
                *slot = Coordinate(value);
            }
            pose.0[axis] = Coordinate(end);
            let machine = &bench
                .rig
                .control()
                .machine()
                .expect("configured")
                .kinematics;
            assert!(machine.inverse(&pose).is_err(), "{case}: held for nothing");
            // Back to where it began, then on.
            let unit = if hand < 3 { MM } else { DEGREE };
            let back = f64::from(commanded(&bench)[hand] - start[hand]) / unit;
            let seconds = (back / rate).abs().min(1.0);
            bench
                .ask(jog(
                    epoch,
                    (seconds * 1000.0) as u16,
                    &[(hand, -back / seconds * 0.9)],
                ))
                .expect("jogs back");
            epoch += 1;
            for _ in 0..7000 {
                step_smoothly(&mut bench, 0.02);
            }
            bench.ask(Command::Resume).expect("goes on");
        }
    }
    panic!("{case}: never ended, {:?}", state(&bench));
}

#[test]
fn a_program_beside_a_jog_stops_in_time_and_goes_on_when_there_is_room() {
    // Down while y or theta is turned out; across while theta is; up and down alone stay free.
    let held = [
        beside(2, -8.0, 1, 25.0),
        beside(1, 12.0, 3, 8.0),
        beside(0, 20.0, 3, -8.0),
        beside(3, 4.0, 1, -20.0),
        beside(4, 4.0, 1, 20.0),
    ];
    println!("held at {held:?}");
    assert!(held.iter().flatten().count() >= 2, "{held:?}");
    assert_eq!(beside(0, 4.0, 2, 1.0), None);
}
