//! Latency from the force measured at the tool to the force at the master.
//!
//! Every force that is sent to the arm is kept with the time of its measurement. The latency ends
//! in the period in which the controller of the arm has it: from then on the motors act on it.
//!
//! With both controllers in the simulator, both times are exact to the control period, and so is
//! the force. Behind a port the first time is that of the machine's report, half a round trip
//! before its arrival, without the wait for that report; the second is when the arm reports the
//! output of the feedback law for that force. Forces are identified by their values there: a force
//! that stays constant, or that the law clamps to the same limit, gives no measurement. Nor is
//! there one while the passivity observer has an energy deficit: the arm then low-passes the
//! fed-back force.
//!
//! Units: microseconds, N.

use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback};
use serde::Serialize;
use std::collections::VecDeque;

/// A force at the master.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSample {
    /// When it determines the motors' currents, microseconds of the loop.
    pub at_us: u64,
    /// The force.
    pub value: ForceValue,
}

/// What is known of a force at the master.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ForceValue {
    /// The force that a simulated controller received last, 2^-6 N.
    Received([i16; COMPONENTS]),
    /// A report of the controller.
    Reported {
        /// Output of the feedback law, N.
        force: [f64; COMPONENTS],
        /// The passivity observer has an energy deficit.
        is_in_deficit: bool,
    },
}

/// Forces that differ by less are equal, N: the coarsest resolution of a report is 1/256.
const SAME: f64 = 0.006;

/// A force is followed when it differs from the one before by this much, N.
const MIN_CHANGE: f64 = 0.03;

/// A force is followed when it is larger than the noise of the sensor, N.
const MIN_FORCE: f64 = 0.2;

/// A force that is not seen at the master within this time is dropped, microseconds.
const TIMEOUT_US: u64 = 500_000;

/// A force that was sent.
#[derive(Debug, Clone, Copy)]
struct SentForce {
    measured_us: u64,
    /// 2^-6 N.
    force: [i16; COMPONENTS],
    /// Output of the feedback law for it, N, where that differs enough from the one before.
    expected: Option<[f64; COMPONENTS]>,
}

/// Measures the latency.
#[derive(Debug, Clone, Default)]
pub struct Latency {
    law: Option<ForceFeedback>,
    /// The force now, 2^-6 N, and the time of its first measurement.
    measured: ([i16; COMPONENTS], u64),
    /// The force that was sent last.
    sent: [i16; COMPONENTS],
    /// Output of the feedback law for the last force that can be identified.
    last_expected: [f64; COMPONENTS],
    in_flight: VecDeque<SentForce>,
    newest: Option<ForceValue>,
    latencies_us: Vec<u64>,
}

/// Statistics of the latency, milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LatencyFigures {
    /// Forces that were followed from tool to master.
    pub count: usize,
    /// Median.
    pub median_ms: f64,
    /// 95th percentile.
    pub p95_ms: f64,
    /// Maximum.
    pub largest_ms: f64,
}

fn differ(one: &[f64; COMPONENTS], other: &[f64; COMPONENTS], by: f64) -> bool {
    one.iter().zip(other).any(|(a, b)| (a - b).abs() >= by)
}

impl Latency {
    /// For a feedback law; without one nothing is measured.
    #[must_use]
    pub fn new(law: Option<ForceFeedback>) -> Self {
        Self {
            law,
            ..Self::default()
        }
    }

    /// Records the force measured at the tool.
    pub fn record_measured(&mut self, at_us: u64, force: [i16; COMPONENTS]) {
        if force != self.measured.0 {
            self.measured = (force, at_us);
        }
    }

