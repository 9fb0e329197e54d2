//! The servo loop of a joint around an identified plant: margins and step responses.
//!
//! The loop is that of docs/control.md (3.36)-(3.38) with the integrator of (C42):
//! K_P + K_D s / (1 + T_f s) + K_I / s, times the inertia of the machine file. Computation and hold
//! delay the effort by one and a half periods.

use crate::complex::{Complex, complex};
use crate::two_mass::TwoMass;
use std::f64::consts::{PI, TAU};

/// Gains of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// K_P, 1/s^2.
    pub kp: f64,
    /// K_D, 1/s.
    pub kd: f64,
    /// K_I, 1/s^3.
    pub ki: f64,
    /// Time constant of the filter on the rate of the error, seconds.
    pub rate_filter: f64,
    /// Inertia that the controller assumes, kg or kg m^2.
    pub inertia: f64,
}

/// Margins of a loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Smallest factor on the gain that makes the loop unstable, dB.
    pub gain_db: f64,
    /// Smallest phase lag that makes it unstable, degrees.
    pub phase_deg: f64,
    /// Largest amplification of a disturbance at the error (peak of the sensitivity).
    pub peak: f64,
    /// Frequency at which the loop gain falls below 1 for the first time, Hz.
    pub crossover_hz: f64,
}

/// Samples of the frequency axis.
const SAMPLES: usize = 3000;

/// Frequencies at which a loop is evaluated, Hz, up to 0.45 of the sampling rate.
pub fn frequencies(period: f64) -> impl Iterator<Item = f64> {
    let (low, high) = (0.2_f64, 0.45 / period);
    (0..SAMPLES).map(move |index| low * (high / low).powf(index as f64 / (SAMPLES - 1) as f64))
}

impl Gains {
    /// Gain of the open loop around a plant at a frequency.
    #[must_use]
    pub fn open_loop(&self, plant: Complex, unit: f64, frequency: f64, period: f64) -> Complex {
        let s = complex(0.0, TAU * frequency);
        let rate = s * self.kd / (complex(1.0, 0.0) + s * self.rate_filter);
        let sum = complex(self.kp, 0.0) + rate + complex(self.ki, 0.0) / s;
        let delay = Complex::unit(-1.5 * TAU * frequency * period);
        sum * (self.inertia / unit) * plant * delay
    }

    /// Margins of the loop around a plant, from its response at each frequency.
    #[must_use]
    pub fn margins(&self, plant: impl Fn(f64) -> Complex, unit: f64, period: f64) -> Margins {
        let mut margins = Margins {
            gain_db: f64::INFINITY,
            phase_deg: 180.0,
            peak: 1.0,
            crossover_hz: 0.0,
        };
        let mut before: Option<Complex> = None;
        for frequency in frequencies(period) {
            let gain = self.open_loop(plant(frequency), unit, frequency, period);
            margins.peak = margins.peak.max(1.0 / (complex(1.0, 0.0) + gain).abs());
            if let Some(before) = before {
                let (size, size_before) = (gain.abs(), before.abs());
                if (size < 1.0) != (size_before < 1.0) {
                    // The distance of the phase from -180 degrees.
                    let phase = (PI - gain.phase().abs()).to_degrees();
                    margins.phase_deg = margins.phase_deg.min(phase);
                    if margins.crossover_hz == 0.0 {
                        margins.crossover_hz = frequency;
                    }
                }
                // A crossing of the negative real axis.
                if (gain.im < 0.0) != (before.im < 0.0) && gain.re < 0.0 {
                    let part = before.im / (before.im - gain.im);
                    let real = before.re + part * (gain.re - before.re);
                    margins.gain_db = margins.gain_db.min((20.0 * real.abs().log10()).abs());
                }
            }
            before = Some(gain);
        }
        margins
    }

