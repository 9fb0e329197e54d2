//! Record of the last control period, for a debugger or an emulator: what the controller was given,
//! what it commanded, and the cycles of its stages. It is the first object of the RAM after the
//! stack (`image.x`), at an address that does not depend on the code.
//!
//! | words | |
//! | --- | --- |
//! | 0 | number of the period, lower half; written last |
//! | 1 | missed periods; from bit 16 room of the transmitter |
//! | 2 | home switches; from bit 8 drives that are ready; bit 16 emergency stop, bit 17 out-of-band |
//! | | stop; from bit 24 cause of the last reset, as the flashes of the LED |
//! | 3 | digital inputs; from bit 16 digital outputs |
//! | 4 | received bytes; from bit 16 bytes that wait |
//! | 5 | lost bytes; from bit 16 spindle speed |
//! | 6 to 21 | the received bytes |
//! | 22 to 26 | emitted steps of the joints |
//! | 27 | joints with a step command |
//! | 28 to 47 | their segments: count, delay, interval, ramp |
//! | 48 to 58 | cycles of the stages of the controller |
//! | 59 | cycles from its end to the end of the words |
//! | 60 | changes of inputs that the noise filter suppressed |

use crate::clocks::cycles;
use crate::ending::last_cause;
use crate::pins::JOINTS;
use core::cell::UnsafeCell;
use haptimill_board_common::PERIOD_RECORD_WORDS as WORDS;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};
use haptimill_firmware::profiler::{Profiler, STAGES, Stage};

#[repr(C, align(8))]
struct Record(UnsafeCell<[u32; WORDS]>);

// SAFETY: only `write` uses it, which only PendSV calls.
unsafe impl Sync for Record {}

#[unsafe(link_section = ".period_record")]
#[used]
static RECORD: Record = Record(UnsafeCell::new([0; WORDS]));

/// Writes the record of a period.
pub fn write(inputs: &Inputs, outputs: &Outputs, cycles: &Cycles, glitches: u32) {
    // SAFETY: see `Record`.
    let words = unsafe { &mut *RECORD.0.get() };
    let pair = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
    words[1] = pair(inputs.missed, inputs.transmit_room);
    let bits = |bit: fn(&haptimill_firmware::io::JointInputs) -> bool| {
        let joints = inputs.joints.iter().enumerate();
        joints.fold(0, |all, (joint, inputs)| {
            all | u32::from(bit(inputs)) << joint
        })
    };
    words[2] = bits(|input| input.home)
        | bits(|input| input.drive_ready) << 8
        | u32::from(inputs.emergency_stop) << 16
        | u32::from(inputs.out_of_band_stop) << 17
        | u32::from(last_cause()) << 24;
    words[3] = pair(inputs.digital as u16, outputs.digital as u16);
    words[4] = pair(inputs.received.len() as u16, inputs.waiting);
    words[5] = pair(inputs.lost_bytes, outputs.spindle_rpm as u16);
    for (word, bytes) in words[6..22].iter_mut().zip(inputs.received.chunks(4)) {
        let mut four = [0; 4];
        four[..bytes.len()].copy_from_slice(bytes);
        *word = u32::from_le_bytes(four);
    }
    words[27] = 0;
    for joint in 0..JOINTS {
        words[22 + joint] = inputs.joints[joint].steps as u32;
        if let DriveCommand::Steps(segment) = outputs.joints[joint] {
            words[27] |= 1 << joint;
            let at = 28 + 4 * joint;
            words[at] = i32::from(segment.count) as u32;
            words[at + 1] = segment.delay;
            words[at + 2] = segment.interval;
            words[at + 3] = segment.ramp as u32;
        }
    }
    words[48..48 + STAGES].copy_from_slice(&cycles.stages);
    words[59] = cycles.words;
    words[60] = glitches;
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
