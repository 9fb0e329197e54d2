//! The evaluators of form against figures of known form, and against the published tables.

use haptimill_volumetric::Vector;
use haptimill_volumetric::gdt::*;
use proptest::prelude::*;
use std::f64::consts::TAU;

fn angles(count: u32) -> impl Iterator<Item = f64> {
    (0..count).map(move |step| TAU * f64::from(step) / f64::from(count))
}

/// Three lobes of 4 um on a circle of 54 mm: roundness 8 um, the same by both methods.
#[test]
fn circle_with_three_lobes() {
    let points: Vec<[f64; 2]> = angles(360)
        .map(|angle| {
            let radius = 54.0 + 0.004 * (3.0 * angle).cos();
            [3.0 + radius * angle.cos(), -2.0 + radius * angle.sin()]
        })
        .collect();
    let circle = fit_circle(&points).unwrap();
    assert!((circle.centre[0] - 3.0).abs() < 1e-6 && (circle.centre[1] + 2.0).abs() < 1e-6);
    assert!((circle.roundness() - 0.008).abs() < 1e-6);
    assert!((roundness_zone(&points).unwrap() - 0.008).abs() < 1e-6);
}

/// A plane with a step pattern of 2 um to either side.
#[test]
fn plane_with_steps() {
    let mut points = Vec::new();
    for i in -4..=4_i32 {
        for j in -4..=4 {
            let (x, y) = (20.0 * f64::from(i), 20.0 * f64::from(j));
            let step = 0.002 * f64::from((i * j).signum());
            points.push(Vector::new(x, y, 1e-4 * x + step));
        }
    }
    assert!((fit_plane(&points).unwrap().flatness() - 0.004).abs() < 1e-6);
    assert!((flatness_zone(&points).unwrap() - 0.004).abs() < 1e-6);
}

/// Two outer and two inner points that alternate fix the minimum zone at their distance, 4 um. More
/// points on one side within this zone draw the least squares fit away from it.
#[test]
fn zones_are_smaller_than_fits() {
    let crowd = || (1..=20).map(|step| 4.0 * f64::from(step) / 180.0 * std::f64::consts::PI);
    let ring = |z: f64, crowded: bool| -> Vec<Vector> {
        let place =
            |angle: f64, radius: f64| Vector::new(radius * angle.cos(), radius * angle.sin(), z);
        let four = (0..4).map(|quarter| {
            let off = if quarter % 2 == 0 { 0.002 } else { -0.002 };
            place(0.25 * TAU * f64::from(quarter), 15.0 + off)
        });
        let more = crowd().map(|angle| place(angle, 15.002));
        let more = more.take(if crowded { 20 } else { 0 });
        four.chain(more).collect()
    };
    let flat: Vec<[f64; 2]> = ring(0.0, true)
        .iter()
        .map(|point| [point.x, point.y])
        .collect();
    let (fit, zone) = (
        fit_circle(&flat).unwrap().roundness(),
        roundness_zone(&flat).unwrap(),
    );
    println!("circle {fit} {zone}");
    assert!((zone - 0.004).abs() < 1e-7 && fit > 0.0045);

    // The corners of a square, alternately 2 um up and down.
    let mut points: Vec<Vector> = [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)]
        .into_iter()
        .zip([0.002, -0.002, 0.002, -0.002])
        .map(|((x, y), z)| Vector::new(x, y, z))
        .collect();
    points.extend((1..=20).map(|step| Vector::new(2.0 * f64::from(step), 40.0, 0.002)));
    let (fit, zone) = (
        fit_plane(&points).unwrap().flatness(),
        flatness_zone(&points).unwrap(),
    );
    println!("plane {fit} {zone}");
    assert!((zone - 0.004).abs() < 1e-7 && fit > 0.0045);

    let points: Vec<Vector> = [(-10.0, false), (0.0, false), (10.0, true)]
        .into_iter()
        .flat_map(|(z, crowded)| ring(z, crowded))
        .collect();
    let (fit, zone) = (
        fit_cylinder(&points).unwrap().cylindricity(),
        cylindricity_zone(&points).unwrap(),
    );
    println!("cylinder {fit} {zone}");
    assert!((zone - 0.004).abs() < 1e-6 && fit > 0.0045);
}

