//! What stands in the frames. Both directions visit the same words.

use super::words::{Reader, Writer};
use super::{Done, FrameError, Heard, Told};
use crate::io::{
    AxisInputs, DriveCommand, ForceSample, HapticInputs, HapticOutputs, LegInputs, StepSegment,
};
use crate::reading::Reading;
use haptimill_protocol::message::State;

pub(super) fn put_force(words: &mut Writer<'_>, force: &ForceSample) {
    let [x, y, z] = force.codes.map(|code| u32::from(code as u16));
    words.put(x | y << 16);
    words.put(z | u32::from(force.conversions) << 16 | u32::from(force.overload) << 24);
}

#[inline(always)]
pub(super) fn take_force(words: &mut Reader<'_>) -> ForceSample {
    let (pair, rest) = (words.take(), words.take());
    ForceSample {
        codes: [pair, pair >> 16, rest].map(|code| code as u16 as i16),
        conversions: (rest >> 16) as u8,
        overload: rest >> 24 & 1 != 0,
    }
}

pub(super) fn put_hand(words: &mut Writer<'_>, hand: &HapticInputs) {
    words.put(u32::from(hand.engaged) | u32::from(hand.drives_ready) << 1);
    for leg in &hand.legs {
        leg.counts
            .iter()
            .for_each(|&counts| words.put(counts as u32));
        let [first, second, third] = leg.illegal.map(u32::from);
        words.put(first | second << 16);
        words.put(third);
    }
}

#[inline(always)]
pub(super) fn take_hand(words: &mut Reader<'_>) -> HapticInputs {
    let bits = words.take();
    let mut hand = HapticInputs {
        engaged: bits & 1 != 0,
        drives_ready: bits & 2 != 0,
        ..HapticInputs::default()
    };
    for leg in &mut hand.legs {
        let counts = [words.take(), words.take(), words.take()].map(|word| word as i32);
        let (pair, third) = (words.take(), words.take());
        *leg = LegInputs {
            counts,
            illegal: [pair as u16, (pair >> 16) as u16, third as u16],
        };
    }
    hand
}

#[inline(always)]
fn put_currents(words: &mut Writer<'_>, hand: &HapticOutputs) {
    words.put(u32::from(hand.enabled));
    for [force, torque] in hand.currents {
        words.put(u32::from(force as u16) | u32::from(torque as u16) << 16);
    }
}

fn take_currents(words: &mut Reader<'_>) -> HapticOutputs {
    let mut hand = HapticOutputs {
        enabled: words.take() & 1 != 0,
        ..HapticOutputs::default()
    };
    for leg in &mut hand.currents {
        let pair = words.take();
        *leg = [pair as i16, (pair >> 16) as i16];
    }
    hand
}

pub(super) fn put_axis(words: &mut Writer<'_>, axis: &AxisInputs) {
    words.put(axis.counts as u32);
    words.put(axis.edge_time_ns);
    words.put(axis.index_counts as u32);
    words.put(axis.steps as u32);
    let bits = [axis.home, axis.limit_low, axis.limit_high, axis.drive_ready];
    let bits = bits
        .iter()
        .rev()
        .fold(0, |all, &bit| all << 1 | u32::from(bit));
    words.put(u32::from(axis.illegal) | u32::from(axis.index_pulses) << 16 | bits << 24);
}

#[inline(always)]
pub(super) fn take_axis(words: &mut Reader<'_>) -> AxisInputs {
    let (counts, edge_time_ns) = (words.take() as i32, words.take());
    let (index_counts, steps) = (words.take() as i32, words.take() as i32);
    let rest = words.take();
    let bit = |index: u32| rest >> (24 + index) & 1 != 0;
    AxisInputs {
        counts,
        edge_time_ns,
        illegal: rest as u16,
        index_counts,
        index_pulses: (rest >> 16) as u8,
        steps,
        home: bit(0),
        limit_low: bit(1),
        limit_high: bit(2),
        drive_ready: bit(3),
    }
}

