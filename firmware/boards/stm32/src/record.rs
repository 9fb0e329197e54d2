//! The [record](haptimill_board_common::period_record) of the last control period, without the
//! cycles of its stages. It is the first object of the RAM (`memory.x`).

use core::cell::UnsafeCell;
use haptimill_board_common::period_record::{self, BUSY, GLITCHES, WORDS};
use haptimill_firmware::io::{Inputs, Outputs};

#[repr(C, align(8))]
struct Record(UnsafeCell<[u32; WORDS]>);

// SAFETY: only `write` uses it, which only PendSV calls.
unsafe impl Sync for Record {}

#[unsafe(link_section = ".period_record")]
#[used]
static RECORD: Record = Record(UnsafeCell::new([0; WORDS]));

/// Writes the record of a period; `busy` are the cycles since its start.
pub fn write(inputs: &Inputs, outputs: &Outputs, glitches: u32, busy: u32) {
    // SAFETY: see `Record`.
    let words = unsafe { &mut *RECORD.0.get() };
    period_record::write(words, inputs, outputs, 0);
    words[GLITCHES] = glitches;
    words[BUSY] = busy;
    // SAFETY: the word is part of the record. The write is volatile so that it stays the last one.
    unsafe {
        RECORD
            .0
            .get()
            .cast::<u32>()
            .write_volatile(inputs.period as u32)
    };
}
