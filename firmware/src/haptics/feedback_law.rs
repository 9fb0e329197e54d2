//! Force feedback law: the part of the cutting force that acts on the operator (docs/control.md
//! 3.4, 7.1 items 27-29).
//!
//! Each axis feeds back a percentage of the force on the tool, with its sign, up to a limit. Where
//! the force is too weak to perceive (below 2 N), a velocity-proportional damping term of 0.1 N for
//! each mm/s of the master opposes its motion. The term fades out over the last 0.5 N below that
//! threshold, so the force is continuous. It only dissipates energy of the operator.
//!
//! Units: forces 2^-16 N, rates 2^-20 mm/s. Changed settings ramp over `RAMP_US` for the whole
//! range.
//!
//! Callers must pass the force on the tool. The force on the workpiece would pull the operator's
//! hand into the cut.

use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_math::scale::saturate;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, ForceFeedbackAxis};

/// Ramp time of settings for a change over their whole range (100 %, [`MAX`]), microseconds.
const RAMP_US: i64 = 1_000_000;

/// Largest limit of an axis: 10 N.
pub const MAX: Force = Force(10 << 16);

/// Maximum velocity-proportional damping: 1 N for each mm/s, in 2^-16 N s/mm.
pub const DAMPING_MAX: u16 = u16::MAX;

/// Force range over which the damping term fades out: 0.5 N, a power of two in its unit.
const FADE_SHIFT: u32 = 15;

/// Force feedback law with ramped settings.
#[derive(Debug, Clone, Default)]
pub struct FeedbackLaw {
    /// Percentages, 2^-24 of one, and limits, 2^-24 N.
    percent: [i32; COMPONENTS],
    max: [i32; COMPONENTS],
    /// Velocity-proportional damping, 2^-24 N s/mm, and the force below which it acts.
    damping: i32,
    below: i32,
    commanded: ForceFeedback,
    /// All settings have reached their targets.
    arrived: bool,
    /// Change of a percentage in a control period.
    step: i32,
}

/// Whether settings are in range: at most 100 %, limits from 0 to 10 N, a threshold from 0.5 N to
/// 10 N.
#[must_use]
pub fn is_sound(feedback: &ForceFeedback) -> bool {
    let axis = |axis: &ForceFeedbackAxis| axis.percent <= 100 && (0..=MAX.0).contains(&axis.limit);
    feedback.axes.iter().all(axis) && (1 << FADE_SHIFT..=MAX.0).contains(&feedback.damping_below)
}

/// Moves `value` towards `commanded` by at most `step`.
fn approach(value: &mut i32, commanded: i32, step: i32) {
    *value = commanded.clamp(value.saturating_sub(step), value.saturating_add(step));
}

/// Clamps a force to a limit on either side.
#[inline(always)]
fn within(force: i32, max: i32) -> Force {
    Force(force.max(-max).min(max))
}

impl FeedbackLaw {
    /// Creates a law with these settings in effect.
    #[must_use]
    pub fn new(settings: &ForceFeedback, period_us: u16) -> Self {
        let mut law = Self {
            commanded: *settings,
            // Below 2^16 * 2^24 / 10^6.
            step: (i64::from(period_us) * (1 << 24) / RAMP_US) as i32,
            ..Self::default()
        };
        law.approach(i32::MAX);
        law
    }

    /// Sets new settings, which ramp from the present ones.
    pub const fn set(&mut self, settings: &ForceFeedback) {
        self.commanded = *settings;
        self.arrived = false;
    }

    /// The target settings.
    #[must_use]
    pub const fn settings(&self) -> &ForceFeedback {
        &self.commanded
    }

    /// Ramps the settings; called once per control period until they reach their targets.
    #[inline(never)]
    fn approach(&mut self, step: i32) {
        let before = (self.percent, self.max, self.damping, self.below);
        for (axis, commanded) in self.commanded.axes.iter().enumerate() {
            // 2^24 / 100, to nearest.
            approach(
                &mut self.percent[axis],
                i32::from(commanded.percent) * 167_772,
                step,
            );
            approach(
                &mut self.max[axis],
                commanded.limit << 8,
                step.saturating_mul(10),
            );
        }
        approach(
            &mut self.damping,
            i32::from(self.commanded.damping) << 8,
            step,
        );
        approach(
            &mut self.below,
            self.commanded.damping_below << 8,
            step.saturating_mul(10),
        );
        // Settings that do not change have reached their targets.
        self.arrived = before == (self.percent, self.max, self.damping, self.below);
    }

    /// The present limit of an axis.
    #[must_use]
    pub fn limit(&self, axis: usize) -> Force {
        Force(self.max.get(axis).map_or(0, |max| max >> 8))
    }

    /// Computes the force feedback of a control period from the force on the tool and the rates of
    /// the master.
    pub fn feedback(
        &mut self,
        forces: &[Force; COMPONENTS],
        rates: &[Rate; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        let shares = self.shares(forces);
        self.damped(&shares, rates)
    }

    /// First half of a control period: the percentage of each force, clamped to the largest value
    /// that limit and damping term can use.
    pub fn shares(&mut self, forces: &[Force; COMPONENTS]) -> [Force; COMPONENTS] {
        if !self.arrived {
            self.approach(self.step);
        }
        let damped = if self.damping == 0 { 0 } else { self.below };
        core::array::from_fn(|axis| {
            let share = (i64::from(forces[axis].0) * i64::from(self.percent[axis])) >> 24;
            within(saturate(share), self.max[axis].max(damped) >> 8)
        })
    }

    /// Second half: adds the velocity-proportional damping term and applies the limits.
    #[must_use]
    pub fn damped(
        &self,
        shares: &[Force; COMPONENTS],
        rates: &[Rate; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        core::array::from_fn(|axis| {
            let share = shares[axis].0;
            let max = self.max[axis] >> 8;
            // An axis without force feedback has no damping term.
            if self.damping == 0 || self.percent[axis] == 0 {
                return within(share, max);
            }
            // 1 below the threshold minus the fade range, 0 above the threshold, in 2^-15.
            let under = (self.below >> 8).saturating_sub(share.saturating_abs());
            let fade = under.clamp(0, 1 << FADE_SHIFT);
            // 2^-20 mm/s times 2^-24 N s/mm is 2^-44 N; |rate| <= 2^31, damping < 2^24: at most
            // 2^27, before and after the fade.
            let against = ((i64::from(rates[axis].0) * i64::from(self.damping)) >> 28) as i32;
            let damping = ((i64::from(against) * i64::from(fade)) >> FADE_SHIFT) as i32;
            within(share.saturating_sub(damping), max)
        })
    }

    /// Adds the forces on an axis: feedback, damping and virtual fixture. One limit applies to
    /// feedback plus damping: the sum stays within it on either side, and exceeds it only by the
    /// force of the fixture. Damping has priority: against a force at its limit it has twice the
    /// limit available, and along it the limit itself opposes the motion.
    #[must_use]
    pub fn combine(&self, axis: usize, feedback: Force, damping: Force, fixture: Force) -> Force {
        let max = i64::from(self.limit(axis).0);
        let fixture = i64::from(fixture.0);
        let all = i64::from(feedback.0) + i64::from(damping.0) + fixture;
        Force(saturate(
            all.clamp(fixture.min(0) - max, fixture.max(0) + max),
        ))
    }
}
