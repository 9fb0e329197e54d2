//! Integrity check of the configuration: a digest over all its values and all values derived from
//! it.
//!
//! A stray write or a flipped bit in a gain, a limit or a reciprocal would move the machine wrongly
//! without any other sign. Each part therefore gets a digest at its activation, and the controller
//! digests one part after the other again while the machine runs.
//!
//! The digest is FNV-1a over 32-bit words. Each step is a bijection of the hash so far, and
//! different words give different results. A change within one word is therefore always found;
//! changes in several words are missed once in 2^32.
//!
//! Callers must add only values that stay constant after activation, and no position, sum or queue.
//! A type with both kinds lists all its fields in `impl_digest!`, so a new field does not compile
//! until it has a kind.

use core::hash::{Hash, Hasher};

/// FNV-1a hash over words.
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

    /// Adds a value that is constant as a whole.
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
        // Arrays of numbers arrive as bytes: four of them are a word.
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

/// Values derived from the configuration.
pub trait Constants {
    /// Adds the constant values to a digest.
    fn digest(&self, digest: &mut Digest);
}

/// Implements [`Constants`] for a structure. The three lists are the constant fields, the fields
/// that implement [`Constants`] themselves, and the fields that change.
macro_rules! impl_digest {
    ($type:ty { fields { $($constant:ident),* }, nested { $($part:ident),* }, skip { $($changing:ident),* } }) => {
        impl crate::digest::Constants for $type {
            fn digest(&self, digest: &mut crate::digest::Digest) {
                let Self { $($constant,)* $($part,)* $($changing: _,)* } = self;
                $(digest.add($constant);)*
                $(crate::digest::Constants::digest($part, digest);)*
            }
        }
    };
}
pub(crate) use impl_digest;

#[cfg(test)]
mod tests {
    use super::Digest;
    use proptest::prelude::*;

    proptest! {
        /// A change within one word is always found, at any position.
        #[test]
        fn one_word(words in prop::collection::vec(any::<u32>(), 1..40), place: prop::sample::Index, other: u32) {
            let mut changed = words.clone();
            let place = place.index(words.len());
            changed[place] = other;
            prop_assert_eq!(Digest::of(&words) == Digest::of(&changed), words == changed);
        }
    }
}
