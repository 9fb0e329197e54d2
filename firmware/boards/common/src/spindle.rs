//! Lines of a spindle: duty of its PWM, and direction.

/// Speed at a duty of 100 %, rev/min.
pub const FULL_RPM: u32 = 24_000;

/// Levels of the lines for a control period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpindleLevels {
    /// Counts of the PWM in which its line is high.
    pub duty: u32,
    /// Level of the direction line: high is clockwise.
    pub is_clockwise: bool,
}

/// The direction line changes only in a control period that follows one with a duty of 0, and keeps
/// its level while the spindle is off: a spindle that slows down does not see a reversal.
#[derive(Debug, Clone)]
pub struct SpindleLines {
    levels: SpindleLevels,
}

impl SpindleLines {
    /// Both lines are low.
    #[must_use]
    pub const fn new() -> Self {
        let levels = SpindleLevels {
            duty: 0,
            is_clockwise: false,
        };
        Self { levels }
    }

    /// Levels for a speed in rev/min, counter-clockwise below 0, with a PWM of `counts` counts.
    /// Callers must call it once every control period.
    pub fn update(&mut self, rpm: i16, counts: u32) -> SpindleLevels {
        let SpindleLevels { duty, is_clockwise } = self.levels;
        let commanded = if rpm == 0 { is_clockwise } else { rpm > 0 };
        let must_wait = commanded != is_clockwise && duty > 0;
        let speed = u32::from(rpm.unsigned_abs()).min(FULL_RPM);
        self.levels = if must_wait {
            SpindleLevels {
                duty: 0,
                is_clockwise,
            }
        } else {
            SpindleLevels {
                duty: speed * counts / FULL_RPM,
                is_clockwise: commanded,
            }
        };
        self.levels
    }
}

impl Default for SpindleLines {
    fn default() -> Self {
        Self::new()
    }
}
