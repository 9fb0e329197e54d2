//! Received messages that wait: reliable ones in order, last-value messages as they arrive.

use crate::frame::{Acknowledgement, MAX_PAYLOAD, Words};

/// Bytes in front of each stored payload: kind, sequence number, length.
const PREFIX: usize = 4;

/// Kind of a stored reliable message.
const RELIABLE: u8 = 1;
/// Kind of a stored last-value message.
const LATEST: u8 = 2;

/// A last-value message is old if its number is less than this behind the newest one. No line
/// delays a frame for longer; a message that is further behind comes after an outage and is new.
const LATE: u8 = 16;

/// Bytes that a stored payload takes, in whole words.
const fn stride(payload: usize) -> usize {
    PREFIX + payload.next_multiple_of(PREFIX)
}

/// Received messages in a buffer: kind, sequence number, length (two bytes), payload.
#[derive(Debug)]
pub(super) struct Inbox<const BYTES: usize> {
    bytes: Words<BYTES>,
    /// Range of the stored messages in `bytes`.
    head: usize,
    used: usize,
    /// Sequence number of the first missing reliable frame.
    missing: u8,
    /// Bit `k`: frame `missing + 1 + k` arrived.
    beyond: u8,
    /// Sequence number of the next reliable message to deliver.
    give: u8,
    /// Sequence number of the newest last-value message.
    newest: Option<u8>,
    /// Duplicate reliable frames.
    pub(super) duplicates: u32,
    /// Frames dropped because the buffer was full.
    pub(super) no_room: u32,
    /// Stored bytes were moved, which is expensive.
    pub(super) moved: bool,
}

impl<const BYTES: usize> Default for Inbox<BYTES> {
    fn default() -> Self {
        Self {
            bytes: Words([0; BYTES]),
            head: 0,
            used: 0,
            missing: 0,
            beyond: 0,
            give: 0,
            newest: None,
            duplicates: 0,
            no_room: 0,
            moved: false,
        }
    }
}

impl<const BYTES: usize> Inbox<BYTES> {
    /// The largest message must fit beside one that arrived out of order.
    const ENOUGH: () = assert!(BYTES >= 2 * stride(MAX_PAYLOAD) && BYTES.is_multiple_of(PREFIX));

    /// Clears everything except the counters.
    pub(super) fn clear(&mut self) {
        let () = Self::ENOUGH;
        self.head = 0;
        self.used = 0;
        self.missing = 0;
        self.beyond = 0;
        self.give = 0;
        self.newest = None;
    }

    /// Returns the acknowledgement for the peer. Without a gap, messages beyond half of the buffer
    /// are not acknowledged yet (flow control).
    pub(super) fn acknowledgement(&self) -> Acknowledgement {
        let crowding = if self.is_crowded() && self.beyond == 0 {
            self.crowding()
        } else {
            0
        };
        Acknowledgement {
            next: self.missing.wrapping_sub(crowding),
            beyond: self.beyond,
        }
    }

    /// Takes a reliable frame. Returns true when it should be acknowledged at once: there is a gap,
    /// or the peer missed an acknowledgement.
    pub(super) fn reliable(&mut self, sequence: u8, payload: &[u8]) -> bool {
        let ahead = sequence.wrapping_sub(self.missing);
        if ahead == 0 {
            // At most half of the sequence numbers may wait to be polled; more could not be
            // distinguished.
            if self.missing.wrapping_sub(self.give) >= 120 {
                self.no_room = self.no_room.saturating_add(1);
                return false;
            }
            if !self.store(RELIABLE, sequence, payload, 0) {
                return false;
            }
            // Frames that arrived out of order are now in order.
            let run = self.beyond.trailing_ones();
            self.missing = self.missing.wrapping_add(1 + run as u8);
            self.beyond = self.beyond.checked_shr(run + 1).unwrap_or(0);
            return run > 0 || self.beyond != 0;
        }
        if ahead > 8 {
            // Less than half of the numbers behind: a duplicate. More than a window ahead: not from
            // this peer.
            if ahead >= 128 {
                self.duplicates = self.duplicates.saturating_add(1);
            }
            return true;
        }
        let bit = 1 << (ahead - 1);
        if self.beyond & bit != 0 {
            self.duplicates = self.duplicates.saturating_add(1);
        } else if self.store(RELIABLE, sequence, payload, PREFIX + MAX_PAYLOAD) {
            self.beyond |= bit;
        }
        true
    }

