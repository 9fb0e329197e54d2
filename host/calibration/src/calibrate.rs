//! Measurement of the 21 errors with a laser: drives each axis to its targets through the
//! controller, reads the instruments, and identifies the error functions.
//!
//! Every axis runs along its line through the origin of the work, five times in each direction. One
//! drive of the machine serves all set-ups of the instruments; their noise is independent.
//!
//! The reflectors for positioning and straightness stand between the tool and the table: their
//! readings are deviations of the tool relative to the workpiece, on a compensated machine those
//! that are left. Angles are those of the carriages, which no axis corrects.
//!
//! The tables do not contain what these readings do not contain:
//! - An offset. A channel shows 0 at the first target; positioning and angles are then shifted to
//!   zero at the origin.
//! - The slope of a straightness: an optical straight edge is aligned with the axis, so the line of
//!   least squares is removed. The angles between the axes come from a square.
//!
//! A table of errors therefore equals the truth up to a rigid motion of the whole workpiece.
//! Straight edge and square stand on the table, and their readings contain what the rotations of
//! the table do on their arms; that part is taken off.

mod identify;
mod readings_file;
mod report;

pub use identify::identify;
pub use readings_file::{of_readings, write_readings};
pub use report::Conditions;

use crate::drive::Machine;
use crate::laser::{Channel, Laser, LaserOptions};
use crate::noise::Noise;
use crate::observed::Sample;
use crate::targets::{Deviations, Positioning, RUNS, evaluate, targets};
use haptimill_client::{Error, ErrorKind};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::carriage_errors::CarriageErrors;
use haptimill_machine_file::MachineFile;
use haptimill_volumetric::errors::{Axis, ErrorSet, Function, Kind};

/// How to measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Nominal interval of the targets, mm.
    pub interval: f64,
    /// Feed between targets, mm/s.
    pub feed: f64,
    /// Wait at a target, and the part of it over which readings are averaged, seconds.
    pub wait: f64,
    /// See `wait`.
    pub window: f64,
    /// The instruments.
    pub laser: LaserOptions,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            // About the distance of the controller's nodes on a travel of 650 mm: between targets a
            // table is linear.
            interval: 10.0,
            feed: 100.0,
            wait: 0.6,
            window: 0.2,
            laser: LaserOptions::default(),
        }
    }
}

/// A measured function of an axis: readings at every target.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The function.
    pub function: Function,
    /// Readings upwards, by target and run, mm or radians.
    pub up: Vec<Deviations>,
    /// The same downwards.
    pub down: Vec<Deviations>,
    /// Result of ISO 230-2.
    pub result: Positioning,
}

/// A measured axis.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredAxis {
    /// The axis.
    pub axis: Axis,
    /// Target positions, mm.
    pub targets: Vec<f64>,
    /// Its functions. Roll is missing without an instrument for it.
    pub functions: Vec<Measured>,
    /// Mean readings of the indicator at the square by target: deviations of the tool from the line
    /// in x, y and z, mm.
    pub square: Vec<[f64; 3]>,
}

/// A calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The axes.
    pub axes: Vec<MeasuredAxis>,
    /// The identified errors.
    pub errors: ErrorSet,
    /// The instruments and their environment.
    pub options: LaserOptions,
    /// Volumetric compensation was in effect during the measurement, percent of its fade.
    pub compensation: Option<u8>,
}

/// Drives the machine to all targets and identifies its errors.
///
/// # Errors
/// The machine is not homed or not simulated: nothing moves then. A run fails: the machine stands
/// where it stopped.
pub fn calibrate(
    machine: &mut Machine,
    file: &MachineFile,
    plan: &Plan,
    mut progress: impl FnMut(&str),
) -> Result<Calibration, Error> {
    let status = machine.status()?;
    if !status.homed {
        let what = "a machine that is not homed cannot be measured: home it first; nothing moved";
        return Err(Error::new(ErrorKind::Command, what));
    }
    let plant = file.plant()?;
    let mut truth = carriage_errors(file, &plant)?.1;
    let mut axes = Vec::new();
    for axis in Axis::ALL {
        let limits = &file.pose[axis.index()];
        let mut noise = Noise::new(plan.laser.seed, axis.index() as u64);
        let targets = targets((limits.low, limits.high), plan.interval, &mut noise);
        progress(&format!(
            "{} axis: {} targets, {RUNS} runs in both directions",
            axis.letter(),
            targets.len()
        ));
        let visited = visit_all(machine, axis, &targets, (limits.low, limits.high), plan)?;
        axes.push(read_axis(axis, &targets, &visited, &mut truth, plan));
    }
    let errors = identify(&axes);
    Ok(Calibration {
        axes,
        errors,
        options: plan.laser,
        compensation: status.compensation(),
    })
}

/// Errors of the carriages of the simulated machine, which the instruments see, and the text of
/// their error file.
pub(crate) fn carriage_errors<'p>(
    file: &MachineFile,
    plant: &'p PlantConfig,
) -> Result<(&'p str, CarriageErrors), Error> {
    let errors = match &plant.geometry {
        Some(geometry) => geometry.carriage_errors(),
        None => Ok(None),
    };
    let errors = errors.map_err(|problem| Error::in_file(&file.file, problem))?;
    errors.ok_or_else(|| {
        let model = file.config.model.descriptor().code;
        let what = format!(
            "the simulated machine has no errors to measure; add `errors` to \
             [plant.geometry.{model}], if the model has this key (docs/machine-files.md)"
        );
        Error::in_file(&file.file, what)
    })
}

