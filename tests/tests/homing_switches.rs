//! Homing by switches: the mill of machines/mill3.toml, and its switches with every defect. Each
//! ends in a named state, with `position kept` true to the plant.

use crate::setup;
use haptimill_firmware::config::{Home, SwitchHome};
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::fault::Fault as Injected;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{
    Command, Event, Fault, HomingProblem, InputProblem, Refusal, State,
};
use haptimill_tests::Bench;
use setup::{MM, drives_off, line, state};

const MILL: &str = include_str!("../../machines/mill3.toml");

/// A mill with its text changed and faults injected, configured and enabled.
fn mill(text: &str, faults: &[&str]) -> Bench {
    mill_with_plant(text, text, faults)
}

/// As [`mill`], with the simulated machine of another text: joints that stand elsewhere.
fn mill_with_plant(text: &str, plant: &str, faults: &[&str]) -> Bench {
    let machine = MachineFile::parse("mill3.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let machine = MachineFile {
        text: plant.to_string(),
        ..machine
    };
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

/// Enables and homes; the state in which homing ends.
fn home(bench: &mut Bench) -> State {
    bench.ask(Command::Enable).expect("enabled");
    bench.ask(Command::Home).expect("homing");
    for _ in 0..2000 {
        bench.steps(100);
        if state(bench) != State::Homing {
            bench.steps(500);
            return state(bench);
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

fn assert_homed(bench: &mut Bench) {
    assert_eq!(home(bench), State::Idle, "{:?}", bench.events);
    let status = bench.status();
    assert!(status.homed, "{status:?}");
    let off = error(bench);
    println!("off by {off:.4} mm");
    assert!(off < 0.02, "{off} mm");
}

fn assert_failed(bench: &mut Bench, joint: u8, problem: HomingProblem) {
    assert_eq!(home(bench), State::Fault);
    let status = bench.status();
    assert_eq!(status.fault, Some(Fault::Homing { joint, problem }));
    assert!(!status.homed);
    assert!(drives_off(bench));
    // Nothing is left behind: it can be tried again.
    bench.ask(Command::Reset).expect("reset");
    bench.ask(Command::Enable).expect("enabled");
    assert_eq!(state(bench), State::Idle);
    let start = bench.status().commanded;
    let refused = bench.try_job(1, &line(&start, 0, 5.0, 2));
    assert_eq!(refused, Err(Refusal::NotHomed));
}

/// Text with the first occurrence of a part replaced, which must exist.
fn with(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from}");
    text.replacen(from, to, 1)
}

#[test]
fn the_switches_are_found_in_their_order() {
    let mut bench = mill(MILL, &[]);
    bench.ask(Command::Enable).expect("enabled");
    let before = bench.rig.truth().joints;
    bench.ask(Command::Home).expect("homing");
    // z first: x and y wait until it is found.
    let mut moved = [None; 3];
    let mut period = 0;
    while state(&bench) == State::Homing {
        bench.step();
        period += 1;
        for joint in 0..3 {
            if (bench.rig.truth().joints[joint] - before[joint]).abs() > 0.1 {
                moved[joint].get_or_insert(period);
            }
        }
    }
    let [x, y, z] = moved.map(|at: Option<i32>| at.expect("it moved"));
    assert!((x - y).abs() < 100 && x > z + 1000, "{moved:?}");
    bench.steps(500);
    let status = bench.status();
    assert!(status.homed);
    assert!(error(&mut bench) < 0.02);
    // Off the switches by the back-off.
    let truth = bench.rig.truth().joints;
    for (place, switch) in [(truth[0], -150.0), (truth[1], -100.0), (truth[2], 100.0)] {
        let off: f64 = place - switch;
        assert!((2.9..4.0).contains(&off.abs()), "{truth:?}");
    }
}

/// The true joints move in the order of `home_order`, whatever the order of the joints: a joint is
/// at rest off its switch before the first motion of a later one, and equal ones move together.
#[test]
fn the_order_of_the_file_is_the_order_of_motion() {
    for order in [[1, 2, 3], [3, 2, 1], [2, 3, 1], [6, 1, 1]] {
        let mut parts = MILL.split("home_order = ");
        let mut text = parts.next().expect("a beginning").to_string();
        let joints = order.iter().zip(parts);
        for (number, part) in joints {
            text.push_str(&format!("home_order = {number}{}", &part[1..]));
        }
        let mut bench = mill(&text, &[]);
        bench.ask(Command::Enable).expect("enabled");
        bench.ask(Command::Home).expect("homing");
        let mut places = vec![bench.rig.truth().joints];
        while state(&bench) == State::Homing {
            bench.step();
            places.push(bench.rig.truth().joints);
        }
        let (first, last) = (places[0], places[places.len() - 1]);
        // First and last period in which a joint is 0.1 mm from where it began and ends.
        let spans = [0, 1, 2].map(|axis| {
            let far = |from: f64| move |place: &[f64; 6]| (place[axis] - from).abs() > 0.1;
            let begin = places.iter().position(far(first[axis])).expect("it moves");
            let end = places.iter().rposition(far(last[axis])).expect("it moves");
            (begin, end)
        });
        println!("{order:?}: {spans:?}");
        for (one, other) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = match order[one] <= order[other] {
                true => (one, other),
                false => (other, one),
            };
            if order[a] == order[b] {
                assert!(
                    spans[a].0.abs_diff(spans[b].0) < 100,
                    "{order:?}: {spans:?}"
                );
            } else {
                assert!(spans[a].1 < spans[b].0, "{order:?}: {spans:?}");
            }
        }
    }
}

#[test]
fn homing_again_finds_the_same_place() {
    let mut bench = mill(MILL, &[]);
    assert_homed(&mut bench);
    let first = bench.rig.truth().joints;
    for _ in 0..3 {
        bench.ask(Command::Disable).expect("off");
        assert!(!bench.status().homed);
        assert_homed(&mut bench);
        for (joint, first) in first.iter().enumerate().take(3) {
            let off = bench.rig.truth().joints[joint] - first;
            assert!(off.abs() < 0.01, "{joint}: {off}");
        }
    }
}

/// The joints begin on their switches, and beyond them.
#[test]
fn homing_begins_from_beyond_a_switch() {
    for (x, z) in [("-150.5", "101.0"), ("-154.0", "104.5")] {
        let text = with(
            MILL,
            "preset = 0.0\nstart_spread = 20.0",
            &format!("preset = {x}\nstart_spread = 0.0"),
        );
        let text = with(
            &text,
            "preset = 50.0\nstart_spread = 20.0",
            &format!("preset = {z}\nstart_spread = 0.0"),
        );
        let mut bench = mill_with_plant(MILL, &text, &[]);
        assert_homed(&mut bench);
    }
}

#[test]
fn lost_steps_before_homing_and_a_jam_in_it() {
    // A jam that ends: steps are lost in the fast search, and the slow touch is right.
    let mut bench = mill(MILL, &["joint-jammed joint=z at=1.5s for=500ms"]);
    assert_homed(&mut bench);
    // A joint that never moves does not come to its switch.
    let mut bench = mill(MILL, &["joint-jammed joint=z"]);
    assert_failed(&mut bench, 2, HomingProblem::NoSwitch);
}

#[test]
fn a_switch_that_sticks_or_is_missing_ends_homing() {
    for fault in [
        "switch-missing joint=x switch=home",
        "switch-stuck joint=x switch=home active=no",
    ] {
        let mut bench = mill(MILL, &[fault]);
        assert_failed(&mut bench, 0, HomingProblem::NoSwitch);
    }
    // Closed from the start; and closed when it was pressed, in the middle of homing.
    for fault in [
        "switch-stuck joint=z switch=home active=yes",
        "switch-stuck joint=z switch=home active=yes at=1.2s",
        "switch-inverted joint=z switch=home",
    ] {
        let mut bench = mill(MILL, &[fault]);
        assert_failed(&mut bench, 2, HomingProblem::SwitchStuck);
        // It did not run to the other end of its stroke.
        let z = bench.rig.truth().joints[2];
        assert!(z > 20.0, "{fault}: {z}");
    }
    // It closes again while the joint moves off.
    let mut bench = mill(MILL, &["switch-stuck joint=z switch=home active=yes at=3s"]);
    assert_failed(&mut bench, 2, HomingProblem::SwitchUnsteady);
}

#[test]
fn a_contact_that_bounces_is_found() {
    let mut bench = mill(MILL, &["switch-bounces joint=x switch=home ms=8"]);
    assert_homed(&mut bench);
}

/// A contact that is active at a low level, and one that is wired so without the machine file
/// saying it.
#[test]
fn the_active_level_is_configured() {
    let low = MILL.replace(
        "home = \"switch\"\n",
        "home = \"switch\"\nhome_active = \"low\"\n",
    );
    let mechanics = "kind = \"linear\"               # mm, N, kg\n";
    assert!(low.contains(mechanics));
    let wired = low.replace(mechanics, &format!("{mechanics}active_low = [\"home\"]\n"));
    let mut bench = mill(&wired, &[]);
    assert_homed(&mut bench);
    // A machine that is wired for the other level.
    let mut bench = mill_with_plant(&wired, &low, &[]);
    assert_failed(&mut bench, 2, HomingProblem::SwitchStuck);
    // The line of a contact that opens is low when its cable breaks: it is found active.
    let mut bench = mill(&wired, &["switch-missing joint=z switch=home"]);
    assert_failed(&mut bench, 2, HomingProblem::SwitchStuck);
}

/// The limit switch of x serves as its home switch: no fault until it has homed, one afterwards.
#[test]
fn a_limit_switch_serves_as_home_switch() {
    let text = with(
        MILL,
        "at_mm = -150.0\n",
        "at_mm = -152.0\ninput = \"limit_low\"\n",
    );
    let text = with(
        &text,
        "high = 160.0\n",
        "high = 160.0\nlimit_low = -152.0\n",
    );
    let mut bench = mill(&text, &[]);
    assert_homed(&mut bench);
    let mut condition = bench.rig.plant().condition(0);
    condition.switches[1].stuck = Some(true);
    bench.rig.plant_mut().set_condition(0, condition);
    bench.steps(50);
    assert_eq!(bench.status().fault, Some(Fault::LimitSwitch { joint: 0 }));
    assert!(!bench.status().homed);
    // Beyond it the drives come on, and homing moves off.
    condition.switches[1].stuck = None;
    bench.rig.plant_mut().set_condition(0, condition);
    bench.ask(Command::Reset).expect("reset");
    let beyond = with(
        &text,
        "preset = 0.0\nstart_spread = 20.0",
        "preset = -153.0\nstart_spread = 0.0",
    );
    let mut bench = mill_with_plant(&text, &beyond, &[]);
    assert_homed(&mut bench);
    // The other limit stays one.
    let text = with(&text, "high = 160.0\n", "high = 160.0\nlimit_high = 10.0\n");
    let stuck = mill(
        &text,
        &["switch-stuck joint=x switch=limit-high active=yes"],
    )
    .ask(Command::Enable);
    assert_eq!(
        stuck,
        Err(Refusal::Input(InputProblem::LimitSwitch { joint: 0 }))
    );
}

/// A stop, a lost host and a loss of power in the middle of homing.
#[test]
fn homing_is_interrupted() {
    let middle = || {
        let mut bench = mill(MILL, &[]);
        bench.ask(Command::Enable).expect("enabled");
        bench.ask(Command::Home).expect("homing");
        bench.steps(5000);
        assert_eq!(state(&bench), State::Homing);
        bench
    };
    let mut bench = middle();
    bench.ask(Command::Stop).expect("stopped");
    assert!(bench.wait_for(State::Idle, 5000));
    let status = bench.status();
    assert!(!status.homed && status.fault.is_none());
    assert_eq!(bench.ask(Command::Home), Ok(()));
    while state(&bench) == State::Homing {
        bench.step();
    }
    bench.steps(500);
    assert!(bench.status().homed);
    assert!(error(&mut bench) < 0.02);

    let mut bench = middle();
    for _ in 0..10_000 {
        bench.rig.step();
    }
    let safety = bench.rig.control().safety();
    assert!(matches!(safety.fault(), Some(Fault::LostHost { .. })));
    assert!(!safety.homed());

    let mut bench = middle();
    bench.rig.plant_mut().set_emergency_stop(true);
    bench.steps(1000);
    assert_eq!(state(&bench), State::EmergencyStop);
    bench.rig.plant_mut().set_emergency_stop(false);
    bench.ask(Command::Reset).expect("reset");
    assert_homed(&mut bench);
    assert!(bench.events.contains(&Event::Homed));
}

/// With an encoder the index pulse next to the switch counts.
/// The servo mill with home switches beside the index pulses.
fn servo_with_switches() -> String {
    let servo = include_str!("../../machines/mill3-servo.toml");
    let switch = |towards: &str, at: f64| {
        format!(
            "home = \"switch_and_index\"\n\n[joint.switch]\ntowards = \"{towards}\"\nat_mm = {at}\n\
             rate_mm_s = 20.0\ntouch_rate_mm_s = 1.0\nback_off_mm = 3.0\n\n[joint.drive]\nkind = \"torque\""
        )
    };
    let mut text = String::new();
    let mut parts = servo.split("\n[joint.drive]\nkind = \"torque\"");
    text.push_str(parts.next().expect("a part"));
    for (part, (towards, at)) in parts.zip([("down", -150.0), ("down", -100.0), ("up", 100.0)]) {
        text.push_str(&switch(towards, at));
        text.push_str(part);
    }
    let start = text.find("# Search for the index").expect("homing");
    let end = text.find("# The simulated machine.").expect("plant");
    text.replace_range(start..end, "");
    // The switches of the plant are 0.4 mm off: the index pulses decide.
    let homes = [
        "at = -150.4, active = \"below\"",
        "at = -99.6, active = \"below\"",
        "at = 100.4, active = \"above\"",
    ];
    let mut parts = text.split("\nencoder = {");
    let mut with_homes = parts.next().expect("a part").to_string();
    for (part, home) in parts.zip(homes) {
        with_homes.push_str(&format!("\nhome = {{ {home} }}\nencoder = {{{part}"));
    }
    with_homes.replace("start_spread = 0.3", "start_spread = 20.0")
}

#[test]
fn switch_and_index_on_servo_joints() {
    let text = servo_with_switches();
    let mut bench = mill(&text, &[]);
    assert_homed(&mut bench);
    let mut bench = mill(&text, &["index-missing joint=y"]);
    assert_failed(&mut bench, 1, HomingProblem::NoIndex);
}

/// A configuration with another reference: coordinates of the one before say nothing about it.
#[test]
fn another_home_coordinate_or_side_loses_the_position() {
    type Change = fn(&mut SwitchHome);
    let changes: [Change; 3] = [
        |home| home.coordinate.0 += 5 << 20,
        |home| home.downwards = !home.downwards,
        |home| home.rate.0 /= 2,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut bench = mill(&servo_with_switches(), &[]);
        assert_homed(&mut bench);
        bench.ask(Command::Disable).expect("off");
        let home = &mut bench.machine.config.joints[0].home;
        let (Home::Switch(search) | Home::SwitchAndIndex(search)) = home else {
            panic!("{home:?}");
        };
        change(search);
        // The drives are locked for some periods after they went off.
        bench.steps(2000);
        bench.configure();
        // The rate of the search does not change what a coordinate means.
        let is_kept = number == 2;
        let status = bench.status();
        assert_eq!(status.homed, is_kept, "change {number}");
    }
}
