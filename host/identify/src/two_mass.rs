//! A joint as two masses with a spring: motor and screw, and the driven mass.
//!
//! With the total inertia M, the motor's part r of it, the natural frequency w of one side against
//! the other and its damping ratio z, the spring has the stiffness k = w^2 r (1 - r) M and the
//! damping c = 2 z w r (1 - r) M. Effort acts on the motor, and the encoder is on the motor. The
//! viscous friction acts on the motor side.

use crate::complex::{Complex, complex};
use crate::least_squares::solve;
use std::f64::consts::TAU;

/// The linear plant of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoMass {
    /// Total inertia, kg or kg m^2.
    pub inertia: f64,
    /// Part of it on the motor side, 0 to 1.
    pub motor_share: f64,
    /// Natural frequency of motor against driven mass, Hz.
    pub mode_hz: f64,
    /// Damping ratio of that mode.
    pub mode_damping: f64,
    /// Viscous friction, N s/mm or N m s/deg.
    pub viscous: f64,
    /// Acceleration of one unit of effort on one unit of inertia: 1000 or 180 / pi.
    pub unit: f64,
}

/// A plant that was fitted to a frequency response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The plant. Without a resonance its mode lies at [`UNSEEN`] times the highest frequency, with
    /// [`UNSEEN_DAMPING`]: the worst that the points do not exclude.
    pub plant: TwoMass,
    /// Median of the relative difference between the response and the plant, without a resonance
    /// the rigid one.
    pub error: f64,
    /// The points show a resonance; if not, the highest of their frequencies, Hz.
    pub resonance: Result<(), f64>,
}

/// Frequency of a mode that was not seen, as a multiple of the highest measured frequency.
pub const UNSEEN: f64 = 1.25;
/// Its damping ratio.
pub const UNSEEN_DAMPING: f64 = 0.02;

/// Ratio by which a mode must lower the sum of the weighted squares, or it is none.
const GAIN: f64 = 2.5;
/// Largest damping ratio of a mode.
const MAX_DAMPING: f64 = 0.3;
/// Smallest and largest share of the motor in a mode: beyond them peak and notch coincide.
const SHARES: std::ops::RangeInclusive<f64> = 0.1..=0.9;
/// Range of the notch of a mode: multiples of the lowest and the highest measured frequency.
const NOTCH: [f64; 2] = [1.2, 0.9];

/// A measured point of the frequency response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Hz.
    pub frequency: f64,
    /// Motion of the motor for effort, mm/N or deg/(N m).
    pub response: Complex,
    /// Standard deviation of the response.
    pub deviation: f64,
}

impl TwoMass {
    /// Stiffness of the spring, effort per axis unit.
    #[must_use]
    pub fn stiffness(&self) -> f64 {
        let omega = TAU * self.mode_hz;
        omega * omega * self.reduced()
    }

    /// Damping of the spring, effort per axis unit and second.
    #[must_use]
    pub fn damping(&self) -> f64 {
        2.0 * self.mode_damping * TAU * self.mode_hz * self.reduced()
    }

    fn reduced(&self) -> f64 {
        self.inertia * self.motor_share * (1.0 - self.motor_share) / self.unit
    }

    /// Inertia of motor side and driven side, effort per axis unit and second squared.
    #[must_use]
    pub fn sides(&self) -> (f64, f64) {
        let total = self.inertia / self.unit;
        (total * self.motor_share, total * (1.0 - self.motor_share))
    }

    /// Frequency at which the motor stands still while the driven mass moves, Hz.
    #[must_use]
    pub fn antiresonance(&self) -> f64 {
        self.mode_hz * self.motor_share.sqrt()
    }

    /// Motion of the motor for effort at a frequency.
    #[must_use]
    pub fn response(&self, frequency: f64) -> Complex {
        let s = complex(0.0, TAU * frequency);
        let (motor, driven) = self.sides();
        let spring = complex(self.stiffness(), 0.0) + s * self.damping();
        let driven = s * s * driven + spring;
        let motor = s * s * motor + s * self.viscous + spring;
        driven / (motor * driven - spring * spring)
    }

    /// Motion of the driven mass for motion of the motor.
    #[must_use]
    pub fn driven(&self, frequency: f64) -> Complex {
        let s = complex(0.0, TAU * frequency);
        let spring = complex(self.stiffness(), 0.0) + s * self.damping();
        spring / (s * s * self.sides().1 + spring)
    }

    /// The motor side alone, while the gap of the screw is open.
    #[must_use]
    pub fn motor_alone(&self, frequency: f64) -> Complex {
        let s = complex(0.0, TAU * frequency);
        complex(1.0, 0.0) / (s * s * self.sides().0 + s * self.viscous)
    }

    fn parameters(&self) -> [f64; 4] {
        [
            self.inertia.ln(),
            (self.motor_share / (1.0 - self.motor_share)).ln(),
            self.mode_hz.ln(),
            self.mode_damping.ln(),
        ]
    }

