//! A joint on its limit switch is moved off by a command: only this joint moves, only away from the
//! switch, and not far where the switch does not open. `position kept` is true to the plant.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::fault::Fault as Injected;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{
    Command, Event, Fault, HomingProblem, InputProblem, Refusal, State,
};
use haptimill_tests::Bench;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use setup::{MM, drives_off, jog, line, state};

const SERVO: &str = include_str!("../../machines/mill3-servo.toml");
const MILL: &str = include_str!("../../machines/mill3.toml");
const ROUTER: &str = include_str!("../../machines/router3.toml");

/// Stroke and limit switches of the joints of the servo mill, mm.
const STROKES: [(f64, f64); 3] = [(-155.0, 155.0), (-105.0, 105.0), (-55.0, 105.0)];
const NAMES: [&str; 3] = ["x", "y", "z"];

/// Backlash and wind-up of a screw, mm.
const LOST_MOTION: f64 = 0.03;

fn bench(text: &str, faults: &[String]) -> Bench {
    let machine =
        MachineFile::parse("changed.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let options = RigOptions {
        faults: faults
            .iter()
            .map(|fault| fault.parse::<Injected>().expect("a fault"))
            .collect(),
        ..RigOptions::default()
    };
    let mut bench = Bench::of_machine(machine, &options, Controller::new(200));
    bench.steps(500);
    bench.configure();
    bench
}

/// The servo mill with a joint pushed onto a limit switch by hand, drives off.
fn pushed(joint: usize, upper: bool, more: &[&str]) -> Bench {
    let effort = if upper { 45.0 } else { -45.0 };
    let push = format!("push joint={} effort={effort} at=1s for=7s", NAMES[joint]);
    let mut faults = vec![push];
    faults.extend(more.iter().map(ToString::to_string));
    let mut bench = bench(SERVO, &faults);
    bench.steps(45_000);
    let (low, high) = STROKES[joint];
    let at = bench.rig.truth().joints[joint];
    let is_on = if upper {
        at > high + 3.0
    } else {
        at < low - 3.0
    };
    assert!(is_on, "{joint} {upper}: {at}");
    bench
}

/// What moved during a motion off a switch, from the plant.
#[derive(Debug)]
struct Moved {
    /// Farthest towards the switch and away from it, mm.
    towards: f64,
    away: f64,
    /// Largest motion of another joint, mm.
    others: f64,
    /// Maximum rate, mm/s.
    rate: f64,
    /// Largest following error of a joint whose drive is on, mm.
    following: f64,
    periods: usize,
}

/// Largest following error, mm; 0 where the drives are off.
fn following(bench: &Bench) -> f64 {
    if drives_off(bench) {
        return 0.0;
    }
    let machine = bench.rig.control().machine().expect("configured");
    machine.joints().fold(0.0_f64, |max, joint| {
        max.max(f64::from(joint.following_error.0).abs() / MM)
    })
}

/// Follows the motion until it ends; `until` may command something in a period of it.
fn follow(
    bench: &mut Bench,
    moving: &[usize],
    upper: bool,
    mut during: impl FnMut(&mut Bench, usize),
) -> Moved {
    let begin = bench.rig.truth().joints;
    let mut moved = Moved {
        towards: 0.0,
        away: 0.0,
        others: 0.0,
        rate: 0.0,
        following: 0.0,
        periods: 0,
    };
    // The mean over 20 ms: a screw that winds up is no motion.
    let mut marks = vec![begin];
    while state(bench) == State::Homing {
        bench.step();
        during(bench, moved.periods);
        moved.periods += 1;
        moved.following = moved.following.max(following(bench));
        assert!(moved.periods < 300_000, "it does not end");
        let now = bench.rig.truth().joints;
        for (index, (now, begin)) in now.iter().zip(&begin).enumerate().take(4) {
            let by = if upper { begin - now } else { now - begin };
            if moving.contains(&index) {
                moved.away = moved.away.max(by);
                moved.towards = moved.towards.max(-by);
            } else {
                moved.others = moved.others.max(by.abs());
            }
        }
        if moved.periods.is_multiple_of(100) {
            let before = marks.last().expect("a mark")[moving[0]];
            moved.rate = moved.rate.max((now[moving[0]] - before).abs() / 0.02);
            marks.push(now);
        }
    }
    moved
}

