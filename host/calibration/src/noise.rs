//! Noise of instruments: normal, seeded.

use haptimill_hil_sim::random::Random;

/// A source of noise.
#[derive(Debug, Clone)]
pub struct Noise(Random);

impl Noise {
    /// The stream `stream` of a seed.
    #[must_use]
    pub const fn new(seed: u64, stream: u64) -> Self {
        Self(Random::new(seed, stream))
    }

    /// A normal number with mean 0 and this standard deviation (Box, Muller 1958).
    pub fn normal(&mut self, deviation: f64) -> f64 {
        let radius = (-2.0 * (1.0 - self.0.fraction()).ln()).sqrt();
        deviation * radius * (core::f64::consts::TAU * self.0.fraction()).cos()
    }

    /// Uniform between -1 and 1.
    pub const fn uniform(&mut self) -> f64 {
        2.0 * self.0.fraction() - 1.0
    }
}
