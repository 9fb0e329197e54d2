//! Record of the last control period, for a debugger or an emulator: what the controller was given
//! and what it commanded. A board keeps it at an address that does not depend on its code.
//!
//! | words | |
//! | --- | --- |
//! | 0 | number of the period, lower half; the board writes it last |
//! | 1 | missed periods; from bit 16 free bytes of the transmitter |
//! | 2 | home switches; from bit 8 drives that are ready; bit 16 emergency stop |
//! | | bit 17 out-of-band stop; from bit 18 state of the memory for a configuration; from bit 24 cause of the last reset, as the flashes of the LED |
//! | 3 | digital inputs; from bit 16 digital outputs |
//! | 4 | received bytes; from bit 16 bytes that wait |
//! | 5 | lost bytes; from bit 16 spindle speed |
//! | 6 to 21 | the received bytes |
//! | 22 to 26 | emitted steps of the joints |
//! | 27 | joints with a step command |
//! | 28 to 47 | their segments: count, delay, interval, ramp |
//! | 48 to 58 | cycles of the stages of the controller, or 0 |
//! | 59 | cycles from its end to the end of the words, or 0 |
//! | 60 | changes of inputs that the noise filter suppressed |
//! | 61 | cycles from the start of the period to the end of this record, all handlers included |
//! | 62 | cycles from the start of the period to the first work of its handler, or 0 |
//! | 63 | why drives are not ready, four bits per joint |
//! | 64 to 68 | counts of the encoders, or 0 |
//! | 69 to 73 | times of their last edges, or 0 |
//! | 74 | limit switches at the lower ends; from bit 8 those at the upper ends; or 0 |

use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};

/// Words of the record.
pub const WORDS: usize = 75;
/// Joints in it.
pub const JOINTS: usize = 5;

/// Words of the stages: the first one, and the one behind them.
pub const STAGE_WORDS: (usize, usize) = (48, 59);
/// Word of the cycles of the step words.
pub const STEP_WORDS: usize = 59;
/// Word of the suppressed changes of inputs.
pub const GLITCHES: usize = 60;
/// Word of the cycles of the whole period.
pub const BUSY: usize = 61;
/// Word of the cycles until the handler works.
pub const LATE: usize = 62;

/// Word of the alarms of the drives.
pub const ALARMS: usize = 63;
/// First words of the counts and of the times of the edges.
pub const COUNTS: (usize, usize) = (64, 69);
/// Word of the limit switches.
pub const LIMITS: usize = 74;

/// Writes the words 64 to 74, of a board with encoders and limit switches.
pub fn write_encoders(words: &mut [u32; WORDS], inputs: &Inputs) {
    words[LIMITS] = 0;
    for (joint, input) in inputs.joints[..JOINTS].iter().enumerate() {
        words[COUNTS.0 + joint] = input.counts as u32;
        words[COUNTS.1 + joint] = input.edge_time_ns;
        words[LIMITS] |= (u32::from(input.limit_low) | u32::from(input.limit_high) << 8) << joint;
    }
}

/// Writes the words 1 to 47 and [`ALARMS`]; `cause` is that of the last reset.
pub fn write(words: &mut [u32; WORDS], inputs: &Inputs, outputs: &Outputs, cause: u8) {
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
        | (inputs.storage as u32) << 18
        | u32::from(cause) << 24;
    words[3] = pair(inputs.digital as u16, outputs.digital as u16);
    words[4] = pair(inputs.received.len() as u16, inputs.waiting);
    words[5] = pair(inputs.lost_bytes, outputs.spindle_rpm as u16);
    for (word, bytes) in words[6..22].iter_mut().zip(inputs.received.chunks(4)) {
        let mut four = [0; 4];
        four[..bytes.len()].copy_from_slice(bytes);
        *word = u32::from_le_bytes(four);
    }
    words[ALARMS] = inputs.alarms().bits();
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
}
