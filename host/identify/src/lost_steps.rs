//! Search for the largest rate and acceleration at which a step motor loses no steps.
//!
//! The search only chooses motions and judges them; [`crate::switch_test`] runs them.
//!
//! Rates are tested at the acceleration of the machine file, first all over the range in equal
//! ratios. A loss below a rate without loss is a resonance. The largest rate without loss is then
//! bisected. Accelerations are tested at [`MARGIN`] of that rate, and bisected likewise. The last
//! test is the proposal itself.

use haptimill_firmware::config::AxisKind;

/// Part of the largest value without loss that is proposed.
pub const MARGIN: f64 = 0.7;

/// Rates of the first tests.
pub const SCAN: usize = 12;

/// Ratio of a value with loss to one without loss, at which the search ends.
const RATE_RATIO: f64 = 1.03;
const ACCELERATION_RATIO: f64 = 1.05;

/// A motion away from the switch, and back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Rate, mm/s or deg/s.
    pub rate: f64,
    /// Acceleration, mm/s^2 or deg/s^2.
    pub acceleration: f64,
}

/// A motion that was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// The motion.
    pub motion: Motion,
    /// Steps by which the switch tripped at another count than before.
    pub steps: f64,
    /// Whether they are a loss.
    pub is_lost: bool,
}

/// Range of the tests of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Lowest and largest rate.
    pub rate: [f64; 2],
    /// Acceleration while rates are tested, and the largest one.
    pub acceleration: [f64; 2],
}

/// The largest value without loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Highest {
    /// No test lost steps; the value is that of the largest test.
    NoLossUpTo(f64),
    /// The largest value without loss, and the next one, which lost steps.
    Between(f64, f64),
    /// The lowest test, of this value, lost steps.
    AllLost(f64),
}

impl Highest {
    fn of(trials: &[Trial], value: fn(&Motion) -> f64) -> Option<Self> {
        let kept = trials.iter().filter(|it| !it.is_lost);
        let kept = kept.map(|it| value(&it.motion)).max_by(f64::total_cmp);
        let lost = trials.iter().filter(|it| it.is_lost);
        let lost = lost
            .map(|it| value(&it.motion))
            .filter(|lost| kept.is_none_or(|kept| *lost > kept))
            .min_by(f64::total_cmp);
        match (kept, lost) {
            (None, None) => None,
            (Some(kept), None) => Some(Self::NoLossUpTo(kept)),
            (Some(kept), Some(lost)) => Some(Self::Between(kept, lost)),
            (None, Some(lost)) => Some(Self::AllLost(lost)),
        }
    }

    /// The largest value without loss.
    #[must_use]
    pub const fn kept(&self) -> Option<f64> {
        match self {
            Self::NoLossUpTo(kept) | Self::Between(kept, _) => Some(*kept),
            Self::AllLost(_) => None,
        }
    }

    /// The value between both, while they are farther apart than `ratio`.
    fn middle(&self, ratio: f64) -> Option<f64> {
        match self {
            Self::Between(kept, lost) if lost / kept > ratio => Some((kept * lost).sqrt()),
            _ => None,
        }
    }

    /// The proposed value; `None` where no value lost steps, so that the limit is not known.
    #[must_use]
    pub fn proposed(&self) -> Option<f64> {
        match self {
            Self::Between(kept, _) => Some(MARGIN * kept),
            Self::NoLossUpTo(_) | Self::AllLost(_) => None,
        }
    }
}

/// The tests of a joint, and what they say.
#[derive(Debug, Clone)]
pub struct StepLimits {
    /// Index of the joint.
    pub joint: usize,
    /// Its name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Range of the tests.
    pub bounds: Bounds,
    /// Steps from which on a difference is a loss.
    pub threshold: f64,
    /// Tests of the rate.
    pub rates: Vec<Trial>,
    /// Tests of the acceleration.
    pub accelerations: Vec<Trial>,
    /// The test of the proposal.
    pub proposal: Option<Trial>,
}

impl StepLimits {
    /// Whether a number of steps is a loss.
    #[must_use]
    pub fn is_loss(&self, steps: f64) -> bool {
        steps.abs() > self.threshold
    }

    /// The largest rate; `None` before the first test.
    #[must_use]
    pub fn rate(&self) -> Option<Highest> {
        Highest::of(&self.rates, |motion| motion.rate)
    }

    /// The largest acceleration at [`StepLimits::working_rate`].
    #[must_use]
    pub fn acceleration(&self) -> Option<Highest> {
        Highest::of(&self.accelerations, |motion| motion.acceleration)
    }

