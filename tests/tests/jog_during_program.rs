//! Coordinates that are jogged or held while the program moves the others.

use crate::setup;
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Command, Event, Refusal, SetpointBatch, Source, State};
use haptimill_tests::Bench;
use setup::{DEGREE, MM, commanded, jog, line, ready, rest, state, step_smoothly};

#[test]
fn changing_the_source_of_an_axis_does_not_move_the_tool() {
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
    // y is jogged while the program moves x.
    pause(&mut bench);
    bench
        .ask(Command::Source {
            coordinate: 1,
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
    // The jog of x had no effect, because the program is its source. Now x holds.
    pause(&mut bench);
    bench
        .ask(Command::Source {
            coordinate: 0,
            source: Source::Hold,
        })
        .expect("chosen");
    let held = commanded(&bench)[0];
    resume(&mut bench, 1500);
    assert_eq!(commanded(&bench)[0], held);
    // The program moves both again. They keep the motion since then as their offset.
    pause(&mut bench);
    for coordinate in [0, 1] {
        bench
            .ask(Command::Source {
                coordinate,
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
    // The next job begins at the present pose, without offsets.
    let start = bench.status().commanded;
    bench.start_job(2, &line(&start, 1, -4.0, 3));
    assert!(bench.wait_for(State::Idle, 10_000));
    let moved = f64::from(start[1] - commanded(&bench)[1]) / MM;
    assert!((moved - 1.6).abs() < 0.001, "{moved}");
}

#[test]
fn soft_limits_are_checked_with_the_offset_of_a_jog() {
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
            coordinate: 1,
            source: Source::Jog,
        })
        .expect("chosen");
    bench.ask(jog(1, 1000, &[(1, 30.0)])).expect("jogs");
    bench.steps(8000);
    bench
        .ask(Command::Source {
            coordinate: 1,
            source: Source::Program,
        })
        .expect("chosen");
    let offset = commanded(&bench)[1] - start[1];
    assert!(offset > (20.0 * MM) as i32);
    // The setpoint is inside the soft limits by itself, and outside with the offset.
    let mut far = rest(&start, 40_000);
    far.pose[1] = bench.machine.config.pose[1].high.0 - offset / 2;
    far.periods = 5000;
    let mut coder = haptimill_protocol::setpoint::SetpointCoder::new(200, &start);
    let items = [coder.encode(&far).expect("codes")].into_iter().collect();
    let refused = bench.ask(Command::Setpoints(SetpointBatch { first: 0, items }));
    let beyond = Err(Refusal::SoftLimit {
        setpoint: 0,
        coordinate: 1,
    });
    assert_eq!(refused, beyond);
    // What a path needs that touches the limit is within it, and no unit more. The arms do not
    // reach so far.
    let limits = &bench.machine.config.pose[1];
    let max = limits.high.0 + limits.kind.soft_limit_tolerance() - offset;
    for (place, is_beyond) in [(max + 1, true), (max, false)] {
        far.pose[1] = place;
        let mut coder = haptimill_protocol::setpoint::SetpointCoder::new(200, &start);
        let items = [coder.encode(&far).expect("codes")].into_iter().collect();
        let answer = bench.ask(Command::Setpoints(SetpointBatch { first: 0, items }));
        assert_eq!(answer == beyond, is_beyond, "{place}: {answer:?}");
    }
}

/// Runs a program in one coordinate while another is jogged outwards.
///
/// Returns the setpoint at which the program was held, if it was. It then jogged back and finished.
fn jog_during_program(axis: usize, speed: f64, hand: usize, rate: f64) -> Option<u32> {
    let mut bench = ready();
    let start = bench.status().commanded;
    let points = line(&start, axis, speed, 70);
    let end = points.last().expect("some").pose[axis];
    bench.start_job(1, &points);
    bench.ask(Command::Hold).expect("holds");
    bench.steps(3000);
    let source = Command::Source {
        coordinate: hand as u8,
        source: Source::Jog,
    };
    bench.ask(source).expect("chosen");
    bench.ask(Command::Resume).expect("goes on");
    let mut epoch = 1;
    let case = format!("axis {axis} at {speed}, axis {hand} jogged at {rate}");
    let mut held = None;
    for period in 0..60_000 {
        if period % 400 == 0 && period < 40_000 && held.is_none() {
            // The controller refuses a jog after the end.
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
            // The hold had a reason: the rest of the path is outside the workspace at the jogged
            // coordinate.
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
            // Jog back to the start, then continue.
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
fn a_program_stops_in_time_for_a_jogged_axis_and_continues_when_it_jogs_back() {
    // Move down while y or theta is jogged, across while theta is jogged, up and down alone.
    let held = [
        jog_during_program(2, -8.0, 1, 25.0),
        jog_during_program(1, 12.0, 3, 8.0),
        jog_during_program(0, 20.0, 3, -8.0),
        jog_during_program(3, 4.0, 1, -20.0),
        jog_during_program(4, 4.0, 1, 20.0),
    ];
    println!("held at {held:?}");
    assert!(held.iter().flatten().count() >= 2, "{held:?}");
    assert_eq!(jog_during_program(0, 4.0, 2, 1.0), None);
}
