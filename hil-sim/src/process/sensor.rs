//! Force sensor: a quartz element between the table and the vise, its charge amplifier, and the
//! ADC.
//!
//! The element turns with the table and measures along the table's axes, which are those of the
//! pose. On a machine whose pose does not turn with the workpiece it is below the rotary axis, and
//! does not turn. It measures the force **on the workpiece**, which is minus the force on the tool
//! (docs/control.md 1.3), and the weight of vise and workpiece. The codes have that sign; a
//! calibration converts them to the force on the tool.
//!
//! Quartz gives charge for a change of force. The amplifier therefore measures from its last reset,
//! decays with a time constant (a high-pass) and drifts by the leakage of its input. Amplifier
//! output and ADC have a limited range. Every imperfection can be switched off by a field of
//! [`SensorConfig`]; [`SensorConfig::ideal`] keeps the ADC alone.
//!
//! Callers must call [`Sensor::sample`] once per period, because the drift is computed per sample.

use crate::check::{Check, PlantError};
use crate::random::Random;
use serde::{Deserialize, Serialize};

/// Standard acceleration of gravity, m/s^2.
const GRAVITY: f64 = 9.80665;

/// Largest code of the 14-bit ADC; the smallest is -8192.
pub const FULL_CODE: i16 = 8191;

/// Sensor parameters and imperfections of a healthy sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorConfig {
    /// Force at code 8192, the end of the ADC's range, N: sensitivity of amplifier and ADC together
    /// (10 N/V over 10 V is 100 N).
    pub full_scale_n: f64,
    /// Range of the amplifier, N; infinity switches the limit off. The ADC still saturates at its
    /// full scale.
    pub range_n: f64,
    /// Time constant of the high-pass, seconds; infinity switches it off.
    pub high_pass_s: f64,
    /// Drift of each axis, N/s; 0 switches it off.
    pub drift_n_s: [f64; 3],
    /// Standard deviation of the noise of a sample, N; 0 switches it off. The distribution is
    /// bounded by 3.5 standard deviations.
    pub noise_n: f64,
    /// Mass on the element: vise and workpiece, kg; 0 switches their weight off.
    pub vise_kg: f64,
}

impl Default for SensorConfig {
    /// The estimates of docs/control.md 7.1 (items 24 to 26): 10 N/V over 10 V, saturation at the
    /// range; the drift of a quartz amplifier of 2 pC/N with 0.03 pC/s leakage; 1000 s; noise of
    /// two codes; a vise of 3 kg.
    fn default() -> Self {
        Self {
            full_scale_n: 100.0,
            range_n: 100.0,
            high_pass_s: 1000.0,
            drift_n_s: [0.010, -0.006, 0.015],
            noise_n: 0.025,
            vise_kg: 3.0,
        }
    }
}

impl SensorConfig {
    /// A sensor without imperfections; only the ADC rounds.
    pub fn ideal() -> Self {
        Self {
            range_n: f64::INFINITY,
            high_pass_s: f64::INFINITY,
            drift_n_s: [0.0; 3],
            noise_n: 0.0,
            vise_kg: 0.0,
            ..Self::default()
        }
    }

    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        check.within("sensor: full_scale_n".into(), self.full_scale_n, 0.1, 1e6);
        check.within("sensor: range_n".into(), self.range_n, 0.1, f64::INFINITY);
        check.within(
            "sensor: high_pass_s".into(),
            self.high_pass_s,
            1e-3,
            f64::INFINITY,
        );
        for (axis, drift) in self.drift_n_s.into_iter().enumerate() {
            check.within(format!("sensor: drift_n_s {axis}"), drift, -1e3, 1e3);
        }
        check.within("sensor: noise_n".into(), self.noise_n, 0.0, 1e3);
        check.within("sensor: vise_kg".into(), self.vise_kg, 0.0, 1e3);
        check.done()
    }
}

/// Injected faults of a sensor axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorCondition {
    /// Factor on the signal: 1 healthy, -1 reversed.
    pub gain: f64,
    /// Additional drift, N/s.
    pub drift_n_s: f64,
    /// The code is frozen.
    pub stuck: bool,
    /// The signal is lost: the code is always 0.
    pub dropped: bool,
    /// The output is saturated at this end of its range.
    pub saturated: Option<End>,
}

/// An end of the range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The upper one.
    High,
    /// The lower one.
    Low,
}

