//! The log: defmt frames over UART2, read by whoever has the image, which has the texts.
//!
//! The stamp of a line is the control period that runs. What waits is sent at once: the emulator takes a byte in no time of the board; on a board with a
//! real line a logger has to write into a ring.

use crate::registers::{UART2, write};
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use critical_section::RestoreState;
use defmt::{Encoder, Logger, global_logger};

const CONTROL: usize = 0x8;
const BAUD_DIVIDER: usize = 0x10;
/// The transmitter alone.
const TRANSMITTER_ON: u32 = 1;

/// The period that runs.
static PERIOD: AtomicU32 = AtomicU32::new(0);

defmt::timestamp!("{=u32}", PERIOD.load(Ordering::Relaxed));

/// Starts the line.
pub fn start() {
    write(UART2, BAUD_DIVIDER, 16);
    write(UART2, CONTROL, TRANSMITTER_ON);
}

/// A period begins.
pub fn begin(period: u64) {
    PERIOD.store(period as u32, Ordering::Relaxed);
}

/// The logger; of no use to anybody but defmt's macros.
#[global_logger]
struct Line;

/// What the logger works on, inside of its critical section.
struct Working {
    encoder: Encoder,
    restore: RestoreState,
}

struct Shared(UnsafeCell<Working>);

// SAFETY: used between `acquire` and `release` alone, which are the ends of a critical section.
unsafe impl Sync for Shared {}

static TAKEN: AtomicBool = AtomicBool::new(false);
static WORKING: Shared = Shared(UnsafeCell::new(Working {
    encoder: Encoder::new(),
    restore: RestoreState::invalid(),
}));

fn send(bytes: &[u8]) {
    crate::serial::send(UART2, bytes);
}

// SAFETY: `acquire` begins a critical section and `release` ends it, so that nobody comes between them; a second `acquire` inside is refused.
unsafe impl Logger for Line {
    fn acquire() {
        // SAFETY: given back by `release`, which defmt calls once for each of these calls.
        let restore = unsafe { critical_section::acquire() };
        assert!(
            !TAKEN.load(Ordering::Relaxed),
            "a log statement inside of another"
        );
        TAKEN.store(true, Ordering::Relaxed);
        // SAFETY: inside of the critical section, and not taken.
        let working = unsafe { &mut *WORKING.0.get() };
        working.restore = restore;
        working.encoder.start_frame(send);
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: `acquire` came before; this is the end of its critical section.
        unsafe {
            let working = &mut *WORKING.0.get();
            working.encoder.end_frame(send);
            TAKEN.store(false, Ordering::Relaxed);
            critical_section::release(working.restore);
        }
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: between `acquire` and `release`.
        let working = unsafe { &mut *WORKING.0.get() };
        working.encoder.write(bytes, send);
    }
}
