//! Speed profile of a block: jerk-limited in seven phases, without acceleration at both ends.

/// Largest change of speed without a ramp: far below the resolution of setpoints.
const NO_CHANGE: f64 = 1e-6;

/// Limits along a block, in its unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Along {
    pub speed: f64,
    pub acceleration: f64,
    pub jerk: f64,
    /// Shortest phase, seconds, so that both its ends can have setpoints.
    pub hold: f64,
}

/// A phase of constant jerk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Phase {
    pub duration: f64,
    pub acceleration: f64,
    pub jerk: f64,
}

impl Along {
    /// Returns the duration of a change of speed, without acceleration before and after.
    pub(crate) fn ramp_time(&self, from: f64, to: f64) -> f64 {
        // Grows with the change of speed: below the acceleration limit, at its edge, and at the
        // limit.
        let change = (to - from).abs();
        let rise = self.acceleration / self.jerk;
        if change <= NO_CHANGE {
            0.0
        } else if change <= self.acceleration * rise {
            2.0 * (change / self.jerk).sqrt().max(self.hold)
        } else if change <= self.acceleration * (rise + self.hold) {
            (self.hold * self.hold + 4.0 * change / self.jerk).sqrt()
        } else {
            change / self.acceleration + rise
        }
    }

    /// Returns the length of a change of speed.
    pub(crate) fn ramp_length(&self, from: f64, to: f64) -> f64 {
        0.5 * (from + to) * self.ramp_time(from, to)
    }

    /// Adds the phases of a change of speed: two, or three at the acceleration limit.
    fn ramp(&self, from: f64, to: f64, phases: &mut Vec<Phase>) {
        let change = to - from;
        let time = self.ramp_time(from, to);
        if time <= 0.0 {
            return;
        }
        // A symmetric triangle or trapezoid of acceleration; change = peak (time - rise).
        let full = self.acceleration / self.jerk;
        let rise = if change.abs() <= self.acceleration * full {
            0.5 * time
        } else {
            full.min(0.5 * (time - self.hold))
        };
        let peak = change / (time - rise);
        let jerk = peak / rise;
        phases.push(Phase {
            duration: rise,
            acceleration: 0.0,
            jerk,
        });
        if time > 2.0 * rise * (1.0 + 1e-12) {
            phases.push(Phase {
                duration: time - 2.0 * rise,
                acceleration: peak,
                jerk: 0.0,
            });
        }
        phases.push(Phase {
            duration: rise,
            acceleration: peak,
            jerk: -jerk,
        });
    }

    /// Adds the phases over a length between two speeds and returns the largest speed. Callers must
    /// pass a length that suffices for the change of speed (to rounding), and a speed or length
    /// above zero.
    pub(crate) fn phases(&self, length: f64, from: f64, to: f64, phases: &mut Vec<Phase>) -> f64 {
        let used = |peak: f64| self.ramp_length(from, peak) + self.ramp_length(peak, to);
        let lowest = from.max(to);
        // A phase of constant speed has at least the shortest duration, or is left out.
        let fits = |peak: f64| used(peak) + self.hold * peak <= length;
        let highest = |fits: &dyn Fn(f64) -> bool| {
            let (mut low, mut high) = (lowest, self.speed.max(lowest));
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if fits(middle) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            low
        };
        let mut peak = self.speed.max(lowest);
        if used(peak) > length {
            peak = highest(&|peak| used(peak) <= length);
        } else if !fits(peak) && fits(lowest) {
            peak = highest(&fits);
        }
        self.ramp(from, peak, phases);
        let cruise = length - used(peak);
        if peak > 0.0 && cruise > 1e-12 * length {
            phases.push(Phase {
                duration: cruise / peak,
                acceleration: 0.0,
                jerk: 0.0,
            });
        }
        self.ramp(peak, to, phases);
        peak
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
        /// The integral of the phases ends at the given length and speed, within the limits.
        #[test]
        fn phases_integrate_to_length_and_speed(
            length in 1e-3..200.0f64, from in 0.0..50.0f64, to in 0.0..50.0f64,
            speed in 0.1..60.0f64, acceleration in 10.0..1000.0f64, jerk in 100.0..20000.0f64,
        ) {
            let along = Along { speed: speed.max(from).max(to), acceleration, jerk, hold: 0.005 };
            prop_assume!(along.ramp_length(from, to) <= length);
            let mut phases = Vec::new();
            let peak = along.phases(length, from, to, &mut phases);
            let (mut s, mut v, mut a) = (0.0, from, 0.0);
            for phase in &phases {
                prop_assert!((a - phase.acceleration).abs() < 1e-6 * acceleration);
                prop_assert!(phase.jerk.abs() <= jerk * (1.0 + 1e-9));
                let t = phase.duration;
                prop_assert!(t >= 0.0);
                s += t * (v + t * (phase.acceleration / 2.0 + t * phase.jerk / 6.0));
                v += t * (phase.acceleration + t * phase.jerk / 2.0);
                a = phase.acceleration + t * phase.jerk;
                prop_assert!(a.abs() <= acceleration * (1.0 + 1e-9));
                prop_assert!(v <= peak * (1.0 + 1e-9) + 1e-9 && v >= -1e-9);
            }
            prop_assert!((s - length).abs() < 1e-9 * length.max(1.0), "length {s} for {length}");
            prop_assert!((v - to).abs() < 1e-6, "speed {v} for {to}");
            prop_assert!(a.abs() < 1e-6 * acceleration);
            prop_assert!(peak <= along.speed);
        }
    }
}
