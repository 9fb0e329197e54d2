//! Machines from changed machine files, and the position after an emergency stop.

use super::{DEGREE, MM, drives_off, jog};
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_machine_file::{BUILT_IN, MachineFile};
use haptimill_protocol::message::{Command, InputProblem, Refusal, State};
use haptimill_tests::Bench;

/// The machine file with step motors.
pub const STEP: &str = include_str!("../../../machines/h4-step.toml");

/// Creates a machine from a changed machine file, with any controller.
pub fn machine_from<C: Control>(file: &str, changes: &[(&str, &str)], control: C) -> Bench<C> {
    let mut text = file.to_string();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let machine = MachineFile::parse("changed.toml", &text).expect("sound");
    Bench::of_machine(machine, &RigOptions::default(), control)
}

/// Returns the homed machine with step motors.
pub fn step_machine(seed: u64) -> Bench {
    let seed = format!("seed = {seed}\n");
    let mut bench = machine_from(STEP, &[("seed = 1\n", &seed)], Controller::new(200));
    bench.make_ready();
    bench.steps(500);
    bench
}

/// Returns the largest difference between a measured joint and its true slide: mm, and degrees for
/// the table.
pub fn largest_error<C: Control>(bench: &mut Bench<C>) -> f64 {
    let joints = bench.status().joints;
    let off = |joint: usize| {
        let unit = if joint == 4 { DEGREE } else { MM };
        (f64::from(joints[joint]) / unit - bench.rig.truth().joints[joint]).abs()
    };
    (0..5).map(off).fold(0.0, f64::max)
}

/// Asserts: homed, no fault, and the measured joints are true within `bound` (backlash, counts,
/// wind-up of the screws).
pub fn assert_position_true<C: Control>(bench: &mut Bench<C>, bound: f64) {
    let off = largest_error(bench);
    let status = bench.status();
    assert_eq!((status.state, status.fault), (State::Idle, None));
    assert!(status.homed);
    assert!(off < bound, "off by {off}");
}

/// Opens the emergency stop circuit for some periods, resets, and enables at standstill.
pub fn emergency_stop_and_enable(bench: &mut Bench, periods: usize) {
    bench.rig.plant_mut().set_emergency_stop(true);
    bench.steps(periods);
    assert!(drives_off(bench));
    bench.rig.plant_mut().set_emergency_stop(false);
    bench.steps(5);
    bench.ask(Command::Reset).expect("reset");
    let mut enabled = bench.ask(Command::Enable);
    for _ in 0..40 {
        if enabled != Err(Refusal::Input(InputProblem::Coasting)) {
            break;
        }
        bench.steps(100);
        enabled = bench.ask(Command::Enable);
    }
    enabled.expect("enabled");
}

/// A jog in x until its timeout.
pub fn jog_in_x(bench: &mut Bench, epoch: u16, rate: f64, ms: u16) {
    bench.ask(jog(epoch, ms, &[(0, rate)])).expect("jogs");
    bench.steps(usize::from(ms) * 5 + 1500);
}

/// Returns the built-in machine with some lines of its file changed.
pub fn machine_with(changes: &[(&str, &str)]) -> Bench {
    machine_from(BUILT_IN, changes, Controller::new(200))
}

/// Configures and enables a machine.
pub fn enabled_machine(mut bench: Bench) -> Bench {
    bench.steps(500);
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    bench
}