    /// The rate at which accelerations are tested.
    #[must_use]
    pub fn working_rate(&self) -> Option<f64> {
        Some(MARGIN * self.rate()?.kept()?)
    }

    /// Bands of rates with loss below a rate without loss: rates without loss on both sides, or
    /// the lowest rate that was tested.
    #[must_use]
    pub fn resonances(&self) -> Vec<[f64; 2]> {
        let mut trials = self.rates.clone();
        trials.sort_by(|a, b| a.motion.rate.total_cmp(&b.motion.rate));
        let mut bands = Vec::new();
        let (mut below, mut open) = (self.bounds.rate[0], false);
        for trial in trials {
            if trial.is_lost {
                open = true;
                continue;
            }
            if open {
                bands.push([below, trial.motion.rate]);
            }
            (below, open) = (trial.motion.rate, false);
        }
        bands
    }

    /// The next motion to test; `None` at the end.
    #[must_use]
    pub fn next(&self) -> Option<Motion> {
        let [low, high] = self.bounds.rate;
        let [gentle, max] = self.bounds.acceleration;
        let scanned = self.rates.len();
        if scanned < SCAN {
            let part = scanned as f64 / (SCAN - 1) as f64;
            return Some(Motion {
                rate: low * (high / low).powf(part),
                acceleration: gentle,
            });
        }
        if let Some(rate) = self.rate()?.middle(RATE_RATIO) {
            return Some(Motion {
                rate,
                acceleration: gentle,
            });
        }
        let rate = self.working_rate()?;
        let at = |acceleration| Some(Motion { rate, acceleration });
        match self.accelerations.as_slice() {
            [] => return at(max),
            [first] if first.is_lost && gentle < max => return at(gentle),
            _ => {}
        }
        let acceleration = self.acceleration()?;
        if let Some(middle) = acceleration.middle(ACCELERATION_RATIO) {
            return at(middle);
        }
        match self.proposal {
            None => at(MARGIN * acceleration.kept()?),
            Some(_) => None,
        }
    }

    /// Takes the result of the motion of [`StepLimits::next`].
    pub fn record(&mut self, motion: Motion, steps: f64) {
        let trial = Trial {
            motion,
            steps,
            is_lost: self.is_loss(steps),
        };
        let is_rate = self.rates.len() < SCAN
            || (self.rate()).is_some_and(|it| it.middle(RATE_RATIO).is_some());
        let is_acceleration = self.accelerations.is_empty()
            || matches!(self.accelerations.as_slice(), [first] if first.is_lost
                && self.bounds.acceleration[0] < self.bounds.acceleration[1])
            || (self.acceleration()).is_some_and(|it| it.middle(ACCELERATION_RATIO).is_some());
        if is_rate {
            self.rates.push(trial);
        } else if is_acceleration {
            self.accelerations.push(trial);
        } else {
            self.proposal = Some(trial);
        }
    }

    /// Proposed rate and acceleration, where the machine file needs them. Nothing is proposed
    /// where the proposal itself lost steps.
    #[must_use]
    pub fn proposed(&self) -> [Option<f64>; 2] {
        if self.proposal.is_none_or(|it| it.is_lost) {
            return [None, None];
        }
        [self.rate(), self.acceleration()].map(|it| it.and_then(|it| it.proposed()))
    }

    /// Units of rate and acceleration.
    #[must_use]
    pub const fn units(&self) -> [&'static str; 2] {
        if self.kind.is_rotary() {
            ["deg/s", "deg/s^2"]
        } else {
            ["mm/s", "mm/s^2"]
        }
    }