    fn with(&self, parameters: [f64; 4]) -> Self {
        let [inertia, share, mode, damping] = parameters;
        Self {
            inertia: inertia.exp(),
            motor_share: 1.0 / (1.0 + (-share).exp()),
            mode_hz: mode.exp(),
            mode_damping: damping.exp(),
            ..*self
        }
    }

    /// Weighted residuals of the points: relative to the response, with its deviation.
    fn residuals(&self, points: &[Point], model_error: f64) -> Vec<f64> {
        points
            .iter()
            .flat_map(|point| {
                let size = point.response.abs();
                let weight = 1.0 / (point.deviation.hypot(model_error * size));
                let difference = (self.response(point.frequency) - point.response) * weight;
                [difference.re, difference.im]
            })
            .collect()
    }

    fn cost(&self, points: &[Point]) -> f64 {
        let residuals = self.residuals(points, MODEL_ERROR);
        residuals.iter().map(|it| it * it).sum()
    }

    /// One mass: its mode is far above the points.
    const fn rigid(inertia: f64, viscous: f64, unit: f64, high: f64) -> Self {
        Self {
            inertia,
            motor_share: 0.5,
            mode_hz: 1e3 * high,
            mode_damping: 0.05,
            viscous,
            unit,
        }
    }

    /// The one mass whose response is nearest to the points.
    fn fit_rigid(points: &[Point], viscous: f64, unit: f64, high: f64) -> Self {
        // Each point gives an inertia; the best one is among them or between two of them.
        let mut guesses: Vec<f64> = points
            .iter()
            .map(|point| {
                let omega = TAU * point.frequency;
                unit / (omega * omega * point.response.abs())
            })
            .collect();
        guesses.sort_by(f64::total_cmp);
        let cost = |inertia: f64| Self::rigid(inertia, viscous, unit, high).cost(points);
        let (mut low, mut high_end) = (guesses[0] / 2.0, guesses[guesses.len() - 1] * 2.0);
        for _ in 0..100 {
            let step = (high_end / low).powf(1.0 / 3.0);
            let (one, two) = (low * step, low * step * step);
            if cost(one) < cost(two) {
                high_end = two;
            } else {
                low = one;
            }
        }
        Self::rigid((low * high_end).sqrt(), viscous, unit, high)
    }

    /// Whether the mode is one that the points show, against one mass without a mode.
    fn is_shown(&self, points: &[Point], rigid: &Self, low: f64, high: f64) -> bool {
        self.cost(points) * GAIN < rigid.cost(points)
            && self.mode_damping < MAX_DAMPING
            && SHARES.contains(&self.motor_share)
            && (NOTCH[0] * low..=NOTCH[1] * high).contains(&self.antiresonance())
    }

