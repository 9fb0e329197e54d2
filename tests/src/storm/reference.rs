//! References in f64: the interpolation of setpoints, and the closed loops of the rods.

use super::units::{DEGREE, MM, PERIOD};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::h4::{Arm, ArmGeometry, Tip};
use haptimill_protocol::message::Action;
use haptimill_protocol::setpoint::Setpoint;

/// The simulator's geometry, for commanded joints and poses.
pub struct ReferenceKinematics {
    arm: Option<(ArmGeometry, Arm)>,
}

impl ReferenceKinematics {
    /// Creates the reference of a simulated machine.
    #[must_use]
    pub fn new(plant: &PlantConfig) -> Self {
        let presets: Vec<f64> = plant.joint.iter().map(|joint| joint.preset).collect();
        let arm = ArmGeometry::of(plant).and_then(|geometry| {
            let slides = [presets[0], presets[1], presets[2], presets[3]];
            Some((geometry.clone(), Arm::new(geometry, &slides).ok()?))
        });
        Self { arm }
    }

    /// Returns the distance of the rods from closing, in mm, or of the table, in degrees.
    ///
    /// Pose and joints are in axis units. The result is the larger of the two.
    #[must_use]
    pub fn residual(&self, pose: &[f64; 6], joints: &[f64; 6]) -> f64 {
        let Some((geometry, arm)) = &self.arm else {
            return 0.0;
        };
        let [x, y, z] = [0, 1, 2].map(|axis| pose[axis] / MM);
        let (theta, alpha) = (
            (pose[3] / DEGREE).to_radians(),
            (pose[4] / DEGREE).to_radians(),
        );
        let (across, up) = (y + geometry.y_off, z + geometry.z_off);
        let tip = Tip {
            x: x + geometry.p + geometry.x_off,
            y: across * alpha.cos() - up * alpha.sin(),
            z: across * alpha.sin() + up * alpha.cos() - geometry.h,
            sin_theta: theta.sin(),
        };
        let slides = [0, 1, 2, 3].map(|joint| joints[joint] / MM);
        let turned = (f64::from((joints[4] - pose[4]) as i64 as i32) / DEGREE).abs();
        arm.residual(&tip, &slides).abs().max(turned)
    }
}

/// State of a job in a period.
pub struct JobSample {
    /// Program time, 2^-32 periods.
    pub time: u64,
    /// Number of setpoints that were reached.
    pub reached: u32,
    /// Number of setpoints that were accepted.
    pub accepted: u32,
    /// Commanded pose, axis units.
    pub pose: [f64; 6],
    /// Commanded speed of the spindle.
    pub spindle: i16,
}

/// A job as the host planned it.
#[derive(Debug, Default)]
pub struct PlannedJob {
    setpoints: Vec<Setpoint>,
    /// Program time at each setpoint, periods.
    ends: Vec<u64>,
    start: [f64; 6],
    /// A job was planned that has not begun.
    planned: bool,
    running: bool,
    /// The controller executes the plan, and the program is the source of all coordinates.
    pub comparable: bool,
    /// The queue may differ from the plan: a setpoint was refused, or others were sent.
    pub altered: bool,
    /// Every segment is long enough to stop in it.
    pub long_segments: bool,
    last: Option<(u64, u32)>,
}

impl PlannedJob {
    /// The host has planned a job.
    pub fn plan(&mut self, setpoints: &[Setpoint]) {
        self.setpoints = setpoints.to_vec();
        let mut end = 0;
        self.ends = setpoints
            .iter()
            .map(|setpoint| {
                end += u64::from(setpoint.periods);
                end
            })
            .collect();
        self.long_segments = setpoints.iter().all(|setpoint| setpoint.periods >= 200);
        self.planned = true;
        self.altered = false;
    }

    /// Another command was sent that may put setpoints into the queue.
    pub fn invalidate(&mut self) {
        self.altered = true;
        self.comparable = false;
        self.planned = false;
    }

    /// The controller has begun a job at this pose.
    pub fn begin(&mut self, start: [f64; 6]) {
        self.comparable = core::mem::take(&mut self.planned) && !self.altered;
        self.start = start;
        self.running = true;
        self.last = None;
    }

