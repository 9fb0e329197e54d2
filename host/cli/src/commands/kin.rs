//! `haptimill kin`: computes the firmware's kinematics for a table.

use super::args::MachineArg;
use super::{CliError, Exit, output};
use crate::kin::{Direction, GridColumn, Table};
use clap::Args;
use haptimill_client::session;
use haptimill_machine_file::input;
use std::io::Write;
use std::path::{Path, PathBuf};

const IK_LONG: &str = "\
Compute joint positions from poses (inverse kinematics). The columns are the coordinates and joints \
of the machine with their units, as x_mm, a_deg; the last column is the status. A machine with a \
singularity has a column singularity_mm, the distance from it.

The status is ok, unreachable, near_singularity, an error of the geometry (as near_reach_limit), or \
out_of_range (a number beyond the range of the controller); only a row with ok has joint positions. \
With --strokes a row whose joints exceed their strokes is out_of_stroke, with joint positions. Columns are found by name; other \
columns are ignored. - is standard input or output.

With --grid the table is computed at points of a grid, and its rows begin with the coordinates of \
the point. Coordinates without a --grid are those of the home pose.";

const FK_LONG: &str = "\
Compute poses from joint positions (forward kinematics). The columns are the joints and coordinates \
of the machine with their units, as x_mm, a_deg; the last column is the status. A machine with a \
singularity has a column singularity_mm, the distance from it.

The status is ok, unreachable, near_singularity, an error of the geometry (as near_reach_limit), or \
out_of_range (a number beyond the range of the controller); only a row with ok has a pose. With \
--strokes a row whose joints exceed their strokes is out_of_stroke, with a pose. Columns are found by name; other columns are ignored. - \
is standard input or output.

With --grid the table is computed at points of a grid, and its rows begin with the joint positions of \
the point. Joints without a --grid are at their presets.";

/// Arguments of `haptimill kin ik`.
#[derive(Debug, Clone, Args)]
#[command(about = "Compute joint positions from poses (inverse kinematics)", long_about = IK_LONG)]
pub struct IkArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub table: TableArgs,
}

/// Arguments of `haptimill kin fk`.
#[derive(Debug, Clone, Args)]
#[command(about = "Compute poses from joint positions (forward kinematics)", long_about = FK_LONG)]
pub struct FkArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub table: TableArgs,
}

/// The machine and the tables.
#[derive(Debug, Clone, Args)]
pub struct TableArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Also check the strokes of the joints
    #[arg(long)]
    pub strokes: bool,
    /// Compute the points of a grid instead of a table, as x=-100:100:50; one for each
    /// coordinate (or joint)
    #[arg(long, value_name = "NAME=LOW:HIGH:STEP", allow_hyphen_values = true)]
    #[arg(conflicts_with = "input")]
    pub grid: Vec<GridColumn>,
    /// Table to read
    #[arg(long = "in", value_name = "CSV", default_value = "-")]
    pub input: PathBuf,
    /// Table to write
    #[arg(long = "out", value_name = "CSV", default_value = "-")]
    pub output: PathBuf,
}

/// Joints of poses.
///
/// # Errors
/// [`Exit::BadInput`], [`Exit::Output`].
pub fn ik(args: IkArgs) -> Result<(), CliError> {
    table(&args.table, Direction::Inverse)
}

/// Poses of joints.
///
/// # Errors
/// [`Exit::BadInput`], [`Exit::Output`].
pub fn fk(args: FkArgs) -> Result<(), CliError> {
    table(&args.table, Direction::Forward)
}

fn table(args: &TableArgs, direction: Direction) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    session::check_has_tool(&machine)?;
    let standard = |path: &Path| path.as_os_str() == "-";
    if !standard(&args.input) && !standard(&args.output) {
        output::refuse_overwrite(&args.input, &args.output, "table")?;
    }
    let table = Table::new(&machine.config, direction, args.strokes);
    let result = if args.grid.is_empty() {
        let name = if standard(&args.input) {
            "standard input".to_string()
        } else {
            args.input.display().to_string()
        };
        let read = if standard(&args.input) {
            input::read_bounded(std::io::stdin().lock(), input::TABLE_BYTES)
        } else {
            input::read(&args.input, input::TABLE_BYTES)
        };
        let bytes =
            read.map_err(|error| CliError::new(Exit::BadInput, format!("{name}: {error}")))?;
        table.of_csv(&name, &bytes)
    } else {
        table.of_grid(&args.grid)
    };
    let result = result.map_err(|message| CliError::new(Exit::BadInput, message))?;
    if standard(&args.output) {
        output::to_stdout(|out| out.write_all(&result));
        return Ok(());
    }
    let failed = |error| output::write_error(&args.output, error);
    output::write_file(&args.output, failed, |out| {
        out.write_all(&result).map_err(failed)
    })
}
