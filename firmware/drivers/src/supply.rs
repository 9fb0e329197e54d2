//! Voltage of a supply behind a divider, from codes of a converter, smoothed.

/// A voltage divider at a converter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Divider {
    /// Resistor from the supply to the input, ohm.
    pub upper_ohm: f32,
    /// Resistor from the input to ground, ohm.
    pub lower_ohm: f32,
    /// Reference of the converter, V.
    pub reference_v: f32,
    /// Code at the reference: 4095 for 12 bits.
    pub full_scale: u16,
}

impl Divider {
    /// Voltage of the supply at a code, V.
    #[must_use]
    pub fn volts(&self, code: u16) -> f32 {
        let input = f32::from(code) / f32::from(self.full_scale.max(1)) * self.reference_v;
        input * (self.upper_ohm + self.lower_ohm) / self.lower_ohm
    }
}

/// Watches a supply: a brown-out is reported from below `low_v` until the voltage is above
/// `good_v` again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupplyMonitor {
    low_v: f32,
    good_v: f32,
    smoothed: Option<f32>,
    is_low: bool,
}

impl SupplyMonitor {
    /// A monitor; `good_v` must be above `low_v`, and is raised to it otherwise.
    #[must_use]
    pub const fn new(low_v: f32, good_v: f32) -> Self {
        Self {
            low_v,
            good_v: if good_v > low_v { good_v } else { low_v },
            smoothed: None,
            is_low: false,
        }
    }

    /// Adds a reading; returns whether the supply is too low. Each reading counts a quarter.
    pub fn add(&mut self, volts: f32) -> bool {
        let smoothed = match self.smoothed {
            None => volts,
            Some(before) => before + (volts - before) / 4.0,
        };
        self.smoothed = Some(smoothed);
        let limit = if self.is_low { self.good_v } else { self.low_v };
        self.is_low = smoothed < limit;
        self.is_low
    }

    /// The smoothed voltage, V, once there was a reading.
    #[must_use]
    pub const fn volts(&self) -> Option<f32> {
        self.smoothed
    }
}
