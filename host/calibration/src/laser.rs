//! A laser interferometer and the instruments beside it, on the simulated machine.
//!
//! Readings have the sign of the tool relative to the workpiece. The values of [`LaserOptions`] are
//! those of a common instrument (633 nm, class ML10), as two standard deviations. A scale error
//! belongs to a set-up: all runs of an axis share it, and their mean keeps it. A constant error
//! belongs to a reading. The error of the expansion coefficient is a property of the machine: it is
//! the same in all set-ups of a seed.

use crate::noise::Noise;
use core::fmt;

/// What an instrument measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Positioning, by the beam along the motion.
    Linear,
    /// Straightness, by a Wollaston prism.
    Straightness,
    /// Pitch or yaw, by two beams.
    Angle,
    /// Roll: not by a laser beam along the motion, which a turn about the beam does not change.
    Roll,
}

/// Air along the beam, and the machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Environment {
    /// Temperature of the air, degrees Celsius.
    pub air_c: f64,
    /// Pressure, hPa.
    pub pressure_hpa: f64,
    /// Relative humidity, percent.
    pub humidity_percent: f64,
    /// Temperature of the scales of the machine, degrees Celsius.
    pub machine_c: f64,
}

impl Default for Environment {
    /// The conditions for which the wavelength is stated.
    fn default() -> Self {
        Self {
            air_c: 20.0,
            pressure_hpa: 1013.25,
            humidity_percent: 50.0,
            machine_c: 20.0,
        }
    }
}

/// Uncertainty of the expansion coefficient of a machine, per kelvin.
const EXPANSION: f64 = 2e-6;

/// Stream of the noise of the expansion coefficient.
const EXPANSION_STREAM: u64 = 900;

impl Environment {
    /// Change of the wavelength by the refractive index of the air, relative to the stated
    /// conditions: +0.93e-6 per kelvin, -0.27e-6 per hPa, +0.01e-6 per percent of humidity.
    #[must_use]
    pub fn wavelength_change(&self) -> f64 {
        let stated = Self::default();
        0.93e-6 * (self.air_c - stated.air_c) - 0.27e-6 * (self.pressure_hpa - stated.pressure_hpa)
            + 0.01e-6 * (self.humidity_percent - stated.humidity_percent)
    }

    /// Uncertainty that the expansion coefficient adds to a length, mm: 2 um per metre and kelvin
    /// from 20 degrees.
    #[must_use]
    pub fn expansion_uncertainty(&self, length_mm: f64) -> f64 {
        EXPANSION * length_mm * self.off_reference().abs()
    }

    /// Temperature of the machine less the 20 degrees at which lengths are stated, kelvin.
    #[must_use]
    pub fn off_reference(&self) -> f64 {
        self.machine_c - Self::default().machine_c
    }
}

/// Accuracy of the instruments as two standard deviations, and how they are used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaserOptions {
    /// Scale of the linear channel.
    pub linear: f64,
    /// Scale of the angle channel, and its reading, radians.
    pub angle: (f64, f64),
    /// Scale of the straightness channel, and its reading, mm.
    pub straightness: (f64, f64),
    /// Reading of the linear channel, mm: vibration and resolution.
    pub resolution: f64,
    /// Expansion coefficient by which lengths are corrected to 20 degrees, per kelvin.
    pub expansion: f64,
    /// Reading of the roll instrument, a photodiode with four quadrants on a second beam, radians;
    /// `None` without it.
    pub roll: Option<f64>,
    /// Reading of the square and its indicator, mm.
    pub square: f64,
    /// The sensors of the environment correct the wavelength.
    pub corrects_wavelength: bool,
    /// The environment.
    pub environment: Environment,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for LaserOptions {
    fn default() -> Self {
        Self {
            linear: 0.7e-6,
            angle: (0.006, 0.5e-6),
            straightness: (0.005, 0.5e-3),
            resolution: 0.05e-3,
            expansion: EXPANSION,
            roll: Some(1e-6),
            square: 0.2e-3,
            corrects_wavelength: true,
            environment: Environment::default(),
            seed: 1,
        }
    }
}

impl LaserOptions {
    /// Instruments without noise.
    #[must_use]
    pub fn ideal() -> Self {
        Self {
            linear: 0.0,
            angle: (0.0, 0.0),
            straightness: (0.0, 0.0),
            resolution: 0.0,
            expansion: 0.0,
            roll: Some(0.0),
            square: 0.0,
            ..Self::default()
        }
    }
}

/// A reading that an instrument cannot give.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoInstrument;

impl fmt::Display for NoInstrument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "a laser does not measure roll: a turn about its beam changes no path; use the roll \
             instrument, or take roll as 0",
        )
    }
}

impl core::error::Error for NoInstrument {}

/// The instruments in one set-up.
#[derive(Debug, Clone)]
pub struct Laser {
    options: LaserOptions,
    noise: Noise,
    /// Scale errors of the set-up: linear, straightness, angle.
    scales: [f64; 3],
    /// Scale error of lengths by the expansion coefficient.
    expansion: f64,
}

impl Laser {
    /// Instruments that are set up once; `set_up` distinguishes the set-ups of a seed.
    #[must_use]
    pub fn new(options: &LaserOptions, set_up: u64) -> Self {
        let mut noise = Noise::new(options.seed, 1000 + set_up);
        let deviations = [options.linear, options.straightness.0, options.angle.0];
        let coefficient =
            Noise::new(options.seed, EXPANSION_STREAM).normal(0.5 * options.expansion);
        Self {
            options: *options,
            scales: deviations.map(|two| noise.normal(0.5 * two)),
            expansion: coefficient * options.environment.off_reference(),
            noise,
        }
    }

    /// A reading of the true value; `path` is the travel of the reflector from its first target,
    /// mm, for the linear channel.
    ///
    /// # Errors
    /// Roll without its own instrument.
    pub fn read(&mut self, channel: Channel, truth: f64, path: f64) -> Result<f64, NoInstrument> {
        let [linear, straightness, angle] = self.scales;
        let options = self.options;
        Ok(match channel {
            Channel::Linear => {
                let air = if options.corrects_wavelength {
                    0.0
                } else {
                    // The display multiplies fringes with the stated wavelength.
                    -options.environment.wavelength_change()
                };
                let scale = linear + air + self.expansion;
                truth + path * scale + self.noise.normal(0.5 * options.resolution)
            }
            Channel::Straightness => {
                truth * (1.0 + straightness) + self.noise.normal(0.5 * options.straightness.1)
            }
            Channel::Angle => truth * (1.0 + angle) + self.noise.normal(0.5 * options.angle.1),
            Channel::Roll => {
                let deviation = options.roll.ok_or(NoInstrument)?;
                truth + self.noise.normal(0.5 * deviation)
            }
        })
    }

    /// A reading of the indicator at the square.
    pub fn read_square(&mut self, truth: f64) -> f64 {
        truth + self.noise.normal(0.5 * self.options.square)
    }
}
