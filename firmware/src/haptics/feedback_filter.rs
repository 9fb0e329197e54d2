//! Low-pass filter of the fed-back force while the passivity observer is in deficit.
//!
//! A stiff contact at the end of a slow loop acts as a switch: 0.01 mm of the master decides
//! between no force and the full force, and it decides late. With a gain of 0.4 * 200 N/mm against
//! an operator's hand of 0.1 to 2 N/mm no damper of an arm stops this oscillation. It would need at
//! least 2 N s/mm, behind a filter and a force step that allow 0.2. The fed-back forces therefore
//! pass a first-order filter, whose time constant grows with the energy deficit of the passivity
//! observers ([`super::passivity`], [`super::oscillation`]): none without deficit, [`SLOW_US`] for
//! each full deficit, up to three.
//!
//! In the time t in which the loop answers, the force then changes by at most limit * (1 - exp(-t /
//! T)), for every hand, contact and line. The filter has unit gain at rest and treats rising and
//! falling forces alike, so the mean force remains that of the law. (With a filter that falls
//! faster than it rises, the force would be the minimum of the last oscillations.)
//!
//! The filter delays forces during a deficit, and they persist as long after the contact ends.
//! Virtual fixtures, damping and the velocity-proportional damping term are not delayed. Units:
//! forces 2^-16 N; deficits 2^-16 of a full one.
//!
//! Callers must pass only forces from a tool. A force that depends directly on the master's motion
//! adds energy when it is delayed.

use super::passivity::{COUNTED, WHOLE};
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, multiply_high, total};
use haptimill_protocol::haptic::COMPONENTS;

/// Time constant per full deficit, microseconds.
pub const SLOW_US: u32 = 350_000;

/// Additional fraction bits of the filter state.
const FRACTION: u32 = 12;

/// Filter of the three fed-back forces.
#[derive(Debug, Clone)]
pub struct FeedbackFilter {
    /// [`SLOW_US`] in control periods.
    periods: u32,
    slow: [i64; COMPONENTS],
}

impl FeedbackFilter {
    /// Creates a filter at zero force.
    #[must_use]
    pub fn new(period_us: u16) -> Self {
        Self {
            periods: SLOW_US / u32::from(period_us.max(1)),
            slow: [0; COMPONENTS],
        }
    }

    /// Resets the filter to zero force.
    pub const fn reset(&mut self) {
        self.slow = [0; COMPONENTS];
    }

    /// Filters the forces of a control period, each by the deficit of its axis.
    pub fn smooth(
        &mut self,
        shares: &[Force; COMPONENTS],
        deficit_of: &[i32; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        core::array::from_fn(|axis| {
            // Time constant in control periods: at most 3 * 350,000.
            let deficit_of = deficit_of[axis].clamp(0, COUNTED * WHOLE) as u32;
            let constant = ((u64::from(self.periods) * u64::from(deficit_of)) >> 16) as u32;
            let share = i64::from(shares[axis].0) << FRACTION;
            let slow = &mut self.slow[axis];
            *slow = if constant == 0 {
                share
            } else {
                // Both are below 2^43.
                let away = difference(share, *slow);
                total(*slow, multiply_high(away, u32::MAX / (constant + 1)))
            };
            // The state lies between past forces, so it is in range.
            Force((total(*slow, 1 << (FRACTION - 1)) >> FRACTION) as i32)
        })
    }
}
