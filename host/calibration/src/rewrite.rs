//! Compensation by the part program instead of the controller: every move is replaced by short
//! straight moves between corrected points. A control without error tables needs it.

use haptimill_client::{Error, ErrorKind, session};
use haptimill_gcode::{Feed, Options, Path, Step};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::compensation::{CHAIN, arms};
use haptimill_machine_file::model::{Model, program_options};
use haptimill_machine_file::scale::PER_MM;
use haptimill_volumetric::chain::Arms;
use haptimill_volumetric::errors::ErrorSet;
use haptimill_volumetric::grid::compensated;
use haptimill_volumetric::{Vector, chain};
use std::fmt::Write as _;

/// Longest of the straight moves, mm.
const LONGEST: f64 = 1.0;

/// Largest distance of an arc from its chords, mm.
const SAGITTA: f64 = 0.005e-3;

/// Largest distance of a blended corner, mm: below what the correction is to reach.
const TOLERANCE: f64 = 0.1e-3;

/// The part program `text` with all its points corrected by the error of the machine, mm.
///
/// # Errors
/// The program is refused, or has a step other than moves, dwells, messages, spindle commands and
/// tool changes.
pub fn rewritten(
    name: &str,
    text: &str,
    options: &Options,
    error: impl Fn(Vector) -> Vector,
) -> Result<String, Error> {
    let program = haptimill_gcode::read(name, text.as_bytes(), options)
        .map_err(|refused| Error::refused(ErrorKind::BadInput, &refused))?;
    let mut out = format!("(corrected: {name})\nG21 G90 G94 G64 P{TOLERANCE}\n");
    for step in &program.steps {
        write_step(&mut out, step, &error).map_err(|line| {
            let what = format!(
                "{name}:{line}: only moves, dwells, messages, spindle commands and tool changes can \
                 be rewritten"
            );
            Error::new(ErrorKind::BadInput, what)
        })?;
    }
    out.push_str("M30\n");
    Ok(out)
}

/// Writes a step, or returns its line.
fn write_step(out: &mut String, step: &Step, error: &impl Fn(Vector) -> Vector) -> Result<(), u32> {
    // Writing to a string does not fail.
    let _ = match step {
        Step::Move(step) => {
            let word = match step.feed {
                Feed::Rapid => "G0".to_owned(),
                Feed::PerMinute(feed) => format!("G1 F{feed:.3}"),
            };
            // The overrides are off in a move of its own: tapping stops exactly before it.
            if step.fixed {
                out.push_str("M49\n");
            }
            let count = pieces(&step.path, step.feed);
            for piece in 1..=count {
                let [x, y, z, ..] = step
                    .path
                    .at(step.path.length * f64::from(piece) / f64::from(count));
                let at = compensated(Vector::new(x, y, z), error);
                let _ = writeln!(out, "{word} X{:.6} Y{:.6} Z{:.6}", at.x, at.y, at.z);
            }
            if step.fixed {
                out.push_str("M48\n");
            }
            if step.exact_stop {
                out.push_str("G4 P0.001\n");
            }
            Ok(())
        }
        Step::Dwell { seconds, .. } => writeln!(out, "G4 P{seconds}"),
        Step::Spindle { rpm: 0, .. } => writeln!(out, "M5"),
        Step::Spindle { rpm, .. } => {
            let word = if *rpm > 0 { "M3" } else { "M4" };
            writeln!(out, "S{} {word}", rpm.unsigned_abs())
        }
        Step::ToolChange { tool, .. } => writeln!(out, "T{tool} M6"),
        Step::Message { text, .. } => writeln!(out, "(MSG,{text})"),
        other => return Err(other.place().line),
    };
    Ok(())
}

/// As [`rewritten`], for a run of a machine from its home pose, with the errors of a file. The
/// machine has the chain [w Y b X Z t] and no further axis.
///
/// # Errors
/// See [`rewritten`]; the machine has another chain, or no home pose.
pub fn rewritten_for(
    machine: &MachineFile,
    name: &str,
    text: &str,
    errors: &ErrorSet,
) -> Result<String, Error> {
    check_chain(machine)?;
    let model = Model::new(machine);
    let home = session::find_home_pose(machine, &model)?;
    let options = program_options(machine, model.to_engineering_units(&home));
    let chain = chain::Model::Physical(arms_of(machine));
    rewritten(name, text, &options, |point| chain.error(errors, point))
}

/// Where the axes of a machine were measured: as its tables state it, or at the origin.
fn arms_of(machine: &MachineFile) -> Arms {
    let tables = machine.config.volumetric.as_ref();
    tables.map_or_else(Arms::default, |tables| {
        let [x, y, _] = tables
            .axes
            .each_ref()
            .map(|axis| axis.measured_at.map(|place| f64::from(place.0) / PER_MM));
        // The rotations of the z axis do not act on the tool with which it was measured.
        Arms {
            x_height: x[2],
            table_point: y.into(),
            ..Arms::default()
        }
    })
}

/// Refuses a machine whose tool [`chain::Model`] does not describe.
fn check_chain(machine: &MachineFile) -> Result<(), Error> {
    let descriptor = machine.config.model.descriptor();
    if !descriptor.has_machine_axes() || descriptor.axes() != 3 {
        let what = format!(
            "the joints of the model \"{}\" are not x, y and z, and an error file has errors of \
             these axes only; name a machine with these joints, such as machines/vmc3.toml",
            descriptor.code
        );
        return Err(Error::in_file(&machine.file, what));
    }
    let own = machine.config.volumetric.as_ref();
    let own = own.map(|tables| tables.axes.each_ref().map(|axis| axis.arm));
    if own.is_some_and(|own| Some(own) != arms(CHAIN)) {
        let what = format!(
            "compensation.chain is not \"{CHAIN}\", the only chain for which a program is \
             rewritten; let the controller compensate instead"
        );
        return Err(Error::in_file(&machine.file, what));
    }
    Ok(())
}

/// Number of straight moves for a path. A rapid move cuts nothing: one is enough.
fn pieces(path: &Path, feed: Feed) -> u32 {
    let Feed::PerMinute(_) = feed else {
        return 1;
    };
    let radius = path
        .arc
        .as_ref()
        .map(|arc| arc.radius[0].max(arc.radius[1]));
    let chord = radius.map_or(LONGEST, |radius| (8.0 * radius * SAGITTA).sqrt());
    (path.length / chord.min(LONGEST)).ceil().max(1.0) as u32
}
