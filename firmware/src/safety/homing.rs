//! Finding the reference: one transaction for all joints.
//!
//! The operator sets the joints to their presets before power-on, within
//! [`EncoderSettings::search`]. Motion after that is known from the counters
//! ([`crate::joint::power_on_counts`]).
//!
//! Joints of a parallel arm that home one by one can leave the workspace, so the *pose* moves. The
//! machine names for each joint the coordinate that moves in its search, and the pose rates
//! ([`haptimill_kinematics::Machine::search_rates`]). Joints with the same coordinate are searched
//! together, in the order of the joints. At a bound of the workspace the search reverses once.
//! The jog keeps its whole stopping envelope within the workspace. Near a bound that the search
//! does not move along, the envelope of the full rate may not fit in either direction: the search
//! then starts again at a quarter of the rate, and at a sixteenth.
//!
//! Homing of all joints fails if a joint finds no index, finds one too far from its position by the
//! preset, or if a pose is unreachable.

use crate::config::{AxisKind, Config, EncoderSettings, JointSettings};
use crate::motion::jog::Jog;
use haptimill_kinematics::{BoundedKinematics, Pose};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Fault, HomingProblem, MAX_AXES};

/// Halvings of the search rate in each slower search, and at most. A stopping distance at limited
/// jerk is proportional to the rate to the power of 3/2: at a sixteenth it is a 64th.
const SLOWER: u8 = 2;
const SLOWEST: u8 = 4;

/// Step of the homing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum HomingPhase {
    /// To start, in the period after the command.
    #[default]
    Aim,
    /// Moving, searching for index pulses.
    Search,
    /// All pulses of a search found, or the workspace ends: decelerating.
    Rest,
}

/// Result of a period of homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HomingProgress {
    /// Not yet.
    Searching,
    /// Every joint has its index: the corrections to add to the coordinates of the joints.
    Found([Coordinate; MAX_AXES]),
    /// All joints must stop.
    Failed(Fault),
}

/// The machine whose joints are searched.
pub struct Searched<'a> {
    /// Its configuration.
    pub config: &'a Config,
    /// Its kinematics.
    pub kinematics: &'a BoundedKinematics,
}

/// A homing in progress.
#[derive(Debug, Clone, Copy, Default)]
pub struct Homing {
    phase: HomingPhase,
    /// Coordinate that moves in the present search.
    coordinate: Option<usize>,
    /// Direction of the search.
    downwards: bool,
    /// The present search has reached the end of the workspace and reversed.
    reversed: bool,
    /// Halvings of the search rate.
    slower: u8,
    /// Correction of each joint whose index was found.
    corrections: [Option<Coordinate>; MAX_AXES],
    /// Periods that the search may still take.
    left: u32,
}

impl Homing {
    /// Starts the search for the joints that are searched with `joint`.
    #[inline(never)]
    fn start_search(&mut self, machine: &Searched<'_>, joint: usize, pose: &Pose, jog: &mut Jog) {
        let coordinate = machine.kinematics.search_coordinate(joint);
        if self.coordinate != Some(coordinate) {
            self.coordinate = Some(coordinate);
            self.reversed = false;
            self.slower = 0;
            // Upwards, but from the upper quarter of the range towards its middle.
            self.downwards = machine.config.pose.get(coordinate).is_some_and(|limits| {
                let (low, high) = (i64::from(limits.low.0), i64::from(limits.high.0));
                i64::from(pose.0[coordinate].0) > high - (high - low) / 4
            });
        }
        self.left = (machine.config.joints.iter().enumerate())
            .filter(|(other, _)| machine.kinematics.search_coordinate(*other) == coordinate)
            .map(|(_, other)| search_periods(machine.config, other, self.slower))
            .max()
            .unwrap_or(0);
        self.steer(machine, joint, pose, jog);
        self.phase = HomingPhase::Search;
    }

