//! Seeded random numbers, the only ones in the simulator.
//!
//! SplitMix64 (Steele, Lea, Flood 2014), not suitable for secrets. Each device draws from its own
//! stream, so a fault of one device does not change the numbers of another.

/// A stream of pseudo-random numbers.
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// Creates the stream `stream` of a seed; each device has its own stream number.
    pub const fn new(seed: u64, stream: u64) -> Self {
        let mut random = Self(seed ^ stream.wrapping_mul(0xd1b5_4a32_d192_ed03));
        // Two draws separate the streams of neighbouring seeds.
        random.draw();
        random.draw();
        random
    }

    /// 64 random bits.
    pub const fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    }

    /// Uniform in 0 (included) to 1 (excluded), 53 bits.
    pub const fn fraction(&mut self) -> f64 {
        (self.draw() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Returns true with this probability.
    pub const fn happens(&mut self, probability: f64) -> bool {
        self.fraction() < probability
    }
}
