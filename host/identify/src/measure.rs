//! What the telemetry of a motion says about a joint.

use crate::complex::{Complex, complex};
use crate::excitation::Window;
use crate::least_squares::fit;
use crate::two_mass::Point;
use haptimill_firmware::config::Drive;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_protocol::message::{State, Telemetry};
use std::f64::consts::TAU;

/// One telemetry frame of a motion.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Time of the motion, seconds.
    pub time: f64,
    /// Position of each joint, mm or degrees.
    pub joints: Vec<f64>,
    /// Effort of each joint, N or N m; 0 of a step drive.
    pub efforts: Vec<f64>,
}

/// Effort of one converter code, N or N m; 0 of a step drive.
fn per_code(machine: &MachineFile, joint: usize) -> f64 {
    match machine.config.joints[joint].drive {
        Drive::Torque { full_scale, .. } => f64::from(full_scale.0) / 65536.0 / 8192.0,
        Drive::Steps { .. } => 0.0,
    }
}

/// The samples of a motion.
#[must_use]
pub fn samples(machine: &MachineFile, model: &Model, frames: &[Telemetry]) -> Vec<Sample> {
    let period = f64::from(machine.config.period_us) * 1e-6;
    let scales: Vec<f64> = (0..machine.joints.len())
        .map(|joint| per_code(machine, joint))
        .collect();
    frames
        .iter()
        .filter(|frame| frame.state == State::Run)
        .map(|frame| Sample {
            time: f64::from(frame.program_periods) * period,
            joints: model.unwound_joints(frame),
            efforts: frame
                .drive
                .iter()
                .zip(&scales)
                .map(|(code, scale)| f64::from(*code) * scale)
                .collect(),
        })
        .collect()
}

/// Effort at a constant rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Steady {
    /// Measured rate of the joint, mm/s or deg/s.
    pub rate: f64,
    /// Mean effort, N or N m.
    pub effort: f64,
}

fn inside<'a>(samples: &'a [Sample], window: &Window) -> impl Iterator<Item = &'a Sample> + Clone {
    let (from, to) = (window.from, window.to);
    samples
        .iter()
        .filter(move |sample| (from..to).contains(&sample.time))
}

/// Effort and rate of a joint in a window at a constant rate. `inertia` in effort per axis unit and
/// second squared removes what is left of an acceleration.
#[must_use]
pub fn steady(samples: &[Sample], window: &Window, joint: usize, inertia: f64) -> Option<Steady> {
    let part: Vec<&Sample> = inside(samples, window).collect();
    if part.len() < 20 {
        return None;
    }
    let middle = (window.from + window.to) / 2.0;
    // Position as a parabola: rate and acceleration.
    let rows: Vec<_> = part
        .iter()
        .map(|sample| {
            let t = sample.time - middle;
            ([1.0, t, t * t / 2.0], sample.joints[joint])
        })
        .collect();
    let ([_, rate, acceleration], _) = fit(&rows)?;
    let sum: f64 = part.iter().map(|sample| sample.efforts[joint]).sum();
    Some(Steady {
        rate,
        effort: sum / part.len() as f64 - inertia * acceleration,
    })
}

/// Friction of a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Friction {
    /// Coulomb friction of forward and backward motion, N or N m.
    pub coulomb: [f64; 2],
    /// Viscous friction, N s/mm or N m s/deg; not below 0.
    pub viscous: f64,
    /// The measured points.
    pub points: Vec<Steady>,
    /// Rms of the residuals, N or N m.
    pub rms: f64,
}

/// Friction as a constant for each direction and one slope.
#[must_use]
pub fn friction(points: Vec<Steady>) -> Option<Friction> {
    let is_forward = |point: &Steady| point.rate > 0.0;
    let rows: Vec<_> = points
        .iter()
        .map(|point| {
            let forward = is_forward(point);
            let direction = if forward { [1.0, 0.0] } else { [0.0, -1.0] };
            ([direction[0], direction[1], point.rate], point.effort)
        })
        .collect();
    let ([forward, backward, viscous], rms) = fit(&rows)?;
    Some(Friction {
        coulomb: [forward, backward],
        viscous: viscous.max(0.0),
        points,
        rms,
    })
}

/// Response of a joint to the sine of a window: motion over effort, both as they are measured.
///
/// The effort of a frame is that of the period after it, held for a period: on average it acts one
/// and a half periods after the position of the same frame.
#[must_use]
pub fn response(
    samples: &[Sample],
    window: &Window,
    joint: usize,
    period: f64,
    count: f64,
) -> Option<Point> {
    let omega = TAU * window.frequency;
    let middle = (window.from + window.to) / 2.0;
    let part: Vec<&Sample> = inside(samples, window).collect();
    if part.len() < 30 {
        return None;
    }
    let amplitude = |value: &dyn Fn(&Sample) -> f64| -> Option<(Complex, f64)> {
        let rows: Vec<_> = part
            .iter()
            .map(|sample| {
                let t = sample.time - middle;
                let (sine, cosine) = (omega * t).sin_cos();
                ([1.0, t, t * t, cosine, sine], value(sample))
            })
            .collect();
        let ([_, _, _, cosine, sine], rms) = fit(&rows)?;
        Some((complex(cosine, -sine), rms))
    };
    let (motion, noise) = amplitude(&|sample| sample.joints[joint])?;
    let (effort, effort_noise) = amplitude(&|sample| sample.efforts[joint])?;
    if effort.abs() <= 0.0 {
        return None;
    }
    // Relative deviations of amplitudes: the noise of one sample, over the number of samples.
    // A count is an even distribution: its variance is a twelfth of its square.
    let relative = (noise.max(count / 12_f64.sqrt()) / motion.abs())
        .hypot(effort_noise / effort.abs())
        * (2.0 / part.len() as f64).sqrt();
    let effort = effort * Complex::unit(-omega * 1.5 * period);
    let response = motion / effort;
    Some(Point {
        frequency: window.frequency,
        response,
        deviation: relative * response.abs(),
    })
}

/// Size of a count of a joint's encoder, mm or degrees.
#[must_use]
pub fn count_of(machine: &MachineFile, joint: usize) -> f64 {
    let kind = machine.joints[joint].kind;
    let encoder = machine.config.joints[joint].encoder.as_ref();
    encoder.map_or(0.0, |encoder| {
        encoder.per_count.unsigned_abs() as f64 / f64::from(1 << 24) / per_unit(kind)
    })
}
