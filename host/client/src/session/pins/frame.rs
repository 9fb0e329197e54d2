//! What `haptimill` and the program of the emulator send each other.
//!
//! The host sends the bytes for the line of the board, and the emulator runs a control period:
//!
//! | field | |
//! | --- | --- |
//! | length | `u32`, little-endian |
//! | bytes | for the line |
//!
//! It answers with the kind of the answer (`u8`), a length (`u32`), and this number of bytes: a
//! [`Turn`], or text. When the host closes its end, the emulator answers with the result of its
//! checks and ends.

use super::record::WORDS;
use haptimill_hil_sim::plant::GroundTruth;
use haptimill_protocol::message::MAX_AXES;
use std::io::{self, Read, Write};

/// Largest length that is accepted, bytes.
const MAX: usize = 1 << 20;

/// An answer of the emulator.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// A control period has passed.
    Turn(Box<Turn>),
    /// The emulator cannot go on: why.
    Failed(String),
    /// The checks of the run found no fault: what was compared.
    Passed(String),
    /// The checks of the run found faults.
    Faulty(String),
}

/// A control period.
#[derive(Debug, Clone, PartialEq)]
pub struct Turn {
    /// Time of the board, us.
    pub time_us: u64,
    /// Bytes that left the line of the board.
    pub sent: Vec<u8>,
    /// The machine, at the end of the control period.
    pub truth: GroundTruth,
    /// Records of the control periods that the board has completed since the last answer.
    pub records: Vec<[u32; WORDS]>,
}

/// Writes the bytes for the line.
///
/// # Errors
/// The other end is gone.
pub fn write_bytes(out: &mut impl Write, bytes: &[u8]) -> io::Result<()> {
    let length = u32::try_from(bytes.len()).map_err(io::Error::other)?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(bytes)?;
    out.flush()
}

/// Reads the bytes for the line; `None` at the end.
///
/// # Errors
/// The input ends in the middle, or the length is not sound.
pub fn read_bytes(input: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut length = [0; 4];
    match input.read(&mut length[..1])? {
        0 => return Ok(None),
        _ => input.read_exact(&mut length[1..])?,
    }
    read_exactly(input, u32::from_le_bytes(length)).map(Some)
}

fn read_exactly(input: &mut impl Read, length: u32) -> io::Result<Vec<u8>> {
    let length = length as usize;
    if length > MAX {
        return Err(io::Error::other(format!("a frame of {length} bytes")));
    }
    let mut bytes = vec![0; length];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

impl Answer {
    /// Writes the answer.
    ///
    /// # Errors
    /// The other end is gone.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let (kind, bytes) = match self {
            Self::Turn(turn) => (0, turn.encode()),
            Self::Failed(text) => (1, text.as_bytes().to_vec()),
            Self::Passed(text) => (2, text.as_bytes().to_vec()),
            Self::Faulty(text) => (3, text.as_bytes().to_vec()),
        };
        out.write_all(&[kind])?;
        write_bytes(out, &bytes)
    }

    /// Reads an answer.
    ///
    /// # Errors
    /// The emulator has ended, or has another version.
    pub fn read(input: &mut impl Read) -> io::Result<Self> {
        let mut head = [0; 5];
        input.read_exact(&mut head)?;
        let [kind, length @ ..] = head;
        let bytes = read_exactly(input, u32::from_le_bytes(length))?;
        let text = || String::from_utf8_lossy(&bytes).into_owned();
        match kind {
            0 => Turn::decode(&bytes).map(|turn| Self::Turn(Box::new(turn))),
            1 => Some(Self::Failed(text())),
            2 => Some(Self::Passed(text())),
            3 => Some(Self::Faulty(text())),
            _ => None,
        }
        .ok_or_else(|| {
            io::Error::other("the emulator has another version; `cargo xtask emulator --build`")
        })
    }
}

