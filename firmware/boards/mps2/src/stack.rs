//! Stack usage: cortex-m-rt paints the stack before the start, and words that lost the paint were
//! used.

/// Value of an unused word of the stack.
const PAINT: u32 = 0xCCCC_CCCC;

use haptimill_board_cortex::guard::stack as bounds;

/// Returns the largest number of stack bytes that were used.
#[must_use]
pub fn used_bytes() -> u32 {
    let (low, high) = bounds();
    let mut at = low;
    // SAFETY: only the stack lies between the linker's symbols.
    while at < high && unsafe { (at as *const u32).read_volatile() } == PAINT {
        at += 4;
    }
    (high - at) as u32
}

/// Returns the size of the stack, bytes.
#[must_use]
pub fn bytes() -> usize {
    let (low, high) = bounds();
    high - low
}

/// Returns whether a stack pointer has left the stack, or was stopped at its end. A single push has
/// less than 64 bytes.
#[must_use]
pub fn overflown(stack_pointer: usize) -> bool {
    let (low, _) = bounds();
    stack_pointer < low + 64
}
