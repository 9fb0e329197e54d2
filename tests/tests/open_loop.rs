//! Joints without an encoder: the position is the count of the emitted steps, and it is lost when
//! the drives go off.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, DriveAlarm, Event, Fault, Refusal, State};
use haptimill_tests::Bench;
use setup::{MM, drives_off, line, state};

/// The mill of machines/mill3.toml, with its text changed.
fn mill(change: impl FnOnce(String) -> String) -> Bench {
    let text = change(include_str!("../../machines/mill3.toml").to_string());
    let machine = MachineFile::parse("mill3.toml", &text).unwrap_or_else(|error| panic!("{error}"));
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    bench.steps(500);
    bench.configure();
    bench
}

/// Enables and homes.
fn home(bench: &mut Bench) {
    bench.ask(Command::Enable).expect("enabled");
    home_again(bench);
}

fn home_again(bench: &mut Bench) {
    bench.events.clear();
    bench.ask(Command::Home).expect("homing");
    for _ in 0..2000 {
        bench.steps(100);
        if bench.events.contains(&Event::Homed) {
            bench.steps(500);
            return;
        }
    }
    panic!("not homed: {:?}", bench.events);
}

/// The text with joints that home by their presets.
fn without_switches(text: String) -> String {
    let mut parts = text.split("home = \"switch\"\n");
    let mut without = parts.next().expect("a part").to_string();
    for part in parts {
        let drive = part.find("[joint.drive]").expect("a drive");
        without.push_str("home = \"none\"\n\n");
        without.push_str(&part[drive..]);
    }
    without.replace("start_spread = 20.0", "start_spread = 0.0")
}

/// A homed mill in the middle of a line in x at 20 mm/s.
fn moving() -> Bench {
    let mut bench = mill(|text| text);
    home(&mut bench);
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 0, 20.0, 20));
    bench.steps(4000);
    assert_eq!(state(&bench), State::Run);
    bench
}

/// Distance of the true tool from the controller's measured pose, mm.
fn error(bench: &mut Bench) -> f64 {
    let status = bench.status();
    let truth = bench.rig.plant().truth().pose;
    let measured = status.measured.iter().zip(truth);
    let errors = measured.map(|(value, truth)| (f64::from(*value) / MM - truth).abs());
    errors.fold(0.0, f64::max)
}

fn assert_lost(bench: &mut Bench) {
    let status = bench.status();
    assert!(!status.homed, "{status:?}");
    assert!(drives_off(bench));
    let kept = bench.events.iter().rev().find_map(|event| match event {
        Event::State { homed, .. } => Some(*homed),
        _ => None,
    });
    assert_eq!(kept, Some(false), "{:?}", bench.events);
}

#[test]
fn a_job_moves_the_true_tool_and_telemetry_says_open_loop() {
    let mut bench = moving();
    assert!(bench.wait_for(State::Idle, 30_000));
    let status = bench.status();
    assert!(status.homed && status.fault.is_none());
    assert_eq!(status.open_loop, 0b111);
    // Backlash, a step and the lag of the rotor.
    let off = error(&mut bench);
    assert!(off < 0.02, "{off} mm");
}

/// The controller does not see that steps are lost. It says that it does not: telemetry has the
/// joint as open loop. Homing finds the position again, and reports what was lost.
#[test]
fn lost_steps_show_at_the_next_homing() {
    let mut bench = moving();
    let mut condition = bench.rig.plant().condition(0);
    condition.jam = f64::INFINITY;
    bench.rig.plant_mut().set_condition(0, condition);
    bench.steps(1000);
    condition.jam = 0.0;
    bench.rig.plant_mut().set_condition(0, condition);
    assert!(bench.wait_for(State::Idle, 30_000));
    assert_eq!(bench.status().open_loop, 0b111);
    let (status, truth) = (bench.status(), bench.rig.plant().truth().joints);
    let lost: Vec<f64> = (status.joints.iter().zip(truth))
        .map(|(value, truth)| truth - f64::from(*value) / MM)
        .collect();
    assert!(lost[0].abs() > 1.0, "{lost:?} mm");
    home_again(&mut bench);
    // Homing says by how much each joint was off.
    let mut shifts = [0.0; 3];
    for event in &bench.events {
        if let Event::ReferenceShift { joint, by } = event {
            shifts[usize::from(*joint)] = f64::from(*by) / MM;
        }
    }
    for (shift, lost) in shifts.iter().zip(&lost) {
        assert!((shift - lost).abs() < 0.02, "{shifts:?} for {lost:?} mm");
    }
    let off = error(&mut bench);
    assert!(off < 0.02, "{off} mm");
}

