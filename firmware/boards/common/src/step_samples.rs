//! Samples of step and direction lines for a port whose pins are set and reset by one word: the
//! `BSRR` register of an STM32, fed by DMA at a fixed rate.
//!
//! A control period has [`SLOTS`] slots. At the start of each slot the DMA writes one word, which
//! has the pins that rise in its lower half and the pins that fall in its upper half; all other
//! pins keep their levels. One word holds the lines of all joints.
//!
//! Step `k` of a segment rises at the start of the slot in which its time `delay + k * interval +
//! ramp * k * (k - 1) / 2` lies: at most a slot early, never late. The times are not rounded one
//! after the other, so the error does not add up. A pulse whose width is a number of slots has
//! exactly this width, and the pause after it is at least as long.
//!
//! A pulse may end in the next period: [`StepSamples::add`] lets its line fall there. In a missed
//! period, whose words are those of [`missed`], it ends in the middle of the period.

use haptimill_firmware::io::StepSegment;

/// Slots of a control period.
pub const SLOTS: usize = 400;

/// Words of a control period.
pub type Samples = [u32; SLOTS];

/// A segment does not fit into the period. It is not emitted: the joint has lost its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unfit;

/// The lines of a joint, as numbers of pins of the port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lines {
    /// A step is a rising edge.
    pub step: u8,
    /// High for a positive step.
    pub direction: u8,
}

impl Lines {
    /// Word that lets the step line rise.
    const fn rise(self) -> u32 {
        1 << self.step
    }

    /// Word that lets the step line fall.
    #[must_use]
    pub const fn fall(self) -> u32 {
        1 << (self.step + 16)
    }

    /// Word that sets the direction line.
    const fn point(self, up: bool) -> u32 {
        if up {
            1 << self.direction
        } else {
            1 << (self.direction + 16)
        }
    }
}

/// Word that lets the step lines of all joints fall.
#[must_use]
pub const fn fall(lines: &[Lines]) -> u32 {
    let mut word = 0;
    let mut joint = 0;
    while joint < lines.len() {
        word |= lines[joint].fall();
        joint += 1;
    }
    word
}

/// Words of a missed period, which has no steps. A pulse of the period before is over in the middle
/// of the period, as two pulse widths fit into a period.
#[must_use]
pub const fn missed(lines: &[Lines]) -> Samples {
    let mut samples = [0; SLOTS];
    samples[SLOTS / 2] = fall(lines);
    samples
}

/// Encoder of the samples of a joint.
#[derive(Debug, Clone)]
pub struct StepSamples {
    lines: Lines,
    /// Ticks of the step clock in a slot.
    ticks: u32,
    /// Slots of a pulse.
    width: u32,
    /// First slot of the next period in which the line may rise.
    ready: u32,
    /// Slot of the next period in which the line is low: a pulse that is not over falls there.
    low: u32,
}

impl StepSamples {
    /// Samples for pulses of `width` slots, at least 1, in slots of `ticks` ticks.
    #[must_use]
    pub const fn new(lines: Lines, ticks: u32, width: u32) -> Self {
        Self {
            lines,
            ticks: if ticks == 0 { 1 } else { ticks },
            width: if width == 0 { 1 } else { width },
            ready: 0,
            low: 0,
        }
    }

    /// The same lines with pulses of another width, at least 1 slot, from the next period on.
    #[must_use]
    pub const fn with_width(self, width: u32) -> Self {
        let other = Self::new(self.lines, self.ticks, width);
        Self {
            width: other.width,
            ..self
        }
    }

    /// Slots of a pulse.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Adds the steps of a segment to words that have none of this joint, and the end of a pulse of
    /// the period before. Requires of the segment what [`StepSegment`] promises for a pulse of the
    /// width of this encoder.
    ///
    /// # Errors
    /// [`Unfit`]; then no step was added.
    pub fn add(&mut self, segment: &StepSegment, samples: &mut Samples) -> Result<(), Unfit> {
        if let Some(word) = samples.get_mut(self.low as usize) {
            *word |= self.lines.fall();
        }
        let (ready, slots) = (self.ready, SLOTS as u32);
        self.low = self.low.saturating_sub(slots);
        self.ready = ready.saturating_sub(slots);
        let count = i64::from(segment.count.unsigned_abs());
        if count == 0 {
            return Ok(());
        }
        let (delay, ticks) = (i64::from(segment.delay), i64::from(self.ticks));
        let (interval, ramp) = (i64::from(segment.interval), i64::from(segment.ramp));
        // The intervals change by the ramp, so that the first and the last of them bound all.
        let gaps = count - 1;
        let shortest = interval.min(interval + ramp * (gaps - 1).max(0));
        let last = delay + interval * gaps + ramp * (gaps * (gaps - 1) / 2);
        let pulse = i64::from(self.width) * ticks;
        if delay < i64::from(ready) * ticks
            || gaps > 0 && shortest < 2 * pulse
            || last < delay
            || last >= SLOTS as i64 * ticks
        {
            return Err(Unfit);
        }
        samples[0] |= self.lines.point(segment.count > 0);
        let (rise, fall) = (self.lines.rise(), self.lines.fall());
        // All times are below the end of the period, all intervals are positive.
        let mut time = segment.delay;
        let mut interval = segment.interval;
        let mut slot = 0;
        for _ in 0..count {
            slot = time / self.ticks;
            if let Some(word) = samples.get_mut(slot as usize) {
                // The line of this joint does not fall where it rises.
                *word = *word & !fall | rise;
            }
            if let Some(word) = samples.get_mut((slot + self.width) as usize) {
                *word |= fall;
            }
            time = time.wrapping_add(interval);
            interval = interval.wrapping_add_signed(segment.ramp);
        }
        self.low = (slot + self.width).saturating_sub(slots);
        self.ready = (slot + 2 * self.width).saturating_sub(slots);
        Ok(())
    }
}

/// Rising edges of a line in the first `sent` words of a period.
#[must_use]
pub fn rises(samples: &Samples, lines: Lines, sent: usize) -> u16 {
    let sent = &samples[..sent.min(SLOTS)];
    let rises = sent.iter().filter(|word| **word & lines.rise() != 0);
    // At most one a slot.
    rises.count() as u16
}
