//! Forces of the mill against a plain integration of the equations of docs/control.md.

use crate::mill;
use haptimill_hil_sim::process::{Coefficients, CutterConfig};
use mill::{Bench, block, config};
use std::f64::consts::{PI, TAU};

/// Returns the part of the circle in the material, by immersion angle and radius.
type Engaged = dyn Fn(f64, f64) -> bool;

/// Mean force on the tool over a revolution in steady feed along +x, by quadrature over height and
/// immersion. The lag of the edges has no effect on the mean, so no tooth is followed. Equations of
/// docs/control.md 5.1: dS from R'(psi), db = dz / sin kappa, h = f_t sin Psi sin kappa. `onset` is
/// the chip thickness at which the edge force is full; 0 is the equation as it stands there.
fn mean_of_equations(
    cutter: &CutterConfig,
    depth: f64,
    per_tooth: f64,
    onset: f64,
    engaged: &Engaged,
) -> [f64; 3] {
    let k = cutter.coefficients;
    let r0 = cutter.radius_mm;
    let cot = 1.0 / (cutter.helix_deg * PI / 180.0).tan();
    let (heights, angles) = (4000, 720);
    let mut sum = [0.0; 3];
    for level in 0..heights {
        // Levels are dense at the tip, where dS has an integrable pole.
        let (low, high) = (
            depth * (f64::from(level) / f64::from(heights)).powi(2),
            depth * (f64::from(level + 1) / f64::from(heights)).powi(2),
        );
        let (z, dz) = (0.5 * (low + high), high - low);
        let psi = z / (r0 * cot);
        let on_shank = z > r0;
        let along = psi * cot - 1.0;
        let r = if on_shank {
            r0
        } else {
            r0 * (1.0 - along * along).sqrt()
        };
        let r_slope = if on_shank {
            0.0
        } else {
            -r0 * along * cot / (1.0 - along * along).sqrt()
        };
        let ds = (r_slope * r_slope + r * r + r0 * r0 * cot * cot).sqrt() * dz / (r0 * cot);
        let kappa = (r / r0).min(1.0).asin();
        let db = dz / kappa.sin();
        for step in 0..angles {
            let immersion = (f64::from(step) + 0.5) * PI / f64::from(angles);
            if !engaged(immersion, r) {
                continue;
            }
            let h = per_tooth * immersion.sin() * kappa.sin();
            let edge = if h < onset { ds * h / onset } else { ds };
            let (dr, dt, da) = (
                k.radial_edge * edge + k.radial * h * db,
                k.tangential_edge * edge + k.tangential * h * db,
                k.axial_edge * edge + k.axial * h * db,
            );
            let (sin, cos) = immersion.sin_cos();
            let weight = cutter.teeth as f64 / TAU * PI / f64::from(angles);
            sum[0] += weight * (-kappa.sin() * sin * dr - cos * dt - kappa.cos() * sin * da);
            sum[1] += weight * (-kappa.sin() * cos * dr + sin * dt - kappa.cos() * cos * da);
            sum[2] += weight * (kappa.cos() * dr - kappa.sin() * da);
        }
    }
    sum
}

/// Forces of a slot along a direction, in axes whose x is the feed direction.
fn slot(coefficients: Coefficients, depth: f64, feed: f64, heading: [f64; 2]) -> Vec<[f64; 3]> {
    let config = config(block(-9.0, 9.0, -9.0, 9.0), coefficients);
    let mut bench = Bench::new(&config, [0.0, 0.0, 1.0]);
    bench.line([0.0, 0.0, -depth], 5.0);
    let cuts = bench.line([heading[0] * 3.0, heading[1] * 3.0, -depth], feed);
    cuts[cuts.len() - 4 * mill::TURN..]
        .iter()
        .map(|cut| {
            let [x, y, z] = cut.force;
            [
                x * heading[0] + y * heading[1],
                y * heading[0] - x * heading[1],
                z,
            ]
        })
        .collect()
}

fn mean_of(forces: &[[f64; 3]]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for force in forces {
        for (total, part) in sum.iter_mut().zip(force) {
            *total += part / forces.len() as f64;
        }
    }
    sum
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b) * (a - b))
        .sum::<f64>()
        .sqrt()
}

#[test]
fn slot_has_the_mean_force_of_the_printed_equations() {
    for coefficients in [Coefficients::P1, Coefficients::P2] {
        for (depth, feed) in [(1.0, 2.0), (2.0, 4.0), (2.0, 10.0), (3.0, 2.0), (5.0, 6.0)] {
            let cutter = CutterConfig {
                coefficients,
                ..CutterConfig::default()
            };
            let per_tooth = feed / (mill::RPM / 60.0 * 2.0);
            let all: &Engaged = &|_, _| true;
            let printed = mean_of_equations(&cutter, depth, per_tooth, 0.0, all);
            let eased = mean_of_equations(&cutter, depth, per_tooth, cutter.edge_onset_mm, all);
            let size = distance(printed, [0.0; 3]);
            for heading in [[1.0, 0.0], [-1.0, 0.0], [0.6, -0.8]] {
                let ours = mean_of(&slot(coefficients, depth, feed, heading));
                let case = format!("{depth} mm, {feed} mm/s, {heading:?}: {ours:?}");
                let off = distance(ours, eased) / size;
                // The chip is thinner at the free surface, by half its thickness times cos kappa;
                // the equation neglects that.
                assert!(off < 0.006, "{case}, with onset {eased:?}: {off}");
                let off = distance(ours, printed) / size;
                assert!(off < 0.05, "{case}, printed {printed:?}: {off}");
            }
        }
    }
}

/// Peaks over a revolution of a slot towards -x. docs/control.md 5.2 has them from another model
/// (midpoint slices, no map, no memory).
#[test]
fn slot_has_the_peaks_that_the_coefficients_were_fitted_with() {
    for (coefficients, table) in [
        (
            Coefficients::P1,
            [
                (2.0, 3.6, Some(-3.0), Some(3.3)),
                (4.0, 5.6, Some(-4.8), Some(4.3)),
                (6.0, 7.6, Some(-6.7), Some(5.3)),
                (10.0, 11.7, Some(-10.4), Some(7.3)),
            ],
        ),
        (
            Coefficients::P2,
            [
                (2.0, 2.5, None, None),
                (4.0, 4.9, None, None),
                (6.0, 7.4, None, None),
                (10.0, 12.3, None, None),
            ],
        ),
    ] {
        for (feed, x, y, z) in table {
            let forces = slot(coefficients, 2.0, feed, [-1.0, 0.0]);
            // `slot` turns the feed into +x.
            let peak = |value: &dyn Fn(&[f64; 3]) -> f64| {
                forces.iter().map(value).fold(f64::NEG_INFINITY, f64::max)
            };
            let ours = peak(&|force| -force[0]);
            assert!(
                (ours - x).abs() < 0.02 * x + 0.05,
                "{feed} mm/s: Fx {ours}, {x}"
            );
            if let Some(y) = y {
                let ours = -peak(&|force| force[1]);
                assert!((ours - y).abs() < 0.1, "{feed} mm/s: Fy {ours}, {y}");
            }
            if let Some(z) = z {
                // The tip has finer slices here; the first slice of the other model has the axial
                // edge force at its middle.
                let ours = peak(&|force| force[2]);
                assert!((ours - z).abs() < 0.5, "{feed} mm/s: Fz {ours}, {z}");
            }
        }
    }
}
