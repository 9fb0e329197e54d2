//! Time-domain passivity observer and controller at the operator's port. They keep the loop through
//! the operator stable for every hand, contact and delay.
//!
//! *Observer.* The force of the last control period times the displacement of the tip is the exact
//! work of the arm on the operator: the force was constant, and the displacement is measured, so no
//! rate estimate is needed. Energy that the operator puts in is surplus; energy that returns
//! reduces it. The surplus is capped, because energy dissipated long ago must not cover an
//! oscillation now (a cut of one slot would cover fifty oscillations). The energy stored in the
//! virtual fixtures is added to the cap, because they are springs that return it.
//!
//! *Controller.* If more energy came out than went in, there is a deficit. Damping proportional to
//! the deficit opposes the master's motion, and is full at [`PassivityConfig::deficit`] and beyond.
//! At standstill it is zero, so in steady contact the force is that of the law for every deficit.
//! The deficit is limited to [`COUNTED`] times that value: a soft hand that a force pushes back
//! takes energy that it keeps. The remaining deficit leaks with the time constant given by the
//! owner of the observer. Motion of the hand against the damping reduces it sooner.
//!
//! The filter and the force step limit bound the strength of a damper. The part that the damper
//! cannot absorb is taken out of the force feedback: see [`super::feedback_filter`], which uses the
//! same deficit. `tests/feedback_loop` sweeps hands, contacts and lines.
//!
//! Units: energies 2^-36 N mm (2^-16 N times 2^-20 mm).
//!
//! Callers must pass the force that acted. After a clamp this is the clamped force.

use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, product, total};
use haptimill_protocol::haptic::COMPONENTS;
use serde::{Deserialize, Serialize};

/// Bounds of the energy at the operator's port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PassivityConfig {
    /// Largest surplus, without the energy of the fixtures, 2^-16 N mm: to 100 N mm.
    pub surplus: u32,
    /// Deficit with full damping, 2^-16 N mm: 0.01 to 100 N mm.
    pub deficit: u32,
    /// Full damping, 2^-16 N s/mm: to 0.5 N s/mm.
    pub damping: u32,
}

impl PassivityConfig {
    /// Whether all values are in range.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.surplus <= 100 << 16
            && (655..=100 << 16).contains(&self.deficit)
            && self.damping <= 1 << 15
    }
}

/// Work of a force on a moving tip, along each axis, 2^-36 N mm: at most 2^46.
pub(super) fn works(force: &[Force; COMPONENTS], moved: &[i32; COMPONENTS]) -> [i64; COMPONENTS] {
    core::array::from_fn(|axis| {
        // At most 2^22 (64 N) times 2^24 (16 mm).
        let force = force[axis].0.clamp(-(1 << 22), 1 << 22);
        i64::from(force) * i64::from(moved[axis].clamp(-(1 << 24), 1 << 24))
    })
}

/// Largest deficit, as a multiple of the deficit with full damping.
pub const COUNTED: i32 = 3;

/// One full deficit, in the unit of [`Passivity::deficit_of`].
pub const WHOLE: i32 = 1 << 16;

/// Passivity observer and controller.
#[derive(Debug, Clone)]
pub struct Passivity {
    cap: i64,
    /// Lowest energy: the largest deficit.
    min: i64,
    /// 2^58 divided by the full deficit.
    per_debt: i64,
    /// At most 2^15.
    damping: u32,
    /// Fraction of a deficit that leaks per control period, 2^-32; below 2^26.
    leak: i64,
    /// Surplus, or below 0 deficit.
    energy: i64,
}

impl Passivity {
    /// Creates an observer at zero energy, with the leak's time constant (63 %) `leak_us`.
    #[must_use]
    pub fn new(config: &PassivityConfig, period_us: u16, leak_us: u32) -> Self {
        // At most 2^43.
        let deficit = (i64::from(config.deficit) << 20).clamp(1 << 29, 100 << 36);
        Self {
            cap: i64::from(config.surplus) << 20,
            min: -i64::from(COUNTED) * deficit,
            per_debt: (1 << 58) / deficit,
            damping: config.damping.min(1 << 15),
            leak: ((i64::from(period_us) << 32) / i64::from(leak_us.max(1))).min(1 << 26),
            energy: 0,
        }
    }

    /// Resets the energy to zero.
    pub const fn reset(&mut self) {
        self.energy = 0;
    }

    /// Energy surplus, or below 0 deficit, 2^-36 N mm.
    #[must_use]
    pub const fn energy(&self) -> i64 {
        self.energy
    }

    /// Updates the observer: `force` acted while the tip moved by `moved` (2^-20 mm); the virtual
    /// fixtures store `stored` now.
    pub fn observe(&mut self, force: &[Force; COMPONENTS], moved: &[i32; COMPONENTS], stored: i64) {
        self.observe_work(&works(force, moved), stored);
    }

    /// As [`Passivity::observe`], with the work along each axis.
    pub(super) fn observe_work(&mut self, works: &[i64; COMPONENTS], stored: i64) {
        let [x, y, z] = *works;
        // A work is at most 2^46, deficit and cap are below 2^45, and the fixtures store less than
        // 2^56.
        let energy = difference(self.energy, total(total(x, y), z));
        let energy = energy.max(self.min).min(total(self.cap, stored));
        // A deficit shifted by 8 bits is below 2^37.
        self.energy = match energy {
            0.. => energy,
            _ => difference(energy, product(energy >> 8, self.leak) >> 24),
        };
    }

    /// Deficit as a fraction of the full deficit, 2^-16: 0 to [`COUNTED`] times that.
    #[must_use]
    pub fn deficit_of(&self) -> i32 {
        // At most 3 * 2^43: shifted below 2^33, and times 2^58 / deficit below 2^48.
        let deficit = difference(0, self.energy.min(0));
        (product(deficit >> 12, self.per_debt) >> 30) as i32
    }

    /// Damping forces of the controller against the master's motion.
    #[must_use]
    pub fn damp(&self, rates: &[Rate; COMPONENTS]) -> [Force; COMPONENTS] {
        let part = self.deficit_of().min(WHOLE);
        rates.map(|rate| self.damp_by(part, rate))
    }

    /// A fraction of the full damping, 2^-16, against the master's motion along an axis.
    #[must_use]
    pub fn damp_by(&self, part: i32, rate: Rate) -> Force {
        // At most 2^15 times 2^16, and then at most 2^15.
        let damping = self.damping.wrapping_mul(part.clamp(0, WHOLE) as u32) >> 16;
        // At most 2^31 * 2^15 / 2^20.
        let against = -(damping as i32);
        Force((product(i64::from(rate.0), i64::from(against)) >> 20) as i32)
    }
}
