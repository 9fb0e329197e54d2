//! I/O log: all inputs and outputs of a controller since power on, in some thirty bytes per period.
//! Recordings store it and replays read it.
//!
//! A period is the two frames of the plant link that carry it ([`haptimill_firmware::pil`]: inputs
//! and outputs), followed by the raw bytes of the serial line. The log therefore holds all fields
//! of the frames. It stores only the words of the frames that differ from their prediction. The
//! prediction is the last value or, if the last two changes were equal, the last value plus that
//! change. Clocks and counters with a constant rate need no bytes.
//!
//! A word that differs from its prediction is stored as a byte and a difference. The lower five
//! bits of the byte count the predicted words before it; the upper three give the format of the
//! difference:
//!
//! | | |
//! | --- | --- |
//! | 0, 1, 5, 6 | i8, i16, i24, i32 |
//! | 2, 3 | i8, i16, times 65536: the upper half of a word |
//! | 4 | i8 and i8: the lower and the upper half separately |
//! | 7 | no word: lower bits 0 end the frames, lower bits 1 skip the next 31 words |
//!
//! Predictions restart with every block, so each block can be decoded alone.
//!
//! Callers must start a log with the first period of its controller. A replay cannot reconstruct
//! earlier periods.

use haptimill_firmware::io::{Inputs, Outputs, RECEIVE_BYTES, TRANSMIT_BYTES};
use haptimill_firmware::pil::{
    Done, FROM_BOARD_BYTES, FromBoard, LineInputs, TO_BOARD_BYTES, ToBoard, seal,
};

/// Words of the frame to the board, without its check.
const TO: usize = TO_BOARD_BYTES / 4 - 1;
const FROM: usize = FROM_BOARD_BYTES / 4 - 1;
const WORDS: usize = TO + FROM;

/// Words per row; a row is compared at once.
const ROW: usize = 8;
/// Number of rows. The words beyond the frames are always 0.
const ROWS: usize = WORDS.div_ceil(ROW);
type Words = [[u32; ROW]; ROWS];

/// Upper bound of the bytes for the words of a period: a byte and a difference of four for each,
/// and the end.
const MAX_BYTES: usize = 5 * WORDS + 1;

/// Periods per block.
const BLOCK_PERIODS: u32 = 2048;

/// Upper bound of the bytes that a log holds in memory: minutes of a moving machine, half an hour
/// of one at standstill.
const MAX_KEPT: usize = 1 << 26;

/// Code for the end of the frames.
const END: u8 = 7 << 5;
/// Code that skips words.
const PASS: u8 = END | 1;
/// Number of words that [`PASS`] skips; a word's own byte skips at most one less.
const PASSED: usize = 31;

/// A control period: inputs and outputs of the controller.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Period {
    /// Inputs of the controller.
    pub inputs: Inputs,
    /// Outputs of the controller.
    pub outputs: Outputs,
}

/// A complete block of periods.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LogBlock {
    /// Number of periods.
    pub count: u32,
    /// Encoded periods.
    pub bytes: Vec<u8>,
}

/// Records the periods of a controller, from its first one.
#[derive(Debug)]
pub struct IoLog {
    expected: Expected,
    block: LogBlock,
    /// Complete blocks that have not been taken.
    kept: Vec<LogBlock>,
    kept_bytes: usize,
    full: bool,
}

impl Default for IoLog {
    fn default() -> Self {
        Self::new()
    }
}

impl IoLog {
    /// Creates an empty log.
    #[must_use]
    pub fn new() -> Self {
        Self {
            expected: Expected::new(),
            block: LogBlock::default(),
            kept: Vec::new(),
            kept_bytes: 0,
            full: false,
        }
    }

    /// Adds a period.
    pub fn add(&mut self, inputs: &Inputs, outputs: &Outputs) {
        if self.full {
            return;
        }
        self.expected
            .encode(&mut self.block.bytes, &words(inputs, outputs));
        self.block.bytes.extend_from_slice(&inputs.received);
        self.block.bytes.extend_from_slice(&outputs.transmit);
        self.block.count += 1;
        if self.block.count == BLOCK_PERIODS {
            self.close();
        }
    }

    /// Takes the blocks completed since the last call.
    pub fn take(&mut self) -> std::vec::Drain<'_, LogBlock> {
        self.kept_bytes = 0;
        self.kept.drain(..)
    }

    /// Completes the block in progress, so that it can be taken.
    pub fn close(&mut self) {
        if self.block.count == 0 {
            return;
        }
        let room = self.block.bytes.len();
        let next = LogBlock {
            count: 0,
            bytes: Vec::with_capacity(room + room / 8),
        };
        let block = std::mem::replace(&mut self.block, next);
        self.kept_bytes += block.bytes.len();
        self.kept.push(block);
        self.expected = Expected::new();
        if self.kept_bytes > MAX_KEPT {
            // The machine has been on for hours without a job. A replay of that time is not needed,
            // and the memory is.
            *self = Self {
                full: true,
                ..Self::new()
            };
        }
    }

    /// Returns whether the log holds all periods since its first.
    #[must_use]
    pub const fn is_whole(&self) -> bool {
        !self.full
    }
}

