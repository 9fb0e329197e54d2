//! Grinding on a lap: forces and removal against the equations of the model, in closed form.

use haptimill_hil_sim::polyhedron::Polyhedron;
use haptimill_hil_sim::process::grinding::{Grinding, HardSpot, LapConfig};
use haptimill_hil_sim::vector::Vector;

const PERIOD_S: f64 = 2e-4;
/// Stone upside down: its z points to the lap.
const DOWN: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
const RADIUS: f64 = 45.0;

/// A block of 2 x 3 mm whose face is 5 mm below the tip.
fn stone() -> Polyhedron {
    Polyhedron::block([-1.0, -1.5, -5.0], [1.0, 1.5, 5.0], usize::MAX)
}

fn lap() -> LapConfig {
    LapConfig {
        preston_mm2_n: 4e-5,
        bed_n_mm3: 100.0,
        friction: 0.0,
        ..LapConfig::default()
    }
}

/// Turns of the lap in a period, at 600 rev/min.
const TURNS: f64 = 10.0 * PERIOD_S;
/// Speed under the stone, mm/s.
const SPEED: f64 = core::f64::consts::TAU * RADIUS * 10.0;

/// A stone held 5 um below the surface: the force is E A d, and d falls with the rate K E v.
#[test]
fn a_held_stone_sparks_out_with_the_rate_of_preston() {
    let mut grinding = Grinding::new(lap(), stone()).unwrap();
    let depth = 5e-3;
    let tip = [RADIUS, 0.0, 5.0 - depth];
    let rate = 4e-5 * 100.0 * SPEED;
    for period in 0..2000 {
        let force = grinding.step(tip, &DOWN, TURNS).force;
        let left = depth * (-rate * PERIOD_S * f64::from(period)).exp();
        // The area is known from the first removal on.
        if period > 2 {
            let expected = 100.0 * 6.0 * left;
            assert!(
                (force[2] - expected).abs() < 1e-6 + 1e-3 * expected,
                "{period} {force:?}"
            );
        }
    }
    grinding.lift_off();
    let low = grinding.stone().reach([0.0, 0.0, 1.0]);
    let left = depth * (-rate * PERIOD_S * 2000.0).exp();
    assert!((low - (5.0 - depth + left)).abs() < 1e-6, "{low}");
}

/// In steady feed w the stone is w / (K E v) deep, whatever the area.
#[test]
fn the_force_of_a_feed_is_that_of_the_steady_state() {
    let mut grinding = Grinding::new(lap(), stone()).unwrap();
    let feed = 0.05;
    let mut force = [0.0; 3];
    for period in 0..10_000 {
        let z = 5.0 - feed * PERIOD_S * f64::from(period);
        force = grinding.step([RADIUS, 0.0, z], &DOWN, TURNS).force;
    }
    let depth = feed / (4e-5 * 100.0 * SPEED);
    let expected = 100.0 * 6.0 * depth;
    assert!(
        (force[2] - expected).abs() < 2e-3 * expected,
        "{force:?} {expected}"
    );
}

/// A lap at standstill removes nothing; friction acts against its motion.
#[test]
fn nothing_is_removed_without_speed() {
    let config = LapConfig {
        friction: 0.25,
        ..lap()
    };
    let mut grinding = Grinding::new(config, stone()).unwrap();
    let tip = [RADIUS, 0.0, 4.999];
    for _ in 0..100 {
        grinding.step(tip, &DOWN, 0.0);
    }
    grinding.lift_off();
    assert!((grinding.stone().reach([0.0, 0.0, 1.0]) - 5.0).abs() < 1e-9);
    let mut grinding = Grinding::new(config, stone()).unwrap();
    for turns in [TURNS, -TURNS] {
        for _ in 0..5 {
            let force = grinding.step(tip, &DOWN, turns).force;
            // The lap turns from x to y at a place on x.
            assert!(
                (force[1] - 0.25 * force[2] * turns.signum()).abs() < 1e-9,
                "{force:?}"
            );
            assert!(force[0].abs() < 1e-9);
        }
    }
}

/// The plane that is ground is that of the lap: a stone that leans by 3 degrees gets a facet of 3
/// degrees, whose depth is that of the tip.
#[test]
fn a_leaning_stone_gets_the_plane_of_the_lap() {
    let (s, c) = 3.0_f64.to_radians().sin_cos();
    let axes = [[c, 0.0, s], [0.0, -1.0, 0.0], [s, 0.0, -c]];
    let mut grinding = Grinding::new(lap(), stone()).unwrap();
    for period in 0..20_000 {
        let z = (5.06 - 0.08 * PERIOD_S * f64::from(period)).max(4.9);
        grinding.step([RADIUS, 0.0, z], &axes, TURNS);
    }
    grinding.lift_off();
    let plane = grinding.ground()[0].plane;
    let normal = [-s, 0.0, c];
    for (is, goal) in plane.normal.iter().zip(normal) {
        assert!((is - goal).abs() < 1e-9, "{plane:?}");
    }
    assert!((plane.distance - 4.9).abs() < 1e-6, "{plane:?}");
}