fn home(bench: &mut Bench) {
    if state(bench) == State::Disabled {
        bench.ask(Command::Enable).expect("enabled");
    }
    bench.ask(Command::Home).expect("homing");
    assert!(bench.wait_for(State::Idle, 400_000), "{:?}", bench.events);
    bench.steps(1000);
    let status = bench.status();
    assert!(status.homed, "{status:?}");
}

/// Largest distance of a true joint from the measured one, mm.
fn error(bench: &mut Bench) -> f64 {
    let status = bench.status();
    let truth = bench.rig.truth().joints;
    let errors = status.joints.iter().zip(truth);
    errors
        .map(|(value, truth)| (f64::from(*value) / MM - truth).abs())
        .fold(0.0, f64::max)
}

#[test]
fn every_joint_comes_off_both_of_its_switches() {
    for joint in 0..3 {
        for upper in [false, true] {
            let mut bench = pushed(joint, upper, &[]);
            let on = Err(Refusal::Input(InputProblem::LimitSwitch {
                joint: joint as u8,
            }));
            assert_eq!(bench.ask(Command::Enable), on);
            bench
                .ask(Command::MoveOff { joint: joint as u8 })
                .expect("moves");
            let moved = follow(&mut bench, &[joint], upper, |_, _| ());
            bench.steps(200);
            println!("{} {upper}: {moved:?}", NAMES[joint]);
            assert!(
                moved.towards < LOST_MOTION && moved.others < LOST_MOTION,
                "{moved:?}"
            );
            // A sixteenth of the stroke, and twice that into the stroke, at a 32nd of the rate.
            let (low, high) = STROKES[joint];
            assert!(moved.away < 3.0 * (high - low) / 16.0 + 0.5, "{moved:?}");
            assert!(moved.rate < 100.0 / 32.0 * 1.2, "{moved:?}");
            let at = bench.rig.truth().joints[joint];
            assert!((low..high).contains(&at), "{at}");
            assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
            assert!(
                bench
                    .events
                    .contains(&Event::MovedOff { joint: joint as u8 }),
                "{:?}",
                bench.events
            );
            let status = bench.status();
            assert!(!status.homed, "{status:?}");
            let start = status.commanded;
            assert_eq!(
                bench.try_job(1, &line(&start, 0, 5.0, 2)),
                Err(Refusal::NotHomed)
            );
            home(&mut bench);
            assert!(error(&mut bench) < 0.02, "{}", error(&mut bench));
        }
    }
}

/// A joint that is on no switch, on both, or not there; a machine that is not disabled.
#[test]
fn anything_else_is_refused_and_nothing_moves() {
    let mut free = bench(SERVO, &[]);
    let none = |joint| Err(Refusal::Input(InputProblem::NoLimitSwitch { joint }));
    assert_eq!(free.ask(Command::MoveOff { joint: 1 }), none(1));
    assert_eq!(free.ask(Command::MoveOff { joint: 3 }), Err(Refusal::Range));
    free.ask(Command::Enable).expect("enabled");
    let idle = Err(Refusal::State(State::Idle));
    assert_eq!(free.ask(Command::MoveOff { joint: 0 }), idle);
    let both =
        ["low", "high"].map(|end| format!("switch-stuck joint=x switch=limit-{end} active=yes"));
    let mut both = bench(SERVO, &both);
    let refused = Err(Refusal::Input(InputProblem::BothLimitSwitches { joint: 0 }));
    assert_eq!(both.ask(Command::MoveOff { joint: 0 }), refused);
    assert!(drives_off(&both) && state(&both) == State::Disabled);
    // An open door.
    let mut open = pushed(0, true, &["input-level name=door level=low at=8s"]);
    let input = 3;
    let door = Err(Refusal::Input(InputProblem::DoorOpen { input }));
    assert_eq!(open.ask(Command::MoveOff { joint: 0 }), door);
    assert!(drives_off(&open) && state(&open) == State::Disabled);
    // During the motion nothing else starts, and another switch is a fault.
    let mut bench = pushed(
        0,
        true,
        &["switch-stuck joint=y switch=limit-low active=yes at=11s"],
    );
    bench.ask(Command::MoveOff { joint: 0 }).expect("moves");
    let homing = Err(Refusal::State(State::Homing));
    for command in [
        Command::Home,
        Command::Enable,
        Command::Disable,
        Command::MoveOff { joint: 0 },
    ] {
        assert_eq!(bench.ask(command), homing);
    }
    assert_eq!(bench.ask(jog(1, 200, &[(0, 5.0)])), Err(Refusal::NotHomed));
    follow(&mut bench, &[0], true, |_, _| ());
    assert_eq!(bench.status().fault, Some(Fault::LimitSwitch { joint: 1 }));
    assert!(drives_off(&bench));
}