    /// Takes a last-value message, unless a newer one was received. Older ones are dropped when the
    /// buffer is nearly full.
    pub(super) fn latest(&mut self, sequence: u8, payload: &[u8]) {
        let old = self
            .newest
            .is_some_and(|newest| newest.wrapping_sub(sequence) < LATE);
        if old {
            return;
        }
        self.newest = Some(sequence);
        // A reliable message that arrives in order must always fit.
        let reserve = PREFIX + MAX_PAYLOAD;
        while self.free() < stride(payload.len()) + reserve {
            let Some((start, _, end)) = self.find(|kind, _| kind == LATEST) else {
                break;
            };
            self.remove(start, end);
            self.no_room = self.no_room.saturating_add(1);
        }
        self.store(LATEST, sequence, payload, reserve);
    }

    /// Returns whether nothing is stored.
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.head == self.used
    }

    /// Returns whether more than half of the buffer is used.
    fn is_crowded(&self) -> bool {
        self.used - self.head > BYTES / 2
    }

    /// Number of reliable messages in order that lie beyond half of the buffer, if all have the
    /// same size.
    fn crowding(&self) -> u8 {
        let (waiting, used) = (self.missing.wrapping_sub(self.give), self.used - self.head);
        // Both are at most 2^16.
        let first = u32::from(waiting) * (BYTES / 2) as u32 / (used as u32).max(1);
        waiting.saturating_sub(first as u8)
    }

    /// The next message in order; it stays stored.
    pub(super) fn first(&self) -> Option<&[u8]> {
        let (start, end, _) = self.place()?;
        self.stored().get(start + PREFIX..end)
    }

    /// Drops the next message in order. Returns whether that made room that the peer waits for.
    pub(super) fn drop_first(&mut self) -> bool {
        let Some((start, _, end)) = self.place() else {
            return false;
        };
        let crowded = self.is_crowded();
        let kind = self.stored().get(start).copied();
        self.remove(start, end);
        if kind == Some(RELIABLE) {
            self.give = self.give.wrapping_add(1);
        }
        crowded
    }

    /// Position of the next message in order: its start, the end of its payload, the start of the
    /// next message.
    fn place(&self) -> Option<(usize, usize, usize)> {
        let give = self.give;
        self.find(|kind, sequence| kind == LATEST || sequence == give)
    }

    /// The stored bytes.
    fn stored(&self) -> &[u8] {
        self.bytes.0.get(self.head..self.used).unwrap_or_default()
    }

    /// Number of free bytes.
    fn free(&self) -> usize {
        BYTES - (self.used - self.head)
    }

    /// Stores a payload if `reserve` bytes remain free.
    fn store(&mut self, kind: u8, sequence: u8, payload: &[u8], reserve: usize) -> bool {
        let length = stride(payload.len());
        if payload.len() > MAX_PAYLOAD || self.free() < length + reserve {
            self.no_room = self.no_room.saturating_add(1);
            return false;
        }
        let [low, high] = (payload.len() as u16).to_le_bytes();
        if self.used + length > BYTES {
            // Moving is expensive and therefore delayed: the inbox nearly always becomes empty
            // before, and starts again at 0.
            self.bytes.0.copy_within(self.head..self.used, 0);
            self.used -= self.head;
            self.head = 0;
            self.moved = true;
        }
        let end = self.used + PREFIX + payload.len();
        let Some((prefix, place)) = self
            .bytes
            .0
            .get_mut(self.used..end)
            .and_then(|place| place.split_first_chunk_mut::<PREFIX>())
        else {
            return false;
        };
        *prefix = [kind, sequence, low, high];
        place.copy_from_slice(payload);
        self.used += length;
        true
    }

    /// Position of the first stored message that `commanded` selects: its start, the end of its
    /// payload, the start of the next message.
    fn find(&self, commanded: impl Fn(u8, u8) -> bool) -> Option<(usize, usize, usize)> {
        let mut start = 0;
        while let Some(&[kind, sequence, low, high]) = self
            .stored()
            .get(start..)
            .and_then(|rest| rest.first_chunk::<PREFIX>())
        {
            let length = usize::from(u16::from_le_bytes([low, high]));
            let end = start + stride(length);
            if commanded(kind, sequence) {
                return Some((start, start + PREFIX + length, end));
            }
            start = end;
        }
        None
    }

    /// Removes the bytes from `start` to `end`.
    fn remove(&mut self, start: usize, end: usize) {
        if start == 0 {
            self.head = (self.head + end).min(self.used);
            if self.head == self.used {
                self.head = 0;
                self.used = 0;
            }
            return;
        }
        let (start, end) = (self.head + start, (self.head + end).min(self.used));
        let start = start.min(end);
        self.bytes.0.copy_within(end..self.used, start);
        self.used -= end - start;
    }
}