    /// One line for the joint.
    #[must_use]
    pub fn summary(&self) -> String {
        let [rate_unit, unit] = self.units();
        let [gentle, _] = self.bounds.acceleration;
        let say = |highest: Option<Highest>, unit: &str| match highest {
            Some(Highest::NoLossUpTo(max)) => format!("no loss up to {max:.1} {unit}"),
            Some(Highest::Between(kept, lost)) => {
                format!("no loss at {kept:.1} {unit}, loss at {lost:.1} {unit}")
            }
            Some(Highest::AllLost(lost)) => format!("loss at {lost:.1} {unit}, the lowest test"),
            None => "not tested".to_string(),
        };
        let mut text = format!(
            "{}: rate at {gentle:.0} {unit}: {}",
            self.name,
            say(self.rate(), rate_unit)
        );
        if let Some(rate) = self.working_rate() {
            text += &format!(
                "; acceleration at {rate:.1} {rate_unit}: {}",
                say(self.acceleration(), unit)
            );
        }
        for [low, high] in self.resonances() {
            text += &format!("; resonance: loss between {low:.1} and {high:.1} {rate_unit}");
        }
        match (self.proposed(), &self.proposal) {
            (_, Some(trial)) if trial.is_lost => {
                text += &format!(
                    "; the proposal of {:.1} {rate_unit} and {:.0} {unit} lost {:.0} steps, so \
                     nothing is proposed",
                    trial.motion.rate, trial.motion.acceleration, trial.steps
                );
            }
            ([None, None], _) => text += "; nothing to propose",
            ([rate, acceleration], _) => {
                let parts = [(rate, rate_unit), (acceleration, unit)];
                let parts = parts.into_iter().filter_map(|(value, unit)| {
                    Some(format!("{} {unit}", crate::tune::rounded(value?)))
                });
                text += &format!("; proposal {}", parts.collect::<Vec<_>>().join(" and "));
            }
        }
        text
    }
}

/// A joint before its tests, for tests.
#[cfg(test)]
pub(crate) fn untested_joint() -> StepLimits {
    StepLimits {
        joint: 0,
        name: "x".to_string(),
        kind: AxisKind::Linear,
        bounds: Bounds {
            rate: [2.0, 70.0],
            acceleration: [300.0, 1400.0],
        },
        threshold: 10.0,
        rates: Vec::new(),
        accelerations: Vec::new(),
        proposal: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs the search on a joint that loses 64 steps where `loses` says so.
    fn searched(loses: impl Fn(&Motion) -> bool) -> StepLimits {
        let mut joint = untested_joint();
        for count in 0.. {
            assert!(count < 60, "{joint:?}");
            let Some(motion) = joint.next() else { break };
            assert!(motion.rate <= 70.0 + 1e-9 && motion.acceleration <= 1400.0);
            joint.record(motion, if loses(&motion) { -64.0 } else { 0.4 });
        }
        joint
    }

    #[test]
    fn limits_are_bisected_and_their_part_is_proposed() {
        let found = searched(|it| it.rate > 41.0 || it.acceleration > 770.0);
        let Some(Highest::Between(kept, lost)) = found.rate() else {
            panic!("{found:?}")
        };
        assert!(kept <= 41.0 && lost > 41.0 && lost / kept < 1.03);
        let Some(Highest::Between(kept, lost)) = found.acceleration() else {
            panic!("{found:?}")
        };
        assert!(kept <= 770.0 && lost > 770.0 && lost / kept < 1.05);
        let [rate, acceleration] = found.proposed().map(Option::unwrap_or_default);
        assert!((0.97 * 28.7..=28.7).contains(&rate), "{rate}");
        assert!((0.95 * 539.0..=539.0).contains(&acceleration));
        assert!(found.resonances().is_empty());
    }

    #[test]
    fn without_loss_nothing_is_proposed() {
        let found = searched(|_| false);
        assert_eq!(found.rate(), Some(Highest::NoLossUpTo(70.0)));
        assert_eq!(found.acceleration(), Some(Highest::NoLossUpTo(1400.0)));
        assert_eq!(found.proposed(), [None, None]);
        assert!(found.summary().contains("no loss up to 70.0 mm/s"));
        assert_eq!(found.rates.len() + found.accelerations.len(), SCAN + 1);
    }

    #[test]
    fn a_loss_below_a_rate_without_loss_is_a_resonance() {
        let found = searched(|it| it.rate > 50.0 || (6.0..9.0).contains(&it.rate));
        let [[low, high]] = found.resonances()[..] else {
            panic!("{found:?}")
        };
        assert!((4.0..6.0).contains(&low) && (9.0..13.0).contains(&high));
        let kept = found.rate().and_then(|it| it.kept()).unwrap_or_default();
        assert!((48.0..=50.0).contains(&kept), "{kept}");
    }

    #[test]
    fn a_proposal_that_loses_steps_is_none() {
        // A band of accelerations that the bisection passes over: 70 % of 907 mm/s^2 is in it.
        let found = searched(|it| {
            let band = (630.0..640.0).contains(&it.acceleration);
            it.rate > 41.0 || band || it.acceleration > 950.0
        });
        assert!(found.proposal.is_some_and(|it| it.is_lost), "{found:?}");
        assert_eq!(found.proposed(), [None, None]);
        let all = searched(|_| true);
        assert_eq!(all.rate(), Some(Highest::AllLost(2.0)));
        assert_eq!(all.proposed(), [None, None]);
    }
}
