//! Gantries: two step motors on the beam of machines/router3.toml, squared by their two switches.
//! Each defect ends in a named state, with `position kept` true to the plant.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::fault::Fault as Injected;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{
    Command, DriveAlarm, Event, Fault, HomingProblem, Refusal, State,
};
use haptimill_tests::Bench;
use setup::{MM, drives_off, line, state};

const ROUTER: &str = include_str!("../../machines/router3.toml");

/// Joints of the two motors.
const FIRST: usize = 1;
const SECOND: usize = 3;

/// Largest racking of the machine file, mm.
const LARGEST: f64 = 4.0;

/// Largest racking of a beam that is square: the hysteresis of nothing, a step, and what friction
/// and the beam leave between rotor and field, mm.
const SQUARE: f64 = 0.02;

fn router(text: &str, faults: &[&str]) -> Bench {
    let machine =
        MachineFile::parse("router3.toml", text).unwrap_or_else(|error| panic!("{error}"));
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

/// The router with its beam off square at power-on, mm.
fn racked(by: f64) -> String {
    assert!(ROUTER.contains("racked = 1.5"));
    ROUTER.replace("racked = 1.5", &format!("racked = {by:?}"))
}

/// The router with encoders on both motors of the beam.
fn with_encoders(text: &str) -> String {
    let motors = text
        .split_inclusive("[[joint]]\n")
        .map(|part| match part.starts_with("name = \"y") {
            true => part
                .replacen(
                    "lead_mm = 5.0\n",
                    "lead_mm = 5.0\ncounts_per_turn = 4000\ndirection = 1\nfollowing_error_mm = 0.5\n\
                     following_error_lag_ms = 5.0\nencoder_stuck_mm = 0.1\nindex_mm = 0.0\n\
                     search_mm = 2.0\n",
                    1,
                )
                .replacen("kind = \"step\"\n", "kind = \"step\"\nlost_mm = 0.2\n", 1),
            false => part.to_string(),
        })
        .collect::<String>();
    let motors = motors.replace(
        "heartbeat_ms = 500 ",
        "illegal_transitions = 4\nheartbeat_ms = 500 ",
    );
    let mut parts = motors.split_inclusive("[[plant.joint]]\n");
    let mut text = parts.next().expect("a part").to_string();
    for part in parts {
        let with = "encoder = { counts_per_turn = 4000, index = 0.0 }\n\n[plant.joint.drive.steps]";
        text.push_str(&match part.starts_with("name = \"y") {
            true => part.replacen("[plant.joint.drive.steps]", with, 1),
            false => part.to_string(),
        });
    }
    text
}

/// True racking, mm.
fn racking(bench: &Bench) -> f64 {
    let truth = bench.rig.plant().truth().joints;
    truth[SECOND] - truth[FIRST]
}

/// Enables and homes; the state in which homing ends, and the largest true racking on the way.
fn home(bench: &mut Bench) -> (State, f64) {
    bench.events.clear();
    bench.ask(Command::Enable).expect("enabled");
    bench.ask(Command::Home).expect("homing");
    let mut largest = 0.0_f64;
    for _ in 0..200_000 {
        bench.step();
        largest = largest.max(racking(bench).abs());
        if state(bench) != State::Homing {
            bench.steps(500);
            return (state(bench), largest);
        }
    }
    panic!("homing does not end: {:?}", bench.events);
}

/// Largest distance of a true joint from the measured one, mm.
fn error(bench: &mut Bench) -> f64 {
    let status = bench.status();
    let truth = bench.rig.plant().truth().joints;
    let joints = status.joints.iter().zip(truth);
    let errors = joints.map(|(value, truth)| (f64::from(*value) / MM - truth).abs());
    errors.fold(0.0, f64::max)
}

fn assert_square(bench: &mut Bench) {
    let status = bench.status();
    assert!(status.homed, "{status:?}");
    assert_eq!(status.joints.len(), 4);
    assert_eq!(status.commanded.len(), 3);
    let (racking, off) = (racking(bench), error(bench));
    println!("racking {racking:.4} mm, joints off by {off:.4} mm");
    assert!(racking.abs() < SQUARE, "{racking} mm");
    assert!(off < 0.02, "{off} mm");
}

fn assert_lost(bench: &mut Bench) {
    let status = bench.status();
    assert!(!status.homed, "{status:?}");
    assert!(drives_off(bench));
    bench.ask(Command::Reset).expect("reset");
    bench.ask(Command::Enable).expect("enabled");
    let start = bench.status().commanded;
    let refused = bench.try_job(9, &line(&start, 0, 5.0, 2));
    assert_eq!(refused, Err(Refusal::NotHomed));
    bench.ask(Command::Disable).expect("disabled");
}

/// The racking fault, mm.
fn racking_fault(bench: &mut Bench) -> f64 {
    match bench.status().fault {
        Some(Fault::Racking { joint: 3, by }) => f64::from(by) / MM,
        other => panic!("{other:?}"),
    }
}

fn squared(bench: &Bench) -> f64 {
    let by = bench.events.iter().find_map(|event| match event {
        Event::Squared { joint: 3, by } => Some(f64::from(*by) / MM),
        _ => None,
    });
    by.expect("squared")
}

fn shifts(bench: &Bench) -> Vec<(u8, f64)> {
    let events = bench.events.iter().filter_map(|event| match event {
        Event::ReferenceShift { joint, by } => Some((*joint, f64::from(*by) / MM)),
        _ => None,
    });
    events.collect()
}

/// Jams a motor for 0.2 s in motion: it loses steps, by whole electrical turns.
fn lose_steps(bench: &mut Bench, joint: usize) {
    let mut condition = bench.rig.plant().condition(joint);
    condition.jam = f64::INFINITY;
    bench.rig.plant_mut().set_condition(joint, condition);
    bench.steps(1000);
    condition.jam = 0.0;
    bench.rig.plant_mut().set_condition(joint, condition);
}

#[test]
fn homing_squares_a_beam_and_says_by_how_much() {
    for by in [-3.0, -1.5, 0.0, 1.5, 3.0] {
        let mut bench = router(&racked(by), &[]);
        let before = racking(&bench);
        assert!((before - by).abs() < 0.1, "{before}");
        let (ended, largest) = home(&mut bench);
        assert_eq!(ended, State::Idle, "{by}: {:?}", bench.events);
        assert_square(&mut bench);
        assert!(largest < by.abs() + 0.5, "{by}: {largest}");
        let moved = racking(&bench) - before;
        let said = squared(&bench);
        assert!((said - moved).abs() < 0.05, "{by}: {said} for {moved}");
        // Nothing was known before, so nothing was shifted.
        assert_eq!(shifts(&bench), []);
    }
}

/// The switches are at different places of their ends: the machine file has their places.
#[test]
fn the_places_of_the_switches_make_a_beam_square() {
    let (place, true_place) = ("at_mm = -100.0", "home = { at = -100.0");
    let second = ROUTER.rfind(place).expect("the second motor");
    let mut text = ROUTER.to_string();
    text.replace_range(second..second + place.len(), "at_mm = -98.7");
    let second = text.rfind(true_place).expect("its switch");
    text.replace_range(second..second + true_place.len(), "home = { at = -98.7");
    let mut bench = router(&text, &[]);
    assert_eq!(home(&mut bench).0, State::Idle);
    bench.steps(10_000);
    assert_square(&mut bench);
}

#[test]
fn both_motors_move_alike() {
    let mut bench = router(ROUTER, &[]);
    home(&mut bench);
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 1, 40.0, 20));
    let mut largest = 0.0_f64;
    let mut travelled = false;
    while state(&bench) != State::Idle {
        bench.step();
        largest = largest.max(racking(&bench).abs());
        let machine = bench.rig.control().machine().expect("configured");
        let target = machine.target();
        assert_eq!(target.rates[FIRST], target.rates[SECOND]);
        travelled |= target.rates[FIRST].0 > (39.0 * MM) as i32;
    }
    assert!(travelled && largest < 0.05, "{largest} mm");
    let (status, truth) = (bench.status(), bench.rig.plant().truth().pose);
    let off = f64::from(status.measured[1]) / MM - truth[1];
    assert!(off.abs() < 0.02, "{off} mm");
    assert_square(&mut bench);
}

