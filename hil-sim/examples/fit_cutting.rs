//! Fits the cutting coefficients, the radius of the edge and the helix to the forces that the
//! thesis states for E1, E2 and E7 (docs/control.md 4.1), and prints the residuals:
//! `cargo run --release -p haptimill-hil-sim --example fit_cutting`.
//!
//! No other experiment enters: E3 to E6 and E8 to E12 are held out. The model is the static one of
//! docs/control.md 5.1 in a slot, with the chip thickness h = f_t sin(Psi) sin(kappa) and the onset
//! of the edge force over one edge radius. A result costs the logarithm of its squared distance
//! from its band (kept a margin inside; a row that the model cannot reach must not move the
//! others), and a small part of the squared distance from a stated value. The search (Nelder and
//! Mead) starts from several points, which a fixed sequence gives: same input, same fit.
//!
//! Physical limits: no coefficient is negative; the edge force along the cut is the friction of the
//! radial one, of polyethylene on steel ([`FRICTION`]), and there is none along the edge; the
//! radius of the edge is at least that of a sharp mill.
//!
//! Units: mm, N, mm/s, N/mm^2 and N/mm.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

const RADIUS: f64 = 4.0;
const TEETH: usize = 2;
const TURNS_PER_S: f64 = 5000.0 / 60.0;
/// Slices of the ball, and angles in a revolution.
const SLICES: usize = 32;
const ANGLES: usize = 60;
/// Distance that a result should keep from the end of its band, N.
const MARGIN: f64 = 0.3;
/// Weight of the distance from a stated value.
const POINT_WEIGHT: f64 = 0.03;

/// Friction of polyethylene on steel: tangential over radial edge force.
const FRICTION: f64 = 0.2;
/// Smallest and largest radius of the edge, um, and largest helix, degrees.
const EDGE_UM: [f64; 2] = [5.0, 15.0];
const HELIX_DEG: f64 = 45.0;
/// Starts of the search.
const STARTS: usize = 24;

/// Tangential, radial, axial coefficients; their edge forces; edge radius, um; helix, degrees.
type Material = [f64; 8];

const NAMES: [&str; 8] = [
    "tangential",
    "radial",
    "axial",
    "tangential_edge",
    "radial_edge",
    "axial_edge",
    "edge_onset_um",
    "helix_deg",
];

/// Plant P1 of docs/control.md 5.2 with the edge radius of decision 0017.
const P1: Material = [60.5, 82.6, 32.1, 0.118, 0.706, 0.014, 6.0, 30.0];

/// What the search varies: the three coefficients, the radial edge force, edge radius, helix.
type Point = [f64; 6];

const fn material(point: &Point) -> Material {
    let [tangential, radial, axial, edge, onset, helix] = *point;
    let friction = FRICTION * edge;
    [tangential, radial, axial, friction, edge, 0.0, onset, helix]
}

/// Peak and low force of a revolution, as the controller defines them.
#[derive(Clone, Copy)]
struct Forces {
    peak: [f64; 3],
    low: [f64; 3],
}

/// Forces on the tool in a slot towards -X.
fn slot(material: &Material, feed: f64, depth: f64) -> Forces {
    let [tangential, radial, axial, te, re, ae, onset_um, helix] = *material;
    let per_tooth = feed / (TEETH as f64 * TURNS_PER_S);
    let tan_helix = (helix * PI / 180.0).tan();
    // Sine and cosine of kappa, lag of the edge, width of the chip, length of the edge.
    let mut slices = Vec::new();
    let step = FRAC_PI_2 / SLICES as f64;
    let height = |k: f64| RADIUS * (1.0 - (k * step).cos());
    for k in 0..SLICES {
        let (below, above) = (height(k as f64), height(k as f64 + 1.0));
        let share = ((depth - below) / (above - below)).clamp(0.0, 1.0);
        if share > 0.0 {
            let middle = k as f64 + 0.5;
            let (sin, cos) = (middle * step).sin_cos();
            let turn = tan_helix * sin * sin;
            let width = RADIUS * step * share;
            let lag = height(middle) * tan_helix / RADIUS;
            slices.push((sin, cos, lag, width, width * turn.hypot(1.0)));
        }
    }
    let shank = (depth - RADIUS).max(0.0) / 8.0;
    for k in 0..8 {
        let lag = (RADIUS + (f64::from(k) + 0.5) * shank) * tan_helix / RADIUS;
        slices.push((1.0, 0.0, lag, shank, shank * tan_helix.hypot(1.0)));
    }

    let mut max = [f64::NEG_INFINITY; 3];
    let mut min = [f64::INFINITY; 3];
    for i in 0..ANGLES {
        let mut force = [0.0; 3];
        for tooth in 0..TEETH {
            let turns = i as f64 / ANGLES as f64 + tooth as f64 / TEETH as f64;
            for &(sin_kappa, cos_kappa, lag, width, edge) in &slices {
                let (sin, cos) = (turns * TAU - lag).sin_cos();
                let chip = -per_tooth * sin * sin_kappa;
                if chip <= 0.0 {
                    continue;
                }
                let eased = (chip / (onset_um * 1e-3)).min(1.0) * edge;
                let r = radial * chip * width + re * eased;
                let t = tangential * chip * width + te * eased;
                let a = axial * chip * width + ae * eased;
                let inward = r * sin_kappa + a * cos_kappa;
                force[0] -= inward * sin + t * cos;
                force[1] -= inward * cos - t * sin;
                force[2] += r * cos_kappa - a * sin_kappa;
            }
        }
        for axis in 0..3 {
            max[axis] = f64::max(max[axis], force[axis]);
            min[axis] = f64::min(min[axis], force[axis]);
        }
    }
    let (mut peak, mut low) = (max, min);
    for axis in 0..3 {
        if min[axis].abs() > max[axis].abs() {
            (peak[axis], low[axis]) = (min[axis], max[axis]);
        }
    }
    Forces { peak, low }
}

