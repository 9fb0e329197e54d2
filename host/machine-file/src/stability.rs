//! Stability of the position loop at a control period.
//!
//! The inertia cancels out of the servo law (docs/control.md (3.36)-(3.37)), so an axis is a double
//! integrator. Its acceleration is held for a period and takes effect one period after its
//! computation. The rate of the error is a difference through a first-order filter, the integrator
//! a sum. Friction only damps and is left out. The loop is stable if every eigenvalue of one period
//! lies inside the unit circle.

/// Gains of a position loop.
#[derive(Debug, Clone, Copy)]
pub struct Gains {
    /// K_P, 1/s^2.
    pub kp: f64,
    /// K_D, 1/s.
    pub kd: f64,
    /// K_I, 1/s^3.
    pub ki: f64,
    /// Time constant of the filter on the rate of the error, s.
    pub rate_filter: f64,
}

/// States: position, velocity, held acceleration, previous position, filtered rate, integral.
const STATES: usize = 6;
type Matrix = [[f64; STATES]; STATES];

/// Returns the largest eigenvalue magnitude of one control period; the loop is stable below 1.
///
/// Gelfand's formula: the 2^40th root of the norm of the 2^40th power, with an error of about
/// 1e-11.
pub fn spectral_radius(gains: Gains, period: f64) -> f64 {
    let Gains { kp, kd, ki, .. } = gains;
    let keep = if gains.rate_filter > 0.0 {
        (-period / gains.rate_filter).exp()
    } else {
        0.0
    };
    let rate = (1.0 - keep) / period;
    // Without an integrator its state is left out: the eigenvalue of 1 would not be an instability.
    let sum = if ki > 0.0 { 1.0 } else { 0.0 };
    let mut power: Matrix = [
        [1.0, period, period * period / 2.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, period, 0.0, 0.0, 0.0],
        [-kp - kd * rate, 0.0, 0.0, kd * rate, -kd * keep, -ki],
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [rate, 0.0, 0.0, -rate, keep, 0.0],
        [sum * period, 0.0, 0.0, 0.0, 0.0, sum],
    ];
    let mut log_norm = 0.0;
    let doublings = 40;
    for _ in 0..doublings {
        power = product(&power, &power);
        log_norm *= 2.0;
        let norm = power
            .iter()
            .flatten()
            .fold(0.0_f64, |max, entry| max.max(entry.abs()));
        if norm == 0.0 || !norm.is_finite() {
            return if norm == 0.0 { 0.0 } else { f64::INFINITY };
        }
        log_norm += norm.ln();
        for entry in power.iter_mut().flatten() {
            *entry /= norm;
        }
    }
    (log_norm / 2_f64.powi(doublings)).exp()
}

fn product(left: &Matrix, right: &Matrix) -> Matrix {
    let mut result = [[0.0; STATES]; STATES];
    for (row, target) in left.iter().zip(&mut result) {
        for (entry, factors) in row.iter().zip(right) {
            for (sum, factor) in target.iter_mut().zip(factors) {
                *sum += entry * factor;
            }
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gains(kp: f64, kd: f64, rate_filter: f64, ki: f64) -> Gains {
        Gains {
            kp,
            kd,
            ki,
            rate_filter,
        }
    }

    #[test]
    fn short_periods_give_the_roots_of_the_continuous_loop() {
        // s^2 + 400 s + 40000 has the double root -200: exp(-200 * 1e-6) a period.
        let radius = spectral_radius(gains(40_000.0, 400.0, 0.0, 0.0), 1e-6);
        assert!((radius.ln() / 1e-6 + 200.0).abs() < 5.0, "{radius}");
        // Underdamped: s^2 + 40 s + 40000, real part -20.
        let radius = spectral_radius(gains(40_000.0, 40.0, 0.0, 0.0), 1e-6);
        assert!((radius.ln() / 1e-6 + 20.0).abs() < 0.2, "{radius}");
    }

    #[test]
    fn radius_agrees_with_a_simulation() {
        let period = 2e-4;
        let cases = [
            (gains(40_000.0, 400.0, 1.5e-3, 0.0), true),
            (gains(3_600.0, 120.0, 0.0, 0.0), true),
            (gains(3_600.0, 120.0, 0.0, 10_000.0), true),
            (gains(40_000.0, 8_000.0, 0.0, 0.0), false),
            (gains(4e6, 400.0, 1.5e-3, 0.0), false),
            (gains(40_000.0, 400.0, 1.5e-3, 6e7), false),
            (gains(40_000.0, 0.0, 0.0, 0.0), false),
        ];
        for (gains, stable) in cases {
            assert_eq!(spectral_radius(gains, period) < 1.0, stable, "{gains:?}");
            // The same loop written as a simulation.
            let (mut x, mut v, mut held, mut before, mut rate, mut sum) =
                (1.0, 0.0, 0.0, 1.0, 0.0, 0.0);
            let keep = (-period / gains.rate_filter).exp();
            for _ in 0..60_000 {
                let e: f64 = -x;
                rate = keep * rate + (1.0 - keep) * (e + before) / period;
                let next = gains.kp * e + gains.kd * rate + gains.ki * sum;
                sum += e * period;
                before = x;
                x += v * period + held * period * period / 2.0;
                v += held * period;
                held = next;
                if f64::abs(x) > 1e12 {
                    break;
                }
            }
            assert_eq!(x.abs() < 1e-3, stable, "{gains:?} ended at {x}");
        }
    }
}
