//! A second watch over the energy at the hand, on what swings alone; and whether the hand leads.
//!
//! A hand that leads a cut is opposed by a force that grows with its speed and comes late: tool, cut, the peak over a revolution. On a light hand that swings, at some 5 to 10 Hz and by half a millimetre, although the hand
//! as a whole puts in 20 mW all the time. The watch over the whole energy ([`super::passivity`]) credits it with them and sees nothing: a swing takes 1 N mm. So the same observer and controller are used once more, on force and motion
//! without their slow parts, which are means over some tenth of a second. In a steady cut both are nothing, and at rest there is no damping. On a stiff contact a soft hand puts in and gets back up to 40 N mm in a swing, more than the
//! whole account counts, so that half of the time there seems to be no debt; here the sum is clear.
//!
//! *Who leads* ([`OperatorPower`]). A hand that holds still is passive: in a swing that goes on it gets energy, in the mean, and puts none in. One that puts in some milliwatts along an axis leads along it. There only what swings is
//! damped, and the reflection is not smoothed: the swing is that of a cut, which a damper can take. Elsewhere the debt of the swings counts as one of the whole motion.
//!
//! Units as in [`super::passivity`].

use super::passivity::{Passivity, PassivityConfig, WHOLE, works};
use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, product, saturate, shift_right, total};
use haptimill_protocol::haptic::COMPONENTS;

/// The mean that is taken for the slow part is over at least so long, microseconds; the next power of two of periods.
const SLOW_US: u32 = 100_000;

/// How long it takes until most (63 %) of what swings took out is forgiven, microseconds. A hand that does not swing any more pays nothing back.
const FORGET_US: u32 = 10_000_000;

/// The mean of what the hand puts in is over at least so long, microseconds; the next power of two of periods.
const MEAN_US: u32 = 1_000_000;

/// What a hand puts in that leads, N mm/s, which are mW.
const LEADS_N_MM_S: i64 = 5;

/// Fraction bits of the slow parts.
const FRACTION: u32 = 12;

/// What is left of a value without its slow part.
#[derive(Debug, Clone, Copy, Default)]
struct OscillationDamper {
    slow: i64,
}

impl OscillationDamper {
    /// The mean is over 2^`shift` periods.
    fn of(&mut self, value: i32, shift: u32) -> i32 {
        // Both are below 2^43, and so is the magnitude of their difference below 2^44.
        let fine = i64::from(value) << FRACTION;
        self.slow = total(self.slow, shift_right(difference(fine, self.slow), shift));
        saturate(difference(fine, self.slow) >> FRACTION)
    }
}

/// The watch over what swings.
#[derive(Debug, Clone)]
pub struct OscillationDampers {
    watch: Passivity,
    shift: u32,
    force: [OscillationDamper; COMPONENTS],
    moved: [OscillationDamper; COMPONENTS],
    rates: [OscillationDamper; COMPONENTS],
}

impl OscillationDampers {
    /// At rest.
    #[must_use]
    pub fn new(config: &PassivityConfig, period_us: u16) -> Self {
        let periods = SLOW_US / u32::from(period_us.max(1));
        Self {
            watch: Passivity::new(config, period_us, FORGET_US),
            shift: periods.next_power_of_two().trailing_zeros(),
            force: Default::default(),
            moved: Default::default(),
            rates: Default::default(),
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.watch.reset();
        self.force = Default::default();
        self.moved = self.force;
        self.rates = self.force;
    }

    /// Once a period: `force` acted while the tip moved by `moved` (2^-20 mm), and the virtual walls hold `stored`.
    pub fn watch(&mut self, force: &[Force; COMPONENTS], moved: &[i32; COMPONENTS], stored: i64) {
        let shift = self.shift;
        let force = core::array::from_fn(|axis| Force(self.force[axis].of(force[axis].0, shift)));
        let moved = core::array::from_fn(|axis| self.moved[axis].of(moved[axis], shift));
        self.watch.observe(&force, &moved, stored);
    }

    /// The force against what swings of a motion of the hand, as far as it is led: of each axis `idle` is the part to which it is not, and `damped` the part of the whole damping that acts on all of the motion already. Dampers are not
    /// added up.
    pub fn damp(
        &mut self,
        rates: &[Rate; COMPONENTS],
        idle: &[i32; COMPONENTS],
        damped: &[i32; COMPONENTS],
    ) -> [Force; COMPONENTS] {
        let part = self.watch.deficit_of().min(WHOLE);
        core::array::from_fn(|axis| {
            // A hand that has stopped is not damped, though its slow part goes on for a while: no more than it moves.
            let most = rates[axis].0.saturating_abs();
            let swings = self.rates[axis].of(rates[axis].0, self.shift);
            let rate = Rate(swings.clamp(-most, most));
            let led = ((i64::from(part) * i64::from(WHOLE - idle[axis])) >> 16) as i32;
            self.watch.damp_by(led - damped[axis], rate)
        })
    }

    /// Credit of the swings, or below 0 debt, as [`Passivity::energy`].
    #[must_use]
    pub const fn energy(&self) -> i64 {
        self.watch.energy()
    }

    /// The debt of the swings, as [`Passivity::deficit_of`].
    #[must_use]
    pub fn deficit_of(&self) -> i32 {
        self.watch.deficit_of()
    }
}

/// What the hand puts in along each axis, in the mean.
#[derive(Debug, Clone)]
pub struct OperatorPower {
    shift: u32,
    /// 2^-36 N mm in a period, from which on it leads.
    leads: i64,
    /// 2^56 by it.
    per_leads: i64,
    power: [i64; COMPONENTS],
}

impl OperatorPower {
    /// At rest.
    #[must_use]
    pub fn new(period_us: u16) -> Self {
        let period = u32::from(period_us.max(1));
        // Below 2^16 * 2^3 * 2^36 / 10^6: 2^36.
        let leads = ((i64::from(period) * LEADS_N_MM_S) << 36) / 1_000_000;
        Self {
            shift: (MEAN_US / period).next_power_of_two().trailing_zeros(),
            leads,
            per_leads: (1 << 56) / leads,
            power: [0; COMPONENTS],
        }
    }

