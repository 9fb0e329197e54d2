//! It leads: the clutch, the scale, the orientation, holds and stops, sources that change, the edge of the workspace, and a hand afar.

use crate::arm::{self, rotation, times};
use crate::bed::Bed;
use crate::{JointMonitor, mill};
use haptimill_firmware::config::Config;
use haptimill_protocol::haptic::MasterPose;
use haptimill_protocol::message::{Command, Event, Refusal, Request, Source, State};

#[test]
fn the_tool_follows_the_hand_and_the_clutch_does_not_move_it() {
    let mut bed = Bed::ready(mill());
    bed.master(0);
    bed.master(1);
    bed.start_job();
    let start = [bed.at(0).0, bed.at(1).0, bed.at(2).0];
    // The hand moves and does not hold the button: nothing.
    bed.lead([5.0, 0.0, 0.0], 2000);
    assert_eq!(bed.at(0).0, start[0]);
    // It holds it, where it is now, and moves: the tool follows, z does not.
    bed.inputs.haptic.engaged = true;
    let mut watch = JointMonitor::at(&bed);
    for way in [[-12.0, 4.0, 3.0], [0.0; 3], [20.0, -9.0, 0.0], [0.0; 3]] {
        watch.lead(&mut bed, way, 5000);
    }
    for _ in 0..10_000 {
        bed.step();
        watch.look(&bed);
    }
    assert!(
        (bed.at(0).0 - start[0] - 8.0).abs() < 0.02,
        "{:?}",
        bed.at(0)
    );
    assert!(
        (bed.at(1).0 - start[1] + 5.0).abs() < 0.02,
        "{:?}",
        bed.at(1)
    );
    assert_eq!(bed.at(2).0, start[2]);
    // The clutch, in the midst of a motion: it lets go, goes back, and goes on from there.
    for _ in 0..5 {
        bed.lead([1.0, 0.0, 0.0], 500);
    }
    let mut watch = JointMonitor::at(&bed);
    bed.inputs.haptic.engaged = false;
    watch.lead(&mut bed, [-8.0, 0.0, 0.0], 4000);
    let rest = bed.at(0);
    assert_eq!(rest.1, 0.0);
    bed.inputs.haptic.engaged = true;
    for _ in 0..1000 {
        bed.step();
        watch.look(&bed);
    }
    assert!((bed.at(0).0 - rest.0).abs() < 0.02);
    // The scale changes while it leads: no jump, and half the way from there on.
    assert_eq!(
        bed.ask(Command::PositionScale { scale: 300 }),
        Err(Refusal::Range)
    );
    assert_eq!(
        bed.ask(Command::PositionScale { scale: 8300 }),
        Err(Refusal::Range)
    );
    let before = bed.at(0).0;
    assert_eq!(bed.ask(Command::PositionScale { scale: 2048 }), Ok(()));
    watch.lead(&mut bed, [-4.0, 0.0, 0.0], 4000);
    bed.steps(5000);
    assert!(
        (bed.at(0).0 - before + 2.0).abs() < 0.03,
        "{}",
        bed.at(0).0 - before
    );
    // The job is over: the hand leads no more.
    assert_eq!(bed.ask(Command::JobEnd { count: 0 }), Ok(()));
    bed.wait_for(State::Idle);
    // One event is told in a period.
    bed.steps(20);
    assert!(
        bed.events
            .iter()
            .any(|event| matches!(event, Event::JobDone { job: 3, .. }))
    );
}

