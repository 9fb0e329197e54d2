//! Reports of a calibration and of readings from a file: conditions and results by ISO 230-2.

use super::{Calibration, MeasuredAxis};
use crate::laser::Environment;
use haptimill_volumetric::errors::{ErrorSet, Squareness};
use haptimill_volumetric::file::NOT_TO_COMPENSATE;
use std::fmt::Write as _;

/// What is known of the conditions of readings from a file.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Conditions {
    /// Temperature of the air, degrees Celsius.
    pub air_c: Option<f64>,
    /// Pressure of the air, hPa.
    pub pressure_hpa: Option<f64>,
    /// Temperature of the machine, degrees Celsius.
    pub machine_c: Option<f64>,
    /// The controller compensated during the readings.
    pub compensated: Option<bool>,
}

impl Conditions {
    /// The conditions as text; what nobody stated is named.
    #[must_use]
    pub fn report(&self) -> String {
        let compensation = match self.compensated {
            None => "not stated: the readings of a compensated machine are what it leaves".into(),
            Some(false) => "off".into(),
            Some(true) => format!("ON: {REMAINS}; {NOT_TO_COMPENSATE}"),
        };
        let stated = |value: Option<f64>, unit: &str| {
            value.map_or_else(
                || "not stated".to_string(),
                |value| format!("{value} {unit}"),
            )
        };
        let mut text = format!(
            "machine     load not stated; temperature {}; volumetric compensation {compensation}\n\
             air         temperature {}, pressure {}; the instrument corrects the wavelength\n",
            stated(self.machine_c, "deg C"),
            stated(self.air_c, "deg C"),
            stated(self.pressure_hpa, "hPa"),
        );
        if let Some(machine_c) = self.machine_c {
            text += &warm(&Environment {
                machine_c,
                ..Environment::default()
            });
        }
        text
    }
}

/// What the readings of a compensated machine are.
const REMAINS: &str = "positioning, straightness and squareness are what it leaves on the measured \
                       lines; rotations remain";

/// Warning of a machine that has not the temperature at which lengths are stated; empty otherwise.
fn warm(environment: &Environment) -> String {
    if environment.off_reference().abs() <= 1e-9 {
        return String::new();
    }
    let per_metre = environment.expansion_uncertainty(1000.0) * 1e3;
    format!(
        "WARNING     the machine has {} deg C and not 20; the coefficient of expansion adds an \
         uncertainty of +-{per_metre:.1} um per metre\n",
        environment.machine_c
    )
}

/// Results of ISO 230-2 and squareness errors as text.
pub(super) fn results(axes: &[MeasuredAxis], errors: &ErrorSet) -> String {
    // Writing to a string does not fail.
    let mut text = String::from("ISO 230-2            A        R        B        E        M\n");
    for axis in axes {
        for measured in &axis.functions {
            let (function, result) = (measured.function, &measured.result);
            let unit = function.file_unit();
            let _ = writeln!(
                text,
                "{function} {:<5} {:>8.3} {:>8.3} {:>8.3} {:>8.3} {:>8.3}",
                function.unit(),
                result.accuracy / unit,
                result.repeatability / unit,
                result.reversal / unit,
                result.systematic / unit,
                result.range / unit,
            );
        }
    }
    for (name, value) in Squareness::NAMES.iter().zip(errors.squareness.values()) {
        let _ = writeln!(text, "{name} urad {:>8.3}", value * 1e6);
    }
    text
}

impl Calibration {
    /// Conditions and results as text.
    #[must_use]
    pub fn report(&self) -> String {
        let mut text = String::new();
        let Environment {
            air_c,
            pressure_hpa,
            humidity_percent,
            ..
        } = self.options.environment;
        let compensation = match self.compensation {
            None => "the machine has none".to_string(),
            Some(0) => "off".to_string(),
            Some(percent) => format!("ON ({percent} %): {REMAINS}; {NOT_TO_COMPENSATE}"),
        };
        let wavelength = if self.options.corrects_wavelength {
            "corrected by sensors".to_string()
        } else {
            let ppm = self.options.environment.wavelength_change() * 1e6;
            format!("NOT corrected: readings are off by {:.2} ppm", -ppm)
        };
        let roll = if self.options.roll.is_some() {
            "by another instrument than the laser"
        } else {
            "not measured, taken as 0"
        };
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "machine     unloaded; volumetric compensation {compensation}\n\
             air         {air_c} deg C, {pressure_hpa} hPa, {humidity_percent} %; wavelength \
             {wavelength}\n\
             roll        {roll}"
        );
        text += &warm(&self.options.environment);
        text + "\n" + &results(&self.axes, &self.errors)
    }
}
