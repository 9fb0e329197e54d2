//! The random source of the fuzz test.

use haptimill_hil_sim::random::Random;

/// Random numbers of a stream of a seed.
#[derive(Debug, Clone)]
pub struct Rng(Random);

impl Rng {
    /// Creates the stream of a seed.
    #[must_use]
    pub const fn new(seed: u64, stream: u64) -> Self {
        Self(Random::new(seed, stream))
    }

    /// Returns 64 random bits.
    pub const fn bits(&mut self) -> u64 {
        self.0.draw()
    }

    /// Returns an integer from 0 to below `count`.
    pub const fn below(&mut self, count: u64) -> u64 {
        self.0.draw() % count
    }

    /// Returns an index of a list of `count` elements.
    pub const fn index(&mut self, count: usize) -> usize {
        (self.0.draw() % count as u64) as usize
    }

    /// Returns a number, uniformly distributed.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.fraction()
    }

    /// Returns a positive number with a uniformly distributed logarithm.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0.fraction())
    }

    /// Returns true with a probability.
    pub const fn chance(&mut self, probability: f64) -> bool {
        self.0.happens(probability)
    }

    /// Returns an element of a list.
    pub fn choose<T: Clone>(&mut self, list: &[T]) -> T {
        list[self.index(list.len())].clone()
    }
}
