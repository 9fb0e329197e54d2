//! Reliable messages under way: stored until the peer acknowledges them.

use super::WINDOW;
use crate::frame::Acknowledgement;
use heapless::Deque;

/// A reliable message under way.
#[derive(Debug, Clone, Copy)]
struct Outgoing {
    /// Length of its payload, bytes.
    length: u16,
    /// Time of its last transmission, and its number in the order of all transmissions; `None`
    /// before the first one.
    sent: Option<(u64, u32)>,
    /// It was sent more than once, so its round trip is unknown (Karn).
    again: bool,
    /// The peer has received it, beyond a gap.
    arrived: bool,
    /// A frame that was sent later has arrived, so this one is lost.
    lost: bool,
}

/// Reliable messages under way, oldest first, with their payloads in the same order.
#[derive(Debug)]
pub(super) struct Outbox<const BYTES: usize> {
    payloads: [u8; BYTES],
    used: usize,
    queue: Deque<Outgoing, WINDOW>,
    /// Sequence number of the oldest message.
    oldest: u8,
    /// Number of transmissions; it gives their order.
    order: u32,
    /// Smoothed round trip and its mean deviation, microseconds times 8 and times 4 (Jacobson).
    round_trip: Option<(u32, u32)>,
    /// Doublings of the resend time since the last progress.
    back_off: u8,
    /// Time of the last acknowledgement, or of the first transmission.
    progress_us: Option<u64>,
    /// Number of resent frames.
    pub(super) resent: u32,
}

/// Upper bound of a measured round trip: 16 s.
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
    /// Clears everything except the counter.
    pub(super) fn clear(&mut self) {
        *self = Self {
            resent: self.resent,
            ..Self::default()
        };
    }

    /// Number of messages under way.
    pub(super) fn len(&self) -> usize {
        self.queue.len()
    }

    /// Number of messages of this size that fit now.
    pub(super) fn room(&self, bytes: usize) -> usize {
        let fit = (BYTES - self.used) / bytes.max(1);
        fit.min(WINDOW - self.queue.len())
    }

    /// Time without an acknowledgement while messages are under way, microseconds.
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

    /// Buffer for the next message, which [`Outbox::push`] then takes.
    pub(super) fn free(&mut self) -> &mut [u8] {
        self.payloads.get_mut(self.used..).unwrap_or_default()
    }

    /// Takes the message of `length` bytes that was written to [`Outbox::free`]. Returns false when
    /// it does not fit.
    pub(super) fn push(&mut self, length: usize) -> bool {
        if self.queue.is_full() || length > BYTES - self.used {
            return false;
        }
        self.used += length;
        let outgoing = Outgoing {
            // No outbox is as large as 2^16 bytes.
            length: length as u16,
            sent: None,
            again: false,
            arrived: false,
            lost: false,
        };
        // The queue was checked above.
        self.queue.push_back(outgoing).is_ok()
    }

    /// Returns the next frame to send or resend: its sequence number and payload.
    pub(super) fn next(&mut self, now_us: u64, bounds: (u32, u32)) -> Option<(u8, &[u8])> {
        if self.queue.is_empty() {
            return None;
        }
        let timeout = self.resend_timeout_us(bounds);
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
                let late = waited >= timeout;
                if !late && !outgoing.lost {
                    continue;
                }
                // Only for the oldest message: a window that is late as a whole is one event.
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

    /// Time at which the next frame is to be resent, if [`Outbox::next`] has none now and nothing
    /// is received until then.
    pub(super) fn due_us(&self, bounds: (u32, u32)) -> u64 {
        let waits = self.queue.iter().filter(|outgoing| !outgoing.arrived);
        waits.fold(u64::MAX, |soonest, outgoing| {
            let sent_us = outgoing.sent.map_or(0, |(at, _)| at);
            soonest.min(sent_us.saturating_add(self.resend_timeout_us(bounds)))
        })
    }

    /// Applies an acknowledgement of the peer.
    pub(super) fn acknowledge(&mut self, now_us: u64, acknowledgement: Acknowledgement) {
        let confirmed = usize::from(acknowledgement.next.wrapping_sub(self.oldest));
        let sent = self
            .queue
            .iter()
            .take_while(|outgoing| outgoing.sent.is_some())
            .count();
        if confirmed > sent {
            // A late acknowledgement from before the known state: nothing new.
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

    /// Time that a frame waits for its acknowledgement, microseconds.
    fn resend_timeout_us(&self, (min, max): (u32, u32)) -> u64 {
        // Before the first measurement: a quarter of the longest time.
        let usual = self.round_trip.map_or(max / 4, |(smooth, deviation)| {
            (smooth / 8).saturating_add(deviation)
        });
        (u64::from(usual.max(min)) << self.back_off).min(u64::from(max.max(min)))
    }
}

/// Adds a round trip to the estimate (Jacobson's filter with gains 1/8 and 1/4; the sum is the mean
/// plus 4 deviations).
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
