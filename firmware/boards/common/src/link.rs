//! Rings between the line to the host and the controller.

use haptimill_firmware::comm::rx_ring::{RING_BYTES, ReceiveRing, Receiver, Waiting};
use heapless::spsc::{Consumer, Producer, Queue};

/// Bytes of the transmit ring; one stays free.
const TRANSMIT_RING: usize = 257;

/// Both rings.
#[derive(Default)]
pub struct Rings {
    receive: ReceiveRing<{ RING_BYTES + 1 }>,
    transmit: Queue<u8, TRANSMIT_RING>,
}

/// Ends of the rings at the line.
pub struct Wire<'a> {
    /// Takes received bytes.
    pub receiver: Receiver<'a>,
    /// Bytes to send.
    pub outgoing: Consumer<'a, u8>,
}

/// Ends of the rings at the controller.
pub struct Bytes<'a> {
    /// Received bytes.
    pub waiting: Waiting<'a>,
    transmit: Producer<'a, u8>,
}

impl Rings {
    /// Empty rings.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            receive: ReceiveRing::new(),
            transmit: Queue::new(),
        }
    }

    /// Splits both rings into their ends.
    pub fn split(&mut self) -> (Wire<'_>, Bytes<'_>) {
        let (receiver, waiting) = self.receive.split();
        let (transmit, outgoing) = self.transmit.split();
        (Wire { receiver, outgoing }, Bytes { waiting, transmit })
    }
}

impl Bytes<'_> {
    /// Bytes that can be sent in this period.
    #[must_use]
    pub fn room(&self) -> u16 {
        (self.transmit.capacity() - self.transmit.len()) as u16
    }

    /// Sends bytes; the controller gives no more than [`Bytes::room`].
    pub fn send(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if self.transmit.enqueue(byte).is_err() {
                return;
            }
        }
    }
}
