//! Junction of two blocks: its maximum speed and its rounding.
//!
//! The motion through a corner is the motion along the two exact paths plus a *bump*, which cancels
//! the jump of velocity. The speed v is constant for the time h around the corner. The jump is dv,
//! which is v times u2 less u1. The acceleration of the bump is a triangle from 0 over 2 dv / h to
//! 0: jerk 4 dv / h^2, two cubics, largest deviation dv h / 12 at the corner, which is a sixth of
//! the magnitude of the difference of u2 and u1 times the half-length d, v h / 2.
//!
//! A jump of curvature, k2 less k1, is a jump of acceleration da, v^2 times as large. A second bump
//! cancels it: with x the time from the corner in half-durations, da (h/2)^2 phi(x). phi is odd,
//! and its second derivative for x above 0 is linear from -1/2 with a slope m up to x1, then with
//! the slope -m to 0 at 1. x1 = 2^(-2/3) and m = 1 / (4 x1 - 2) make it and its slope 0 at 1. The
//! jerk is 2 m da / h, the acceleration at most 0.176 da beyond those of the paths, the deviation
//! at most 0.0146 times k2 less k1 times d^2.

use super::block::{ACCELERATION_SHARE, Block, JERK_SHARE, JOINT_CORNER_JERK, JOINT_RAMP_SHARE};
use super::limits::Settings;
use haptimill_gcode::{Coordinates, WordKind};

/// Largest half-length of a rounding, as a fraction of the shorter block. The rest is for
/// acceleration and deceleration.
const REACH_SHARE: f64 = 0.35;
/// Cosine of the largest corner without a stop: 120 degrees.
const SHARPEST_COSINE: f64 = -0.5;
/// Share of the limits for a rounding next to an arc; the centripetal acceleration takes the rest.
const ARC_SHARE: f64 = 0.45;
/// Share of the jerk limit for the bump of a jump of curvature. With [`ARC_SHARE`] for a corner and
/// the share of the arc itself it is below 1.
const BEND_JERK_SHARE: f64 = 0.2;
/// Share of the tolerance for the bump of a jump of curvature; the rest is for the corner.
const BEND_TOLERANCE_SHARE: f64 = 0.1;
/// m and x1 of the bump.
pub(crate) const BEND_SLOPE: f64 = 0.851_207_191_959_657_4;
pub(crate) const BEND_TURN: f64 = 0.793_700_525_984_1;
/// Largest value of phi, rounded up.
const BEND_VALUE: f64 = 0.0146;
/// Directions that differ by less are equal: at 100 mm/s this is a tenth of the resolution of
/// rates.
const SAME_DIRECTION: f64 = 1e-7;

/// A junction of two blocks.
#[derive(Debug, Clone)]
pub(crate) struct Corner {
    /// Maximum speed.
    pub speed: f64,
    /// u2 - u1: change of velocity per unit of speed.
    pub change: Coordinates,
    /// k2 - k1: change of acceleration per square of speed.
    pub bend: Coordinates,
    /// The duration of a rounding at speed v is at least v * `per_speed`, sqrt(v) * `per_root` and
    /// v^2 * `per_square`.
    per_speed: f64,
    per_root: f64,
    per_square: f64,
    /// Largest v * h: from the tolerance and the lengths of the blocks.
    largest: f64,
    /// Preferred duration of a rounding.
    preferred: f64,
    /// Maximum speed that the jump of curvature allows.
    bend_speed: f64,
}

impl Corner {
    /// Returns a junction with a stop.
    pub(crate) fn stop() -> Corner {
        Corner {
            speed: 0.0,
            change: [0.0; 6],
            bend: [0.0; 6],
            per_speed: 0.0,
            per_root: 0.0,
            per_square: 0.0,
            largest: 0.0,
            preferred: 0.0,
            bend_speed: f64::INFINITY,
        }
    }