    /// Sets the rates of this period; they depend on the pose.
    fn steer(&self, machine: &Searched<'_>, joint: usize, pose: &Pose, jog: &mut Jog) {
        let Some(settings) = machine.config.joints.get(joint) else {
            return;
        };
        let rate = search_rate(machine.config, settings.kind) >> self.slower;
        let rate = if self.downwards { -rate } else { rate };
        let rates = machine.kinematics.search_rates(joint, pose, rate);
        jog.set_rates(&rates, self.left);
    }

    /// Takes the correction of a joint that is not searched.
    pub fn place(&mut self, joint: usize, correction: i32) {
        if let Some(slot) = self.corrections.get_mut(joint) {
            *slot = Some(Coordinate(correction));
        }
    }

    /// Takes the index pulse of a joint: the coordinate, by the preset, at which it came.
    pub fn index(
        &mut self,
        joint: usize,
        config: &EncoderSettings,
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
                joint: joint as u8,
                problem: HomingProblem::Implausible,
            });
        }
        *slot = Some(Coordinate(off as i32));
        None
    }

    /// One period, with the machine commanded to `pose`; `limited` is true while the jog was
    /// limited. The first period starts the search.
    pub fn advance(
        &mut self,
        machine: &Searched<'_>,
        pose: &Pose,
        jog: &mut Jog,
        limited: bool,
    ) -> HomingProgress {
        let joints = 0..machine.config.joints.len().min(MAX_AXES);
        let missing = { joints }.find(|joint| self.corrections[*joint].is_none());
        match (self.phase, missing) {
            (HomingPhase::Aim, Some(joint)) => self.start_search(machine, joint, pose, jog),
            (HomingPhase::Search, Some(joint))
                if self.coordinate == Some(machine.kinematics.search_coordinate(joint)) =>
            {
                self.left = self.left.saturating_sub(1);
                let problem = if limited && self.reversed && self.slower >= SLOWEST {
                    HomingProblem::Workspace
                } else if limited {
                    if self.reversed {
                        self.slower += SLOWER;
                    }
                    self.reversed = !self.reversed;
                    self.downwards = !self.downwards;
                    jog.release();
                    self.phase = HomingPhase::Rest;
                    return HomingProgress::Searching;
                } else if self.left == 0 {
                    HomingProblem::NoIndex
                } else {
                    self.steer(machine, joint, pose, jog);
                    return HomingProgress::Searching;
                };
                return HomingProgress::Failed(Fault::Homing {
                    joint: joint as u8,
                    problem,
                });
            }
            (HomingPhase::Aim | HomingPhase::Search, _) => {
                jog.release();
                self.phase = HomingPhase::Rest;
            }
            (HomingPhase::Rest, Some(_)) if jog.is_at_standstill() => self.phase = HomingPhase::Aim,
            (HomingPhase::Rest, None) if jog.is_at_standstill() => {
                return HomingProgress::Found(self.corrections.map(Option::unwrap_or_default));
            }
            (HomingPhase::Rest, _) => {}
        }
        HomingProgress::Searching
    }
}

/// Rate of the coordinate that searches for the joints of a kind.
fn search_rate(config: &Config, kind: AxisKind) -> i64 {
    i64::from(match kind {
        AxisKind::Linear => config.homing.rate.0,
        AxisKind::Rotary => config.homing.rotary_rate.0,
        AxisKind::MultiTurn => config.homing.multi_turn_rate(),
    })
}

/// Periods in which a joint must have seen its index: a turn and a fifth at the search rate, and
/// half a second to accelerate.
fn search_periods(config: &Config, joint: &JointSettings, slower: u8) -> u32 {
    let rate = (search_rate(config, joint.kind) >> slower).max(1);
    let pitch = joint
        .encoder
        .as_ref()
        .map_or(0, |encoder| encoder.index_pitch.0);
    let travel = i64::from(pitch) * 6 / 5;
    let period = i64::from(config.period_us).max(1);
    ((travel * 1_000_000 / rate + 500_000) / period).clamp(1, i64::from(u32::MAX)) as u32
}
