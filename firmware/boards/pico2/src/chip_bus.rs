//! One-wire bus of the chips of the drives: UART0, 115,200 baud, 8 data bits, no parity.
//!
//! GP1 receives from the wire, and GP0 drives it over a resistor. The main loop polls the bus
//! between all handlers: it takes no time of a control period. The FIFO of the transmitter has a
//! whole datagram, so that a handler between two bytes makes no pause on the wire; at this baud
//! rate a chip even takes pauses of two control periods.

use crate::chips::Keeper;
use crate::clocks::{CYCLES_PER_US, cycles};
use crate::pins;
use crate::registers::{read, write};
use core::convert::Infallible;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use haptimill_drivers::tmc2209::Bus;

/// The UART.
const UART0: usize = 0x4007_0000;
const BAUD: u32 = 115_200;
/// Divider of 150 MHz / (16 * 115,200 baud) = 81 + 24/64: 115,207 baud.
const WHOLE: u32 = 81;
const FRACTION: u32 = 24;

const DATA: usize = 0x0;
const FLAGS: usize = 0x18;
const BUSY: u32 = 1 << 3;
const RECEIVER_EMPTY: u32 = 1 << 4;
const TRANSMITTER_FULL: u32 = 1 << 5;

/// Errors of a received byte: framing, parity, break, overrun.
const FRAMING: u32 = 1 << 8;
const PARITY: u32 = 1 << 9;
const BREAK: u32 = 1 << 10;
const OVERRUN: u32 = 1 << 11;

struct Uart;

impl ErrorType for Uart {
    type Error = ErrorKind;
}

impl Read<u8> for Uart {
    fn read(&mut self) -> nb::Result<u8, ErrorKind> {
        if read(UART0, FLAGS) & RECEIVER_EMPTY != 0 {
            return Err(nb::Error::WouldBlock);
        }
        let word = read(UART0, DATA);
        let errors = [
            (OVERRUN, ErrorKind::Overrun),
            (FRAMING | BREAK, ErrorKind::FrameFormat),
            (PARITY, ErrorKind::Parity),
        ];
        match errors.into_iter().find(|(bits, _)| word & bits != 0) {
            None => Ok(word as u8),
            Some((_, error)) => Err(nb::Error::Other(error)),
        }
    }
}

impl Write<u8> for Uart {
    fn write(&mut self, byte: u8) -> nb::Result<(), ErrorKind> {
        if read(UART0, FLAGS) & TRANSMITTER_FULL != 0 {
            return Err(nb::Error::WouldBlock);
        }
        write(UART0, DATA, u32::from(byte));
        Ok(())
    }

    fn flush(&mut self) -> nb::Result<(), ErrorKind> {
        match read(UART0, FLAGS) & BUSY {
            0 => Ok(()),
            _ => Err(nb::Error::WouldBlock),
        }
    }
}

/// Starts the UART and its pins.
fn start() {
    write(UART0, 0x24, WHOLE);
    write(UART0, 0x28, FRACTION);
    // 8 bits, FIFOs. Then transmitter, receiver, UART enabled.
    write(UART0, 0x2C, 0x70);
    write(UART0, 0x30, 0x301);
    pins::give_to_chip_bus();
}

/// Keeps the chips of the drives configured, for ever.
pub async fn serve(keeper: Keeper) -> Infallible {
    let mut bus = Bus::new(Uart, cycles, CYCLES_PER_US, BAUD);
    keeper
        .keep(&mut bus, cycles, CYCLES_PER_US, start, || {
            !pins::drives_are_on()
        })
        .await
}
