//! Serial line and sessions: a bad line, two hosts, and the out-of-band stop. No wrong motion, and
//! no lost message.

use crate::setup;
use haptimill_hil_sim::random::Random;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_protocol::link::{HostLink, LinkState, Timing};
use haptimill_protocol::message::{
    Command, Event, HelloRefusal, Refusal, SetpointBatch, Source, State,
};
use haptimill_protocol::out_of_band::STOP;
use haptimill_protocol::setpoint::SetpointCoder;
use haptimill_tests::Bench;
use setup::{
    MM, circle, commanded, commands, distance_from_path, line, moving, ready, rest, send_available,
    state, without_repetitions,
};
use std::collections::VecDeque;

/// Runs the circle over a line with these faults. Returns the commanded poses of every period of
/// the job, and the bench.
fn run_circle(faults: &[&str]) -> (Vec<[i32; 6]>, Bench) {
    let options = RigOptions {
        baud: Some(115_200),
        faults: faults
            .iter()
            .map(|fault| fault.parse().expect("a fault"))
            .collect(),
        ..RigOptions::default()
    };
    let mut bench = Bench::with_options(&options);
    bench.make_ready();
    // Faults of the line begin at 8 s, when the machine is ready.
    while bench.rig.time_ns() < 8_000_000_000 {
        bench.step();
    }
    let start = commanded(&bench)[..5].iter().copied().collect();
    let mut job = commands(7, &start, &circle(&start, 5.0, 160));
    let mut poses = vec![commanded(&bench)];
    for _ in 0..60_000 {
        // The host keeps at most 1.6 s of setpoints queued, so the line is always in use.
        let machine = bench.rig.control().machine().expect("configured");
        let sent = 4 * (42 - job.len());
        if sent < machine.motion.program.reached() as usize + 32 || sent < 32 {
            send_next(&mut bench, &mut job);
        }
        bench.step();
        poses.push(commanded(&bench));
        let over = state(&bench) == State::Idle && poses.len() > 2500 && job.is_empty();
        if over || state(&bench) == State::Fault {
            break;
        }
    }
    // Receive the outstanding events.
    bench.steps(3000);
    (poses, bench)
}

/// Sends the next command, if there is room.
fn send_next(bench: &mut Bench, commands: &mut VecDeque<Command>) {
    if let Some(command) = commands.front()
        && bench.send(command.clone()).is_some()
    {
        commands.pop_front();
    }
}

#[test]
fn a_bad_line_causes_no_wrong_motion() {
    let (clean, bench) = run_circle(&[]);
    assert!(bench.events.contains(&Event::JobDone {
        job: 7,
        setpoints: 160
    }));
    let clean = without_repetitions(&clean);
    let mut same = 0;
    let cases: [&[&str]; 10] = [
        &["link-errors rate=1e-6 at=8s"],
        &["link-errors rate=1e-5 at=8s"],
        &["link-errors rate=1e-4 at=8s"],
        &["link-errors rate=3e-4 at=8s"],
        &["link-errors rate=1e-3 at=8s"],
        &["link-drop rate=0.005 at=8s"],
        &["link-duplicate rate=0.005 at=8s"],
        &[
            "link-errors rate=3e-4 at=8s",
            "link-drop rate=0.001 at=8s",
            "link-duplicate rate=0.001 at=8s",
        ],
        // Twice frames are cut short, and the line works again within the heartbeat.
        &[
            "link-cut at=10.2s for=300ms",
            "link-cut at=12.5s for=200ms direction=to-machine",
        ],
        &["link-cut at=11.7s"],
    ];
    for faults in cases {
        let (poses, bench) = run_circle(faults);
        let done = bench.events.contains(&Event::JobDone {
            job: 7,
            setpoints: 160,
        });
        let underrun = bench
            .events
            .iter()
            .any(|event| matches!(event, Event::Underrun { .. }));
        let stopped = bench.rig.control().safety().state();
        let path = without_repetitions(&poses);
        println!(
            "{faults:?}: done {done}, underrun {underrun}, {stopped:?}, {} periods, {:?}",
            poses.len(),
            bench.rig.to_machine().count()
        );
        if path == clean {
            same += 1;
        } else {
            // The machine may brake and resume, but it stays on the path.
            for pose in path.iter().step_by(7).chain(path.last()) {
                let off = distance_from_path(&clean, pose) / MM;
                assert!(off < 1e-3, "{off} mm off the path");
            }
        }
        let safety = bench.rig.control().safety();
        assert!(safety.homed() && safety.drives_on());
        let whole = stopped == State::Idle && done && path.last() == clean.last();
        assert!(
            whole || stopped == State::Fault || stopped == State::Hold,
            "{stopped:?}"
        );
    }
    assert!(same >= 9, "the same path in {same} of 10");
}