/// A motor without an encoder loses steps unseen. The next homing says by how much, and squares the
/// beam again.
#[test]
fn lost_steps_of_one_motor_are_reported_at_the_next_homing() {
    for motor in [FIRST, SECOND] {
        let mut bench = router(ROUTER, &[]);
        home(&mut bench);
        let start = bench.status().commanded;
        bench.start_job(1, &line(&start, 1, 10.0, 10));
        bench.steps(2000);
        lose_steps(&mut bench, motor);
        assert!(bench.wait_for(State::Idle, 30_000));
        let lost = racking(&bench);
        let behind = if motor == FIRST { -lost } else { lost };
        assert!((-3.9..-1.0).contains(&behind), "{motor}: {behind} mm");
        bench.events.clear();
        bench.ask(Command::Home).expect("homing");
        assert!(bench.wait_for(State::Idle, 200_000));
        bench.steps(500);
        assert_square(&mut bench);
        let shift = |joint: usize| -> f64 {
            let shifts = shifts(&bench).into_iter();
            shifts
                .filter(|it| usize::from(it.0) == joint)
                .map(|it| it.1)
                .sum()
        };
        assert!((shift(motor) - behind).abs() < 0.05, "{:?}", bench.events);
        let other = FIRST + SECOND - motor;
        assert!(shift(other).abs() < 0.02, "{:?}", bench.events);
        assert!((squared(&bench) + lost).abs() < 0.05, "{:?}", bench.events);
    }
}

