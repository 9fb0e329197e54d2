//! A frame on its way out, made while it goes.
//!
//! The check of a frame and the distances between its zeros take some 12 instructions a byte, and a controller has no period for all of a long
//! frame. So its content is put down at once, which takes little, and [`OutgoingFrame::read`] makes of it no more than it gives, as far as COBS
//! lets it: a run without a zero goes when its end is known.

use super::{
    CRC_BYTES, CRC_START, Header, MAX_CONTENT, MAX_PAYLOAD, TooLong, Words, crc_step, session_key,
    sign_of_life,
};

/// The first code of COBS stands here: behind it and a header of three bytes the payload begins with a word.
const CODE: usize = 4;

/// Room in front, content, one more code, the closing zero.
const BYTES: usize = CODE + 1 + MAX_CONTENT + 1 + 1;

/// A frame that goes out.
#[derive(Debug)]
pub struct OutgoingFrame {
    bytes: Words<BYTES>,
    /// What went.
    gone: usize,
    /// The code that is looked for, of a run that has `run` bytes so far; everything before it can go.
    code_at: usize,
    run: u8,
    /// The next byte of content that is looked at.
    at: usize,
    /// The check begins here; the content ends here.
    check_at: usize,
    end: usize,
    /// Register of the CRC, and what it is combined with.
    register: u32,
    key: u32,
}

impl Default for OutgoingFrame {
    fn default() -> Self {
        Self {
            bytes: Words::default(),
            gone: CODE,
            code_at: CODE,
            run: 0,
            at: 0,
            check_at: 0,
            end: 0,
            register: CRC_START,
            key: 0,
        }
    }
}

impl OutgoingFrame {
    /// Puts down a frame in place of the one before, whether that is gone or not. `zero_first`: a zero goes before it, for a line that may hold the
    /// rest of a broken frame.
    ///
    /// # Errors
    ///
    /// [`TooLong`] when the payload has more than [`MAX_PAYLOAD`] bytes; then there is no frame.
    pub fn begin(
        &mut self,
        header: Header,
        payload: &[u8],
        session: u32,
        zero_first: bool,
    ) -> Result<(), TooLong> {
        self.gone = CODE;
        self.code_at = CODE;
        self.end = 0;
        let start = CODE + 1;
        let content = self.bytes.0.get_mut(start..).unwrap_or_default();
        let end = if header == Header::Alive {
            if let Some(place) = content.first_mut() {
                *place = sign_of_life(session);
            }
            start + 1
        } else {
            let (bytes, length) = header.write();
            if let Some(place) = content.first_chunk_mut() {
                *place = bytes;
            }
            if payload.len() > MAX_PAYLOAD {
                return Err(TooLong);
            }
            let room = content.get_mut(length..).unwrap_or_default();
            if let Some(place) = room.get_mut(..payload.len()) {
                place.copy_from_slice(payload);
            }
            start + length + payload.len() + CRC_BYTES
        };
        self.gone -= usize::from(zero_first);
        self.run = 1;
        self.at = start;
        self.end = end;
        self.check_at = if header == Header::Alive {
            BYTES
        } else {
            end - CRC_BYTES
        };
        self.register = CRC_START;
        self.key = session_key(header.session(session));
        Ok(())
    }

    /// Whether the frame went, to its last byte.
    #[inline]
    pub fn is_gone(&self) -> bool {
        self.gone > self.end
    }

    /// Gives the next bytes and says how many they are: fewer than asked for at the end of the frame, and where more than `most` bytes of content
    /// would have to be looked at.
    pub fn read(&mut self, buffer: &mut [u8], most: usize) -> usize {
        let mut most = most;
        while self.code_at - self.gone < buffer.len() && self.code_at <= self.end && most > 0 {
            most -= self.stuff(most);
        }
        let count = buffer.len().min(self.code_at - self.gone);
        let ready = self.bytes.0.get(self.gone..self.gone + count);
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), ready) {
            to.copy_from_slice(from);
        }
        self.gone += count;
        count
    }

    /// COBS in place: each zero, and the place in front, becomes the distance to the next one; behind 254 bytes without a zero a place is made. Looks
    /// at content as far as that, its check or its end, and at no more than `most` bytes; says at how many.
    fn stuff(&mut self, most: usize) -> usize {
        let from = self.at;
        if from == self.check_at {
            let check = (!self.register ^ self.key).to_le_bytes();
            let place = self.bytes.0.get_mut(from..);
            if let Some(place) = place.and_then(|place| place.first_chunk_mut()) {
                *place = check;
            }
        }
        let until = if from < self.check_at {
            self.check_at.min(self.end)
        } else {
            self.end
        };
        let until = until.min(from.saturating_add(most));
        let (mut at, mut register) = (from, self.register);
        let (mut code_at, mut run) = (self.code_at, self.run);
        let looked = self.bytes.0.get_mut(..until).unwrap_or_default();
        while run != u8::MAX
            && let Some(&byte) = looked.get(at)
        {
            register = crc_step(register, byte);
            if byte == 0 {
                set(looked, code_at, run);
                code_at = at;
                run = 0;
            }
            // At most 255 is left above, and `at` is below `until`.
            run = run.wrapping_add(1);
            at = at.wrapping_add(1);
        }
        let looked_at = at.saturating_sub(from);
        if run == u8::MAX {
            self.bytes.0.copy_within(at..self.end, at + 1);
            set(&mut self.bytes.0, code_at, run);
            self.end += 1;
            self.check_at += 1;
            code_at = at;
            run = 1;
            at += 1;
        }
        if at >= self.end {
            set(&mut self.bytes.0, code_at, run);
            set(&mut self.bytes.0, self.end, 0);
            code_at = self.end + 1;
        }
        (self.at, self.register) = (at, register);
        (self.code_at, self.run) = (code_at, run);
        looked_at
    }
}

#[inline(always)]
fn set(bytes: &mut [u8], at: usize, value: u8) {
    if let Some(place) = bytes.get_mut(at) {
        *place = value;
    }
}
