//! Frames: the bytes between two zero bytes on the line.
//!
//! ```text
//! COBS( header 1 to 4 bytes | payload 0 to MAX_PAYLOAD bytes | CRC-32, little endian ) 00
//! COBS( byte of the session key ) 00                                   keep-alive frame
//! ```
//!
//! COBS leaves no zero in a frame, so a receiver that lost synchronisation recovers at the next
//! zero. A frame costs 6 bytes in addition to payload and header: one of COBS (two above 254
//! bytes), four of the CRC, and the zero. `Hello`, `Welcome` and keep-alive frames also have a
//! zero before them.
//!
//! The CRC-32 (ISO-HDLC) covers header and payload. It is combined with the session number, so a
//! frame of another session fails its check without an extra byte. The check has 32 bits because
//! frames move a machine: of garbage that is well-formed COBS, one in 4 * 10^9 is accepted as a
//! frame. The table has 256 entries, 1 KiB of flash, and costs about 6 cycles a byte on a Cortex-M.
//! Without a table a byte costs 50 cycles, and 64 bytes would take a tenth of a control period.
//!
//! The keep-alive frame of an idle endpoint has neither header nor check. Its content is one byte
//! of the session key, so it takes three bytes on the line instead of eight, or four with the zero
//! that [`crate::link`] sends before it. A slow program sends two or three batches of setpoints in
//! ten seconds and some hundred keep-alive frames, which would otherwise cost more than all other
//! traffic. The frame carries no data and can only delay the detection of a silent peer. Of random
//! bytes, one in 4 * 10^9 begins the four (with the zero before them) that are accepted: as good as
//! the check of the other frames.
//!
//! Callers must give each session its own number: frames of two sessions with the same number
//! cannot be distinguished.

mod outgoing;

pub use outgoing::OutgoingFrame;

use crate::out_of_band;
use heapless::Vec;

/// Largest payload of a frame, bytes. The largest message, telemetry of six axes that wrap around,
/// with force sensor, inputs and outputs, has 345.
pub const MAX_PAYLOAD: usize = 348;

/// Largest header, payload and check, bytes.
const MAX_CONTENT: usize = MAX_HEADER + MAX_PAYLOAD + CRC_BYTES;

/// Largest header, bytes.
const MAX_HEADER: usize = 4;

/// Bytes of the check.
const CRC_BYTES: usize = 4;

/// Largest frame on the line, bytes: content, two bytes of COBS, the zero.
pub const MAX_FRAME: usize = MAX_CONTENT + 2 + 1;

/// Word-aligned bytes, so that they can be copied by words.
#[derive(Debug)]
#[repr(align(4))]
pub(crate) struct Words<const BYTES: usize>(pub(crate) [u8; BYTES]);

impl<const BYTES: usize> Default for Words<BYTES> {
    fn default() -> Self {
        Self([0; BYTES])
    }
}

/// An encoded frame, including its closing zero.
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

/// CRC register before the first byte. The CRC is the complement of the register after the last.
const CRC_START: u32 = !0;

/// Returns the CRC register after one more byte.
#[inline(always)]
fn crc_step(register: u32, byte: u8) -> u32 {
    // The index is a byte: the mask drops nothing.
    CRC_TABLE[((register ^ u32::from(byte)) & 0xFF) as usize] ^ (register >> 8)
}

/// Returns the CRC-32 (ISO-HDLC) of `bytes`, as in [`crate::message::Command::Activate`].
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.add(bytes);
    crc.value()
}

/// CRC-32 (ISO-HDLC) of bytes that come in parts.
#[derive(Debug, Clone, Copy)]
pub struct Crc32(u32);

impl Crc32 {
    /// No byte came yet.
    pub const fn new() -> Self {
        Self(CRC_START)
    }

    /// Adds the next bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        let step = |register, byte: &u8| crc_step(register, *byte);
        self.0 = bytes.iter().fold(self.0, step);
    }

    /// The CRC of all bytes so far.
    pub const fn value(self) -> u32 {
        !self.0
    }
}

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}

/// CRC register after content and check of a valid frame of a session. The check is the CRC
/// combined with the session key, so the register does not depend on the content: it is the result
/// of four zero bytes after the complement of the key.
fn crc_of_good(session: u32) -> u32 {
    (0..CRC_BYTES).fold(!session_key(session), |register, _| crc_step(register, 0))
}

/// Key that is combined with the CRC of a session's frames: 0 for session 0, and different for
/// different sessions. It differs in many bits for neighbouring sessions: an odd factor is a
/// bijection, and this one is 2^32 divided by the golden ratio.
const fn session_key(session: u32) -> u32 {
    session.wrapping_mul(0x9E37_79B1)
}

/// Content of a session's keep-alive frame: the byte of its key that depends on every bit of its
/// number.
const fn sign_of_life(session: u32) -> u8 {
    (session_key(session) >> 24) as u8
}

/// Acknowledgement of received frames: cumulative, and beyond the first gap.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Acknowledgement {
    /// Sequence number of the reliable frame that is expected next; all frames before it have
    /// arrived.
    pub next: u8,
    /// Bit `k` is set when the frame `next + 1 + k` has arrived.
    pub beyond: u8,
}

/// Kind of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Header {
    /// [`crate::message::Hello`]; in session 0.
    Hello,
    /// [`crate::message::Welcome`]; in session 0.
    Welcome,
    /// Reliable message: delivered once and in order.
    Reliable {
        /// Sequence number.
        sequence: u8,
        /// Acknowledgement of the sender.
        acknowledgement: Acknowledgement,
    },
    /// Last-value message: the next one replaces it.
    Latest {
        /// Sequence number.
        sequence: u8,
        /// Acknowledgement of the sender.
        acknowledgement: Acknowledgement,
    },
    /// Acknowledgement without a message.
    Acknowledge(Acknowledgement),
    /// Keep-alive frame of an idle endpoint. A payload given with it is not sent.
    KeepAlive,
}

