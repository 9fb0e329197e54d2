//! The cut surface and its measurement; the spindle; the elastic wall; refused configurations.

use crate::mill;
use haptimill_hil_sim::process::metrology::circle;
use haptimill_hil_sim::process::{
    Coefficients, CuttingConfig, ElasticWall, Spindle, SpindleConfig, ToolPose, Workpiece,
};
use mill::{Bench, block, config, with_slot};
use proptest::prelude::*;
use std::f64::consts::PI;

const R: f64 = 4.0;

#[test]
fn slot_and_circle_are_measured_as_cut() {
    let mut bench = with_slot(20.0, 2.0);
    bench.cutting.settle();
    let piece = bench.cutting.workpiece();
    let groove = piece
        .groove([-10.0, -6.0], [-10.0, 6.0], 0.1)
        .expect("a groove");
    let half = (R * R - (R - 1.9) * (R - 1.9)).sqrt();
    assert!(
        (groove.width() - 2.0 * half).abs() < 0.01,
        "{groove:?} {half}"
    );
    assert!((groove.depth - 2.0).abs() < 1e-3);
    let extents = piece.extents(0.1).expect("a slot");
    assert!((extents.x_min - (-20.0 - half)).abs() < 0.02, "{extents:?}");
    assert!((extents.x_max - half).abs() < 0.02);
    assert!((extents.y_max - half).abs() < 0.02 && (extents.y_min + half).abs() < 0.02);

    // The circle of the experiment: 30 mm, from (0, 0) towards -x and -y, here flattened by 0.3 mm
    // in y to test the measurement.
    let config = config(block(-36.0, 6.0, -21.0, 21.0), Coefficients::P2);
    let mut bench = Bench::new(&config, [0.0, 0.0, 1.0]);
    bench.line([0.0, 0.0, -2.0], 10.0);
    let steps = 12_000;
    for step in 1..=steps {
        let angle = 2.0 * PI * f64::from(step) / f64::from(steps);
        bench.step([-15.0 + 15.0 * angle.cos(), -14.85 * angle.sin(), -2.0]);
    }
    bench.cutting.settle();
    let ring = bench.cutting.workpiece().ring(0.1, 180).expect("a ring");
    assert!((ring.extent_x - 30.0).abs() < 0.01, "{ring:?}");
    assert!((ring.extent_y - 29.7).abs() < 0.01, "{ring:?}");
    assert!((ring.middle.centre[0] + 15.0).abs() < 0.005);
    assert!((ring.middle.roundness - 0.15).abs() < 0.02, "{ring:?}");
    assert!((ring.outer.radius - ring.inner.radius - 2.0 * half).abs() < 0.02);
    assert_eq!(bench.cutting.workpiece().missed(), 0);

    let picture = bench.cutting.workpiece().picture(200);
    assert!(picture.columns <= 200 && picture.rows <= 200);
    assert_eq!(picture.heights.len(), picture.columns * picture.rows);
    let sum: f64 = picture.depths.iter().map(|depth| f64::from(*depth)).sum();
    let cell = (picture.area.x_max - picture.area.x_min) / picture.columns as f64;
    let volume = bench.cutting.workpiece().removed_mm3();
    assert!((sum * cell * cell / volume - 1.0).abs() < 0.02);
}

#[test]
fn leaving_the_map_is_reported() {
    let config = config(block(-5.0, 5.0, -5.0, 5.0), Coefficients::P2);
    let mut bench = Bench::new(&config, [0.0, 0.0, 1.0]);
    bench.line([0.0, 0.0, -1.0], 5.0);
    bench.line([-2.0, 0.0, -1.0], 10.0);
    assert_eq!(bench.cutting.workpiece().missed(), 0);
    bench.line([-8.0, 0.0, -1.0], 10.0);
    assert!(bench.cutting.workpiece().missed() > 0);
}

#[test]
fn the_spindle_runs_up_and_stops() {
    let mut spindle = Spindle::new(
        &SpindleConfig {
            time_constant_s: 0.3,
        },
        mill::PERIOD,
    );
    let mut turns = 0.0;
    for _ in 0..7500 {
        turns += spindle.advance(5000.0);
    }
    // At 1.5 s the speed is n (1 - e^-5), and the angle n / 60 (t - T (1 - e^-5)).
    let left = (-5.0_f64).exp();
    assert!((spindle.rpm() - 5000.0 * (1.0 - left)).abs() < 1e-6);
    let exact = 5000.0 / 60.0 * (1.5 - 0.3 * (1.0 - left));
    assert!((turns - exact).abs() < 1e-3, "{turns} {exact}");
    spindle.set_stalled(true);
    spindle.advance(5000.0);
    assert_eq!(spindle.rpm(), 0.0);
    assert_eq!(spindle.advance(5000.0), 0.0);
    spindle.set_stalled(false);
    for _ in 0..50_000 {
        spindle.advance(0.0);
    }
    assert_eq!(spindle.rpm(), 0.0);
}

