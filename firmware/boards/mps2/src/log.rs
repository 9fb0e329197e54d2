//! Logging: defmt frames over UART2. Decoding needs the image, which contains the texts.
//!
//! The timestamp of a line is the control period. Bytes are sent at once, because the emulator
//! accepts a byte in no time of the board. A board with a real line must log into a ring buffer.

use crate::registers::{UART2, write};
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use critical_section::RestoreState;
use defmt::{Encoder, Logger, global_logger};

const CONTROL: usize = 0x8;
const BAUD_DIVIDER: usize = 0x10;
/// The transmitter alone.
const TRANSMITTER_ON: u32 = 1;

/// Number of the present control period.
static PERIOD: AtomicU32 = AtomicU32::new(0);

defmt::timestamp!("{=u32}", PERIOD.load(Ordering::Relaxed));

/// Starts the log line.
pub fn start() {
    write(UART2, BAUD_DIVIDER, 16);
    write(UART2, CONTROL, TRANSMITTER_ON);
}

/// Records the start of a control period.
pub fn begin(period: u64) {
    PERIOD.store(period as u32, Ordering::Relaxed);
}

/// The logger, for defmt's macros only.
#[global_logger]
struct Line;

/// State of the logger inside its critical section.
struct Working {
    encoder: Encoder,
    restore: RestoreState,
}

struct Shared(UnsafeCell<Working>);

// SAFETY: used only between `acquire` and `release`, which are the bounds of a critical section.
unsafe impl Sync for Shared {}

static TAKEN: AtomicBool = AtomicBool::new(false);
static WORKING: Shared = Shared(UnsafeCell::new(Working {
    encoder: Encoder::new(),
    restore: RestoreState::invalid(),
}));

fn send(bytes: &[u8]) {
    crate::serial::send(UART2, bytes);
}

// SAFETY: `acquire` begins a critical section and `release` ends it, so no other code runs in
// between. A second `acquire` inside is refused.
unsafe impl Logger for Line {
    fn acquire() {
        // SAFETY: `release` restores it; defmt calls `release` once for each `acquire`.
        let restore = unsafe { critical_section::acquire() };
        assert!(
            !TAKEN.load(Ordering::Relaxed),
            "a log statement inside of another"
        );
        TAKEN.store(true, Ordering::Relaxed);
        // SAFETY: inside the critical section, and not borrowed.
        let working = unsafe { &mut *WORKING.0.get() };
        working.restore = restore;
        working.encoder.start_frame(send);
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: `acquire` was called before; this ends its critical section.
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
