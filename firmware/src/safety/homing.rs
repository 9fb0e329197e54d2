//! Finding the reference: one transaction for all joints.
//!
//! The operator has set the slides up at the preset (spec h4-milling 1.2: 1135 mm and 485 mm) before power on, within
//! [`JointAxis::search`]; what is moved after that, the counters see ([`crate::drive::counted`]). Homed one by one, four slides of a parallel arm can leave the workspace; so the *pose* moves: along the
//! coordinates that the model names, which shift all joints alike, until every joint has seen its index pulse. A joint that finds none, an
//! index far from where the preset says it is, a pose that the machine cannot take: each ends the homing of all joints.

use crate::config::{AxisKind, Config, JointAxis};
use crate::kinematics::Pose;
use crate::motion::jog::Jog;
use crate::units::Coordinate;
use haptimill_protocol::message::{Fault, HomingProblem, MAX_AXES};

/// Where the homing is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Phase {
    /// To set out: the period of the command had enough to do.
    #[default]
    Aim,
    /// Moving, looking for index pulses.
    Search,
    /// All found; coming to rest.
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
    /// Correction of each joint whose index was found.
    corrections: [Option<Coordinate>; MAX_AXES],
    /// Periods that the search may still take.
    left: u32,
}

/// Pose coordinates whose motion shifts all joints alike: on the H-4 arm x for the slides and alpha for the table.
const SEARCH_COORDINATES: [usize; 2] = [0, 4];

impl Homing {
    /// Sets the jog going from `pose`.
    #[inline(never)]
    fn aim(&mut self, config: &Config, pose: &Pose, jog: &mut Jog) {
        let mut rates = [0_i64; MAX_AXES];
        for coordinate in SEARCH_COORDINATES {
            if let Some(axis) = config.pose.get(coordinate) {
                let rate = i64::from(match axis.kind {
                    AxisKind::Linear => config.homing.rate.0,
                    AxisKind::Rotary => config.homing.table_rate.0,
                });
                // Upwards, but from the upper part of the way back towards its middle.
                let (low, high) = (i64::from(axis.low.0), i64::from(axis.high.0));
                let turning = high - (high - low) / 4;
                let here = i64::from(pose.0[coordinate].0);
                rates[coordinate] = if here > turning { -rate } else { rate };
            }
        }
        self.left = config
            .joints
            .iter()
            .map(|joint| search_periods(config, joint))
            .max()
            .unwrap_or(0);
        jog.aim(&rates, self.left);
        self.phase = Phase::Search;
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
        let missing = (0..config.joints.len()).find(|&joint| self.corrections[joint].is_none());
        match (self.phase, missing) {
            (Phase::Aim, _) => {
                self.aim(config, pose, jog);
                Outcome::Searching
            }
            (Phase::Search, Some(joint)) => {
                let fail = |problem| {
                    Outcome::Failed(Fault::Homing {
                        axis: joint as u8,
                        problem,
                    })
                };
                self.left = self.left.saturating_sub(1);
                if limited {
                    fail(HomingProblem::Workspace)
                } else if self.left == 0 {
                    fail(HomingProblem::NoIndex)
                } else {
                    Outcome::Searching
                }
            }
            (Phase::Search, None) => {
                jog.release();
                self.phase = Phase::Rest;
                Outcome::Searching
            }
            (Phase::Rest, _) if jog.is_still() => {
                Outcome::Found(self.corrections.map(Option::unwrap_or_default))
            }
            (Phase::Rest, _) => Outcome::Searching,
        }
    }
}

/// Periods in which a joint must have seen its index: a turn and a fifth at the search rate, and half a second to get going.
fn search_periods(config: &Config, joint: &JointAxis) -> u32 {
    let rate = i64::from(match joint.kind {
        AxisKind::Linear => config.homing.rate.0,
        AxisKind::Rotary => config.homing.table_rate.0,
    })
    .max(1);
    let travel = i64::from(joint.index_pitch.0) * 6 / 5;
    let period = i64::from(config.period_us).max(1);
    ((travel * 1_000_000 / rate + 500_000) / period).clamp(1, i64::from(u32::MAX)) as u32
}
