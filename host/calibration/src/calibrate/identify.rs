//! Identification: the error functions and the squareness errors from the readings of all axes.

use super::{Measured, MeasuredAxis};
use haptimill_volumetric::errors::{
    Approach, Axis, ErrorSet, Function, Kind, Shape, Squareness, Table, interpolate,
};
use haptimill_volumetric::gdt::fit_line;

/// The error functions from the readings of all axes.
#[must_use]
pub fn identify(axes: &[MeasuredAxis]) -> ErrorSet {
    let mut set = ErrorSet::default();
    for measured in axes {
        identify_axis(measured, &mut set);
    }
    subtract_rotation_effects(&mut set);
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
pub(super) fn identify_axis(measured: &MeasuredAxis, set: &mut ErrorSet) {
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

/// Subtracts from the straightness along y the part that the measured rotations of the table cause
/// at the straight edge. The straight edge is fixed to the table and rotates with it about the
/// origin of the work.
pub(super) fn subtract_rotation_effects(set: &mut ErrorSet) {
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
