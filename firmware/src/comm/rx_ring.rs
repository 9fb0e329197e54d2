//! Receive ring of a board: bytes from the host wait here between the receive interrupt and the
//! control period.
//!
//! [`ReceiveRing::split`] gives the [`Receiver`] to the interrupt and the [`Waiting`] end to the
//! control period. Neither waits for the other. The interrupt side recognises the out-of-band stop,
//! whatever waits in the ring, also in a byte that finds the ring full.
//!
//! Callers must push from one interrupt only: two that push would lose bytes without counting them.

use crate::io::{Inputs, RECEIVE_BYTES};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use haptimill_protocol::out_of_band::StopDetector;
use heapless::Vec;
use heapless::spsc::{Consumer, Producer, Queue};

/// Capacity of the usual ring, `ReceiveRing<{ RING_BYTES + 1 }>`, in bytes.
pub const RING_BYTES: usize = 4095;

/// State that both ends share, besides the bytes.
#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    lost: AtomicU32,
    peak: AtomicU32,
    received_count: AtomicU32,
}

/// A ring of `N` bytes, one of which stays free.
#[derive(Default)]
pub struct ReceiveRing<const N: usize> {
    queue: Queue<u8, N>,
    detector: StopDetector,
    shared: Shared,
}

/// End of the receive interrupt.
pub struct Receiver<'a> {
    queue: Producer<'a, u8>,
    detector: &'a mut StopDetector,
    shared: &'a Shared,
}

/// End of the control period.
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
            detector: StopDetector::new(),
            shared: Shared {
                stop: AtomicBool::new(false),
                lost: AtomicU32::new(0),
                peak: AtomicU32::new(0),
                received_count: AtomicU32::new(0),
            },
        }
    }

    /// Splits the ring into its two ends.
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
    /// Takes a byte from the line. A full ring drops it and counts it.
    #[inline]
    pub fn push(&mut self, byte: u8) {
        if self.detector.push(byte) {
            self.shared.stop.store(true, Ordering::Release);
        }
        if self.queue.enqueue(byte).is_err() {
            add(&self.shared.lost);
        }
        let fill = self.queue.len() as u32;
        if fill > self.shared.peak.load(Ordering::Relaxed) {
            self.shared.peak.store(fill, Ordering::Relaxed);
        }
        add(&self.shared.received_count);
    }
}

/// Adds one. Only the interrupt writes, so load and store suffice.
fn add(count: &AtomicU32) {
    let now = count.load(Ordering::Relaxed);
    count.store(now.wrapping_add(1), Ordering::Release);
}

impl Waiting<'_> {
    /// Fills in the serial-line inputs of a control period: at most [`RECEIVE_BYTES`] bytes, the
    /// rest waits.
    pub fn take(&mut self, inputs: &mut Inputs) {
        // Read before the bytes: a stop that arrives now is seen now or in the next period, never
        // lost.
        inputs.out_of_band_stop = self.shared.stop.load(Ordering::Acquire);
        if inputs.out_of_band_stop {
            self.shared.stop.store(false, Ordering::Release);
        }
        inputs.lost_bytes = self.shared.lost.load(Ordering::Acquire) as u16;
        let count = self.queue.len().min(RECEIVE_BYTES);
        if count > inputs.received.len() {
            // Resized as a whole and written in place: pushing byte after byte takes three times as
            // long.
            inputs.received = Vec::from_array([0; RECEIVE_BYTES]);
        }
        inputs.received.truncate(count);
        for place in &mut inputs.received {
            // Never empty here: nothing else takes bytes.
            *place = self.queue.dequeue().unwrap_or_default();
        }
        inputs.waiting = self.queue.len().min(usize::from(u16::MAX)) as u16;
    }

    /// Bytes received so far, including lost ones; wraps around.
    #[must_use]
    pub fn received_count(&self) -> u32 {
        self.shared.received_count.load(Ordering::Acquire)
    }

    /// Largest number of bytes that have waited.
    #[must_use]
    pub fn peak(&self) -> u32 {
        self.shared.peak.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_protocol::out_of_band;
    use std::vec::Vec;

    extern crate std;

    /// In an overrun the ring keeps the oldest bytes in order and counts the rest. A stop among the
    /// lost bytes is seen once.
    #[test]
    fn an_overrun_loses_the_newest_and_no_stop() {
        let mut ring = ReceiveRing::<256>::new();
        let (mut receiver, mut waiting) = ring.split();
        let flood: Vec<u8> = (0..400).map(|k| (k % 23) as u8 + 40).collect();
        flood.iter().for_each(|&byte| receiver.push(byte));
        out_of_band::STOP
            .iter()
            .chain(&[7])
            .for_each(|&byte| receiver.push(byte));
        assert_eq!((waiting.received_count(), waiting.peak()), (404, 255));
        let mut inputs = Inputs::default();
        let mut received = Vec::new();
        for period in 0..5 {
            waiting.take(&mut inputs);
            received.extend_from_slice(&inputs.received);
            assert_eq!(inputs.out_of_band_stop, period == 0);
            assert_eq!(usize::from(inputs.waiting), 255 - received.len());
            assert_eq!(inputs.lost_bytes, 149);
        }
        assert_eq!(received, flood[..255]);
        receiver.push(9);
        waiting.take(&mut inputs);
        assert_eq!(inputs.received, [9]);
    }
}