#[test]
fn an_out_of_band_stop_at_any_byte_stops_in_time_and_loses_no_message() {
    let mut bench = ready();
    let start = commanded(&bench)[..5].iter().copied().collect();
    let path = {
        let mut clean = ready();
        let mut job = commands(1, &start, &circle(&start, 5.0, 100));
        let mut poses = vec![];
        for _ in 0..30_000 {
            send_available(&mut clean, &mut job);
            clean.step();
            poses.push(commanded(&clean));
        }
        without_repetitions(&poses)
    };
    // Setpoints are sent slowly, so that the stream continues through all the stops.
    let mut job = commands(1, &start, &circle(&start, 5.0, 100));
    let mut poses = vec![commanded(&bench)];
    let mut stopped = 0;
    let mut next_offset = 0_usize;
    let mut since_resume = 0;
    let mut longest = 0;
    while state(&bench) != State::Idle || poses.len() < 100 {
        assert!(poses.len() < 600_000, "{:?}", bench.events.last());
        if job.len() > 8 || since_resume > 100 {
            send_available(&mut bench, &mut job);
        }
        let mut struck = false;
        let due = state(&bench) == State::Run && since_resume > 120 && next_offset < 80;
        bench.step_with_fault(|bytes| {
            // One more ping, so that the stop interrupts a stream of bytes.
            if due && !bytes.is_empty() {
                let at = next_offset % (bytes.len() + 1);
                bytes.splice(at..at, STOP);
                struck = true;
            }
        });
        poses.push(commanded(&bench));
        since_resume += 1;
        if due && !struck {
            bench.send(Command::Ping);
        }
        if struck {
            next_offset += 1;
            // The stop takes at most one period.
            for period in 0..2000 {
                bench.step();
                poses.push(commanded(&bench));
                if state(&bench) == State::Hold
                    && poses[poses.len() - 1] == poses[poses.len() - 2]
                    && period > 3
                {
                    longest = longest.max(period);
                    break;
                }
                assert!(period < 1520, "does not stop: {:?}", state(&bench));
            }
            assert_eq!(state(&bench), State::Hold);
            stopped += 1;
            // The stale-command window outlasts what may still be under way; a new hold ends it.
            bench.ask(Command::Hold).expect("holds");
            bench.ask(Command::Resume).expect("goes on");
            since_resume = 0;
        }
    }
    println!(
        "{stopped} stops, the longest {:.1} ms",
        f64::from(longest) * 0.2
    );
    assert!(stopped >= 60, "{stopped}");
    // Events of the last period are reported in one of the next.
    bench.steps(20);
    assert!(bench.events.contains(&Event::JobDone {
        job: 1,
        setpoints: 100
    }));
    let interrupted = without_repetitions(&poses);
    for pose in interrupted.iter().step_by(31).chain(interrupted.last()) {
        let off = distance_from_path(&path, pose) / MM;
        assert!(off < 1e-3, "{off} mm off the path");
    }
    assert_eq!(interrupted.last(), path.last());
}

