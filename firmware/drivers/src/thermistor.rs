//! Temperature of an NTC resistor in a voltage divider, from the code of a converter.

use micromath::F32Ext;

/// 0 C, in K.
const ZERO_CELSIUS: f32 = 273.15;

/// An NTC resistor to ground with a resistor to the reference of the converter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermistor {
    /// Resistance at 25 C, ohm.
    pub at_25_ohm: f32,
    /// Constant B of its equation, K.
    pub beta_k: f32,
    /// Resistor to the reference, ohm.
    pub pull_up_ohm: f32,
    /// Code of the converter at its reference: 4095 for 12 bits.
    pub full_scale: u16,
}

/// Reason why a code is no temperature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorFault {
    /// The code is near 0: the sensor is shorted.
    Shorted,
    /// The code is near the reference: the sensor or its wire is open.
    Open,
}

impl Thermistor {
    /// Temperature in C, from 1/T = 1/T25 + ln(R/R25)/B. micromath's logarithm adds at most 0.1 K
    /// from -20 to 120 C.
    ///
    /// # Errors
    /// The code is within 1 % of the ends of the scale: see [`SensorFault`].
    pub fn celsius(&self, code: u16) -> Result<f32, SensorFault> {
        let share = f32::from(code) / f32::from(self.full_scale.max(1));
        if share < 0.01 {
            return Err(SensorFault::Shorted);
        }
        if share > 0.99 {
            return Err(SensorFault::Open);
        }
        let resistance = self.pull_up_ohm * share / (1.0 - share);
        // micromath's logarithm is within 0.001 above 1. Below, it inverts its argument by a fast
        // approximation, which would cost 4.5 K.
        let ratio = resistance / self.at_25_ohm;
        let logarithm = if ratio >= 1.0 {
            F32Ext::ln(ratio)
        } else {
            -F32Ext::ln(1.0 / ratio)
        };
        let inverse = 1.0 / (ZERO_CELSIUS + 25.0) + logarithm / self.beta_k;
        Ok(1.0 / inverse - ZERO_CELSIUS)
    }
}
