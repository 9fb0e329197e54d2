//! Mechanics of the joints: each joint is a motor side and a slide side with a spring and a gap
//! between them.
//!
//! Units are those of [`crate::config`]: axis units (mm or degrees), effort (N or N m), seconds.
//! All joints are integrated side by side in arrays, which keeps a control period within its time
//! budget. Unused lanes have no inertia constants and stay at zero.
//!
//! One step is drift-kick-drift (position Verlet): half a step of motion, one evaluation of the
//! forces in the middle, half a step of motion. Without friction it conserves a nearby energy
//! exactly. The true energy therefore oscillates by (omega * step)^2 / 4, which is 25 ppm at 80 Hz,
//! and does not drift. Each contact or separation at the gap, which falls within a step, changes
//! the energy by up to that amount at random.
//!
//! Coulomb friction has the exact implicit form: an impulse that reduces the rate by at most its
//! bound and ends at zero. A sticking joint has exactly the rate 0.0 and does not chatter.
//!
//! [`Mechanics::step`] is explicit in the springs. Callers must keep omega * step below 0.3, which
//! [`crate::config::PlantConfig::check`] verifies.

use crate::joint::JointConfig;
use haptimill_protocol::message::MAX_AXES;

/// One value for each joint.
pub type JointArray = [f64; MAX_AXES];

/// Positions and rates of both sides of every joint, axis units and axis units/s.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bodies {
    /// Position of the motor side, as an axis coordinate.
    pub motor: JointArray,
    /// Rate of the motor side, per second.
    pub motor_rate: JointArray,
    /// Position of the slide side.
    pub slide: JointArray,
    /// Rate of the slide side, per second.
    pub slide_rate: JointArray,
}

/// Constants of the joints for the inner loop.
#[derive(Debug, Clone, Default)]
pub struct Mechanics {
    /// Half a step, seconds.
    half_step: f64,
    /// Half the gap.
    half_gap: JointArray,
    /// Stiffness of the screw.
    stiffness: JointArray,
    /// Damping of the screw while its flanks touch.
    damping: JointArray,
    /// Largest pull of a closed gap: 0 with backlash, infinite without.
    pull: JointArray,
    /// Change of rate per unit of effort in one step, motor side.
    motor_kick: JointArray,
    /// The same, slide side.
    slide_kick: JointArray,
    /// Coulomb friction as the change of rate in one step, motor side.
    motor_coulomb: JointArray,
    /// The same, slide side.
    slide_coulomb: JointArray,
    /// Factor that viscous friction applies to the rate in one step, motor side.
    motor_keep: JointArray,
    /// The same, slide side.
    slide_keep: JointArray,
    /// Lower hard stop.
    low: JointArray,
    /// Upper hard stop.
    high: JointArray,
    /// Stiffness of the hard stops.
    stop_stiffness: JointArray,
    /// Damping of the hard stops.
    stop_damping: JointArray,
    /// Coulomb friction of the healthy slide side.
    healthy_coulomb: JointArray,
    /// Inertia of the motor side divided by the acceleration unit: effort per axis unit per second
    /// squared.
    motor_inertia: JointArray,
    /// The same, slide side.
    slide_inertia: JointArray,
}

#[inline(always)]
fn clamp(value: f64, low: f64, high: f64) -> f64 {
    // The comparisons compile to two instructions; f64::clamp and f64::max also handle NaN.
    let value = if value > low { value } else { low };
    if value < high { value } else { high }
}

/// Effort of a spring and damper that touch only when `depth` is not 0 and that pull with at most
/// `pull`.
#[inline(always)]
fn contact(depth: f64, rate: f64, stiffness: f64, damping: f64, pull: f64) -> f64 {
    let effort = stiffness * depth + damping * rate;
    let pushed = if effort > -pull { effort } else { -pull };
    let pulled = if effort < pull { effort } else { pull };
    let positive = if depth > 0.0 { pushed } else { 0.0 };
    let negative = if depth < 0.0 { pulled } else { 0.0 };
    positive + negative
}

