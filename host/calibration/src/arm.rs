//! Calibration of the H-4 arm: its true lengths and the offsets of its joints, found by a fit to
//! the readings of a laser tracker. A parallel arm has no error functions of single axes; its table
//! of errors is what the fit leaves.

use crate::noise::Noise;
use haptimill_hil_sim::joint::mechanics::JointArray;
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_hil_sim::machines::h4::ArmGeometry;
use nalgebra::{DMatrix, DVector};

/// Parameters: length of the rods, half distance of the platform joints, offsets of rails and
/// carriages, x of the workpiece, and the offsets of the joints.
pub const NAMES: [&str; 9] = ["r", "c", "w", "ge", "x_off", "l1", "l2", "l3", "l4"];

/// A reading: joints as the controller reports them, and the tip that the tracker sees, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Joint positions, mm and degrees.
    pub joints: JointArray,
    /// The tip in work coordinates.
    pub tip: [f64; 3],
}

/// The geometry with changed parameters, and the joints with their offsets.
fn changed(
    nominal: &ArmGeometry,
    by: &[f64; NAMES.len()],
    joints: &JointArray,
) -> (ArmGeometry, JointArray) {
    let mut geometry = nominal.clone();
    let [r, c, w, ge, x_off, ..] = *by;
    geometry.r += r;
    geometry.c += c;
    geometry.w += w;
    geometry.ge += ge;
    geometry.x_off += x_off;
    let mut joints = *joints;
    joints
        .iter_mut()
        .zip(&by[5..])
        .for_each(|(joint, offset)| *joint += offset);
    (geometry, joints)
}

/// The tip of the arm with changed parameters; `None` where it cannot be assembled.
#[must_use]
pub fn tip(
    nominal: &ArmGeometry,
    by: &[f64; NAMES.len()],
    joints: &JointArray,
) -> Option<[f64; 3]> {
    let (geometry, joints) = changed(nominal, by, joints);
    let pose = GeometryConfig::H4(geometry).pose(&joints)?;
    Some([pose[0], pose[1], pose[2]])
}

/// Readings of an arm whose parameters differ, with noise of this standard deviation, mm.
#[must_use]
pub fn readings(
    nominal: &ArmGeometry,
    by: &[f64; NAMES.len()],
    poses: &[JointArray],
    deviation: f64,
    seed: u64,
) -> Vec<Reading> {
    let mut noise = Noise::new(seed, 4000);
    let seen = poses.iter().filter_map(|joints| {
        let tip = tip(nominal, by, joints)?.map(|place| place + noise.normal(deviation));
        Some(Reading {
            joints: *joints,
            tip,
        })
    });
    seen.collect()
}

/// A fitted arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Changes of the parameters from their nominal values, mm.
    pub by: [f64; NAMES.len()],
    /// Root mean square and largest distance of the readings from the arm, before and after, mm.
    pub before: [f64; 2],
    /// See `before`.
    pub after: [f64; 2],
}

/// Steps of Levenberg and Marquardt.
const STEPS: usize = 40;

/// Fits the parameters to readings; `None` where a reading cannot be reached.
#[must_use]
pub fn fit(nominal: &ArmGeometry, readings: &[Reading]) -> Option<Fit> {
    const N: usize = NAMES.len();
    let residuals = |by: &[f64; N]| -> Option<Vec<f64>> {
        let mut all = Vec::with_capacity(3 * readings.len());
        for reading in readings {
            let model = tip(nominal, by, &reading.joints)?;
            all.extend(
                reading
                    .tip
                    .iter()
                    .zip(model)
                    .map(|(seen, model)| seen - model),
            );
        }
        Some(all)
    };
    let cost = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>();
    let mut by = [0.0; N];
    let mut now = residuals(&by)?;
    let before = distances(&now);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let mut columns = Vec::with_capacity(N);
        for parameter in 0..N {
            const STEP: f64 = 1e-4;
            let mut moved = by;
            moved[parameter] += STEP;
            let moved = residuals(&moved)?;
            let slope = moved.iter().zip(&now).map(|(a, b)| (b - a) / STEP);
            columns.push(slope.collect::<Vec<f64>>());
        }
        let slopes = DMatrix::from_vec(now.len(), N, columns.concat());
        let mut matrix = slopes.tr_mul(&slopes);
        for parameter in 0..N {
            matrix[(parameter, parameter)] *= 1.0 + damping;
        }
        let step = matrix
            .lu()
            .solve(&slopes.tr_mul(&DVector::from_column_slice(&now)))?;
        let mut next = by;
        next.iter_mut()
            .zip(&step)
            .for_each(|(value, step)| *value += step);
        match residuals(&next) {
            Some(changed) if cost(&changed) < cost(&now) => {
                (by, now) = (next, changed);
                damping *= 0.2;
            }
            _ => damping *= 10.0,
        }
        if damping > 1e6 {
            break;
        }
    }
    Some(Fit {
        by,
        before,
        after: distances(&now),
    })
}

/// Root mean square and largest length of the vectors.
fn distances(residuals: &[f64]) -> [f64; 2] {
    let (vectors, _) = residuals.as_chunks::<3>();
    let squares = vectors
        .iter()
        .map(|v| v.iter().map(|part| part * part).sum::<f64>());
    let squares: Vec<f64> = squares.collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    [
        mean.sqrt(),
        squares.iter().fold(0.0_f64, |a, b| a.max(*b)).sqrt(),
    ]
}
