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

use crate::drive::Machine;
use crate::laser::{Channel, Environment, Laser, LaserOptions};
use crate::noise::Noise;
use crate::observed::Sample;
use crate::targets::{Deviations, Positioning, RUNS, evaluate, targets};
use haptimill_client::{Error, ErrorKind};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_hil_sim::machines::carriage_errors::CarriageErrors;
use haptimill_machine_file::MachineFile;
use haptimill_volumetric::errors::{
    Approach, Axis, ErrorSet, Function, Kind, Shape, Squareness, Table, even_nodes, interpolate,
};
use haptimill_volumetric::file::NOT_TO_COMPENSATE;
use haptimill_volumetric::gdt::fit_line;
use haptimill_volumetric::readings::{self, Readings};
use std::fmt::Write as _;

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

/// Readings of a laser as a file, for [`readings::read`]: every run at every target.
#[must_use]
pub fn write_readings(calibration: &Calibration) -> String {
    let mut text = format!("{}\n", readings::HEADER);
    for axis in &calibration.axes {
        for measured in &axis.functions {
            let function = measured.function;
            let (one, unit) = (function.file_unit(), function.unit());
            for (direction, columns) in [("up", &measured.up), ("down", &measured.down)] {
                for (target, runs) in axis.targets.iter().zip(columns) {
                    for (run, value) in runs.iter().enumerate() {
                        let (run, value) = (run + 1, value / one);
                        // Writing to a string does not fail.
                        let _ = writeln!(
                            text,
                            "{function},{target:.6},{run},{direction},{value:.5},{unit}"
                        );
                    }
                }
            }
        }
    }
    let squareness = calibration.errors.squareness.values();
    for (name, value) in Squareness::NAMES.iter().zip(squareness) {
        let _ = writeln!(text, "{name},,,,{:.5},urad", value / 1e-6);
    }
    text
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
    if !status.homed || !status.position_kept {
        let what = "a machine that is not homed cannot be measured: home it first; nothing moved";
        return Err(Error::new(ErrorKind::Command, what));
    }
    let mut truth = truth_of(file)?;
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
        compensation: status.compensation,
    })
}

