//! The spindle: a speed with first-order lag, and a stall for fault injection.

use crate::process::config::SpindleConfig;

/// A spindle, with its speed.
#[derive(Debug, Clone)]
pub struct Spindle {
    /// Fraction of a speed difference that remains after a period.
    keeps: f64,
    period_s: f64,
    rpm: f64,
    stalled: bool,
}

impl Spindle {
    /// Creates a spindle at standstill that is advanced once every `period_s` seconds.
    pub fn new(config: &SpindleConfig, period_s: f64) -> Self {
        Self {
            keeps: if config.time_constant_s > 0.0 {
                libm::exp(-period_s / config.time_constant_s)
            } else {
                0.0
            },
            period_s,
            rpm: 0.0,
            stalled: false,
        }
    }

    /// Speed, rev/min; clockwise above 0.
    pub const fn rpm(&self) -> f64 {
        self.rpm
    }

    /// Stalls the spindle at once whatever the command is, or releases it.
    pub const fn set_stalled(&mut self, stalled: bool) {
        self.stalled = stalled;
    }

    /// Advances by one period under this command (rev/min) and returns the turns made.
    pub fn advance(&mut self, command_rpm: f64) -> f64 {
        let before = self.rpm;
        self.rpm = if self.stalled {
            0.0
        } else {
            let next = command_rpm + (before - command_rpm) * self.keeps;
            // Below one rev/min the spindle stops.
            if command_rpm == 0.0 && next.abs() < 1.0 {
                0.0
            } else {
                next
            }
        };
        0.5 * (before + self.rpm) * self.period_s / 60.0
    }
}
