//! Frames: what stands between two zero bytes on the line.
//!
//! ```text
//! COBS( header 1 to 4 bytes | payload 0 to MAX_PAYLOAD bytes | CRC-32, little endian ) 00
//! COBS( byte of the session's key ) 00                                                        a sign of life
//! ```
//!
//! COBS leaves no zero in a frame, so a receiver that lost its place finds it again at the next zero. A frame costs 7 bytes beside
//! its payload and header: one of COBS (two above 254 bytes), four of the CRC, the zero.
//!
//! The CRC-32 (ISO-HDLC) covers header and payload and is combined with the number of the session, so that a frame of another session
//! fails its check without a byte spent on saying so. 32 bits because a frame that moves a machine is at stake: of garbage that
//! happens to be well-formed COBS, one in 4 * 10^9 is taken for a frame. The table has 256 entries, 1 KiB of flash and about 6
//! cycles a byte on a Cortex-M; without a table it is 50 cycles, 64 bytes of which are a tenth of a control period.
//!
//! One frame has neither header nor check: the sign of life of an end that has nothing to say. Its content is one byte, made of the session's
//! number, so that it takes three bytes on the line instead of eight, four with the zero that [`crate::link`] puts in front of it. A slow program sends two or three batches of setpoints in ten seconds and
//! some hundred signs of life, which would cost more than all the rest. It carries nothing and can only put off the moment at which a
//! silent peer is given up. Of random bytes, one in 4 * 10^9 begins the four (with the zero before them) that are taken for it: as good as the check
//! of the other frames.
//!
//! Misuse: a frame is only as good as its session number. Two sessions must not have the same one.

mod outgoing;

pub use outgoing::OutgoingFrame;

use crate::urgent;
use heapless::Vec;

/// The most bytes of payload in a frame; the largest message, a full batch of setpoints far from their prediction, has 284.
pub const MAX_PAYLOAD: usize = 288;

/// The most bytes of header, payload and check.
const MAX_CONTENT: usize = MAX_HEADER + MAX_PAYLOAD + CRC_BYTES;

/// The most bytes of a header.
const MAX_HEADER: usize = 4;

/// Bytes of the check.
const CRC_BYTES: usize = 4;

/// The most bytes of a frame on the line: content, two bytes of COBS, the zero.
pub const MAX_FRAME: usize = MAX_CONTENT + 2 + 1;

/// Bytes that lie as words do, so that they can be copied by words.
#[derive(Debug)]
#[repr(align(4))]
pub(crate) struct Words<const BYTES: usize>(pub(crate) [u8; BYTES]);

impl<const BYTES: usize> Default for Words<BYTES> {
    fn default() -> Self {
        Self([0; BYTES])
    }
}

/// The encoded frame, its closing zero included.
pub type FrameBytes = Vec<u8, MAX_FRAME>;

/// CRC-32 as in Ethernet and zip, byte by byte.
static CRC_TABLE: [u32; 256] = crc_table();

const fn crc_table() -> [u32; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < table.len() {
        let mut value = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            let odd = value & 1;
            value = (value >> 1) ^ (0xEDB8_8320 & odd.wrapping_neg());
            bit += 1;
        }
        table[byte] = value;
        byte += 1;
    }
    table
}

/// The register before the first byte; the CRC is the opposite of the register after the last.
const CRC_START: u32 = !0;

/// The register after one more byte.
#[inline(always)]
fn crc_step(register: u32, byte: u8) -> u32 {
    // The mask cuts nothing: the index is a byte.
    CRC_TABLE[((register ^ u32::from(byte)) & 0xFF) as usize] ^ (register >> 8)
}

/// CRC-32 (ISO-HDLC) of some bytes, as it stands in [`crate::message::Command::Activate`].
pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes
        .iter()
        .fold(CRC_START, |register, &byte| crc_step(register, byte))
}

/// The register after content and check of a good frame of a session. The check is the CRC combined with the session's key, so what is left of the register does not depend on the
/// content: it is what four bytes of zero make of the opposite of the key.
fn crc_of_good(session: u32) -> u32 {
    (0..CRC_BYTES).fold(!session_key(session), |register, _| crc_step(register, 0))
}

/// What is combined with the CRC of a session's frames: 0 for session 0, different for different sessions, and differing in many
/// bits for neighbouring ones (an odd factor is a bijection; this one is 2^32 divided by the golden ratio).
const fn session_key(session: u32) -> u32 {
    session.wrapping_mul(0x9E37_79B1)
}

/// The content of a session's sign of life: the byte of its key that depends on every bit of its number.
const fn sign_of_life(session: u32) -> u8 {
    (session_key(session) >> 24) as u8
}

/// What has arrived: cumulative, and beyond the first gap.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Acknowledgement {
    /// Sequence number of the reliable frame that is expected next; all before it arrived.
    pub next: u8,
    /// Bit `k` is set when the frame `next + 1 + k` arrived already.
    pub beyond: u8,
}

