//! Speed profile of a block: jerk-limited in seven phases, without acceleration at both ends.

use core::cmp::Ordering;

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

/// Returns the largest value from `low` on for which `excess`, which grows, is not above 0: the
/// lower end of a bisection of so many steps between `low` and `high`, where it is.
///
/// The steps whose result two values near the root already tell are not computed, so that the
/// result has the bits of the whole bisection.
pub(crate) fn largest_within(
    mut low: f64,
    mut high: f64,
    steps: u32,
    excess: impl Fn(f64) -> f64,
) -> f64 {
    let [mut inside, mut outside] = bracket(low, high, &excess);
    for _ in 0..steps {
        let middle = 0.5 * (low + high);
        let fits = if middle <= inside {
            true
        } else if middle >= outside {
            false
        } else {
            let fits = excess(middle) <= 0.0;
            *(if fits { &mut inside } else { &mut outside }) = middle;
            fits
        };
        if fits {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Returns values on both sides of the root of a growing function, where it is not above 0 and
/// above 0; minus infinity if it is above 0 from `low` on.
fn bracket(low: f64, high: f64, excess: &impl Fn(f64) -> f64) -> [f64; 2] {
    const STEPS: usize = 12;
    let (mut inside, mut below) = (low, excess(low));
    if below > 0.0 {
        return [f64::NEG_INFINITY, low];
    }
    let (mut outside, mut above) = (high, excess(high));
    let mut was_inside = None;
    for _ in 0..STEPS {
        // Regula falsi with halved weights (Illinois), at least a little off both ends.
        let span = outside - inside;
        let next = inside - below * span / (above - below);
        let margin = 1e-13 * high;
        if span.partial_cmp(&(4.0 * margin)) != Some(Ordering::Greater) {
            break;
        }
        let next = next.max(inside + margin).min(outside - margin);
        let value = excess(next);
        let fits = value <= 0.0;
        if fits {
            (inside, below) = (next, value);
            if was_inside == Some(true) {
                above *= 0.5;
            }
        } else {
            (outside, above) = (next, value);
            if was_inside == Some(false) {
                below *= 0.5;
            }
        }
        was_inside = Some(fits);
    }
    [inside, outside]
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
        let excess = |peak: f64| used(peak) + self.hold * peak - length;
        let mut peak = self.speed.max(lowest);
        if used(peak) > length {
            peak = largest_within(lowest, peak, 60, |peak| used(peak) - length);
        } else if excess(peak) > 0.0 && excess(lowest) <= 0.0 {
            peak = largest_within(lowest, peak, 60, excess);
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
        /// The shortened search ends at the bits of the whole bisection.
        #[test]
        fn a_shortened_search_has_the_bits_of_the_whole_one(
            from in 0.0..50.0f64, highest in 0.1..200.0f64, part in 0.0..1.0f64,
            acceleration in 10.0..1000.0f64, jerk in 100.0..20000.0f64, steps in 1..61u32,
            hold in prop_oneof![Just(0.0), Just(0.0052)],
        ) {
            let along = Along { speed: highest, acceleration, jerk, hold };
            let highest = from + highest;
            let length = |peak: f64| along.ramp_length(from, peak) + hold * peak;
            let room = part * length(highest);
            let excess = |peak: f64| length(peak) - room;
            let (mut low, mut high) = (from, highest);
            for _ in 0..steps {
                let middle = 0.5 * (low + high);
                *(if excess(middle) <= 0.0 { &mut low } else { &mut high }) = middle;
            }
            let found = largest_within(from, highest, steps, excess);
            prop_assert_eq!(found.to_bits(), low.to_bits());
        }

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
