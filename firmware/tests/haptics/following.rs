//! Following a master: enabling switch, scale, orientation, holds and stops, change of sources, the
//! workspace boundary, and a remote master.

use super::bench::Bench;
use super::{JumpCheck, mill};
use crate::arm::{self, rotation, times};
use haptimill_firmware::config::Config;
use haptimill_protocol::haptic::MasterPose;
use haptimill_protocol::message::{Command, Event, Refusal, Request, Source, State};

#[test]
fn tool_follows_the_master_and_the_enabling_switch() {
    let mut bench = Bench::ready(mill());
    bench.master(0);
    bench.master(1);
    bench.start_job();
    let start = [bench.at(0).0, bench.at(1).0, bench.at(2).0];
    // The hand moves and does not hold the button: nothing.
    bench.move_master([5.0, 0.0, 0.0], 2000);
    assert_eq!(bench.at(0).0, start[0]);
    // It holds it, where it is now, and moves: the tool follows, z does not.
    bench.inputs.haptic.enabling_switch = true;
    let mut jump_check = JumpCheck::at(&bench);
    for way in [[-12.0, 4.0, 3.0], [0.0; 3], [20.0, -9.0, 0.0], [0.0; 3]] {
        jump_check.move_master(&mut bench, way, 5000);
    }
    for _ in 0..10_000 {
        bench.step();
        jump_check.check(&bench);
    }
    assert!(
        (bench.at(0).0 - start[0] - 8.0).abs() < 0.02,
        "{:?}",
        bench.at(0)
    );
    assert!(
        (bench.at(1).0 - start[1] + 5.0).abs() < 0.02,
        "{:?}",
        bench.at(1)
    );
    assert_eq!(bench.at(2).0, start[2]);
    // The enabling switch during a motion: released, moved back, pressed again there.
    for _ in 0..5 {
        bench.move_master([1.0, 0.0, 0.0], 500);
    }
    let mut jump_check = JumpCheck::at(&bench);
    bench.inputs.haptic.enabling_switch = false;
    jump_check.move_master(&mut bench, [-8.0, 0.0, 0.0], 4000);
    let rest = bench.at(0);
    assert_eq!(rest.1, 0.0);
    bench.inputs.haptic.enabling_switch = true;
    for _ in 0..1000 {
        bench.step();
        jump_check.check(&bench);
    }
    assert!((bench.at(0).0 - rest.0).abs() < 0.02);
    // The scale changes while it moves the tool: no jump, and half the way from there on.
    assert_eq!(
        bench.ask(Command::PositionScale { scale: 300 }),
        Err(Refusal::Range)
    );
    assert_eq!(
        bench.ask(Command::PositionScale { scale: 8300 }),
        Err(Refusal::Range)
    );
    let before = bench.at(0).0;
    assert_eq!(bench.ask(Command::PositionScale { scale: 2048 }), Ok(()));
    jump_check.move_master(&mut bench, [-4.0, 0.0, 0.0], 4000);
    bench.steps(5000);
    assert!(
        (bench.at(0).0 - before + 2.0).abs() < 0.03,
        "{}",
        bench.at(0).0 - before
    );
    // The job is over: the hand moves the tool no more.
    assert_eq!(bench.ask(Command::JobEnd { count: 0 }), Ok(()));
    bench.wait_for(State::Idle);
    // One event is reported per period.
    bench.steps(20);
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::JobDone { job: 3, .. }))
    );
}

#[test]
fn orientation_follows_the_handle() {
    let mut bench = Bench::ready(mill());
    for axis in 3..5 {
        bench.master(axis);
    }
    let start = [3, 4].map(|k| f64::from(bench.commanded()[k]) / 4_294_967_296.0 * 360.0);
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    bench.steps(10);
    // By 8 degrees about y, then 5 about x: theta about Y by as much, alpha about X against it
    // (docs/control.md (3.20)-(3.22)).
    let (t, a) = (8.0_f64.to_radians(), 5.0_f64.to_radians());
    for k in 1..=4000 {
        let part = f64::from(k) / 4000.0;
        bench.turn = times(
            rotation([1.0, 0.0, 0.0], -a * part),
            rotation([0.0, 1.0, 0.0], t * part),
        );
        bench.step();
    }
    bench.steps(10_000);
    let (st, sa) = (start[0].to_radians(), start[1].to_radians());
    let tool = [
        libm::sin(st),
        libm::cos(st) * libm::sin(sa),
        libm::cos(st) * libm::cos(sa),
    ];
    let axis = arm::apply(bench.turn, tool);
    let degrees = |k: usize| f64::from(bench.commanded()[k]) / 4_294_967_296.0 * 360.0;
    let theta = libm::atan2(axis[0], libm::hypot(axis[1], axis[2])).to_degrees();
    let alpha = libm::atan2(axis[1], axis[2]).to_degrees();
    assert!(
        (degrees(3) - theta).abs() < 0.03 && (degrees(4) - alpha).abs() < 0.03,
        "{} {theta} {} {alpha}",
        degrees(3),
        degrees(4)
    );
    assert!(theta.abs() > 7.0 && alpha.abs() > 4.0);
}

