//! Oscillation damper: a second passivity observer, on force and motion without their slow parts,
//! and the operator power estimate.
//!
//! In a cut the master is opposed by a force that grows with its speed and comes late, through
//! tool, cut and the peak over a revolution. With a light hand this causes an oscillation of some 5
//! to 10 Hz and 0.5 mm, although the operator puts in 20 mW on average. The observer of the whole
//! energy ([`super::passivity`]) counts this power as surplus and does not detect the oscillation,
//! which takes 1 N mm. This module therefore applies the same observer and controller to force and
//! motion without their slow parts, which are means over some 0.1 s. Both are zero in a steady cut,
//! and at standstill there is no damping.
//!
//! On a stiff contact a soft hand puts in and gets back up to 40 N mm in an oscillation. This
//! exceeds the range of the observer of the whole energy, so half of the time it shows no deficit.
//! The sum of this module is unambiguous.
//!
//! *Operator power estimate* ([`OperatorPower`]). A hand that holds still is passive: in a
//! sustained oscillation it receives energy on average and puts none in. A hand that puts in some
//! milliwatts along an axis drives that axis. There only the oscillation is damped, and the force
//! feedback is not filtered: the oscillation is that of a cut, which a damper can handle. On other
//! axes the deficit of the oscillation counts as one of the whole motion.
//!
//! Units as in [`super::passivity`].

use super::passivity::{Passivity, PassivityConfig, WHOLE, works};
use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, product, saturate, shift_right, total};
use haptimill_protocol::haptic::COMPONENTS;

/// Shortest averaging time of the slow part, microseconds; rounded up to a power of two of control
/// periods.
const SLOW_US: u32 = 100_000;

/// Time constant of the leak of an energy deficit (63 %), microseconds: as long as an operator
/// needs to notice an oscillating contact. A hand that has stopped oscillating returns no energy.
pub(super) const FORGET_US: u32 = 10_000_000;

/// Shortest averaging time of the operator power, microseconds; rounded up to a power of two of
/// control periods.
const MEAN_US: u32 = 1_000_000;

/// Power of an operator that drives an axis, N mm/s, which are mW.
const DRIVES_N_MM_S: i64 = 5;

/// Fraction bits of the slow parts.
const FRACTION: u32 = 12;

/// High-pass filter: a value without its slow part.
#[derive(Debug, Clone, Copy, Default)]
struct OscillationDamper {
    slow: i64,
}

impl OscillationDamper {
    /// Filters a value. The slow part is the mean over 2^`shift` control periods.
    fn of(&mut self, value: i32, shift: u32) -> i32 {
        // Both are below 2^43, and so is the magnitude of their difference below 2^44.
        let fine = i64::from(value) << FRACTION;
        self.slow = total(self.slow, shift_right(difference(fine, self.slow), shift));
        saturate(difference(fine, self.slow) >> FRACTION)
    }
}

/// Passivity observer and controller of the oscillation.
#[derive(Debug, Clone)]
pub struct OscillationDampers {
    observer: Passivity,
    shift: u32,
    force: [OscillationDamper; COMPONENTS],
    moved: [OscillationDamper; COMPONENTS],
    rates: [OscillationDamper; COMPONENTS],
}

impl OscillationDampers {
    /// Creates the dampers at standstill.
    #[must_use]
    pub fn new(config: &PassivityConfig, period_us: u16) -> Self {
        let periods = SLOW_US / u32::from(period_us.max(1));
        Self {
            observer: Passivity::new(config, period_us, FORGET_US),
            shift: periods.next_power_of_two().trailing_zeros(),
            force: Default::default(),
            moved: Default::default(),
            rates: Default::default(),
        }
    }

    /// Resets all states.
    pub fn reset(&mut self) {
        self.observer.reset();
        self.force = Default::default();
        self.moved = self.force;
        self.rates = self.force;
    }

