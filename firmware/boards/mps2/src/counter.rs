//! Stage profiler: counts the instructions of each stage of a control period with TIMER0.
//!
//! Under QEMU's `-icount shift=10` an instruction takes 1024 ns of the board's time, and the timer
//! counts at 25 MHz. A count is exactly 40/1024 of an instruction. The unit is instructions and not
//! cycles: `DWT.CYCCNT` reads 0 on this emulator.

use crate::registers::{TIMER0, read, write};
use haptimill_firmware::profiler::{Profiler, STAGES, Stage};

const CONTROL: usize = 0x0;
const VALUE: usize = 0x4;
const RELOAD: usize = 0x8;

/// Starts the timer, which wraps around.
pub fn start() {
    write(TIMER0, RELOAD, u32::MAX);
    write(TIMER0, CONTROL, 1);
}

/// Returns the counts since the start; wraps around.
#[inline(always)]
pub fn now() -> u32 {
    // The timer counts down.
    !read(TIMER0, VALUE)
}

/// Counts of each stage.
#[derive(Debug, Default)]
pub struct StageCounter {
    last: u32,
    /// Counts, in the order of [`Stage`].
    pub stages: [u32; STAGES],
}

impl StageCounter {
    /// Starts a measurement.
    #[inline(always)]
    #[must_use]
    pub fn begin() -> Self {
        Self {
            stages: [0; STAGES],
            last: now(),
        }
    }
}

impl Profiler for StageCounter {
    #[inline(always)]
    fn mark(&mut self, stage: Stage) {
        let now = now();
        if let Some(count) = self.stages.get_mut(stage as usize) {
            *count = now.wrapping_sub(self.last);
        }
        self.last = now;
        #[cfg(feature = "faults")]
        crate::faults::mark(stage);
    }
}
