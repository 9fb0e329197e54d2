//! The record of the last control period that an image keeps in its RAM, where its stack begins.
//! Its layout is in [`haptimill_board_common::period_record`].

use haptimill_firmware::io::{DriveCommand, Inputs, StepSegment, Storage};
use haptimill_firmware::profiler::STAGES;
use haptimill_protocol::message::Alarms;

use haptimill_board_common::period_record::{
    ALARMS, BUSY, COUNTS, GLITCHES, LATE, LIMITS, STAGE_WORDS, STEP_WORDS,
};
pub use haptimill_board_common::period_record::{JOINTS, WORDS};

/// A control period of a board.
#[derive(Debug, Clone)]
pub struct Period {
    /// What the controller was given.
    pub inputs: Inputs,
    /// What it commanded.
    pub commands: [DriveCommand; JOINTS],
    /// Cycles of its stages.
    pub stages: [u32; STAGES],
    /// Cycles from the end of the controller to the end of the words for the PIO.
    pub words: u32,
    /// Cause of the last reset, as the flashes of the LED.
    pub cause: u8,
    /// Changes of inputs that the noise filter suppressed.
    pub glitches: u32,
    /// Cycles from the start of the period to the end of its work, all handlers included.
    pub busy: u32,
    /// Cycles from the start of the period to the first work of its handler.
    pub late: u32,
}

impl Period {
    /// Decodes a record; `period_us` is the control period of the image.
    #[must_use]
    pub fn decode(words: &[u32; WORDS], period_us: u32) -> Self {
        let mut inputs = Inputs {
            period: u64::from(words[0]),
            missed: words[1] as u16,
            transmit_room: (words[1] >> 16) as u16,
            time_ns: words[0].wrapping_mul(period_us * 1000),
            emergency_stop: words[2] >> 16 & 1 != 0,
            out_of_band_stop: words[2] >> 17 & 1 != 0,
            storage: Storage::of_code((words[2] >> 18 & 0b111) as u8),
            digital: words[3] & 0xFFFF,
            waiting: (words[4] >> 16) as u16,
            lost_bytes: words[5] as u16,
            ..Inputs::default()
        };
        let count = (words[4] & 0xFFFF) as usize;
        let bytes = words[6..22].iter().flat_map(|word| word.to_le_bytes());
        for byte in bytes.take(count) {
            // The record has room for no more bytes than the inputs.
            let _ = inputs.received.push(byte);
        }
        let alarms = Alarms::of_bits(words[ALARMS]);
        for (axis, seen) in inputs.joints.iter_mut().enumerate() {
            seen.drive_ready = words[2] >> (8 + axis) & 1 != 0;
            seen.alarm = alarms.of(axis).unwrap_or_default();
            if axis < JOINTS {
                seen.home = words[2] >> axis & 1 != 0;
                seen.steps = words[22 + axis] as i32;
                seen.counts = words[COUNTS.0 + axis] as i32;
                seen.edge_time_ns = words[COUNTS.1 + axis];
                seen.limit_low = words[LIMITS] >> axis & 1 != 0;
                seen.limit_high = words[LIMITS] >> (8 + axis) & 1 != 0;
            }
        }
        let commands = core::array::from_fn(|joint| {
            let at = 28 + 4 * joint;
            match words[27] >> joint & 1 {
                0 => DriveCommand::Off,
                _ => DriveCommand::Steps(StepSegment {
                    count: words[at] as i32 as i16,
                    delay: words[at + 1],
                    interval: words[at + 2],
                    ramp: words[at + 3] as i32,
                }),
            }
        });
        Self {
            inputs,
            commands,
            stages: core::array::from_fn(|stage| words[STAGE_WORDS.0 + stage]),
            words: words[STEP_WORDS],
            cause: (words[2] >> 24) as u8,
            glitches: words[GLITCHES],
            busy: words[BUSY],
            late: words[LATE],
        }
    }

    /// Cycles of the controller and of the words for the PIO.
    #[must_use]
    pub fn cycles(&self) -> u32 {
        self.stages.iter().sum::<u32>() + self.words
    }
}
