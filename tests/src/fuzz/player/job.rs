//! Plans the jobs of an episode.

use super::Player;
use crate::fuzz::command;
use crate::fuzz::episode::{JobPlan, PathPlan};
use crate::fuzz::machines::MachineKind;
use crate::fuzz::rng::Rng;
use crate::fuzz::units::{MM, PERIOD};
use core::f64::consts::TAU;
use haptimill_firmware::config::PoseAxis;
use haptimill_protocol::message::{
    Action, AxisValues, Command, SETPOINT_BATCH, SetpointBatch, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};

/// Returns a setpoint with all rates 0.
fn at_standstill(place: &[f64; 6], axes: usize, periods: u16, action: Action) -> Setpoint {
    Setpoint {
        periods,
        pose: place[..axes]
            .iter()
            .map(|value| *value as i64 as i32)
            .collect(),
        rates: (0..axes).map(|_| 0).collect(),
        action,
    }
}

/// Returns setpoints that start the spindle and wait for it.
fn start_spindle(place: &[f64; 6], axes: usize) -> Vec<Setpoint> {
    vec![
        at_standstill(place, axes, 50, Action::Spindle(5000)),
        at_standstill(place, axes, 5000, Action::None),
    ]
}

/// Returns a line in the negative direction of an axis.
fn line(here: &[f64; 6], axes: usize, axis: usize, distance: f64, speed: f64) -> Vec<Setpoint> {
    let mut setpoints = start_spindle(here, axes);
    let segments = (distance / (speed * 50.0) / 0.1).ceil().max(2.0);
    let rate = distance / (segments * 0.1);
    let segments = segments as usize;
    let mut place = *here;
    for segment in 0..=segments {
        let ends = segment == 0 || segment == segments;
        place[axis] -= if ends { rate / 2.0 } else { rate } * 0.1 * MM;
        let mut setpoint = at_standstill(&place, axes, 500, Action::None);
        if segment != segments {
            setpoint.rates[axis] = (-rate * 4096.0) as i32;
        }
        setpoints.push(setpoint);
    }
    setpoints.push(at_standstill(&place, axes, 3000, Action::None));
    setpoints
}

/// Motion of a coordinate: a profile of fifth order, and an oscillation on top of it.
///
/// Both begin and end at standstill.
#[derive(Default)]
struct Profile {
    reach: f64,
    amplitude: f64,
    cycles: f64,
}

impl Profile {
    /// Returns a random motion from `here`, of this duration in seconds.
    fn random(axis: &PoseAxis, here: f64, speed: f64, duration: f64, rng: &mut Rng) -> Self {
        let rate = f64::from(axis.rate.0) * speed;
        let acceleration = f64::from(axis.acceleration.0) * 256.0 * 6.0;
        let (low, high) = (f64::from(axis.low.0), f64::from(axis.high.0));
        let middle = (low + high) / 2.0;
        let range = (high - low) * 0.12;
        // Far from the middle of its range the coordinate moves back towards it.
        let direction = if (here - middle).abs() < range {
            rng.choose(&[-1.0, 1.0])
        } else {
            (middle - here).signum()
        };
        let reach = (rate * duration * 0.35)
            .min(acceleration * duration * duration / 8.0)
            .min(range);
        let cycles = (1.0 + rng.uniform(0.0, 4.0)).floor();
        let amplitude = (rate * duration * 0.15 / (cycles * TAU))
            .min(acceleration * duration * duration / (TAU * cycles).powi(2) / 8.0)
            .min(range / 4.0)
            // Near a limit an oscillation would leave it between two setpoints inside.
            .min(((high - low) / 2.0 - (here - middle).abs()).max(0.0) / 8.0);
        Self {
            reach: direction * rng.uniform(0.1, 1.0) * reach,
            amplitude: rng.uniform(-1.0, 1.0) * amplitude,
            cycles,
        }
    }

    /// Returns the displacement at `t`, from 0 to 1.
    fn displacement(&self, here: f64, t: f64) -> f64 {
        let angle = TAU * self.cycles * t;
        let profile = t * t * t * (10.0 + t * (6.0 * t - 15.0));
        here + self.reach * profile
            + self.amplitude
                * (angle.sin() - self.cycles * TAU * t * (1.0 - t) * (1.0 - 2.0 * t))
                * 0.5
    }

    /// Returns the rate at `t`, from 0 to 1.
    fn rate(&self, t: f64, duration: f64) -> f64 {
        let angle = TAU * self.cycles * t;
        let slope = 30.0 * t * t * (1.0 - t) * (1.0 - t) / duration;
        let bend = self.cycles * TAU * (1.0 - 6.0 * t + 6.0 * t * t);
        self.reach * slope
            + self.amplitude * (TAU * self.cycles * angle.cos() - bend) * 0.5 / duration
    }
}

