//! The H-4 machine in f64, written independently from docs/control.md 2.6 and 2.7 with the lengths
//! of REF-G (7.2), and default dynamics.

use haptimill_gcode::{Coordinates, WordKind};
use haptimill_planner::{JointLimits, MachineModel, PoseLimits, PoseProblem, Settings};

/// The geometry REF-G.
pub struct H4;

const E: f64 = 250.0;
const C: f64 = 100.0;
const D: f64 = 100.0;
const W: f64 = 50.0;
const R: f64 = 480.0;
const GE: f64 = 25.0;
const TL: f64 = 150.0;
const X_OFFSET: f64 = 810.0;
const H: f64 = 600.0;
/// Home pose.
pub const HOME: Coordinates = [0.0, 0.0, 21.231996, 0.0, 0.0, 0.0];
const HOME_SLIDES: [f64; 4] = [1135.0, 485.0, 1135.0, 485.0];
const STROKE: f64 = 250.0;

/// s and sigma of each slide.
const LEGS: [(f64, f64); 4] = [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];

/// Pose in the machine base: x, y, z, theta.
fn base(pose: &Coordinates) -> [f64; 4] {
    let (sin, cos) = pose[4].to_radians().sin_cos();
    [
        pose[0] + X_OFFSET,
        pose[1] * cos - pose[2] * sin,
        pose[1] * sin + pose[2] * cos - H,
        pose[3].to_radians(),
    ]
}

/// U, V, m of a slide.
fn leg(base: &[f64; 4], sigma: f64) -> (f64, f64, f64) {
    let m = TL + C * (1.0 + sigma);
    (
        E - sigma * base[1],
        -base[2] - m * base[3].cos() + sigma * D - GE,
        m,
    )
}

impl MachineModel for H4 {
    fn joints(&self, pose: &Coordinates) -> Result<[f64; 6], PoseProblem> {
        let base = base(pose);
        let mut joints = [0.0; 6];
        for (k, (s, sigma)) in LEGS.into_iter().enumerate() {
            let (u, v, m) = leg(&base, sigma);
            let squared = R * R - u * u - v * v;
            if squared < 0.01 * R * R {
                return Err(PoseProblem(format!(
                    "rod {} is at the end of its reach",
                    k + 1
                )));
            }
            joints[k] = base[0] + m * base[3].sin() + s * (W + squared.sqrt());
            let beyond = (joints[k] - HOME_SLIDES[k]).abs() - STROKE;
            if beyond > 0.0 {
                return Err(PoseProblem(format!(
                    "slide {} would be {beyond:.3} mm beyond its stroke",
                    k + 1
                )));
            }
        }
        let (z, d) = (
            base[2] + (TL + C) * base[3].cos() + GE,
            D - C * base[3].cos(),
        );
        if -(E * z - base[1] * d) / E.hypot(d) < 5.0 {
            return Err(PoseProblem("too near the parallel singularity".into()));
        }
        joints[4] = pose[4];
        Ok(joints)
    }

    fn joint_rates(&self, pose: &Coordinates, rates: &Coordinates) -> [f64; 6] {
        let base = base(pose);
        let (sin, cos) = pose[4].to_radians().sin_cos();
        let (theta_rate, alpha_rate) = (rates[3].to_radians(), rates[4].to_radians());
        let y_rate = rates[1] * cos - rates[2] * sin - (base[2] + H) * alpha_rate;
        let z_rate = rates[1] * sin + rates[2] * cos + base[1] * alpha_rate;
        let mut joints = [0.0; 6];
        for (k, (s, sigma)) in LEGS.into_iter().enumerate() {
            let (u, v, m) = leg(&base, sigma);
            let root = (R * R - u * u - v * v).sqrt();
            let (sin, cos) = base[3].sin_cos();
            joints[k] = rates[0]
                + s * sigma * u / root * y_rate
                + s * v / root * z_rate
                + (m * cos - s * v / root * m * sin) * theta_rate;
        }
        joints[4] = rates[4];
        joints
    }
}

/// Default dynamics at 200 us.
pub fn settings() -> Settings {
    let linear = |letter, low, high| PoseLimits {
        letter,
        kind: WordKind::Linear,
        units: 1_048_576.0,
        low,
        high,
        rate: 60.0,
        acceleration: 200.0,
        jerk: 5000.0,
    };
    let rotary = |letter, reach: f64| PoseLimits {
        letter,
        kind: WordKind::Rotary,
        units: 4_294_967_296.0 / 360.0,
        low: -reach,
        high: reach,
        rate: 30.0,
        acceleration: 100.0,
        jerk: 2500.0,
    };
    let slide = |k| JointLimits {
        name: format!("slide {k}"),
        unit: "mm",
        rate: 120.0,
        acceleration: 1500.0,
        jerk: 37_500.0,
    };
    Settings::new(
        vec![
            linear('X', -150.0, 150.0),
            linear('Y', -150.0, 150.0),
            linear('Z', -50.0, 150.0),
            rotary('B', 35.0),
            rotary('A', 45.0),
        ],
        vec![
            slide(1),
            slide(2),
            slide(3),
            slide(4),
            JointLimits {
                name: "table".into(),
                unit: "deg",
                rate: 45.0,
                acceleration: 200.0,
                jerk: 5000.0,
            },
        ],
        200,
    )
}
