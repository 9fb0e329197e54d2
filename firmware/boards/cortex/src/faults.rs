//! The handler of all processor faults. It changes to a stack of its own, because the main stack
//! may be the cause, and calls a function of the board, which never returns.

use core::cell::UnsafeCell;

/// A stack that only the fault handler uses.
#[doc(hidden)]
#[derive(Debug)]
#[repr(C, align(8))]
pub struct FaultStack<const BYTES: usize>(UnsafeCell<[u8; BYTES]>);

// SAFETY: only the fault handler uses it, and it never returns.
unsafe impl<const BYTES: usize> Sync for FaultStack<BYTES> {}

impl<const BYTES: usize> FaultStack<BYTES> {
    /// An unused stack.
    #[must_use]
    pub const fn new() -> Self {
        Self(UnsafeCell::new([0; BYTES]))
    }
}

impl<const BYTES: usize> Default for FaultStack<BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

/// Instructions of the fault handler that lift the limit of the stack pointer.
#[cfg(feature = "armv8m")]
#[doc(hidden)]
#[macro_export]
macro_rules! lift_stack_limit {
    () => {
        "movs r1, #0\nmsr msplim, r1"
    };
}

/// The processor has no limit of the stack pointer.
#[cfg(not(feature = "armv8m"))]
#[doc(hidden)]
#[macro_export]
macro_rules! lift_stack_limit {
    () => {
        ""
    };
}

/// Defines `HardFault`, which calls `report`, an `extern "C" fn(usize) -> !`, with the stack
/// pointer at its entry. `report` runs on a stack of `bytes` bytes.
///
/// With `all` the faults of bus, memory and instructions have the same handler. The linker script
/// must not define theirs then.
#[macro_export]
macro_rules! fault_handler {
    ($report:ident, $bytes:expr, all) => {
        $crate::fault_handler!($report, $bytes);

        core::arch::global_asm!(
            ".global BusFault",
            ".thumb_set BusFault, HardFault",
            ".global MemoryManagement",
            ".thumb_set MemoryManagement, HardFault",
            ".global UsageFault",
            ".thumb_set UsageFault, HardFault",
        );
    };
    ($report:ident, $bytes:expr) => {
        static FAULT_STACK: $crate::faults::FaultStack<{ $bytes }> =
            $crate::faults::FaultStack::new();

        /// Handler of all processor faults.
        ///
        /// # Safety
        /// Only the processor may call it.
        #[unsafe(naked)]
        #[unsafe(no_mangle)]
        unsafe extern "C" fn HardFault() -> ! {
            // The argument is the old stack pointer. The new one is the end of the fault stack.
            core::arch::naked_asm!(
                "mrs r0, msp",
                $crate::lift_stack_limit!(),
                "movw r1, #:lower16:{stack}",
                "movt r1, #:upper16:{stack}",
                "add r1, r1, #{bytes}",
                "msr msp, r1",
                "b {report}",
                stack = sym FAULT_STACK,
                bytes = const $bytes,
                report = sym $report,
            )
        }
    };
}

/// Address of the instruction that failed, from the stack pointer at the entry of the handler; 0 if
/// the processor could not stack it.
#[must_use]
pub fn address(frame: usize) -> u32 {
    let (low, high) = crate::guard::stack();
    // It is the seventh word of the frame, which has eight.
    if frame >= low && frame + 32 <= high {
        // SAFETY: it lies within the stack.
        unsafe { ((frame + 24) as *const u32).read_volatile() }
    } else {
        0
    }
}
