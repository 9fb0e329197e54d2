//! Readings of a laser as CSV: every run at every target, as the software of an instrument exports
//! them.
//!
//! ```csv
//! function,target_mm,run,direction,reading,unit
//! EXX,-312.5,1,up,0.41,um
//! EC0Y,,,,25,urad
//! ```
//!
//! A reading is the actual position less the target, in the sign of the tool relative to the
//! workpiece. The squareness errors are results, not readings. A problem names the line and the
//! remedy.

use crate::errors::{Function, Squareness};
use crate::file::{FileProblem, Name, Row, problem, rows};

/// Header of the file.
pub const HEADER: &str = "function,target_mm,run,direction,reading,unit";

/// Readings of one function, mm or radians.
#[derive(Debug, Clone, PartialEq)]
pub struct FunctionReadings {
    /// The function.
    pub function: Function,
    /// Targets, mm, ascending.
    pub targets: Vec<f64>,
    /// First line of each target, from 1.
    pub lines: Vec<u64>,
    /// Readings upwards by target and run.
    pub up: Vec<Vec<f64>>,
    /// The same downwards.
    pub down: Vec<Vec<f64>>,
}

/// Readings of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Readings {
    /// The functions that have readings, in the order of [`Function::all`].
    pub functions: Vec<FunctionReadings>,
    /// Squareness errors; 0 where the file has none.
    pub squareness: Squareness,
}

/// One line with a reading.
struct Reading {
    line: u64,
    target: f64,
    up: bool,
    value: f64,
}

/// Reads a file.
///
/// # Errors
/// The first problem: a header, a name, a unit, a number, a direction, or a target whose number of
/// readings differs from that of the others.
pub fn read(text: &str) -> Result<Readings, FileProblem> {
    let mut all: [Vec<Reading>; 18] = Default::default();
    let mut squareness = [None; 3];
    for row in rows(text, HEADER)? {
        match row.name()? {
            Name::Squareness(index) => {
                let value = row.number(4, "reading")? * row.unit(5, true)?;
                if squareness[index].replace(value).is_some() {
                    let what = format!("{} is there twice", row.text(0));
                    return Err(problem(row.line, what, "remove one"));
                }
            }
            Name::Function(function) => all[function.index()].push(reading(&row, function)?),
        }
    }
    let mut functions = Vec::new();
    for function in Function::all() {
        let readings = &mut all[function.index()];
        if !readings.is_empty() {
            functions.push(group(function, readings)?);
        }
    }
    if functions.is_empty() && squareness == [None; 3] {
        return Err(problem(0, "no readings", "add a line for each reading"));
    }
    Ok(Readings {
        functions,
        squareness: Squareness::of_values(squareness.map(Option::unwrap_or_default)),
    })
}

fn reading(row: &Row, function: Function) -> Result<Reading, FileProblem> {
    row.number(2, "run")?;
    let up = match row.text(3) {
        "up" => true,
        "down" => false,
        other => {
            let what = format!("direction = \"{other}\"");
            return Err(problem(row.line, what, "write up or down"));
        }
    };
    Ok(Reading {
        line: row.line,
        target: row.number(1, "target_mm")?,
        up,
        value: row.number(4, "reading")? * row.unit(5, function.rotates)?,
    })
}

fn group(function: Function, readings: &mut [Reading]) -> Result<FunctionReadings, FileProblem> {
    readings.sort_by(|a, b| a.target.total_cmp(&b.target));
    let mut found = FunctionReadings {
        function,
        targets: Vec::new(),
        lines: Vec::new(),
        up: Vec::new(),
        down: Vec::new(),
    };
    let mut line = 0;
    let mut count = None;
    for at_target in readings.chunk_by(|a, b| a.target == b.target) {
        let of = |up: bool| -> Vec<f64> {
            let direction = at_target.iter().filter(|reading| reading.up == up);
            direction.map(|reading| reading.value).collect()
        };
        let (target, up, down) = (at_target[0].target, of(true), of(false));
        line = at_target[0].line;
        let expected = *count.get_or_insert(up.len().max(down.len()));
        for (name, direction) in [("up", &up), ("down", &down)] {
            if direction.len() != expected {
                let what = format!(
                    "{function} has {} readings {name} at {target} mm, and {expected} elsewhere",
                    direction.len()
                );
                let remedy = "every target needs the same number of runs in both directions";
                return Err(problem(line, what, remedy));
            }
        }
        found.targets.push(target);
        let lines = at_target.iter().map(|reading| reading.line);
        found.lines.push(lines.min().unwrap_or(line));
        found.up.push(up);
        found.down.push(down);
    }
    if found.targets.len() < 2 {
        let what = format!("{function} has one target");
        return Err(problem(line, what, "measure at two at least"));
    }
    Ok(found)
}
