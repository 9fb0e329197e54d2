//! Line to the host: UART0, 1 Mbaud, 8 data bits, no parity.
//!
//! No interrupt: the FIFOs of 32 bytes hold more than the 20 bytes of a control period, and SysTick
//! empties and fills them in every period, also while a late period still computes.

use crate::registers::{UART0, read, write};
use haptimill_firmware::comm::rx_ring::{RING_BYTES, ReceiveRing, Receiver, Waiting};
use heapless::spsc::{Consumer, Producer, Queue};

/// Divider of 150 MHz / (16 * 1 Mbaud) = 9 + 24/64.
const WHOLE: u32 = 9;
const FRACTION: u32 = 24;

const DATA: usize = 0x0;
const ERRORS: usize = 0x4;
const FLAGS: usize = 0x18;
const TRANSMITTER_FULL: u32 = 1 << 5;
const RECEIVER_EMPTY: u32 = 1 << 4;

/// Bytes of the transmit ring; one stays free.
const TRANSMIT_RING: usize = 257;

/// Rings of the line.
pub struct Rings {
    receive: ReceiveRing<{ RING_BYTES + 1 }>,
    transmit: Queue<u8, TRANSMIT_RING>,
}

/// Ends of the rings at the UART.
pub struct Wire {
    receiver: Receiver<'static>,
    outgoing: Consumer<'static, u8>,
}

/// Ends of the rings at the controller.
pub struct Bytes {
    /// Received bytes.
    pub waiting: Waiting<'static>,
    transmit: Producer<'static, u8>,
}

impl Rings {
    /// Empty rings.
    pub const fn new() -> Self {
        Self {
            receive: ReceiveRing::new(),
            transmit: Queue::new(),
        }
    }

    /// Splits the rings.
    pub fn split(&'static mut self) -> (Wire, Bytes) {
        let (receiver, waiting) = self.receive.split();
        let (transmit, outgoing) = self.transmit.split();
        let wire = Wire { receiver, outgoing };
        (wire, Bytes { waiting, transmit })
    }
}

/// Starts the UART.
pub fn start() {
    write(UART0, 0x24, WHOLE);
    write(UART0, 0x28, FRACTION);
    // 8 bits, FIFOs. Then transmitter, receiver, UART enabled.
    write(UART0, 0x2C, 0x70);
    write(UART0, 0x30, 0x301);
}

impl Wire {
    /// Takes what has arrived, and sends what waits.
    pub fn exchange(&mut self) {
        while read(UART0, FLAGS) & RECEIVER_EMPTY == 0 {
            self.receiver.push(read(UART0, DATA) as u8);
        }
        write(UART0, ERRORS, 0);
        while read(UART0, FLAGS) & TRANSMITTER_FULL == 0 {
            let Some(byte) = self.outgoing.dequeue() else {
                return;
            };
            write(UART0, DATA, u32::from(byte));
        }
    }
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