/// A defect of one switch never racks the beam by more than the machine file allows.
#[test]
fn a_defect_of_one_switch_stops_both_motors() {
    for fault in [
        "switch-missing joint=y switch=home",
        "switch-missing joint=y2 switch=home",
        "switch-stuck joint=y switch=home active=yes",
        "switch-stuck joint=y2 switch=home active=yes",
        "switch-inverted joint=y switch=home",
        "switch-inverted joint=y2 switch=home",
    ] {
        for by in [-1.5, 1.5] {
            let mut bench = router(&racked(by), &[fault]);
            let (ended, largest) = home(&mut bench);
            assert_eq!(ended, State::Fault, "{fault}: {:?}", bench.events);
            let off = racking_fault(&mut bench);
            println!("{fault}, {by} mm: {off:.3} mm, true {largest:.3} mm");
            assert!(off.abs() > LARGEST && off.abs() < LARGEST + 0.01, "{off}");
            assert!(largest < LARGEST + by.abs() + 0.1, "{fault}: {largest}");
            assert_lost(&mut bench);
        }
    }
}

/// Without both switches the controller cannot detect that the beam is at its end.
#[test]
fn a_beam_without_switches_is_a_missing_switch() {
    let both = [
        "switch-missing joint=y switch=home",
        "switch-missing joint=y2 switch=home",
    ];
    let mut bench = router(ROUTER, &both);
    assert_eq!(home(&mut bench).0, State::Fault);
    let fault = bench.status().fault;
    let problem = HomingProblem::NoSwitch;
    assert_eq!(fault, Some(Fault::Homing { joint: 1, problem }));
    assert_lost(&mut bench);
}

#[test]
fn switches_that_bounce_square_the_beam() {
    let mut bench = router(ROUTER, &["switch-bounces joint=y2 switch=home ms=8"]);
    assert_eq!(home(&mut bench).0, State::Idle, "{:?}", bench.events);
    assert_square(&mut bench);
}

/// Homing from beyond both switches, from beyond one of them, and from their edges.
#[test]
fn a_beam_on_its_switches_moves_off_them_first() {
    for (start, by) in [(-103.0, 0.0), (-99.0, -1.5), (-101.0, 1.5), (-100.0, 0.3)] {
        let text = racked(by).replace("start_spread = 20.0", "start_spread = 0.0");
        let mut parts = text.split_inclusive("[[plant.joint]]\n");
        let mut moved = parts.next().expect("a part").to_string();
        for part in parts {
            moved.push_str(&match part.starts_with("name = \"y") {
                true => part.replacen("preset = 0.0", &format!("preset = {start:?}"), 1),
                false => part.to_string(),
            });
        }
        let machine = MachineFile::parse("router3.toml", ROUTER).expect("the router");
        let machine = MachineFile {
            text: moved,
            ..machine
        };
        let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
        bench.steps(500);
        bench.configure();
        let (ended, largest) = home(&mut bench);
        assert_eq!(ended, State::Idle, "{start}: {:?}", bench.events);
        assert!(largest < by.abs() + 0.5, "{start}: {largest}");
        assert_square(&mut bench);
    }
}