/// The words of both frames.
fn words(inputs: &Inputs, outputs: &Outputs) -> Words {
    let to = ToBoard::Period {
        inputs: inputs.clone(),
        arrived: 0,
    };
    let from = FromBoard::Done(Done {
        period: inputs.period,
        outputs: outputs.clone(),
        transmitted: outputs.transmit.len() as u16,
        line_inputs: LineInputs::of(inputs),
        ..Done::default()
    });
    let mut words = [[0; ROW]; ROWS];
    let (first, second) = words.as_flattened_mut().split_at_mut(TO);
    fill(first, &to.encode_unsealed());
    fill(second, &from.encode_unsealed());
    words
}

/// Fills in the words of a frame, without its check, which is the last word.
fn fill(words: &mut [u32], frame: &[u8]) {
    for (word, bytes) in words
        .iter_mut()
        .zip(&frame.as_chunks::<4>().0[..frame.len() / 4 - 1])
    {
        *word = u32::from_le_bytes(*bytes);
    }
}

/// Prediction of the words.
#[derive(Debug, Clone)]
struct Expected {
    last: Words,
    change: Words,
    next: Words,
}

impl Expected {
    const fn new() -> Self {
        Self {
            last: [[0; ROW]; ROWS],
            change: [[0; ROW]; ROWS],
            next: [[0; ROW]; ROWS],
        }
    }

    fn learn(&mut self, words: &Words) {
        let last = self.last.as_flattened_mut().iter_mut();
        let change = self.change.as_flattened_mut().iter_mut();
        let next = self.next.as_flattened_mut().iter_mut();
        for (word, (last, (change, next))) in
            words.as_flattened().iter().zip(last.zip(change.zip(next)))
        {
            let now = word.wrapping_sub(*last);
            let again = if now == *change { now } else { 0 };
            *next = word.wrapping_add(again);
            (*last, *change) = (*word, now);
        }
    }

    fn encode(&mut self, bytes: &mut Vec<u8>, words: &Words) {
        let mut coded = Coded::new();
        let mut from = 0;
        // Most rows equal their prediction.
        for (row, (words, next)) in words.iter().zip(&self.next).enumerate() {
            let unlike = words
                .iter()
                .zip(next)
                .fold(0, |unlike, (word, next)| unlike | (word ^ next));
            if unlike == 0 {
                continue;
            }
            for (place, (word, next)) in words.iter().zip(next).enumerate() {
                if word == next {
                    continue;
                }
                let index = row * ROW + place;
                let mut passed = index - from;
                while passed >= PASSED {
                    coded.put(PASS, 0, 0);
                    passed -= PASSED;
                }
                coded.put_difference(passed as u8, word.wrapping_sub(*next));
                from = index + 1;
            }
        }
        coded.put(END, 0, 0);
        bytes.extend_from_slice(coded.bytes());
        self.learn(words);
    }

    /// Decodes the words of a period; `None` when the bytes are truncated or invalid.
    fn decode(&mut self, bytes: &mut &[u8]) -> Option<Words> {
        let mut words = self.next;
        let mut index = 0_usize;
        loop {
            let head = take(bytes, 1)?[0];
            if head == END {
                break;
            }
            if head == PASS {
                index += PASSED;
                continue;
            }
            index += usize::from(head & 31);
            let word = words.as_flattened_mut().get_mut(index)?;
            *word = word.wrapping_add(difference(bytes, head >> 5)?);
            index += 1;
        }
        self.learn(&words);
        Some(words)
    }
}

/// Encoded words of a period.
struct Coded {
    bytes: [u8; MAX_BYTES + 4],
    at: usize,
}

impl Coded {
    const fn new() -> Self {
        Self {
            bytes: [0; MAX_BYTES + 4],
            at: 0,
        }
    }

    /// Appends a byte and the lowest `count` bytes of `content`. It writes all four bytes; the next
    /// call overwrites the surplus.
    fn put(&mut self, head: u8, content: u32, count: usize) {
        let slot = self.bytes.get_mut(self.at..self.at + 5);
        if let Some(slot) = slot {
            slot[0] = head;
            slot[1..].copy_from_slice(&content.to_le_bytes());
            self.at += 1 + count;
        }
    }

