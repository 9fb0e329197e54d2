//! `haptimill offset`: the work offsets of a machine file.

use super::args::{BoardArg, ConnectArgs};
use super::board::file_of;
use super::exit::{CliError, Exit};
use super::jog::{self, CoordinateValue};
use super::probe_cycle::{kept_beside, set_origin};
use super::simple::open;
use clap::{Args, Subcommand};
use haptimill_gcode::SYSTEM_NAMES;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::work_data::{WorkData, axis_index, offsets_path, system_index};
use std::path::PathBuf;

/// Commands of `haptimill offset`.
#[derive(Debug, Clone, Subcommand)]
pub enum OffsetCommand {
    /// Print the work offsets and the tool table of a machine
    Show(ShowArgs),
    /// Set the origin of a work coordinate system, as `g54 x=12.5 y=0`, in machine coordinates
    Set(SetArgs),
    /// Set the origin such that the present position gets these coordinates, as `g54 x=0 z=2`
    Touch(TouchArgs),
}

/// Arguments of `haptimill offset touch`.
#[derive(Debug, Clone, Args)]
pub struct TouchArgs {
    /// System: g54 to g59, g59.1 to g59.3
    #[arg(value_name = "SYSTEM")]
    pub system: String,
    /// Coordinates that the present position gets, mm or degrees
    #[arg(
        value_name = "COORDINATE=VALUE",
        required = true,
        allow_negative_numbers = true
    )]
    pub values: Vec<CoordinateValue>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
}

/// Arguments of `haptimill offset show`.
#[derive(Debug, Clone, Args)]
pub struct ShowArgs {
    /// Machine file; the offsets are in a file beside it
    #[arg(long, value_name = "FILE")]
    pub machine: PathBuf,
}

/// Arguments of `haptimill offset set`.
#[derive(Debug, Clone, Args)]
pub struct SetArgs {
    /// System: g54 to g59, g59.1 to g59.3
    #[arg(value_name = "SYSTEM")]
    pub system: String,
    /// Origin in mm or degrees, as x=12.5; also rotation=DEGREES about z
    #[arg(value_name = "COORDINATE=VALUE", required = true)]
    pub values: Vec<String>,
    /// Machine file; the offsets are in a file beside it
    #[arg(long, value_name = "FILE")]
    pub machine: PathBuf,
}

fn bad(message: String) -> CliError {
    CliError::new(Exit::BadInput, message)
}

/// Runs a command.
///
/// # Errors
/// The machine file or the offsets cannot be read or written, or an argument is wrong.
pub fn run(command: OffsetCommand) -> Result<(), CliError> {
    match command {
        OffsetCommand::Show(args) => {
            let machine = MachineFile::load(&args.machine)?;
            show(&machine, &WorkData::load(&args.machine).map_err(bad)?);
            Ok(())
        }
        OffsetCommand::Set(args) => set(&args),
        OffsetCommand::Touch(args) => touch(&args),
    }
}

/// Makes the present position the place of given coordinates.
fn touch(args: &TouchArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    let mut session = open(&args.connect, &chosen.file)?;
    let machine = file_of(&chosen, &mut session)?;
    let file = kept_beside(&machine)?;
    let status = session.status()?;
    if !status.homed {
        let what = "offset touch: the machine is not homed; `haptimill home` homes it";
        return Err(CliError::new(Exit::Command, what));
    }
    let here = session.model().to_engineering_units(&status.commanded);
    let mut places = Vec::new();
    for value in &args.values {
        let axis = jog::coordinate_index(&machine, &value.coordinate)?;
        places.push((axis, here[axis] - value.value));
    }
    set_origin(&machine, &file, &args.system, &places)?;
    print_line!("{} written", offsets_path(&file).display());
    Ok(())
}

/// Returns the axes of a machine: the name of a letter, and its index in an offset.
fn axes(machine: &MachineFile) -> Vec<(char, usize)> {
    let pose = machine.config.model.descriptor().pose;
    pose.iter()
        .filter_map(|axis| {
            let index = axis_index(&axis.letter.to_string())?;
            Some((axis.letter.to_ascii_lowercase(), index))
        })
        .collect()
}

fn show(machine: &MachineFile, data: &WorkData) {
    let axes = axes(machine);
    let line = |values: &[f64; 9]| {
        let words: Vec<String> = axes
            .iter()
            .map(|(letter, index)| format!("{letter}={}", rounded(values[*index])))
            .collect();
        words.join(" ")
    };
    for (name, system) in SYSTEM_NAMES.iter().zip(&data.offsets.systems) {
        let rotation = match system.rotation {
            0.0 => String::new(),
            degrees => format!(" rotation={}", rounded(degrees)),
        };
        print_line!("{name:6}{}{rotation}", line(&system.origin));
    }
    print_line!("G28   {}", line(&data.offsets.g28));
    print_line!("G30   {}", line(&data.offsets.g30));
    for (number, tool) in &data.tools {
        print_line!(
            "T{number:<5}{} diameter={}",
            line(&tool.offset),
            rounded(tool.diameter)
        );
    }
}

/// A value to 0.1 um or 0.0001 degrees, without zeros at its end; the file has all digits.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}

fn set(args: &SetArgs) -> Result<(), CliError> {
    let usage = |message: String| CliError::new(Exit::Usage, message);
    let machine = MachineFile::load(&args.machine)?;
    let mut data = WorkData::load(&args.machine).map_err(bad)?;
    let index = system_index(&args.system).ok_or_else(|| {
        usage(format!(
            "{}: no work coordinate system; write g54 to g59, g59.1 to g59.3",
            args.system
        ))
    })?;
    let axes = axes(&machine);
    let system = &mut data.offsets.systems[index];
    for text in &args.values {
        let (name, value) = text
            .split_once('=')
            .and_then(|(name, value)| Some((name, value.parse::<f64>().ok()?)))
            .filter(|(_, value)| value.abs() <= 1e6)
            .ok_or_else(|| usage(format!("{text}: write COORDINATE=VALUE, as x=12.5")))?;
        if name == "rotation" {
            system.rotation = value;
            continue;
        }
        let axis = axes
            .iter()
            .find(|(letter, _)| name.eq_ignore_ascii_case(&letter.to_string()));
        let Some((_, axis)) = axis else {
            let letters: Vec<String> = axes.iter().map(|(letter, _)| letter.to_string()).collect();
            return Err(usage(format!(
                "there is no coordinate '{name}'; this machine has {}",
                letters.join(", ")
            )));
        };
        system.origin[*axis] = value;
    }
    data.save_offsets(&args.machine)
        .map_err(|error| CliError::new(Exit::Output, error))?;
    print_line!("{} written", offsets_path(&args.machine).display());
    Ok(())
}
