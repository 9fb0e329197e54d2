//! Jogs: timeouts, epochs and limits.

use crate::setup;
use haptimill_protocol::message::{Command, Event, Refusal, State};
use setup::{commanded, jog, ready, state, step_smoothly};

#[test]
fn a_jog_ends_at_its_timeout() {
    let mut bench = ready();
    let before = commanded(&bench);
    bench.ask(jog(1, 100, &[(0, 10.0)])).expect("jogs");
    let mut moving_for = 0;
    for _ in 0..3000 {
        step_smoothly(&mut bench, 0.0021);
        moving_for += usize::from(state(&bench) == State::Jog);
    }
    assert_eq!(state(&bench), State::Idle);
    // 100 ms timeout, and 90 ms from 10 mm/s at 200 mm/s^2 and 5000 mm/s^3.
    assert!((500..=1000).contains(&moving_for), "{moving_for} periods");
    assert!(commanded(&bench)[0] > before[0]);
    assert_eq!(commanded(&bench)[1..], before[1..]);
}

#[test]
fn a_cancelled_jog_is_not_restarted_by_late_messages() {
    // Every byte of the cancel is broken once, so that its resend comes late. Jogs of its epoch
    // follow it.
    for offset in 0..20 {
        let mut bench = ready();
        bench.ask(jog(5, 1000, &[(1, 20.0)])).expect("jogs");
        bench.steps(300);
        bench.send(Command::JogCancel { epoch: 5 }).expect("room");
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
fn a_stop_ends_the_jog_epoch() {
    for stop in [Command::Stop, Command::Hold] {
        let mut bench = ready();
        bench.ask(jog(1, 200, &[(0, 10.0)])).expect("jogs");
        bench.steps(300);
        bench.send(stop).expect("room");
        // The host has not received the event and sends the next jog.
        for _ in 0..60 {
            bench.send(jog(1, 200, &[(0, 10.0)]));
            bench.steps(50);
        }
        assert_eq!(state(&bench), State::Idle);
        let standing = commanded(&bench);
        bench.steps(500);
        assert_eq!(commanded(&bench), standing);
    }
}

#[test]
fn a_jog_stops_before_soft_limits_strokes_and_reach_limits() {
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