    /// Returns the junction between two blocks.
    pub(crate) fn between(before: &Block, after: &Block, settings: &Settings) -> Corner {
        let tolerance = match (before.tolerance, after.tolerance) {
            // Parts of a move have no corner.
            _ if before.continues => settings.tolerance_mm.max(1e-3),
            (Some(one), Some(other)) => one.min(other),
            (one, other) => one.or(other).unwrap_or(settings.tolerance_mm),
        };
        // At standstill the speed factor takes that of the overrides, or 1 without them, at once.
        let is_alike =
            (before.path.measure, before.is_fixed) == (after.path.measure, after.is_fixed);
        if before.exact_stop || tolerance < 1e-6 || !is_alike {
            return Corner::stop();
        }
        let (u1, u2) = (&before.tangents[1], &after.tangents[0]);
        let mut corner = Corner::stop();
        corner.speed = before.along.speed.min(after.along.speed);
        corner.preferred = 2.0 * settings.shortest_span_s;
        corner.largest = 2.0 * REACH_SHARE * before.path.length.min(after.path.length);

        let is_arc = before.path.arc.is_some() || after.path.arc.is_some();
        let (acceleration_share, jerk_share) = if is_arc {
            (ARC_SHARE, ARC_SHARE)
        } else {
            (ACCELERATION_SHARE, JERK_SHARE)
        };
        let (mut dot, mut norm1, mut norm2) = (0.0, 0.0, 0.0);
        let mut squared = [0.0; 2];
        for (k, axis) in settings.pose.iter().enumerate() {
            let rotary = usize::from(axis.kind == WordKind::Rotary);
            // Direction of the tip, or of the rotary axes if only they move.
            if rotary == usize::from(before.path.tip_length() == 0.0) {
                dot += u1[k] * u2[k];
                norm1 += u1[k] * u1[k];
                norm2 += u2[k] * u2[k];
            }
            let change = u2[k] - u1[k];
            if change.abs() < SAME_DIRECTION {
                continue;
            }
            corner.change[k] = change;
            squared[rotary] += change * change;
            corner.need(
                change.abs(),
                acceleration_share * axis.acceleration,
                jerk_share * axis.jerk,
            );
        }
        if dot < SHARPEST_COSINE * (norm1 * norm2).sqrt() {
            return Corner::stop();
        }
        let (m1, m2) = (&before.machine_tangents[1], &after.machine_tangents[0]);
        for ((axis, m1), m2) in settings.pose.iter().zip(m1).zip(m2) {
            let change = (m2 - m1).abs();
            if change > SAME_DIRECTION {
                let jerk = jerk_share * axis.jerk;
                corner.need(change, acceleration_share * axis.acceleration, jerk);
            }
        }
        for (k, axis) in settings.joints.iter().enumerate() {
            let change = (after.joint_tangents[0][k] - before.joint_tangents[1][k]).abs();
            if change > SAME_DIRECTION {
                let jerk = JOINT_CORNER_JERK * axis.jerk;
                corner.need(change, JOINT_RAMP_SHARE * axis.acceleration, jerk);
            }
        }
        if is_arc {
            corner.limit_bend(before, after, tolerance, settings);
        }
        let bends = corner.per_square > 0.0;
        let share = if bends {
            1.0 - BEND_TOLERANCE_SHARE
        } else {
            1.0
        };
        let turns = before.turns.min(after.turns) * settings.tolerance_deg;
        for (squared, tolerance) in squared.iter().zip([tolerance, turns]) {
            if *squared > 0.0 {
                corner.largest = corner
                    .largest
                    .min(12.0 * share * tolerance / squared.sqrt());
            }
        }
        if corner.per_root > 0.0 {
            // v h(v) <= largest, with h = per_speed v or per_root sqrt(v).
            let root = libm::cbrt(corner.largest / corner.per_root);
            corner.speed = corner.speed.min(root * root);
        }
        if corner.per_speed > 0.0 {
            corner.speed = corner.speed.min((corner.largest / corner.per_speed).sqrt());
        }
        if corner.per_square > 0.0 {
            corner.speed = corner
                .speed
                .min(libm::cbrt(corner.largest / corner.per_square));
        }
        corner
    }

