//! Rings between the line to the host and the controller.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use haptimill_firmware::comm::rx_ring::{RING_BYTES, ReceiveRing, Receiver, Waiting};
use heapless::spsc::{Consumer, Producer, Queue};

/// Bytes of the transmit ring; one stays free.
const TRANSMIT_RING: usize = 257;

struct Rings {
    receive: ReceiveRing<{ RING_BYTES + 1 }>,
    transmit: Queue<u8, TRANSMIT_RING>,
}

/// Ends of the rings at the line.
pub struct Wire {
    /// Takes received bytes.
    pub receiver: Receiver<'static>,
    /// Bytes to send.
    pub outgoing: Consumer<'static, u8>,
}

/// Ends of the rings at the controller.
pub struct Bytes {
    /// Received bytes.
    pub waiting: Waiting<'static>,
    transmit: Producer<'static, u8>,
}

struct Place(UnsafeCell<MaybeUninit<Rings>>);

// SAFETY: only `start` uses it, once; the ends of the rings are made for two contexts.
unsafe impl Sync for Place {}

static RINGS: Place = Place(UnsafeCell::new(MaybeUninit::uninit()));

/// Makes the rings. Only `main` calls it, once.
pub fn start() -> (Wire, Bytes) {
    // SAFETY: called once, so this is the only reference.
    let place = unsafe { &mut *RINGS.0.get() };
    let rings = place.write(Rings {
        receive: ReceiveRing::new(),
        transmit: Queue::new(),
    });
    let (receiver, waiting) = rings.receive.split();
    let (transmit, outgoing) = rings.transmit.split();
    (Wire { receiver, outgoing }, Bytes { waiting, transmit })
}

impl Bytes {
    /// Bytes that can be sent in this period.
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