#[test]
fn orientation_follows_the_handle() {
    let mut bed = Bed::ready(mill());
    for axis in 3..5 {
        bed.master(axis);
    }
    let start = [3, 4].map(|k| f64::from(bed.commanded()[k]) / 4_294_967_296.0 * 360.0);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.steps(10);
    // By 8 degrees about y, then 5 about x: theta about Y by as much, alpha about X against it (docs/control.md (3.20)-(3.22)).
    let (t, a) = (8.0_f64.to_radians(), 5.0_f64.to_radians());
    for k in 1..=4000 {
        let part = f64::from(k) / 4000.0;
        bed.turn = times(
            rotation([1.0, 0.0, 0.0], -a * part),
            rotation([0.0, 1.0, 0.0], t * part),
        );
        bed.step();
    }
    bed.steps(10_000);
    let (st, sa) = (start[0].to_radians(), start[1].to_radians());
    let tool = [
        libm::sin(st),
        libm::cos(st) * libm::sin(sa),
        libm::cos(st) * libm::cos(sa),
    ];
    let axis = arm::apply(bed.turn, tool);
    let degrees = |k: usize| f64::from(bed.commanded()[k]) / 4_294_967_296.0 * 360.0;
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
fn hold_stop_and_the_urgent_stop_brake_it_and_only_a_command_goes_on() {
    let mut bed = Bed::ready(mill());
    bed.master(0);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.lead([-5.0, 0.0, 0.0], 2500);
    bed.link
        .send(&Request {
            id: 0,
            command: Command::Hold,
        })
        .expect("room");
    bed.lead([-3.0, 0.0, 0.0], 1500);
    assert_eq!((bed.state(), bed.at(0).1), (State::Hold, 0.0));
    let held = bed.at(0).0;
    bed.lead([9.0, 0.0, 0.0], 1500);
    assert_eq!(bed.at(0).0, held);
    // Resumed where both are now.
    assert_eq!(bed.ask(Command::Resume), Ok(()));
    bed.steps(3000);
    assert!((bed.at(0).0 - held).abs() < 0.02);
    bed.lead([-4.0, 0.0, 0.0], 2000);
    bed.steps(4000);
    assert!((bed.at(0).0 - held + 4.0).abs() < 0.03);
    bed.inputs.urgent = true;
    bed.lead([-4.0, 0.0, 0.0], 2000);
    assert_eq!((bed.state(), bed.at(0).1), (State::Hold, 0.0));
    bed.steps(3000);
    assert_eq!(bed.ask(Command::Stop), Ok(()));
    bed.wait_for(State::Idle);
    // The emergency stop takes the arm off at once.
    assert!(bed.outputs.haptic.enabled);
    bed.inputs.emergency_stop = true;
    bed.step();
    assert!(bed.arm_off());
}

#[test]
fn sources_change_while_they_move() {
    let mut bed = Bed::ready(mill());
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.steps(10);
    let mut watch = JointMonitor::at(&bed);
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
        let axis = (k % 2) as u8;
        bed.link
            .send(&Request {
                id: 0,
                command: Command::Source { axis, source },
            })
            .expect("room");
        for _ in 0..(200 + 37 * k) {
            phase += 2e-4 * 6.0;
            bed.centre = [12.0 * phase.sin(), 9.0 * (1.3 * phase).cos() - 9.0, 450.0];
            bed.step();
            watch.look(&bed);
        }
    }
    assert_eq!(bed.state(), State::Run);
    assert!(
        bed.events
            .iter()
            .all(|event| !matches!(event, Event::Fault(_))),
        "{:?}",
        bed.events
    );
}

#[test]
fn a_jog_takes_over_only_what_has_come_to_rest() {
    let mut bed = Bed::ready(mill());
    bed.master(0);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.lead([-5.0, 0.0, 0.0], 2500);
    assert_eq!(bed.ask(Command::Hold), Ok(()));
    let mut watch = JointMonitor::at(&bed);
    assert!(bed.at(0).1 < -5.0, "under way: {}", bed.at(0).1);
    let source = Source::Jog;
    let id = 77;
    let command = Command::Source { axis: 0, source };
    bed.link.send(&Request { id, command }).expect("room");
    for _ in 0..1500 {
        bed.step();
        watch.look(&bed);
    }
    assert_eq!((bed.state(), bed.at(0).1), (State::Hold, 0.0));
    assert_eq!(bed.ask(Command::Source { axis: 0, source }), Ok(()));
    for _ in 0..100 {
        bed.step();
        watch.look(&bed);
    }
}

