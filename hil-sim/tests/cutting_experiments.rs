//! The experiments without force control on a rigid machine: both material presets against the
//! stated values (docs/control.md 4.1, bands 4.2).
//!
//! `cargo test -p haptimill-hil-sim --test all cutting_experiments -- --nocapture` prints the
//! table.

use crate::mill;
use haptimill_hil_sim::process::{Coefficients, Cut};
use mill::{Bench, TURN, block, config, peaks};
use std::f64::consts::PI;

const PRESETS: [(&str, Coefficients); 2] = [("P1", Coefficients::P1), ("P2", Coefficients::P2)];

/// Returns the force of largest magnitude of each axis over the last revolutions, with its sign:
/// "high" of the experiments.
fn high(cuts: &[Cut]) -> [f64; 3] {
    let (max, min) = peaks(cuts, 8);
    core::array::from_fn(|i| if max[i] > -min[i] { max[i] } else { min[i] })
}

/// Returns the force nearest to the other side: "low" of the experiments.
fn low(cuts: &[Cut]) -> [f64; 3] {
    let (max, min) = peaks(cuts, 8);
    core::array::from_fn(|i| if max[i] > -min[i] { min[i] } else { max[i] })
}

fn show(what: &str, force: [f64; 3]) {
    println!(
        "  {what:<34} {:+6.2} {:+6.2} {:+6.2} N",
        force[0], force[1], force[2]
    );
}

/// E1: depth 2 mm, 2, 6, 10 mm/s for 3 s each towards -x. Stated: Fx 3 N, then 7 N just after the
/// step to 6 mm/s, 5 N later, 12 N after the step to 10.
#[test]
fn e1_feed_sweep() {
    for (name, coefficients) in PRESETS {
        println!("E1 {name}: high and low force");
        let mut bench = Bench::new(
            &config(block(-60.0, 6.0, -5.0, 5.0), coefficients),
            [0.0, 0.0, 1.0],
        );
        bench.line([0.0, 0.0, -2.0], 4.0);
        let mut ours = Vec::new();
        for (feed, end) in [(2.0, -6.0), (6.0, -24.0), (10.0, -54.0)] {
            let cuts = bench.line([end, 0.0, -2.0], feed);
            show(&format!("{feed} mm/s high"), high(&cuts));
            show(&format!("{feed} mm/s low"), low(&cuts));
            // From the new level, within the stated rise time of 0.2 s.
            let settled = high(&cuts[..1000]);
            assert!((settled[0] - high(&cuts)[0]).abs() < 0.02 * settled[0]);
            ours.push((high(&cuts), low(&cuts)));
        }
        // Bands 4.2: 3 +- 1, 7 +- 2, 12 +- 3 N; signs + - +.
        for ((force, _), (stated, band)) in ours.iter().zip([(3.0, 1.0), (7.0, 2.0), (12.0, 3.0)]) {
            assert!((force[0] - stated).abs() <= band, "{force:?} {stated}");
            assert!(force[1] < 0.0 && force[2] > 0.0);
        }
        // Fx low is at most 4 N towards -x. Fz high is 3 to 7 N; P2 misses this at 2 mm/s, and both
        // leave it slightly at 10 mm/s.
        assert!(ours.iter().all(|(_, low)| low[0].abs() <= 4.0));
        let z: Vec<f64> = ours.iter().map(|(high, _)| high[2]).collect();
        if name == "P1" {
            assert!(
                (3.0..=7.0).contains(&z[0]) && (3.0..=7.0).contains(&z[1]),
                "{z:?}"
            );
        } else {
            assert!(z[0] < 3.0, "{z:?}");
        }
        assert!(z[2] > 7.0 && z[2] < 8.5, "{z:?}");
    }
}

/// E2: 2 mm/s, depth 1, 3, 5 mm for 5 s each. Stated: Fx and -Fy grow with depth, Fz 3 to 7 N and
/// largest at 5 mm.
#[test]
fn e2_depth_sweep() {
    for (name, coefficients) in PRESETS {
        println!("E2 {name}: high and low force");
        let mut bench = Bench::new(
            &config(block(-36.0, 6.0, -5.0, 5.0), coefficients),
            [0.0, 0.0, 1.0],
        );
        let mut x = 0.0;
        let mut before = [0.0; 3];
        for depth in [1.0, 3.0, 5.0] {
            bench.line([x, 0.0, -depth], 4.0);
            x -= 10.0;
            let cuts = bench.line([x, 0.0, -depth], 2.0);
            let now = high(&cuts);
            show(&format!("{depth} mm high"), now);
            show(&format!("{depth} mm low"), low(&cuts));
            assert!(now[0] > before[0] && now[1] < before[1]);
            assert!(low(&cuts)[0].abs() <= 4.0);
            before = now;
        }
    }
}

