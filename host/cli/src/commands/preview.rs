//! `haptimill preview`: one offline page with the path of a part program.

use super::args::MachineArg;
use super::program::{LanguageArgs, PartProgram};
use super::{CliError, output};
use clap::Args;
use haptimill_client::ErrorKind;
use haptimill_client::session;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_planner::Planner;
use haptimill_preview::{Joint, Preview};
use haptimill_protocol::message::AxisValues;
use std::path::PathBuf;

/// Arguments of `haptimill preview`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Write a page with the path of a part program",
    long_about = "Write a page with the path of a part program.\n\nThe command checks and plans the \
                  program, as run does. The page needs no network: the path of the tool tip in 3D, \
                  coloured by feed, rapid moves apart, with a time line; the speed over time; the \
                  extremes of the joints; stops and commands. Nothing moves."
)]
pub struct PreviewArgs {
    /// Part program (G-code)
    #[arg(value_name = "FILE")]
    pub program: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Page to write [default: the program's name with .html]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub language: LanguageArgs,
}

/// Writes the page.
///
/// # Errors
/// See [`Exit`](super::Exit).
pub fn run(args: PreviewArgs) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    let model = Model::new(&machine);
    let home = session::find_home_pose(&machine, &model)?;
    let program = PartProgram::load(&args.program, args.language)?;
    let checked = program.check(&machine, &model, &home)?;
    let preview = preview(&program, &machine, &model, &home)?;
    let page = preview.page(&program.name, &machine.config.name, &checked.figures);
    let name = PathBuf::from(&program.name).with_extension("html");
    let out = args.out.unwrap_or(name);
    output::save(&out, page)?;
    print_line!("{}", out.display());
    Ok(())
}

/// Plans a program from a pose.
///
/// # Errors
/// The program has errors, or exceeds the machine.
pub(crate) fn preview<'a>(
    program: &PartProgram,
    machine: &MachineFile,
    model: &'a Model,
    start: &AxisValues,
) -> Result<Preview<&'a Model>, CliError> {
    let options = program.options(machine, model, start)?;
    let mut planner = Planner::new(options.start, program.settings(machine), model);
    let mut preview = Preview::new(
        options.start,
        program.settings(machine),
        machine.config.model.descriptor().tool_tip_parts(),
        model,
        joints(machine),
    );
    program.for_each_step(&options, |step| {
        let done = planner.step(step);
        planner.made().for_each(|planned| preview.add(&planned));
        preview.add_step(step);
        done
    })?;
    planner
        .finish(0)
        .map_err(|problem| program.refuse(ErrorKind::Refused, problem, &[]))?;
    planner.made().for_each(|planned| preview.add(&planned));
    Ok(preview)
}

/// Names and strokes of the joints.
fn joints(machine: &MachineFile) -> Vec<Joint> {
    let joints = machine.joints.iter().zip(&machine.config.joints);
    // The second motor of a gantry moves as the first one.
    let joints = joints.filter(|(_, joint)| joint.gantry.is_none());
    joints
        .map(|(named, joint)| {
            let unit = per_unit(joint.kind);
            let end = |value: i32, infinite: f64| {
                if joint.wraps() {
                    infinite
                } else {
                    f64::from(value) / unit
                }
            };
            Joint {
                name: named.name.clone(),
                unit: if joint.kind.is_rotary() { "deg" } else { "mm" },
                low: end(joint.low.0, f64::NEG_INFINITY),
                high: end(joint.high.0, f64::INFINITY),
            }
        })
        .collect()
}
