//! Loads a part program, checks it against the machine and plans it.

use super::{CliError, Exit};
use haptimill_client::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::input;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::{Action, AxisValues};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;

/// A program that was checked and planned from a start pose.
#[derive(Debug)]
pub(crate) struct Planned {
    pub(crate) plan: Plan,
    /// Setpoints at which the program pauses, with the line of each pause.
    pub(crate) pauses: BTreeMap<u32, u32>,
    /// Number of lines of the file.
    #[cfg_attr(not(feature = "console"), allow(dead_code))]
    pub(crate) lines: u32,
}

/// A part program on disk.
#[derive(Debug)]
pub(crate) struct PartProgram {
    /// File name without folders. The recording contains it and must not depend on the folder.
    pub(crate) name: String,
    file: String,
    pub(crate) text: Vec<u8>,
    /// Whether M1 pauses.
    optional_stop: bool,
}

impl PartProgram {
    /// Reads the file. With `optional_stop`, M1 pauses.
    pub(crate) fn load(path: &Path, optional_stop: bool) -> Result<Self, CliError> {
        let file = path.display().to_string();
        let text = input::read(path, input::PROGRAM_BYTES)
            .map_err(|error| CliError::new(Exit::BadInput, format!("{file}: {error}")))?;
        let name = path
            .file_name()
            .map_or_else(|| file.clone(), |name| name.to_string_lossy().into_owned());
        Ok(Self {
            name,
            file,
            text,
            optional_stop,
        })
    }

    /// Checks and plans the program from a start pose.
    ///
    /// # Errors
    /// The mistakes of the program, or what the machine cannot do; nothing moves.
    pub(crate) fn plan(
        &self,
        machine: &MachineFile,
        model: &Model,
        start: &AxisValues,
    ) -> Result<Planned, CliError> {
        let options = haptimill_gcode::Options {
            optional_stop: self.optional_stop,
            ..program_options(machine, model.to_engineering_units(start))
        };
        let program = haptimill_gcode::read(&self.file, &self.text, &options)
            .map_err(|refused| Error::refused(ErrorKind::BadInput, &refused))?;
        let plan = Plan::new(&program, &settings(machine), model)
            .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))?;
        // Each pause of the program has one setpoint, in the same order.
        let setpoints = (0..)
            .zip(&plan.setpoints)
            .filter(|(_, setpoint)| setpoint.action == Action::Pause);
        let lines = program.steps.iter().filter_map(|step| match step {
            haptimill_gcode::Step::Pause { place }
            | haptimill_gcode::Step::ToolChange { place, .. } => Some(place.line),
            _ => None,
        });
        let pauses = setpoints.map(|(index, _)| index).zip(lines).collect();
        Ok(Planned {
            plan,
            pauses,
            lines: program.lines,
        })
    }

    /// Refuses a program with pauses where standard input is no terminal, because a pause waits for
    /// Enter.
    pub(crate) fn check_pauses(&self, planned: &Planned) -> Result<(), CliError> {
        match planned.pauses.values().next() {
            Some(line) if !std::io::stdin().is_terminal() => Err(CliError::new(
                Exit::Usage,
                format!(
                    "{}:{line}: the program pauses here and standard input is no terminal to press Enter on; \
                     run it in a terminal, or with --skip-pauses",
                    self.file
                ),
            )),
            _ => Ok(()),
        }
    }
}
