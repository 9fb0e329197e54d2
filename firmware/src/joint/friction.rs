//! Friction compensation: effort * tanh(rate / knee), docs/control.md 7.1 item 15.
//!
//! It depends only on the *commanded* rate. A measured rate would change its sign with the noise at
//! standstill, and the loop would oscillate between the two sides of the friction. At standstill
//! the compensation is zero.
//!
//! The commanded rate has no noise, so the knee should be low. Below the knee the friction acts
//! without full compensation, which is an error of coulomb / (inertia K_P), 25 um for 40 N on 40 kg
//! at 40,000 1/s^2. A knee of 0.02 mm/s is suitable.
//!
//! tanh is a table of 81 values with linear interpolation from 0 to 5 knees, and 1 beyond. Its
//! error is below 4e-4; it is continuous, odd, and never decreases.

use haptimill_math::reciprocal::Reciprocal;
use haptimill_math::scale::{product, total};
use haptimill_math::{Effort, Rate};

/// tanh(i / 16), Q15; the last value is 1.
const TANH: [u16; 82] = [
    0, 2045, 4075, 6073, 8025, 9919, 11743, 13486, 15143, 16706, 18173, 19542, 20813, 21986, 23066,
    24054, 24956, 25776, 26519, 27191, 27797, 28341, 28830, 29268, 29660, 30010, 30322, 30600,
    30847, 31067, 31262, 31435, 31589, 31726, 31846, 31953, 32048, 32132, 32206, 32271, 32329,
    32381, 32426, 32466, 32501, 32532, 32560, 32584, 32606, 32625, 32642, 32657, 32670, 32681,
    32691, 32700, 32708, 32715, 32721, 32727, 32732, 32736, 32740, 32743, 32746, 32749, 32751,
    32753, 32755, 32756, 32758, 32759, 32760, 32761, 32762, 32762, 32763, 32764, 32764, 32765,
    32768, 32768,
];

/// Friction compensation of one joint.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Friction {
    coulomb: Effort,
    knee: Reciprocal,
    /// Five knees: full compensation from here on.
    full: u32,
}

impl Friction {
    /// Full compensation is `coulomb`, of which tanh(1) = 76 % is reached at the rate `knee` (its
    /// magnitude counts; zero counts as the smallest).
    pub const fn new(coulomb: Effort, knee: Rate) -> Self {
        let knee = knee.0.unsigned_abs();
        Self {
            coulomb,
            knee: Reciprocal::new(knee),
            full: if knee == 0 { 5 } else { knee.saturating_mul(5) },
        }
    }

    /// Whether the compensation acts in full at a commanded rate: five knees or more.
    #[inline]
    pub const fn is_full(&self, commanded: Rate) -> bool {
        commanded.0.unsigned_abs() >= self.full
    }

    /// Effort that cancels the friction at a commanded rate, rounded; within +-`coulomb`, which is
    /// the configured friction plus the `adapted` one.
    #[inline]
    pub fn effort(&self, commanded: Rate, adapted: Effort) -> Effort {
        let coulomb = self.coulomb.saturating_add(adapted);
        if self.is_full(commanded) {
            // The usual case in motion.
            return if commanded.0 < 0 {
                coulomb.saturating_neg()
            } else {
                coulomb
            };
        }
        // In 1/16 of the knee, Q16. A rate of 2^31 over a knee of 1 is 2^31 * 2^20: no overflow
        // before the clamp.
        let ratio = self
            .knee
            .scaled(i64::from(commanded.0.unsigned_abs()), 20)
            .min(80 << 16);
        // 0 to 80, so a next value exists.
        let place = (ratio >> 16) as usize;
        let part = ratio & 0xffff;
        let (Some(&low), Some(&high)) = (TANH.get(place), TANH.get(place + 1)) else {
            return Effort(0);
        };
        let (low, high) = (i64::from(low), i64::from(high));
        // Q31; never decreases.
        let tanh = total(low << 16, product(total(high, -low), part));
        // Below 2^31 * 2^31.
        let effort = total(product(i64::from(coulomb.0), tanh), 1 << 30) >> 31;
        let signed = if commanded.0 < 0 { -effort } else { effort };
        Effort(haptimill_math::reciprocal::saturate(signed))
    }
}
