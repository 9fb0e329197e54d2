//! Volumetric compensation in a fault that leaves the drives on: the tool stays at its place. A
//! changed value of the error tables is found while the machine runs.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::Inputs;
use haptimill_firmware::machine::Machine;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, State};
use haptimill_tests::Bench;
use setup::{drives_off, jog, line, state};

const MILL: &str = include_str!("../../machines/vmc3.toml");
const ERRORS: &str = include_str!("../../host/volumetric/data/vmc3_errors.csv");

fn mill() -> MachineFile {
    let machine = MachineFile::parse("machines/vmc3.toml", MILL).expect("sound");
    machine
        .with_errors("vmc3_errors.csv", ERRORS, "wYbXZt")
        .expect("sound tables")
}

/// The integrity check covers each value of the tables, their scale and the squareness errors.
#[test]
fn a_changed_error_table_is_found() {
    // More than the digest parts of a machine.
    const PERIODS: usize = 100;
    let config = mill().config;
    let number = config.volumetric.as_ref().expect("tables").values.len();
    assert!(number > 200, "{number}");
    let mut machine = Machine::new(config, 0, &Inputs::default()).expect("sound");
    let is_sound = |machine: &mut Machine| (0..PERIODS).all(|_| machine.check_next_digest());
    assert!(is_sound(&mut machine));
    for place in 0..number + 4 {
        let sound = machine.config.volumetric.clone();
        let tables = machine.config.volumetric.as_mut().expect("tables");
        match place.checked_sub(number) {
            None => tables.values[place] ^= 1,
            Some(3) => tables.shift += 1,
            Some(axis) => tables.squareness[axis] += 1,
        }
        assert!(!is_sound(&mut machine), "place {place}");
        machine.config.volumetric = sound;
    }
    assert!(is_sound(&mut machine));
}

#[test]
fn the_correction_stays_while_a_fault_holds_the_tool() {
    let mut bench = Bench::of_machine(mill(), &RigOptions::default(), Controller::new(200));
    bench.steps(500);
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    bench.ask(Command::Home).expect("homing");
    assert!(bench.wait_for(State::Idle, 400_000), "{:?}", bench.events);
    for _ in 0..10 {
        bench.send(jog(1, 200, &[(0, 20.0), (1, -20.0)]));
        bench.steps(500);
    }
    bench.steps(6000);
    assert_eq!(bench.status().compensation(), Some(100));
    let start = bench.status().commanded;
    bench.start_job(1, &line(&start, 0, 5.0, 100));
    bench.steps(2000);
    // The host is silent. The machine decelerates; a fade would take a second longer.
    let target = |bench: &Bench| {
        let machine = bench.rig.control().machine().expect("configured");
        let still = state(bench) == State::Fault && machine.motion.is_at_standstill();
        still.then_some(machine.target().joints)
    };
    let mut held = None;
    for _ in 0..10_000 {
        bench.rig.step();
        held = held.or_else(|| target(&bench));
        if held.is_some() {
            assert_eq!(target(&bench), held);
        }
    }
    assert!(held.is_some(), "{:?}", state(&bench));
    let before = bench.rig.truth().pose;
    for _ in 0..20_000 {
        bench.rig.step();
    }
    assert_eq!(target(&bench), held);
    assert!(!drives_off(&bench));
    let after = bench.rig.truth().pose;
    let change = (0..3).map(|axis| (after[axis] - before[axis]).abs());
    let moved = change.fold(0.0, f64::max);
    // The errors at this place are several micrometres.
    assert!(moved < 1e-4, "{moved} mm");
    assert_eq!(bench.status().compensation(), Some(100));
}