#[test]
fn an_elastic_wall_pushes_and_never_pulls() {
    let wall = ElasticWall {
        point: [-10.0, 0.0, 0.0],
        normal: [0.8, 0.0, 0.6],
        stiffness: 300.0,
        damping: 0.5,
        radius: R,
    };
    let pose = |depth: f64| {
        // The ball's point nearest to the face is centre - R n.
        let tip = [-10.0 + 0.8 * (R - depth), 3.0, 0.6 * (R - depth) - R];
        ToolPose::upright(tip)
    };
    assert_eq!(wall.force(&pose(-0.001), [-5.0, 0.0, 0.0]), [0.0; 3]);
    let force = wall.force(&pose(0.02), [0.0; 3]);
    assert!((force[0] - 0.8 * 6.0).abs() < 1e-9 && (force[2] - 0.6 * 6.0).abs() < 1e-9);
    assert!(force[1].abs() < 1e-12);
    let closing = wall.force(&pose(0.02), [-8.0, 0.0, -6.0]);
    assert!((closing[0] - 0.8 * (6.0 + 5.0)).abs() < 1e-9);
    assert_eq!(wall.force(&pose(0.02), [80.0, 0.0, 60.0]), [0.0; 3]);
}

#[test]
fn an_invalid_configuration_is_refused() {
    let mut config = CuttingConfig::default();
    assert!(config.check().is_ok());
    config.cutter.teeth = 0;
    config.cutter.radius_mm = f64::NAN;
    config.cutter.coefficients.radial = f64::INFINITY;
    config.workpiece.cell_mm = 1e-6;
    config.workpiece.map.x_max = config.workpiece.map.x_min;
    let problems = config.check().expect_err("invalid");
    for part in ["teeth", "radius_mm", "radial", "cell_mm", "map: x_max"] {
        assert!(
            problems.iter().any(|problem| problem.field.contains(part)),
            "{part}: {problems:?}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// After any sweeps every point of the map is exactly as low as the lowest ball that passed
    /// over it.
    #[test]
    fn the_surface_is_the_envelope_of_the_ball(
        places in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64, 2.0..7.0_f64), 2..6)
    ) {
        let mut shape = block(-8.0, 8.0, -8.0, 8.0);
        shape.cell_mm = 0.25;
        shape.bottom_mm = -20.0;
        let mut piece = Workpiece::new(&shape);
        let places: Vec<[f64; 3]> = places.iter().map(|(x, y, z)| [*x, *y, *z]).collect();
        piece.sweep(R, places[0], places[0]);
        for pair in places.windows(2) {
            piece.sweep(R, pair[0], pair[1]);
        }
        let [columns, rows] = piece.size();
        for row in (0..rows).step_by(5) {
            for column in (0..columns).step_by(5) {
                let [x, y] = piece.place(column, row);
                // Densely placed balls along the path.
                let mut lowest = 0.0_f64;
                for pair in places.windows(2) {
                    for step in 0..=400 {
                        let part = f64::from(step) / 400.0;
                        let at: [f64; 3] =
                            core::array::from_fn(|i| pair[0][i] + part * (pair[1][i] - pair[0][i]));
                        let square = R * R - (x - at[0]).powi(2) - (y - at[1]).powi(2);
                        if square > 0.0 {
                            lowest = lowest.min(at[2] - square.sqrt());
                        }
                    }
                }
                let ours = f64::from(piece.heights()[row * columns + column]);
                // Steps of 20 um: near a wall the dense balls are higher by the effect of the
                // slope.
                prop_assert!(ours <= lowest + 1e-5, "{ours} {lowest}");
                prop_assert!(ours > lowest - 0.15, "{ours} {lowest}");
            }
        }
    }

    /// The circle through points of a circle is that circle.
    #[test]
    fn circle_fit_is_exact(x in -50.0..50.0_f64, y in -50.0..50.0_f64, radius in 0.5..40.0_f64, part in 0.3..1.0_f64) {
        let points: Vec<[f64; 2]> = (0..60)
            .map(|k| {
                let angle = 2.0 * PI * part * f64::from(k) / 60.0;
                [x + radius * angle.cos(), y + radius * angle.sin()]
            })
            .collect();
        let fit = circle(&points).expect("a circle");
        prop_assert!((fit.centre[0] - x).abs() < 1e-6 && (fit.centre[1] - y).abs() < 1e-6);
        prop_assert!((fit.radius - radius).abs() < 1e-6 && fit.roundness < 1e-6);
    }
}
