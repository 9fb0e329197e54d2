//! Gains for an identified joint.
//!
//! Both poles of the rigid loop are at -w: K_P = w^2, K_D = 2 w. The integrator is an eighth of
//! what three poles there would give, K_I = w^3 / 8. The proposal is the largest w, with a filter
//! on the rate of the error, at which the loop keeps these margins: around both masses, and around
//! the motor alone, which is the plant while the gap of the screw is open. The encoder on the motor
//! does not see the driven mass, so its resonance behind the loop is bounded too.

use crate::complex::complex;
use crate::servo_loop::{Gains, Margins, frequencies};
use crate::two_mass::TwoMass;

/// What a proposal must keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Requirement {
    /// Gain margin, dB.
    pub gain_db: f64,
    /// Phase margin, degrees.
    pub phase_deg: f64,
    /// Largest peak of the sensitivity.
    pub peak: f64,
    /// Largest amplification from the setpoint to the driven mass.
    pub driven_peak: f64,
    /// Largest effort of one encoder count, as a part of the drive's limit.
    pub count_effort: f64,
}

impl Default for Requirement {
    fn default() -> Self {
        Self {
            gain_db: 6.0,
            phase_deg: 40.0,
            peak: 2.0,
            driven_peak: 2.0,
            count_effort: 0.02,
        }
    }
}

/// Range of w, 1/s, and its resolution.
const RATES: (f64, f64) = (20.0, 1000.0);
const STEPS: usize = 120;

/// Filters on the rate of the error, seconds.
const FILTERS: [f64; 6] = [0.5e-3, 1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3];

/// A joint as tuning sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// The identified plant.
    pub plant: TwoMass,
    /// Control period, seconds.
    pub period: f64,
    /// Size of an encoder count, mm or degrees.
    pub count: f64,
    /// Limit of the drive, N or N m.
    pub limit: f64,
}

/// Margins around both masses, and around the motor alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BothMargins {
    /// The flanks of the screw touch.
    pub closed: Margins,
    /// The gap of the screw is open.
    pub open: Margins,
}

impl Joint {
    /// Margins of gains.
    #[must_use]
    pub fn margins(&self, gains: &Gains) -> BothMargins {
        let plant = self.plant;
        BothMargins {
            closed: gains.margins(|f| plant.response(f), plant.unit, self.period),
            open: gains.margins(|f| plant.motor_alone(f), plant.unit, self.period),
        }
    }

    /// Effort of one count in the period in which it comes, N or N m.
    #[must_use]
    pub fn count_effort(&self, gains: &Gains) -> f64 {
        let rate = if gains.rate_filter > 0.0 {
            (1.0 - (-self.period / gains.rate_filter).exp()) / self.period
        } else {
            1.0 / self.period
        };
        gains.inertia / self.plant.unit * self.count * (gains.kp + gains.kd * rate)
    }

    /// Largest amplification from the setpoint to the driven mass.
    #[must_use]
    pub fn driven_peak(&self, gains: &Gains) -> f64 {
        let plant = self.plant;
        let one = complex(1.0, 0.0);
        frequencies(self.period)
            .map(|frequency| {
                let gain = gains.open_loop(
                    plant.response(frequency),
                    plant.unit,
                    frequency,
                    self.period,
                );
                (gain / (one + gain) * plant.driven(frequency)).abs()
            })
            .fold(0.0, f64::max)
    }

