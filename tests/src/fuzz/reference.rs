//! References in f64: the interpolation of setpoints, and the closed loops of the rods.

use super::units::{DEGREE, MM, PERIOD};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::h4::{Arm, ArmGeometry, Tip};
use haptimill_protocol::message::{Action, OverrideMode};
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
        let arm = ArmGeometry::of(plant.geometry.as_ref()).and_then(|geometry| {
            let slides = [presets[0], presets[1], presets[2], presets[3]];
            Some((geometry.clone(), Arm::new(geometry, &slides).ok()?))
        });
        Self { arm }
    }

    /// Returns a joint of a pose, in mm or degrees, or `None` beyond the reach. The pose is in axis
    /// units.
    #[must_use]
    pub fn joint(&self, pose: &[f64; 6], joint: usize) -> Option<f64> {
        let (arm, _) = self.arm.as_ref()?;
        if joint > 3 {
            return Some(pose[4] / DEGREE);
        }
        let tip = place_tip(arm, pose);
        let theta = (pose[3] / DEGREE).to_radians();
        let side = [1.0, -1.0, 1.0, -1.0][joint];
        let sigma = if joint < 2 { 1.0 } else { -1.0 };
        let m = arm.tl + arm.c * (1.0 + sigma);
        let u = arm.a - arm.b - arm.e - sigma * tip.y;
        let v = -tip.z - m * theta.cos() + sigma * arm.d - arm.ge;
        let square = arm.r * arm.r - u * u - v * v;
        (square > 0.0).then(|| tip.x + m * tip.sin_theta + side * (arm.w + square.sqrt()))
    }

    /// Returns the distance of the rods from closing, in mm, or of the table, in degrees.
    ///
    /// Pose and joints are in axis units. The result is the larger of the two.
    #[must_use]
    pub fn residual(&self, pose: &[f64; 6], joints: &[f64; 6]) -> f64 {
        let Some((geometry, arm)) = &self.arm else {
            return 0.0;
        };
        let tip = place_tip(geometry, pose);
        let slides = [0, 1, 2, 3].map(|joint| joints[joint] / MM);
        let turned = (f64::from((joints[4] - pose[4]) as i64 as i32) / DEGREE).abs();
        arm.residual(&tip, &slides).abs().max(turned)
    }
}

