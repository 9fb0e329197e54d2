//! Abnormal end of a run: a reason on the emulator's console, and an exit code.
//!
//! The drives are off from then on: the simulated machine treats the end of the link as a watchdog
//! reset. A board with real drives must have a watchdog that does the same after a panic.

use crate::semihosting;
use core::fmt::{self, Write};
use cortex_m::peripheral::{MPU, SCB};
use cortex_m_rt::ExceptionFrame;
use haptimill_board_cortex::{fault_handler, guard};

/// Exit code after a panic.
pub const PANIC: u8 = 101;
/// Exit code after a processor fault.
pub const FAULT: u8 = 102;
/// Exit code when the simulator has ended.
pub const GONE: u8 = 103;
/// Exit code after a stack overflow.
pub const STACK: u8 = 104;

/// Text buffer; text that does not fit is cut off.
struct Text {
    bytes: [u8; 256],
    length: usize,
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for &byte in text.as_bytes() {
            // The last byte stays the terminating zero.
            if self.length + 1 < self.bytes.len() && byte != 0 {
                self.bytes[self.length] = byte;
                self.length += 1;
            }
        }
        Ok(())
    }
}

/// Writes a message to the console, at most 255 bytes.
pub fn say(what: fmt::Arguments<'_>) {
    let mut text = Text {
        bytes: [0; 256],
        length: 0,
    };
    // Cannot fail: text that does not fit is cut off.
    let _ = text.write_fmt(what);
    if let Ok(text) = core::ffi::CStr::from_bytes_until_nul(&text.bytes) {
        semihosting::console(text);
    }
}

/// Writes the reason to the console and ends the emulator.
pub fn end(code: u8, reason: fmt::Arguments<'_>) -> ! {
    say(reason);
    say(format_args!("\n"));
    semihosting::exit(code)
}

#[panic_handler]
fn panicked(info: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    #[cfg(feature = "defmt")]
    defmt::error!("{}", defmt::Display2Format(info));
    end(PANIC, format_args!("{info}"))
}

/// Enables separate fault handlers, and makes the memory below the stack inaccessible: nothing is
/// below the RAM of this board, and an access there raises no fault.
pub fn watch(scb: &mut SCB, mpu: &mut MPU) {
    // SAFETY: nothing of this image lies in the 256 MiB below the RAM (see `memory/product.x`).
    unsafe { guard::close_below_stack(scb, mpu, 0x1000_0000, 28) };
}

fault_handler!(report, 2048, all);

/// Reports the fault. `frame` is the stack pointer of the failed code.
extern "C" fn report(frame: usize) -> ! {
    // SAFETY: reading the fault status changes nothing.
    let status = unsafe { (*SCB::PTR).cfsr.read() };
    if crate::stack::overflown(frame) || status & NOT_STACKED != 0 {
        end(
            STACK,
            format_args!(
                "the stack has overflown: {} bytes are not enough",
                crate::stack::bytes()
            ),
        )
    }
    // SAFETY: the processor has stacked the frame, and it lies within the stack.
    let frame = unsafe { &*(frame as *const ExceptionFrame) };
    end(
        FAULT,
        format_args!(
            "processor fault at {:#010x}, called from {:#010x}, fault status {status:#010x}",
            frame.pc(),
            frame.lr()
        ),
    )
}

/// Bits of the fault status: an exception frame could not be stacked, because of the bus (12) or
/// the memory protection (4).
const NOT_STACKED: u32 = 1 << 12 | 1 << 4;
