//! The error model and the evaluators against values that a program in Python computed from the
//! same error set: 28 characteristics of the test piece, three ways.

use haptimill_volumetric::Vector;
use haptimill_volumetric::chain::{Arms, Model};
use haptimill_volumetric::errors::{Approach, ErrorSet, Function, Shape, Squareness, Table};
use haptimill_volumetric::file::{self, Limits};
use haptimill_volumetric::grid::{Grid, Sizes, compensated, reached};
use haptimill_volumetric::part::{characteristics, probe_points};

fn errors() -> ErrorSet {
    file::read(include_str!("../data/vmc3_errors.csv"), &Limits::default()).unwrap()
}

const PHYSICAL: Model = Model::Physical(Arms {
    x_height: 0.0,
    table_point: Vector::new(0.0, 0.0, 0.0),
    tool: Vector::new(0.0, 0.0, -228.3009),
    measured_tool: Vector::new(0.0, 0.0, -228.3009),
});

/// The errors of the simulated machine are the proposed ones, value by value.
#[test]
fn errors_are_the_proposed_ones() {
    let errors = errors();
    let proposed = include_str!("data/proposed_21_errors.csv");
    let rows = proposed
        .lines()
        .filter(|line| !line.starts_with('#'))
        .skip(1);
    let mut count = 0;
    for row in rows {
        let words: Vec<&str> = row.split(',').collect();
        let number = |column: usize| words[column].parse::<f64>().unwrap();
        count += 1;
        let Some(function) = Function::of_name(&format!("E{}", words[0])) else {
            let name = format!("E{}", words[0]);
            let index = Squareness::NAMES.iter().position(|known| *known == name);
            let found = errors.squareness.values()[index.unwrap()];
            assert!((found * 1e6 - number(4)).abs() < 1e-9, "{row}");
            continue;
        };
        assert_eq!(words[3], function.unit(), "{row}");
        for step in -80..=80 {
            let q = 5.0 * f64::from(step);
            let wave = |first: usize| {
                let [amplitude, length, phase] = [0, 1, 2].map(|part| number(first + part));
                if length == 0.0 {
                    return 0.0;
                }
                amplitude * (std::f64::consts::TAU * q / length + phase).sin()
            };
            let expected = number(4) + number(5) * q + wave(6) + wave(9);
            let found = errors.function(function).value(q, Approach::Any) / function.file_unit();
            assert!(
                (found - expected).abs() < 1e-9,
                "{row} {q} {found} {expected}"
            );
        }
    }
    assert_eq!(count, 21);
}

/// Every characteristic within 0.001 um of its golden value.
#[test]
fn characteristics_of_the_test_piece() {
    let errors = errors();
    let rows_of = |model: Model, corrected: bool| {
        let error = |point| model.error(&errors, point);
        let points = probe_points().map(|point| {
            let centre = point.tool_centre();
            let commanded = if corrected {
                compensated(centre, error)
            } else {
                centre
            };
            point.cut_by(reached(commanded, error))
        });
        characteristics(&points).unwrap()
    };
    let columns = [
        rows_of(Model::thesis(), false),
        rows_of(PHYSICAL, false),
        rows_of(PHYSICAL, true),
    ];
    let text = include_str!("data/golden_a160_gdt.csv");
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let mut count = 0;
    for (index, record) in reader.records().enumerate() {
        let record = record.unwrap();
        for (column, rows) in columns.iter().enumerate() {
            let expected: f64 = record[column + 1].parse().unwrap();
            let row = &rows[index];
            assert_eq!(row.name, &record[0]);
            let value = row.value * 1e3;
            let difference = (value - expected).abs();
            assert!(
                difference < 0.001,
                "{} {column}: {value} {expected}",
                row.name
            );
        }
        count += 1;
    }
    assert_eq!((count, columns[0].len()), (28, 28));
}

