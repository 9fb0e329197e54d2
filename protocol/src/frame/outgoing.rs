//! Incremental encoder of one outgoing frame.
//!
//! CRC and COBS cost some 12 instructions a byte, too much to encode a long frame in one control
//! period. [`OutgoingFrame::begin`] copies the content, which is cheap. [`OutgoingFrame::read`]
//! encodes only as much as it returns, as far as COBS allows: a run without a zero can be sent only
//! when its end is known.

use super::{
    CRC_BYTES, CRC_START, Header, MAX_CONTENT, MAX_PAYLOAD, TooLong, Words, crc_step, session_key,
    sign_of_life,
};

/// Index of the first COBS code. The payload behind it and a header of three bytes is then
/// word-aligned.
const CODE: usize = 4;

/// Space in front, content, one more code, the closing zero.
const BYTES: usize = CODE + 1 + MAX_CONTENT + 1 + 1;

/// An outgoing frame.
#[derive(Debug)]
pub struct OutgoingFrame {
    bytes: Words<BYTES>,
    /// Index of the next byte to send.
    gone: usize,
    /// Index of the open COBS code, whose run has `run` bytes so far. Everything before it can be
    /// sent.
    code_at: usize,
    run: u8,
    /// Index of the next content byte to encode.
    at: usize,
    /// Index at which the check begins, and index at which the content ends.
    check_at: usize,
    end: usize,
    /// CRC register, and the session key that is combined with it.
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
    /// Begins a frame, in place of the one before, also if that was not sent completely. With
    /// `zero_first` a zero is sent before it, for a line that may hold the rest of a broken frame.
    ///
    /// # Errors
    ///
    /// [`TooLong`] when the payload has more than [`MAX_PAYLOAD`] bytes; no frame is begun.
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
        let end = if header == Header::KeepAlive {
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
        self.check_at = if header == Header::KeepAlive {
            BYTES
        } else {
            end - CRC_BYTES
        };
        self.register = CRC_START;
        self.key = session_key(header.session(session));
        Ok(())
    }

    /// Returns whether the frame was sent completely.
    #[inline]
    pub fn is_gone(&self) -> bool {
        self.gone > self.end
    }

    /// Copies the next bytes to `buffer` and returns their number. It is less than the buffer's
    /// length at the end of the frame, and when more than `max` bytes of content would have to be
    /// encoded.
    pub fn read(&mut self, buffer: &mut [u8], max: usize) -> usize {
        let mut max = max;
        while self.code_at - self.gone < buffer.len() && self.code_at <= self.end && max > 0 {
            max -= self.stuff(max);
        }
        let count = buffer.len().min(self.code_at - self.gone);
        let ready = self.bytes.0.get(self.gone..self.gone + count);
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), ready) {
            to.copy_from_slice(from);
        }
        self.gone += count;
        count
    }

    /// Encodes COBS in place: each zero, and the place in front, becomes the distance to the next
    /// one. A code is inserted after 254 bytes without a zero. Encodes up to that point, the check
    /// or the end, but at most `max` bytes, and returns how many.
    fn stuff(&mut self, max: usize) -> usize {
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
        let until = until.min(from.saturating_add(max));
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
            // `run` is at most 254 and `at` is below `until`.
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