#[test]
fn it_waits_in_front_of_where_the_machine_cannot_go() {
    let mut bed = Bed::ready(mill());
    bed.master(1);
    bed.master(2);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    // G_P of 2 and repeated strokes of the clutch, towards soft limit and edge of the workspace.
    assert_eq!(bed.ask(Command::PositionScale { scale: 8192 }), Ok(()));
    let mut watch = JointMonitor::at(&bed);
    for _ in 0..4 {
        bed.inputs.haptic.engaged = true;
        watch.lead(&mut bed, [0.0, 35.0, 30.0], 5000);
        bed.steps(3000);
        bed.inputs.haptic.engaged = false;
        bed.steps(200);
        bed.lead([0.0, -35.0, -30.0], 3000);
        watch = JointMonitor::at(&bed);
    }
    assert_eq!(bed.state(), State::Run, "{:?}", bed.events);
    let machine = bed.controller.machine().expect("configured");
    for axis in 1..3 {
        let limits = &machine.config.pose[axis];
        let place = machine.motion.commanded().pose.0[axis];
        assert!((limits.low..=limits.high).contains(&place));
    }
    // And back.
    bed.inputs.haptic.engaged = true;
    let far = bed.at(1).0;
    bed.lead([0.0, -10.0, -5.0], 3000);
    bed.steps(3000);
    assert!(bed.at(1).0 < far - 15.0, "{far} {}", bed.at(1).0);
}

#[test]
fn a_hand_afar_leads_and_when_it_falls_silent_the_mill_holds() {
    let config = Config {
        haptic: None,
        ..mill()
    };
    let mut bed = Bed::ready(config);
    assert_eq!(
        bed.ask(Command::RemoteForce { force: [0; 3] }),
        Err(Refusal::NoMaster)
    );
    bed.master(0);
    bed.start_job();
    let start = bed.at(0).0;
    let mut x = 30.0_f64;
    let say = |bed: &mut Bed, epoch: u16, x: f64, rate: f64| {
        let hand = MasterPose {
            tip: [(x * 1_048_576.0) as i32, 0, 0],
            rate: [(rate * 4096.0) as i32, 0, 0],
            axes: [[32767, 0, 0], [0, 0, 32767]],
            engaged: true,
        };
        bed.say(Command::MasterPose {
            epoch,
            age_ms: 2,
            pose: hand,
        });
    };
    let mut watch = JointMonitor::at(&bed);
    // 10 mm/s, a word every 10 ms.
    for k in 0..10_000 {
        if k % 50 == 0 {
            say(&mut bed, 1, x, -10.0);
        }
        x -= 10.0 * 2e-4;
        bed.step();
        watch.look(&bed);
    }
    assert!((bed.at(0).1 + 10.0).abs() < 0.6, "{:?}", bed.at(0));
    assert!(
        (bed.at(0).0 - start + 20.0).abs() < 0.6,
        "{}",
        bed.at(0).0 - start
    );
    // Silence.
    for _ in 0..2000 {
        bed.step();
        watch.look(&bed);
    }
    assert_eq!((bed.state(), bed.at(0).1), (State::Hold, 0.0));
    assert!(
        bed.events
            .iter()
            .any(|event| matches!(event, Event::MasterLost { age_ms: 50..=52 })),
        "{:?}",
        bed.events
    );
    // It comes back: nothing, and the old epoch is over.
    let held = bed.at(0).0;
    for k in 0..3000 {
        if k % 50 == 0 {
            say(&mut bed, 1, x + 5.0, 0.0);
        }
        bed.step();
    }
    assert_eq!(bed.at(0).0, held);
    assert_eq!(bed.ask(Command::Resume), Ok(()));
    for k in 0..3000 {
        if k % 50 == 0 {
            say(&mut bed, 2, x, 0.0);
        }
        bed.step();
        watch.look(&bed);
    }
    assert!((bed.at(0).0 - held).abs() < 1e-3);
}
