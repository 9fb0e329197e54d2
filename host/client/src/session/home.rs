//! From wherever the search for the references ends to the home pose.

use super::{Line, Session, Unwatched};
use crate::{Error, ErrorKind};

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::AxisValues;

/// That the machine moves a tool.
///
/// # Errors
/// It is a haptic arm alone.
pub fn has_tool(machine: &MachineFile) -> Result<(), Error> {
    if !machine.is_master() {
        return Ok(());
    }
    let what = format!(
        "{}: a haptic arm alone, which has no tool to move; name a machine with --machine, and the arm with --master of `haptimill teleop`",
        machine.file
    );
    Err(Error::new(ErrorKind::BadInput, what))
}

/// The pose at the home preset.
///
/// # Errors
/// There is none: the machine has no tool, or no pose at its presets.
pub fn home_of(machine: &MachineFile, model: &Model) -> Result<AxisValues, Error> {
    has_tool(machine)?;
    model.home(machine).ok_or_else(|| {
        let what = format!(
            "{}: no pose has the joints at their presets; correct the presets",
            machine.file
        );
        Error::new(ErrorKind::BadInput, what)
    })
}

/// The host's number of the job that goes to the home pose.
const HOME_JOB: u32 = 1;

/// A straight move between two poses, in axis units: at a feed, mm/min or deg/min, or rapid.
pub fn way(
    machine: &MachineFile,
    model: &Model,
    from: &AxisValues,
    to: &AxisValues,
    feed: Option<f64>,
) -> Result<Plan, Error> {
    let options = program_options(machine, model.to_engineering_units(from));
    // Ten decimals: far below an axis unit, so the end is the wanted one to the last bit.
    let words: String = options
        .axes
        .iter()
        .zip(model.to_engineering_units(to))
        .map(|(axis, value)| format!(" {}{value:.10}", axis.letter))
        .collect();
    let name = "the way";
    let block = match feed {
        Some(feed) => format!("G1 F{feed:.6}{words}\n"),
        None => format!("G0{words}\n"),
    };
    let program = haptimill_gcode::read(name, block.as_bytes(), &options)
        .map_err(|refused| Error::new(ErrorKind::Internal, refused))?;
    Plan::new(&program, &settings(machine), model)
        .map_err(|refused| Error::new(ErrorKind::Refused, refused))
}

impl<L: Line> Session<L> {
    /// Finds the references, then goes to the home pose: the pose of the presets, of which every program can rely.
    ///
    /// # Errors
    /// As [`Session::home`], when the way is refused, and when its end is [not reached](Session::well_ended).
    pub fn go_home(&mut self, machine: &MachineFile, home: &AxisValues) -> Result<(), Error> {
        self.home()?;
        let here = self.status()?.commanded;
        let plan = way(machine, &self.model, &here, home, None)?;
        let end = self.run_job(HOME_JOB, here, plan.setpoints, &mut Unwatched)?;
        self.well_ended(&end)
    }
}
