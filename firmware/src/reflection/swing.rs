//! A second watch over the energy at the hand, on what swings alone.
//!
//! A hand that leads a cut is opposed by a force that grows with its speed and comes late: tool, cut, the peak over a revolution. On a light hand that swings, at some 5 to 10 Hz and by half a millimetre, although the hand
//! as a whole puts in 20 mW all the time. The watch over the whole energy ([`super::passivity`]) credits it with them and sees nothing: a swing takes 1 N mm. So the same observer and controller are used once more, on force and motion
//! without their slow parts, which are means over some tenth of a second. In a steady cut both are nothing, and at rest there is no damping; slow swings, of a hand afar, are those of the whole energy.
//!
//! Units as in [`super::passivity`].

use super::passivity::{Passivity, PassivityConfig, WHOLE};
use crate::units::Rate;
use crate::units::force::Force;
use haptimill_protocol::haptic::COMPONENTS;

/// The mean that is taken for the slow part is over at least so long, microseconds; the next power of two of periods.
const SLOW_US: u32 = 100_000;

/// How long it takes until most (63 %) of what swings took out is forgiven, microseconds. A hand that does not swing any more pays nothing back.
const FORGET_US: u32 = 10_000_000;

/// Fraction bits of the slow parts.
const FRACTION: u32 = 12;

/// What is left of a value without its slow part.
#[derive(Debug, Clone, Copy, Default)]
struct Swing {
    slow: i64,
}

impl Swing {
    /// The mean is over 2^`shift` periods.
    fn of(&mut self, value: i32, shift: u32) -> i32 {
        // Below 2^43, and so is their difference's magnitude below 2^44.
        let fine = i64::from(value) << FRACTION;
        self.slow += (fine - self.slow) >> shift;
        super::saturate((fine - self.slow) >> FRACTION)
    }
}

/// The watch over what swings.
#[derive(Debug, Clone)]
pub struct Swings {
    watch: Passivity,
    shift: u32,
    force: [Swing; COMPONENTS],
    moved: [Swing; COMPONENTS],
    rates: [Swing; COMPONENTS],
}

impl Swings {
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
    pub fn watch(
        &mut self,
        force: &[Force; COMPONENTS],
        moved: &[i32; COMPONENTS],
        stored: i64,
    ) {
        let shift = self.shift;
        let force = core::array::from_fn(|axis| Force(self.force[axis].of(force[axis].0, shift)));
        let moved = core::array::from_fn(|axis| self.moved[axis].of(moved[axis], shift));
        self.watch.observe(&force, &moved, stored);
    }

    /// The debt of the swings, as [`Passivity::owed`].
    #[must_use]
    pub fn owed(&self) -> i64 {
        self.watch.owed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: PassivityConfig = PassivityConfig {
        credit: 32_768,
        debt: 65_536,
        damping: 19_661,
    };

    /// A hand that goes steadily against a steady force is not damped; one that swings besides, with a force that comes late, is.
    #[test]
    fn only_what_swings_is_damped() {
        let damped = |amplitude: f64, late: f64| {
            let mut swings = Swings::new(&CONFIG, 200);
            let mut most = 0;
            for period in 0..15_000_u32 {
                let time = f64::from(period) * 200e-6;
                // 6 mm/s against 3 N, and a swing of 8 Hz.
                let swing = |time: f64| amplitude * (50.0 * time).sin();
                let rate = -6.0 + swing(time);
                let force = 3.0 - 0.1 * swing(time - late);
                let got = swings.watch(
                    &[Force((force * 65_536.0) as i32), Force(0), Force(0)],
                    &[(rate * 200e-6 * 1_048_576.0) as i32, 0, 0],
                    &[Rate((rate * 1_048_576.0) as i32), Rate(0), Rate(0)],
                    0,
                    0,
                );
                if period > 10_000 {
                    most = most.max(got[0].0.abs());
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
}