/// A tilted cylinder.
#[test]
fn tilted_cylinder() {
    let mut points = Vec::new();
    for step in 0..7 {
        let z = -24.0 + 4.0 * f64::from(step);
        for angle in angles(36) {
            let (sine, cosine) = angle.sin_cos();
            points.push(Vector::new(
                52.0 + 1e-4 * z + 13.0 * cosine,
                -52.0 + 13.0 * sine,
                z,
            ));
        }
    }
    let cylinder = fit_cylinder(&points).unwrap();
    assert!((cylinder.axis.x - 1e-4).abs() < 1e-7 && (cylinder.radius - 13.0).abs() < 1e-5);
    assert!(cylinder.cylindricity() < 1e-6);
    assert!(cylindricity_zone(&points).unwrap() < 1e-6);
    // A barrel of 3 um.
    for point in &mut points {
        let bulge = 0.003 * (1.0 - ((point.z + 12.0) / 12.0).powi(2));
        let radial = Vector::new(point.x - 52.0, point.y + 52.0, 0.0).normalize();
        *point += radial * bulge;
    }
    assert!((cylindricity_zone(&points).unwrap() - 0.003).abs() < 1e-5);
}

/// Orientation and position against figures of known errors, by hand: a part that is turned by
/// 10 mrad on the measuring machine, whose sides are off by small angles in the part.
#[test]
fn orientation_and_position() {
    let turn = 0.01_f64;
    let placed = |[x, y]: [f64; 2]| {
        let (sine, cosine) = turn.sin_cos();
        [3.0 + cosine * x - sine * y, -2.0 + sine * x + cosine * y]
    };
    // 15 points over 140 mm from a point, in a direction by its angle from x.
    let side = |from: [f64; 2], angle: f64| -> Vec<[f64; 2]> {
        let (sine, cosine) = angle.sin_cos();
        let point = |step: i32| {
            let along = 10.0 * f64::from(step);
            placed([from[0] + along * cosine, from[1] + along * sine])
        };
        (-7..=7).map(point).collect()
    };
    let close = |value: f64, expected: f64| {
        assert!((value - expected).abs() < 1e-9, "{value} {expected}");
    };
    let datum = fit_line(&side([0.0, -80.0], 0.0)).unwrap();
    for off in [0.0_f64, 2e-5, -3e-5] {
        let range = 140.0 * off.sin().abs();
        close(
            perpendicularity(&side([80.0, 0.0], TAU / 4.0 + off), &datum),
            range,
        );
        close(parallelism(&side([0.0, 80.0], off), &datum), range);
        for nominal in [30.0_f64, 120.0, 210.0, 300.0] {
            let angle = nominal.to_radians();
            let (sine, cosine) = angle.sin_cos();
            let normal = [sine, -cosine];
            let from = normal.map(|part| 54.0 * part);
            close(angularity(&side(from, angle + off), normal, &datum), range);
        }
    }
    // A form error counts in an orientation: one point 4 um out of a side.
    let mut bent = side([0.0, 80.0], 0.0);
    bent[3][0] += 0.004 * -turn.sin();
    bent[3][1] += 0.004 * turn.cos();
    close(parallelism(&bent, &datum), 0.004);
    // A hole 3 um and 4 um off its place in the part: a zone of 10 um, however the part lies.
    let origin = placed([0.0, 0.0]);
    let hole = placed([52.003, -51.996]);
    close(
        position(in_datum(hole, origin, &datum), [52.0, -52.0]),
        0.010,
    );
    close(concentricity(hole, placed([52.0, -52.0])), 0.010);
    // An axis that leans by 30 urad and 40 urad over 50 mm: 2.5 um.
    close(
        axis_perpendicularity(Vector::new(3e-5, -4e-5, 1.0), 50.0),
        0.0025,
    );
}