    /// Forgets everything.
    pub const fn reset(&mut self) {
        self.power = [0; COMPONENTS];
    }

    /// Once a period: `force` acted while the tip moved by `moved`. Gives of each axis the part to which the hand does not lead, 2^-16.
    pub fn watch(
        &mut self,
        force: &[Force; COMPONENTS],
        moved: &[i32; COMPONENTS],
    ) -> [i32; COMPONENTS] {
        self.watch_works(&works(force, moved))
    }

    /// The same, for the work along each axis.
    pub(super) fn watch_works(&mut self, works: &[i64; COMPONENTS]) -> [i32; COMPONENTS] {
        core::array::from_fn(|axis| {
            // A work is at most 2^46, and so is a mean of them.
            let away = difference(difference(0, works[axis]), self.power[axis]);
            let power = total(self.power[axis], shift_right(away, self.shift));
            self.power[axis] = power;
            // 2^48 at most.
            let led = product(power.max(0).min(self.leads) >> 8, self.per_leads);
            WHOLE - (led >> 32) as i32
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

    /// A hand that goes steadily against a steady force is not damped; one that swings besides, with a force that comes late, is.
    #[test]
    fn only_what_swings_is_damped() {
        let damped = |amplitude: f64, late: f64| {
            let mut swings = OscillationDampers::new(&CONFIG, 200);
            let mut supply = OperatorPower::new(200);
            let mut most = 0;
            for period in 0..15_000_u32 {
                let time = f64::from(period) * 200e-6;
                // 6 mm/s against 3 N, and a swing of 8 Hz.
                let swing = |time: f64| amplitude * (50.0 * time).sin();
                let rate = -6.0 + swing(time);
                let force = [
                    Force(of(3.0 - 0.1 * swing(time - late), 65_536.0)),
                    Force(0),
                    Force(0),
                ];
                let moved = [of(rate * 200e-6, 1_048_576.0), 0, 0];
                swings.watch(&force, &moved, 0);
                let idle = supply.watch(&force, &moved);
                let rates = [Rate(of(rate, 1_048_576.0)), Rate(0), Rate(0)];
                let got = swings.damp(&rates, &idle, &[0; COMPONENTS]);
                if period > 10_000 {
                    most = most.max(got[0].0.abs());
                    assert!(idle[0] < 8 && idle[1..] == [WHOLE; 2], "it leads along x");
                }
            }
            f64::from(most) / 65_536.0
        };
        assert!(damped(0.0, 0.0) < 0.01, "{}", damped(0.0, 0.0));
        // In time, the force takes energy from the swing.
        assert!(damped(10.0, 0.0) < 0.05, "{}", damped(10.0, 0.0));
        // Half a swing late, it feeds it.
        assert!(damped(10.0, 0.06) > 1.0, "{}", damped(10.0, 0.06));
    }

    /// Swings that owe all that is counted are damped with the whole damping where the hand leads, with none where it does not, and in between in proportion.
    #[test]
    fn a_whole_debt_is_damped_wholly() {
        let mut swings = OscillationDampers::new(&CONFIG, 200);
        for period in 0..20_000_u32 {
            // 8 Hz, 5 N along 10 mm/s.
            let swing = (f64::from(period) * 0.01).sin();
            let force = [Force(of(5.0 * swing, 65_536.0)), Force(0), Force(0)];
            swings.watch(&force, &[of(0.002 * swing, 1_048_576.0), 0, 0], 0);
        }
        assert!(swings.deficit_of() > 2 * WHOLE);
        // A rate out of nothing swings but for a 512th. 0.3 N s/mm; what is damped anyway is not damped again.
        let rates = [Rate(10 << 20); 3];
        let got = swings.damp(&rates, &[0, WHOLE, WHOLE / 2], &[0, 0, WHOLE / 4]);
        for (force, want) in got.into_iter().zip([3.0, 0.0, 0.75]) {
            let force = -f64::from(force.0) / 65_536.0;
            assert!((force - want).abs() < 0.01, "{force} {want}");
        }
    }

    /// A passive hand that holds still, and is driven to and fro by a force, does not lead, though for half of each swing it gives back what it got; one at rest against a force does not either.
    #[test]
    fn a_hand_that_is_driven_does_not_lead() {
        for (amplitude, late) in [(0.0, 0.0), (0.5, 0.3), (2.0, 1.2), (4.0, 0.1)] {
            let mut supply = OperatorPower::new(200);
            // 5 Hz; a force of 3 N, and one of 1.5 N that leads the motion by `late` of a quarter turn: it drives it.
            for period in 0..25_000_u32 {
                let turn = f64::from(period) * 200e-6 * 31.4;
                let rate = amplitude * 31.4 * turn.cos();
                let force = 3.0 + 1.5 * (turn + late).sin();
                let moved = [of(rate * 200e-6, 1_048_576.0), 0, 0];
                let idle = supply.watch(&[Force(of(force, 65_536.0)), Force(0), Force(0)], &moved);
                if period > 10_000 {
                    assert!(idle[0] > WHOLE / 2, "{amplitude} {late} {idle:?}");
                }
            }
        }
    }
}
