//! The [record](haptimill_board_common::period_record) of the last control period, with the cycles
//! of its stages. It is the first object of the RAM after the stack (`image.x`).

use crate::clocks::cycles;
use crate::ending::last_cause;
use core::cell::UnsafeCell;
use haptimill_board_common::period_record::{
    BUSY, GLITCHES, LATE, STAGE_WORDS, STEP_WORDS, WORDS, write as encode,
};
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::profiler::{Profiler, STAGES, Stage};

#[repr(C, align(8))]
struct Record(UnsafeCell<[u32; WORDS]>);

// SAFETY: only `write` uses it, which only PendSV calls.
unsafe impl Sync for Record {}

#[unsafe(link_section = ".period_record")]
#[used]
static RECORD: Record = Record(UnsafeCell::new([0; WORDS]));

/// Start of a control period.
#[derive(Clone, Copy)]
pub struct Start {
    /// Count of the cycle counter at its time.
    pub at: u32,
    /// Cycles after it at which its handler began to work.
    pub late: u32,
}

/// Writes the record of a period.
pub fn write(inputs: &Inputs, outputs: &Outputs, profile: &Cycles, glitches: u32, start: Start) {
    // SAFETY: see `Record`.
    let words = unsafe { &mut *RECORD.0.get() };
    encode(words, inputs, outputs, last_cause());
    words[STAGE_WORDS.0..STAGE_WORDS.1].copy_from_slice(&profile.stages);
    words[STEP_WORDS] = profile.words;
    words[GLITCHES] = glitches;
    words[LATE] = start.late;
    #[cfg(feature = "encoders")]
    haptimill_board_common::period_record::write_encoders(words, inputs);
    words[BUSY] = cycles().wrapping_sub(start.at);
    // SAFETY: the word is part of the record. The write is volatile so that it stays the last one.
    unsafe {
        RECORD
            .0
            .get()
            .cast::<u32>()
            .write_volatile(inputs.period as u32)
    };
}

/// Cycles of the stages of a period.
pub struct Cycles {
    last: u32,
    stages: [u32; STAGES],
    words: u32,
}

impl Cycles {
    /// Starts a measurement.
    pub const fn begin(now: u32) -> Self {
        Self {
            last: now,
            stages: [0; STAGES],
            words: 0,
        }
    }

    /// Ends it.
    pub const fn end(&mut self, now: u32) {
        self.words = now.wrapping_sub(self.last);
    }
}

impl Profiler for Cycles {
    #[inline(always)]
    fn mark(&mut self, stage: Stage) {
        let now = cycles();
        self.stages[stage as usize] = now.wrapping_sub(self.last);
        self.last = now;
    }
}
