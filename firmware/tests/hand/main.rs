//! A hand in the controller: it leads, it feels, it lets go, its arm lies, and it is far away.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

#[path = "../arm/mod.rs"]
mod arm;
mod bed;

use arm::{rotation, times};
use bed::Bed;
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_firmware::force::conditioning::{Channel, Sensor};
use haptimill_firmware::force::{ForceConfig, Gate, LoopSettings};
use haptimill_firmware::units::force::{Force, VirtualDamping, VirtualMass};
use haptimill_firmware::units::{Length, Rate};
use haptimill_protocol::haptic::{Hand, HandProblem, ReflectAxis, Reflection, Wall};
use haptimill_protocol::message::{Command, Event, Fault, Refusal, Request, Source, State};

fn mill() -> Config {
    Config {
        follow: Some(reference::follow()),
        haptic: Some(reference::haptic()),
        ..reference::h4_with_steps()
    }
}

/// Of 200 mm/s^2 in a period, mm/s, and a little for rounding.
const STEP: f64 = 200.0 * 2e-4 + 1e-3;

fn master(bed: &mut Bed, axis: u8) {
    let source = Source::Master;
    assert_eq!(bed.ask(Command::Source { axis, source }), Ok(()));
}

/// Watches that nothing jumps: place against the rate, rate against the acceleration.
struct Watch {
    before: [(f64, f64); 3],
}

impl Watch {
    fn at(bed: &Bed) -> Self {
        Self {
            before: [bed.at(0), bed.at(1), bed.at(2)],
        }
    }

    /// The handle goes on evenly by a way.
    #[track_caller]
    fn lead(&mut self, bed: &mut Bed, way: [f64; 3], periods: usize) {
        for _ in 0..periods {
            bed.lead(way.map(|part| part / periods as f64), 1);
            self.look(bed);
        }
    }

    #[track_caller]
    fn look(&mut self, bed: &Bed) {
        for axis in 0..3 {
            let (now, before) = (bed.at(axis), self.before[axis]);
            let step = now.0 - before.0 - (now.1 + before.1) / 2.0 * 2e-4;
            assert!(step.abs() < 1e-3, "axis {axis} steps by {step} mm");
            let change = now.1 - before.1;
            assert!(
                change.abs() < STEP,
                "axis {axis} changes its rate by {change} mm/s"
            );
            self.before[axis] = now;
        }
    }
}

