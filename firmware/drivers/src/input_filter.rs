//! Noise filter of digital inputs, with counters: a level counts when it was seen a number of times
//! in a row.

/// Filter of 32 inputs.
#[derive(Debug, Clone)]
pub struct InputFilter {
    /// Samples in a row that a new level needs.
    samples: u8,
    levels: u32,
    /// Samples in a row of the level that differs.
    seen: [u8; 32],
    /// Changes that did not last, per input.
    glitches: [u16; 32],
}

impl InputFilter {
    /// A filter that takes a level after `samples` equal samples, at least 1, and starts with these
    /// levels.
    #[must_use]
    pub const fn new(samples: u8, levels: u32) -> Self {
        Self {
            samples: if samples == 0 { 1 } else { samples },
            levels,
            seen: [0; 32],
            glitches: [0; 32],
        }
    }

    /// Adds a sample of all inputs; returns the filtered levels.
    pub fn add(&mut self, sample: u32) -> u32 {
        let differing = sample ^ self.levels;
        for (input, seen) in self.seen.iter_mut().enumerate() {
            if differing >> input & 1 != 0 {
                *seen += 1;
                if *seen >= self.samples {
                    self.levels ^= 1 << input;
                    *seen = 0;
                }
            } else if *seen > 0 {
                *seen = 0;
                self.glitches[input] = self.glitches[input].saturating_add(1);
            }
        }
        self.levels
    }

    /// Filtered levels.
    #[must_use]
    pub const fn levels(&self) -> u32 {
        self.levels
    }

    /// Number of changes of an input that did not last, at most 65535; 0 for an input that does not
    /// exist.
    #[must_use]
    pub fn glitches(&self, input: usize) -> u16 {
        self.glitches.get(input).copied().unwrap_or(0)
    }
}
