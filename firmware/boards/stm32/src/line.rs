//! Line to the host: USART3, 1 Mbaud, 8 data bits, no parity. Its interrupt takes and sends single
//! bytes, more urgently than the control period.

use crate::registers::{USART3, USART3_INTERRUPT, read, write};
use cortex_m::peripheral::NVIC;
use haptimill_board_common::link::{Bytes, Rings, Wire};
use haptimill_board_cortex::shared::Shared;

const STATUS: usize = 0x0;
const DATA: usize = 0x4;
const DIVIDER: usize = 0x8;
const CONTROL: usize = 0xC;

/// Bits of the status: a byte waits, the transmitter takes one, and an error of the line.
const RECEIVED: u32 = 1 << 5;
const TRANSMITTER_EMPTY: u32 = 1 << 7;
const OVERRUN: u32 = 1 << 3;
/// The USART, its receiver with an interrupt, its transmitter.
const ENABLED: u32 = 1 << 13 | 1 << 5 | 1 << 3 | 1 << 2;
/// An interrupt while the transmitter takes a byte.
const SENDING: u32 = 1 << 7;
/// 42 MHz / (16 * 1 Mbaud) = 2 + 10/16.
const BAUD: u32 = 2 << 4 | 10;
/// More urgent than the control period, less than a fault.
const PRIORITY: u8 = 0x40;

// `start` writes both, once, before the interrupt is enabled. From then on only the interrupt uses
// the wire, and the ends of the rings are made for two contexts.
static RINGS: Shared<Rings> = Shared::new();
static WIRE: Shared<Wire<'static>> = Shared::new();

/// The controller's end of the line.
pub struct Line(Bytes<'static>);

/// Starts the line. Only `main` calls it, once.
pub fn start(nvic: &mut NVIC) -> Line {
    // SAFETY: called once, and the interrupt is not enabled yet: these are the only references.
    let (rings, place) = unsafe { (RINGS.place(), WIRE.place()) };
    let (wire, bytes) = rings.write(Rings::new()).split();
    place.write(wire);
    write(USART3, DIVIDER, BAUD);
    write(USART3, CONTROL, ENABLED);
    // SAFETY: the wire is in place; no critical section depends on priorities.
    unsafe {
        nvic.set_priority(USART3_INTERRUPT, PRIORITY);
        NVIC::unmask(USART3_INTERRUPT);
    }
    Line(bytes)
}

impl core::ops::Deref for Line {
    type Target = Bytes<'static>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl core::ops::DerefMut for Line {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl Line {
    /// Sends bytes.
    pub fn transmit(&mut self, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.0.send(bytes);
            // The interrupt ends it when the ring is empty. If it does so now, it runs once more.
            write(USART3, CONTROL, ENABLED | SENDING);
        }
    }
}

/// Handler of the USART.
pub extern "C" fn serve() {
    // SAFETY: `start` wrote the wire before it enabled this interrupt, which alone uses it and does
    // not preempt itself.
    let wire = unsafe { WIRE.get() };
    let status = read(USART3, STATUS);
    if status & (RECEIVED | OVERRUN) != 0 {
        // Reading it ends the flags of errors, too. A byte with a wrong frame goes on: the frames
        // of the protocol have a check.
        let byte = read(USART3, DATA) as u8;
        if status & RECEIVED != 0 {
            wire.receiver.push(byte);
        }
    }
    if status & TRANSMITTER_EMPTY != 0 {
        match wire.outgoing.dequeue() {
            Some(byte) => write(USART3, DATA, u32::from(byte)),
            None => write(USART3, CONTROL, ENABLED),
        }
    }
}