impl Default for SensorCondition {
    fn default() -> Self {
        Self {
            gain: 1.0,
            drift_n_s: 0.0,
            stuck: false,
            dropped: false,
            saturated: None,
        }
    }
}

/// A sensor with the charge of its amplifier.
#[derive(Debug, Clone)]
pub struct Sensor {
    config: SensorConfig,
    period_s: f64,
    keeps: f64,
    random: Random,
    condition: [SensorCondition; 3],
    /// Force of the last sample.
    force: [f64; 3],
    /// Value that the amplifier holds, N.
    charge: [f64; 3],
    signal: [f64; 3],
    codes: [i16; 3],
    started: bool,
}

impl Sensor {
    /// Creates a sensor that is sampled once every `period_s` seconds and is reset at its first
    /// sample. The configuration must have passed its check.
    pub fn new(config: &SensorConfig, period_s: f64, random: Random) -> Self {
        Self {
            keeps: libm::exp(-period_s / config.high_pass_s),
            config: config.clone(),
            period_s,
            random,
            condition: [SensorCondition::default(); 3],
            force: [0.0; 3],
            charge: [0.0; 3],
            signal: [0.0; 3],
            codes: [0; 3],
            started: false,
        }
    }

    /// Configuration of the sensor.
    pub const fn config(&self) -> &SensorConfig {
        &self.config
    }

    /// Sets the injected faults of an axis.
    pub fn set_condition(&mut self, axis: usize, condition: SensorCondition) {
        self.condition[axis] = condition;
    }

    /// Injected faults of an axis.
    pub fn condition(&self, axis: usize) -> SensorCondition {
        self.condition[axis]
    }

    /// Resets the amplifier: the force of the last sample becomes the zero.
    pub fn reset(&mut self) {
        self.charge = [0.0; 3];
    }

    /// Takes the next sample, with the force on the tool (N) and the direction downwards, both in
    /// the frame of the sensor.
    pub fn sample(&mut self, on_tool: [f64; 3], down: [f64; 3]) {
        let weight = self.config.vise_kg * GRAVITY;
        let pull = down.map(|part| weight * part);
        if !self.started {
            // The amplifier is reset with the vise mounted.
            self.force = core::array::from_fn(|i| pull[i] - on_tool[i]);
            self.started = true;
        }
        for i in 0..3 {
            let condition = &self.condition[i];
            let force = pull[i] - on_tool[i];
            let drift = (self.config.drift_n_s[i] + condition.drift_n_s) * self.period_s;
            self.charge[i] = self.charge[i] * self.keeps + (force - self.force[i]) + drift;
            self.force[i] = force;
            // The noise is always drawn, so a fault does not change the noise of the other axes.
            let noise = self.config.noise_n * deviate(&mut self.random);
            let signal = match condition.saturated {
                Some(End::High) => f64::INFINITY,
                Some(End::Low) => f64::NEG_INFINITY,
                None if condition.dropped => 0.0,
                None => condition.gain * self.charge[i] + noise,
            };
            if condition.stuck {
                continue;
            }
            let full = self.config.full_scale_n;
            let range = if self.config.range_n < full {
                self.config.range_n
            } else {
                full
            };
            let signal = signal.clamp(-range, range);
            let code = (signal / full * (f64::from(FULL_CODE) + 1.0)).round();
            let code = code.clamp(-f64::from(FULL_CODE) - 1.0, f64::from(FULL_CODE));
            self.codes[i] = code as i16;
            self.signal[i] = signal;
        }
    }

    /// Codes of the last sample, signed 14 bits: force on the workpiece along x_w, y_w, z_w.
    pub const fn codes(&self) -> [i16; 3] {
        self.codes
    }

    /// Returns whether the amplifier reports saturation.
    pub fn overloaded(&self) -> bool {
        self.signal
            .iter()
            .any(|signal| signal.abs() >= self.config.range_n)
    }

    /// Input of the ADC, N: the amplifier's output within its range, not rounded.
    pub const fn signal(&self) -> [f64; 3] {
        self.signal
    }
}

/// Random number of mean 0 and variance 1: the sum of four uniform ones of 16 bits each.
fn deviate(random: &mut Random) -> f64 {
    let bits = random.draw();
    let sum: u64 = (0..4).map(|lane| (bits >> (16 * lane)) & 0xffff).sum();
    // Four times (0 to 65535): mean 131070, variance 4 (65536^2 - 1) / 12.
    (sum as f64 - 131_070.0) / 37_837.227
}
