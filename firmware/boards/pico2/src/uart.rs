//! Line to the host: UART0, 1 Mbaud, 8 data bits, no parity.
//!
//! No interrupt: the FIFOs of 32 bytes hold more than the 20 bytes of a control period, and SysTick
//! empties and fills them in every period, also while a late period still computes.

use crate::chips::Keeper;
use crate::ending::Lamp;
use crate::link::Wire;
use crate::registers::{read, write};
use crate::storage;

/// The UART.
const UART0: usize = 0x4007_0000;
/// Divider of 150 MHz / (16 * 1 Mbaud) = 9 + 24/64.
const WHOLE: u32 = 9;
const FRACTION: u32 = 24;

const DATA: usize = 0x0;
const ERRORS: usize = 0x4;
const FLAGS: usize = 0x18;
const TRANSMITTER_FULL: u32 = 1 << 5;
const RECEIVER_EMPTY: u32 = 1 << 4;

/// The part of the line that SysTick serves.
pub struct InPeriod(Wire);

/// The part of the line that is served between the control periods: none.
pub struct Between;

/// Starts the UART.
pub fn start(wire: Wire) -> (InPeriod, Between) {
    write(UART0, 0x24, WHOLE);
    write(UART0, 0x28, FRACTION);
    // 8 bits, FIFOs. Then transmitter, receiver, UART enabled.
    write(UART0, 0x2C, 0x70);
    write(UART0, 0x30, 0x301);
    (InPeriod(wire), Between)
}

impl InPeriod {
    /// Takes what has arrived, and sends what waits.
    pub fn exchange(&mut self) {
        let wire = &mut self.0;
        while read(UART0, FLAGS) & RECEIVER_EMPTY == 0 {
            wire.receiver.push(read(UART0, DATA) as u8);
        }
        write(UART0, ERRORS, 0);
        while read(UART0, FLAGS) & TRANSMITTER_FULL == 0 {
            let Some(byte) = wire.outgoing.dequeue() else {
                return;
            };
            write(UART0, DATA, u32::from(byte));
        }
    }
}

impl Between {
    /// Shows the cause of the last reset for ever.
    pub fn serve(self, mut lamp: Lamp, _: Keeper) -> ! {
        let mut turn = || lamp.update();
        loop {
            turn();
            storage::serve(&mut turn);
        }
    }
}
