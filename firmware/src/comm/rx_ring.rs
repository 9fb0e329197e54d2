//! A board's receive ring: where bytes of the host wait between the interrupt that takes them from the line and the control period.
//!
//! The interrupt has the [`Receiver`], the control period the [`Waiting`] end; both come from one [`ReceiveRing`] and neither ever waits for the
//! other. The urgent stop is recognised on the interrupt's side, whatever waits in the ring, also in a byte that finds the ring full.
//!
//! Misuse: the [`Receiver`] belongs to one interrupt; two that push would lose bytes without counting them.

use crate::io::{Inputs, RECEIVE_BYTES};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use haptimill_protocol::urgent::UrgentDetector;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer, Queue};

/// Bytes that wait at most on a board with the usual ring, `ReceiveRing<{ RING_BYTES + 1 }>`.
pub const RING_BYTES: usize = 4095;

/// What both ends see, besides the bytes.
#[derive(Debug, Default)]
struct Shared {
    urgent: AtomicBool,
    lost: AtomicU32,
    peak: AtomicU32,
    seen: AtomicU32,
}

/// A ring of `N` bytes, one of which stays free.
#[derive(Default)]
pub struct ReceiveRing<const N: usize> {
    queue: Queue<u8, N>,
    detector: UrgentDetector,
    shared: Shared,
}

/// The interrupt's end.
pub struct Receiver<'a> {
    queue: Producer<'a, u8>,
    detector: &'a mut UrgentDetector,
    shared: &'a Shared,
}

/// The control period's end.
pub struct Waiting<'a> {
    queue: Consumer<'a, u8>,
    shared: &'a Shared,
}

impl<const N: usize> ReceiveRing<N> {
    /// An empty ring.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            queue: Queue::new(),
            detector: UrgentDetector::new(),
            shared: Shared {
                urgent: AtomicBool::new(false),
                lost: AtomicU32::new(0),
                peak: AtomicU32::new(0),
                seen: AtomicU32::new(0),
            },
        }
    }

    /// Its two ends.
    pub fn split(&mut self) -> (Receiver<'_>, Waiting<'_>) {
        let (producer, consumer) = self.queue.split();
        let receiver = Receiver {
            queue: producer,
            detector: &mut self.detector,
            shared: &self.shared,
        };
        let waiting = Waiting {
            queue: consumer,
            shared: &self.shared,
        };
        (receiver, waiting)
    }
}

impl Receiver<'_> {
    /// Takes a byte from the line.
    #[inline]
    pub fn push(&mut self, byte: u8) {
        if self.detector.push(byte) {
            self.shared.urgent.store(true, Ordering::Release);
        }
        if self.queue.enqueue(byte).is_err() {
            add(&self.shared.lost);
        }
        let fill = self.queue.len() as u32;
        if fill > self.shared.peak.load(Ordering::Relaxed) {
            self.shared.peak.store(fill, Ordering::Relaxed);
        }
        add(&self.shared.seen);
    }
}

/// One more; only the interrupt writes, so load and store do.
fn add(count: &AtomicU32) {
    let now = count.load(Ordering::Relaxed);
    count.store(now.wrapping_add(1), Ordering::Release);
}

impl Waiting<'_> {
    /// Fills in what came over the line for a control period: at most [`RECEIVE_BYTES`], the rest waits.
    pub fn take(&mut self, inputs: &mut Inputs) {
        // Before the bytes: a stop that comes now is seen now or in the next period, never lost.
        inputs.urgent = self.shared.urgent.load(Ordering::Acquire);
        if inputs.urgent {
            self.shared.urgent.store(false, Ordering::Release);
        }
        inputs.lost_bytes = self.shared.lost.load(Ordering::Acquire) as u16;
        let count = self.queue.len().min(RECEIVE_BYTES);
        if count > inputs.received.len() {
            // As a whole, and then written in place: to push byte after byte takes three times as long.
            inputs.received = Vec::from_array([0; RECEIVE_BYTES]);
        }
        inputs.received.truncate(count);
        for place in &mut inputs.received {
            // So many are there, and nobody else takes them.
            *place = self.queue.dequeue().unwrap_or_default();
        }
        inputs.waiting = self.queue.len().min(usize::from(u16::MAX)) as u16;
    }

    /// Bytes that came so far, lost ones included; wraps around.
    #[must_use]
    pub fn seen(&self) -> u32 {
        self.shared.seen.load(Ordering::Acquire)
    }

    /// The most bytes that ever waited.
    #[must_use]
    pub fn peak(&self) -> u32 {
        self.shared.peak.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_protocol::urgent;
    use std::vec::Vec;

    extern crate std;

    /// A flood: the oldest bytes are kept in order, the rest is counted, and a stop among the lost ones is seen once.
    #[test]
    fn an_overrun_loses_the_newest_and_no_stop() {
        let mut ring = ReceiveRing::<256>::new();
        let (mut receiver, mut waiting) = ring.split();
        let flood: Vec<u8> = (0..400).map(|k| (k % 23) as u8 + 40).collect();
        flood.iter().for_each(|&byte| receiver.push(byte));
        urgent::STOP
            .iter()
            .chain(&[7])
            .for_each(|&byte| receiver.push(byte));
        assert_eq!((waiting.seen(), waiting.peak()), (404, 255));
        let mut inputs = Inputs::default();
        let mut heard = Vec::new();
        for period in 0..5 {
            waiting.take(&mut inputs);
            heard.extend_from_slice(&inputs.received);
            assert_eq!(inputs.urgent, period == 0);
            assert_eq!(usize::from(inputs.waiting), 255 - heard.len());
            assert_eq!(inputs.lost_bytes, 149);
        }
        assert_eq!(heard, flood[..255]);
        receiver.push(9);
        waiting.take(&mut inputs);
        assert_eq!(inputs.received, [9]);
    }
}
