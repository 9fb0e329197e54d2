//! The vector table in the RAM: while the flash is written no handler can be found there.

use crate::registers::{read, write};
use core::cell::UnsafeCell;

/// Exceptions of the core. No interrupt of a device is used.
const VECTORS: usize = 16;

/// Vector table offset register of the core.
const SCB: usize = 0xE000_ED00;
const VTOR: usize = 0x8;

#[repr(C, align(128))]
struct Table(UnsafeCell<[u32; VECTORS]>);

// SAFETY: only `move_to_ram` writes it, before any handler can run.
unsafe impl Sync for Table {}

static TABLE: Table = Table(UnsafeCell::new([0; VECTORS]));

/// Copies the vector table into the RAM and uses it there. Only `main` calls it, once, before it
/// starts a handler.
pub fn move_to_ram() {
    let flash = read(SCB, VTOR) as usize;
    // SAFETY: no handler runs yet, and this function runs once.
    let table = unsafe { &mut *TABLE.0.get() };
    for (vector, at) in table.iter_mut().zip((0..).step_by(4)) {
        *vector = read(flash, at);
    }
    write(SCB, VTOR, TABLE.0.get() as u32);
}
