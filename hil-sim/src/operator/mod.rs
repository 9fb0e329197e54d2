//! Operator model at the handle of the haptic arm: intended motion and compliance of the operator's
//! hand.
//!
//! The model has four parts with different time scales, one line each:
//!
//! ```text
//! perceived force  F_r' = (F(t - T_r) . s - F_r) / T_s
//! pace             v = v_0 (1 - F_r / F_0), within 0 and v_0
//! effort           T_e E' = G K e(t - T_r) - E
//! force            F = K (x_d - x) + B (v - x') + E, at most F_max
//! ```
//!
//! * *perceived force*: the force on the hand along its path s, after the reaction time.
//! * *pace*: the operator decelerates against resistance, and stops at F_0.
//! * *effort*: the operator sees the position error e of the tip, and pushes harder.
//! * *force*: spring and damper of the arm itself, without delay.
//!
//! Here x_d is the position that the trajectory has reached at that speed ([`trajectory`]). The
//! mass of the hand acts at the grip and moves with the handle. Rotation about the upright handle
//! uses the same equations, without a speed. Where the hand presses against an edge, the direction
//! of the edge's normal has a force instead of a position.
//!
//! One set of parameters serves all scenarios; docs/decisions states its origin. F_0 and T_r
//! determine the compliance: of a speed of 20 mm/s, 12 mm/s remain against 2.8 N, 4 mm/s against
//! 5.6 N.
//!
//! Units: mm, N, N mm, s, rad; positions of the tip from its home, axes of the master's base.
//!
//! This model cannot show whether a controller is safe with *every* operator. Callers must sweep
//! stiffness and mass for that, and let the operator hold the handle without a trajectory.

pub mod contact;
pub mod trajectory;

pub use contact::{Rail, ReferencePart};
pub use trajectory::{Live, Stroke, Trace, Trajectory};

use crate::check::{Check, PlantError};
use crate::vector::{Vector, dot, length, minus, plus, times};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use trajectory::{Carried, IntendedMotion, without};

/// Parameters of the operator: the `[plant.operator]` section of a machine file. All keys are
/// optional.
///
/// ```
/// let text = r#"
/// grip_mm = [0.0, 0.0, 75.0]
/// mass_kg = 0.5
/// stiffness = 0.8          # N/mm
/// damping = 0.04           # N s/mm
/// turn_stiffness = 5000.0  # N mm/rad
/// turn_damping = 150.0     # N mm s/rad
/// force_limit_n = 12.0
/// moment_limit_n_mm = 2000.0
/// reaction_s = 0.2
/// smoothing_s = 0.3
/// effort_gain = 3.0
/// effort_s = 1.2
/// stop_force_n = 7.0
/// "#;
/// let written: haptimill_hil_sim::operator::OperatorConfig = toml::from_str(text).unwrap();
/// assert_eq!(written, haptimill_hil_sim::operator::OperatorConfig::default());
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OperatorConfig {
    /// Grip position in the platform's frame, mm.
    pub grip_mm: [f64; 3],
    /// Mass of hand and forearm that moves with the handle, kg.
    pub mass_kg: f64,
    /// Stiffness K, N/mm.
    pub stiffness: f64,
    /// Damping B, N s/mm.
    pub damping: f64,
    /// Rotational stiffness, N mm/rad.
    pub turn_stiffness: f64,
    /// Rotational damping, N mm s/rad.
    pub turn_damping: f64,
    /// Largest force of the hand, N.
    pub force_limit_n: f64,
    /// Largest moment of the hand, N mm.
    pub moment_limit_n_mm: f64,
    /// Reaction time T_r from perception to action, s.
    pub reaction_s: f64,
    /// Time constant T_s of the perceived force, s.
    pub smoothing_s: f64,
    /// Final gain G of the visual position correction, in multiples of the stiffness; 0 switches it
    /// off.
    pub effort_gain: f64,
    /// Time constant T_e of the visual position correction, s.
    pub effort_s: f64,
    /// Force F_0 against the motion that stops the hand, N; infinity switches the deceleration off.
    pub stop_force_n: f64,
}

impl Default for OperatorConfig {
    fn default() -> Self {
        Self {
            grip_mm: [0.0, 0.0, 75.0],
            mass_kg: 0.5,
            stiffness: 0.8,
            damping: 0.04,
            turn_stiffness: 5000.0,
            turn_damping: 150.0,
            force_limit_n: 12.0,
            moment_limit_n_mm: 2000.0,
            reaction_s: 0.2,
            smoothing_s: 0.3,
            effort_gain: 3.0,
            effort_s: 1.2,
            stop_force_n: 7.0,
        }
    }
}

impl OperatorConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems, not only the first.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        let field = |key: &str| format!("operator: {key}");
        for (axis, value) in self.grip_mm.into_iter().enumerate() {
            check.within(field(&format!("grip_mm {axis}")), value, -500.0, 500.0);
        }
        check.within(field("mass_kg"), self.mass_kg, 0.0, 10.0);
        check.within(field("stiffness"), self.stiffness, 1e-3, 20.0);
        check.within(field("damping"), self.damping, 0.0, 2.0);
        check.within(field("turn_stiffness"), self.turn_stiffness, 1.0, 1e6);
        check.within(field("turn_damping"), self.turn_damping, 0.0, 1e5);
        check.within(field("force_limit_n"), self.force_limit_n, 0.0, 200.0);
        check.within(field("moment_limit_n_mm"), self.moment_limit_n_mm, 0.0, 1e5);
        check.within(field("reaction_s"), self.reaction_s, 0.0, 2.0);
        check.within(field("smoothing_s"), self.smoothing_s, 0.0, 10.0);
        check.within(field("effort_gain"), self.effort_gain, 0.0, 100.0);
        check.within(field("effort_s"), self.effort_s, 1e-2, 100.0);
        check.within(
            field("stop_force_n"),
            self.stop_force_n,
            1e-2,
            f64::INFINITY,
        );
        check.done()
    }
}