/// Returns the tip at a pose, in the frame of the arm's base.
fn place_tip(geometry: &ArmGeometry, pose: &[f64; 6]) -> Tip {
    let [x, y, z] = [0, 1, 2].map(|axis| pose[axis] / MM);
    let (theta, alpha) = (
        (pose[3] / DEGREE).to_radians(),
        (pose[4] / DEGREE).to_radians(),
    );
    let (across, up) = (y + geometry.y_off, z + geometry.z_off);
    Tip {
        x: x + geometry.p + geometry.x_off,
        y: across * alpha.cos() - up * alpha.sin(),
        z: across * alpha.sin() + up * alpha.cos() - geometry.h,
        sin_theta: theta.sin(),
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
    /// Spindle overrides that may be in force; none where a lost answer leaves them unknown.
    pub spindle_overrides: Vec<u8>,
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
    /// The setpoint at the end of the segment that was compared last.
    compared: Option<usize>,
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
        self.compared = None;
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
            // The ramp of the speed factor may exceed the largest factor of the modes by some parts
            // in 10^7 by rounding.
            let percent = self.largest_factor(seen.reached);
            if passed > ((1 << 32) + (1 << 13)) * percent / 100 {
                return Err(format!(
                    "{} periods of program time passed in one period",
                    passed as f64 / 4_294_967_296.0
                ));
            }
            // A segment takes a period of program time or more.
            let passable = u32::from(percent > 100) + 1;
            if seen.reached < reached || seen.reached > reached + passable {
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
        let is_planned = |percent: &u8| {
            let speed = i32::from(spindle) * i32::from(*percent) / 100;
            let highest = i32::from(i16::MAX);
            speed.clamp(-highest, highest) == i32::from(seen.spindle)
        };
        let mode = self.setpoints[..place].iter().rev();
        let mode = mode.filter_map(|setpoint| match setpoint.action {
            Action::OverrideMode(mode) => Some(mode),
            _ => None,
        });
        let is_fixed = mode.take(1).any(|mode| mode == OverrideMode::FIXED);
        let overrides = match seen.spindle_overrides.as_slice() {
            [] => Vec::new(),
            _ if is_fixed => vec![100],
            overrides => overrides.to_vec(),
        };
        if !overrides.is_empty() && !overrides.iter().any(is_planned) {
            return Err(format!(
                "the spindle is at {} after setpoint {place}, by the host's plan at {spindle} with \
                 an override of {overrides:?} %",
                seen.spindle
            ));
        }
        self.compared = Some(place);
        let begin = if place == 0 { 0 } else { self.ends[place - 1] };
        let Some(to) = self.setpoints.get(place) else {
            return Ok(distance(&seen.pose, &self.node(place).0));
        };
        if place as u32 == seen.accepted && seen.time > begin << 32 {
            return Err(format!(
                "the motion continues beyond setpoint {place}, the last that was accepted"
            ));
        }
        let time = seen.time as f64 / 4_294_967_296.0 - begin as f64;
        let planned = self.pose_at(place, to, time / f64::from(to.periods));
        Ok(distance(&seen.pose, &planned))
    }

    /// Returns the largest factor that the modes of the first `reached` setpoints allow, percent.
    fn largest_factor(&self, reached: u32) -> u64 {
        let setpoints = self.setpoints.iter().take(reached as usize);
        let factors = setpoints.filter_map(|setpoint| match setpoint.action {
            Action::OverrideMode(mode) => Some(u64::from(mode.max_percent())),
            _ => None,
        });
        factors.max().unwrap_or(100)
    }

    /// Returns place and rates at the start of the segment to setpoint `place`.
    fn node(&self, place: usize) -> ([f64; 6], [f64; 6]) {
        if place == 0 {
            return (self.start, [0.0; 6]);
        }
        let setpoint = &self.setpoints[place - 1];
        (places(&setpoint.pose), speeds(&setpoint.rates))
    }

    /// Returns the pose at a part of the segment to setpoint `place`, which is `to`.
    fn pose_at(&self, place: usize, to: &Setpoint, u: f64) -> [f64; 6] {
        let (from, rates) = self.node(place);
        let span = f64::from(to.periods) * PERIOD;
        let (end, end_rates) = (places(&to.pose), speeds(&to.rates));
        let mut planned = [0.0; 6];
        for axis in 0..to.pose.len() {
            let mut way = end[axis] - from[axis];
            if way.abs() > 2_147_483_648.0 {
                // The shorter way of a coordinate that wraps around.
                way = f64::from(way as i64 as i32);
            }
            let (v0, v1) = (rates[axis] * span, end_rates[axis] * span);
            planned[axis] = from[axis]
                + u * v0
                + u * u * (3.0 * way - 2.0 * v0 - v1)
                + u * u * u * (v0 + v1 - 2.0 * way);
        }
        planned
    }

    /// Returns whether the plan leaves its bounds between two setpoints within them, in the segment
    /// that was compared last or in the next one.
    ///
    /// `beyond` is the distance of a pose from its bounds, positive outside. `accuracy` is that of
    /// the controller's arithmetic at the setpoints.
    pub fn leaves_between(&self, beyond: impl Fn(&[f64; 6]) -> f64, accuracy: f64) -> bool {
        let Some(compared) = self.compared else {
            return false;
        };
        (compared..=compared + 1).any(|place| {
            self.setpoints.get(place).is_some_and(|to| {
                let at = |part: f64| beyond(&self.pose_at(place, to, part));
                let between = |period: u16| at(f64::from(period) / f64::from(to.periods)) > 0.0;
                at(0.0) <= accuracy && at(1.0) <= accuracy && (1..to.periods).any(between)
            })
        })
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
        .map(|(a, b)| {
            let off = a - b;
            off.rem_euclid(4_294_967_296.0)
                .min((-off).rem_euclid(4_294_967_296.0))
        })
        .fold(0.0, f64::max)
}