#[test]
fn commands_sent_before_a_stop_do_not_restart_the_machine() {
    let mut bench = moving(0, 10.0);
    bench.ask(Command::Hold).expect("holds");
    bench.steps(2000);
    // `Resume` waits in the receive ring behind garbage while the stop overtakes it.
    bench.send(Command::Resume).expect("room");
    bench.step_with_fault(|bytes| {
        let mut flood = vec![7; 1000];
        flood.push(0);
        flood.append(bytes);
        flood.extend(STOP);
        *bytes = flood;
    });
    bench.steps(100);
    assert_eq!(state(&bench), State::Hold);
    assert!(
        bench
            .take_answers()
            .iter()
            .any(|(_, answer)| *answer == Err(Refusal::RecentStop))
    );
    bench.ask(Command::Hold).expect("holds");
    bench.ask(Command::Resume).expect("now");
    assert_eq!(state(&bench), State::Run);
}

#[test]
fn garbage_neither_moves_the_machine_nor_ends_the_link() {
    let mut random = Random::new(99, 0);
    for speed in [0.0, 10.0] {
        let mut bench = moving(0, speed);
        let before = commanded(&bench);
        // 340 ms: the heartbeat, less the silences before a lost keep-alive frame and before the
        // first received one.
        for _ in 0..1700 {
            bench.step_with_fault(|bytes| {
                let count = (random.fraction() * 40.0) as usize;
                let garbage: Vec<u8> = (0..count)
                    .map(|_| (random.fraction() * 256.0) as u8)
                    .collect();
                // Without a stop by chance, which is another test.
                if !garbage.windows(3).any(|three| three == STOP) {
                    bytes.extend(
                        garbage
                            .iter()
                            .map(|&byte| if byte == 0x18 { 0x19 } else { byte }),
                    );
                }
            });
            let now = commanded(&bench);
            assert_eq!(now[1..], before[1..]);
            if speed == 0.0 {
                assert_eq!(now, before);
            }
        }
        bench.steps(10_300);
        let status = bench.status();
        assert_eq!((status.state, status.fault), (State::Idle, None));
        assert!(status.bad_frames > 10);
    }
}

#[test]
fn a_second_host_is_refused_in_motion_and_accepted_at_standstill() {
    let mut bench = moving(0, 10.0);
    let mut second = HostLink::new(Timing::default());
    second.open(1234, bench.rig.time_ns() / 1000);
    // Both hosts share one line: the bytes of the second come between the frames of the first, and
    // it receives the answers to the first.
    for _ in 0..1500 {
        let now = bench.rig.time_ns() / 1000;
        let mut buffer = [0; 256];
        let count = second.transmit(now, &mut buffer);
        bench.step_with_fault(|bytes| bytes.extend(&buffer[..count]));
        let bytes = bench.rig.outputs().transmit.to_vec();
        second.receive(now, &bytes);
    }
    let now = bench.rig.time_ns() / 1000;
    assert_eq!(second.state(now), LinkState::Refused(HelloRefusal::Busy));
    assert_eq!(state(&bench), State::Run);
    assert!(bench.wait_for(State::Idle, 40_000));
    assert!(bench.events.contains(&Event::JobDone {
        job: 1,
        setpoints: 30
    }));
    // In idle the new host has the machine, without anything of the old session.
    bench
        .ask(Command::Source {
            coordinate: 1,
            source: Source::Hold,
        })
        .expect("chosen");
    bench
        .ask(Command::Jog {
            epoch: 9,
            timeout_ms: 10,
            rates: [100; 5].into_iter().collect(),
        })
        .expect("jogs");
    bench.steps(3000);
    let standing = commanded(&bench);
    bench.link.open(555, bench.rig.time_ns() / 1000);
    bench.steps(500);
    assert_eq!(
        bench.link.state(bench.rig.time_ns() / 1000),
        LinkState::Open
    );
    assert_eq!(commanded(&bench), standing);
    bench
        .ask(Command::Jog {
            epoch: 1,
            timeout_ms: 10,
            rates: [100; 5].into_iter().collect(),
        })
        .expect("counts its own epochs");
    bench.steps(3000);
    // The program is the source of axis 1 again.
    let start = bench.status().commanded;
    bench.start_job(2, &line(&start, 1, -4.0, 2));
    assert!(bench.wait_for(State::Idle, 10_000));
    assert!(commanded(&bench)[1] < start[1] - (MM as i32));
}

