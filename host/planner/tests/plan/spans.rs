//! The cubics that the controller interpolates between setpoints, computed from the integers alone.

use haptimill_planner::Plan;
use haptimill_protocol::setpoint::Setpoint;

/// The cubic from one setpoint to the next, in one coordinate.
#[derive(Debug, Clone, Copy)]
pub struct Cubic {
    /// Length in seconds.
    pub t: f64,
    /// Positions and rates at the ends.
    pub p: [f64; 2],
    pub v: [f64; 2],
}

impl Cubic {
    /// Acceleration at both ends; linear between.
    pub fn acceleration(&self) -> [f64; 2] {
        let step = self.p[1] - self.p[0];
        let t = self.t;
        [
            6.0 * step / (t * t) - (4.0 * self.v[0] + 2.0 * self.v[1]) / t,
            -6.0 * step / (t * t) + (2.0 * self.v[0] + 4.0 * self.v[1]) / t,
        ]
    }

    pub fn jerk(&self) -> f64 {
        let [a, b] = self.acceleration();
        (b - a) / self.t
    }

    /// Maximum rate.
    pub fn peak_rate(&self) -> f64 {
        let [a, b] = self.acceleration();
        let mut peak = self.v[0].abs().max(self.v[1].abs());
        if a * b < 0.0 {
            let at = a / (a - b);
            peak = peak.max((self.v[0] + 0.5 * a * at * self.t).abs());
        }
        peak
    }

    /// Position at a fraction of the span.
    pub fn at(&self, u: f64) -> f64 {
        let (u2, u3) = (u * u, u * u * u);
        (2.0 * u3 - 3.0 * u2 + 1.0) * self.p[0]
            + (u3 - 2.0 * u2 + u) * self.t * self.v[0]
            + (3.0 * u2 - 2.0 * u3) * self.p[1]
            + (u3 - u2) * self.t * self.v[1]
    }
}

/// Millimetres or degrees in one axis unit of coordinate `k` of the H-4.
pub fn unit(k: usize) -> f64 {
    if k < 3 {
        1.0 / 1_048_576.0
    } else {
        360.0 / 4_294_967_296.0
    }
}

/// A span between two setpoints: its start time and its five cubics.
pub struct Span {
    pub start: f64,
    pub axes: [Cubic; 5],
}

/// All spans of a plan.
pub fn spans(plan: &Plan) -> Vec<Span> {
    spans_of(&plan.start, &plan.setpoints, plan.period_s)
}

/// All spans of setpoints.
pub fn spans_of(start: &[i32], setpoints: &[Setpoint], period_s: f64) -> Vec<Span> {
    let mut pose: Vec<i32> = start.to_vec();
    let mut rates = vec![0i32; pose.len()];
    let mut period = 0u64;
    let mut spans = Vec::new();
    for setpoint in setpoints {
        let t = f64::from(setpoint.periods) * period_s;
        let axes = std::array::from_fn(|k| Cubic {
            t,
            p: [
                f64::from(pose[k]) * unit(k),
                f64::from(setpoint.pose[k]) * unit(k),
            ],
            v: [
                f64::from(rates[k]) * 256.0 * unit(k),
                f64::from(setpoint.rates[k]) * 256.0 * unit(k),
            ],
        });
        spans.push(Span {
            start: period as f64 * period_s,
            axes,
        });
        pose = setpoint.pose.to_vec();
        rates = setpoint.rates.to_vec();
        period += u64::from(setpoint.periods);
    }
    spans
}
