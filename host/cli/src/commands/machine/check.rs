//! `haptimill machine check`: lists every problem of a machine file.

use crate::commands::{CliError, Exit};
use clap::Args;
use haptimill_machine_file::pose_difference::{PoseDifference, WARNING};
use haptimill_machine_file::{AxisLimits, MachineFile, Problem};
use std::path::PathBuf;

const LONG: &str = "\
Check a machine file.

Lists every problem with its line, the value, the allowed range and the remedy. Ends with exit code \
3 when there is a problem, otherwise prints a summary of the file.

The poses of the controller and of the simulated machine are compared at the presets and over a grid \
of the soft limits, from the same joint positions. A difference above 0.01 mm or degrees is a \
warning: errors of [plant.geometry] may be intended. Above 10 mm or degrees the simulated \
machine is another one, which is a problem.";

/// Arguments of `haptimill machine check`.
#[derive(Debug, Clone, Args)]
#[command(about = "Check a machine file", long_about = LONG)]
pub struct CheckArgs {
    /// The machine file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Print JSON: a list of {file, line, column, key, what, remedy}, empty when there is no
    /// problem
    #[arg(long)]
    pub json: bool,
}

/// Checks a machine file.
///
/// # Errors
/// [`Exit::BadInput`] with every problem.
pub(super) fn run(args: CheckArgs) -> Result<(), CliError> {
    let result = MachineFile::load(&args.file);
    if args.json {
        let problems = result.as_ref().err().map_or(&[][..], |p| &p.0);
        let list: Vec<_> = problems.iter().map(as_json).collect();
        print_line!("{}", serde_json::Value::from(list));
    }
    match result {
        Ok(machine) => {
            if !args.json {
                print_line!("{}", summary(&machine).trim_end());
            }
            compare_poses(&machine, args.json)?;
        }
        Err(problems) => {
            let count = problems.count();
            let plural = if count == 1 { "" } else { "s" };
            let message = format!("{problems}\n{count} problem{plural}");
            return Err(CliError::new(Exit::BadInput, message).reported());
        }
    }
    Ok(())
}

/// Values of each coordinate in the comparison of poses.
const LEVELS: u32 = 5;

/// Compares the poses of the controller and of the simulated machine, and prints the result.
fn compare_poses(machine: &MachineFile, json: bool) -> Result<(), CliError> {
    if !machine.has_plant || machine.is_master() {
        return Ok(());
    }
    let plant = machine.plant()?;
    let Some(difference) = PoseDifference::new(machine, &plant, LEVELS) else {
        return Ok(());
    };
    if difference.is_notable() {
        eprintln!(
            "{}: warning: the simulated machine: {difference}",
            machine.file
        );
    } else if !json {
        print_line!(
            "\nthe controller and the simulated machine agree within {WARNING} mm and deg over {} \
             poses",
            difference.compared
        );
        if let Some(text) = difference.unreached(machine) {
            print_line!("{text}");
        }
    }
    Ok(())
}

fn as_json(problem: &Problem) -> serde_json::Value {
    serde_json::json!({
        "file": problem.file,
        "line": problem.line,
        "column": problem.column,
        "key": problem.key,
        "what": problem.what,
        "remedy": problem.remedy,
    })
}

/// Names the joints without an encoder, and what that means.
fn open_loop(machine: &MachineFile) -> String {
    let mut text = String::new();
    for (keeps, consequence) in [
        (false, "the position is lost whenever the drives go off"),
        (true, "the position is kept while the drives are off"),
    ] {
        let joints = machine.config.joints.iter().zip(&machine.joints);
        let names: Vec<&str> = joints
            .filter(|(joint, _)| joint.encoder.is_none() && joint.keeps_position == keeps)
            .map(|(_, axis)| axis.name.as_str())
            .collect();
        if !names.is_empty() {
            let names = names.join(", ");
            text.push_str(&format!(
                "\nopen loop: {names}: no encoder, steps are counted; lost steps are not detected, and \
                 {consequence}\n"
            ));
        }
    }
    text
}

fn summary(machine: &MachineFile) -> String {
    let config = &machine.config;
    let mut text = format!(
        "{}: no problem\n{}: control period {} us, {} pose coordinates, {} joints{}\n",
        machine.file,
        config.name,
        config.period_us,
        config.pose.len(),
        config.joints.len(),
        if machine.has_plant {
            ", with a simulated plant"
        } else {
            ""
        }
    );
    let mut table = |title: &str, axes: &[AxisLimits]| {
        text.push_str(&format!(
            "\n{title:<8} {:>10} {:>10} {:>12} {:>16}\n",
            "low", "high", "rate", "acceleration"
        ));
        for axis in axes {
            let unit = if axis.kind.is_rotary() { "deg" } else { "mm" };
            let [low, high] = if axis.wraps() {
                ["wraps".to_string(), "wraps".to_string()]
            } else {
                [axis.low, axis.high].map(|end| format!("{end} {unit}"))
            };
            text.push_str(&format!(
                "{:<8} {low:>10} {high:>10} {:>12} {:>16}\n",
                axis.name,
                format!("{} {unit}/s", axis.rate),
                format!("{} {unit}/s^2", axis.acceleration),
            ));
        }
    };
    table("pose", &machine.pose);
    table("joint", &machine.joints);
    text.push_str(&open_loop(machine));
    text
}
