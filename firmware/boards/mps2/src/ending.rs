//! How a run ends that goes wrong: the reason on the emulator's console, and an exit code.
//!
//! The drives are off from then on: the simulated machine takes the end of the link for a watchdog's reset, which on a board with
//! drives is what must follow a panic.

use crate::semihosting;
use core::fmt::{self, Write};
use cortex_m_rt::{ExceptionFrame, exception};

/// Exit code after a panic.
pub const PANIC: u8 = 101;
/// Exit code after a fault of the processor.
pub const HARD_FAULT: u8 = 102;
/// Exit code when the simulator has gone.
pub const GONE: u8 = 103;
/// Exit code when the stack was too small.
pub const STACK: u8 = 104;

/// A text that is cut off where the room ends.
struct Text {
    bytes: [u8; 256],
    length: usize,
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for &byte in text.as_bytes() {
            // The last byte stays the zero at the end.
            if self.length + 1 < self.bytes.len() && byte != 0 {
                self.bytes[self.length] = byte;
                self.length += 1;
            }
        }
        Ok(())
    }
}

/// Says the reason and ends the emulator.
pub fn end(code: u8, reason: fmt::Arguments<'_>) -> ! {
    let mut text = Text {
        bytes: [0; 256],
        length: 0,
    };
    // Cannot fail: what has no room is cut off.
    let _ = text.write_fmt(reason);
    let _ = text.write_char('\n');
    if let Ok(text) = core::ffi::CStr::from_bytes_until_nul(&text.bytes) {
        semihosting::console(text);
    }
    semihosting::exit(code)
}

#[panic_handler]
fn panicked(info: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    end(PANIC, format_args!("{info}"))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    if crate::stack::overflown(core::ptr::from_ref(frame) as usize) {
        end(STACK, format_args!("the stack has overflown"))
    }
    // SAFETY: reading the fault status changes nothing.
    let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
    end(
        HARD_FAULT,
        format_args!(
            "hard fault at {:#010x}, called from {:#010x}, fault status {status:#010x}",
            frame.pc(),
            frame.lr()
        ),
    )
}
