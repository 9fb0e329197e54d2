//! From the force that the tool feels to the force at the hand: how long it takes.
//!
//! Every force that is told to the arm is kept with the moment at which it was sensed, and with what the law of reflection will make of it. When the arm's controller shows that value, the way is
//! over. Values are told apart by their size, so a force that stays as it is, or that the law clamps to the same limit, measures nothing. Nor is anything measured while the hand owes energy: its arm then
//! smooths what is reflected, and shows the law's values late or never.
//!
//! With a simulated controller the moment is exact, to the control period. Behind a port it is that of the report, half a round trip before it came; the wait for the next report is not in it then.
//!
//! Units: microseconds, N.

use haptimill_protocol::haptic::{COMPONENTS, Reflection};
use serde::Serialize;
use std::collections::VecDeque;

/// What the law made of the force on the tool at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Felt {
    /// When the motors' currents have it, microseconds of the loop.
    pub at_us: u64,
    /// The law's force, N.
    pub reflected: [f64; COMPONENTS],
    /// The hand owes energy.
    pub owes: bool,
}

/// Two forces are the same when they differ by less, N: the coarsest step of what is told is 1/256.
const SAME: f64 = 0.006;

/// Forces are only waited for when they differ from the one before by so much, N.
const APART: f64 = 0.03;

/// And when it is no noise of the sensor, N.
const CLEAR: f64 = 0.2;

/// A force that was not seen at the hand for so long never will be, microseconds.
const PATIENCE_US: u64 = 500_000;

/// A force on its way.
#[derive(Debug, Clone, Copy)]
struct Told {
    sensed_us: u64,
    expected: [f64; COMPONENTS],
}

/// Measures it.
#[derive(Debug, Clone, Default)]
pub struct Latency {
    law: Option<Reflection>,
    /// The force now, 2^-6 N, and since when it is so.
    sensed: ([i16; COMPONENTS], u64),
    last: [f64; COMPONENTS],
    under_way: VecDeque<Told>,
    seen: [f64; COMPONENTS],
    samples: Vec<u64>,
}

/// What was measured, milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LatencyFigures {
    /// Forces that were followed from tool to hand.
    pub count: usize,
    /// Half of them took no longer.
    pub median_ms: f64,
    /// 95 of 100 took no longer.
    pub p95_ms: f64,
    /// None took longer.
    pub largest_ms: f64,
}

fn differ(one: &[f64; COMPONENTS], other: &[f64; COMPONENTS], by: f64) -> bool {
    one.iter().zip(other).any(|(a, b)| (a - b).abs() >= by)
}

impl Latency {
    /// For a law of reflection; without one nothing is measured.
    #[must_use]
    pub fn new(law: Option<Reflection>) -> Self {
        Self {
            law,
            ..Self::default()
        }
    }

    /// The tool feels this at a moment.
    pub fn sensed(&mut self, at_us: u64, force: [i16; COMPONENTS]) {
        if force != self.sensed.0 {
            self.sensed = (force, at_us);
        }
    }

    /// This is told to the arm now.
    pub fn told(&mut self, force: [i16; COMPONENTS]) {
        let Some(law) = &self.law else {
            return;
        };
        let expected = std::array::from_fn(|axis| {
            let most = f64::from(law.axes[axis].most) / 65_536.0;
            let share = f64::from(force[axis]) / 64.0 * f64::from(law.axes[axis].percent) / 100.0;
            share.clamp(-most, most)
        });
        // A force that was told later than it was sensed belongs to a report of before.
        let clear = expected.iter().any(|part| part.abs() >= CLEAR);
        if clear && force == self.sensed.0 && differ(&expected, &self.last, APART) {
            self.under_way.push_back(Told {
                sensed_us: self.sensed.1,
                expected,
            });
            self.last = expected;
        }
    }

    /// The arm's controller has this.
    pub fn felt(&mut self, felt: &Felt) {
        if !differ(&felt.reflected, &self.seen, SAME) {
            return;
        }
        self.seen = felt.reflected;
        if felt.owes {
            self.under_way.clear();
        }
        self.under_way
            .retain(|told| felt.at_us.saturating_sub(told.sensed_us) < PATIENCE_US);
        let seen = self
            .under_way
            .iter()
            .position(|told| !differ(&told.expected, &felt.reflected, SAME));
        if let Some(index) = seen {
            let told = self.under_way[index];
            self.under_way.drain(..=index);
            self.samples.push(felt.at_us.saturating_sub(told.sensed_us));
        }
    }

    /// What was measured; `None` when nothing was.
    #[must_use]
    pub fn figures(&self) -> Option<LatencyFigures> {
        let mut sorted = self.samples.clone();
        sorted.sort_unstable();
        let at = |part: f64| {
            let index = (part * sorted.len() as f64).ceil() as usize;
            let sample = sorted.get(index.saturating_sub(1).min(sorted.len().saturating_sub(1)));
            sample.map_or(f64::NAN, |us| *us as f64 / 1000.0)
        };
        (!sorted.is_empty()).then(|| LatencyFigures {
            count: sorted.len(),
            median_ms: at(0.5),
            p95_ms: at(0.95),
            largest_ms: at(1.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_protocol::haptic::ReflectAxis;

    #[test]
    fn each_force_is_followed_from_the_period_in_which_it_was_sensed() {
        let axis = ReflectAxis {
            percent: 50,
            most: 2 << 16,
        };
        let mut latency = Latency::new(Some(Reflection {
            axes: [axis; COMPONENTS],
            ..Reflection::default()
        }));
        // Sensed in steps of 5 ms, told 1 ms later, felt another 2 ms later; the last ones beyond the clamp.
        for step in 0..10_u64 {
            let force = [0, 0, (step * 64) as i16];
            let now = step * 5000;
            latency.sensed(now, force);
            latency.sensed(now + 200, force);
            latency.told(force);
            let reflected = [0.0, 0.0, (step as f64 / 2.0).min(2.0)];
            latency.felt(&Felt {
                at_us: now + 3000,
                reflected,
                owes: step == 2,
            });
            latency.felt(&Felt {
                at_us: now + 3200,
                reflected,
                owes: false,
            });
        }
        let figures = latency.figures().unwrap();
        assert_eq!(figures.count, 3);
        assert_eq!((figures.median_ms, figures.largest_ms), (3.0, 3.0));
        assert_eq!(Latency::new(None).figures(), None);
    }
}
