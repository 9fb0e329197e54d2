//! What is reflected comes and goes slowly while the hand owes energy.
//!
//! A stiff contact at the end of a slow way back is a switch: a hundredth of a millimetre of the hand decides between no force and all of it, and it decides late. With a gain of 0.4 * 200 N/mm against a hand of 0.1 to 2 N/mm no
//! damper that an arm can have stops that swing: it would need 2 N s/mm and more, behind a filter and a step of the force that allow 0.2. So the shares of the law pass a first-order filter whose time constant grows
//! with the debt of the watches ([`super::passivity`], [`super::swing`]): none without debt, [`SLOW_US`] for each whole debt, up to three. In the time t that the loop takes to answer the felt force then changes by at most
//! limit * (1 - exp(-t / T)), whatever hand, contact and line; and as the filter has a gain of 1 at rest and is the same up and down, the mean force remains that of the law.
//! (One that falls faster than it rises does not: the hand feels the least of the last swings.)
//!
//! The price: while there is debt, a force comes late, and stays for as long when the contact is gone. Virtual walls, damping and boost are not delayed. Forces 2^-16 N; debts 2^-16 of a whole one.
//!
//! Misuse: what does not come from a tool. A force that depends on the hand at once, delayed, feeds it.

use super::passivity::{COUNTED, WHOLE};
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, multiply_high, total};
use haptimill_protocol::haptic::COMPONENTS;

/// Time constant for each whole debt, microseconds.
pub const SLOW_US: u32 = 350_000;

/// Fraction bits of what is remembered, besides those of a force.
const FRACTION: u32 = 12;

/// The filter of the three shares.
#[derive(Debug, Clone)]
pub struct FeedbackFilter {
    /// [`SLOW_US`] in periods.
    periods: u32,
    slow: [i64; COMPONENTS],
}

impl FeedbackFilter {
    /// At no force.
    #[must_use]
    pub fn new(period_us: u16) -> Self {
        Self {
            periods: SLOW_US / u32::from(period_us.max(1)),
            slow: [0; COMPONENTS],
        }
    }

    /// Forgets what it smoothed.
    pub const fn reset(&mut self) {
        self.slow = [0; COMPONENTS];
    }

    /// One period: the shares, each smoothed by what is owed along its axis.
    pub fn smooth(
        &mut self,
        shares: &[Force; COMPONENTS],
        deficit_of: &[i32; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        core::array::from_fn(|axis| {
            // Periods of the time constant: at most 3 * 350,000.
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
            // Between shares, which are forces.
            Force((total(*slow, 1 << (FRACTION - 1)) >> FRACTION) as i32)
        })
    }
}