#[test]
fn a_beam_racked_by_more_than_allowed_is_not_squared() {
    for by in [-6.0, 6.0] {
        // So soft a beam stays racked by the friction of its ends.
        let soft = racked(by).replace("racking_stiffness = 10.0", "racking_stiffness = 2.0");
        let mut bench = router(&soft, &[]);
        let (ended, largest) = home(&mut bench);
        assert_eq!(ended, State::Fault);
        racking_fault(&mut bench);
        assert!(largest < by.abs() + 0.5, "{largest}");
        assert_lost(&mut bench);
    }
}

/// Stop, emergency stop and a drive that trips, in the search and in motion.
#[test]
fn both_motors_stop_together() {
    for period in [500, 20_000, 40_000, 60_000] {
        for stop in [Command::Stop, Command::EmergencyStop] {
            let mut bench = router(ROUTER, &[]);
            bench.ask(Command::Enable).expect("enabled");
            bench.ask(Command::Home).expect("homing");
            bench.steps(period);
            if state(&bench) != State::Homing {
                continue;
            }
            bench.ask(stop.clone()).expect("stopped");
            bench.steps(3000);
            assert!(racking(&bench).abs() < LARGEST, "{}", racking(&bench));
            let status = bench.status();
            assert!(!status.homed);
        }
    }
    for motor in [FIRST, SECOND] {
        let mut bench = router(ROUTER, &[]);
        home(&mut bench);
        let start = bench.status().commanded;
        bench.start_job(1, &line(&start, 1, 20.0, 20));
        bench.steps(4000);
        let mut condition = bench.rig.plant().condition(motor);
        condition.drive_tripped = true;
        bench.rig.plant_mut().set_condition(motor, condition);
        bench.steps(2000);
        let joint = motor as u8;
        assert_eq!(
            bench.status().fault,
            Some(Fault::Drive {
                joint,
                alarm: DriveAlarm::Input
            })
        );
        assert!(racking(&bench).abs() < LARGEST);
        condition.drive_tripped = false;
        bench.rig.plant_mut().set_condition(motor, condition);
        assert_lost(&mut bench);
        assert_eq!(home(&mut bench).0, State::Idle, "{:?}", bench.events);
        assert_square(&mut bench);
    }
}

/// With encoders a motor that loses steps is seen at once.
#[test]
fn motors_with_encoders_that_disagree_are_a_fault() {
    let text = with_encoders(ROUTER);
    let mut bench = router(&text, &[]);
    assert_eq!(home(&mut bench).0, State::Idle, "{:?}", bench.events);
    assert_square(&mut bench);
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 1, 10.0, 10));
    bench.steps(2000);
    lose_steps(&mut bench, SECOND);
    let fault = bench.status().fault;
    assert!(
        matches!(
            fault,
            Some(Fault::StepsLost { joint: 3, .. } | Fault::EncoderStuck { joint: 3 })
        ),
        "{fault:?}"
    );
    assert_lost(&mut bench);
}

/// One end is pushed by hand while the drives are off. The encoders see it, so the beam is not
/// taken for square when the drives are switched on again.
#[test]
fn a_beam_that_was_pushed_off_square_is_found_when_the_drives_go_on() {
    let text = with_encoders(ROUTER).replace("racking_mm = 4.0", "racking_mm = 1.0");
    // The others stay where they are without their drives.
    let keeps = "kind = \"step\"\nkeeps_position = true\nsteps";
    let text = text.replace("kind = \"step\"\nsteps", keeps);
    let mut bench = router(&text.replace("racked = 1.5", "racked = 0.5"), &[]);
    assert_eq!(home(&mut bench).0, State::Idle, "{:?}", bench.events);
    bench.ask(Command::Disable).expect("off");
    // 200 N for as long as it takes to move the end by 1.5 mm.
    bench.rig.plant_mut().set_load(SECOND, 200.0);
    while racking(&bench) < 1.5 {
        bench.step();
    }
    bench.rig.plant_mut().set_load(SECOND, -60.0);
    bench.steps(500);
    bench.rig.plant_mut().set_load(SECOND, 0.0);
    bench.steps(3000);
    let by = racking(&bench);
    assert!(by.abs() > 1.1, "the test does not rack the beam: {by}");
    assert!(bench.status().homed, "{:?}", bench.status());
    bench.ask(Command::Enable).ok();
    bench.steps(2000);
    let found = racking_fault(&mut bench);
    assert!((found - by).abs() < 0.1, "{found} for {by}");
    assert_lost(&mut bench);
}