/// The machine at every target: run by run, upwards and then downwards, in the order of the visits.
fn visit_all(
    machine: &mut Machine,
    axis: Axis,
    targets: &[f64],
    (low, high): (f64, f64),
    plan: &Plan,
) -> Result<Vec<Sample>, Error> {
    let place = |at: f64| {
        let mut place = [0.0; 3];
        place[axis.index()] = at;
        place
    };
    // A target is reached from beyond the target before it, also the first one of a run.
    let mut cycle = vec![place(low)];
    cycle.extend(targets.iter().map(|at| place(*at)));
    cycle.push(place(high));
    cycle.extend(targets.iter().rev().map(|at| place(*at)));
    let mut all = Vec::new();
    for _ in 0..RUNS {
        let stood = machine.visit(&cycle, plan.feed, plan.wait, plan.window)?;
        let count = targets.len();
        all.extend_from_slice(&stood[1..=count]);
        all.extend(stood[count + 2..].iter().rev());
    }
    Ok(all)
}

fn read_axis(
    axis: Axis,
    targets: &[f64],
    visited: &[Sample],
    truth: &mut CarriageErrors,
    plan: &Plan,
) -> MeasuredAxis {
    let count = targets.len();
    // What an instrument without noise shows, by pass and target.
    let seen = |function: Function, truth: &mut CarriageErrors| {
        let deviations = visited.iter().enumerate().map(|(index, sample)| {
            let upwards = (index / count).is_multiple_of(2);
            deviation(function, targets[index % count], sample, upwards, truth)
        });
        let deviations: Vec<f64> = deviations.collect();
        set_up(function, targets, deviations)
    };
    let all = Function::all().filter(|function| function.moving == axis);
    let seen: Vec<(Function, Vec<f64>)> = all
        .map(|function| (function, seen(function, truth)))
        .collect();
    let mut functions: Vec<Measured> = seen
        .iter()
        .map(|(function, _)| Measured {
            function: *function,
            up: vec![Vec::new(); count],
            down: vec![Vec::new(); count],
            result: Positioning::default(),
        })
        .collect();
    let mut square = vec![[0.0; 3]; count];
    // The optics stay in place over all runs of an axis.
    let mut laser = Laser::new(&plan.laser, axis.index() as u64);
    for (pass, samples) in visited.chunks(count).enumerate() {
        let upwards = pass % 2 == 0;
        for (target, sample) in samples.iter().enumerate() {
            for (measured, (function, seen)) in functions.iter_mut().zip(&seen) {
                let channel = match function.kind() {
                    Kind::Positioning => Channel::Linear,
                    Kind::Straightness => Channel::Straightness,
                    Kind::Roll => Channel::Roll,
                    _ => Channel::Angle,
                };
                let path = targets[target] - targets[0];
                // Roll without an instrument for it has no reading.
                if let Ok(reading) = laser.read(channel, seen[pass * count + target], path) {
                    let column = if upwards {
                        &mut measured.up
                    } else {
                        &mut measured.down
                    };
                    column[target].push(reading);
                }
            }
            for (component, sum) in square[target].iter_mut().enumerate() {
                let ideal = if component == axis.index() {
                    targets[target]
                } else {
                    0.0
                };
                let off = sample.tool[component] - ideal;
                *sum += laser.read_square(off) / (2 * RUNS) as f64;
            }
        }
    }
    functions.retain(|measured| measured.up.iter().all(|runs| !runs.is_empty()));
    for measured in &mut functions {
        measured.result = evaluate(&measured.up, &measured.down);
    }
    MeasuredAxis {
        axis,
        targets: targets.to_vec(),
        functions,
        square,
    }
}

/// Deviation at a target: of the tool relative to the table where the beam stands between the two,
/// as the controller may correct it with any axis; of the carriage for a rotation, which no axis
/// corrects.
fn deviation(
    function: Function,
    target: f64,
    sample: &Sample,
    upwards: bool,
    truth: &mut CarriageErrors,
) -> f64 {
    let axis = function.moving.index();
    let component = function.direction.index();
    if function.rotates {
        let at = sample.carriages[axis];
        return truth.of_carriage(axis, at, upwards)[3 + component];
    }
    let ideal = if component == axis { target } else { 0.0 };
    sample.tool[component] - ideal
}

/// Deviations as the optics show them after their set-up: the first one is 0, and the straight edge
/// is aligned with the first and the last target of the first run.
fn set_up(function: Function, targets: &[f64], deviations: Vec<f64>) -> Vec<f64> {
    let count = targets.len();
    let first = deviations[0];
    let slope = if function.kind() == Kind::Straightness && count > 1 {
        (deviations[count - 1] - first) / (targets[count - 1] - targets[0])
    } else {
        0.0
    };
    let shown = deviations.iter().enumerate().map(|(index, deviation)| {
        deviation - first - slope * (targets[index % count] - targets[0])
    });
    shown.collect()
}