#[inline(always)]
pub(super) fn put_done(words: &mut Writer<'_>, done: &Told<'_>) {
    words.put_long(done.period);
    for command in &done.outputs.axes {
        let (kind, row) = match command {
            DriveCommand::Off => (0, [0; 3]),
            DriveCommand::Torque(code) => (1 | u32::from(*code as u16) << 16, [0; 3]),
            DriveCommand::Steps(steps) => (
                2 | u32::from(steps.count as u16) << 16,
                [steps.delay, steps.interval, steps.ramp as u32],
            ),
        };
        words.put(kind);
        row.into_iter().for_each(|word| words.put(word));
    }
    put_currents(words, &done.outputs.haptic);
    words.put(u32::from(done.outputs.spindle_rpm as u16) | u32::from(done.said) << 16);
    let heard = &done.heard;
    words.put(u32::from(heard.received) | u32::from(heard.waiting) << 16);
    words.put(u32::from(heard.lost_bytes) | u32::from(heard.urgent) << 16);
    done.stages.iter().for_each(|&ticks| words.put(ticks));
    let Some(reading) = done.reading else {
        return;
    };
    let state = u32::from(reading.state.number());
    let flags = u32::from(reading.homed)
        | u32::from(reading.position_kept) << 1
        | u32::from(reading.fault) << 2
        | u32::from(reading.more) << 3;
    words.put(1 | state << 8 | flags << 16 | u32::from(reading.queued & 0xFFF) << 20);
    words.put(reading.setpoint);
    words.put(u32::from(reading.path_rate) | u32::from(reading.spindle_rpm as u16) << 16);
    words.put_long(reading.program_time);
    for row in [
        &reading.wanted,
        &reading.joints_wanted,
        &reading.joints,
        &reading.following_error,
        &reading.drive,
    ] {
        words.put_row(row);
    }
    let (force, hand) = (&reading.force, &reading.hand);
    for row in [
        &force.high,
        &force.low,
        &force.yielded,
        &hand.tip,
        &hand.force,
        &hand.reflected,
        &hand.wall,
    ] {
        words.put_row(row);
    }
}

pub(super) fn take_done(words: &mut Reader<'_>) -> Result<Done, FrameError> {
    let mut done = Done {
        period: words.take_long(),
        ..Done::default()
    };
    for command in &mut done.outputs.axes {
        let kind = words.take();
        let (delay, interval, ramp) = (words.take(), words.take(), words.take() as i32);
        let value = (kind >> 16) as i16;
        *command = match kind & 0xFFFF {
            0 => DriveCommand::Off,
            1 => DriveCommand::Torque(value),
            2 => DriveCommand::Steps(StepSegment {
                count: value,
                delay,
                interval,
                ramp,
            }),
            _ => return Err(FrameError::Content),
        };
    }
    done.outputs.haptic = take_currents(words);
    let pair = words.take();
    done.outputs.spindle_rpm = pair as i16;
    done.said = (pair >> 16) as u16;
    let (pair, rest) = (words.take(), words.take());
    done.heard = Heard {
        received: pair as u16,
        waiting: (pair >> 16) as u16,
        lost_bytes: rest as u16,
        urgent: rest >> 16 & 1 != 0,
    };
    for ticks in &mut done.stages {
        *ticks = words.take();
    }
    let head = words.take();
    if head & 1 == 0 {
        return Ok(done);
    }
    let state = State::ALL.get((head >> 8 & 0xFF) as usize);
    let mut reading = Reading {
        state: *state.ok_or(FrameError::Content)?,
        homed: head >> 16 & 1 != 0,
        position_kept: head >> 17 & 1 != 0,
        fault: head >> 18 & 1 != 0,
        more: head >> 19 & 1 != 0,
        queued: (head >> 20) as u16,
        setpoint: words.take(),
        ..Reading::default()
    };
    let pair = words.take();
    reading.path_rate = pair as u16;
    reading.spindle_rpm = (pair >> 16) as i16;
    reading.program_time = words.take_long();
    let rows = [
        &mut reading.wanted,
        &mut reading.joints_wanted,
        &mut reading.joints,
        &mut reading.following_error,
        &mut reading.drive,
    ];
    let force = &mut reading.force;
    let forces = [&mut force.high, &mut force.low, &mut force.yielded];
    let hand = &mut reading.hand;
    let hands = [
        &mut hand.tip,
        &mut hand.force,
        &mut hand.reflected,
        &mut hand.wall,
    ];
    for value in rows
        .into_iter()
        .flatten()
        .chain(forces.into_iter().chain(hands).flatten())
    {
        *value = words.take() as i32;
    }
    done.reading = Some(reading);
    Ok(done)
}
