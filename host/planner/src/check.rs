//! Check of a whole program: every block, in memory that does not depend on its length.

use super::figures::Figures;
use super::limits::{MachineModel, Settings};
use super::planner::{Keep, Planner};
use haptimill_gcode::{Coordinates, Interpreter, Problems, Refused, Step};
use std::fmt;

/// Reason why a program is refused.
#[derive(Debug)]
pub enum CheckError {
    /// Problems of reading it.
    Unreadable(Refused),
    /// What the machine cannot do.
    Impossible(Refused),
}

impl fmt::Display for CheckError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            CheckError::Unreadable(refused) | CheckError::Impossible(refused) => refused.fmt(f),
        }
    }
}

impl std::error::Error for CheckError {}

/// Checks a program to its end, without setpoints, and shows `seen` each step. `file` is its name
/// in messages.
///
/// # Errors
///
/// Returns every problem of reading the program; without one, every problem of the planner.
pub fn check(
    file: &str,
    interpreter: &mut Interpreter<'_>,
    start: Coordinates,
    settings: &Settings,
    model: &impl MachineModel,
    mut seen: impl FnMut(&Step),
) -> Result<Figures, CheckError> {
    let mut planner = Planner::keeping(start, settings.clone(), model, Keep::Nothing);
    let (mut unreadable, mut impossible) = (Problems::default(), Problems::default());
    impossible.note(planner.check_start());
    while let Some(step) = interpreter.next() {
        match step {
            Ok(step) if unreadable.is_empty() => {
                seen(&step);
                let planned = planner.step(&step);
                let with_offsets = |problem| interpreter.with_offsets(step.place(), problem);
                impossible.note(planned.map_err(with_offsets));
            }
            Ok(_) => {}
            Err(problem) => unreadable.note(Err(problem)),
        }
    }
    impossible.note(planner.finish(interpreter.lines()));
    let called = interpreter.called();
    unreadable
        .take(file, called)
        .map_err(CheckError::Unreadable)?;
    impossible
        .take(file, called)
        .map_err(CheckError::Impossible)?;
    Ok(planner.figures())
}