/// Switches that are stuck, inverted, or wired to the other end's input: the motion ends.
#[test]
fn a_switch_that_does_not_open_ends_the_motion() {
    for fault in [
        "switch-stuck joint=x switch=limit-low active=yes",
        "switch-inverted joint=x switch=limit-low",
    ] {
        let mut bench = bench(SERVO, &[fault.to_string()]);
        bench.ask(Command::MoveOff { joint: 0 }).expect("moves");
        let moved = follow(&mut bench, &[0], false, |_, _| ());
        println!("{fault}: {moved:?}");
        let problem = HomingProblem::LimitStuck;
        assert_eq!(
            bench.status().fault,
            Some(Fault::Homing { joint: 0, problem })
        );
        assert!(drives_off(&bench));
        let sixteenth = 310.0 / 16.0;
        assert!(
            (sixteenth - 1.0..sixteenth + 1.0).contains(&moved.away),
            "{moved:?}"
        );
    }
    // The upper switch is wired to the lower input: the joint runs onto its hard stop.
    let exchanged = [
        "switch-missing joint=x switch=limit-high",
        "switch-stuck joint=x switch=limit-low active=yes",
    ];
    let mut bench = pushed(0, true, &exchanged);
    bench.ask(Command::MoveOff { joint: 0 }).expect("moves");
    let moved = follow(&mut bench, &[0], true, |_, _| ());
    let status = bench.status();
    println!("exchanged: {moved:?} {:?}", status.fault);
    assert_eq!(status.state, State::Fault);
    assert!(drives_off(&bench) && moved.towards < 2.0, "{moved:?}");
}

/// Step motors without encoders begin on limit switches; the beam of a gantry moves as one.
#[test]
fn open_loop_joints_and_both_motors_of_a_gantry_come_off() {
    let at = |text: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    };
    let x = "preset = 0.0\nstart_spread = 20.0\nhome = { at = -150.0,";
    let on = "preset = 158.0\nstart_spread = 0.0\nlimit_high = 157.0\nhome = { at = -150.0,";
    let mut mill = bench_with_plant(MILL, &at(MILL, x, on));
    mill.ask(Command::MoveOff { joint: 0 }).expect("moves");
    let moved = follow(&mut mill, &[0], true, |_, _| ());
    assert!(
        moved.towards < LOST_MOTION && moved.others < LOST_MOTION,
        "{moved:?}"
    );
    assert!(
        mill.rig.truth().joints[0] < 157.0 && state(&mill) == State::Idle,
        "{:?}",
        mill.events
    );
    assert!(!mill.status().homed);
    home(&mut mill);
    assert!(error(&mut mill) < 0.02);

    let y = "preset = 0.0\nstart_spread = 20.0\nhome = { at = -100.0,";
    let on = "preset = 108.0\nstart_spread = 0.0\nlimit_high = 107.0\nhome = { at = -100.0,";
    let plant = at(ROUTER, y, on);
    let y2 = "preset = 0.0\ngantry_of = \"y\"";
    let plant = at(
        &plant,
        y2,
        "preset = 108.0\nlimit_high = 107.0\ngantry_of = \"y\"",
    );
    for joint in [1, 3] {
        let mut router = bench_with_plant(ROUTER, &plant);
        let racking = |bench: &Bench| bench.rig.truth().joints[3] - bench.rig.truth().joints[1];
        let before = racking(&router);
        router.ask(Command::MoveOff { joint }).expect("moves");
        let moved = follow(&mut router, &[1, 3], true, |bench, _| {
            let by = (racking(bench) - before).abs();
            assert!(by < 0.1, "racked by {by}");
        });
        println!("gantry by {joint}: {moved:?}");
        assert!(
            moved.towards < 0.1 && moved.others < LOST_MOTION,
            "{moved:?}"
        );
        let truth = router.rig.truth().joints;
        assert!(truth[1] < 107.0 && truth[3] < 107.0, "{truth:?}");
        assert_eq!(state(&router), State::Idle, "{:?}", router.events);
        home(&mut router);
    }
}