/// Bit of the first header byte: the acknowledgement has its second byte.
const BEYOND: u8 = 0x80;

impl Header {
    /// Returns the header and its length in bytes.
    fn write(&self) -> ([u8; MAX_HEADER], usize) {
        let (kind, sequence, Acknowledgement { next, beyond }) = match *self {
            Self::Hello => return ([1, 0, 0, 0], 1),
            Self::Welcome => return ([2, 0, 0, 0], 1),
            Self::KeepAlive => return ([0; MAX_HEADER], 0),
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
        // Unused bytes follow the used ones and are overwritten by the payload.
        match sequence {
            Some(sequence) => ([kind, sequence, next, beyond], 3 + usize::from(more)),
            None => ([kind, next, beyond, 0], 2 + usize::from(more)),
        }
    }

    /// Splits content into the header and the bytes after it.
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

    /// Session whose key the check of this frame carries.
    fn session(&self, session: u32) -> u32 {
        match self {
            Self::Hello | Self::Welcome => 0,
            _ => session,
        }
    }
}

/// Error: a payload is longer than [`MAX_PAYLOAD`].
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

/// Encodes the frame of a payload. `frame` is cleared first.
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

/// A frame with a valid check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Kind of the frame.
    pub header: Header,
    /// Payload.
    pub payload: &'a [u8],
}

/// Finds frames in a stream of bytes.
///
/// It needs no look-ahead and at most [`MAX_FRAME`] bytes of memory. After any input it is
/// synchronised again at the next zero.
#[derive(Debug)]
pub struct FrameDecoder {
    /// Content of the frame so far, from [`FIRST`] to `filled`, and the register of its CRC.
    content: Words<{ FIRST + MAX_CONTENT }>,
    filled: usize,
    register: u32,
    /// COBS: bytes before the next code, and whether that code stands for a zero.
    left: u8,
    zero: bool,
    /// Everything up to the next zero is skipped.
    skip: bool,
    /// Session whose frames are accepted.
    session: u32,
    /// Number of refused frames.
    bad: u32,
}

/// Index of the first byte of content. The payload behind the usual header of three bytes is then
/// word-aligned and can be copied by words.
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
    /// Creates a decoder that accepts only Hello and Welcome.
    pub fn new() -> Self {
        Self::default()
    }

    /// Accepts frames of this session from now on, besides Hello and Welcome.
    pub fn set_session(&mut self, session: u32) {
        self.session = session;
    }

    /// Number of refused frames: invalid COBS, too long, wrong check, or of another session. It
    /// saturates.
    pub fn bad_frames(&self) -> u32 {
        self.bad
    }

    /// Takes the next byte of the line. Returns the frame that it ends, if its check is valid.
    pub fn push(&mut self, byte: u8) -> Option<Frame<'_>> {
        self.take(&mut [byte].as_slice())
    }

    /// Takes bytes of the line up to the end of the next frame with a valid check, and returns that
    /// frame. The check is complete when its last byte arrives.
    pub fn take(&mut self, line: &mut &[u8]) -> Option<Frame<'_>> {
        while self.fill(line) {
            if let Some((header, start, end)) = self.end() {
                let payload = self.content.0.get(start..end)?;
                return Some(Frame { header, payload });
            }
        }
        None
    }

    /// Takes bytes up to the next zero and returns whether there was one. It costs twelve
    /// instructions a byte and forty a run.
    #[inline(never)]
    fn fill(&mut self, line: &mut &[u8]) -> bool {
        while let Some((&first, rest)) = line.split_first() {
            if first == 0 {
                *line = rest;
                return true;
            }
            if self.left != 0 {
                // The part of a run without a zero that has arrived.
                let run = line.get(..usize::from(self.left)).unwrap_or(line);
                let count = self.copy(run);
                *line = line.get(count..).unwrap_or_default();
                // `count` is at most `left`.
                self.left = self.left.wrapping_sub(count as u8);
                continue;
            }
            // A code. It also stands for a zero if the code before announced that.
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

    /// Returns the index of the next byte of content.
    #[inline(always)]
    fn place(&mut self) -> usize {
        if self.filled < FIRST + MAX_CONTENT {
            return self.filled;
        }
        // The frame is skipped: the following bytes may overwrite it.
        self.skip = true;
        FIRST + 1
    }

    /// Copies content up to a zero or up to the end of the buffer. Returns the number of bytes.
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

    /// Ends a frame. Returns its header and the range of its payload, if its check is valid.
    fn end(&mut self) -> Option<(Header, usize, usize)> {
        let (end, register) = (self.filled, self.register);
        let (left, zero) = (self.left, self.zero);
        let whole = !self.skip && left == 0;
        self.filled = FIRST;
        self.register = CRC_START;
        self.left = 0;
        self.zero = false;
        self.skip = false;
        if end == FIRST && (left == out_of_band::STOP_CODE - 1 || (left == 0 && !zero)) {
            // An out-of-band stop between frames, or an empty frame.
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

/// Returns the header of `content` and the range of its payload, if the check is valid.
fn check(content: &[u8], register: u32, session: u32) -> Option<(Header, usize, usize)> {
    if let [sign] = *content {
        return (session != 0 && sign == sign_of_life(session)).then_some((
            Header::KeepAlive,
            1,
            1,
        ));
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
