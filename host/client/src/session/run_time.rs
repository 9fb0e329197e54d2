//! Time that a job takes at overrides: the path rate of the controller, without its link.

use haptimill_firmware::motion::interpolator::{FULL_RATE, braking_limits};
use haptimill_firmware::motion::ramp::{Ramp, RampLimits};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Action, Pace};
use haptimill_protocol::setpoint::Setpoint;

/// Sums up the time of a job that nothing stops, setpoint by setpoint. Pauses take no time.
#[derive(Debug)]
pub struct RunTime {
    /// Feed and rapid override, percent.
    overrides: [u8; 2],
    limits: Option<RampLimits>,
    period_s: f64,
    rate: Ramp,
    target: i64,
    /// Control periods so far, and program time beyond the last setpoint, 2^-32 periods.
    periods: u64,
    time: i64,
}

impl RunTime {
    /// Begins at the overrides of feed (at least 1 %) and of rapid moves (at least 1 %).
    #[must_use]
    pub fn new(machine: &MachineFile, feed: u8, rapid: u8) -> Self {
        let config = &machine.config;
        let target = target(Pace::FEED, [feed.max(1), rapid.max(1)]);
        Self {
            overrides: [feed.max(1), rapid.max(1)],
            limits: braking_limits(&config.stopping, config.period_us),
            period_s: f64::from(config.period_us) * 1e-6,
            rate: Ramp::at(target),
            target,
            periods: 0,
            time: 0,
        }
    }

    /// Adds the motion to a setpoint.
    pub fn add(&mut self, setpoint: &Setpoint) {
        let end = i64::from(setpoint.periods) * FULL_RATE;
        while self.time < end {
            let steady = self.rate == Ramp::at(self.target);
            match &self.limits {
                Some(limits) if !steady => {
                    self.time += self.rate.advance(self.target, limits).max(0);
                    self.periods += 1;
                }
                _ => {
                    let periods = (end - self.time + self.target - 1) / self.target;
                    self.time += periods * self.target;
                    self.periods += periods as u64;
                }
            }
        }
        self.time -= end;
        if let Action::Pace(pace) = setpoint.action {
            let is_steady = self.rate == Ramp::at(self.target);
            self.target = target(pace, self.overrides);
            // The controller begins a motion at its override.
            if is_steady && setpoint.rates.iter().all(|rate| *rate == 0) {
                self.rate = Ramp::at(self.target);
            }
        }
    }

    /// The time so far, seconds.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.periods as f64 * self.period_s
    }
}

fn target(pace: Pace, [feed, rapid]: [u8; 2]) -> i64 {
    FULL_RATE * i64::from(pace.factor(feed, rapid)) / 100
}