    /// Median of the relative difference between the response and the plant.
    fn median_error(&self, points: &[Point]) -> f64 {
        let mut errors: Vec<f64> = points
            .iter()
            .map(|point| {
                let difference = self.response(point.frequency) - point.response;
                difference.abs() / point.response.abs()
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }

    /// The plant whose response is nearest to the points. `inertia` starts the search; the
    /// frequency is sought over the range of the points. `None` without points.
    #[must_use]
    pub fn fit(points: &[Point], inertia: f64, viscous: f64, unit: f64) -> Option<Fit> {
        let low = points.first()?.frequency;
        let high = points.last()?.frequency;
        let mut best: Option<(f64, Self)> = None;
        for step in 0..24 {
            let mode_hz = 2.0 * low * (high / low / 1.4).powf(f64::from(step) / 23.0);
            for motor_share in [0.25, 0.5, 0.75] {
                let start = Self {
                    inertia,
                    motor_share,
                    mode_hz,
                    mode_damping: 0.05,
                    viscous,
                    unit,
                };
                let found = start.descend(points);
                let cost = found.cost(points);
                if cost.is_finite() && best.is_none_or(|(min, _)| cost < min) {
                    best = Some((cost, found));
                }
            }
        }
        let (_, found) = best?;
        let rigid = Self::fit_rigid(points, viscous, unit, high);
        if found.is_shown(points, &rigid, low, high) {
            return Some(Fit {
                plant: found,
                error: found.median_error(points),
                resonance: Ok(()),
            });
        }
        Some(Fit {
            plant: Self {
                mode_hz: UNSEEN * high,
                mode_damping: UNSEEN_DAMPING,
                ..rigid
            },
            error: rigid.median_error(points),
            resonance: Err(high),
        })
    }

    /// Levenberg-Marquardt on the logarithms of the parameters.
    fn descend(self, points: &[Point]) -> Self {
        let mut here = self;
        let mut cost = here.cost(points);
        let mut damping = 1e-2;
        for _ in 0..60 {
            let parameters = here.parameters();
            let residuals = here.residuals(points, MODEL_ERROR);
            let step = 1e-6;
            let columns: [Vec<f64>; 4] = std::array::from_fn(|index| {
                let mut shifted = parameters;
                shifted[index] += step;
                let moved = here.with(shifted).residuals(points, MODEL_ERROR);
                let slopes = moved.iter().zip(&residuals).map(|(b, a)| (b - a) / step);
                slopes.collect()
            });
            let (mut normal, mut right) = ([[0.0; 4]; 4], [0.0; 4]);
            for i in 0..4 {
                for j in 0..4 {
                    normal[i][j] = columns[i].iter().zip(&columns[j]).map(|(a, b)| a * b).sum();
                }
                right[i] = -columns[i]
                    .iter()
                    .zip(&residuals)
                    .map(|(a, r)| a * r)
                    .sum::<f64>();
            }
            for (i, row) in normal.iter_mut().enumerate() {
                row[i] = row[i] * (1.0 + damping) + 1e-12;
            }
            let Some(change) = solve(normal, right) else {
                break;
            };
            let bounded = |index: usize| parameters[index] + change[index].clamp(-0.5, 0.5);
            let next = here.with(std::array::from_fn(bounded));
            let next_cost = next.cost(points);
            if next_cost < cost {
                let gain = cost - next_cost;
                (here, cost) = (next, next_cost);
                damping = (damping / 3.0).max(1e-9);
                if gain < 1e-9 * cost {
                    break;
                }
            } else {
                damping *= 4.0;
                if damping > 1e9 {
                    break;
                }
            }
        }
        here
    }
}

/// Relative error of a response that no noise explains: the model is not exact.
const MODEL_ERROR: f64 = 0.02;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_those_of_the_masses() {
        let plant = TwoMass {
            inertia: 40.0,
            motor_share: 0.4,
            mode_hz: 80.0,
            mode_damping: 0.02,
            viscous: 0.0,
            unit: 1000.0,
        };
        // Far below the mode it is one mass; far above it, the motor.
        let accelerate = |frequency: f64| {
            let omega = TAU * frequency;
            plant.response(frequency).abs() * omega * omega
        };
        assert!((accelerate(1.0) / 25.0 - 1.0).abs() < 1e-3);
        assert!((accelerate(3000.0) / 62.5 - 1.0).abs() < 1e-2);
        // The spring moves the driven mass alone: at once when slow, in antiphase when fast.
        assert!((plant.driven(1.0).re - 1.0).abs() < 1e-3);
        assert!(plant.driven(100.0).re < 0.0);
        // Peak and notch.
        let at = |frequency: f64| plant.response(frequency).abs();
        assert!(at(80.0) > at(75.0) && at(80.0) > at(85.0));
        let notch = plant.antiresonance();
        assert!(at(notch) < at(notch - 4.0) && at(notch) < at(notch + 4.0));
    }

    #[test]
    fn a_fit_finds_the_plant_that_made_the_points() {
        for (share, mode_hz) in [(0.5, 80.0), (0.75, 71.0), (0.3, 35.0)] {
            let plant = TwoMass {
                inertia: 40.0,
                motor_share: share,
                mode_hz,
                mode_damping: 0.05,
                viscous: 0.15,
                unit: 1000.0,
            };
            let points: Vec<Point> = (0..30)
                .map(|i| 4.0 * 50_f64.powf(f64::from(i) / 29.0))
                .map(|frequency| Point {
                    frequency,
                    response: plant.response(frequency),
                    deviation: 1e-6,
                })
                .collect();
            let found = TwoMass::fit(&points, 80.0, 0.15, 1000.0).expect("points");
            assert!(found.error < 1e-3, "{found:?}");
            assert_eq!(found.resonance, Ok(()));
            for (found, expected) in found.plant.parameters().iter().zip(plant.parameters()) {
                assert!((found - expected).abs() < 1e-3, "{found} {expected}");
            }
        }
    }

    /// A mode far above the points is not invented, and one whose notch is within them is found,
    /// with responses that are off by up to 6 %.
    #[test]
    fn a_mode_beyond_the_points_is_not_found() {
        for (mode_hz, share, is_seen) in [(400.0, 0.5, false), (180.0, 0.5, true)] {
            let plant = TwoMass {
                inertia: 40.0,
                motor_share: share,
                mode_hz,
                mode_damping: 0.05,
                viscous: 0.15,
                unit: 1000.0,
            };
            let points: Vec<Point> = (0..30)
                .map(|i| (i, 4.0 * 37.5_f64.powf(f64::from(i) / 29.0)))
                .map(|(i, frequency)| Point {
                    frequency,
                    response: plant.response(frequency)
                        * (1.0 + 0.03 * f64::from(i * 7919 % 5 - 2)),
                    deviation: 1e-9,
                })
                .collect();
            let found = TwoMass::fit(&points, 80.0, 0.15, 1000.0).expect("points");
            assert_eq!(found.resonance.is_ok(), is_seen, "{found:?}");
            assert!((found.plant.inertia / 40.0 - 1.0).abs() < 0.08, "{found:?}");
            if !is_seen {
                assert!(
                    (found.plant.mode_hz - UNSEEN * 150.0).abs() < 0.1,
                    "{found:?}"
                );
            }
        }
    }
}
