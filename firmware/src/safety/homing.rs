//! Finding the reference: one transaction for all joints.
//!
//! The operator sets the slides to their presets (docs/control.md 1.2: 1135 mm and 485 mm) before
//! power-on, within [`JointAxis::search`]. Motion after that is known from the counters
//! ([`crate::joint::power_on_counts`]).
//!
//! Four slides of a parallel arm that home one by one can leave the workspace, so the *pose* moves.
//! It moves along x first, which shifts all slides alike, until each of them has its index pulse.
//! Then tool and workpiece turn together about the axis of the table: the table turns and the
//! slides stand, so only the stroke of the table bounds the search. With x and alpha at once a
//! slide may move by less than an index pitch, because alpha moves the slides as well away from the
//! axis of the table. At a bound of the workspace the search turns back once.
//!
//! Homing of all joints fails if a joint finds no index, finds one far from where the preset says,
//! or if the machine cannot take a pose.

use crate::config::{AxisKind, Config, JointAxis};
use crate::motion::jog::Jog;
use haptimill_kinematics::h4::H4Geometry;
use haptimill_kinematics::{Model, Pose};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Fault, HomingProblem, MAX_AXES};

/// Where the homing is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Phase {
    /// To set out: the period of the command had enough to do.
    #[default]
    Aim,
    /// Moving, looking for index pulses.
    Search,
    /// All of a kind found, or the workspace ends: coming to rest.
    Rest,
}

/// What homing says after a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Not yet.
    Searching,
    /// Every joint has its index: the corrections to add to the coordinates of the joints.
    Found([Coordinate; MAX_AXES]),
    /// All joints must stop.
    Failed(Fault),
}

/// A homing in progress.
#[derive(Debug, Clone, Copy, Default)]
pub struct Homing {
    phase: Phase,
    /// What moves in the present search.
    kind: Option<AxisKind>,
    /// Which way it searches.
    downwards: bool,
    /// The present search has met the end of the workspace and turned back.
    reversed: bool,
    /// Correction of each joint whose index was found.
    corrections: [Option<Coordinate>; MAX_AXES],
    /// Periods that the search may still take.
    left: u32,
}

/// Pose coordinates.
const X: usize = 0;
const Y: usize = 1;
const Z: usize = 2;
const ALPHA: usize = 4;

impl Homing {
    /// Sets the jog going from `pose`, for the joints of the kind of `joint`.
    #[inline(never)]
    fn set_rates(&mut self, config: &Config, joint: &JointAxis, pose: &Pose, jog: &mut Jog) {
        let coordinate = match joint.kind {
            AxisKind::Linear => X,
            AxisKind::Rotary => ALPHA,
        };
        if self.kind != Some(joint.kind) {
            self.kind = Some(joint.kind);
            self.reversed = false;
            // Upwards, but from the upper part of the way back towards its middle.
            self.downwards = config.pose.get(coordinate).is_some_and(|axis| {
                let (low, high) = (i64::from(axis.low.0), i64::from(axis.high.0));
                i64::from(pose.0[coordinate].0) > high - (high - low) / 4
            });
        }
        self.left = (config.joints.iter())
            .filter(|other| other.kind == joint.kind)
            .map(|other| search_periods(config, other))
            .max()
            .unwrap_or(0);
        self.steer(config, joint.kind, pose, jog);
        self.phase = Phase::Search;
    }

    /// Rates of this period. Those of y and z that go with alpha change as the work turns.
    fn steer(&self, config: &Config, kind: AxisKind, pose: &Pose, jog: &mut Jog) {
        let rate = search_rate(config, kind);
        let rate = if self.downwards { -rate } else { rate };
        let mut rates = [0_i64; MAX_AXES];
        match (kind, &config.model) {
            (AxisKind::Linear, _) => rates[X] = rate,
            (AxisKind::Rotary, Model::H4(geometry)) => {
                rates[ALPHA] = rate;
                [rates[Y], rates[Z]] = with_the_work(geometry, pose, rate);
            }
            (AxisKind::Rotary, Model::None) => {}
        }
        jog.set_rates(&rates, self.left);
    }

