//! A joint of the plant: its drive, encoder and switches, and their injected faults.

use crate::fault::Switch as Kind;
use crate::joint::encoder::Encoder;
use crate::joint::mechanics::{Bodies, JointArray};
use crate::joint::stepper::Stepper;
use crate::joint::switch::{Switch, SwitchCondition, SwitchPlace};
use crate::joint::{DriveConfig, JointConfig, SwitchSide};
use crate::random::Random;
use haptimill_firmware::io::{DriveCommand, Outputs};

/// Injected faults of a joint, without its encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointCondition {
    /// Ratio of the drive's effort to the commanded one: 1 healthy, 0 dead, negative reversed.
    pub drive_gain: f64,
    /// The drive reports a fault and gives no effort.
    pub drive_tripped: bool,
    /// Additional Coulomb friction on the slide, effort; infinity blocks it.
    pub jam: f64,
    /// Home switch, lower and upper limit switch.
    pub switches: [SwitchCondition; SWITCHES],
}

/// Number of switches of a joint: home, lower limit, upper limit.
pub const SWITCHES: usize = 3;

impl Default for JointCondition {
    fn default() -> Self {
        Self {
            drive_gain: 1.0,
            drive_tripped: false,
            jam: 0.0,
            switches: [SwitchCondition::default(); SWITCHES],
        }
    }
}

#[derive(Debug, Clone)]
pub(super) enum Drive {
    Torque { per_code: f64, limit: f64 },
    Steps(Box<Stepper>),
}

#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub(super) config: JointConfig,
    pub(super) drive: Drive,
    pub(super) encoder: Option<Encoder>,
    pub(super) switches: [Switch; SWITCHES],
    pub(super) condition: JointCondition,
}

impl Joint {
    /// A joint with its slide at `start`; `lane` is its index.
    pub(super) fn new(
        joint: &JointConfig,
        lane: usize,
        start: f64,
        seed: u64,
        period_us: u16,
    ) -> Self {
        Self {
            drive: match &joint.drive {
                DriveConfig::Torque(drive) => Drive::Torque {
                    per_code: drive.full_scale / 8192.0,
                    limit: drive.limit,
                },
                DriveConfig::Steps(drive) => {
                    Drive::Steps(Box::new(Stepper::new(joint, drive, start, period_us)))
                }
            },
            encoder: joint.encoder.as_ref().map(|encoder| {
                let random = Random::new(seed, 16 + lane as u64);
                Encoder::new(joint, encoder, start, random)
            }),
            switches: switches(joint, start, seed, lane),
            condition: JointCondition::default(),
            config: joint.clone(),
        }
    }

    /// Effort of a torque drive for this command.
    pub(super) fn torque(&self, command: &DriveCommand, powered: bool) -> f64 {
        match (&self.drive, command) {
            (Drive::Torque { per_code, limit }, DriveCommand::Torque(code)) if powered => {
                (f64::from(*code) * per_code).clamp(-limit, *limit) * self.condition.drive_gain
            }
            _ => 0.0,
        }
    }

    /// Level of the line of a switch.
    pub(super) fn level(&self, switch: usize) -> bool {
        self.switches[switch].level(&self.condition.switches[switch])
    }
}

/// The switches of a joint with its slide at `slide`.
fn switches(joint: &JointConfig, slide: f64, seed: u64, lane: usize) -> [Switch; SWITCHES] {
    let limit = |at: Option<f64>, side| {
        at.map(|at| SwitchPlace {
            at,
            side,
            hysteresis: 0.0,
            bounce_ms: 0.0,
        })
    };
    let home = joint.home.as_ref().map(|home| SwitchPlace {
        at: home.at,
        side: home.active,
        hysteresis: home.hysteresis,
        bounce_ms: home.bounce_ms,
    });
    let places = [
        (Kind::Home, home),
        (Kind::LimitLow, limit(joint.limit_low, SwitchSide::Below)),
        (Kind::LimitHigh, limit(joint.limit_high, SwitchSide::Above)),
    ];
    places.map(|(kind, place)| {
        let random = Random::new(seed, 64 + 4 * lane as u64 + kind as u64);
        Switch::new(place, joint.active_low.contains(&kind), slide, random)
    })
}

/// Computes the efforts of the step motors at the fraction `part` of the period.
pub(super) fn step_efforts(
    joints: &mut [Joint],
    outputs: &Outputs,
    powered: bool,
    part: f64,
    bodies: &Bodies,
    drive: &mut JointArray,
) {
    for (index, joint) in joints.iter_mut().enumerate() {
        if let (Drive::Steps(stepper), DriveCommand::Steps(_)) =
            (&mut joint.drive, &outputs.joints[index])
        {
            let effort = stepper.effort(part, bodies.motor[index], bodies.motor_rate[index]);
            let alive = powered && !joint.condition.drive_tripped;
            drive[index] = if alive {
                effort * joint.condition.drive_gain
            } else {
                0.0
            };
        }
    }
}
