//! Words for a step generator in a programmable I/O block (PIO of the RP2350), fed by DMA.
//!
//! A word is a wait, and the pulse at its end if there is one. The words of a joint add up to the
//! control periods: what a word lasts beyond its period is missing from the first word of the next
//! one. The state machines therefore need no signal at the start of a period, and the times of all
//! pulses have one constant offset to the controller's.
//!
//! | bits | |
//! | --- | --- |
//! | 0 | level of the direction line, from the start of the word |
//! | 1 | a pulse ends the word |
//! | 2 to 31 | `x`, turns of the waiting loop less one |
//!
//! A tick of the step clock is a turn of the waiting loop: two cycles, because each turn also looks
//! at the emergency stop. A word takes `x + 3` ticks, and one with a pulse the width of the pulse
//! more; the pulse rises `x + 3` ticks after the start of the word:
//!
//! ```text
//! .side_set 1                  the step line
//!     out pins, 1    side 0    direction
//!     out y, 1       side 0    a pulse ends the word
//!     out x, 30      side 0
//! wait:
//!     jmp pin, stop  side 0    the emergency stop is open
//!     jmp x--, wait  side 0
//!     jmp !y, start  side 0
//!     mov y, isr     side 1    the pulse: y + 2 cycles
//! high:
//!     jmp y--, high  side 1
//! .wrap
//! stop:
//!     jmp stop       side 0    until the processor restarts the state machine
//! ```

use haptimill_firmware::io::StepSegment;

/// The program above, assembled for the address 0.
pub const PROGRAM: [u16; 9] = [
    0x6001, // out pins, 1
    0x6041, // out y, 1
    0x603E, // out x, 30
    0x00C8, // jmp pin, 8
    0x0043, // jmp x--, 3
    0x0060, // jmp !y, 0
    0xB046, // mov y, isr      side 1
    0x1087, // jmp y--, 7      side 1
    0x0008, // jmp 8
];

/// Address of the last instruction before the program begins again.
pub const WRAP: u32 = 7;

/// Address at which a state machine stays after an emergency stop.
pub const STOP: u32 = 8;

/// Address of the instruction that a state machine repeats while the step line is high.
pub const PULSE: u32 = 7;

/// Whether a state machine that was stopped at an address holds a word in its registers whose pulse
/// it has not begun. A word of which a part is in the output shift register is not among them: the
/// register holds it.
#[must_use]
pub const fn is_before_pulse(address: u32) -> bool {
    address >= 3 && address < PULSE || address == STOP
}

/// Cycles of the state machine in a tick.
pub const CYCLES_PER_TICK: u32 = 2;

/// Ticks of a word without a pulse and with `x` = 0, and from the start of a word to its pulse.
pub const MIN: u32 = 3;

/// Shortest pulse, ticks.
pub const MIN_WIDTH: u16 = 2;

/// Least set-up and hold times of the direction, ticks: within them the line changes.
pub const MIN_SETUP: u16 = 3;

/// Largest number of words of a joint in a period.
pub const MAX: usize = 512;

/// Value of the state machine's ISR for pulses of `width` ticks, at least [`MIN_WIDTH`].
#[must_use]
pub const fn width_register(width: u16) -> u32 {
    let width = if width < MIN_WIDTH { MIN_WIDTH } else { width };
    width as u32 * CYCLES_PER_TICK - 2
}

/// A segment does not fit into the period or the buffer. It is not emitted: the joint has lost its
/// position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unfit;

/// Encoder of the words of a joint.
#[derive(Debug, Clone)]
pub struct StepWords {
    period: i32,
    width: i32,
    /// Ticks by which the last word ends before the start of the next period; negative after it.
    early: i32,
    up: bool,
}

impl StepWords {
    /// Words for periods of `period` ticks and pulses of `width` ticks, from the start of a period.
    #[must_use]
    pub const fn new(period: u32, width: u16) -> Self {
        Self {
            period: period as i32,
            width: if width < MIN_WIDTH { MIN_WIDTH } else { width } as i32,
            early: 0,
            up: false,
        }
    }

