//! A serial line with faults for tests: seeded, in virtual time, byte by byte.

use std::collections::VecDeque;

/// A random generator with a seed (SplitMix64, Steele, Lea and Flood 2014).
pub struct Random(u64);

impl Random {
    /// Creates the generator of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Returns true with a probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        ((self.bits() >> 11) as f64) < probability * (1u64 << 53) as f64
    }

    /// Returns a number below another.
    pub fn below(&mut self, bound: usize) -> usize {
        (self.bits() % bound.max(1) as u64) as usize
    }
}

/// The faults of a line.
#[derive(Debug, Clone, Copy, Default)]
pub struct Faults {
    /// Probability that a bit is flipped.
    pub bit_error: f64,
    /// Probability that a byte is lost.
    pub byte_loss: f64,
    /// Probability of each: a frame is lost, sent twice, overtaken by the next one, or cut off.
    pub frame: f64,
}

/// One direction of a line.
pub struct Line {
    random: Random,
    faults: Faults,
    /// Time of a byte on the line, nanoseconds; 0 for none.
    byte_ns: u64,
    /// Bytes of the frame that arrives from the sender.
    frame: Vec<u8>,
    /// A frame that the next one overtakes.
    held: Option<Vec<u8>>,
    /// Bytes on the line and their times of arrival, nanoseconds.
    way: VecDeque<(u64, u8)>,
    free_ns: u64,
    /// Number of bytes that were sent.
    pub carried: usize,
}

impl Line {
    /// Creates a line of this many bytes per second; 0 for one without delay.
    pub fn new(seed: u64, bytes_per_second: u64, faults: Faults) -> Self {
        Self {
            random: Random::new(seed),
            faults,
            byte_ns: 1_000_000_000u64.checked_div(bytes_per_second).unwrap_or(0),
            frame: Vec::new(),
            held: None,
            way: VecDeque::new(),
            free_ns: 0,
            carried: 0,
        }
    }

    /// Puts bytes on the line.
    pub fn send(&mut self, now_us: u64, bytes: &[u8]) {
        self.carried += bytes.len();
        if self.faults.frame == 0.0 {
            // Without faults of whole frames bytes need not wait for the end of theirs.
            self.put(now_us, bytes);
            return;
        }
        for &byte in bytes {
            self.frame.push(byte);
            if byte == 0 {
                let frame = std::mem::take(&mut self.frame);
                self.frame_ends(now_us, frame);
            }
        }
    }

    fn frame_ends(&mut self, now_us: u64, mut frame: Vec<u8>) {
        let rate = self.faults.frame;
        if self.random.chance(rate) {
            return;
        }
        if self.random.chance(rate) {
            let length = self.random.below(frame.len());
            frame.truncate(length);
        }
        if self.held.is_none() && self.random.chance(rate) {
            self.held = Some(frame);
            return;
        }
        self.put(now_us, &frame);
        if self.random.chance(rate) {
            self.put(now_us, &frame);
        }
        if let Some(held) = self.held.take() {
            self.put(now_us, &held);
        }
    }

    fn put(&mut self, now_us: u64, bytes: &[u8]) {
        for &byte in bytes {
            self.free_ns = self.free_ns.max(now_us * 1000) + self.byte_ns;
            if self.random.chance(self.faults.byte_loss) {
                continue;
            }
            let mut byte = byte;
            if self.faults.bit_error > 0.0 {
                for bit in 0..8 {
                    byte ^= u8::from(self.random.chance(self.faults.bit_error)) << bit;
                }
            }
            self.way.push_back((self.free_ns, byte));
        }
    }

    /// Returns the bytes that have arrived, up to a limit.
    pub fn take(&mut self, now_us: u64, max: usize) -> Vec<u8> {
        let ready = self
            .way
            .iter()
            .take(max)
            .take_while(|(at, _)| *at <= now_us * 1000)
            .count();
        self.way.drain(..ready).map(|(_, byte)| byte).collect()
    }
}