    /// Updates the observer in every control period: `force` acted while the tip moved by `moved`
    /// (2^-20 mm), and the virtual fixtures store `stored`.
    pub fn update(&mut self, force: &[Force; COMPONENTS], moved: &[i32; COMPONENTS], stored: i64) {
        let shift = self.shift;
        let force = core::array::from_fn(|axis| Force(self.force[axis].of(force[axis].0, shift)));
        let moved = core::array::from_fn(|axis| self.moved[axis].of(moved[axis], shift));
        self.observer.observe(&force, &moved, stored);
    }

    /// Damping force against the oscillating part of the master's motion, on axes that the operator
    /// drives. For each axis `idle` is the fraction to which the operator does not drive it, and
    /// `damped` the fraction of the full damping that already acts on the whole motion. The dampers
    /// are not added.
    pub fn damp(
        &mut self,
        rates: &[Rate; COMPONENTS],
        idle: &[i32; COMPONENTS],
        damped: &[i32; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        let part = self.observer.deficit_of().min(WHOLE);
        core::array::from_fn(|axis| {
            // A master that has stopped is not damped, although its slow part decays later: the
            // damped rate is at most the actual one.
            let max = rates[axis].0.saturating_abs();
            let oscillation = self.rates[axis].of(rates[axis].0, self.shift);
            let rate = Rate(oscillation.clamp(-max, max));
            let driven = ((i64::from(part) * i64::from(WHOLE - idle[axis])) >> 16) as i32;
            self.observer.damp_by(driven - damped[axis], rate)
        })
    }

    /// Energy surplus of the oscillation, or below 0 the deficit, as [`Passivity::energy`].
    #[must_use]
    pub const fn energy(&self) -> i64 {
        self.observer.energy()
    }

    /// Energy deficit of the oscillation, as [`Passivity::deficit_of`].
    #[must_use]
    pub fn deficit_of(&self) -> i32 {
        self.observer.deficit_of()
    }
}

/// Operator power estimate: mean power along each axis.
#[derive(Debug, Clone)]
pub struct OperatorPower {
    shift: u32,
    /// Energy per control period from which on the operator drives the axis, 2^-36 N mm.
    driving: i64,
    /// 2^56 divided by `driving`.
    per_driving: i64,
    power: [i64; COMPONENTS],
}

impl OperatorPower {
    /// Creates the estimate at zero power.
    #[must_use]
    pub fn new(period_us: u16) -> Self {
        let period = u32::from(period_us.max(1));
        // Below 2^16 * 2^3 * 2^36 / 10^6: 2^36.
        let driving = ((i64::from(period) * DRIVES_N_MM_S) << 36) / 1_000_000;
        Self {
            shift: (MEAN_US / period).next_power_of_two().trailing_zeros(),
            driving,
            per_driving: (1 << 56) / driving,
            power: [0; COMPONENTS],
        }
    }

    /// Resets the estimate.
    pub const fn reset(&mut self) {
        self.power = [0; COMPONENTS];
    }

    /// Updates the estimate in every control period: `force` acted while the tip moved by `moved`.
    /// Returns for each axis the fraction to which the operator does not drive it, 2^-16.
    pub fn update(
        &mut self,
        force: &[Force; COMPONENTS],
        moved: &[i32; COMPONENTS],
    ) -> [i32; COMPONENTS] {
        self.observe_work(&works(force, moved))
    }

