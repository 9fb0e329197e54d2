//! Readings as a file: those of a calibration written, and errors identified from those of a file.

use super::identify::{identify_axis, subtract_rotation_effects};
use super::report::{Conditions, results};
use super::{Calibration, Measured, MeasuredAxis};
use crate::targets::evaluate;
use haptimill_volumetric::errors::{ErrorSet, Function, Shape, Squareness, Table, even_nodes};
use haptimill_volumetric::readings::{self, Readings};
use std::fmt::Write as _;

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
    subtract_rotation_effects(&mut set);
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
