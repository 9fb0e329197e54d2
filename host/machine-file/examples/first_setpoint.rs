//! Prints the CPU time from the start of the process to the first setpoint of a streamed program on
//! the built-in machine, with its start at X0 Y0 Z30 (Linux).
//!
//! `cargo run -p haptimill-machine-file --example first_setpoint FILE`

use haptimill_gcode::Interpreter;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Planner;
use std::fs::File;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("name a part program")?;
    let machine = MachineFile::built_in().map_err(|problems| format!("{problems:?}"))?;
    let start = [0.0, 0.0, 30.0, 0.0, 0.0, 0.0];
    let options = program_options(&machine, start);
    let mut planner = Planner::new(start, settings(&machine), Model::new(&machine));
    let mut steps = 0u32;
    for step in Interpreter::new(File::open(path)?, &options) {
        let text =
            |problem: haptimill_gcode::Problem| format!("{}: {}", problem.what, problem.remedy);
        planner.step(&step.map_err(text)?).map_err(text)?;
        steps += 1;
        if planner.made().next().is_some() {
            break;
        }
    }
    // The first value is the time on a CPU in nanoseconds.
    let schedule = std::fs::read_to_string("/proc/self/schedstat")?;
    let cpu: f64 = schedule.split(' ').next().unwrap_or("0").parse()?;
    println!(
        "first setpoint after {steps} steps, {:.3} CPU s",
        cpu * 1e-9
    );
    Ok(())
}
