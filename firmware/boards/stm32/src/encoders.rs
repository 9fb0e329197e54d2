//! Encoders: four timers count the edges of their channels 1 and 2 by themselves, and channel 3
//! captures the count at the rising edge of the index pulse.
//!
//! A timer in encoder mode does not time its edges and does not count illegal transitions. The time
//! of the last edge is that of the latch which found a new count; the count of illegal transitions
//! stays 0.

use crate::registers::timer::{
    CAPTURED_3, CHANNEL_3, CHANNEL_ENABLES, CHANNELS_1_2, CHANNELS_3_4, CONTROL, COUNT,
    OVERWRITTEN_3, RELOAD, RUN, SLAVE, STATUS,
};
use crate::registers::{TIM2, TIM3, TIM4, TIM5, read, write};
use haptimill_board_common::counter::extended;
use haptimill_firmware::io::JointInputs;

/// Joints with an encoder: joints 0 to 3.
pub const ENCODERS: usize = 4;

/// Timer of each encoder, and whether it counts in 32 bits.
const TIMERS: [(usize, bool); ENCODERS] =
    [(TIM2, true), (TIM5, true), (TIM3, false), (TIM4, false)];

/// Counts on both channels, up where channel 1 leads.
const ENCODER_MODE: u32 = 3;
/// An input channel with a filter: an edge lasts for 6 samples at half the clock, 143 ns.
const INPUT: u32 = 1 | 0b0100 << 4;
/// Channels 1, 2 and 3 at their rising edges.
const ENABLED: u32 = 1 | 1 << 4 | 1 << 8;

struct Encoder {
    timer: usize,
    wide: bool,
    counts: i32,
    edge_time_ns: u32,
    index_counts: i32,
    index_pulses: u8,
    /// The last reading found a new count.
    moved: bool,
}

/// All encoders.
pub struct Encoders([Encoder; ENCODERS]);

impl Encoders {
    /// Starts the counters at 0.
    pub fn start() -> Self {
        Self(TIMERS.map(|(timer, wide)| {
            write(timer, CONTROL, 0);
            write(timer, SLAVE, ENCODER_MODE);
            write(timer, CHANNELS_1_2, INPUT | INPUT << 8);
            write(timer, CHANNELS_3_4, INPUT);
            write(timer, CHANNEL_ENABLES, ENABLED);
            write(timer, RELOAD, if wide { u32::MAX } else { 0xFFFF });
            write(timer, COUNT, 0);
            write(timer, STATUS, 0);
            write(timer, CONTROL, RUN);
            Encoder {
                timer,
                wide,
                counts: 0,
                edge_time_ns: 0,
                index_counts: 0,
                index_pulses: 0,
                moved: false,
            }
        }))
    }

    /// Reads all counters, and the captured index pulses.
    pub fn read(&mut self) {
        for encoder in &mut self.0 {
            let status = read(encoder.timer, STATUS);
            let before = encoder.counts;
            encoder.counts = encoder.known(read(encoder.timer, COUNT));
            if status & CAPTURED_3 != 0 {
                // Reading it ends the flag.
                encoder.index_counts = encoder.known(read(encoder.timer, CHANNEL_3));
                let overwritten = status & OVERWRITTEN_3 != 0;
                if overwritten {
                    write(encoder.timer, STATUS, !OVERWRITTEN_3);
                }
                let pulses = 1 + u8::from(overwritten);
                encoder.index_pulses = encoder.index_pulses.wrapping_add(pulses);
            }
            encoder.moved = encoder.counts != before;
        }
    }

    /// Writes what was read into the inputs of the joints. `time_ns` is the time of the latch.
    pub fn latch(&mut self, joints: &mut [JointInputs], time_ns: u32) {
        for (encoder, input) in self.0.iter_mut().zip(joints) {
            if encoder.moved {
                encoder.edge_time_ns = time_ns;
            }
            input.counts = encoder.counts;
            input.edge_time_ns = encoder.edge_time_ns;
            input.index_counts = encoder.index_counts;
            input.index_pulses = encoder.index_pulses;
        }
    }
}

impl Encoder {
    /// A value of the counter in 32 bits, next to the last known count.
    const fn known(&self, value: u32) -> i32 {
        if self.wide {
            value.cast_signed()
        } else {
            extended(self.counts, value as u16)
        }
    }
}
