//! What arrived and waits: reliable messages put into order, latest values as they come.

use crate::frame::{Acknowledgement, MAX_PAYLOAD, Words};

/// Bytes in front of each stored payload: its kind, its number, its length.
const PREFIX: usize = 4;

/// A stored reliable message.
const RELIABLE: u8 = 1;
/// A stored latest value.
const LATEST: u8 = 2;

/// A latest value is older than the newest if its number is less than so many behind. No line keeps a frame back for longer; what seems to be further
/// behind comes after an outage, and is new.
const LATE: u8 = 16;

/// Bytes that a stored payload takes: whole words.
const fn stride(payload: usize) -> usize {
    PREFIX + payload.next_multiple_of(PREFIX)
}

/// Messages that arrived, one after the other: kind, number, length (two bytes), payload.
#[derive(Debug)]
pub(super) struct Inbox<const BYTES: usize> {
    bytes: Words<BYTES>,
    /// The stored ones lie between these.
    head: usize,
    used: usize,
    /// The reliable frame that is missing first.
    missing: u8,
    /// Bit `k`: frame `missing + 1 + k` arrived.
    beyond: u8,
    /// The reliable message that is to be given next.
    give: u8,
    /// Number of the newest latest value.
    newest: Option<u8>,
    /// Reliable frames that had arrived before.
    pub(super) duplicates: u32,
    /// Frames that found no room.
    pub(super) no_room: u32,
    /// Bytes that were stored had to be moved, which takes long.
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
    /// A message of the largest size must fit beside one that came too early.
    const ENOUGH: () = assert!(BYTES >= 2 * stride(MAX_PAYLOAD) && BYTES.is_multiple_of(PREFIX));

    /// Forgets everything but the counts.
    pub(super) fn clear(&mut self) {
        let () = Self::ENOUGH;
        self.head = 0;
        self.used = 0;
        self.missing = 0;
        self.beyond = 0;
        self.give = 0;
        self.newest = None;
    }

    /// What is to be told to the peer. While nothing is missing in between, that is of messages beyond half of the room that they have not arrived yet.
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

    /// Takes a reliable frame; true when the peer should be told at once: there is a gap, or it did not hear what it was told.
    pub(super) fn reliable(&mut self, sequence: u8, payload: &[u8]) -> bool {
        let ahead = sequence.wrapping_sub(self.missing);
        if ahead == 0 {
            // Half the circle of numbers at most may wait to be polled, or they could not be told apart.
            if self.missing.wrapping_sub(self.give) >= 120 {
                self.no_room = self.no_room.saturating_add(1);
                return false;
            }
            if !self.store(RELIABLE, sequence, payload, 0) {
                return false;
            }
            // Frames that had come too early are now in order.
            let run = self.beyond.trailing_ones();
            self.missing = self.missing.wrapping_add(1 + run as u8);
            self.beyond = self.beyond.checked_shr(run + 1).unwrap_or(0);
            return run > 0 || self.beyond != 0;
        }
        if ahead > 8 {
            // Behind by less than half the circle: it was here before. Ahead by more than a window: not ours.
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

    /// Takes a latest value, unless a newer one was here. When room is short, older ones make way.
    pub(super) fn latest(&mut self, sequence: u8, payload: &[u8]) {
        let old = self
            .newest
            .is_some_and(|newest| newest.wrapping_sub(sequence) < LATE);
        if old {
            return;
        }
        self.newest = Some(sequence);
        // A reliable message that comes in order must find its room whatever else is here.
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

    /// Whether nothing at all is stored.
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.head == self.used
    }

    /// Whether more than half of the room is used.
    fn is_crowded(&self) -> bool {
        self.used - self.head > BYTES / 2
    }

    /// Reliable messages in order that lie beyond half of the room, if all are of a size.
    fn crowding(&self) -> u8 {
        let (waiting, used) = (self.missing.wrapping_sub(self.give), self.used - self.head);
        // Neither is above 2^16.
        let first = u32::from(waiting) * (BYTES / 2) as u32 / (used as u32).max(1);
        waiting.saturating_sub(first as u8)
    }

    /// The next message in order; it stays.
    pub(super) fn first(&self) -> Option<&[u8]> {
        let (start, end, _) = self.place()?;
        self.stored().get(start + PREFIX..end)
    }

    /// Drops the next message in order; says whether that made room which the peer waits for.
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

    /// The next message in order: where it begins, where its payload ends, where the next one begins.
    fn place(&self) -> Option<(usize, usize, usize)> {
        let give = self.give;
        self.find(|kind, sequence| kind == LATEST || sequence == give)
    }

    /// What is stored.
    fn stored(&self) -> &[u8] {
        self.bytes.0.get(self.head..self.used).unwrap_or_default()
    }

    /// Bytes that are free.
    fn free(&self) -> usize {
        BYTES - (self.used - self.head)
    }

    /// Stores a payload if that leaves `reserve` bytes free.
    fn store(&mut self, kind: u8, sequence: u8, payload: &[u8], reserve: usize) -> bool {
        let length = stride(payload.len());
        if payload.len() > MAX_PAYLOAD || self.free() < length + reserve {
            self.no_room = self.no_room.saturating_add(1);
            return false;
        }
        let [low, high] = (payload.len() as u16).to_le_bytes();
        if self.used + length > BYTES {
            // Only now, for it takes long: nearly always the inbox is empty before, and begins anew.
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

    /// The first stored message that is wanted: where it begins, where its payload ends, where the next one begins.
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

    /// Removes what lies between two places.
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