impl Turn {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend(self.time_us.to_le_bytes());
        bytes.push(u8::from(self.truth.pose_valid));
        let truth = &self.truth;
        for value in truth.joints.iter().chain(&truth.pose).chain(&truth.force) {
            bytes.extend(value.to_le_bytes());
        }
        for length in [self.sent.len(), self.records.len()] {
            bytes.extend((length as u32).to_le_bytes());
        }
        bytes.extend(&self.sent);
        for word in self.records.iter().flatten() {
            bytes.extend(word.to_le_bytes());
        }
        bytes
    }

    fn decode(mut bytes: &[u8]) -> Option<Self> {
        let rest = &mut bytes;
        let time_us = u64::from_le_bytes(take(rest)?);
        let [pose_valid] = take(rest)?;
        let mut values = [0.0; 2 * MAX_AXES + 3];
        for value in &mut values {
            *value = f64::from_le_bytes(take(rest)?);
        }
        let (joints, others) = values.split_at(MAX_AXES);
        let (pose, force) = others.split_at(MAX_AXES);
        let truth = GroundTruth {
            joints: joints.try_into().ok()?,
            pose: pose.try_into().ok()?,
            pose_valid: pose_valid != 0,
            force: force.try_into().ok()?,
        };
        let sent = u32::from_le_bytes(take(rest)?) as usize;
        let records = u32::from_le_bytes(take(rest)?) as usize;
        let (sent, words) = rest.split_at_checked(sent)?;
        if Some(words.len()) != records.checked_mul(4 * WORDS) {
            return None;
        }
        let (words, _) = words.as_chunks::<4>();
        let (records, _) = words.as_chunks::<WORDS>();
        Some(Self {
            time_us,
            sent: sent.to_vec(),
            truth,
            records: records
                .iter()
                .map(|words| words.map(u32::from_le_bytes))
                .collect(),
        })
    }
}

/// Takes the first bytes.
fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turn() -> Turn {
        let value = |at: usize| (at as f64 + 0.1) * 1.7;
        Turn {
            time_us: 1 << 40,
            sent: (0..200).collect(),
            truth: GroundTruth {
                joints: core::array::from_fn(value),
                pose: core::array::from_fn(|at| -value(at)),
                pose_valid: true,
                force: [1.0, f64::MIN_POSITIVE, -3.0],
            },
            records: vec![[0x0102_0304; WORDS], core::array::from_fn(|at| at as u32)],
        }
    }

    #[test]
    fn answers_are_read_as_they_were_written() {
        let answers = [
            Answer::Turn(Box::new(turn())),
            Answer::Failed("why".to_string()),
            Answer::Passed(String::new()),
            Answer::Faulty("12".to_string()),
        ];
        let mut bytes = Vec::new();
        for answer in &answers {
            answer.write(&mut bytes).expect("memory");
        }
        let mut input = &bytes[..];
        for answer in &answers {
            assert_eq!(&Answer::read(&mut input).expect("an answer"), answer);
        }
        assert!(input.is_empty() && Answer::read(&mut input).is_err());
    }

    #[test]
    fn a_damaged_answer_is_an_error() {
        let mut bytes = Vec::new();
        Answer::Turn(Box::new(turn()))
            .write(&mut bytes)
            .expect("memory");
        for length in 0..bytes.len() {
            assert!(Answer::read(&mut &bytes[..length]).is_err());
            if let Some(body) = bytes[5..].get(..length) {
                let short = [&[0][..], &(length as u32).to_le_bytes(), body].concat();
                let is_whole = body.len() + 5 == bytes.len();
                assert_eq!(Answer::read(&mut &short[..]).is_ok(), is_whole, "{length}");
            }
        }
        assert!(Answer::read(&mut &[9, 0, 0, 0, 0][..]).is_err());
        assert!(Answer::read(&mut &[0, 255, 255, 255, 255][..]).is_err());
    }

    #[test]
    fn bytes_for_the_line_are_read_to_their_end() {
        let mut bytes = Vec::new();
        for sent in [&[][..], &[1, 2, 3]] {
            write_bytes(&mut bytes, sent).expect("memory");
        }
        let mut input = &bytes[..];
        assert_eq!(read_bytes(&mut input).expect("none"), Some(vec![]));
        assert_eq!(read_bytes(&mut input).expect("some"), Some(vec![1, 2, 3]));
        assert_eq!(read_bytes(&mut input).expect("the end"), None);
        assert!(read_bytes(&mut &bytes[..2]).is_err());
        assert!(read_bytes(&mut &[255; 8][..]).is_err());
    }
}
