//! Noise filter of digital inputs, with counters: a level counts when it was seen a number of times
//! in a row.

/// Filter of 32 inputs.
#[derive(Debug, Clone)]
pub struct InputFilter {
    /// Samples in a row that a new level needs.
    samples: u8,
    levels: u32,
    /// Inputs whose level differs from that of before.
    changing: u32,
    /// Samples in a row of the level that differs.
    seen: [u8; 32],
    /// Changes that did not last, per input.
    glitches: [u16; 32],
    all_glitches: u32,
}

impl InputFilter {
    /// A filter that takes a level after `samples` equal samples, at least 1, and starts with these
    /// levels.
    #[must_use]
    pub const fn new(samples: u8, levels: u32) -> Self {
        Self {
            samples: if samples == 0 { 1 } else { samples },
            levels,
            changing: 0,
            seen: [0; 32],
            glitches: [0; 32],
            all_glitches: 0,
        }
    }

    /// Adds a sample of all inputs; returns the filtered levels. Its time grows with the number of
    /// inputs that change.
    pub fn add(&mut self, sample: u32) -> u32 {
        let differing = sample ^ self.levels;
        let mut left = differing | self.changing;
        while left != 0 {
            let input = left.trailing_zeros() as usize;
            let bit = 1 << input;
            left &= !bit;
            if differing & bit == 0 {
                self.changing &= !bit;
                self.seen[input] = 0;
                self.glitches[input] = self.glitches[input].saturating_add(1);
                self.all_glitches = self.all_glitches.saturating_add(1);
                continue;
            }
            self.seen[input] += 1;
            self.changing |= bit;
            if self.seen[input] >= self.samples {
                self.levels ^= bit;
                self.changing &= !bit;
                self.seen[input] = 0;
            }
        }
        self.levels
    }

    /// Number of changes of all inputs that did not last.
    #[must_use]
    pub const fn all_glitches(&self) -> u32 {
        self.all_glitches
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
