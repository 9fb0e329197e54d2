//! Abnormal end of a run: a reason on the emulator's console, and an exit code.
//!
//! The drives are off from then on: the simulated machine treats the end of the link as a watchdog
//! reset. A board with real drives must have a watchdog that does the same after a panic.

use crate::semihosting;
use core::cell::UnsafeCell;
use core::fmt::{self, Write};
use cortex_m::peripheral::scb::Exception;
use cortex_m::peripheral::{MPU, SCB};
use cortex_m_rt::ExceptionFrame;

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

/// Bytes of the stack on which a fault is reported.
const FAULT_STACK_BYTES: usize = 2048;

/// Stack for fault reports, because the main stack may be the cause of the fault.
#[repr(C, align(8))]
struct FaultStack(UnsafeCell<[u8; FAULT_STACK_BYTES]>);

// SAFETY: only the handler below uses it, and the handler never returns.
unsafe impl Sync for FaultStack {}

static FAULT_STACK: FaultStack = FaultStack(UnsafeCell::new([0; FAULT_STACK_BYTES]));

/// Enables separate fault handlers, and makes the memory below the stack inaccessible.
///
/// On this board nothing is below the RAM, and an access there raises no fault, so the memory
/// protection unit raises it. A stack that has left the memory cannot take the exception frame of
/// the fault either. For a `MemoryManagement` or `BusFault` this is a second fault, which becomes a
/// `HardFault`, and that one is entered. A `HardFault` whose frame cannot be stacked locks the
/// processor up instead.
pub fn watch(scb: &mut SCB, mpu: &mut MPU) {
    scb.enable(Exception::BusFault);
    scb.enable(Exception::MemoryManagement);
    scb.enable(Exception::UsageFault);
    // SAFETY: nothing of this image lies in the protected region (see `memory/product.x`). All
    // other memory keeps its access rules.
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
/// The region number (0) is written together with its address.
const REGION_VALID: u32 = 1 << 4;
/// 2^(27 + 1) bytes, no access: all other fields are zero.
const REGION_256_MIB: u32 = 27 << 1;
const REGION_ON: u32 = 1;
/// Memory outside of all regions keeps the processor's default rules.
const OTHERS_AS_BEFORE: u32 = 1 << 2;
const PROTECTION_ON: u32 = 1;

/// Handler of all processor faults.
///
/// # Safety
/// Only the processor may call it.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    // The argument is the old stack pointer. The new stack pointer is the end of the fault stack.
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
