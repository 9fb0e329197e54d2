//! Motors of the haptic arm with their amplifiers: from the converter's code to a joint effort.
//!
//! The current of a current-mode amplifier, and with it the force of the motor, is proportional to
//! the code (docs/control.md 2.4), up to a limit. The current follows its command with a
//! first-order lag. Without its enable, and after a trip, the amplifier commands no current. Codes
//! hold for a control period.
//!
//! Units: N for a slide, N mm for a turn.

use crate::check::Check;
use haptimill_firmware::io::{HapticOutputs, LEGS};
use serde::{Deserialize, Serialize};

/// Drive, inertia and friction of one joint of a leg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuatorConfig {
    /// Inertia of motor and transmission referred to the joint: kg for a slide, kg mm^2 for a turn.
    pub inertia: f64,
    /// Coulomb friction, N or N mm.
    pub coulomb: f64,
    /// Viscous friction, N s/mm or N mm s.
    pub viscous: f64,
    /// Effort for code 8192, N or N mm; negative for a reversed amplifier.
    pub full_scale: f64,
    /// Largest effort of the motor, N or N mm.
    pub limit: f64,
}

impl ActuatorConfig {
    pub(super) fn check(&self, name: &str, check: &mut Check) {
        let field = |key: &str| format!("haptic: {name}: {key}");
        check.within(field("inertia"), self.inertia, 0.0, 1e5);
        check.within(field("coulomb"), self.coulomb, 0.0, 1e5);
        check.within(field("viscous"), self.viscous, 0.0, 1e4);
        check.within(field("full_scale"), self.full_scale.abs(), 1e-6, 1e6);
        check.within(field("limit"), self.limit, 0.0, 1e6);
    }
}

/// The six motors.
#[derive(Debug, Clone)]
pub struct Motors {
    per_code: [f64; 2],
    limit: [f64; 2],
    /// Fraction of its deviation from the command that a current covers in a step.
    follows: f64,
    force: [f64; 2 * LEGS],
    /// Commanded efforts of this period.
    commanded: [f64; 2 * LEGS],
    tripped: bool,
}

impl Motors {
    /// Creates motors without current, for steps of `step` seconds.
    pub fn new(slide: &ActuatorConfig, turn: &ActuatorConfig, lag_s: f64, step: f64) -> Self {
        Self {
            per_code: [slide, turn].map(|actuator| actuator.full_scale / 8192.0),
            limit: [slide, turn].map(|actuator| actuator.limit),
            follows: if lag_s > 0.0 {
                1.0 - libm::exp(-step / lag_s)
            } else {
                1.0
            },
            force: [0.0; 2 * LEGS],
            commanded: [0.0; 2 * LEGS],
            tripped: false,
        }
    }

    /// Sets the codes of a period.
    pub fn command(&mut self, outputs: &HapticOutputs, powered: bool) {
        let alive = powered && outputs.enabled && !self.tripped;
        for (index, commanded) in self.commanded.iter_mut().enumerate() {
            let kind = index % 2;
            let force = f64::from(outputs.currents[index / 2][kind]) * self.per_code[kind];
            *commanded = if alive {
                force.clamp(-self.limit[kind], self.limit[kind])
            } else {
                0.0
            };
        }
    }

    /// Returns whether all efforts and all commands are zero.
    pub fn still(&self) -> bool {
        let small = |force: &f64| force.abs() < 1e-9;
        self.commanded.iter().all(|commanded| *commanded == 0.0) && self.force.iter().all(small)
    }

    /// Advances by one step and returns the joint efforts, slide and turn of each leg.
    #[inline]
    pub fn step(&mut self) -> [f64; 2 * LEGS] {
        for (force, commanded) in self.force.iter_mut().zip(&self.commanded) {
            *force += (commanded - *force) * self.follows;
        }
        self.force
    }

    /// Present efforts: N along the slides, N mm about them.
    pub const fn force(&self) -> [f64; 2 * LEGS] {
        self.force
    }

    /// Returns whether the amplifiers report that they are healthy.
    pub const fn ready(&self) -> bool {
        !self.tripped
    }

    /// Trips the amplifiers, or resets them.
    pub const fn set_tripped(&mut self, tripped: bool) {
        self.tripped = tripped;
    }
}
