//! Slides of a pose in f64, for joint rates.

use super::{DEGREE, MM, rest};
use haptimill_protocol::message::AxisValues;
use haptimill_protocol::setpoint::Setpoint;

/// Maximum rate of a slide in machines/h4.toml, mm/s.
pub const LIMIT: f64 = 100.0;

/// Returns the slides of a pose (mm, degrees): docs/control.md (3.23) to (3.26), with the lengths
/// of machines/h4.toml.
pub fn slides(pose: &[f64; 5]) -> [f64; 4] {
    let (theta, alpha) = (pose[3].to_radians(), pose[4].to_radians());
    let x = pose[0] + 780.0 + 30.0;
    let y = pose[1] * alpha.cos() - pose[2] * alpha.sin();
    let z = pose[1] * alpha.sin() + pose[2] * alpha.cos() - 600.0;
    let slide = |s: f64, sigma: f64| {
        let m = 150.0 + 100.0 * (1.0 + sigma);
        let u = 250.0 - sigma * y;
        let v = -z - m * theta.cos() + sigma * 100.0 - 25.0;
        x + m * theta.sin() + s * (50.0 + (480.0_f64.powi(2) - u * u - v * v).sqrt())
    };
    [
        slide(1.0, 1.0),
        slide(-1.0, 1.0),
        slide(1.0, -1.0),
        slide(-1.0, -1.0),
    ]
}

/// Returns a tilt: each segment (periods) leads from the rate before to its own (degrees/s), by the
/// mean of both.
pub fn tilt(start: &AxisValues, spans: &[(u16, f64)]) -> Vec<Setpoint> {
    let (mut angle, mut before) = (f64::from(start[3]) / DEGREE, 0.0);
    spans
        .iter()
        .map(|&(periods, rate)| {
            angle += (before + rate) / 2.0 * f64::from(periods) * 2e-4;
            before = rate;
            let mut setpoint = rest(start, periods);
            setpoint.pose[3] = (angle * DEGREE) as i32;
            setpoint.rates[3] = (rate * DEGREE / 256.0) as i32;
            setpoint
        })
        .collect()
}

/// Returns the largest rate of a slide (mm/s) before each setpoint: the cubic Hermite polynomial of
/// the pose in 400 steps.
pub fn peak_rates(start: &AxisValues, setpoints: &[Setpoint]) -> Vec<f64> {
    let unit = |axis: usize| if axis < 3 { MM } else { DEGREE };
    let mut from: ([f64; 5], [f64; 5]) = (
        std::array::from_fn(|axis| f64::from(start[axis]) / unit(axis)),
        [0.0; 5],
    );
    setpoints
        .iter()
        .map(|setpoint| {
            let to: ([f64; 5], [f64; 5]) = (
                std::array::from_fn(|axis| f64::from(setpoint.pose[axis]) / unit(axis)),
                std::array::from_fn(|axis| f64::from(setpoint.rates[axis]) * 256.0 / unit(axis)),
            );
            let time = f64::from(setpoint.periods) * 2e-4;
            let at = |s: f64| {
                slides(&std::array::from_fn(|axis| {
                    let (p0, p1) = (from.0[axis], to.0[axis]);
                    let (m0, m1) = (from.1[axis] * time, to.1[axis] * time);
                    (2.0 * s * s * s - 3.0 * s * s + 1.0) * p0
                        + (s * s * s - 2.0 * s * s + s) * m0
                        + (3.0 * s * s - 2.0 * s * s * s) * p1
                        + (s * s * s - s * s) * m1
                }))
            };
            let mut max = 0.0_f64;
            for step in 0..=400 {
                let s = f64::from(step) / 400.0;
                let (back, ahead) = (at(s - 1e-5), at(s + 1e-5));
                for joint in 0..4 {
                    max = max.max(((ahead[joint] - back[joint]) / (2e-5 * time)).abs());
                }
            }
            from = to;
            max
        })
        .collect()
}
