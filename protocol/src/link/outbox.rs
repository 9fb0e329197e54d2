//! Reliable messages under way: kept until the peer has them.

use super::WINDOW;
use crate::frame::Acknowledgement;
use heapless::Deque;

/// A message under way.
#[derive(Debug, Clone, Copy)]
struct Outgoing {
    /// Bytes of its payload.
    length: u16,
    /// When it was last sent, and as which frame of all; `None` before the first time.
    sent: Option<(u64, u32)>,
    /// It was sent more than once: its round trip cannot be told (Karn).
    again: bool,
    /// The peer has it, beyond a gap.
    arrived: bool,
    /// A frame that was sent later has arrived: this one is lost.
    lost: bool,
}

/// Reliable messages under way, oldest first, their payloads one after the other.
#[derive(Debug)]
pub(super) struct Outbox<const BYTES: usize> {
    payloads: [u8; BYTES],
    used: usize,
    queue: Deque<Outgoing, WINDOW>,
    /// Sequence number of the oldest.
    oldest: u8,
    /// Frames sent, to tell which was sent before which.
    order: u32,
    /// Smoothed round trip and its mean deviation, microseconds times 8 and times 4 (Jacobson).
    round_trip: Option<(u32, u32)>,
    /// Doublings of the resend time since the last news.
    back_off: u8,
    /// When something was last confirmed, or the first message was sent.
    progress_us: Option<u64>,
    /// Frames sent again.
    pub(super) resent: u32,
}

/// A round trip is at most taken for this long: 16 s.
const LONGEST_US: u64 = 1 << 24;

impl<const BYTES: usize> Default for Outbox<BYTES> {
    fn default() -> Self {
        Self {
            payloads: [0; BYTES],
            used: 0,
            queue: Deque::new(),
            oldest: 0,
            order: 0,
            round_trip: None,
            back_off: 0,
            progress_us: None,
            resent: 0,
        }
    }
}

impl<const BYTES: usize> Outbox<BYTES> {
    /// Forgets everything but the count.
    pub(super) fn clear(&mut self) {
        *self = Self {
            resent: self.resent,
            ..Self::default()
        };
    }

    /// Messages under way.
    pub(super) fn len(&self) -> usize {
        self.queue.len()
    }

    /// Messages of a size that fit now.
    pub(super) fn room(&self, bytes: usize) -> usize {
        let fit = (BYTES - self.used) / bytes.max(1);
        fit.min(WINDOW - self.queue.len())
    }

    /// How long nothing was confirmed although something is under way.
    pub(super) fn stalled_us(&self, now_us: u64) -> u64 {
        match self.progress_us {
            Some(since) if !self.queue.is_empty() => now_us.saturating_sub(since),
            _ => 0,
        }
    }

    /// Smoothed round trip, microseconds.
    pub(super) fn round_trip_us(&self) -> u32 {
        self.round_trip.map_or(0, |(smooth, _)| smooth / 8)
    }

    /// Where the next message is written before it is taken with [`Outbox::push`].
    pub(super) fn free(&mut self) -> &mut [u8] {
        self.payloads.get_mut(self.used..).unwrap_or_default()
    }

    /// Takes the message of so many bytes that was written to [`Outbox::free`]; false when there was no room.
    pub(super) fn push(&mut self, length: usize) -> bool {
        if self.queue.is_full() || length > BYTES - self.used {
            return false;
        }
        self.used += length;
        let outgoing = Outgoing {
            // Below the room of any outbox.
            length: length as u16,
            sent: None,
            again: false,
            arrived: false,
            lost: false,
        };
        // There is room: asked above.
        self.queue.push_back(outgoing).is_ok()
    }

    /// The next frame to send, or to send again: its number and payload.
    pub(super) fn next(&mut self, now_us: u64, bounds: (u32, u32)) -> Option<(u8, &[u8])> {
        if self.queue.is_empty() {
            return None;
        }
        let patience = self.patience_us(bounds);
        let mut start = 0;
        for (index, outgoing) in self.queue.iter_mut().enumerate() {
            let range = start..start + usize::from(outgoing.length);
            start = range.end;
            let waited = match outgoing.sent {
                None => None,
                Some(_) if outgoing.arrived => continue,
                Some((at, _)) => Some(now_us.saturating_sub(at)),
            };
            if let Some(waited) = waited {
                let late = waited >= patience;
                if !late && !outgoing.lost {
                    continue;
                }
                // Only the oldest: a window that is late as a whole is one event.
                if !outgoing.lost && index == 0 {
                    self.back_off = (self.back_off + 1).min(4);
                }
                outgoing.again = true;
                self.resent = self.resent.saturating_add(1);
            }
            outgoing.sent = Some((now_us, self.order));
            outgoing.lost = false;
            self.order = self.order.wrapping_add(1);
            self.progress_us.get_or_insert(now_us);
            let payload = self.payloads.get(range)?;
            return Some((self.oldest.wrapping_add(index as u8), payload));
        }
        None
    }