/// Returns the setpoints of a smooth path from `here`.
fn path(here: &[f64; 6], axes: &[PoseAxis], plan: &PathPlan, rng: &mut Rng) -> Vec<Setpoint> {
    let mut setpoints = if plan.actions {
        start_spindle(here, axes.len())
    } else {
        vec![]
    };
    let count = usize::from(plan.count);
    let duration = f64::from(plan.span.max(1)) * PERIOD * count as f64;
    let mut profiles: Vec<Profile> = axes.iter().map(|_| Profile::default()).collect();
    for (axis, profile) in profiles.iter_mut().enumerate() {
        if !rng.chance(0.35) {
            *profile = Profile::random(&axes[axis], here[axis], plan.speed, duration, rng);
        }
    }
    let mut elapsed = 0.0;
    for index in 1..=count {
        let absurd = rng.chance(plan.absurd);
        let left = (duration - elapsed) / PERIOD;
        let periods = if index == count {
            left.round().max(1.0)
        } else {
            (f64::from(plan.span) * rng.uniform(0.7, 1.3))
                .round()
                .clamp(1.0, 60_000.0)
                .min((left - (count - index) as f64).max(1.0))
        };
        elapsed += periods * PERIOD;
        let t = (elapsed / duration).clamp(0.0, 1.0);
        let mut setpoint = at_standstill(here, axes.len(), periods as u16, Action::None);
        for (axis, profile) in profiles.iter().enumerate() {
            let place = profile.displacement(here[axis], t);
            setpoint.pose[axis] = place.round() as i64 as i32;
            if index != count {
                setpoint.rates[axis] = (profile.rate(t, duration) / 256.0).round() as i32;
            }
            if absurd {
                setpoint.pose[axis] = command::word(rng);
            }
        }
        if plan.actions && rng.chance(0.05) {
            // Force control needs at least this speed.
            let rpm = rng.uniform(4000.0, 6000.0) as i16;
            setpoint.action = Action::Spindle(if rng.chance(0.3) { -rpm } else { rpm });
        } else if plan.actions && rng.chance(0.08) {
            let mode = command::override_mode(rng);
            if mode.is_valid() || absurd {
                setpoint.action = Action::OverrideMode(mode);
            }
        }
        setpoints.push(setpoint);
    }
    if plan.actions {
        let mut last = setpoints.last().expect("the spindle start").clone();
        last.periods = 100;
        last.action = if rng.chance(0.3) {
            Action::Pause
        } else {
            Action::Spindle(0)
        };
        setpoints.push(last);
    }
    setpoints
}

impl Player {
    /// Plans a job from the present pose; its commands are sent period by period.
    pub(super) fn begin_job(&mut self, plan: &JobPlan) {
        if self.kind == MachineKind::MasterAlone {
            return;
        }
        let axes = self.axes();
        let start: AxisValues = self.commanded()[..axes].iter().copied().collect();
        let mut here = [0.0; 6];
        for (place, value) in here.iter_mut().zip(&start) {
            *place = f64::from(*value);
        }
        let setpoints = match plan {
            JobPlan::Path(plan) => {
                let axes = &self.bench.machine.config.pose;
                path(&here, axes, plan, &mut Rng::new(plan.seed, 902))
            }
            JobPlan::Line {
                axis,
                distance_um,
                speed,
            } => {
                let distance = f64::from(*distance_um) / 1000.0;
                line(&here, axes, usize::from(*axis), distance, *speed)
            }
            JobPlan::Dwell { periods } => vec![at_standstill(&here, axes, *periods, Action::None)],
        };
        let (gap, absurd, open) = match plan {
            JobPlan::Path(plan) => (
                (plan.gap > 0).then(|| (u32::from(plan.count) / 3, u32::from(plan.gap))),
                plan.absurd > 0.0,
                plan.open,
            ),
            JobPlan::Line { .. } | JobPlan::Dwell { .. } => (None, false, false),
        };
        self.gap = gap;
        self.queue_job(&setpoints, start, open);
        if !absurd && self.state() == State::Idle {
            self.checks.job.plan(&setpoints);
        } else {
            self.checks.job.invalidate();
        }
    }

    fn queue_job(&mut self, setpoints: &[Setpoint], start: AxisValues, open: bool) {
        self.job = self.job.wrapping_add(1);
        let mut coder = SetpointCoder::new(200, &start);
        self.stream.clear();
        self.stream.push_back(Command::JobStart {
            job: self.job,
            pose: start,
        });
        for (index, batch) in setpoints.chunks(SETPOINT_BATCH).enumerate() {
            let items = batch
                .iter()
                .filter_map(|setpoint| coder.encode(setpoint).ok())
                .collect();
            self.stream.push_back(Command::Setpoints(SetpointBatch {
                first: (index * SETPOINT_BATCH) as u32,
                items,
            }));
        }
        if !open {
            self.stream.push_back(Command::JobEnd {
                count: setpoints.len() as u32,
            });
        }
    }
}
