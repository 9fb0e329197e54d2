//! PIL framing: a frame as an array of words, with a check word at the end.

use super::FrameError;
use haptimill_protocol::message::MAX_AXES;

/// Version of the frames; each change of a frame increments it.
const VERSION: u32 = 6;

/// FNV-1a over words.
///
/// Unrolled to eight words: the counter of a plain loop takes longer than the hash.
#[inline(always)]
pub(super) fn check(words: &[u32]) -> u32 {
    let (rows, rest) = words.as_chunks::<8>();
    let hash = rows.iter().fold(BASIS, |hash, row| {
        let [a, b, c, d, e, f, g, h] = *row;
        let hash = step(step(step(step(hash, a), b), c), d);
        step(step(step(step(hash, e), f), g), h)
    });
    rest.iter().fold(hash, |hash, word| step(hash, *word))
}

const BASIS: u32 = 0x811C_9DC5;

const fn step(hash: u32, word: u32) -> u32 {
    (hash ^ word).wrapping_mul(0x0100_0193)
}

/// Writes the check, which is the last word, into a frame whose other words are complete.
/// Recordings keep frames without the check.
pub fn seal(frame: &mut [u8]) {
    let (words, _) = frame.as_chunks_mut::<4>();
    if let Some((last, words)) = words.split_last_mut() {
        let sum = words
            .iter()
            .fold(BASIS, |hash, word| step(hash, u32::from_le_bytes(*word)));
        *last = sum.to_le_bytes();
    }
}

/// Writer of a frame without its last word. It drops words beyond the end.
///
/// Writing several words at once checks the remaining room only once.
pub(super) struct Writer<'a> {
    left: &'a mut [u32],
}

impl<'a> Writer<'a> {
    #[inline(always)]
    pub(super) fn begin(frame: &'a mut [u32]) -> Self {
        let left = match frame.split_last_mut() {
            Some((_, words)) => words,
            None => &mut [],
        };
        Self { left }
    }

    #[inline(always)]
    pub(super) fn head(&mut self, kind: u32) {
        self.put(kind | VERSION << 16);
    }

    #[inline(always)]
    pub(super) fn put(&mut self, word: u32) {
        self.put_all([word]);
    }

    #[inline(always)]
    pub(super) fn put_long(&mut self, long: u64) {
        self.put_all([long as u32, (long >> 32) as u32]);
    }

    /// Writes a value of each axis. Unrolled: the counter of a loop takes longer than the work.
    #[inline(always)]
    pub(super) fn put_axes(&mut self, row: &[i32; MAX_AXES]) {
        let [a, b, c, d, e, f] = *row;
        self.put_all([a as u32, b as u32, c as u32, d as u32, e as u32, f as u32]);
    }

    /// Writes a value along each of x, y and z.
    #[inline(always)]
    pub(super) fn put_vector(&mut self, vector: &[i32; 3]) {
        let [x, y, z] = *vector;
        self.put_all([x as u32, y as u32, z as u32]);
    }

    #[inline(always)]
    pub(super) fn put_all<const N: usize>(&mut self, words: [u32; N]) {
        if let Some(slots) = self.room::<N>() {
            *slots = words;
        }
    }

    #[inline(always)]
    fn room<const N: usize>(&mut self) -> Option<&mut [u32; N]> {
        let left = core::mem::take(&mut self.left);
        debug_assert!(left.len() >= N, "the frame is too short");
        let (slots, rest) = left.split_first_chunk_mut()?;
        self.left = rest;
        Some(slots)
    }

    /// Fills the remaining words with zeros.
    #[inline(always)]
    pub(super) fn end(self) {
        self.left.fill(0);
    }
}

/// Reader of a frame, word by word. It returns zeros beyond the end.
pub(super) struct Reader<'a> {
    left: &'a [u32],
}

impl<'a> Reader<'a> {
    /// Verifies check and version of a frame; returns its kind and a reader of its contents.
    #[inline(always)]
    pub(super) fn begin(frame: &'a [u32]) -> Result<(u32, Self), FrameError> {
        let (last, words) = frame.split_last().ok_or(FrameError::Check)?;
        if check(words) != *last {
            return Err(FrameError::Check);
        }
        let mut reader = Self { left: words };
        let head = reader.take();
        if head >> 16 != VERSION {
            return Err(FrameError::Version);
        }
        Ok((head & 0xFFFF, reader))
    }

    #[inline(always)]
    pub(super) fn take(&mut self) -> u32 {
        let [word] = self.take_all();
        word
    }

    #[inline(always)]
    pub(super) fn take_long(&mut self) -> u64 {
        let [low, high] = self.take_all();
        u64::from(low) | u64::from(high) << 32
    }

    #[inline(always)]
    pub(super) fn take_row<const N: usize>(&mut self) -> [i32; N] {
        self.take_all().map(|word| word as i32)
    }

    #[inline(always)]
    pub(super) fn take_all<const N: usize>(&mut self) -> [u32; N] {
        match self.left.split_first_chunk() {
            Some((words, rest)) => {
                self.left = rest;
                *words
            }
            None => [0; N],
        }
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
