//! UART0: the serial line to the host. Its receive interrupt fills the receive ring at any time.
//! Sending waits for the transmitter.

use crate::registers::{UART0, read, write};
use core::cell::UnsafeCell;
use cortex_m::peripheral::NVIC;
use haptimill_firmware::comm::rx_ring::{RING_BYTES, ReceiveRing, Receiver, Waiting};

const DATA: usize = 0x0;
const STATE: usize = 0x4;
const CONTROL: usize = 0x8;
const INTERRUPT: usize = 0xC;
const BAUD_DIVIDER: usize = 0x10;

const TRANSMITTER_FULL: u32 = 1;
const RECEIVER_FULL: u32 = 2;
/// Transmitter, receiver and receive interrupt enabled.
const ENABLED: u32 = 0b1011;

/// Clock of the device, Hz.
const CLOCK_HZ: u32 = 25_000_000;

/// Size of the receive ring, bytes; one byte of it stays free.
pub const RING: usize = RING_BYTES + 1;

/// The receiver, which only the interrupt uses once it is enabled.
struct ForInterrupt(UnsafeCell<Option<Receiver<'static>>>);

// SAFETY: `start` writes it once, before the interrupt is enabled. From then on only the interrupt
// uses it.
unsafe impl Sync for ForInterrupt {}

static RECEIVER: ForInterrupt = ForInterrupt(UnsafeCell::new(None));

/// Interrupt number.
#[derive(Debug, Clone, Copy)]
struct Number(u16);

// SAFETY: the numbers used are in the table below and do not change.
unsafe impl cortex_m::interrupt::InterruptNumber for Number {
    fn number(self) -> u16 {
        self.0
    }
}

const UART0_RX_NUMBER: Number = Number(0);

/// Starts the line. Returns the end of the ring that the control period reads.
pub fn start(ring: &'static mut ReceiveRing<RING>, nvic: &mut NVIC, baud: u32) -> Waiting<'static> {
    let (receiver, waiting) = ring.split();
    // SAFETY: the interrupt is not enabled yet, so nothing else accesses the cell.
    unsafe { *RECEIVER.0.get() = Some(receiver) };
    write(UART0, BAUD_DIVIDER, (CLOCK_HZ / baud.max(1)).max(16));
    write(UART0, CONTROL, ENABLED);
    // SAFETY: the receiver is in place. The interrupt has a higher priority than the control period
    // (see `tick`), so that no byte waits for it, and a lower one than a fault (see `ending`).
    unsafe {
        nvic.set_priority(UART0_RX_NUMBER, 0x40);
        NVIC::unmask(UART0_RX_NUMBER);
    }
    waiting
}

/// Sends bytes to the host.
pub fn say(bytes: &[u8]) {
    send(UART0, bytes);
}

/// Sends bytes over a line at the rate of its transmitter.
pub(crate) fn send(line: usize, bytes: &[u8]) {
    for &byte in bytes {
        while read(line, STATE) & TRANSMITTER_FULL != 0 {}
        write(line, DATA, u32::from(byte));
    }
}

extern "C" fn receive() {
    // SAFETY: only this interrupt uses the cell while it is enabled, and it does not preempt
    // itself.
    let receiver = unsafe { &mut *RECEIVER.0.get() };
    write(UART0, INTERRUPT, RECEIVER_FULL);
    while read(UART0, STATE) & RECEIVER_FULL != 0 {
        let byte = read(UART0, DATA) as u8;
        if let Some(receiver) = receiver {
            receiver.push(byte);
        }
    }
}

/// Handler of all other interrupts.
extern "C" fn unexpected() {
    panic!("an interrupt came that was not enabled");
}

/// Interrupt vectors of the board, by number.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [extern "C" fn(); 32] = {
    let mut table: [extern "C" fn(); 32] = [unexpected; 32];
    table[UART0_RX_NUMBER.0 as usize] = receive;
    table
};