/// A result, its band, and the value that the thesis states.
struct Row {
    name: &'static str,
    value: f64,
    band: [f64; 2],
    stated: Option<f64>,
}

impl Row {
    fn is_inside(&self) -> bool {
        (self.band[0]..=self.band[1]).contains(&self.value)
    }

    fn cost(&self) -> f64 {
        let [low, high] = self.band;
        let margin = MARGIN.min(0.2 * (high - low));
        let beyond = (low + margin - self.value)
            .max(self.value - high + margin)
            .max(0.0);
        let point = self.stated.map_or(0.0, |stated| self.value - stated);
        let missed = beyond / MARGIN;
        MARGIN * MARGIN * (missed * missed).ln_1p() + POINT_WEIGHT * point * point
    }
}

/// The force rows of E1, E2 and E7 that a static model has (no rise times, no ripple).
fn rows(material: &Material) -> Vec<Row> {
    const NONE: f64 = f64::INFINITY;
    let [slow, middle, fast] = [2.0, 6.0, 10.0].map(|feed| slot(material, feed, 2.0));
    let [one, three, five] = [1.0, 3.0, 5.0].map(|depth| slot(material, 2.0, depth));
    let e7 = slot(material, 4.0, 2.0);
    let largest_low = |runs: [Forces; 3], axis: usize| {
        let sizes = runs.map(|run| run.low[axis].abs());
        sizes[0].max(sizes[1]).max(sizes[2])
    };
    let row = |name, value, low, high, stated| Row {
        name,
        value,
        band: [low, high],
        stated,
    };
    let within = |name, value, low, high| row(name, value, low, high, None);
    let low_y = |run: Forces| run.low[1].abs();
    vec![
        row("e1 Fx, 2 mm/s", slow.peak[0], 2.0, 4.0, Some(3.0)),
        row("e1 Fx, 6 mm/s", middle.peak[0], 5.0, 9.0, Some(7.0)),
        row(
            "e1 Fx, 6 mm/s, settled",
            middle.peak[0],
            3.5,
            6.5,
            Some(5.0),
        ),
        row("e1 Fx, 10 mm/s", fast.peak[0], 9.0, 15.0, Some(12.0)),
        within("e1 low Fx", largest_low([slow, middle, fast], 0), 0.0, 4.0),
        within("e1 Fy, 2 mm/s", slow.peak[1], -NONE, 0.0),
        within("e1 Fy grows", slow.peak[1] - fast.peak[1], 0.5, NONE),
        within("e1 Fy at 3 s", slow.peak[1] - middle.peak[1], 0.5, NONE),
        within("e1 Fy at 6 s", middle.peak[1] - fast.peak[1], 0.5, NONE),
        row("e1 low Fy, 10 mm/s", low_y(fast), 1.0, 3.0, Some(2.0)),
        within("e1 Fz, 2 mm/s", slow.peak[2], 3.0, 7.0),
        within("e1 Fz, 10 mm/s", fast.peak[2], 3.0, 7.0),
        within("e1 low Fz", largest_low([slow, middle, fast], 2), 0.0, 1.0),
        within("e2 Fx, 1 to 3 mm", three.peak[0] - one.peak[0], 0.5, NONE),
        within("e2 Fx, 3 to 5 mm", five.peak[0] - three.peak[0], 0.5, NONE),
        within("e2 low Fx", largest_low([one, three, five], 0), 0.0, 4.0),
        within("e2 Fy, 1 mm", one.peak[1], -NONE, 0.0),
        within("e2 Fy, 1 to 3 mm", one.peak[1] - three.peak[1], 0.5, NONE),
        within("e2 Fy, 3 to 5 mm", three.peak[1] - five.peak[1], 0.5, NONE),
        within("e2 low Fy, 1 mm", low_y(one), 1.0, 3.0),
        within("e2 low Fy, 3 mm", low_y(three), 1.0, 3.0),
        within("e2 low Fy, 5 mm", low_y(five), 1.0, 3.0),
        within("e2 Fz, 1 mm", one.peak[2], 3.0, 7.0),
        within("e2 Fz, 3 mm", three.peak[2], 3.0, 7.0),
        within("e2 Fz, 5 mm", five.peak[2], 3.0, 7.0),
        within(
            "e2 Fz, 5 mm less the larger of 1 and 3 mm",
            five.peak[2] - one.peak[2].max(three.peak[2]),
            0.0,
            NONE,
        ),
        row("e7 Fx", e7.peak[0], 4.0, 8.0, Some(6.0)),
        within("e7 Fx, largest", e7.peak[0], 5.0, NONE),
        within("e7 size of Fy", -e7.peak[1], 5.0, 6.0),
        within("e7 Fz", e7.peak[2], 5.0, 6.0),
    ]
}