    /// Width of the pulses, ticks.
    #[must_use]
    pub const fn width(&self) -> u16 {
        self.width as u16
    }

    /// Ticks into the next period at which its first word begins; negative before it.
    #[must_use]
    pub const fn begins(&self) -> i32 {
        -self.early
    }

    /// A word that only waits, at least [`MIN`] ticks.
    #[must_use]
    pub const fn wait(&self, ticks: u32) -> u32 {
        let turns = ticks.saturating_sub(MIN);
        turns << 2 | self.up as u32
    }

    /// Writes the words of a period, and returns their number. Requires of the segment what
    /// [`StepSegment`] promises for a pulse of `width` ticks or more, and set-up and hold times of
    /// [`MIN_SETUP`] or more.
    ///
    /// # Errors
    /// [`Unfit`]; then the words are those of a period without steps.
    pub fn fill(&mut self, segment: &StepSegment, words: &mut [u32; MAX]) -> Result<usize, Unfit> {
        let before = (self.early, self.up);
        let result = self.encode(segment, words);
        if result.is_err() {
            (self.early, self.up) = before;
            // A period is always longer than a word, so this cannot fail.
            return self.encode(&StepSegment::default(), words).and(Err(Unfit));
        }
        result
    }

    #[inline]
    fn encode(&mut self, segment: &StepSegment, words: &mut [u32; MAX]) -> Result<usize, Unfit> {
        let count = usize::from(segment.count.unsigned_abs());
        // A word more for a change of the direction, and one for the rest of the period.
        if count + 2 > MAX {
            return Err(Unfit);
        }
        let mut used = 0;
        // Start of the next word, ticks from the start of the period.
        let mut start = -self.early;
        if count > 0 {
            let up = segment.count > 0;
            if up != self.up {
                // Until the direction may change; the pulses are as late.
                let min = MIN as i32;
                let wait = min - start.min(0);
                words[0] = self.wait(wait.unsigned_abs());
                used = 1;
                start += wait;
                self.up = up;
            }
            let at = i32::try_from(segment.delay).map_err(|_| Unfit)?;
            let first = at - start;
            // The turns of a word after another one change by the ramp, so that the first and the
            // last of them bound all.
            let pulse = i64::from(MIN as i32 + self.width);
            let (ramp, gaps) = (i64::from(segment.ramp), count as i64 - 1);
            let second = i64::from(segment.interval) - pulse;
            let last = second + ramp * (gaps - 1).max(0);
            let min = if gaps > 0 { second.min(last) } else { 0 };
            let rises =
                i64::from(at) + i64::from(segment.interval) * gaps + ramp * (gaps * (gaps - 1) / 2);
            if first < 0 || min < 0 || rises >= i64::from(self.period) {
                return Err(Unfit);
            }
            let flags = 0b10 | u32::from(up);
            let pulses = words.get_mut(used..used + count).ok_or(Unfit)?;
            if let [word, rest @ ..] = pulses {
                *word = first.unsigned_abs() << 2 | flags;
                // Below the period in ticks, as all turns here.
                let mut next = (second as u32) << 2 | flags;
                let change = (segment.ramp as u32) << 2;
                // Eight at a time, which the compiler writes out: a turn of a loop costs more than
                // a word.
                let mut put = |word: &mut u32| {
                    *word = next;
                    next = next.wrapping_add(change);
                };
                let (eights, last) = rest.as_chunks_mut::<8>();
                for eight in eights {
                    eight.iter_mut().for_each(&mut put);
                }
                last.iter_mut().for_each(put);
            }
            used += count;
            start = (rises + pulse) as i32;
        }
        let rest = self.period - start;
        if rest >= MIN as i32 {
            words[used] = self.wait(rest.unsigned_abs());
            used += 1;
            self.early = 0;
        } else {
            self.early = rest;
        }
        Ok(used)
    }
}