impl Mechanics {
    /// Computes the constants for steps of `step` seconds. The joints must have passed their check.
    pub fn new(joints: &[JointConfig], step: f64) -> Self {
        let mut this = Self {
            half_step: step / 2.0,
            motor_keep: [1.0; MAX_AXES],
            slide_keep: [1.0; MAX_AXES],
            low: [f64::NEG_INFINITY; MAX_AXES],
            high: [f64::INFINITY; MAX_AXES],
            ..Self::default()
        };
        for (lane, joint) in joints.iter().enumerate().take(MAX_AXES) {
            let unit = joint.kind.acceleration_unit();
            let motor = joint.inertia * joint.motor_share / unit;
            let slide = joint.inertia * (1.0 - joint.motor_share) / unit;
            this.motor_inertia[lane] = motor;
            this.slide_inertia[lane] = slide;
            this.half_gap[lane] = joint.backlash / 2.0;
            this.stiffness[lane] = joint.stiffness();
            this.damping[lane] = joint.damping();
            this.pull[lane] = if joint.backlash > 0.0 {
                0.0
            } else {
                f64::INFINITY
            };
            this.motor_kick[lane] = step / motor;
            this.slide_kick[lane] = step / slide;
            let share = joint.friction_slide_share;
            this.motor_coulomb[lane] = step / motor * joint.coulomb * (1.0 - share);
            this.slide_coulomb[lane] = step / slide * joint.coulomb * share;
            this.healthy_coulomb[lane] = this.slide_coulomb[lane];
            this.motor_keep[lane] = 1.0 / (1.0 + step / motor * joint.viscous * (1.0 - share));
            this.slide_keep[lane] = 1.0 / (1.0 + step / slide * joint.viscous * share);
            this.low[lane] = joint.low;
            this.high[lane] = joint.high;
            this.stop_stiffness[lane] = joint.stop_stiffness;
            // Half of critical damping: a slide that hits the stop returns slowly.
            this.stop_damping[lane] = libm::sqrt(joint.stop_stiffness * slide);
        }
        this
    }

    /// Adds Coulomb friction to the slide of a joint, as a jam. 0 removes the jam, infinity blocks
    /// the slide.
    pub fn jam(&mut self, lane: usize, effort: f64) {
        self.slide_coulomb[lane] = if effort > 0.0 {
            self.healthy_coulomb[lane] + self.slide_kick[lane] * effort
        } else {
            self.healthy_coulomb[lane]
        };
    }

    /// Kinetic and elastic energy of a joint, in effort times axis unit (N mm, or N m degrees).
    pub fn energy(&self, bodies: &Bodies, lane: usize) -> f64 {
        let wind = bodies.motor[lane] - bodies.slide[lane];
        let depth = wind - clamp(wind, -self.half_gap[lane], self.half_gap[lane]);
        let slide = bodies.slide[lane];
        let stop = slide - clamp(slide, self.low[lane], self.high[lane]);
        0.5 * (self.motor_inertia[lane] * bodies.motor_rate[lane] * bodies.motor_rate[lane]
            + self.slide_inertia[lane] * bodies.slide_rate[lane] * bodies.slide_rate[lane]
            + self.stiffness[lane] * depth * depth
            + self.stop_stiffness[lane] * stop * stop)
    }

    /// Momentum of a joint, in effort times seconds.
    pub fn momentum(&self, bodies: &Bodies, lane: usize) -> f64 {
        self.motor_inertia[lane] * bodies.motor_rate[lane]
            + self.slide_inertia[lane] * bodies.slide_rate[lane]
    }

    /// Advances by one step. `drive` acts on the motor sides, `load` on the slides.
    #[inline(always)]
    pub fn step(&self, bodies: &mut Bodies, drive: &JointArray, load: &JointArray) {
        let half = self.half_step;
        for i in 0..MAX_AXES {
            let motor = bodies.motor[i] + half * bodies.motor_rate[i];
            let slide = bodies.slide[i] + half * bodies.slide_rate[i];
            let wind = motor - slide;
            let depth = wind - clamp(wind, -self.half_gap[i], self.half_gap[i]);
            let slip = bodies.motor_rate[i] - bodies.slide_rate[i];
            let screw = contact(
                depth,
                slip,
                self.stiffness[i],
                self.damping[i],
                self.pull[i],
            );
            let beyond = slide - clamp(slide, self.low[i], self.high[i]);
            let stop = contact(
                beyond,
                bodies.slide_rate[i],
                self.stop_stiffness[i],
                self.stop_damping[i],
                0.0,
            );

            let rate = bodies.motor_rate[i] + self.motor_kick[i] * (drive[i] - screw);
            let rate = (rate - clamp(rate, -self.motor_coulomb[i], self.motor_coulomb[i]))
                * self.motor_keep[i];
            bodies.motor_rate[i] = rate;
            bodies.motor[i] = motor + half * rate;

            let rate = bodies.slide_rate[i] + self.slide_kick[i] * (load[i] + screw - stop);
            let rate = (rate - clamp(rate, -self.slide_coulomb[i], self.slide_coulomb[i]))
                * self.slide_keep[i];
            bodies.slide_rate[i] = rate;
            bodies.slide[i] = slide + half * rate;
        }
    }
}