    /// What the gains miss of a requirement, as text with both values; empty if they keep it.
    #[must_use]
    pub fn misses(&self, gains: &Gains, requirement: &Requirement) -> Vec<String> {
        let mut misses = Vec::new();
        let margins = self.margins(gains);
        for (margins, around) in [(margins.closed, ""), (margins.open, " with the gap open")] {
            let Margins {
                gain_db,
                phase_deg,
                peak,
                ..
            } = margins;
            if gain_db.is_nan() || gain_db < requirement.gain_db {
                let min = requirement.gain_db;
                misses.push(format!(
                    "gain margin{around} {gain_db:.1} dB, least {min} dB"
                ));
            }
            if phase_deg.is_nan() || phase_deg < requirement.phase_deg {
                let min = requirement.phase_deg;
                misses.push(format!(
                    "phase margin{around} {phase_deg:.0} deg, least {min} deg"
                ));
            }
            if peak.is_nan() || peak > requirement.peak {
                let max = requirement.peak;
                misses.push(format!("sensitivity{around} {peak:.2}, most {max}"));
            }
        }
        let driven = self.driven_peak(gains);
        if driven.is_nan() || driven > requirement.driven_peak {
            let max = requirement.driven_peak;
            misses.push(format!(
                "amplification from the setpoint to the driven mass {driven:.2}, most {max}"
            ));
        }
        let effort = self.count_effort(gains) / self.limit;
        if effort.is_nan() || effort > requirement.count_effort {
            let max = requirement.count_effort * 100.0;
            misses.push(format!(
                "effort of one count {:.1} % of the drive's limit, most {max} %",
                effort * 100.0
            ));
        }
        // The slowest of the checks comes last.
        if misses.is_empty() && !gains.is_stable(&self.plant, self.period) {
            misses.push("the step response does not die away".to_string());
        }
        misses
    }

    /// The gains with the largest w that keep the requirement; `None` if none do.
    #[must_use]
    pub fn propose(&self, requirement: &Requirement) -> Option<Gains> {
        let (low, high) = RATES;
        (0..STEPS).rev().find_map(|step| {
            let rate = low * (high / low).powf(step as f64 / (STEPS - 1) as f64);
            FILTERS.into_iter().find_map(|rate_filter| {
                let gains = Gains {
                    kp: rounded(rate * rate),
                    kd: rounded(2.0 * rate),
                    ki: rounded(rate * rate * rate / 8.0),
                    rate_filter,
                    inertia: self.plant.inertia,
                };
                self.misses(&gains, requirement).is_empty().then_some(gains)
            })
        })
    }
}

/// Three significant digits.
#[must_use]
pub fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let scale = 10_f64.powi(value.abs().log10().floor() as i32 - 2);
    let digits = (value / scale).round() * scale;
    // Without the rounding of the scale in the last bits.
    (digits * 1e9).round() / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(mode_hz: f64) -> Joint {
        Joint {
            plant: TwoMass {
                inertia: 40.0,
                motor_share: 0.5,
                mode_hz,
                mode_damping: 0.05,
                viscous: 0.0,
                unit: 1000.0,
            },
            period: 2e-4,
            count: 0.000_625,
            limit: 750.0,
        }
    }

    #[test]
    fn a_stiffer_joint_gets_higher_gains_and_each_keeps_its_margins() {
        let mut last = 0.0;
        for mode_hz in [20.0, 40.0, 80.0, 160.0] {
            // A fine encoder: the effort of a count is no bound here.
            let joint = Joint {
                count: 1e-6,
                ..joint(mode_hz)
            };
            let requirement = Requirement::default();
            let Some(gains) = joint.propose(&requirement) else {
                panic!("no gains at {mode_hz} Hz");
            };
            let margins = joint.margins(&gains);
            for margins in [margins.closed, margins.open] {
                assert!(margins.gain_db >= 6.0 && margins.phase_deg >= 40.0 && margins.peak <= 2.0);
            }
            assert!(gains.is_stable(&joint.plant, joint.period));
            assert!(gains.kp > last, "{mode_hz} Hz: {gains:?}");
            last = gains.kp;
        }
    }

    #[test]
    fn a_coarse_encoder_lowers_the_gains() {
        let requirement = Requirement::default();
        let kp = |count: f64| {
            let joint = Joint {
                count,
                ..joint(160.0)
            };
            joint.propose(&requirement).map_or(0.0, |gains| gains.kp)
        };
        assert!(kp(0.02) < kp(0.000_625));
    }

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!(rounded(40_123.0), 40_100.0);
        assert_eq!(rounded(0.123_456), 0.123);
        assert_eq!(rounded(1_000_000.0), 1_000_000.0);
        assert_eq!(rounded(0.0), 0.0);
    }
}