    /// When the next frame is to be sent again, where [`Outbox::next`] has none now and nothing is heard until then.
    pub(super) fn due_us(&self, bounds: (u32, u32)) -> u64 {
        let waits = self.queue.iter().filter(|outgoing| !outgoing.arrived);
        waits.fold(u64::MAX, |soonest, outgoing| {
            let sent_us = outgoing.sent.map_or(0, |(at, _)| at);
            soonest.min(sent_us.saturating_add(self.patience_us(bounds)))
        })
    }

    /// The peer says what arrived.
    pub(super) fn acknowledge(&mut self, now_us: u64, acknowledgement: Acknowledgement) {
        let confirmed = usize::from(acknowledgement.next.wrapping_sub(self.oldest));
        let sent = self
            .queue
            .iter()
            .take_while(|outgoing| outgoing.sent.is_some())
            .count();
        if confirmed > sent {
            // Late, from before what is known already; nothing new in it.
            return;
        }
        let mut newest: Option<u32> = None;
        let mut arrived = |outgoing: &Outgoing, round_trip: &mut Option<(u32, u32)>| {
            let Some((at, order)) = outgoing.sent else {
                return;
            };
            if newest.is_none_or(|known| order.wrapping_sub(known) as i32 > 0) {
                newest = Some(order);
            }
            if !outgoing.again {
                measure(round_trip, now_us.saturating_sub(at));
            }
        };
        let mut bytes = 0;
        let mut news = confirmed > 0;
        for _ in 0..confirmed {
            if let Some(outgoing) = self.queue.pop_front() {
                bytes += usize::from(outgoing.length);
                if !outgoing.arrived {
                    arrived(&outgoing, &mut self.round_trip);
                }
            }
        }
        self.oldest = acknowledgement.next;
        let bytes = bytes.min(self.used);
        if bytes != 0 {
            self.payloads.copy_within(bytes..self.used, 0);
            self.used -= bytes;
        }
        for (bit, outgoing) in self.queue.iter_mut().skip(1).take(8).enumerate() {
            if acknowledgement.beyond & (1 << bit) != 0
                && outgoing.sent.is_some()
                && !outgoing.arrived
            {
                arrived(outgoing, &mut self.round_trip);
                outgoing.arrived = true;
                news = true;
            }
        }
        if let Some(newest) = newest {
            for outgoing in self.queue.iter_mut().filter(|outgoing| !outgoing.arrived) {
                if let Some((_, order)) = outgoing.sent {
                    outgoing.lost |= (newest.wrapping_sub(order) as i32) > 0;
                }
            }
        }
        if news {
            self.back_off = 0;
            self.progress_us = if self.queue.is_empty() {
                None
            } else {
                Some(now_us)
            };
        }
    }

    /// How long a frame waits for its acknowledgement.
    fn patience_us(&self, (least, most): (u32, u32)) -> u64 {
        // Before the first measurement: a quarter of the longest.
        let usual = self.round_trip.map_or(most / 4, |(smooth, deviation)| {
            (smooth / 8).saturating_add(deviation)
        });
        (u64::from(usual.max(least)) << self.back_off).min(u64::from(most.max(least)))
    }
}

/// Takes a round trip into the estimate (Jacobson's filter: gains 1/8 and 1/4, the sum being mean + 4 deviations).
fn measure(estimate: &mut Option<(u32, u32)>, trip_us: u64) {
    let trip = trip_us.min(LONGEST_US) as u32;
    *estimate = Some(match *estimate {
        None => (trip * 8, trip * 2),
        Some((smooth, deviation)) => {
            let off = trip.abs_diff(smooth / 8);
            (smooth - smooth / 8 + trip, deviation - deviation / 4 + off)
        }
    });
}
