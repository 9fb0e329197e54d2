//! What part of the cutting force the hand feels (docs/control.md 3.4, 7.1 items 27-29).
//!
//! Each axis reflects a percentage of the force on the tool, with its sign, up to a limit. Where that is too weak to be felt (below 2 N), a tenth of a newton for each mm/s of the hand is added against its
//! motion. The boost fades out over the last half newton below that threshold, so nothing steps; it only ever takes energy from the hand.
//!
//! Forces 2^-16 N, rates 2^-20 mm/s. New settings are approached at `RAMP_US` for the whole range. Misuse: the force on the work instead of the one on the tool: the hand would be pulled into the cut.

use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_math::scale::saturate;
use haptimill_protocol::haptic::{COMPONENTS, ReflectAxis, Reflection};

/// How long settings take for a change by their whole range (100 %, [`MOST`]), microseconds.
const RAMP_US: i64 = 1_000_000;

/// The largest limit of an axis: 10 N.
pub const MOST: Force = Force(10 << 16);

/// The largest boost: 1 N for each mm/s, in 2^-16 N s/mm.
pub const BOOST_MOST: u16 = u16::MAX;

/// Over how much force the boost fades out: 0.5 N. A power of two in its unit.
const FADE_SHIFT: u32 = 15;

/// The law with its settings on their way.
#[derive(Debug, Clone, Default)]
pub struct FeedbackLaw {
    /// Percentages, 2^-24 of one, and limits, 2^-24 N.
    percent: [i32; COMPONENTS],
    most: [i32; COMPONENTS],
    /// Boost, 2^-24 N s/mm, and where it ends.
    boost: i32,
    below: i32,
    commanded: Reflection,
    /// All of it is what is wanted.
    arrived: bool,
    /// The way of a percentage in a period.
    step: i32,
}

/// Whether settings are within their ranges: at most 100 %, limits from 0 to 10 N, a threshold from 0.5 N to 10 N.
#[must_use]
pub fn is_sound(reflection: &Reflection) -> bool {
    let axis = |axis: &ReflectAxis| axis.percent <= 100 && (0..=MOST.0).contains(&axis.most);
    reflection.axes.iter().all(axis) && (1 << FADE_SHIFT..=MOST.0).contains(&reflection.boost_below)
}

/// `value` goes towards `commanded` by at most `step`.
fn approach(value: &mut i32, commanded: i32, step: i32) {
    *value = commanded.clamp(value.saturating_sub(step), value.saturating_add(step));
}

/// A force held within a limit on either side.
#[inline(always)]
fn within(force: i32, most: i32) -> Force {
    Force(force.max(-most).min(most))
}

impl FeedbackLaw {
    /// With these settings in force.
    #[must_use]
    pub fn new(settings: &Reflection, period_us: u16) -> Self {
        let mut law = Self {
            commanded: *settings,
            // Below 2^16 * 2^24 / 10^6.
            step: (i64::from(period_us) * (1 << 24) / RAMP_US) as i32,
            ..Self::default()
        };
        law.approach(i32::MAX);
        law
    }

    /// Other settings from now on, gently.
    pub const fn set(&mut self, settings: &Reflection) {
        self.commanded = *settings;
        self.arrived = false;
    }

    /// The settings that are wanted.
    #[must_use]
    pub const fn settings(&self) -> &Reflection {
        &self.commanded
    }

    /// Once a period until it has arrived.
    #[inline(never)]
    fn approach(&mut self, step: i32) {
        let before = (self.percent, self.most, self.boost, self.below);
        for (axis, commanded) in self.commanded.axes.iter().enumerate() {
            // 2^24 / 100, to nearest.
            approach(
                &mut self.percent[axis],
                i32::from(commanded.percent) * 167_772,
                step,
            );
            approach(
                &mut self.most[axis],
                commanded.most << 8,
                step.saturating_mul(10),
            );
        }
        approach(&mut self.boost, i32::from(self.commanded.boost) << 8, step);
        approach(
            &mut self.below,
            self.commanded.boost_below << 8,
            step.saturating_mul(10),
        );
        // What does not move is where it shall be.
        self.arrived = before == (self.percent, self.most, self.boost, self.below);
    }

    /// The limit of an axis that is in force now.
    #[must_use]
    pub fn most(&self, axis: usize) -> Force {
        Force(self.most.get(axis).map_or(0, |most| most >> 8))
    }

    /// One period: what the hand shall feel of a force on the tool while it moves at `rates`.
    pub fn reflect(
        &mut self,
        forces: &[Force; COMPONENTS],
        rates: &[Rate; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        let shares = self.shares(forces);
        self.boosted(&shares, rates)
    }

    /// The first half of a period: the percentage of each force. What is more than can be felt, by limit and boost, is cut off already.
    pub fn shares(&mut self, forces: &[Force; COMPONENTS]) -> [Force; COMPONENTS] {
        if !self.arrived {
            self.approach(self.step);
        }
        let boosted = if self.boost == 0 { 0 } else { self.below };
        core::array::from_fn(|axis| {
            let share = (i64::from(forces[axis].0) * i64::from(self.percent[axis])) >> 24;
            within(saturate(share), self.most[axis].max(boosted) >> 8)
        })
    }

    /// The second half: shares with the boost, within the limits.
    #[must_use]
    pub fn boosted(
        &self,
        shares: &[Force; COMPONENTS],
        rates: &[Rate; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        core::array::from_fn(|axis| {
            let share = shares[axis].0;
            let most = self.most[axis] >> 8;
            // An axis that reflects nothing is not boosted either.
            if self.boost == 0 || self.percent[axis] == 0 {
                return within(share, most);
            }
            // 1 below the threshold less the fade, 0 above, in 2^-15.
            let under = (self.below >> 8).saturating_sub(share.saturating_abs());
            let fade = under.clamp(0, 1 << FADE_SHIFT);
            // 2^-20 mm/s times 2^-24 N s/mm is 2^-44 N; |rate| <= 2^31, boost < 2^24: at most 2^27, before and after the fade takes its turn.
            let against = ((i64::from(rates[axis].0) * i64::from(self.boost)) >> 28) as i32;
            let boost = ((i64::from(against) * i64::from(fade)) >> FADE_SHIFT) as i32;
            within(share.saturating_sub(boost), most)
        })
    }

    /// What acts on an axis: reflection, damping and the push of a wall. The limit of the reflection is one for all that is not a wall: the sum is within it on either side, and beyond it only as far as a wall pushes. Where not everything
    /// fits, the damping has the precedence: against a force at its limit it has twice the limit to act in, and along it the limit itself opposes the motion.
    #[must_use]
    pub fn together(&self, axis: usize, reflected: Force, damping: Force, wall: Force) -> Force {
        let most = i64::from(self.most(axis).0);
        let wall = i64::from(wall.0);
        let all = i64::from(reflected.0) + i64::from(damping.0) + wall;
        Force(saturate(all.clamp(wall.min(0) - most, wall.max(0) + most)))
    }
}