/// What a frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Header {
    /// [`crate::message::Hello`]; in session 0.
    Hello,
    /// [`crate::message::Welcome`]; in session 0.
    Welcome,
    /// A message that must arrive, once and in order.
    Reliable {
        /// Its number.
        sequence: u8,
        /// What its sender has heard.
        acknowledgement: Acknowledgement,
    },
    /// A message of which only the newest is of interest.
    Latest {
        /// Its number.
        sequence: u8,
        /// What its sender has heard.
        acknowledgement: Acknowledgement,
    },
    /// Nothing but the acknowledgement.
    Acknowledge(Acknowledgement),
    /// Nothing at all: the sign of life of an end that has nothing to say. A payload given with it is not sent.
    Alive,
}

/// Bit of the first header byte: the acknowledgement has its second byte.
const BEYOND: u8 = 0x80;

impl Header {
    /// The header, and how many bytes of it there are.
    fn write(&self) -> ([u8; MAX_HEADER], usize) {
        let (kind, sequence, Acknowledgement { next, beyond }) = match *self {
            Self::Hello => return ([1, 0, 0, 0], 1),
            Self::Welcome => return ([2, 0, 0, 0], 1),
            Self::Alive => return ([0; MAX_HEADER], 0),
            Self::Reliable {
                sequence,
                acknowledgement,
            } => (3, Some(sequence), acknowledgement),
            Self::Latest {
                sequence,
                acknowledgement,
            } => (4, Some(sequence), acknowledgement),
            Self::Acknowledge(acknowledgement) => (5, None, acknowledgement),
        };
        let more = beyond != 0;
        let kind = kind | if more { BEYOND } else { 0 };
        // What is not there stands behind what is, and is written over.
        match sequence {
            Some(sequence) => ([kind, sequence, next, beyond], 3 + usize::from(more)),
            None => ([kind, next, beyond, 0], 2 + usize::from(more)),
        }
    }

    /// The header and what follows it.
    fn read(content: &[u8]) -> Option<(Self, &[u8])> {
        let (&first, mut rest) = content.split_first()?;
        let mut take = || {
            let (&byte, after) = rest.split_first()?;
            rest = after;
            Some(byte)
        };
        let kind = first & !BEYOND;
        let header = match kind {
            1 if first == kind => Self::Hello,
            2 if first == kind => Self::Welcome,
            3..=5 => {
                let sequence = if kind == 5 { 0 } else { take()? };
                let next = take()?;
                let beyond = if first == kind { 0 } else { take()? };
                let acknowledgement = Acknowledgement { next, beyond };
                match kind {
                    3 => Self::Reliable {
                        sequence,
                        acknowledgement,
                    },
                    4 => Self::Latest {
                        sequence,
                        acknowledgement,
                    },
                    _ => Self::Acknowledge(acknowledgement),
                }
            }
            _ => return None,
        };
        Some((header, rest))
    }

    /// The session whose key the check of such a frame carries.
    fn session(&self, session: u32) -> u32 {
        match self {
            Self::Hello | Self::Welcome => 0,
            _ => session,
        }
    }
}

/// A payload does not fit into a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooLong;

impl core::fmt::Display for TooLong {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "a message has more than {MAX_PAYLOAD} bytes and fits no frame"
        )
    }
}

impl core::error::Error for TooLong {}

/// Makes the frame of a payload; `frame` is cleared first.
///
/// # Errors
///
/// [`TooLong`] when the payload has more than [`MAX_PAYLOAD`] bytes.
pub fn encode(
    header: Header,
    payload: &[u8],
    session: u32,
    frame: &mut FrameBytes,
) -> Result<(), TooLong> {
    frame.clear();
    let mut outgoing = OutgoingFrame::default();
    outgoing.begin(header, payload, session, false)?;
    let mut bytes = [0; MAX_FRAME];
    let count = outgoing.read(&mut bytes, usize::MAX);
    frame
        .extend_from_slice(bytes.get(..count).unwrap_or_default())
        .map_err(|_| TooLong)
}

/// A frame whose check is right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// What it is.
    pub header: Header,
    /// What it carries.
    pub payload: &'a [u8],
}

/// Finds frames in a stream of bytes.
///
/// It needs no look-ahead and never more than [`MAX_FRAME`] bytes of memory; whatever it is fed, it is in step again after the next zero.
#[derive(Debug)]
pub struct FrameDecoder {
    /// Content of the frame so far, from [`FIRST`] to here, and the register of its CRC.
    content: Words<{ FIRST + MAX_CONTENT }>,
    filled: usize,
    register: u32,
    /// COBS: bytes that follow before the next code, and whether that stands for a zero.
    left: u8,
    zero: bool,
    /// Everything up to the next zero is to be skipped.
    skip: bool,
    /// Session whose frames are heard.
    session: u32,
    /// Frames that were refused.
    bad: u32,
}

