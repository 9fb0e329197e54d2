//! `haptimill kin`: computes the firmware's kinematics for a table.

use super::args::MachineArg;
use super::{CliError, Exit, output};
use crate::kin;
use clap::Args;
use haptimill_machine_file::input;
use std::io::Write;
use std::path::{Path, PathBuf};

const IK_LONG: &str = "\
Compute joint positions from poses (inverse kinematics): columns xw_mm, yw_mm, zw_mm, theta_deg, \
alpha_deg to l1_mm, l2_mm, l3_mm, l4_mm, status.

The status is ok, unreachable, near_singularity, near_reach_limit or tilt; only a row with ok has \
joint positions. With --strokes a row whose joints or alpha_deg exceed the strokes of the machine is \
out_of_stroke, with joint positions. An alpha_deg of 180 or more, or below -180, is out_of_stroke \
with and without --strokes, without joint positions. Columns are found by name; other columns are \
ignored. - is standard input or output.";

const FK_LONG: &str = "\
Compute poses from joint positions (forward kinematics): columns l1_mm, l2_mm, l3_mm, l4_mm to x_mm, \
y_mm, z_mm, theta_deg, status, in the frame of the machine base (before table and work offsets).

The status is ok, unreachable, near_singularity or near_reach_limit; only a row with ok has a pose. \
With --strokes a row whose joints exceed the strokes of the machine is out_of_stroke, with a pose. \
Columns are found by name; other columns are ignored. - is standard input or output.";

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
    /// Table to read
    #[arg(long = "in", value_name = "CSV", default_value = "-")]
    pub input: PathBuf,
    /// Table to write
    #[arg(long = "out", value_name = "CSV", default_value = "-")]
    pub output: PathBuf,
}

/// Slides of poses.
///
/// # Errors
/// [`Exit::BadInput`], [`Exit::Output`].
pub fn ik(args: IkArgs) -> Result<(), CliError> {
    table(&args.table, kin::inverse_table)
}

/// Poses of slides.
///
/// # Errors
/// [`Exit::BadInput`], [`Exit::Output`].
pub fn fk(args: FkArgs) -> Result<(), CliError> {
    table(&args.table, kin::forward_table)
}

type Calculation =
    fn(&haptimill_firmware::config::Config, bool, &str, &[u8]) -> Result<Vec<u8>, String>;

fn table(args: &TableArgs, calculate: Calculation) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    let standard = |path: &Path| path.as_os_str() == "-";
    if !standard(&args.input) && !standard(&args.output) {
        output::refuse_overwrite(&args.input, &args.output, "table")?;
    }
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
    let bytes = read.map_err(|error| CliError::new(Exit::BadInput, format!("{name}: {error}")))?;
    let result = calculate(&machine.config, args.strokes, &name, &bytes)
        .map_err(|message| CliError::new(Exit::BadInput, message))?;
    if standard(&args.output) {
        output::to_stdout(|out| out.write_all(&result));
        return Ok(());
    }
    let failed = |error| output::write_error(&args.output, error);
    output::write_file(&args.output, failed, |out| {
        out.write_all(&result).map_err(failed)
    })
}
