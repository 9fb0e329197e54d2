//! Named inputs and outputs on the simulated machine: probing, feed hold, door, outputs.

use crate::setup;
mod inputs;
mod outputs;
mod probing;
mod recorded;

use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::named_io::config::{ContactReaction, InputFunction};
use haptimill_hil_sim::contact::InputCondition;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{
    Action, AxisValues, Command, Event, Fault, InputProblem, OutputProblem, Refusal, State,
};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::Bench;
use setup::{MM, line, state};

const MILL: &str = include_str!("../../../machines/mill3-servo.toml");

/// Indices of the inputs in the machine file.
const PROBE: usize = 0;
const FEED_HOLD: usize = 2;
const DOOR: usize = 3;

/// Indices of the outputs.
const COOLANT: u8 = 0;
const CLAMP: u8 = 2;
const REVERSE: u8 = 3;
const LIGHT: u8 = 4;

/// Bound of the latched position against the true one, mm: the backlash that the controller assumes
/// (0.008) and that of the machine (0.005), the wind-up of the screw under friction (0.004), and
/// counts of 0.000625. The travel of a period is added to it.
const LATCH_BOUND: f64 = 0.018;

/// Returns the homed mill above its probe block: the top is at z = 0, the tool `height` above it.
fn above_block(edit: impl FnOnce(&mut MachineFile), height: f64) -> Bench {
    let mut machine = MachineFile::parse("mill3-servo.toml", MILL).expect("sound");
    edit(&mut machine);
    let period_us = machine.config.period_us;
    let options = RigOptions::default();
    let mut bench = Bench::of_machine(machine, &options, Controller::new(period_us));
    bench.make_ready();
    bench.steps(500);
    go(&mut bench, 0, 120.0);
    go(&mut bench, 1, 80.0);
    go(&mut bench, 2, height);
    bench.events.clear();
    bench
}

/// Moves one coordinate to a position, at up to 20 mm/s.
fn go(bench: &mut Bench, axis: usize, to: f64) {
    let start = bench.status().commanded;
    let way = to - f64::from(start[axis]) / MM;
    let spans = (way.abs() / 2.0).ceil() as usize;
    let speed = way / (0.1 * (spans + 1) as f64);
    bench.start_job(90, &line(&start, axis, speed, spans));
    assert!(bench.wait_for(State::Idle, 60_000));
}

fn down(bench: &mut Bench, speed: f64, spans: usize) -> Vec<Setpoint> {
    let start = bench.status().commanded;
    line(&start, 2, -speed, spans)
}

fn outputs(bench: &Bench) -> u32 {
    bench.rig.outputs().digital
}

fn is_on(bench: &Bench, output: u8) -> bool {
    let controller = bench.rig.control();
    controller.machine().expect("configured").io.outputs() >> output & 1 != 0
}

fn force(bench: &mut Bench, input: usize, level: Option<bool>) {
    let condition = InputCondition {
        level,
        bounce_hz: 0.0,
    };
    bench
        .rig
        .plant_mut()
        .inputs_mut()
        .set_condition(input, condition);
}

/// The latched coordinates of the newest contact: measured and commanded.
fn latched(bench: &Bench, coordinate: u8) -> Option<(f64, f64)> {
    bench.events.iter().find_map(|event| match event {
        Event::ProbedAt {
            coordinate: of,
            measured,
            commanded,
            ..
        } if *of == coordinate => Some((f64::from(*measured) / MM, f64::from(*commanded) / MM)),
        _ => None,
    })
}
