//! Is what was configured still what it was? A digest over everything that a configuration says and everything that was worked out from it.
//!
//! A stray write or a flipped bit in a gain, a limit or a reciprocal would move the machine wrongly and look like nothing at all. So each part has a
//! digest from the moment of its activation, and one part after the other is digested again while the machine runs.
//!
//! The digest is FNV-1a over 32-bit words. Each of its steps is a bijection of the sum so far, and another word gives another sum, so a change within
//! one word is always found; changes in several words are missed once in 2^32.
//!
//! Misuse: it is for values that stay as they are. What changes while the machine runs (a position, a sum, a queue) is not to be put into it; a type that
//! has both names its fields in `constants!`, so that a new field does not compile until someone has decided which of the two it is.

use core::hash::{Hash, Hasher};

/// A sum over words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Digest(u32);

impl Digest {
    /// The digest of one value.
    #[must_use]
    pub fn of(value: &impl Hash) -> Self {
        let mut digest = Self::default();
        digest.add(value);
        digest
    }

    /// Adds a value, all of which is constant.
    #[inline]
    pub fn add(&mut self, value: &impl Hash) {
        value.hash(self);
    }

    const fn word(&mut self, word: u32) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0100_0193);
    }
}

impl Default for Digest {
    fn default() -> Self {
        Self(0x811C_9DC5)
    }
}

impl Hasher for Digest {
    fn finish(&self) -> u64 {
        u64::from(self.0)
    }

    fn write(&mut self, bytes: &[u8]) {
        // Arrays of numbers come as bytes: four of them a word.
        let (words, rest) = bytes.as_chunks();
        words
            .iter()
            .for_each(|word| self.word(u32::from_le_bytes(*word)));
        rest.iter().for_each(|&byte| self.word(u32::from(byte)));
    }

    fn write_u8(&mut self, value: u8) {
        self.word(u32::from(value));
    }

    fn write_u16(&mut self, value: u16) {
        self.word(u32::from(value));
    }

    fn write_u32(&mut self, value: u32) {
        self.word(value);
    }

    fn write_u64(&mut self, value: u64) {
        self.word(value as u32);
        self.word((value >> 32) as u32);
    }

    fn write_usize(&mut self, value: usize) {
        self.write_u64(value as u64);
    }
}

/// A part that was worked out from the configuration.
pub trait Constants {
    /// Adds what stays as it was made.
    fn digest(&self, digest: &mut Digest);
}

/// [`Constants`] of a structure: fields that stay as they were made, fields that have constants of their own, and fields that change.
macro_rules! constants {
    ($type:ty { $($constant:ident),* } of { $($part:ident),* } but { $($changing:ident),* }) => {
        impl crate::config::digest::Constants for $type {
            fn digest(&self, digest: &mut crate::config::digest::Digest) {
                let Self { $($constant,)* $($part,)* $($changing: _,)* } = self;
                $(digest.add($constant);)*
                $(crate::config::digest::Constants::digest($part, digest);)*
            }
        }
    };
}
pub(crate) use constants;

#[cfg(test)]
mod tests {
    use super::Digest;
    use proptest::prelude::*;

    proptest! {
        /// A change within one word is always found, wherever it is.
        #[test]
        fn one_word(words in prop::collection::vec(any::<u32>(), 1..40), place: prop::sample::Index, other: u32) {
            let mut changed = words.clone();
            let place = place.index(words.len());
            changed[place] = other;
            prop_assert_eq!(Digest::of(&words) == Digest::of(&changed), words == changed);
        }
    }
}