/// Errors of the carriages of the simulated machine, which the instruments see.
fn truth_of(file: &MachineFile) -> Result<CarriageErrors, Error> {
    let plant: PlantConfig = file.plant()?;
    let errors = match &plant.geometry {
        Some(GeometryConfig::Cartesian(config)) => {
            CarriageErrors::parse(&config.errors, config.error_model)
                .ok()
                .flatten()
        }
        _ => None,
    };
    errors.ok_or_else(|| {
        let what = "the simulated machine has no errors to measure; add `errors` to \
                    [plant.geometry.cartesian]";
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

/// Means over all runs in both directions at each target.
fn means(measured: &Measured) -> Vec<f64> {
    let targets = measured.up.iter().zip(&measured.down);
    targets
        .map(|(up, down)| {
            let all = up.iter().chain(down);
            all.sum::<f64>() / (up.len() + down.len()) as f64
        })
        .collect()
}

/// The error functions from the readings of all axes.
#[must_use]
pub fn identify(axes: &[MeasuredAxis]) -> ErrorSet {
    let mut set = ErrorSet::default();
    for measured in axes {
        identify_axis(measured, &mut set);
    }
    take_off_arms(&mut set);
    for measured in axes {
        // A roll that nobody measured is zero.
        for function in Function::all().filter(|function| function.moving == measured.axis) {
            if !matches!(set.function(function), Shape::Table(_)) {
                let zeros = vec![0.0; measured.targets.len()];
                set.set(
                    function,
                    Shape::Table(Table::both(measured.targets.clone(), zeros)),
                );
            }
        }
    }
    set.squareness = squareness(axes, &set);
    set
}

/// Smallest lost motion that is written by direction, mm: the resolution of a laser.
const SMALLEST_LOST_MOTION: f64 = 1e-4;

/// Mean difference between the readings downwards and upwards at each target, if it is a lost
/// motion: its mean over the targets is above three times its standard error over the runs.
fn lost_motion(measured: &Measured) -> Option<Vec<f64>> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let targets = || measured.up.iter().zip(&measured.down);
    let runs = targets().map(|(up, down)| up.len().min(down.len())).min()?;
    let of_runs: Vec<f64> = (0..runs)
        .map(|run| {
            let differences = targets().map(|(up, down)| down[run] - up[run]);
            differences.sum::<f64>() / measured.up.len() as f64
        })
        .collect();
    let whole = mean(&of_runs);
    let scatter: f64 = of_runs.iter().map(|run| (run - whole).powi(2)).sum();
    let error = (scatter / (runs.max(2) * (runs.max(2) - 1)) as f64).sqrt();
    (whole > SMALLEST_LOST_MOTION && whole > 3.0 * error)
        .then(|| targets().map(|(up, down)| mean(down) - mean(up)).collect())
}

/// The measured functions of an axis: means over all runs, straightness without its line, the
/// others zero at the origin. A positioning error with lost motion has a value for each direction.
fn identify_axis(measured: &MeasuredAxis, set: &mut ErrorSet) {
    for function in &measured.functions {
        let mut values = means(function);
        let nodes = &measured.targets;
        let lost = match function.function.kind() {
            Kind::Positioning => lost_motion(function),
            _ => None,
        };
        if function.function.kind() == Kind::Straightness {
            values = without_line(nodes, &values);
        } else {
            let offset = interpolate(nodes, &values, 0.0);
            values.iter_mut().for_each(|value| *value -= offset);
        }
        let table = match lost {
            None => Table::both(nodes.clone(), values),
            Some(lost) => {
                let half = |sign: f64| {
                    let pairs = values.iter().zip(&lost);
                    pairs.map(|(mean, lost)| mean + 0.5 * sign * lost).collect()
                };
                Table {
                    nodes: nodes.clone(),
                    up: half(-1.0),
                    down: Some(half(1.0)),
                }
            }
        };
        set.set(function.function, Shape::Table(table));
    }
}

/// Takes what the measured rotations of the table do on the line along y off the straightness of
/// the table: the straight edge stands on it and turns with it about the origin of the work.
fn take_off_arms(set: &mut ErrorSet) {
    for (direction, about, sign) in [(Axis::X, Axis::Z, 1.0), (Axis::Z, Axis::X, -1.0)] {
        let of = |direction, rotates| Function {
            moving: Axis::Y,
            direction,
            rotates,
        };
        let (straightness, rotation) = (of(direction, false), of(about, true));
        let turn = |at: f64| set.function(rotation).value(at, Approach::Any);
        let Shape::Table(table) = set.function(straightness) else {
            continue;
        };
        let nodes = table.nodes.clone();
        let pairs = nodes.iter().zip(&table.up);
        let values: Vec<f64> = pairs
            .map(|(at, value)| value + sign * at * turn(*at))
            .collect();
        let values = without_line(&nodes, &values);
        set.set(straightness, Shape::Table(Table::both(nodes, values)));
    }
}

fn without_line(nodes: &[f64], values: &[f64]) -> Vec<f64> {
    let points: Vec<[f64; 2]> = nodes.iter().zip(values).map(|(u, v)| [*u, *v]).collect();
    fit_line(&points).map_or_else(|_| values.to_vec(), |line| line.residuals)
}

fn slope(nodes: &[f64], values: impl Iterator<Item = f64>) -> f64 {
    let points: Vec<[f64; 2]> = nodes
        .iter()
        .copied()
        .zip(values)
        .map(<[f64; 2]>::from)
        .collect();
    fit_line(&points).map_or(0.0, |line| line.slope)
}

/// Squareness errors from the indicator at the square, less what the table's rotations, which are
/// in the tables, do on the line along y.
fn squareness(axes: &[MeasuredAxis], set: &ErrorSet) -> Squareness {
    let [x, y, z] = axes else {
        return Squareness::default();
    };
    let line = |axis: &MeasuredAxis, component: usize| {
        slope(
            &axis.targets,
            axis.square.iter().map(|reading| reading[component]),
        )
    };
    let on_arm = |direction| {
        let function = Function {
            moving: Axis::Y,
            direction,
            rotates: true,
        };
        let shape = set.function(function);
        let values = y
            .targets
            .iter()
            .map(|at| at * shape.value(*at, Approach::Any));
        slope(&y.targets, values)
    };
    Squareness {
        c0y: -(line(x, 1) + line(y, 0)) - on_arm(Axis::Z),
        b0z: line(x, 2) + line(z, 0),
        a0z: on_arm(Axis::X) - (line(y, 2) + line(z, 1)),
    }
}

/// What is known of the conditions of readings from a file.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Conditions {
    /// Temperature of the air, degrees Celsius.
    pub air_c: Option<f64>,
    /// Pressure of the air, hPa.
    pub pressure_hpa: Option<f64>,
    /// Temperature of the machine, degrees Celsius.
    pub machine_c: Option<f64>,
    /// The controller compensated during the readings.
    pub compensated: Option<bool>,
}

impl Conditions {
    /// The conditions as text; what nobody stated is named.
    #[must_use]
    pub fn report(&self) -> String {
        let compensation = match self.compensated {
            None => "not stated: the readings of a compensated machine are what it leaves".into(),
            Some(false) => "off".into(),
            Some(true) => format!("ON: {REMAINS}; {NOT_TO_COMPENSATE}"),
        };
        let stated = |value: Option<f64>, unit: &str| {
            value.map_or_else(
                || "not stated".to_string(),
                |value| format!("{value} {unit}"),
            )
        };
        let mut text = format!(
            "machine     load not stated; temperature {}; volumetric compensation {compensation}\n\
             air         temperature {}, pressure {}; the instrument corrects the wavelength\n",
            stated(self.machine_c, "deg C"),
            stated(self.air_c, "deg C"),
            stated(self.pressure_hpa, "hPa"),
        );
        if let Some(machine_c) = self.machine_c {
            text += &warm(&Environment {
                machine_c,
                ..Environment::default()
            });
        }
        text
    }
}

/// What the readings of a compensated machine are.
const REMAINS: &str = "positioning, straightness and squareness are what it leaves on the measured \
                       lines; rotations remain";

/// Warning of a machine that has not the temperature at which lengths are stated; empty otherwise.
fn warm(environment: &Environment) -> String {
    if environment.off_reference().abs() <= 1e-9 {
        return String::new();
    }
    let per_metre = environment.expansion_uncertainty(1000.0) * 1e3;
    format!(
        "WARNING     the machine has {} deg C and not 20; the coefficient of expansion adds an \
         uncertainty of +-{per_metre:.1} um per metre\n",
        environment.machine_c
    )
}

/// The error functions of readings, and a report of them by ISO 230-2. A function without readings
/// is zero over `travel`; the report names it.
#[must_use]
pub fn of_readings(
    readings: &Readings,
    travel: &[(f64, f64); 3],
    conditions: &Conditions,
) -> (ErrorSet, String) {
    let axes: Vec<MeasuredAxis> = readings
        .functions
        .iter()
        .map(|read| MeasuredAxis {
            axis: read.function.moving,
            targets: read.targets.clone(),
            functions: vec![Measured {
                function: read.function,
                up: read.up.clone(),
                down: read.down.clone(),
                result: evaluate(&read.up, &read.down),
            }],
            square: Vec::new(),
        })
        .collect();
    let mut set = ErrorSet::default();
    for axis in &axes {
        identify_axis(axis, &mut set);
    }
    take_off_arms(&mut set);
    set.squareness = readings.squareness;
    let mut text = conditions.report() + "\n" + &results(&axes, &set);
    for function in Function::all() {
        if !matches!(set.function(function), Shape::Table(_)) {
            let (low, high) = travel[function.moving.index()];
            // Two nodes are 200 mm apart at most.
            let count = ((high - low) / 100.0).ceil() as usize + 1;
            let nodes = even_nodes((low, high), count);
            let zeros = vec![0.0; nodes.len()];
            set.set(function, Shape::Table(Table::both(nodes, zeros)));
            let _ = writeln!(text, "{function} not measured, taken as 0");
        }
    }
    (set, text)
}

/// Results of ISO 230-2 and squareness errors as text.
fn results(axes: &[MeasuredAxis], errors: &ErrorSet) -> String {
    // Writing to a string does not fail.
    let mut text = String::from("ISO 230-2            A        R        B        E        M\n");
    for axis in axes {
        for measured in &axis.functions {
            let (function, result) = (measured.function, &measured.result);
            let unit = function.file_unit();
            let _ = writeln!(
                text,
                "{function} {:<5} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {:>8.3}",
                function.unit(),
                result.accuracy / unit,
                result.repeatability / unit,
                result.reversal / unit,
                result.systematic / unit,
                result.range / unit,
            );
        }
    }
    for (name, value) in Squareness::NAMES.iter().zip(errors.squareness.values()) {
        let _ = writeln!(text, "{name} urad {:>8.3}", value * 1e6);
    }
    text
}

impl Calibration {
    /// Conditions and results as text.
    #[must_use]
    pub fn report(&self) -> String {
        let mut text = String::new();
        let Environment {
            air_c,
            pressure_hpa,
            humidity_percent,
            ..
        } = self.options.environment;
        let compensation = match self.compensation {
            None => "the machine has none".to_string(),
            Some(0) => "off".to_string(),
            Some(percent) => format!("ON ({percent} %): {REMAINS}; {NOT_TO_COMPENSATE}"),
        };
        let wavelength = if self.options.corrects_wavelength {
            "corrected by sensors".to_string()
        } else {
            let ppm = self.options.environment.wavelength_change() * 1e6;
            format!("NOT corrected: readings are off by {:.2} ppm", -ppm)
        };
        let roll = if self.options.roll.is_some() {
            "by another instrument than the laser"
        } else {
            "not measured, taken as 0"
        };
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "machine     unloaded; volumetric compensation {compensation}\n\
             air         {air_c} deg C, {pressure_hpa} hPa, {humidity_percent} %; wavelength \
             {wavelength}\n\
             roll        {roll}"
        );
        text += &warm(&self.options.environment);
        text + "\n" + &results(&self.axes, &self.errors)
    }
}
