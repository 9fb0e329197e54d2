//! Flash of the board: the commands of a W25Q32 over the QMI in its direct mode.
//!
//! While the direct mode is on nothing can be read in the memory-mapped window, neither code nor
//! constants. The code of this image and its vector table are in the RAM; what runs from the flash
//! (`.cold` in `image.x`) activates a configuration, which the controller refuses meanwhile.
//! Handlers interrupt the commands: the chip waits while it is selected.

use crate::clocks::{CYCLES_PER_US, cycles};
use crate::registers::{read, write};
use haptimill_board_common::config_store::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read,
    check_write,
};

/// Bytes of the flash.
pub const BYTES: usize = 4 << 20;

/// The QMI: control and status, transmit and receive FIFO of its direct mode.
const QMI: usize = 0x400D_0000;
const CONTROL: usize = 0x0;
const TRANSMIT: usize = 0x4;
const RECEIVE: usize = 0x8;

const DIRECT: u32 = 1;
const BUSY: u32 = 1 << 1;
const SELECT: u32 = 1 << 2;
const RECEIVER_EMPTY: u32 = 1 << 16;
/// Divider of the clock, 25 MHz: below the 50 MHz of the slowest command of the flash, 03h.
const DIVIDER: u32 = 6 << 22;

/// Commands.
const WRITE_ENABLE: u8 = 0x06;
const ERASE_SECTOR: u8 = 0x20;
const PROGRAM_PAGE: u8 = 0x02;
const STATUS: u8 = 0x05;
const READ: u8 = 0x03;
/// Ends a continuous read mode that an earlier program may have left. Otherwise it has no effect.
const END_CONTINUOUS: u8 = 0xFF;

/// Bit of the status: the flash works.
const WORKS: u8 = 1;
/// Longest time of an erase or a program, us. The data sheet has 400 ms for a sector.
const PATIENCE_US: u32 = 1_000_000;

/// Why the flash failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// An address beyond the end, or not aligned.
    Place(NorFlashErrorKind),
    /// The flash does not become ready.
    Late,
}

impl NorFlashError for Error {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Place(kind) => *kind,
            Self::Late => NorFlashErrorKind::Other,
        }
    }
}

/// The flash in the direct mode, until it is dropped. `wait` is called again and again while the
/// flash works.
pub struct Flash<W> {
    wait: W,
    /// The control register before.
    before: u32,
}

impl<W: FnMut()> Flash<W> {
    /// Begins the direct mode.
    pub fn begin(wait: W) -> Self {
        let before = read(QMI, CONTROL) & !(DIRECT | SELECT);
        write(QMI, CONTROL, DIVIDER | DIRECT);
        // A memory-mapped transfer ends first.
        while read(QMI, CONTROL) & BUSY != 0 {}
        let mut flash = Self { wait, before };
        flash.send(&[END_CONTINUOUS, END_CONTINUOUS], |_| ());
        flash
    }

    fn exchange(byte: u8) -> u8 {
        write(QMI, TRANSMIT, u32::from(byte));
        while read(QMI, CONTROL) & RECEIVER_EMPTY != 0 {}
        read(QMI, RECEIVE) as u8
    }

    /// Selects the flash, sends the beginning of a command, and does the rest of it.
    fn send<R>(&mut self, bytes: &[u8], rest: impl FnOnce(fn(u8) -> u8) -> R) -> R {
        write(QMI, CONTROL, DIVIDER | DIRECT | SELECT);
        for byte in bytes {
            Self::exchange(*byte);
        }
        let result = rest(Self::exchange);
        while read(QMI, CONTROL) & BUSY != 0 {}
        write(QMI, CONTROL, DIVIDER | DIRECT);
        result
    }

    /// Waits until the flash is ready.
    fn finish(&mut self) -> Result<(), Error> {
        let start = cycles();
        while self.send(&[STATUS], |exchange| exchange(0)) & WORKS != 0 {
            if cycles().wrapping_sub(start) >= PATIENCE_US * CYCLES_PER_US {
                return Err(Error::Late);
            }
            (self.wait)();
        }
        Ok(())
    }

    /// Carries out a command that changes the contents.
    fn change(&mut self, command: u8, address: u32, bytes: &[u8]) -> Result<(), Error> {
        self.finish()?;
        self.send(&[WRITE_ENABLE], |_| ());
        let [_, a, b, c] = address.to_be_bytes();
        self.send(&[command, a, b, c], |exchange| {
            for byte in bytes {
                exchange(*byte);
            }
        });
        self.finish()
    }
}

impl<W> Drop for Flash<W> {
    fn drop(&mut self) {
        write(QMI, CONTROL, self.before);
    }
}

impl<W> ErrorType for Flash<W> {
    type Error = Error;
}

impl<W: FnMut()> ReadNorFlash for Flash<W> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        check_read(self, offset, bytes.len()).map_err(Error::Place)?;
        self.finish()?;
        let [_, a, b, c] = offset.to_be_bytes();
        self.send(&[READ, a, b, c], |exchange| {
            for byte in bytes {
                *byte = exchange(0);
            }
        });
        (self.wait)();
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl<W: FnMut()> NorFlash for Flash<W> {
    const WRITE_SIZE: usize = 256;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        check_erase(self, from, to).map_err(Error::Place)?;
        (from..to)
            .step_by(Self::ERASE_SIZE)
            .try_for_each(|sector| self.change(ERASE_SECTOR, sector, &[]))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        check_write(self, offset, bytes.len()).map_err(Error::Place)?;
        (offset..)
            .step_by(Self::WRITE_SIZE)
            .zip(bytes.chunks(Self::WRITE_SIZE))
            .try_for_each(|(page, bytes)| self.change(PROGRAM_PAGE, page, bytes))
    }
}
