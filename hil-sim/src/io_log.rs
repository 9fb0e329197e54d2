//! All that a controller sensed and said, from its power-on, in some thirty bytes a period: what a recording keeps, and a replay needs.
//!
//! A period is the two frames of the plant link that carry it ([`haptimill_firmware::pil`]: what is sensed, and what is to be done), so that what they
//! know this knows, and then the bytes of the serial line as they are. Of the frames only those words are kept that are not what was expected. Expected is
//! what stood there last; or, if the last two changes were equal, that change once more: clocks and counters that run evenly cost nothing.
//!
//! A word that is not as expected is a byte, whose lower five bits say how many expected ones are passed before it, and the difference as the upper three
//! say:
//!
//! | | |
//! | --- | --- |
//! | 0, 1, 5, 6 | i8, i16, i24, i32 |
//! | 2, 3 | i8, i16, times 65536: the upper half of a word |
//! | 4 | i8 and i8: the lower and the upper half, each by itself |
//! | 7 | no word: with 0 in the lower bits the frames end, with 1 the next 31 words are passed |
//!
//! Expectations begin anew with every block, so that each can be read by itself.
//!
//! Misuse: the first period of a tape must be the first of its controller. Whatever came before is not in it, and no replay can know it.

use haptimill_firmware::io::{Inputs, Outputs, RECEIVE_BYTES, TRANSMIT_BYTES};
use haptimill_firmware::pil::{
    Done, FROM_BOARD_BYTES, FromBoard, Heard, TO_BOARD_BYTES, ToBoard, seal,
};

/// Words of the two frames, their checks left out.
const TO: usize = TO_BOARD_BYTES / 4 - 1;
const FROM: usize = FROM_BOARD_BYTES / 4 - 1;
const WORDS: usize = TO + FROM;

/// Words that are compared at once.
const ROW: usize = 8;
/// The words in whole rows; those at the end are always 0.
const ROWS: usize = WORDS.div_ceil(ROW);
type Words = [[u32; ROW]; ROWS];

/// The most bytes that the words of a period can take: a byte and a difference of four for each, and the end.
const MOST_BYTES: usize = 5 * WORDS + 1;

/// Periods in a block.
const BLOCK_PERIODS: u32 = 2048;

/// Bytes that a tape keeps before there is a file for them: minutes of a machine that moves, half an hour of one that stands.
const MOST_KEPT: usize = 1 << 26;

/// The frames end.
const END: u8 = 7 << 5;
/// Words are passed.
const PASS: u8 = END | 1;
/// How many [`PASS`] passes; one less is the most that a word can pass.
const PASSED: usize = 31;

/// A control period: what was sensed, and what was said to it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Period {
    /// What was sensed.
    pub inputs: Inputs,
    /// What was to be done.
    pub outputs: Outputs,
}

/// A whole block of periods.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Block {
    /// How many.
    pub count: u32,
    /// As they are kept.
    pub bytes: Vec<u8>,
}

/// Takes down the periods of a controller, from its first one.
#[derive(Debug)]
pub struct IoLog {
    expected: Expected,
    block: Block,
    /// Whole blocks that nobody has taken yet.
    kept: Vec<Block>,
    kept_bytes: usize,
    full: bool,
}

impl Default for IoLog {
    fn default() -> Self {
        Self::new()
    }
}

impl IoLog {
    /// A tape without periods.
    #[must_use]
    pub fn new() -> Self {
        Self {
            expected: Expected::new(),
            block: Block::default(),
            kept: Vec::new(),
            kept_bytes: 0,
            full: false,
        }
    }

    /// Takes down a period.
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

    /// Whole blocks since the last call.
    pub fn take(&mut self) -> std::vec::Drain<'_, Block> {
        self.kept_bytes = 0;
        self.kept.drain(..)
    }

    /// Ends a block that has begun, so that it can be taken.
    pub fn close(&mut self) {
        if self.block.count == 0 {
            return;
        }
        let room = self.block.bytes.len();
        let next = Block {
            count: 0,
            bytes: Vec::with_capacity(room + room / 8),
        };
        let block = std::mem::replace(&mut self.block, next);
        self.kept_bytes += block.bytes.len();
        self.kept.push(block);
        self.expected = Expected::new();
        if self.kept_bytes > MOST_KEPT {
            // A machine that has stood for hours without a job: nobody replays that, and the memory is needed.
            *self = Self {
                full: true,
                ..Self::new()
            };
        }
    }

    /// Whether it has all periods since its first.
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
        said: outputs.transmit.len() as u16,
        heard: Heard::of(inputs),
        ..Done::default()
    });
    let mut words = [[0; ROW]; ROWS];
    let (first, second) = words.as_flattened_mut().split_at_mut(TO);
    fill(first, &to.encode_unsealed());
    fill(second, &from.encode_unsealed());
    words
}

/// The words of a frame; its check, which is the last, is left out.
fn fill(words: &mut [u32], frame: &[u8]) {
    for (word, bytes) in words
        .iter_mut()
        .zip(&frame.as_chunks::<4>().0[..frame.len() / 4 - 1])
    {
        *word = u32::from_le_bytes(*bytes);
    }
}

/// What stands in the frames, as far as it can be foreseen.
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
        // Most rows are as expected.
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

    /// `None` when the bytes end too soon or say what cannot be.
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

/// The words of a period on their way into a block.
struct Coded {
    bytes: [u8; MOST_BYTES + 4],
    at: usize,
}

impl Coded {
    const fn new() -> Self {
        Self {
            bytes: [0; MOST_BYTES + 4],
            at: 0,
        }
    }

    /// A byte, and the lowest `count` bytes of `content`. All four are written; what follows overwrites those too many.
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

/// Reads the periods of a block. An error is how many bytes of the block were understood: its contents are not what this version writes.
#[derive(Debug)]
pub struct IoLogDecoder {
    expected: Expected,
    bytes: Vec<u8>,
    at: usize,
    left: u32,
}

impl IoLogDecoder {
    /// Of a block of so many periods.
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
            // What follows the last one belongs to nothing.
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

/// The period of frames and the bytes of the line behind them.
fn period(words: &Words, bytes: &mut &[u8]) -> Option<Period> {
    let (to, from) = words.as_flattened()[..WORDS].split_at(TO);
    let ToBoard::Period { mut inputs, .. } = ToBoard::decode(&frame(to)).ok()? else {
        return None;
    };
    let FromBoard::Done(done) = FromBoard::decode(&frame(from)).ok()? else {
        return None;
    };
    let (heard, mut outputs) = (done.heard, done.outputs);
    inputs.waiting = heard.waiting;
    inputs.lost_bytes = heard.lost_bytes;
    inputs.urgent = heard.urgent;
    let (received, said) = (usize::from(heard.received), usize::from(done.said));
    if received > RECEIVE_BYTES || said > TRANSMIT_BYTES || done.period != inputs.period {
        return None;
    }
    inputs
        .received
        .extend_from_slice(take(bytes, received)?)
        .ok()?;
    outputs
        .transmit
        .extend_from_slice(take(bytes, said)?)
        .ok()?;
    Some(Period { inputs, outputs })
}

/// A frame of its words.
fn frame<const B: usize>(words: &[u32]) -> [u8; B] {
    let mut frame = [0; B];
    for (bytes, word) in frame.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *bytes = word.to_le_bytes();
    }
    seal(&mut frame);
    frame
}