    fn need(&mut self, change: f64, acceleration: f64, jerk: f64) {
        // At the acceleration limit half a rounding is at least one segment long.
        let jerk = jerk.min(2.0 * acceleration / self.preferred);
        self.per_speed = self.per_speed.max(2.0 * change / acceleration);
        self.per_root = self.per_root.max((4.0 * change / jerk).sqrt());
    }

    /// Limits speed and length of the bump of a jump of curvature.
    fn limit_bend(&mut self, before: &Block, after: &Block, tolerance: f64, settings: &Settings) {
        let (k1, k2) = (
            before.path.curvature(before.path.length),
            after.path.curvature(0.0),
        );
        let mut squared = 0.0;
        for (k, axis) in settings.pose.iter().enumerate() {
            let step = k2[k] - k1[k];
            if step == 0.0 {
                continue;
            }
            self.bend[k] = step;
            squared += step * step;
            let max = settings.curvature_step * axis.acceleration / step.abs();
            self.speed = self.speed.min(max.sqrt());
            self.bend_speed = self.bend_speed.min(max.sqrt());
            let jerk = BEND_JERK_SHARE * axis.jerk;
            self.per_square = self.per_square.max(2.0 * BEND_SLOPE * step.abs() / jerk);
        }
        if squared > 0.0 {
            // The deviation grows with the square of the half-length.
            let value = BEND_VALUE * squared.sqrt();
            let half = (BEND_TOLERANCE_SHARE * tolerance / value).sqrt();
            self.largest = self.largest.min(2.0 * half);
        }
        // The bump is to both sides along the rounding, so near a soft limit it would pass it.
        let reach = 0.5 * self.largest;
        let places = [
            before.path.at(before.path.length - reach),
            before.path.to,
            after.path.at(reach),
        ];
        let places = places.map(|at| before.tool.machine_pose(&at));
        for (k, axis) in settings.pose.iter().enumerate() {
            let step = self.bend[k].abs();
            let distances = places
                .iter()
                .map(|at| (axis.high - at[k]).min(at[k] - axis.low));
            let distance = distances.fold(f64::INFINITY, f64::min);
            let max = distance.max(0.5 * axis.limit_tolerance());
            if BEND_VALUE * step * (0.5 * self.largest).powi(2) > max {
                let half = (max / (BEND_VALUE * step)).sqrt();
                self.largest = self.largest.min(2.0 * half);
            }
        }
    }

    /// Returns the half-length of the rounding at a speed; it grows with the speed.
    pub(crate) fn reach(&self, speed: f64) -> f64 {
        0.5 * speed * self.time(speed)
    }

    /// Returns the largest factor of a speed for which the limits hold on the rounding of that
    /// speed. Accelerations grow with its square, jerks with its cube.
    pub(crate) fn max_factor(&self, speed: f64) -> f64 {
        let time = self.time(speed);
        let ratio = |min: f64| {
            if min > 0.0 { time / min } else { f64::INFINITY }
        };
        let acceleration = ratio(self.per_speed * speed).sqrt();
        let jerk = libm::cbrt(ratio(self.per_root * speed.sqrt()));
        let bend = libm::cbrt(ratio(self.per_square * speed * speed));
        let steady = if speed > 0.0 {
            self.bend_speed / speed
        } else {
            f64::INFINITY
        };
        acceleration.min(jerk * jerk).min(bend).min(steady)
    }

    /// Returns the duration of the rounding at a speed, 0 without rounding.
    fn time(&self, speed: f64) -> f64 {
        let min = (self.per_speed * speed)
            .max(self.per_root * speed.sqrt())
            .max(self.per_square * speed * speed);
        if min <= 0.0 {
            return 0.0;
        }
        // At the maximum speed a rounding error may leave `min` slightly above the largest
        // duration.
        min.max(self.preferred.min(self.largest / speed))
    }
}