    /// Takes the index pulse of a joint: the coordinate, by the preset, at which it came.
    pub fn index(
        &mut self,
        joint: usize,
        config: &JointAxis,
        coordinate: Coordinate,
    ) -> Option<Fault> {
        let slot = self.corrections.get_mut(joint)?;
        if slot.is_some() {
            return None;
        }
        // The nearest of the pulses, which come once a turn of the motor.
        let pitch = i64::from(config.index_pitch.0).max(1);
        let off = (i64::from(config.index.0) - i64::from(coordinate.0)).rem_euclid(pitch);
        let off = if off > pitch / 2 { off - pitch } else { off };
        if off.abs() > i64::from(config.search.0) {
            return Some(Fault::Homing {
                axis: joint as u8,
                problem: HomingProblem::Implausible,
            });
        }
        *slot = Some(Coordinate(off as i32));
        None
    }

    /// One period, with the machine wanted at `pose`; `limited` says that the jog was kept from going on. The first sets out.
    pub fn advance(
        &mut self,
        config: &Config,
        pose: &Pose,
        jog: &mut Jog,
        limited: bool,
    ) -> Outcome {
        let mut joints = config.joints.iter().enumerate();
        let missing = joints.find(|(joint, _)| self.corrections[*joint].is_none());
        match (self.phase, missing) {
            (Phase::Aim, Some((_, axis))) => self.set_rates(config, axis, pose, jog),
            (Phase::Search, Some((joint, axis))) if self.kind == Some(axis.kind) => {
                self.left = self.left.saturating_sub(1);
                let problem = if limited && self.reversed {
                    HomingProblem::Workspace
                } else if limited {
                    self.reversed = true;
                    self.downwards = !self.downwards;
                    jog.release();
                    self.phase = Phase::Rest;
                    return Outcome::Searching;
                } else if self.left == 0 {
                    HomingProblem::NoIndex
                } else {
                    self.steer(config, axis.kind, pose, jog);
                    return Outcome::Searching;
                };
                return Outcome::Failed(Fault::Homing {
                    axis: joint as u8,
                    problem,
                });
            }
            (Phase::Aim | Phase::Search, _) => {
                jog.release();
                self.phase = Phase::Rest;
            }
            (Phase::Rest, Some(_)) if jog.is_at_standstill() => self.phase = Phase::Aim,
            (Phase::Rest, None) if jog.is_at_standstill() => {
                return Outcome::Found(self.corrections.map(Option::unwrap_or_default));
            }
            (Phase::Rest, _) => {}
        }
        Outcome::Searching
    }
}

/// Rates of y and z, axis units per second, with which the tool keeps its place on the work's circle about the table's axis while alpha turns at `rate`: the tool stands in
/// the frame of the slides.
fn with_the_work(geometry: &H4Geometry, pose: &Pose, rate: i64) -> [i64; 2] {
    // 2^32 axis units are a turn: 411,775 is 2 pi, 2^-16. A lever is below 2^32, and so is a rate.
    let speed = |lever: i64| (((lever * (rate >> 8)) >> 24) * 411_775) >> 16;
    let across = i64::from(pose.0[Y].0) + i64::from(geometry.y_offset.0);
    let up = i64::from(pose.0[Z].0) + i64::from(geometry.z_offset.0);
    [speed(up), -speed(across)]
}

/// Rate of the coordinate that searches for the joints of a kind.
fn search_rate(config: &Config, kind: AxisKind) -> i64 {
    i64::from(match kind {
        AxisKind::Linear => config.homing.rate.0,
        AxisKind::Rotary => config.homing.table_rate.0,
    })
}

/// Periods in which a joint must have seen its index: a turn and a fifth at the search rate, and half a second to get going.
fn search_periods(config: &Config, joint: &JointAxis) -> u32 {
    let rate = search_rate(config, joint.kind).max(1);
    let travel = i64::from(joint.index_pitch.0) * 6 / 5;
    let period = i64::from(config.period_us).max(1);
    ((travel * 1_000_000 / rate + 500_000) / period).clamp(1, i64::from(u32::MAX)) as u32
}
