//! Keeps the loop through the hand from swinging, whatever hand, contact and delay: passivity in the time domain at the hand's port.
//!
//! *Observer.* The force of the last period times what the tip moved in it is the work that the arm has done on the hand, to the last bit: the force was constant, and the way is
//! measured, so no rate has to be estimated. What the hand put in is credit, what it got back is paid from it. The credit has a cap: what was dissipated long ago must not pay for a swing now (a cut of one slot would be worth
//! fifty swings). What the virtual walls store is added to the cap, because they are springs that give it back.
//!
//! *Controller.* Where more came out than went in there is debt. Damping in proportion to it acts against the hand's motion, whole at [`PassivityConfig::debt`] and beyond. At rest it is nothing, so in steady contact the
//! force is that of the law, whatever the debt. More than `COUNTED` times that debt is not counted, and a debt is forgiven over `FORGET_US`: a soft hand that is pushed back by a force takes energy that it will keep. So
//! at most some milliwatts come out for long, which a hand's own damping takes.
//!
//! A passive arm on a passive hand cannot swing up; that is all there is to know of hand, contact, mill and delay. `tests/reflection_loop.rs` sweeps them.
//!
//! Energies 2^-36 N mm (a newton in 2^-16 times a millimetre in 2^-20). Misuse: observing a force that was not the one that acted. After a clamp, observe what is left of it.

use crate::units::Rate;
use crate::units::force::Force;
use crate::units::scale::saturate;
use haptimill_protocol::haptic::COMPONENTS;
use serde::{Deserialize, Serialize};

/// Bounds of the energy at the hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PassivityConfig {
    /// The most credit, besides what the walls store, 2^-16 N mm: to 100 N mm.
    pub credit: u32,
    /// Debt at which the damping is whole, 2^-16 N mm: 0.01 to 100 N mm.
    pub debt: u32,
    /// The whole damping, 2^-16 N s/mm: to 0.5 N s/mm.
    pub damping: u32,
}

impl PassivityConfig {
    /// Whether all are within their ranges.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.credit <= 100 << 16
            && (655..=100 << 16).contains(&self.debt)
            && self.damping <= 1 << 15
    }
}

/// How long it takes until most (63 %) of a debt is forgiven, microseconds.
const FORGET_US: i64 = 3_000_000;

/// How many times the debt of the whole damping is counted.
const COUNTED: i64 = 3;

/// The watch over the energy at the hand.
#[derive(Debug, Clone)]
pub struct Passivity {
    cap: i64,
    debt: i64,
    damping: i64,
    /// Part of a debt that is forgiven in a period, 2^-32.
    forget: i64,
    /// Credit, or below 0 debt.
    energy: i64,
}

impl Passivity {
    /// Without credit or debt.
    #[must_use]
    pub fn new(config: &PassivityConfig, period_us: u16) -> Self {
        Self {
            cap: i64::from(config.credit) << 20,
            debt: (i64::from(config.debt) << 20).max(1),
            damping: i64::from(config.damping),
            forget: (i64::from(period_us) << 32) / FORGET_US,
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
        let work: i64 = force
            .iter()
            .zip(moved)
            .map(|(force, moved)| {
                // Below 2^22 (64 N) times 2^24 (16 mm).
                i64::from(force.0.clamp(-(1 << 22), 1 << 22))
                    * i64::from((*moved).clamp(-(1 << 24), 1 << 24))
            })
            .sum();
        self.energy = (self.energy - work).clamp(-COUNTED * self.debt, self.cap + stored);
        if self.energy < 0 {
            self.energy -= ((self.energy >> 8) * self.forget) >> 24;
        }
    }

    /// Controller: the force against a motion of the hand.
    #[must_use]
    pub fn damp(&self, rates: &[Rate; COMPONENTS]) -> [Force; COMPONENTS] {
        let debt = (-self.energy).clamp(0, self.debt);
        // Both by 2^8 less: debt is below 2^43, damping at most 2^15.
        let damping = self.damping * (debt >> 8) / (self.debt >> 8).max(1);
        rates.map(|rate| Force(saturate(-(i64::from(rate.0) * damping) >> 20)))
    }
}
