//! How a run ends that goes wrong: the reason on the emulator's console, and an exit code.
//!
//! The drives are off from then on: the simulated machine takes the end of the link for a watchdog's reset, which on a board with
//! drives is what must follow a panic.

use crate::semihosting;
use core::cell::UnsafeCell;
use core::fmt::{self, Write};
use cortex_m::peripheral::scb::Exception;
use cortex_m::peripheral::{MPU, SCB};
use cortex_m_rt::ExceptionFrame;

/// Exit code after a panic.
pub const PANIC: u8 = 101;
/// Exit code after a fault of the processor.
pub const FAULT: u8 = 102;
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

/// Says something on the console, at most 255 bytes of it.
pub fn say(what: fmt::Arguments<'_>) {
    let mut text = Text {
        bytes: [0; 256],
        length: 0,
    };
    // Cannot fail: what has no room is cut off.
    let _ = text.write_fmt(what);
    if let Ok(text) = core::ffi::CStr::from_bytes_until_nul(&text.bytes) {
        semihosting::console(text);
    }
}

/// Says the reason and ends the emulator.
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

/// Bytes of the stack on which a fault is reported.
const FAULT_STACK_BYTES: usize = 2048;

/// A fault is not reported on the stack that may be what went wrong.
#[repr(C, align(8))]
struct FaultStack(UnsafeCell<[u8; FAULT_STACK_BYTES]>);

// SAFETY: used by the handler below alone, which never returns.
unsafe impl Sync for FaultStack {}

static FAULT_STACK: FaultStack = FaultStack(UnsafeCell::new([0; FAULT_STACK_BYTES]));

/// Faults get handlers of their own, and the memory below the stack is closed.
///
/// On this board nothing is below the RAM, and reading or writing there is no fault: so the memory protection makes it one. A stack that has left the
/// memory cannot take the frame of the exception that says so either. As a `MemoryManagement` or `BusFault` that is a second fault, which becomes a
/// `HardFault`, and that one is entered; a `HardFault` whose frame cannot be stacked locks the processor up instead.
pub fn watch(scb: &mut SCB, mpu: &mut MPU) {
    scb.enable(Exception::BusFault);
    scb.enable(Exception::MemoryManagement);
    scb.enable(Exception::UsageFault);
    // SAFETY: nothing of this image lies in the region that is closed (see `memory/product.x`); everything else stays as it is.
    unsafe {
        mpu.rbar.write(BELOW_RAM | REGION_VALID);
        mpu.rasr.write(REGION_256_MIB | REGION_ON);
        mpu.ctrl.write(OTHERS_AS_BEFORE | PROTECTION_ON);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// The 256 MiB below the RAM.
const BELOW_RAM: u32 = 0x1000_0000;
/// The region's number (0) stands beside its address.
const REGION_VALID: u32 = 1 << 4;
/// 2^(27 + 1) bytes; no access, by leaving out everything else.
const REGION_256_MIB: u32 = 27 << 1;
const REGION_ON: u32 = 1;
/// What is in no region has the processor's own rules.
const OTHERS_AS_BEFORE: u32 = 1 << 2;
const PROTECTION_ON: u32 = 1;

/// All faults of the processor end here.
///
/// # Safety
/// Called by the processor.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    // The old stack pointer is the argument; the new one is the end of the fault's own stack.
    core::arch::naked_asm!(
        "mrs r0, msp",
        "movw r1, #:lower16:{stack}",
        "movt r1, #:upper16:{stack}",
        "add r1, r1, #{bytes}",
        "msr msp, r1",
        "b {report}",
        stack = sym FAULT_STACK,
        bytes = const FAULT_STACK_BYTES,
        report = sym report,
    )
}

core::arch::global_asm!(
    ".global BusFault",
    ".thumb_set BusFault, HardFault",
    ".global MemoryManagement",
    ".thumb_set MemoryManagement, HardFault",
    ".global UsageFault",
    ".thumb_set UsageFault, HardFault",
);

/// Says which fault it was. `frame` is the stack pointer of what failed.
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

/// Bits of the fault status: the frame of an exception could not be stacked, by the bus (12) or by the memory protection (4).
const NOT_STACKED: u32 = 1 << 12 | 1 << 4;