/// Line fits of the published tables of a coordinate measuring machine.
#[test]
fn published_lines() {
    let tables = [
        ("X", include_str!("data/table_4_1_cmm_x_side.csv")),
        ("Y", include_str!("data/table_4_2_cmm_y_side.csv")),
    ];
    let rows = |text: &'static str| {
        let mut reader = csv::ReaderBuilder::new()
            .comment(Some(b'#'))
            .from_reader(text.as_bytes());
        let records = reader.records().map(|record| {
            let record = record.unwrap();
            record.iter().map(str::to_string).collect::<Vec<_>>()
        });
        records.collect::<Vec<_>>()
    };
    let number = |text: &str| text.parse::<f64>().unwrap();
    let expected = rows(include_str!("data/derived_line_fits.csv"));
    let residuals = rows(include_str!("data/derived_residuals.csv"));
    let mut checked = 0;
    for (side, text) in tables {
        let table = rows(text);
        for run in 0..4 {
            let points: Vec<[f64; 2]> = table
                .iter()
                .map(|row| {
                    let runs = [number(&row[1]), number(&row[2]), number(&row[3])];
                    let mean = runs.iter().sum::<f64>() / 3.0;
                    [number(&row[0]), runs.get(run).copied().unwrap_or(mean)]
                })
                .collect();
            let line = fit_line(&points).unwrap();
            let name = if run < 3 {
                format!("run{}", run + 1)
            } else {
                "mean".to_string()
            };
            let row = expected
                .iter()
                .find(|row| row[0] == side && row[1] == name)
                .unwrap();
            assert!((line.slope - number(&row[2])).abs() < 1e-9, "{side} {name}");
            // The table states five decimals.
            let offset = line.offset - number(&row[4]);
            assert!(offset.abs() < 1e-5, "{side} {name} {offset}");
            let squares: f64 = line.residuals.iter().map(|off| off * off).sum();
            let deviation = (squares / (line.residuals.len() - 1) as f64).sqrt();
            assert!(
                (deviation * 1e3 - number(&row[5])).abs() < 0.001,
                "{side} {name} {deviation}"
            );
            assert!((line.straightness() * 1e3 - number(&row[8])).abs() < 0.001);
            assert!((straightness_zone(&points) * 1e3 - number(&row[9])).abs() < 0.001);
            for (at, residual) in line.residuals.iter().enumerate() {
                let row = residuals
                    .iter()
                    .filter(|row| row[0] == side)
                    .nth(at)
                    .unwrap();
                assert!((residual * 1e3 - number(&row[2 + run])).abs() < 0.001);
                checked += 1;
            }
        }
    }
    assert_eq!(checked, 2 * 4 * 15);
}

/// Too few points are an error and no number.
#[test]
fn undetermined() {
    assert!(fit_line(&[[1.0, 2.0], [1.0, 3.0]]).is_err());
    assert!(fit_circle(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]).is_err());
    assert!(fit_plane(&[Vector::zeros(), Vector::x(), Vector::x() * 2.0]).is_err());
    assert!(fit_cylinder(&[Vector::zeros(); 4]).is_err());
}

proptest! {
    /// A minimum zone is never larger than the range of the least squares fit, and no smaller than
    /// what a search around the fit finds.
    #[test]
    fn zones_are_smallest(
        noise in prop::collection::vec(-3e-3..3e-3_f64, 24),
        shift in prop::array::uniform2(-2e-3..2e-3_f64),
    ) {
        let points: Vec<[f64; 2]> = angles(24)
            .zip(&noise)
            .map(|(angle, noise)| {
                let radius = 15.0 + noise;
                [radius * angle.cos(), radius * angle.sin()]
            })
            .collect();
        let circle = fit_circle(&points).unwrap();
        let zone = roundness_zone(&points).unwrap();
        prop_assert!(zone <= circle.roundness() + 1e-12);
        let centre = [circle.centre[0] + shift[0], circle.centre[1] + shift[1]];
        let radii: Vec<f64> = points
            .iter()
            .map(|point| (point[0] - centre[0]).hypot(point[1] - centre[1]))
            .collect();
        prop_assert!(zone <= range(&radii) + 1e-9);
    }

    /// The flatness zone does not depend on where the plane is or how it is turned.
    #[test]
    fn flatness_is_invariant(
        heights in prop::collection::vec(-5e-3..5e-3_f64, 25),
        tilt in prop::array::uniform2(-1e-2..1e-2_f64),
    ) {
        let grid = (0..25).map(|at| (f64::from(at % 5) * 10.0, f64::from(at / 5) * 10.0));
        let level: Vec<Vector> =
            grid.zip(&heights).map(|((x, y), z)| Vector::new(x, y, *z)).collect();
        let turn = nalgebra::Rotation3::from_euler_angles(tilt[0], tilt[1], 0.3);
        let turned: Vec<Vector> =
            level.iter().map(|point| turn * point + Vector::new(100.0, -50.0, 3.0)).collect();
        let (a, b) = (flatness_zone(&level).unwrap(), flatness_zone(&turned).unwrap());
        prop_assert!((a - b).abs() < 1e-7, "{} {}", a, b);
        prop_assert!(a <= fit_plane(&level).unwrap().flatness() + 1e-12);
    }
}