#[test]
fn the_tool_follows_the_hand_and_the_clutch_does_not_move_it() {
    let mut bed = Bed::ready(mill());
    master(&mut bed, 0);
    master(&mut bed, 1);
    bed.start_job();
    let start = [bed.at(0).0, bed.at(1).0, bed.at(2).0];
    // The hand moves and does not hold the button: nothing.
    bed.lead([5.0, 0.0, 0.0], 2000);
    assert_eq!(bed.at(0).0, start[0]);
    // It holds it, where it is now, and moves: the tool follows, z does not.
    bed.inputs.haptic.engaged = true;
    let mut watch = Watch::at(&bed);
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
    let mut watch = Watch::at(&bed);
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
        bed.ask(Command::HandScale { scale: 300 }),
        Err(Refusal::Range)
    );
    assert_eq!(
        bed.ask(Command::HandScale { scale: 8300 }),
        Err(Refusal::Range)
    );
    let before = bed.at(0).0;
    assert_eq!(bed.ask(Command::HandScale { scale: 2048 }), Ok(()));
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
        master(&mut bed, axis);
    }
    let start = [3, 4].map(|k| f64::from(bed.wanted()[k]) / 4_294_967_296.0 * 360.0);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.steps(10);
    // By 8 degrees about y, then 5 about x: theta about Y by as much, alpha about X against it (spec h4-milling (3.20)-(3.22)).
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
    let degrees = |k: usize| f64::from(bed.wanted()[k]) / 4_294_967_296.0 * 360.0;
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
    master(&mut bed, 0);
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
    let mut watch = Watch::at(&bed);
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
fn it_waits_in_front_of_where_the_machine_cannot_go() {
    let mut bed = Bed::ready(mill());
    master(&mut bed, 1);
    master(&mut bed, 2);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    // G_P of 2 and repeated strokes of the clutch, towards soft limit and edge of the workspace.
    assert_eq!(bed.ask(Command::HandScale { scale: 8192 }), Ok(()));
    let mut watch = Watch::at(&bed);
    for _ in 0..4 {
        bed.inputs.haptic.engaged = true;
        watch.lead(&mut bed, [0.0, 35.0, 30.0], 5000);
        bed.steps(3000);
        bed.inputs.haptic.engaged = false;
        bed.steps(200);
        bed.lead([0.0, -35.0, -30.0], 3000);
        watch = Watch::at(&bed);
    }
    assert_eq!(bed.state(), State::Run, "{:?}", bed.events);
    let machinery = bed.controller.machinery().expect("configured");
    for axis in 1..3 {
        let limits = &machinery.config.pose[axis];
        let place = machinery.motion.wanted().pose.0[axis];
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
fn a_lying_encoder_frees_the_hand_and_stops_the_mill() {
    for (lie, name) in [
        ((|counts| counts + 2000) as fn(i32) -> i32, "jump"),
        (|_| 0, "stuck"),
        (|counts: i32| -counts, "reversed"),
    ] {
        for sensor in 0..3 {
            let mut bed = Bed::ready(mill());
            master(&mut bed, 0);
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
                    Some(Fault::Hand(HandProblem::Encoder { leg: 1, .. }))
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
    assert!(bed.events.contains(&Event::Hand(HandProblem::Drive)));
    assert_eq!(bed.ask(Command::Reset), Ok(()));
    bed.steps(2);
    assert!(bed.outputs.haptic.enabled);
    master(&mut bed, 0);
    bed.inputs.haptic.legs[2].illegal[1] = 11;
    bed.step();
    assert!(bed.arm_off());
    let fault = bed.controller.safety().fault();
    assert_eq!(
        fault,
        Some(Fault::Hand(HandProblem::Illegal { leg: 2, sensor: 1 }))
    );
}

/// A role master: the same controller without axes. It feels what it is told, within what may change in a period, and its telemetry leads another.
#[test]
fn an_arm_alone_feels_what_a_tool_afar_feels() {
    let mut bed = Bed::ready(reference::master());
    assert_eq!(bed.ask(Command::HandTelemetry { every: 20 }), Ok(()));
    bed.inputs.haptic.engaged = true;
    bed.steps(600);
    let felt = |bed: &Bed| {
        let arm = bed
            .controller
            .machinery()
            .expect("configured")
            .hands
            .arm
            .clone()
            .expect("an arm");
        arm.force().map(|force| f64::from(force.0) / 65_536.0)
    };
    let mut last = felt(&bed);
    let mut steps = 0;
    let mut run = |bed: &mut Bed, force: [f64; 3], periods: usize| {
        for k in 0..periods {
            if k % 50 == 0 {
                let force = force.map(|part| (part * 64.0) as i16);
                bed.link
                    .send_latest(&Request {
                        id: 0,
                        command: Command::Feel { force },
                    })
                    .expect("open");
            }
            bed.step();
            let now = felt(bed);
            for axis in 0..3 {
                assert!((now[axis] - last[axis]).abs() <= 0.0501, "{now:?} {last:?}");
                steps += usize::from((now[axis] - last[axis]).abs() > 0.0499);
            }
            last = now;
        }
        last
    };
    // 40 % of 5 N, 10 % and 20 % of 5 N; then the limits of 3.2 and 1.2 N.
    let force = run(&mut bed, [5.0, -5.0, 5.0], 1000);
    for (force, want) in force.into_iter().zip([2.0, -0.5, 1.0]) {
        assert!((force - want).abs() < 0.01, "{force} {want}");
    }
    let force = run(&mut bed, [40.0, -5.0, -40.0], 1000);
    for (force, want) in force.into_iter().zip([3.2, -0.5, -1.2]) {
        assert!((force - want).abs() < 0.01, "{force} {want}");
    }
    // Another percentage comes in gently.
    let axis = ReflectAxis {
        percent: 20,
        most: 3 << 16,
    };
    let settings = Reflection {
        axes: [axis; 3],
        boost: 6554,
        boost_below: 2 << 16,
    };
    assert_eq!(bed.ask(Command::Reflect(settings)), Ok(()));
    let force = run(&mut bed, [10.0, 0.0, 0.0], 8000);
    assert!((force[0] - 2.0).abs() < 0.01, "{force:?}");
    let bad = Reflection {
        axes: [ReflectAxis {
            percent: 101,
            most: 0,
        }; 3],
        ..settings
    };
    assert_eq!(bed.ask(Command::Reflect(bad)), Err(Refusal::Range));
    assert!(steps > 10, "the step was never used");
    // Nothing more is heard of the tool: the force goes away by itself.
    bed.steps(1500);
    assert!(felt(&bed)[0].abs() < 0.01);
    let hand = bed.hand_report.expect("telemetry of the hand");
    assert!(hand.hand.engaged && hand.enabled && hand.problem.is_none());
    assert!(
        (f64::from(hand.hand.tip[2]) / 1_048_576.0 - 600.0).abs() < 0.05,
        "{hand:?}"
    );
    assert!(hand.hand.axes[0][0] > 32_700 && hand.hand.axes[1][2] > 32_700);
}

#[test]
fn virtual_walls_push_back_and_a_moving_one_goes_along() {
    let mut bed = Bed::ready(reference::master());
    let at = |x: f64| Some((x * 1_048_576.0) as i32);
    let wall = |x: f64, rate: f64| {
        Some(Wall {
            at: at(x),
            rate: (rate * 4096.0) as i32,
        })
    };
    assert_eq!(
        bed.ask(Command::Wall {
            axis: 0,
            upper: false,
            wall: wall(-10.0, 0.0)
        }),
        Ok(())
    );
    assert_eq!(
        bed.ask(Command::Wall {
            axis: 0,
            upper: true,
            wall: wall(-6.0, 0.0)
        }),
        Err(Refusal::WallTooNear)
    );
    assert_eq!(
        bed.ask(Command::Wall {
            axis: 3,
            upper: true,
            wall: None
        }),
        Err(Refusal::Range)
    );
    let force = |bed: &Bed| {
        let arm = bed
            .controller
            .machinery()
            .expect("configured")
            .hands
            .arm
            .clone()
            .expect("an arm");
        f64::from(arm.force()[0].0) / 65_536.0
    };
    bed.lead([-9.0, 0.0, 0.0], 5000);
    assert_eq!(force(&bed), 0.0);
    bed.lead([-6.0, 0.0, 0.0], 5000);
    // At rest: what watches the swings takes some tenths of a second to see that there is none.
    bed.steps(4000);
    assert!((force(&bed) - 5.0 * 0.35).abs() < 0.02, "{}", force(&bed));
    bed.lead([-20.0, 0.0, 0.0], 9000);
    bed.steps(4000);
    assert!((force(&bed) - 5.5).abs() < 0.01, "{}", force(&bed));
    bed.lead([35.0, 0.0, 0.0], 9000);
    // Thrown back by the wall, the hand may be damped while it moves.
    assert!(force(&bed).abs() < 0.5);
    bed.steps(500);
    assert_eq!(force(&bed), 0.0);
    // E6: from the handle, 4 mm/s in -X.
    let moving = Wall {
        at: None,
        rate: -4 * 4096,
    };
    assert_eq!(
        bed.ask(Command::Wall {
            axis: 0,
            upper: false,
            wall: Some(moving)
        }),
        Ok(())
    );
    bed.lead([-20.0, 0.0, 0.0], 5000);
    // 20 mm in a second, the wall 4 mm behind: 16 mm ahead of it, 5.5 N at the most.
    assert!((force(&bed) - 5.5).abs() < 0.15, "{}", force(&bed));
    bed.lead([-1.0, 0.0, 0.0], 5000);
    // It comes after: 13 mm, and 0.4 mm less a tenth of a second later, when a hand at rest is not damped any more.
    bed.steps(500);
    assert!((force(&bed) - 12.6 * 0.35).abs() < 0.02, "{}", force(&bed));
}

#[test]
fn a_hand_afar_leads_and_when_it_falls_silent_the_mill_holds() {
    let config = Config {
        haptic: None,
        ..mill()
    };
    let mut bed = Bed::ready(config);
    assert_eq!(
        bed.ask(Command::Feel { force: [0; 3] }),
        Err(Refusal::NoHand)
    );
    master(&mut bed, 0);
    bed.start_job();
    let start = bed.at(0).0;
    let mut x = 30.0_f64;
    let say = |bed: &mut Bed, epoch: u16, x: f64, rate: f64| {
        let hand = Hand {
            tip: [(x * 1_048_576.0) as i32, 0, 0],
            rate: [(rate * 4096.0) as i32, 0, 0],
            axes: [[32767, 0, 0], [0, 0, 32767]],
            engaged: true,
        };
        bed.link
            .send_latest(&Request {
                id: 0,
                command: Command::Hand {
                    epoch,
                    age_ms: 2,
                    hand,
                },
            })
            .expect("open");
    };
    let mut watch = Watch::at(&bed);
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
            .any(|event| matches!(event, Event::HandLost { age_ms: 50..=52 })),
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

#[test]
fn what_cannot_be_is_refused() {
    let mut bed = Bed::ready(reference::h4_with_steps());
    let source = Source::Master;
    assert_eq!(
        bed.ask(Command::Source { axis: 0, source }),
        Err(Refusal::NoHand)
    );
    assert_eq!(
        bed.ask(Command::HandScale { scale: 4096 }),
        Err(Refusal::NoHand)
    );
    assert_eq!(
        bed.ask(Command::Wall {
            axis: 0,
            upper: true,
            wall: None
        }),
        Err(Refusal::NoHand)
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

/// A sensor of +-100 N with 14 bits.
fn sensor() -> ForceConfig {
    let channel = || Channel {
        per_code: (100.0 / 8192.0 * 65_536.0 * 65_536.0) as i32,
        saturation: 7782,
    };
    let settings = LoopSettings {
        desired: Force::millinewtons(5000),
        mass: VirtualMass(1 << 16),
        damping: VirtualDamping(5 << 16),
        limit: Length::millimetres(10),
        rate: Rate(10 << 20),
        gate: Gate::AgainstMotion,
    };
    ForceConfig {
        sensor: Sensor {
            channels: [channel(), channel(), channel()],
            silent_samples: 3,
            stuck_samples: 500,
            drift: Force::millinewtons(500),
            limit: Force::millinewtons(80_000),
            tare_samples: 256,
            tare_spread: 30,
            weight: Force::ZERO,
        },
        axes: [settings.clone(), settings.clone(), settings],
        mask: 0,
        drive_lag_us: 5000,
        creep: Rate::ZERO,
        slowest_rpm: 4000,
    }
}

/// From the sensor here to the hand here: the currents of the period in which the force was sampled, and its law in steady contact.
#[test]
fn a_force_is_felt_in_the_period_in_which_it_was_sampled() {
    let config = Config {
        force: Some(sensor()),
        ..mill()
    };
    let mut bed = Bed::ready(config);
    bed.codes = Some([0; 3]);
    assert_eq!(bed.ask(Command::Tare), Ok(()));
    bed.steps(600);
    assert!(bed.events.contains(&Event::Tared), "{:?}", bed.events);
    master(&mut bed, 0);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.steps(1500);
    let before = bed.outputs.haptic.currents;
    // 5 N in x: 410 codes.
    bed.codes = Some([410, 0, 0]);
    bed.step();
    assert_ne!(bed.outputs.haptic.currents, before);
    let felt = |bed: &Bed| {
        let arm = bed
            .controller
            .machinery()
            .expect("configured")
            .hands
            .arm
            .as_ref()
            .expect("an arm");
        f64::from(arm.force()[0].0) / 65_536.0
    };
    assert!((felt(&bed) - 0.05).abs() < 0.02, "{}", felt(&bed));
    bed.steps(200);
    assert!((felt(&bed) - 2.0).abs() < 0.05, "{}", felt(&bed));
    // Lifted, the handle is free; nothing jumps.
    bed.inputs.haptic.engaged = false;
    let mut last = felt(&bed);
    for _ in 0..1000 {
        bed.step();
        assert!((felt(&bed) - last).abs() <= 0.0501);
        last = felt(&bed);
    }
    assert!(last.abs() < 0.01);
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
            .any(|event| matches!(event, Event::Hand(HandProblem::Encoder { leg: 0, .. }))),
        "{:?}",
        bed.events
    );
    bed.lie = None;
    bed.steps(5);
    assert_eq!(bed.ask(Command::Enable), Ok(()));
    bed.steps(5);
    assert!(bed.outputs.haptic.enabled && bed.state() == State::Idle);
}