    /// As [`OperatorPower::update`], with the work along each axis.
    pub(super) fn observe_work(&mut self, works: &[i64; COMPONENTS]) -> [i32; COMPONENTS] {
        core::array::from_fn(|axis| {
            // A work is at most 2^46, and so is their mean.
            let away = difference(difference(0, works[axis]), self.power[axis]);
            let power = total(self.power[axis], shift_right(away, self.shift));
            self.power[axis] = power;
            // 2^48 at most.
            let driven = product(power.max(0).min(self.driving) >> 8, self.per_driving);
            WHOLE - (driven >> 32) as i32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: PassivityConfig = PassivityConfig {
        surplus: 32_768,
        deficit: 65_536,
        damping: 19_661,
    };

    fn of(value: f64, unit: f64) -> i32 {
        (value * unit) as i32
    }

    /// A steady motion against a steady force is not damped; an added oscillation with a late force
    /// is.
    #[test]
    fn only_an_oscillation_is_damped() {
        let damped = |amplitude: f64, late: f64| {
            let mut dampers = OscillationDampers::new(&CONFIG, 200);
            let mut operator_power = OperatorPower::new(200);
            let mut max = 0;
            for period in 0..15_000_u32 {
                let time = f64::from(period) * 200e-6;
                // 6 mm/s against 3 N, and an oscillation of 8 Hz.
                let oscillation = |time: f64| amplitude * (50.0 * time).sin();
                let rate = -6.0 + oscillation(time);
                let force = [
                    Force(of(3.0 - 0.1 * oscillation(time - late), 65_536.0)),
                    Force(0),
                    Force(0),
                ];
                let moved = [of(rate * 200e-6, 1_048_576.0), 0, 0];
                dampers.update(&force, &moved, 0);
                let idle = operator_power.update(&force, &moved);
                let rates = [Rate(of(rate, 1_048_576.0)), Rate(0), Rate(0)];
                let got = dampers.damp(&rates, &idle, &[0; COMPONENTS]);
                if period > 10_000 {
                    max = max.max(got[0].0.abs());
                    assert!(
                        idle[0] < 8 && idle[1..] == [WHOLE; 2],
                        "the operator drives x"
                    );
                }
            }
            f64::from(max) / 65_536.0
        };
        assert!(damped(0.0, 0.0) < 0.01, "{}", damped(0.0, 0.0));
        // A force in phase takes energy from the oscillation.
        assert!(damped(10.0, 0.0) < 0.05, "{}", damped(10.0, 0.0));
        // A force that is half an oscillation late adds energy to it.
        assert!(damped(10.0, 0.06) > 1.0, "{}", damped(10.0, 0.06));
    }

    /// An oscillation with the full deficit gets the full damping on axes that the operator drives,
    /// none on others, and a proportional one between.
    #[test]
    fn a_full_deficit_is_fully_damped() {
        let mut dampers = OscillationDampers::new(&CONFIG, 200);
        for period in 0..20_000_u32 {
            // 8 Hz, 5 N along 10 mm/s.
            let oscillation = (f64::from(period) * 0.01).sin();
            let force = [Force(of(5.0 * oscillation, 65_536.0)), Force(0), Force(0)];
            dampers.update(&force, &[of(0.002 * oscillation, 1_048_576.0), 0, 0], 0);
        }
        assert!(dampers.deficit_of() > 2 * WHOLE);
        // A step of the rate differs from its high-passed value by 1/512. 0.3 N s/mm; motion that
        // is already damped is not damped again.
        let rates = [Rate(10 << 20); 3];
        let got = dampers.damp(&rates, &[0, WHOLE, WHOLE / 2], &[0, 0, WHOLE / 4]);
        for (force, expected) in got.into_iter().zip([3.0, 0.0, 0.75]) {
            let force = -f64::from(force.0) / 65_536.0;
            assert!((force - expected).abs() < 0.01, "{force} {expected}");
        }
    }

    /// A passive hand that a force moves to and fro does not drive the axis, although it returns
    /// energy for half of each oscillation. A hand at standstill against a force does not drive it
    /// either.
    #[test]
    fn a_hand_that_is_driven_does_not_drive() {
        for (amplitude, late) in [(0.0, 0.0), (0.5, 0.3), (2.0, 1.2), (4.0, 0.1)] {
            let mut operator_power = OperatorPower::new(200);
            // 5 Hz; a force of 3 N, and one of 1.5 N that is ahead of the motion by `late` of a
            // quarter turn: it drives the hand.
            for period in 0..25_000_u32 {
                let turn = f64::from(period) * 200e-6 * 31.4;
                let rate = amplitude * 31.4 * turn.cos();
                let force = 3.0 + 1.5 * (turn + late).sin();
                let moved = [of(rate * 200e-6, 1_048_576.0), 0, 0];
                let idle = operator_power
                    .update(&[Force(of(force, 65_536.0)), Force(0), Force(0)], &moved);
                if period > 10_000 {
                    assert!(idle[0] > WHOLE / 2, "{amplitude} {late} {idle:?}");
                }
            }
        }
    }
}