    /// Response to steps, in time.
    ///
    /// A step of the setpoint of 1 axis unit at 0, and a step of an effort of 1 on the driven mass
    /// at half of the `duration`: times, position of the driven mass, effort of the drive.
    #[must_use]
    pub fn steps(
        &self,
        plant: &TwoMass,
        period: f64,
        duration: f64,
        effort: f64,
    ) -> Vec<(f64, f64)> {
        const SUBSTEPS: u32 = 40;
        let step = period / f64::from(SUBSTEPS);
        let (motor_inertia, driven_inertia) = plant.sides();
        let (stiffness, damping) = (plant.stiffness(), plant.damping());
        let keep = if self.rate_filter > 0.0 {
            (-period / self.rate_filter).exp()
        } else {
            0.0
        };
        let (mut motor, mut motor_rate, mut driven, mut driven_rate) = (0.0, 0.0, 0.0, 0.0);
        let (mut held, mut sum, mut rate, mut before) = (0.0, 0.0, 0.0, 1.0);
        let count = (duration / period).round() as u32;
        let mut curve = Vec::new();
        for index in 0..count {
            let time = f64::from(index) * period;
            let load = if time >= duration / 2.0 { effort } else { 0.0 };
            let error: f64 = 1.0 - motor;
            rate = keep * rate + (1.0 - keep) * (error - before) / period;
            before = error;
            let next =
                self.inertia / plant.unit * (self.kp * error + self.kd * rate + self.ki * sum);
            sum += error * period;
            for _ in 0..SUBSTEPS {
                let spring = stiffness * (motor - driven) + damping * (motor_rate - driven_rate);
                motor_rate += step * (held - spring - plant.viscous * motor_rate) / motor_inertia;
                driven_rate += step * (spring - load) / driven_inertia;
                motor += step * motor_rate;
                driven += step * driven_rate;
            }
            held = next;
            curve.push((time, driven));
        }
        curve
    }

    /// Whether the steps die away.
    #[must_use]
    pub fn is_stable(&self, plant: &TwoMass, period: f64) -> bool {
        let curve = self.steps(plant, period, 2.0, 0.0);
        let tail = &curve[curve.len() * 9 / 10..];
        let worst = tail.iter().map(|(_, x)| (x - 1.0).abs());
        worst.fold(0.0, f64::max) < 0.02
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(mode_hz: f64) -> TwoMass {
        TwoMass {
            inertia: 40.0,
            motor_share: 0.5,
            mode_hz,
            mode_damping: 0.05,
            viscous: 0.0,
            unit: 1000.0,
        }
    }

    const GAINS: Gains = Gains {
        kp: 40_000.0,
        kd: 400.0,
        ki: 1e6,
        rate_filter: 1.5e-3,
        inertia: 40.0,
    };

    #[test]
    fn the_gain_margin_is_the_factor_at_which_the_loop_rings_on() {
        for mode_hz in [40.0, 80.0, 1500.0] {
            let plant = plant(mode_hz);
            let margins = GAINS.margins(|f| plant.response(f), plant.unit, 2e-4);
            let scaled = |factor: f64| Gains {
                inertia: GAINS.inertia * factor,
                ..GAINS
            };
            assert!(GAINS.is_stable(&plant, 2e-4), "{mode_hz} Hz");
            let factor = 10_f64.powf(margins.gain_db / 20.0);
            // The margin is upwards or downwards; one side of it rings on.
            let inside = [scaled(0.9 * factor), scaled(1.1 / factor)];
            assert!(
                inside.iter().all(|it| it.is_stable(&plant, 2e-4)),
                "{mode_hz} {margins:?}"
            );
            let outside = [scaled(1.1 * factor), scaled(0.9 / factor)];
            assert!(
                outside.iter().any(|it| !it.is_stable(&plant, 2e-4)),
                "{mode_hz} {margins:?}"
            );
        }
    }

    #[test]
    fn a_rigid_loop_has_the_margins_of_its_formula() {
        // Without integrator, filter and delay, K_P = w^2 and K_D = 2 w: |L| = 1 at w sqrt(2 +
        // sqrt(5)), where the phase is -180 + atan(2 sqrt(2 + sqrt(5))) = -103.6 degrees.
        let gains = Gains {
            ki: 0.0,
            rate_filter: 0.0,
            ..GAINS
        };
        let rigid = |frequency: f64| {
            let omega = TAU * frequency;
            complex(-1000.0 / 40.0 / (omega * omega), 0.0)
        };
        let margins = gains.margins(rigid, 1000.0, 1e-7);
        assert!(
            (margins.crossover_hz - 200.0 * 2.058_17 / TAU).abs() < 0.5,
            "{margins:?}"
        );
        assert!((margins.phase_deg - 76.35).abs() < 0.3, "{margins:?}");
    }
}