/// A machine file, and the simulated machine of another text.
fn bench_with_plant(text: &str, plant: &str) -> Bench {
    let machine =
        MachineFile::parse("changed.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let machine = MachineFile {
        text: plant.to_string(),
        ..machine
    };
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    bench.steps(500);
    bench.configure();
    bench
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever interrupts the motion, it ends within its bounds, the drives are off or hold off
    /// the switch, and a kept position is true to the plant.
    #[test]
    fn an_interrupted_motion_ends_and_never_claims_a_wrong_position(
        joint in 0_usize..3, upper: bool, kind in 0_u8..7, at in 0_usize..30_000,
    ) {
        let jam = format!("joint-jammed joint={} at={}s", NAMES[joint], 10.0 + at as f64 * 2e-4);
        let late = format!("missed-periods count=60 at={}s", 10.0 + at as f64 * 2e-4);
        let jams: &[&str] = match kind {
            0 => &[&jam],
            5 => &[&late],
            _ => &[],
        };
        let mut unheard = 0.0_f64;
        let mut bench = pushed(joint, upper, jams);
        bench.ask(Command::MoveOff { joint: joint as u8 }).expect("moves");
        let moved = follow(&mut bench, &[joint], upper, |bench, period| {
            if period != at {
                return;
            }
            match kind {
                1 => { bench.send(Command::Stop); }
                2 => { bench.send(Command::Hold); }
                3 => { bench.send(Command::EmergencyStop); }
                4 => bench.rig.plant_mut().set_emergency_stop(true),
                6 => for _ in 0..4000 {
                    // The host is silent.
                    bench.rig.step();
                    unheard = unheard.max(following(bench));
                },
                _ => {}
            }
        });
        let (low, high) = STROKES[joint];
        prop_assert!(moved.towards < LOST_MOTION && moved.others < LOST_MOTION, "{:?}", moved);
        prop_assert!(moved.away < 3.0 * (high - low) / 16.0 + 0.5, "{:?}", moved);
        let mut following_error = moved.following.max(unheard);
        for _ in 0..if kind == 5 { at + 500 } else { 500 } {
            bench.step();
            following_error = following_error.max(following(&bench));
        }
        // No pose of before the motion is commanded, whatever ends it.
        prop_assert!(kind == 0 || following_error < 0.2, "{} mm", following_error);
        let status = bench.status();
        let truth = bench.rig.truth().joints[joint];
        let is_on = truth < low - 3.0 || truth > high + 3.0;
        prop_assert!(!(is_on && status.state == State::Idle), "{:?} at {}", status, truth);
        prop_assert!(!status.homed, "{:?}", status);
        // The same command brings it off in the end, unless it is jammed.
        if kind != 0 {
            bench.rig.plant_mut().set_emergency_stop(false);
            bench.steps(100);
            if matches!(state(&bench), State::Fault | State::EmergencyStop) {
                bench.ask(Command::Reset).expect("reset");
                bench.steps(2000);
            }
            // Enable refuses a measured pose beyond the stroke; the true one differs before homing.
            let measured = f64::from(bench.status().joints[joint]) / MM;
            if measured < low || measured > high {
                bench.ask(Command::MoveOff { joint: joint as u8 }).expect("moves");
                follow(&mut bench, &[joint], upper, |_, _| ());
            }
            home(&mut bench);
            let off = error(&mut bench);
            prop_assert!(off < 0.02, "off by {}", off);
        }
    }
}
