//! A frame as a row of words, with its check at the end.

use super::FrameError;

/// Grows whenever a frame changes.
const VERSION: u32 = 5;

/// FNV-1a over words.
#[inline]
pub(super) fn check(words: &[u32]) -> u32 {
    words.iter().fold(BASIS, |hash, word| step(hash, *word))
}

const BASIS: u32 = 0x811C_9DC5;

const fn step(hash: u32, word: u32) -> u32 {
    (hash ^ word).wrapping_mul(0x0100_0193)
}

/// Puts the check, which is the last word, into a frame whose other words are there: for those who keep frames without it, as recordings do.
pub fn seal(frame: &mut [u8]) {
    let (words, _) = frame.as_chunks_mut::<4>();
    if let Some((last, words)) = words.split_last_mut() {
        let sum = words
            .iter()
            .fold(BASIS, |hash, word| step(hash, u32::from_le_bytes(*word)));
        *last = sum.to_le_bytes();
    }
}

/// A frame while it is written: its words, one after the other; those that are left are zeros. Beyond the end nothing is written.
pub(super) struct Writer<'a> {
    frame: &'a mut [u32],
    at: usize,
}

impl<'a> Writer<'a> {
    #[inline(always)]
    pub(super) fn begin(frame: &'a mut [u32]) -> Self {
        frame.fill(0);
        Self { frame, at: 0 }
    }

    #[inline(always)]
    pub(super) fn head(&mut self, kind: u32) {
        self.put(kind | VERSION << 16);
    }

    #[inline(always)]
    pub(super) fn put(&mut self, word: u32) {
        debug_assert!(self.at + 1 < self.frame.len(), "the frame is too short");
        if let Some(slot) = self.frame.get_mut(self.at) {
            *slot = word;
            self.at += 1;
        }
    }

    #[inline(always)]
    pub(super) fn put_long(&mut self, long: u64) {
        self.put(long as u32);
        self.put((long >> 32) as u32);
    }

    #[inline(always)]
    pub(super) fn put_row(&mut self, row: &[i32]) {
        let end = self.at + row.len();
        debug_assert!(end < self.frame.len(), "the frame is too short");
        if let Some(slots) = self.frame.get_mut(self.at..end) {
            for (slot, value) in slots.iter_mut().zip(row) {
                *slot = *value as u32;
            }
            self.at = end;
        }
    }
}

/// A frame while it is read, word by word; beyond the end are zeros.
pub(super) struct Reader<'a> {
    words: core::slice::Iter<'a, u32>,
}

impl<'a> Reader<'a> {
    /// The kind of a frame, and its contents.
    #[inline(always)]
    pub(super) fn begin(frame: &'a [u32]) -> Result<(u32, Self), FrameError> {
        let (last, words) = frame.split_last().ok_or(FrameError::Check)?;
        if check(words) != *last {
            return Err(FrameError::Check);
        }
        let mut reader = Self {
            words: words.iter(),
        };
        let head = reader.take();
        if head >> 16 != VERSION {
            return Err(FrameError::Version);
        }
        Ok((head & 0xFFFF, reader))
    }

    #[inline(always)]
    pub(super) fn take(&mut self) -> u32 {
        self.words.next().copied().unwrap_or(0)
    }

    #[inline(always)]
    pub(super) fn take_long(&mut self) -> u64 {
        u64::from(self.take()) | u64::from(self.take()) << 32
    }
}

pub(super) fn to_bytes<const N: usize, const B: usize>(words: &[u32; N]) -> [u8; B] {
    const { assert!(B == 4 * N) };
    let mut bytes = [0; B];
    for (cell, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *cell = word.to_le_bytes();
    }
    bytes
}

pub(super) fn from_bytes<const N: usize, const B: usize>(bytes: &[u8; B]) -> [u32; N] {
    const { assert!(B == 4 * N) };
    let mut words = [0; N];
    for (word, cell) in words.iter_mut().zip(bytes.as_chunks::<4>().0) {
        *word = u32::from_le_bytes(*cell);
    }
    words
}