/// One point in both models.
#[test]
fn one_point() {
    let errors = errors();
    let point = Vector::new(70.0, -80.0, -10.0);
    for (model, expected) in [
        (Model::thesis(), [0.4253, 2.7701, -1.1598]),
        (PHYSICAL, [3.1437, 1.1817, -0.5239]),
    ] {
        let error = model.error(&errors, point) * 1e3;
        let difference = (error - Vector::from(expected)).amax();
        assert!(difference < 1e-4, "{error} {expected:?}");
    }
}

/// The largest error over the grid, and what one pass of compensation leaves of it.
#[test]
fn grid() {
    let errors = errors();
    for (model, before, after) in [(Model::thesis(), 5.35, 0.22e-3), (PHYSICAL, 4.81, 0.19e-3)] {
        let error = |point| model.error(&errors, point);
        let points = Grid::part().points();
        assert_eq!(points.len(), 9 * 9 * 3);
        let raw = Sizes::of(points.iter().map(|point| reached(*point, error) - point));
        let left = points
            .iter()
            .map(|point| reached(compensated(*point, error), error) - point);
        let left = Sizes::of(left);
        assert!((raw.largest * 1e3 - before).abs() < 0.005, "{raw:?}");
        assert!((left.largest * 1e3 - after).abs() < 0.01e-3, "{left:?}");
    }
}

/// A table of a closed form is exact at its nodes, the mean of two nodes between them, constant
/// beyond the ends, and the mean of both directions where the direction is unknown.
#[test]
fn tables_are_exact_at_nodes() {
    let errors = errors();
    let travel = [(-325.0, 325.0), (-250.0, 250.0), (-150.0, 300.0)];
    let tables = errors.tabulated(&travel, [14, 11, 10]);
    for function in Function::all() {
        let Shape::Table(table) = tables.function(function) else {
            panic!("{function} is no table");
        };
        let form = |at: f64| errors.function(function).value(at, Approach::Any);
        for approach in [Approach::Any, Approach::Up, Approach::Down] {
            for node in &table.nodes {
                assert_eq!(
                    table.value(*node, approach),
                    form(*node),
                    "{function} {node}"
                );
            }
        }
        for pair in table.nodes.windows(2) {
            let mean = 0.5 * (form(pair[0]) + form(pair[1]));
            let between = table.value(0.5 * (pair[0] + pair[1]), Approach::Any);
            assert!((between - mean).abs() < 1e-15, "{function} {pair:?}");
        }
        let (low, high) = travel[function.moving.index()];
        assert_eq!(table.value(low - 50.0, Approach::Any), form(low));
        assert_eq!(table.value(high + 50.0, Approach::Any), form(high));
        let pair = Table {
            down: Some(table.up.iter().map(|value| value + 4e-3).collect()),
            ..table.clone()
        };
        let [any, up, down] = [Approach::Any, Approach::Up, Approach::Down]
            .map(|approach| pair.value(low, approach) - form(low));
        assert!(up.abs() < 1e-15 && (down - 4e-3).abs() < 1e-15 && (any - 2e-3).abs() < 1e-15);
    }
}

/// Tables with nodes every 10 mm keep the closed forms within the sagitta of their sines.
#[test]
fn tables_follow_the_forms() {
    let errors = errors();
    let travel = [(-325.0, 325.0), (-250.0, 250.0), (-150.0, 300.0)];
    let tables = errors.tabulated(&travel, [66, 51, 46]);
    let text = file::write(&tables, "a test");
    let limits = Limits {
        travel: Some(travel),
        ..Limits::default()
    };
    let read = file::read(&text, &limits).unwrap();
    for point in Grid::part().points() {
        let exact = PHYSICAL.error(&errors, point);
        // 0.394 um with 100 mm: 100 / 8 (2 pi / 100)^2 0.394 = 0.0194 um at most in a table.
        assert!((PHYSICAL.error(&tables, point) - exact).amax() < 40e-6);
        // A file has four decimals.
        assert!((PHYSICAL.error(&read, point) - PHYSICAL.error(&tables, point)).amax() < 0.5e-6);
    }
}