/// Content begins here, so that what stands behind the usual header of three bytes begins with a word and can be copied by words.
const FIRST: usize = 1;

impl Default for FrameDecoder {
    fn default() -> Self {
        Self {
            content: Words::default(),
            filled: FIRST,
            register: CRC_START,
            left: 0,
            zero: false,
            skip: false,
            session: 0,
            bad: 0,
        }
    }
}

impl FrameDecoder {
    /// A decoder that hears greetings only.
    pub fn new() -> Self {
        Self::default()
    }

    /// From now on frames of this session are heard, beside greetings.
    pub fn set_session(&mut self, session: u32) {
        self.session = session;
    }

    /// Frames refused so far: broken, too long, check not right, or of another session. Stays at its largest value.
    pub fn bad_frames(&self) -> u32 {
        self.bad
    }

    /// Takes the next byte of the line; gives the frame that it ends, if its check is right.
    pub fn push(&mut self, byte: u8) -> Option<Frame<'_>> {
        self.take(&mut [byte].as_slice())
    }

    /// Takes bytes of the line, up to the end of the next frame whose check is right, and gives that. The check is done when its last byte
    /// comes.
    pub fn take(&mut self, line: &mut &[u8]) -> Option<Frame<'_>> {
        while self.fill(line) {
            if let Some((header, start, end)) = self.end() {
                let payload = self.content.0.get(start..end)?;
                return Some(Frame { header, payload });
            }
        }
        None
    }

    /// Takes bytes up to the next zero; whether there was one. Twelve instructions a byte and forty a run.
    #[inline(never)]
    fn fill(&mut self, line: &mut &[u8]) -> bool {
        while let Some((&first, rest)) = line.split_first() {
            if first == 0 {
                *line = rest;
                return true;
            }
            if self.left != 0 {
                // A run without a zero, as far as it has come.
                let run = line.get(..usize::from(self.left)).unwrap_or(line);
                let count = self.copy(run);
                *line = line.get(count..).unwrap_or_default();
                // No longer than what was left.
                self.left = self.left.wrapping_sub(count as u8);
                continue;
            }
            // A code, which stands for a zero as well, if the one before announced that.
            *line = rest;
            self.left = first - 1;
            if core::mem::replace(&mut self.zero, first != u8::MAX) {
                let filled = self.place();
                if let Some(place) = self.content.0.get_mut(filled) {
                    *place = 0;
                }
                self.register = crc_step(self.register, 0);
                self.filled = filled + 1;
            }
        }
        false
    }

    /// Where the next byte of content goes.
    #[inline(always)]
    fn place(&mut self) -> usize {
        if self.filled < FIRST + MAX_CONTENT {
            return self.filled;
        }
        // Nothing of it will be read: what comes now is written over what came.
        self.skip = true;
        FIRST + 1
    }

    /// Takes content up to a zero or as far as there is room; says how many bytes that are.
    #[inline(always)]
    fn copy(&mut self, run: &[u8]) -> usize {
        let filled = self.place();
        let room = self.content.0.get_mut(filled..).unwrap_or_default();
        let (mut register, mut count) = (self.register, 0_usize);
        for (&byte, place) in run.iter().zip(room) {
            if byte == 0 {
                break;
            }
            register = crc_step(register, byte);
            *place = byte;
            count = count.wrapping_add(1);
        }
        self.register = register;
        self.filled = filled + count;
        count
    }

    /// The end of a frame: its header, and where its payload lies, if its check is right.
    fn end(&mut self) -> Option<(Header, usize, usize)> {
        let (end, register) = (self.filled, self.register);
        let (left, zero) = (self.left, self.zero);
        let whole = !self.skip && left == 0;
        self.filled = FIRST;
        self.register = CRC_START;
        self.left = 0;
        self.zero = false;
        self.skip = false;
        if end == FIRST && (left == urgent::STOP_CODE - 1 || (left == 0 && !zero)) {
            // A stray urgent stop, or nothing at all.
            return None;
        }
        let content = self.content.0.get(FIRST..end).unwrap_or_default();
        let found = if whole {
            check(content, register, self.session)
        } else {
            None
        };
        if found.is_none() {
            self.bad = self.bad.saturating_add(1);
        }
        found.map(|(header, start, end)| (header, FIRST + start, FIRST + end))
    }
}

/// The header of a content, and where its payload lies, if the check is right.
fn check(content: &[u8], register: u32, session: u32) -> Option<(Header, usize, usize)> {
    if let [sign] = *content {
        return (session != 0 && sign == sign_of_life(session)).then_some((Header::Alive, 1, 1));
    }
    let (body, _) = content.split_last_chunk::<CRC_BYTES>()?;
    let (header, payload) = Header::read(body)?;
    let right = register == crc_of_good(header.session(session));
    (right && payload.len() <= MAX_PAYLOAD).then_some((
        header,
        body.len() - payload.len(),
        body.len(),
    ))
}

#[cfg(test)]
mod tests;