#[test]
fn every_stop_ends_following_until_a_command() {
    let mut bench = Bench::ready(mill());
    bench.master(0);
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    bench.move_master([-5.0, 0.0, 0.0], 2500);
    bench
        .link
        .send(&Request {
            id: 0,
            command: Command::Hold,
        })
        .expect("room");
    bench.move_master([-3.0, 0.0, 0.0], 1500);
    assert_eq!((bench.state(), bench.at(0).1), (State::Hold, 0.0));
    let held = bench.at(0).0;
    bench.move_master([9.0, 0.0, 0.0], 1500);
    assert_eq!(bench.at(0).0, held);
    // Resumed where both are now.
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    bench.steps(3000);
    assert!((bench.at(0).0 - held).abs() < 0.02);
    bench.move_master([-4.0, 0.0, 0.0], 2000);
    bench.steps(4000);
    assert!((bench.at(0).0 - held + 4.0).abs() < 0.03);
    bench.inputs.out_of_band_stop = true;
    bench.move_master([-4.0, 0.0, 0.0], 2000);
    assert_eq!((bench.state(), bench.at(0).1), (State::Hold, 0.0));
    bench.steps(3000);
    assert_eq!(bench.ask(Command::Stop), Ok(()));
    bench.wait_for(State::Idle);
    // The emergency stop takes the arm off at once.
    assert!(bench.outputs.haptic.enabled);
    bench.inputs.emergency_stop = true;
    bench.step();
    assert!(bench.arm_off());
}

#[test]
fn sources_change_in_motion() {
    let mut bench = Bench::ready(mill());
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    bench.steps(10);
    let mut jump_check = JumpCheck::at(&bench);
    let sources = [
        Source::Master,
        Source::Hold,
        Source::Master,
        Source::Program,
        Source::Master,
        Source::Hold,
        Source::Program,
    ];
    let mut phase = 0.0_f64;
    for (k, source) in sources.into_iter().cycle().take(60).enumerate() {
        let coordinate = (k % 2) as u8;
        bench
            .link
            .send(&Request {
                id: 0,
                command: Command::Source { coordinate, source },
            })
            .expect("room");
        for _ in 0..(200 + 37 * k) {
            phase += 2e-4 * 6.0;
            bench.centre = [12.0 * phase.sin(), 9.0 * (1.3 * phase).cos() - 9.0, 450.0];
            bench.step();
            jump_check.check(&bench);
        }
    }
    assert_eq!(bench.state(), State::Run);
    assert!(
        bench
            .events
            .iter()
            .all(|event| !matches!(event, Event::Fault(_))),
        "{:?}",
        bench.events
    );
}

#[test]
fn jog_takes_over_only_at_standstill() {
    let mut bench = Bench::ready(mill());
    bench.master(0);
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    bench.move_master([-5.0, 0.0, 0.0], 2500);
    assert_eq!(bench.ask(Command::Hold), Ok(()));
    let mut jump_check = JumpCheck::at(&bench);
    assert!(bench.at(0).1 < -5.0, "under way: {}", bench.at(0).1);
    let source = Source::Jog;
    let id = 77;
    let command = Command::Source {
        coordinate: 0,
        source,
    };
    bench.link.send(&Request { id, command }).expect("room");
    for _ in 0..1500 {
        bench.step();
        jump_check.check(&bench);
    }
    assert_eq!((bench.state(), bench.at(0).1), (State::Hold, 0.0));
    assert_eq!(
        bench.ask(Command::Source {
            coordinate: 0,
            source
        }),
        Ok(())
    );
    for _ in 0..100 {
        bench.step();
        jump_check.check(&bench);
    }
}