    fn put_difference(&mut self, passed: u8, difference: u32) {
        let signed = difference as i32;
        let (low, high) = (difference as u16 as i16, (difference >> 16) as i16);
        let small = |half: i16| i8::try_from(half).is_ok();
        let (kind, content, count) = if i8::try_from(signed).is_ok() {
            (0, difference, 1)
        } else if low == 0 && small(high) {
            (2, difference >> 16, 1)
        } else if i16::try_from(signed).is_ok() {
            (1, difference, 2)
        } else if low == 0 {
            (3, difference >> 16, 2)
        } else if small(low) && small(high) {
            (4, difference & 0xFF | difference >> 16 << 8, 2)
        } else if (-(1 << 23)..1 << 23).contains(&signed) {
            (5, difference, 3)
        } else {
            (6, difference, 4)
        };
        self.put(kind << 5 | passed, content, count);
    }

    fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.at).unwrap_or_default()
    }
}

fn difference(bytes: &mut &[u8], kind: u8) -> Option<u32> {
    let byte = |value: u8| i32::from(value as i8) as u32;
    Some(match kind {
        0 => byte(take(bytes, 1)?[0]),
        2 => byte(take(bytes, 1)?[0]) << 16,
        4 => {
            let halves = take(bytes, 2)?;
            byte(halves[0]) & 0xFFFF | byte(halves[1]) << 16
        }
        1 | 3 => {
            let half = take(bytes, 2)?;
            let value = i32::from(i16::from_le_bytes([half[0], half[1]])) as u32;
            if kind == 1 { value } else { value << 16 }
        }
        5 => {
            let three = take(bytes, 3)?;
            byte(three[2]) << 16 | u32::from(three[1]) << 8 | u32::from(three[0])
        }
        6 => {
            let four = take(bytes, 4)?;
            u32::from_le_bytes([four[0], four[1], four[2], four[3]])
        }
        _ => return None,
    })
}

fn take<'a>(bytes: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, rest) = bytes.split_at_checked(count)?;
    *bytes = rest;
    Some(taken)
}

/// Decodes the periods of a block. An error is the number of bytes decoded before it: the block has
/// a different format.
#[derive(Debug)]
pub struct IoLogDecoder {
    expected: Expected,
    bytes: Vec<u8>,
    at: usize,
    left: u32,
}

impl IoLogDecoder {
    /// Decodes a block of `count` periods.
    #[must_use]
    pub fn new(count: u32, bytes: Vec<u8>) -> Self {
        Self {
            expected: Expected::new(),
            bytes,
            at: 0,
            left: count,
        }
    }

    fn fail(&mut self) -> Option<Result<Period, usize>> {
        let at = self.at;
        (self.left, self.at) = (0, self.bytes.len());
        Some(Err(at))
    }
}

impl Iterator for IoLogDecoder {
    type Item = Result<Period, usize>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.left == 0 {
            // Bytes after the last period are an error.
            return if self.at == self.bytes.len() {
                None
            } else {
                self.fail()
            };
        }
        self.left -= 1;
        let mut rest = &self.bytes[self.at..];
        let words = self.expected.decode(&mut rest);
        match words.and_then(|words| period(&words, &mut rest)) {
            Some(period) => {
                self.at = self.bytes.len() - rest.len();
                Some(Ok(period))
            }
            None => self.fail(),
        }
    }
}

/// Decodes a period from its frames and the bytes of the line after them.
fn period(words: &Words, bytes: &mut &[u8]) -> Option<Period> {
    let (to, from) = words.as_flattened()[..WORDS].split_at(TO);
    let ToBoard::Period { mut inputs, .. } = ToBoard::decode(&frame(to)).ok()? else {
        return None;
    };
    let FromBoard::Done(done) = FromBoard::decode(&frame(from)).ok()? else {
        return None;
    };
    let (line_inputs, mut outputs) = (done.line_inputs, done.outputs);
    inputs.waiting = line_inputs.waiting;
    inputs.lost_bytes = line_inputs.lost_bytes;
    inputs.out_of_band_stop = line_inputs.out_of_band_stop;
    let (received, transmitted) = (
        usize::from(line_inputs.received),
        usize::from(done.transmitted),
    );
    if received > RECEIVE_BYTES || transmitted > TRANSMIT_BYTES || done.period != inputs.period {
        return None;
    }
    inputs
        .received
        .extend_from_slice(take(bytes, received)?)
        .ok()?;
    outputs
        .transmit
        .extend_from_slice(take(bytes, transmitted)?)
        .ok()?;
    Some(Period { inputs, outputs })
}

/// Builds a frame from its words.
fn frame<const B: usize>(words: &[u32]) -> [u8; B] {
    let mut frame = [0; B];
    for (bytes, word) in frame.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *bytes = word.to_le_bytes();
    }
    seal(&mut frame);
    frame
}