/// A joint without a switch takes its preset as its position, once: an operator has to confirm it
/// after the drives were off.
#[test]
fn a_preset_holds_until_the_drives_go_off() {
    let mut bench = mill(without_switches);
    home(&mut bench);
    let status = bench.status();
    assert!(status.homed);
    let off = error(&mut bench);
    assert!(off < 0.06, "a rotor moves to its next detent: {off} mm");
    bench.ask(Command::Disable).expect("off");
    assert_lost(&mut bench);
    bench.ask(Command::Enable).expect("on");
    assert_eq!(bench.ask(Command::Home), Err(Refusal::PresetLost));
    bench.ask(Command::Disable).expect("off");
    bench.configure_as(true);
    home(&mut bench);
    assert!(bench.status().homed);
}

#[test]
fn the_position_is_lost_with_the_drives() {
    // By command.
    let mut bench = moving();
    assert!(bench.wait_for(State::Idle, 30_000));
    bench.ask(Command::Disable).expect("off");
    assert_eq!(state(&bench), State::Disabled);
    assert_lost(&mut bench);
    bench.ask(Command::Enable).expect("on");
    let start = bench.status().commanded;
    let refused = bench.try_job(2, &line(&start, 0, 5.0, 2));
    assert_eq!(refused, Err(Refusal::NotHomed));

    // By a drive that trips in motion.
    let mut bench = moving();
    let mut condition = bench.rig.plant().condition(1);
    condition.drive_tripped = true;
    bench.rig.plant_mut().set_condition(1, condition);
    bench.steps(50);
    assert_eq!(
        bench.status().fault,
        Some(Fault::Drive {
            joint: 1,
            alarm: DriveAlarm::Input
        })
    );
    assert_lost(&mut bench);

    // By the emergency stop, as a command and as a circuit that takes the power in motion.
    let mut bench = moving();
    bench.ask(Command::EmergencyStop).expect("stopped");
    assert_lost(&mut bench);
    let mut bench = moving();
    bench.rig.plant_mut().set_emergency_stop(true);
    bench.steps(2000);
    assert_eq!(state(&bench), State::EmergencyStop);
    assert_lost(&mut bench);
}

/// A fault for which the drives hold keeps the position.
#[test]
fn the_position_is_kept_while_the_drives_hold() {
    let mut bench = moving();
    for _ in 0..10_000 {
        bench.rig.step();
    }
    let status = bench.rig.control().safety();
    assert!(matches!(status.fault(), Some(Fault::LostHost { .. })));
    assert!(status.homed() && status.drives_on());
}

/// A drive that keeps the position by its machine file.
#[test]
fn a_drive_that_holds_its_rotor_keeps_the_position() {
    let keeps = |text: String| {
        text.replace(
            "kind = \"step\"\n",
            "kind = \"step\"\nkeeps_position = true\n",
        )
    };
    let mut bench = mill(keeps);
    home(&mut bench);
    bench.ask(Command::Disable).expect("off");
    bench.steps(1000);
    let status = bench.status();
    assert!(status.homed);
    bench.ask(Command::Enable).expect("on");
    bench.steps(1000);
    let off = error(&mut bench);
    assert!(off < 0.02, "{off} mm");
    // Its alarm says that it did not hold.
    let mut condition = bench.rig.plant().condition(1);
    condition.drive_tripped = true;
    bench.rig.plant_mut().set_condition(1, condition);
    bench.steps(50);
    assert_eq!(
        bench.status().fault,
        Some(Fault::Drive {
            joint: 1,
            alarm: DriveAlarm::Input
        })
    );
    assert_lost(&mut bench);
}