/// A refused change of the source changes nothing: the offset from the master to the tool stays,
/// also while the tool cannot follow.
#[test]
fn a_refused_source_keeps_the_offset_of_the_master() {
    let mut bench = Bench::ready(mill());
    bench.master(0);
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    let begin = bench.at(0).0;
    bench.move_master([-5.0, 0.0, 0.0], 2500);
    let source = Source::Jog;
    let refused = Err(Refusal::State(State::Run));
    // During the motion the tool is behind the master: a new offset would keep this distance.
    bench.move_master([-0.1, 0.0, 0.0], 5);
    assert_eq!(
        bench.ask(Command::Source {
            coordinate: 0,
            source
        }),
        refused
    );
    bench.move_master([5.1, 0.0, 0.0], 2500);
    bench.steps(3000);
    let off = (bench.at(0).0 - begin).abs();
    assert!(off < 1e-3, "{off} mm");
}

#[test]
fn master_is_blocked_at_the_workspace_boundary() {
    let mut bench = Bench::ready(mill());
    bench.master(1);
    bench.master(2);
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    // G_P of 2 and repeated indexing, towards soft limit and edge of the workspace.
    assert_eq!(bench.ask(Command::PositionScale { scale: 8192 }), Ok(()));
    let mut jump_check = JumpCheck::at(&bench);
    for _ in 0..4 {
        bench.inputs.haptic.enabling_switch = true;
        jump_check.move_master(&mut bench, [0.0, 35.0, 30.0], 5000);
        bench.steps(3000);
        bench.inputs.haptic.enabling_switch = false;
        bench.steps(200);
        bench.move_master([0.0, -35.0, -30.0], 3000);
        jump_check = JumpCheck::at(&bench);
    }
    assert_eq!(bench.state(), State::Run, "{:?}", bench.events);
    let machine = bench.controller.machine().expect("configured");
    for axis in 1..3 {
        let limits = &machine.config.pose[axis];
        let place = machine.motion.commanded().pose.0[axis];
        assert!((limits.low..=limits.high).contains(&place));
    }
    // And back.
    bench.inputs.haptic.enabling_switch = true;
    let far = bench.at(1).0;
    bench.move_master([0.0, -10.0, -5.0], 3000);
    bench.steps(3000);
    assert!(bench.at(1).0 < far - 15.0, "{far} {}", bench.at(1).0);
}

#[test]
fn silent_remote_master_holds_the_job() {
    let config = Config {
        haptic: None,
        volumetric: None,
        ..mill()
    };
    let mut bench = Bench::ready(config);
    assert_eq!(
        bench.ask(Command::RemoteForce { force: [0; 3] }),
        Err(Refusal::NoMaster)
    );
    bench.master(0);
    bench.start_job();
    let start = bench.at(0).0;
    let mut x = 30.0_f64;
    let say = |bench: &mut Bench, epoch: u16, x: f64, rate: f64| {
        let master = MasterPose {
            tip: [(x * 1_048_576.0) as i32, 0, 0],
            rate: [(rate * 4096.0) as i32, 0, 0],
            axes: [[32767, 0, 0], [0, 0, 32767]],
            enabling_switch: true,
        };
        bench.say(Command::MasterPose {
            epoch,
            age_ms: 2,
            pose: master,
        });
    };
    let mut jump_check = JumpCheck::at(&bench);
    // 10 mm/s, a word every 10 ms.
    for k in 0..10_000 {
        if k % 50 == 0 {
            say(&mut bench, 1, x, -10.0);
        }
        x -= 10.0 * 2e-4;
        bench.step();
        jump_check.check(&bench);
    }
    assert!((bench.at(0).1 + 10.0).abs() < 0.6, "{:?}", bench.at(0));
    assert!(
        (bench.at(0).0 - start + 20.0).abs() < 0.6,
        "{}",
        bench.at(0).0 - start
    );
    // Silence.
    for _ in 0..2000 {
        bench.step();
        jump_check.check(&bench);
    }
    assert_eq!((bench.state(), bench.at(0).1), (State::Hold, 0.0));
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::MasterLost { age_ms: 50..=52 })),
        "{:?}",
        bench.events
    );
    // It comes back: nothing, and the old epoch is over.
    let held = bench.at(0).0;
    for k in 0..3000 {
        if k % 50 == 0 {
            say(&mut bench, 1, x + 5.0, 0.0);
        }
        bench.step();
    }
    assert_eq!(bench.at(0).0, held);
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    for k in 0..3000 {
        if k % 50 == 0 {
            say(&mut bench, 2, x, 0.0);
        }
        bench.step();
        jump_check.check(&bench);
    }
    assert!((bench.at(0).0 - held).abs() < 1e-3);
}
