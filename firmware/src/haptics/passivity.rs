//! Keeps the loop through the hand from swinging, whatever hand, contact and delay: passivity in the time domain at the hand's port.
//!
//! *Observer.* The force of the last period times what the tip moved in it is the work that the arm has done on the hand, to the last bit: the force was constant, and the way is
//! measured, so no rate has to be estimated. What the hand put in is credit, what it got back is paid from it. The credit has a cap: what was dissipated long ago must not pay for a swing now (a cut of one slot would be worth
//! fifty swings). What the virtual walls store is added to the cap, because they are springs that give it back.
//!
//! *Controller.* Where more came out than went in there is debt. Damping in proportion to it acts against the hand's motion, whole at [`PassivityConfig::deficit`] and beyond. At rest it is nothing, so in steady contact the
//! force is that of the law, whatever the debt. More than [`COUNTED`] times that debt is not counted: a soft hand that is pushed back by a force takes energy that it will keep. What is left is forgiven over the time that whoever owns
//! the watch gives it; a hand that moves against the damping has paid it before.
//!
//! A damper behind a filter and a limit on the step of the force can be made only so strong. What is more than it can take is taken out of the reflection: see [`super::smooth`], which works by the same debt.
//! `tests/reflection_chain` sweeps hands, contacts and lines.
//!
//! Energies 2^-36 N mm (a newton in 2^-16 times a millimetre in 2^-20). Misuse: observing a force that was not the one that acted. After a clamp, observe what is left of it.

use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, product, total};
use haptimill_protocol::haptic::COMPONENTS;
use serde::{Deserialize, Serialize};

/// Bounds of the energy at the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PassivityConfig {
    /// The most credit, besides what the walls store, 2^-16 N mm: to 100 N mm.
    pub surplus: u32,
    /// Debt at which the damping is whole, 2^-16 N mm: 0.01 to 100 N mm.
    pub deficit: u32,
    /// The whole damping, 2^-16 N s/mm: to 0.5 N s/mm.
    pub damping: u32,
}

impl PassivityConfig {
    /// Whether all are within their ranges.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.surplus <= 100 << 16
            && (655..=100 << 16).contains(&self.deficit)
            && self.damping <= 1 << 15
    }
}

/// The work of a force on a tip that moved, along each axis, 2^-36 N mm: at most 2^46.
pub(super) fn works(force: &[Force; COMPONENTS], moved: &[i32; COMPONENTS]) -> [i64; COMPONENTS] {
    core::array::from_fn(|axis| {
        // At most 2^22 (64 N) times 2^24 (16 mm).
        let force = force[axis].0.clamp(-(1 << 22), 1 << 22);
        i64::from(force) * i64::from(moved[axis].clamp(-(1 << 24), 1 << 24))
    })
}

/// How many times the debt of the whole damping is counted.
pub const COUNTED: i32 = 3;

/// Parts of a debt: 1, at which the damping is whole.
pub const WHOLE: i32 = 1 << 16;

/// Observer and controller.
#[derive(Debug, Clone)]
pub struct Passivity {
    cap: i64,
    /// The least that the energy may be: what is counted of debt.
    least: i64,
    /// 2^58 by the debt.
    per_debt: i64,
    /// At most 2^15.
    damping: u32,
    /// Part of a debt that is forgiven in a period, 2^-32; below 2^26.
    forget: i64,
    /// Credit, or below 0 debt.
    energy: i64,
}

impl Passivity {
    /// Without credit or debt; of a debt 63 % are forgiven in `forget_us`.
    #[must_use]
    pub fn new(config: &PassivityConfig, period_us: u16, forget_us: u32) -> Self {
        // At most 2^43.
        let deficit = (i64::from(config.deficit) << 20).clamp(1 << 29, 100 << 36);
        Self {
            cap: i64::from(config.surplus) << 20,
            least: -i64::from(COUNTED) * deficit,
            per_debt: (1 << 58) / deficit,
            damping: config.damping.min(1 << 15),
            forget: ((i64::from(period_us) << 32) / i64::from(forget_us.max(1))).min(1 << 26),
            energy: 0,
        }
    }

    /// Forgets credit and debt.
    pub const fn reset(&mut self) {
        self.energy = 0;
    }

    /// Credit, or below 0 debt, 2^-36 N mm.
    #[must_use]
    pub const fn energy(&self) -> i64 {
        self.energy
    }

    /// Observer: `force` acted while the tip moved by `moved` (2^-20 mm); the walls hold `stored` now.
    pub fn observe(&mut self, force: &[Force; COMPONENTS], moved: &[i32; COMPONENTS], stored: i64) {
        self.observe_works(&works(force, moved), stored);
    }

    /// The same, for the work along each axis.
    pub(super) fn observe_works(&mut self, works: &[i64; COMPONENTS], stored: i64) {
        let [x, y, z] = *works;
        // A work is at most 2^46, debt and cap below 2^45, and the walls hold below 2^56.
        let energy = difference(self.energy, total(total(x, y), z));
        let energy = energy.max(self.least).min(total(self.cap, stored));
        // A debt less 8 bits is below 2^37.
        self.energy = match energy {
            0.. => energy,
            _ => difference(energy, product(energy >> 8, self.forget) >> 24),
        };
    }

    /// The debt in parts of that of the whole damping, 2^-16: 0 to [`COUNTED`] of them.
    #[must_use]
    pub fn deficit_of(&self) -> i32 {
        // Of at most 3 * 2^43: below 2^33, and times 2^58 / debt below 2^48.
        let deficit = difference(0, self.energy.min(0));
        (product(deficit >> 12, self.per_debt) >> 30) as i32
    }

    /// Controller: the force against a motion of the hand.
    #[must_use]
    pub fn damp(&self, rates: &[Rate; COMPONENTS]) -> [Force; COMPONENTS] {
        let part = self.deficit_of().min(WHOLE);
        rates.map(|rate| self.damp_by(part, rate))
    }

    /// A part of the whole damping, 2^-16, against a motion of the hand along an axis.
    #[must_use]
    pub fn damp_by(&self, part: i32, rate: Rate) -> Force {
        // At most 2^15 times 2^16, and then at most 2^15.
        let damping = self.damping.wrapping_mul(part.clamp(0, WHOLE) as u32) >> 16;
        // At most 2^31 * 2^15 / 2^20.
        let against = -(damping as i32);
        Force((product(i64::from(rate.0), i64::from(against)) >> 20) as i32)
    }
}
