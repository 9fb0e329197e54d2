//! The move from the reference position to the home pose.

use super::force::force_axes;
use super::{Line, NoObserver, Session};
use crate::{Error, ErrorKind};

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::AxisValues;

/// Checks that the machine has a tool.
///
/// # Errors
/// The machine file describes a haptic arm alone.
pub fn check_has_tool(machine: &MachineFile) -> Result<(), Error> {
    if !machine.is_master() {
        return Ok(());
    }
    let what = format!(
        "{}: a haptic arm alone has no tool to move; give a machine with --machine, \
         and the arm with --master of `haptimill teleop`",
        machine.file
    );
    Err(Error::new(ErrorKind::BadInput, what))
}

/// The pose at the home preset.
///
/// # Errors
/// The machine has no tool, or its presets are not reachable by any pose.
pub fn find_home_pose(machine: &MachineFile, model: &Model) -> Result<AxisValues, Error> {
    check_has_tool(machine)?;
    model.home(machine).ok_or_else(|| {
        let what = format!(
            "{}: no pose has the joints at their presets; correct the presets",
            machine.file
        );
        Error::new(ErrorKind::BadInput, what)
    })
}

/// The host's number of the job that moves to the home pose.
pub const HOME_JOB: u32 = 1;

/// Plans a straight move between two poses in axis units, at a feed, mm/min or deg/min, or rapid.
///
/// # Errors
/// The machine cannot make the move.
pub fn plan_straight_move(
    machine: &MachineFile,
    model: &Model,
    from: &AxisValues,
    to: &AxisValues,
    feed: Option<f64>,
) -> Result<Plan, Error> {
    let mut options = program_options(machine, model.to_engineering_units(from));
    let mut end = model.to_engineering_units(to);
    // A coordinate that wraps around takes the shorter way.
    for ((axis, to), from) in options.axes.iter_mut().zip(&mut end).zip(&options.start) {
        if std::mem::take(&mut axis.wraps) {
            *to -= ((*to - from) / 360.0).round() * 360.0;
        }
    }
    // Ten decimals are far below an axis unit: the end pose is exact.
    let coordinates: String = options
        .axes
        .iter()
        .zip(end)
        .map(|(axis, value)| format!(" {}{value:.10}", axis.letter))
        .collect();
    let name = "straight move";
    let block = match feed {
        Some(feed) => format!("G1 F{feed:.6}{coordinates}\n"),
        None => format!("G0{coordinates}\n"),
    };
    let program = haptimill_gcode::read(name, block.as_bytes(), &options)
        .map_err(|refused| Error::new(ErrorKind::Internal, refused))?;
    Plan::new(&program, &settings(machine), model).map_err(|refused| {
        // The text of the move is not that of the operator, so its place says nothing.
        let problems = refused.problems.iter();
        let texts = problems.map(|problem| format!("{}; {}", problem.what, problem.remedy));
        Error::new(ErrorKind::Refused, texts.collect::<Vec<_>>().join("\n"))
    })
}

impl<L: Line> Session<L> {
    /// Homes the machine, then moves to the home pose, where every program starts. No axis is under
    /// force control in the meantime: the sensor may have no zero yet.
    ///
    /// # Errors
    /// As [`Session::home`]; the move is refused, or [not completed](Session::check_completed).
    pub fn go_home(&mut self, machine: &MachineFile, home: &AxisValues) -> Result<(), Error> {
        self.home()?;
        self.move_to_home(machine, home)
    }

    /// Moves a homed machine to the home pose, as [`Session::go_home`].
    ///
    /// # Errors
    /// The move is refused, or [not completed](Session::check_completed).
    pub fn move_to_home(&mut self, machine: &MachineFile, home: &AxisValues) -> Result<(), Error> {
        let status = self.status()?;
        let mask = force_axes(&status);
        if !mask.is_empty() {
            self.set_force_mask(&[])?;
        }
        let here = status.commanded;
        let plan = plan_straight_move(machine, &self.model, &here, home, None)?;
        let end = self.run_job(HOME_JOB, here, plan.setpoints, &mut NoObserver)?;
        if !mask.is_empty() {
            self.set_force_mask(&mask)?;
        }
        self.check_completed(&end)
    }
}