fn cost(point: &Point) -> f64 {
    let [.., onset, helix] = *point;
    let physical = point.iter().all(|value| *value >= 0.0);
    if !physical || !(EDGE_UM[0]..=EDGE_UM[1]).contains(&onset) || helix > HELIX_DEG {
        return f64::INFINITY;
    }
    rows(&material(point)).iter().map(Row::cost).sum()
}

/// Nelder and Mead's search from a start.
fn search(start: Point, steps: usize) -> (Point, f64) {
    let along = |from: &Point, to: &Point, part: f64| {
        let point: Point = std::array::from_fn(|i| from[i] + part * (to[i] - from[i]));
        (point, cost(&point))
    };
    let mut simplex = vec![(start, cost(&start))];
    for i in 0..start.len() {
        let mut point = start;
        point[i] += if point[i].abs() > 1e-3 {
            0.3 * point[i]
        } else {
            0.1
        };
        simplex.push((point, cost(&point)));
    }
    let last = start.len();
    for _ in 0..steps {
        simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
        let (best, worst) = (simplex[0], simplex[last]);
        let centre: Point = std::array::from_fn(|i| {
            simplex[..last].iter().map(|point| point.0[i]).sum::<f64>() / last as f64
        });
        let reflected = along(&centre, &worst.0, -1.0);
        if reflected.1 < best.1 {
            let expanded = along(&centre, &worst.0, -2.0);
            simplex[last] = if expanded.1 < reflected.1 {
                expanded
            } else {
                reflected
            };
        } else if reflected.1 < simplex[last - 1].1 {
            simplex[last] = reflected;
        } else {
            let contracted = along(&centre, &worst.0, 0.5);
            if contracted.1 < worst.1 {
                simplex[last] = contracted;
            } else {
                for point in &mut simplex[1..] {
                    *point = along(&best.0, &point.0, 0.5);
                }
            }
        }
    }
    simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
    simplex[0]
}

/// Prints a material with the residual of each row: its distance from its band.
fn print(title: &str, material: &Material) {
    let rows = rows(material);
    let inside = rows.iter().filter(|row| row.is_inside()).count();
    println!("{title}: {inside} of {} rows inside", rows.len());
    for (name, value) in NAMES.iter().zip(material) {
        println!("  {name} = {value:.3}");
    }
    for row in rows {
        let [low, high] = row.band;
        let residual = (row.value - high).max(0.0) - (low - row.value).max(0.0);
        let stated = row
            .stated
            .map_or(String::new(), |stated| format!(" stated {stated}"));
        println!(
            "  {:42} {:7.2} [{low}, {high}] residual {residual:.2}{stated}",
            row.name, row.value
        );
    }
}

fn main() {
    // Points of a box, evenly spread by the powers of an irrational number.
    let spread = |k: usize, axis: usize| {
        let step = 1.19_f64.powi(-(axis as i32 + 1));
        (0.5 + step * (k + 1) as f64).fract()
    };
    let low = [30.0, 15.0, 0.0, 0.3, EDGE_UM[0], 0.0];
    let high = [120.0, 100.0, 20.0, 1.8, 9.0, 30.0];
    let mut best = (low, f64::INFINITY);
    for k in 0..STARTS {
        let start: Point = std::array::from_fn(|axis| {
            low[axis] + (0.1 + 0.8 * spread(k, axis)) * (high[axis] - low[axis])
        });
        let mut found = (start, f64::INFINITY);
        for _ in 0..4 {
            found = search(found.0, 350);
        }
        if found.1 < best.1 {
            best = found;
        }
    }
    print("P1", &P1);
    print("fitted to e1, e2 and e7", &material(&best.0));
    println!("cost {:.4}", best.1);
}