/// A hard spot stands proud while material is removed, and levels out in the spark-out.
#[test]
fn a_hard_spot_stands_proud_and_levels_out() {
    let proud = |spark_out: u32| {
        let mut grinding = Grinding::new(lap(), stone()).unwrap();
        grinding.set_hard_spot(Some(HardSpot {
            centre: [0.0, 0.0, 4.5],
            radius_mm: 0.6,
            part: 0.1,
        }));
        for period in 0..30_000 + spark_out {
            let z = (5.001 - 0.08 * PERIOD_S * f64::from(period)).max(4.7);
            grinding.step([RADIUS, 0.0, z], &DOWN, TURNS);
        }
        grinding.lift_off();
        grinding.ground()[0].proud_mm
    };
    // Only little time after the depth is reached at 3.76 s = period 18813.
    let (at_once, later) = (proud(0), proud(40_000));
    assert!(
        at_once > 1e-6 && later < 0.02 * at_once,
        "{at_once} {later}"
    );
}

/// A facet that is smaller than the hard spot is removed at the rate of the spot, and not stuck.
#[test]
fn a_facet_within_the_hard_spot_is_removed() {
    let mut grinding = Grinding::new(lap(), stone()).unwrap();
    grinding.set_hard_spot(Some(HardSpot {
        centre: [0.0, 0.0, 4.5],
        radius_mm: 10.0,
        part: 0.1,
    }));
    let depth = 5e-3;
    let tip = [RADIUS, 0.0, 5.0 - depth];
    for _ in 0..2000 {
        grinding.step(tip, &DOWN, TURNS);
    }
    grinding.lift_off();
    let low = grinding.stone().reach([0.0, 0.0, 1.0]);
    let left = depth * (-0.1 * 4e-5 * 100.0 * SPEED * PERIOD_S * 2000.0).exp();
    // The area, and with it the spot, is known from the first removal on.
    assert!((low - (5.0 - depth + left)).abs() < 0.01 * depth, "{low}");
}

/// A lap that wears is lower where it was ground, by the volume that it lost.
#[test]
fn a_lap_wears_where_it_grinds() {
    let config = LapConfig { wear: 0.1, ..lap() };
    let mut grinding = Grinding::new(config, stone()).unwrap();
    for period in 0..10_000 {
        let z = 5.0 - 0.05 * PERIOD_S * f64::from(period);
        grinding.step([RADIUS, 0.0, z], &DOWN, TURNS);
    }
    grinding.lift_off();
    let removed = stone().volume() - grinding.stone().volume();
    let width = 75.0 / grinding.wear().len() as f64;
    let lost: f64 = (grinding.wear().iter().enumerate())
        .map(|(cell, wear)| core::f64::consts::TAU * (cell as f64 + 0.5) * width * width * wear)
        .sum();
    assert!(
        (lost - 0.1 * removed).abs() < 1e-3 * lost,
        "{lost} {removed}"
    );
    assert_eq!(
        grinding.wear().iter().filter(|wear| **wear > 0.0).count(),
        1
    );
}

/// With a run-out a held stone is ground to the highest point of the lap: the force comes once per
/// turn and dies away.
#[test]
fn a_run_out_loads_the_stone_once_per_turn() {
    let config = LapConfig {
        run_out_mm: 0.02,
        ..lap()
    };
    let mut grinding = Grinding::new(config, stone()).unwrap();
    let tip = [RADIUS, 0.0, 4.99];
    let mut peaks = Vec::new();
    for _ in 0..20 {
        let mut peak = 0.0_f64;
        for _ in 0..500 {
            peak = peak.max(grinding.step(tip, &DOWN, TURNS).force[2]);
        }
        peaks.push(peak);
    }
    assert!(
        peaks.windows(2).all(|pair| pair[1] <= pair[0] + 1e-9),
        "{peaks:?}"
    );
    grinding.lift_off();
    let low = grinding.stone().reach([0.0, 0.0, 1.0]);
    // Near the end only the top of the wave touches, so the last part comes slowly.
    assert!((low - 4.99).abs() < 1e-3, "{low}");
}
