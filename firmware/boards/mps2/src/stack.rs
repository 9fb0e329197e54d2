//! How much of the stack was ever used: it is painted before the start (by cortex-m-rt), and what the paint lost was used.

/// What an unused word of the stack holds.
const PAINT: u32 = 0xCCCC_CCCC;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

fn bounds() -> (usize, usize) {
    // The linker's symbols stand for their addresses; nothing is read.
    (
        &raw const _stack_end as usize,
        &raw const _stack_start as usize,
    )
}

/// Bytes of stack that were ever used.
#[must_use]
pub fn used_bytes() -> u32 {
    let (low, high) = bounds();
    let mut at = low;
    // SAFETY: between the linker's symbols lies the stack and nothing else.
    while at < high && unsafe { (at as *const u32).read_volatile() } == PAINT {
        at += 4;
    }
    (high - at) as u32
}

/// Bytes of stack that there are.
#[must_use]
pub fn bytes() -> usize {
    let (low, high) = bounds();
    high - low
}

/// Whether a stack pointer has left the stack, or has been stopped at its end: what is pushed at once is less than 64 bytes.
#[must_use]
pub fn overflown(stack_pointer: usize) -> bool {
    let (low, _) = bounds();
    stack_pointer < low + 64
}