    /// Records the force that is sent to the arm now.
    pub fn record_sent(&mut self, force: [i16; COMPONENTS]) {
        let Some(law) = &self.law else {
            return;
        };
        let expected = std::array::from_fn(|axis| {
            let max = f64::from(law.axes[axis].limit) / 65_536.0;
            let share = f64::from(force[axis]) / 64.0 * f64::from(law.axes[axis].percent) / 100.0;
            share.clamp(-max, max)
        });
        // A force other than the newest one belongs to an earlier measurement.
        if force != self.measured.0 || force == self.sent {
            return;
        }
        self.sent = force;
        let is_large = expected.iter().any(|part| part.abs() >= MIN_FORCE);
        let is_known = is_large && differ(&expected, &self.last_expected, MIN_CHANGE);
        if is_known {
            self.last_expected = expected;
        }
        self.in_flight.push_back(SentForce {
            measured_us: self.measured.1,
            force,
            expected: is_known.then_some(expected),
        });
    }

    /// Records a force at the master.
    pub fn record_at_master(&mut self, sample: &ForceSample) {
        if self.newest == Some(sample.value) {
            return;
        }
        self.newest = Some(sample.value);
        self.in_flight
            .retain(|sent| sample.at_us.saturating_sub(sent.measured_us) < TIMEOUT_US);
        let index = match sample.value {
            ForceValue::Received(force) => {
                self.in_flight.iter().position(|sent| sent.force == force)
            }
            ForceValue::Reported {
                is_in_deficit: true,
                ..
            } => {
                self.in_flight.clear();
                None
            }
            ForceValue::Reported { force, .. } => self.in_flight.iter().position(|sent| {
                sent.expected
                    .is_some_and(|expected| !differ(&expected, &force, SAME))
            }),
        };
        if let Some(index) = index {
            let sent = self.in_flight[index];
            self.in_flight.drain(..=index);
            self.latencies_us
                .push(sample.at_us.saturating_sub(sent.measured_us));
        }
    }

    /// The statistics; `None` when nothing was measured.
    #[must_use]
    pub fn figures(&self) -> Option<LatencyFigures> {
        let mut sorted = self.latencies_us.clone();
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

    /// Half of the force, at most 2 N, is fed back.
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

    /// A force that grows by 1 N every 5 ms, and is at the master 3 ms after its measurement.
    fn measure_ramp(value: impl Fn(u64) -> ForceValue) -> LatencyFigures {
        let mut latency = Latency::new(law());
        for step in 1..=10_u64 {
            let force = [0, 0, (step * 64) as i16];
            let now = step * 5000;
            latency.record_measured(now, force);
            latency.record_measured(now + 200, force);
            latency.record_sent(force);
            for at_us in [now + 3000, now + 3200] {
                let value = value(step);
                latency.record_at_master(&ForceSample { at_us, value });
            }
        }
        latency.figures().unwrap()
    }

    #[test]
    fn each_force_is_followed_from_the_period_of_its_measurement() {
        let figures = measure_ramp(|step| ForceValue::Received([0, 0, (step * 64) as i16]));
        assert_eq!(figures.count, 10);
        assert_eq!((figures.median_ms, figures.largest_ms), (3.0, 3.0));
        assert_eq!(Latency::new(None).figures(), None);
    }

    #[test]
    fn a_force_that_is_clamped_or_filtered_is_not_followed() {
        let figures = measure_ramp(|step| ForceValue::Reported {
            force: [0.0, 0.0, (step as f64 / 2.0).min(2.0)],
            is_in_deficit: step == 2,
        });
        // 0.5, not 1, 1.5 and 2 N.
        assert_eq!(figures.count, 3);
        assert_eq!((figures.median_ms, figures.largest_ms), (3.0, 3.0));
    }

    #[test]
    fn a_force_that_a_newer_one_replaced_is_not_followed() {
        let mut latency = Latency::new(law());
        for (now, force) in [(0, [64, 0, 0]), (1000, [128, 0, 0])] {
            latency.record_measured(now, force);
            latency.record_sent(force);
        }
        latency.record_at_master(&ForceSample {
            at_us: 4000,
            value: ForceValue::Received([128, 0, 0]),
        });
        latency.record_at_master(&ForceSample {
            at_us: 5000,
            value: ForceValue::Received([64, 0, 0]),
        });
        let figures = latency.figures().unwrap();
        assert_eq!((figures.count, figures.median_ms), (1, 3.0));
    }
}