/// State of the handle that the operator perceives.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Handle {
    /// Tip, mm from its home.
    pub tip: Vector,
    /// Rotation from upright, as a rotation vector, rad.
    pub turned: Vector,
}

/// Perception at one time.
#[derive(Debug, Clone, Copy, Default)]
struct Observation {
    resistance: f64,
    off: Vector,
    turned: Vector,
}

/// State of the operator model.
#[derive(Debug, Clone)]
pub struct Operator {
    config: OperatorConfig,
    carried: Carried,
    desired: IntendedMotion,
    past: VecDeque<Observation>,
    /// Perceived force along the path, N.
    applied: f64,
    /// Force and moment of the visual correction.
    effort: Vector,
    moment: Vector,
    /// Present force and moment, N and N mm.
    force: Vector,
    turning: Vector,
    pace: f64,
}

/// Limits the length of a vector.
fn within(vector: Vector, max: f64) -> Vector {
    let size = length(vector);
    if size > max {
        times(vector, max / size)
    } else {
        vector
    }
}

impl Operator {
    /// Creates an operator that holds the handle where it is; the model runs once every `period_s`
    /// seconds. The configuration must have passed its check.
    pub fn new(config: &OperatorConfig, handle: &Handle, period_s: f64) -> Self {
        let delay = libm::round(config.reaction_s / period_s) as usize;
        let carried = Carried::new(Trajectory::Hold, handle.tip);
        Self {
            desired: IntendedMotion {
                place: handle.tip,
                ..IntendedMotion::default()
            },
            carried,
            past: core::iter::repeat_n(Observation::default(), delay).collect(),
            applied: 0.0,
            effort: [0.0; 3],
            moment: [0.0; 3],
            force: [0.0; 3],
            turning: [0.0; 3],
            pace: 1.0,
            config: config.clone(),
        }
    }

    /// Configuration of the operator.
    pub const fn config(&self) -> &OperatorConfig {
        &self.config
    }

    /// Sets a new trajectory, which starts at the end of the last one. The present force continues.
    pub fn set_trajectory(&mut self, trajectory: Trajectory) {
        self.carried = Carried::new(trajectory, self.desired.place);
    }

    /// Sets the live target; no effect unless the trajectory is a live one.
    pub const fn live(&mut self, live: Live) {
        self.carried.live(live);
    }

    /// Present trajectory.
    pub const fn trajectory(&self) -> &Trajectory {
        self.carried.trajectory()
    }

    /// Present desired motion.
    pub const fn desired(&self) -> &IntendedMotion {
        &self.desired
    }

    /// Fraction of its intended speed that the hand keeps.
    pub const fn pace(&self) -> f64 {
        self.pace
    }

    /// Force on the handle, N.
    pub const fn force(&self) -> Vector {
        self.force
    }

    /// Advances perception and trajectory by one period.
    pub fn update(&mut self, handle: &Handle, dt: f64) {
        let off = minus(self.desired.place, handle.tip);
        let now = Observation {
            resistance: dot(self.force, self.desired.along),
            off: match self.desired.press {
                Some((normal, _)) => without(off, normal),
                None => off,
            },
            turned: handle.turned,
        };
        self.past.push_back(now);
        let seen = self.past.pop_front().unwrap_or_default();
        let config = &self.config;
        let keep = dt / (config.smoothing_s + dt);
        self.applied += (seen.resistance - self.applied) * keep;
        self.pace = (1.0 - self.applied / config.stop_force_n).clamp(0.0, 1.0);
        self.desired = self.carried.advance(dt, self.pace, handle.tip);
        let (gain, step) = (config.effort_gain, dt / (config.effort_s + dt));
        let towards = |from: Vector, to: Vector| plus(from, times(minus(to, from), step));
        self.effort = towards(self.effort, times(seen.off, gain * config.stiffness));
        if let Some((normal, _)) = self.desired.press {
            self.effort = without(self.effort, normal);
        }
        self.effort = within(self.effort, config.force_limit_n);
        let upright = times(seen.turned, -gain * config.turn_stiffness);
        self.moment = within(towards(self.moment, upright), config.moment_limit_n_mm);
    }

    /// Force (N, at the grip) and moment (N mm) on the handle, `later` seconds after the period
    /// began. `place` is the grip's position from its home, and `turned` the rotation, each with
    /// its rate.
    pub fn force_on(
        &mut self,
        (place, velocity): (Vector, Vector),
        (turned, spin): (Vector, Vector),
        later: f64,
    ) -> (Vector, Vector) {
        let (config, desired) = (&self.config, &self.desired);
        let commanded = plus(desired.place, times(desired.velocity, later));
        let mut spring = times(minus(commanded, place), config.stiffness);
        let mut press = [0.0; 3];
        if let Some((normal, force)) = desired.press {
            spring = without(spring, normal);
            press = times(normal, force);
        }
        let damper = times(minus(desired.velocity, velocity), config.damping);
        let sum = plus(plus(spring, damper), plus(self.effort, press));
        self.force = within(sum, config.force_limit_n);
        let turning: Vector = core::array::from_fn(|i| {
            self.moment[i] - config.turn_stiffness * turned[i] - config.turn_damping * spin[i]
        });
        self.turning = within(turning, config.moment_limit_n_mm);
        (self.force, self.turning)
    }
}
