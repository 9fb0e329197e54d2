//! Guard of the main stack: without it a stack that overflows writes into what lies below.

#[cfg(not(feature = "armv8m"))]
use cortex_m::peripheral::scb::Exception;
#[cfg(not(feature = "armv8m"))]
use cortex_m::peripheral::{MPU, SCB};

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Lowest address of the main stack, and the address behind it, by the linker script.
#[must_use]
pub fn stack() -> (usize, usize) {
    // The linker's symbols stand for their addresses; their contents are not read.
    (
        &raw const _stack_end as usize,
        &raw const _stack_start as usize,
    )
}

/// Sets the limit of the stack pointer.
#[cfg(feature = "armv8m")]
pub fn limit_stack() {
    let (limit, _) = stack();
    // SAFETY: the stack pointer is above the limit.
    unsafe { core::arch::asm!("msr msplim, {}", in(reg) limit) };
}

/// Enables the handlers of bus, memory and usage faults, and closes the addresses below the stack:
/// the 2^`log2_bytes` bytes from `address` on, a multiple of that size.
///
/// A stack that has left its memory cannot take the frame of the fault either. For these handlers
/// this is a second fault, which becomes a `HardFault`, and that one is entered. A `HardFault`
/// whose frame cannot be stacked locks the processor up instead.
///
/// # Safety
/// Nothing of the image lies in the closed addresses. All other memory keeps its access rules.
#[cfg(not(feature = "armv8m"))]
pub unsafe fn close_below_stack(scb: &mut SCB, mpu: &mut MPU, address: u32, log2_bytes: u32) {
    scb.enable(Exception::BusFault);
    scb.enable(Exception::MemoryManagement);
    scb.enable(Exception::UsageFault);
    // SAFETY: the caller guarantees it.
    unsafe {
        mpu.rbar.write(address | REGION_VALID);
        // No access: all other fields are zero.
        mpu.rasr.write((log2_bytes - 1) << 1 | REGION_ON);
        mpu.ctrl.write(OTHERS_AS_BEFORE | PROTECTION_ON);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// The region number (0) is written together with its address.
#[cfg(not(feature = "armv8m"))]
const REGION_VALID: u32 = 1 << 4;
#[cfg(not(feature = "armv8m"))]
const REGION_ON: u32 = 1;
/// Memory outside of all regions keeps the processor's default rules.
#[cfg(not(feature = "armv8m"))]
const OTHERS_AS_BEFORE: u32 = 1 << 2;
#[cfg(not(feature = "armv8m"))]
const PROTECTION_ON: u32 = 1;