/// E3: part tilted by 10 degrees, from 1 to 4.53 mm deep over 20 mm. Stated: the force grows along
/// the path, faster at 4 mm/s.
#[test]
fn e3_incline() {
    for (name, coefficients) in PRESETS {
        let mut rise = [0.0; 2];
        for (which, feed) in [2.0, 4.0].into_iter().enumerate() {
            println!("E3 {name} at {feed} mm/s: high force");
            let mut piece = block(-27.0, 7.0, -6.0, 6.0);
            piece.rise_x_deg = -10.0;
            let mut bench = Bench::new(&config(piece, coefficients), [0.0, 0.0, 3.0]);
            bench.line([0.0, 0.0, -1.0], 4.0);
            let mut first = 0.0;
            for x in [-0.0_f64, -5.0, -10.0, -15.0, -20.0] {
                let cuts = bench.line([x - 0.5, 0.0, -1.0], feed);
                if x == 0.0 {
                    bench.line([-0.9, 0.0, -1.0], feed);
                }
                show(&format!("x = {x} mm"), high(&cuts));
                if x == 0.0 {
                    first = high(&cuts)[0];
                }
                rise[which] = high(&cuts)[0] - first;
            }
        }
        assert!(rise[0] > 1.0 && rise[1] > 1.3 * rise[0], "{rise:?}");
    }
}

/// E7 and E9: slot and pocket at 4 mm/s, 2 mm deep, 2 mm aside. Stated for Fx: +6, then -3, then +5
/// N; Fy negative, then positive, at most 5; Fz at most 6.
#[test]
fn e9_pocket() {
    for (name, coefficients) in PRESETS {
        println!("E9 {name}: high force");
        let mut bench = Bench::new(
            &config(block(-36.0, 6.0, -10.0, 5.0), coefficients),
            [0.0, 0.0, 1.0],
        );
        bench.line([0.0, 0.0, -2.0], 4.0);
        let mut passes = Vec::new();
        for (x, y) in [(-30.0, 0.0), (0.0, -2.0), (-30.0, -4.0)] {
            let at = bench.at;
            if at[1] != y {
                let step = bench.line([at[0], y, -2.0], 1.0);
                show("step in y", high(&step));
            }
            let middle = 0.5 * (at[0] + x);
            let cuts = bench.line([middle, y, -2.0], 4.0);
            show(&format!("pass to x = {x}, y = {y}"), high(&cuts));
            passes.push(high(&cuts));
            bench.line([x, y, -2.0], 4.0);
        }
        // Pattern + - +, the second the smallest, the third not above the first by more than the
        // model's ripple.
        assert!(passes[0][0] > 0.0 && passes[1][0] < 0.0 && passes[2][0] > 0.0);
        assert!(-passes[1][0] < passes[2][0] && passes[2][0] < 1.05 * passes[0][0]);
        assert!(passes[0][1] < 0.0 && passes[1][1] > 0.0);
        bench.cutting.settle();
        let piece = bench.cutting.workpiece();
        let half = (16.0_f64 - 2.1 * 2.1).sqrt();
        let across = piece
            .groove([-15.0, -10.0], [-15.0, 5.0], 0.1)
            .expect("a pocket");
        println!(
            "  pocket: width {:.3}, depth {:.3}",
            across.width(),
            across.depth
        );
        assert!(
            (across.width() - (4.0 + 2.0 * half)).abs() < 0.02,
            "{across:?}"
        );
        assert!((across.depth - 2.0).abs() < 0.01);
        let extents = piece.extents(0.1).expect("a pocket");
        assert!((extents.x_max - extents.x_min - (30.0 + 2.0 * half)).abs() < 0.04);
    }
}

/// E11: circle of 30 mm at 4 mm/s. Stated: 30 x 29.5 mm; Fx 5 to 10 N and Fy at most 5 N, both
/// opposing the motion, Fx flips at 12 s.
#[test]
fn e11_circle() {
    for (name, coefficients) in PRESETS {
        println!("E11 {name}: high force");
        let mut bench = Bench::new(
            &config(block(-36.0, 6.0, -21.0, 21.0), coefficients),
            [0.0, 0.0, 1.0],
        );
        bench.line([0.0, 0.0, -2.0], 4.0);
        let steps = (30.0 * PI / 4.0 / mill::PERIOD).round() as usize;
        let mut cuts = Vec::new();
        for step in 1..=steps {
            let angle = 2.0 * PI * step as f64 / steps as f64;
            cuts.push(bench.step([-15.0 + 15.0 * angle.cos(), -15.0 * angle.sin(), -2.0]));
        }
        for (share, moving) in [
            (0.125, "-x -y"),
            (0.25, "-x"),
            (0.375, "-x +y"),
            (0.625, "+x +y"),
            (0.75, "+x"),
            (0.875, "+x -y"),
        ] {
            let end = (share * steps as f64) as usize;
            let force = high(&cuts[end - 10 * TURN..end]);
            show(&format!("moving {moving}"), force);
            // Fx opposes the motion in x where x is the main direction.
            if moving == "-x" || moving == "+x" {
                assert!((force[0] > 0.0) == (moving == "-x"), "{moving} {force:?}");
            }
        }
        bench.cutting.settle();
        let ring = bench.cutting.workpiece().ring(0.1, 180).expect("a ring");
        println!(
            "  {:.3} x {:.3} mm, roundness {:.4} mm",
            ring.extent_x, ring.extent_y, ring.middle.roundness
        );
        assert!((ring.extent_x - 30.0).abs() < 0.01 && (ring.extent_y - 30.0).abs() < 0.01);
        assert!(ring.middle.roundness < 0.01);
    }
}