    /// The job is over.
    pub fn end(&mut self) {
        if self.running {
            self.running = false;
            self.comparable = false;
            self.long_segments = false;
        }
    }

    /// Returns the distance of the commanded pose from the plan, in axis units.
    ///
    /// # Errors
    /// A setpoint was skipped, executed twice or before it was accepted, or program time is wrong.
    pub fn check(&mut self, seen: &JobSample) -> Result<f64, String> {
        if !self.comparable || !self.running {
            return Ok(0.0);
        }
        if seen.accepted as usize > self.setpoints.len() {
            return Err(format!(
                "{} setpoints were accepted of a job of {}",
                seen.accepted,
                self.setpoints.len()
            ));
        }
        if let Some((time, reached)) = self.last {
            let passed = seen.time.wrapping_sub(time);
            // The ramp of the path rate may exceed the full rate by some parts in 10^7 by rounding.
            if passed > (1 << 32) + (1 << 13) {
                return Err(format!(
                    "{} periods of program time passed in one period",
                    passed as f64 / 4_294_967_296.0
                ));
            }
            if seen.reached < reached || seen.reached > reached + 1 {
                return Err(format!(
                    "setpoint {} was reached after {reached}",
                    seen.reached
                ));
            }
        }
        self.last = Some((seen.time, seen.reached));
        let whole = seen.time >> 32;
        let place = self.ends.partition_point(|end| *end <= whole);
        if place as u32 != seen.reached {
            return Err(format!(
                "at program time {whole} periods setpoint {} is reached, by the host's plan {place}",
                seen.reached
            ));
        }
        if place as u32 > seen.accepted {
            return Err(format!(
                "setpoint {place} was reached and {} were accepted",
                seen.accepted
            ));
        }
        let spindle = self.setpoints[..place]
            .iter()
            .rev()
            .find_map(|setpoint| match setpoint.action {
                Action::Spindle(rpm) => Some(rpm),
                _ => None,
            })
            .unwrap_or(0);
        if spindle != seen.spindle {
            return Err(format!(
                "the spindle is at {} after setpoint {place}, by the host's plan at {spindle}",
                seen.spindle
            ));
        }
        let begin = if place == 0 { 0 } else { self.ends[place - 1] };
        let (from, rates) = if place == 0 {
            (self.start, [0.0; 6])
        } else {
            let setpoint = &self.setpoints[place - 1];
            (places(&setpoint.pose), speeds(&setpoint.rates))
        };
        let Some(to) = self.setpoints.get(place) else {
            return Ok(distance(&seen.pose, &from));
        };
        if place as u32 == seen.accepted && seen.time > begin << 32 {
            return Err(format!(
                "the motion continues beyond setpoint {place}, the last that was accepted"
            ));
        }
        let span = f64::from(to.periods) * PERIOD;
        let time = (seen.time as f64 / 4_294_967_296.0 - begin as f64) * PERIOD;
        let u = time / span;
        let (end, end_rates) = (places(&to.pose), speeds(&to.rates));
        let mut planned = [0.0; 6];
        for axis in 0..to.pose.len() {
            let mut way = end[axis] - from[axis];
            if axis > 2 {
                way = f64::from(way as i64 as i32);
            }
            let (v0, v1) = (rates[axis] * span, end_rates[axis] * span);
            planned[axis] = from[axis]
                + u * v0
                + u * u * (3.0 * way - 2.0 * v0 - v1)
                + u * u * u * (v0 + v1 - 2.0 * way);
        }
        Ok(distance(&seen.pose, &planned))
    }
}

fn places(values: &[i32]) -> [f64; 6] {
    let mut places = [0.0; 6];
    for (slot, value) in places.iter_mut().zip(values) {
        *slot = f64::from(*value);
    }
    places
}

fn speeds(values: &[i32]) -> [f64; 6] {
    places(values).map(|value| value * 256.0)
}

fn distance(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter()
        .zip(b)
        .enumerate()
        .map(|(axis, (a, b))| {
            let off = a - b;
            if axis > 2 {
                (off.rem_euclid(4_294_967_296.0)).min((-off).rem_euclid(4_294_967_296.0))
            } else {
                off.abs()
            }
        })
        .fold(0.0, f64::max)
}
