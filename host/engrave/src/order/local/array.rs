//! The tour as an array of pieces: neighbours in it, and its changes, which can be undone.

use super::Search;
use crate::geometry::Point;

/// A change of the array, for undoing it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Change {
    /// `count` places from `first` reversed.
    Reversed { first: usize, count: usize },
    /// `count` places from `first` rotated to the left by `by`.
    Rotated {
        first: usize,
        count: usize,
        by: usize,
    },
}

impl Search<'_> {
    #[inline]
    pub(super) fn place_of(&self, piece: u32) -> usize {
        (self.place[piece as usize] / 2) as usize
    }

    #[inline]
    pub(super) fn is_flipped(&self, piece: u32) -> bool {
        self.place[piece as usize] % 2 == 1
    }

    #[inline]
    pub(super) fn start(&self, piece: u32) -> Point {
        self.ends[(2 * piece + self.place[piece as usize] % 2) as usize]
    }

    #[inline]
    pub(super) fn end(&self, piece: u32) -> Point {
        self.ends[((2 * piece + self.place[piece as usize] % 2) ^ 1) as usize]
    }

    #[inline]
    pub(super) fn at(&self, place: usize) -> u32 {
        let count = self.order.len();
        self.order[if place >= count { place - count } else { place }] / 2
    }

    #[inline]
    pub(super) fn next(&self, piece: u32) -> u32 {
        self.at(self.place_of(piece) + 1)
    }

    #[inline]
    pub(super) fn previous(&self, piece: u32) -> u32 {
        self.at(self.place_of(piece) + self.order.len() - 1)
    }

    /// Number of steps forward from one piece to another.
    #[inline]
    pub(super) fn steps(&self, from: u32, to: u32) -> usize {
        let (from, to) = (self.place_of(from), self.place_of(to));
        if to >= from {
            to - from
        } else {
            to + self.order.len() - from
        }
    }

    /// Puts a piece by its first end.
    #[inline]
    fn put(&mut self, place: usize, end: u32) {
        self.order[place] = end;
        self.place[(end / 2) as usize] = 2 * place as u32 + end % 2;
    }

    pub(super) fn reverse_places(&mut self, first: usize, count: usize) {
        let total = self.order.len();
        let (mut low, mut high) = (first % total, (first + count + total - 1) % total);
        for _ in 0..count / 2 {
            let (a, b) = (self.order[low], self.order[high]);
            self.put(low, b ^ 1);
            self.put(high, a ^ 1);
            low = if low + 1 == total { 0 } else { low + 1 };
            high = if high == 0 { total - 1 } else { high - 1 };
        }
        if count % 2 == 1 {
            self.put(low, self.order[low] ^ 1);
        }
        if self.logging {
            self.changes.push(Change::Reversed { first, count });
        }
    }

    /// Reverses the pieces from `from` on to `to`, or all others, which is the same tour.
    pub(super) fn reverse(&mut self, from: u32, to: u32) {
        let total = self.order.len();
        let first = self.place_of(from);
        let count = self.steps(from, to) + 1;
        if 2 * count <= total {
            self.reverse_places(first, count);
        } else {
            self.reverse_places((first + count) % total, total - count);
        }
    }

    /// Rotates `count` places from `first` to the left by `by`.
    pub(super) fn rotate(&mut self, first: usize, count: usize, by: usize) {
        let total = self.order.len();
        let index = |k: usize| (first + k) % total;
        // The shorter part is kept aside while the longer one shifts.
        if by <= count - by {
            let aside: Vec<u32> = (0..by).map(|k| self.order[index(k)]).collect();
            for k in 0..count - by {
                self.put(index(k), self.order[index(k + by)]);
            }
            for (k, piece) in aside.into_iter().enumerate() {
                self.put(index(count - by + k), piece);
            }
        } else {
            let aside: Vec<u32> = (by..count).map(|k| self.order[index(k)]).collect();
            for k in (0..by).rev() {
                self.put(index(count - by + k), self.order[index(k)]);
            }
            for (k, piece) in aside.into_iter().enumerate() {
                self.put(index(k), piece);
            }
        }
        if self.logging {
            self.changes.push(Change::Rotated { first, count, by });
        }
    }

    pub(super) fn undo(&mut self) {
        self.logging = false;
        while let Some(change) = self.changes.pop() {
            match change {
                Change::Reversed { first, count } => self.reverse_places(first, count),
                Change::Rotated { first, count, by } => self.rotate(first, count, count - by),
            }
        }
    }

    /// Moves the pieces from `from` on to `to` between `after` and the piece behind it.
    pub(super) fn move_between(&mut self, from: u32, to: u32, after: u32, reversed: bool) {
        let total = self.order.len();
        let length = self.steps(from, to) + 1;
        let first = self.place_of(from);
        if reversed {
            self.reverse_places(first, length);
        }
        // Pieces between the segment and its new place, forwards.
        let ahead = (self.place_of(after) + total - (first + length - 1)) % total;
        let behind = total - length - ahead;
        if ahead <= behind {
            self.rotate(first, length + ahead, length);
        } else {
            self.rotate((first + total - behind) % total, length + behind, behind);
        }
    }
}