#[test]
fn no_host_takes_over_a_moving_machine_before_the_heartbeat_stop() {
    // The first host vanishes; another sends `Hello` all the time. It is accepted when the
    // deceleration has begun, never during a running job.
    let mut bench = moving(0, 10.0);
    let mut second = HostLink::new(Timing {
        hello_us: 200,
        ..Timing::default()
    });
    second.open(1234, bench.rig.time_ns() / 1000);
    for _ in 0..5000 {
        let now = bench.rig.time_ns() / 1000;
        let mut buffer = [0; 256];
        let count = second.transmit(now, &mut buffer);
        bench.step_with_fault(|bytes| *bytes = buffer[..count].to_vec());
        let bytes = bench.rig.outputs().transmit.to_vec();
        second.receive(now, &bytes);
        match second.state(now) {
            LinkState::Refused(_) => second.open(1234, now),
            LinkState::Open => {
                let safety = bench.rig.control().safety();
                assert!(safety.pending().is_some() || !safety.active());
            }
            _ => {}
        }
    }
    assert_eq!(second.state(bench.rig.time_ns() / 1000), LinkState::Open);
    assert_eq!(state(&bench), State::Fault);
}

#[test]
fn a_refused_setpoint_changes_nothing_and_can_be_repeated() {
    let mut bench = ready();
    let start = bench.status().commanded;
    let points = circle(&start, 5.0, 40);
    bench
        .ask(Command::JobStart {
            job: 3,
            pose: start.clone(),
        })
        .expect("started");
    let mut coder = SetpointCoder::new(200, &start);
    let batch = |first: usize, items: &[_]| {
        Command::Setpoints(SetpointBatch {
            first: first as u32,
            items: items.iter().cloned().collect(),
        })
    };
    for (index, point) in points.iter().enumerate() {
        if index % 5 == 3 {
            // Beyond the soft limit, out of order, and too fast: each changes the prediction.
            let mut far = rest(&start, 50);
            far.pose[2] = (500.0 * MM) as i32;
            let wrong = coder.clone().encode(&far).expect("codes");
            let refused = bench.ask(batch(index, core::slice::from_ref(&wrong)));
            assert_eq!(
                refused,
                Err(Refusal::SoftLimit {
                    setpoint: index as u32,
                    coordinate: 2
                })
            );
            let refused = bench.ask(batch(index + 1, core::slice::from_ref(&wrong)));
            assert_eq!(
                refused,
                Err(Refusal::OutOfOrder {
                    expected: index as u32
                })
            );
            // A valid setpoint, then the invalid one: the valid one is accepted, and the answer
            // names the expected number.
            let mut ahead = coder.clone();
            let good = ahead.encode(point).expect("codes");
            let bad = ahead.clone().encode(&far).expect("codes");
            let refused = bench.ask(batch(index, &[good, bad]));
            assert_eq!(
                refused,
                Err(Refusal::SoftLimit {
                    setpoint: index as u32 + 1,
                    coordinate: 2
                })
            );
            coder = ahead;
            // One answer each, and no success before it.
            assert!(bench.take_answers().is_empty());
        } else {
            let good = coder.encode(point).expect("codes");
            bench.ask(batch(index, &[good])).expect("accepted");
        }
    }
    bench.ask(Command::JobEnd { count: 40 }).expect("ended");
    let mut worst = 0.0_f64;
    while state(&bench) != State::Idle {
        bench.step();
        let now = commanded(&bench);
        let x = f64::from(now[0] - start[0]) / MM + 5.0;
        let y = f64::from(now[1] - start[1]) / MM;
        worst = worst.max((x.hypot(y) - 5.0).abs());
        assert_eq!(now[2], start[2]);
    }
    // The circle, except for the cubics between its setpoints.
    assert!(worst < 0.01, "{worst} mm off the circle");
    assert_eq!(commanded(&bench)[..5], points[39].pose[..]);
}
