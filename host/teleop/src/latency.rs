//! From the force that the tool feels to the force at the hand: how long it takes.
//!
//! Every force that is told to the arm is kept with the moment at which it was sensed. When the arm's controller has it, the way is over: from that period on the motors act by it.
//!
//! Where both controllers can be looked into, both moments are exact, to the control period, and so is the force. Behind a port the first is that of the machine's report, half a round trip before it came; the wait
//! for the next report is not in it then. The second is when the arm reports what the law of reflection makes of the force. Values are told apart by their size there, so a force that stays as it is, or that the law
//! clamps to the same limit, measures nothing. Nor is anything measured while the hand owes energy: its arm then smooths what is reflected, and shows the law's values late or never.
//!
//! Units: microseconds, N.

use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback};
use serde::Serialize;
use std::collections::VecDeque;

/// What has come of the force on the tool at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Felt {
    /// When the motors' currents have it, microseconds of the loop.
    pub at_us: u64,
    /// What it is.
    pub what: What,
}

/// What is known of a force at the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum What {
    /// What the arm's controller was told last, 2^-6 N: it can be looked into.
    Told([i16; COMPONENTS]),
    /// What it reports.
    Reflected {
        /// The law's force, N.
        force: [f64; COMPONENTS],
        /// The hand owes energy.
        owes: bool,
    },
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
    /// 2^-6 N.
    force: [i16; COMPONENTS],
    /// What the law will make of it, N, where that can be told from what it made of the one before.
    expected: Option<[f64; COMPONENTS]>,
}

/// Measures it.
#[derive(Debug, Clone, Default)]
pub struct Latency {
    law: Option<ForceFeedback>,
    /// The force now, 2^-6 N, and since when it is so.
    sensed: ([i16; COMPONENTS], u64),
    /// The force that was told last.
    told: [i16; COMPONENTS],
    /// What the law makes of the last one that it can be known by.
    last: [f64; COMPONENTS],
    under_way: VecDeque<Told>,
    seen: Option<What>,
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
    pub fn new(law: Option<ForceFeedback>) -> Self {
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
            let most = f64::from(law.axes[axis].limit) / 65_536.0;
            let share = f64::from(force[axis]) / 64.0 * f64::from(law.axes[axis].percent) / 100.0;
            share.clamp(-most, most)
        });
        // A force that was told later than it was sensed belongs to a report of before.
        if force != self.sensed.0 || force == self.told {
            return;
        }
        self.told = force;
        let clear = expected.iter().any(|part| part.abs() >= CLEAR);
        let known = clear && differ(&expected, &self.last, APART);
        if known {
            self.last = expected;
        }
        self.under_way.push_back(Told {
            sensed_us: self.sensed.1,
            force,
            expected: known.then_some(expected),
        });
    }

    /// The arm's controller has this.
    pub fn felt(&mut self, felt: &Felt) {
        if self.seen == Some(felt.what) {
            return;
        }
        self.seen = Some(felt.what);
        self.under_way
            .retain(|told| felt.at_us.saturating_sub(told.sensed_us) < PATIENCE_US);
        let seen = match felt.what {
            What::Told(force) => self.under_way.iter().position(|told| told.force == force),
            What::Reflected { owes: true, .. } => {
                self.under_way.clear();
                None
            }
            What::Reflected { force, .. } => self.under_way.iter().position(|told| {
                told.expected
                    .is_some_and(|expected| !differ(&expected, &force, SAME))
            }),
        };
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
    use haptimill_protocol::haptic::ForceFeedbackAxis;

    /// Half of it, at most 2 N, is reflected.
    fn law() -> Option<ForceFeedback> {
        let axis = ForceFeedbackAxis {
            percent: 50,
            limit: 2 << 16,
        };
        Some(ForceFeedback {
            axes: [axis; COMPONENTS],
            ..ForceFeedback::default()
        })
    }

    /// A force that grows by 1 N every 5 ms, told 1 ms later, at the hand another 2 ms later.
    fn growing(what: impl Fn(u64) -> What) -> LatencyFigures {
        let mut latency = Latency::new(law());
        for step in 1..=10_u64 {
            let force = [0, 0, (step * 64) as i16];
            let now = step * 5000;
            latency.sensed(now, force);
            latency.sensed(now + 200, force);
            latency.told(force);
            for at_us in [now + 3000, now + 3200] {
                let what = what(step);
                latency.felt(&Felt { at_us, what });
            }
        }
        latency.figures().unwrap()
    }

    #[test]
    fn each_force_is_followed_from_the_period_in_which_it_was_sensed() {
        let figures = growing(|step| What::Told([0, 0, (step * 64) as i16]));
        assert_eq!(figures.count, 10);
        assert_eq!((figures.median_ms, figures.largest_ms), (3.0, 3.0));
        assert_eq!(Latency::new(None).figures(), None);
    }

    #[test]
    fn what_the_law_clamps_or_smooths_is_not_followed() {
        let figures = growing(|step| What::Reflected {
            force: [0.0, 0.0, (step as f64 / 2.0).min(2.0)],
            owes: step == 2,
        });
        // 0.5, not 1, 1.5 and 2 N.
        assert_eq!(figures.count, 3);
        assert_eq!((figures.median_ms, figures.largest_ms), (3.0, 3.0));
    }

    #[test]
    fn a_force_that_was_overtaken_is_not_followed() {
        let mut latency = Latency::new(law());
        for (now, force) in [(0, [64, 0, 0]), (1000, [128, 0, 0])] {
            latency.sensed(now, force);
            latency.told(force);
        }
        latency.felt(&Felt {
            at_us: 4000,
            what: What::Told([128, 0, 0]),
        });
        latency.felt(&Felt {
            at_us: 5000,
            what: What::Told([64, 0, 0]),
        });
        let figures = latency.figures().unwrap();
        assert_eq!((figures.count, figures.median_ms), (1, 3.0));
    }
}
