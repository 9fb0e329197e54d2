//! The moving masses: every joint is a motor side and a slide side with a spring and a gap between them.
//!
//! Units are those of [`crate::config`]: axis units (mm or degrees), effort (N or N m), seconds. All joints are integrated side by
//! side in arrays, because that is what keeps a control period within its budget; unused lanes have no inertia constants and stand still.
//!
//! One step is drift-kick-drift (position Verlet): half a step of motion, one evaluation of the forces in the middle, half a step of
//! motion. Without friction it conserves a nearby energy exactly, so the true energy only swings by (omega * step)^2 / 4, which is
//! 25 ppm at 80 Hz, and does not drift; an edge of the gap, which falls somewhere within a step, adds or takes up to that at random. Coulomb friction is the exact implicit form: an impulse that takes away speed up to its bound and stops at zero. So a
//! joint that sticks has speed 0.0 to the last bit, and nothing chatters.
//!
//! Misuse: [`Mechanics::step`] is explicit in the springs; [`crate::config::PlantConfig::check`] keeps omega * step below 0.3.

use crate::joint::JointConfig;
use haptimill_protocol::message::MAX_AXES;

/// One value for each joint.
pub type JointArray = [f64; MAX_AXES];

/// Positions and rates of both sides of every joint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bodies {
    /// Motor side, as a coordinate of the axis.
    pub motor: JointArray,
    /// Rate of the motor side, per second.
    pub motor_rate: JointArray,
    /// Slide side: where the slide really is.
    pub slide: JointArray,
    /// Rate of the slide side, per second.
    pub slide_rate: JointArray,
}

/// Constants of the joints, ready for the inner loop.
#[derive(Debug, Clone, Default)]
pub struct Mechanics {
    /// Half a step, seconds.
    half_step: f64,
    /// Half the gap.
    half_gap: JointArray,
    /// Stiffness of the screw.
    stiffness: JointArray,
    /// Damping of the screw, while it touches.
    damping: JointArray,
    /// How hard a closed gap can pull: nothing when there is a gap, without bound when there is none.
    pull: JointArray,
    /// Change of rate by one unit of effort in a step, motor side.
    motor_kick: JointArray,
    /// The same, slide side.
    slide_kick: JointArray,
    /// Coulomb friction as the change of rate in a step, motor side.
    motor_coulomb: JointArray,
    /// The same, slide side.
    slide_coulomb: JointArray,
    /// Part of the rate that viscous friction leaves after a step, motor side.
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
    /// Inertia of the motor side divided by the acceleration unit: effort per axis unit per second squared.
    motor_inertia: JointArray,
    /// The same, slide side.
    slide_inertia: JointArray,
}

#[inline(always)]
fn clamp(value: f64, low: f64, high: f64) -> f64 {
    // Written as comparisons so that it is two instructions; f64::clamp and f64::max also mind NaN.
    let value = if value > low { value } else { low };
    if value < high { value } else { high }
}

/// The effort of a spring and damper that touches only when `depth` is not 0 and pulls no harder than `pull`.
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
    /// Prepares the constants for steps of `step` seconds. The joints must have passed their check.
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
            // Half of critical: a slide that hits the stop comes back slowly.
            this.stop_damping[lane] = libm::sqrt(joint.stop_stiffness * slide);
        }
        this
    }

    /// Adds Coulomb friction to the slide of a joint: a jam. 0 heals it, infinity holds it fast.
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

    /// One step: `drive` acts on the motor sides, `load` on the slides.
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
