//! A lamp that shows a number as flashes, then a pause.

/// Lengths of a flash, of the dark after it, and of the pause, ms.
const FLASH_MS: u32 = 100;
const DARK_MS: u32 = 200;
const PAUSE_MS: u32 = 700;

/// The lamp: a number of flashes, then a pause.
#[derive(Debug, Clone)]
pub struct Lamp {
    flashes: u32,
    cycles_per_ms: u32,
    /// Present phase: two a flash, on and off, then the pause.
    phase: u32,
    /// Cycle at which the phase began.
    since: u32,
}

impl Lamp {
    /// The lamp is off, and begins with a pause.
    #[must_use]
    pub const fn new(flashes: u32, cycles_per_ms: u32) -> Self {
        Self {
            flashes,
            cycles_per_ms,
            phase: 2 * flashes,
            since: 0,
        }
    }

    /// Whether the lamp is on from now on, if that changes now; `now` counts cycles and wraps
    /// around.
    pub const fn update(&mut self, now: u32) -> Option<bool> {
        let milliseconds = if self.phase == 2 * self.flashes {
            PAUSE_MS
        } else if self.phase.is_multiple_of(2) {
            FLASH_MS
        } else {
            DARK_MS
        };
        if now.wrapping_sub(self.since) < milliseconds * self.cycles_per_ms {
            return None;
        }
        self.since = now;
        self.phase = (self.phase + 1) % (2 * self.flashes + 1);
        Some(self.phase < 2 * self.flashes && self.phase.is_multiple_of(2))
    }
}
