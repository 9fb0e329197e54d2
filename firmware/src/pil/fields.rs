//! Fields of the PIL frames. The two directions handle the same words in the same order.

use super::words::{Reader, Writer};
use super::{Done, DoneRef, FrameError, LineInputs};
use crate::io::{
    ANALOG, DriveCommand, ForceSample, HapticInputs, HapticOutputs, JointInputs, LegInputs,
    StepSegment,
};
use crate::snapshot::{ForceSnapshot, HapticSnapshot, IoSnapshot, Snapshot};
use haptimill_protocol::message::{DriveAlarm, State};

#[inline(always)]
pub(super) fn put_analog(words: &mut Writer<'_>, codes: [i16; ANALOG]) {
    let [a, b, c, d] = codes.map(|code| u32::from(code as u16));
    words.put_all([a | b << 16, c | d << 16]);
}

#[inline(always)]
pub(super) fn take_analog(words: &mut Reader<'_>) -> [i16; ANALOG] {
    let [low, high] = words.take_all();
    [
        low as i16,
        (low >> 16) as i16,
        high as i16,
        (high >> 16) as i16,
    ]
}

pub(super) fn put_force(words: &mut Writer<'_>, force: &ForceSample) {
    let [x, y, z] = force.codes.map(|code| u32::from(code as u16));
    let rest = z | u32::from(force.conversions) << 16 | u32::from(force.overload) << 24;
    words.put_all([x | y << 16, rest]);
}

#[inline(always)]
pub(super) fn take_force(words: &mut Reader<'_>) -> ForceSample {
    let [pair, rest] = words.take_all();
    ForceSample {
        codes: [pair as i16, (pair >> 16) as i16, rest as i16],
        conversions: (rest >> 16) as u8,
        overload: rest >> 24 & 1 != 0,
    }
}

pub(super) fn put_haptic(words: &mut Writer<'_>, haptic: &HapticInputs) {
    words.put(u32::from(haptic.enabling_switch) | u32::from(haptic.drives_ready) << 1);
    for leg in &haptic.legs {
        words.put_vector(&leg.counts);
        let [first, second, third] = leg.illegal.map(u32::from);
        words.put_all([first | second << 16, third]);
    }
}

#[inline(always)]
pub(super) fn take_haptic(words: &mut Reader<'_>, haptic: &mut HapticInputs) {
    let bits = words.take();
    haptic.enabling_switch = bits & 1 != 0;
    haptic.drives_ready = bits & 2 != 0;
    for leg in &mut haptic.legs {
        let [x, y, z, pair, third] = words.take_all();
        *leg = LegInputs {
            counts: [x as i32, y as i32, z as i32],
            illegal: [pair as u16, (pair >> 16) as u16, third as u16],
        };
    }
}

#[inline(always)]
fn put_currents(words: &mut Writer<'_>, haptic: &HapticOutputs) {
    words.put(u32::from(haptic.enabled));
    let pair = |[force, torque]: [i16; 2]| u32::from(force as u16) | u32::from(torque as u16) << 16;
    let [first, second, third] = haptic.currents;
    words.put_all([pair(first), pair(second), pair(third)]);
}

fn take_currents(words: &mut Reader<'_>) -> HapticOutputs {
    let mut haptic = HapticOutputs {
        enabled: words.take() & 1 != 0,
        ..HapticOutputs::default()
    };
    for leg in &mut haptic.currents {
        let pair = words.take();
        *leg = [pair as i16, (pair >> 16) as i16];
    }
    haptic
}

pub(super) fn put_joint(words: &mut Writer<'_>, joint: &JointInputs) {
    let bits = [
        joint.home,
        joint.limit_low,
        joint.limit_high,
        joint.drive_ready,
    ];
    let bits = bits
        .iter()
        .rev()
        .fold(0, |all, &bit| all << 1 | u32::from(bit));
    words.put_all([
        joint.counts as u32,
        joint.edge_time_ns,
        joint.index_counts as u32,
        joint.steps as u32,
        u32::from(joint.illegal)
            | u32::from(joint.index_pulses) << 16
            | bits << 24
            | u32::from(joint.alarm.code() - 1) << 28,
    ]);
}

#[inline(always)]
pub(super) fn take_joint(words: &mut Reader<'_>) -> JointInputs {
    let [counts, edge_time_ns, index_counts, steps, rest] = words.take_all();
    let bit = |index: u32| rest >> (24 + index) & 1 != 0;
    JointInputs {
        counts: counts as i32,
        edge_time_ns,
        illegal: rest as u16,
        index_counts: index_counts as i32,
        index_pulses: (rest >> 16) as u8,
        steps: steps as i32,
        home: bit(0),
        limit_low: bit(1),
        limit_high: bit(2),
        drive_ready: bit(3),
        alarm: DriveAlarm::of_code((rest >> 28) as u8 + 1).unwrap_or_default(),
    }
}

#[inline(always)]
pub(super) fn put_done(words: &mut Writer<'_>, done: &DoneRef<'_>) {
    words.put_long(done.period);
    for command in &done.outputs.joints {
        words.put_all(match command {
            DriveCommand::Off => [0; 4],
            DriveCommand::Torque(code) => [1 | u32::from(*code as u16) << 16, 0, 0, 0],
            DriveCommand::Steps(steps) => [
                2 | u32::from(steps.count as u16) << 16,
                steps.delay,
                steps.interval,
                steps.ramp as u32,
            ],
        });
    }
    put_currents(words, &done.outputs.haptic);
    let line_inputs = &done.line_inputs;
    words.put_all([
        u32::from(done.outputs.spindle_rpm as u16) | u32::from(done.transmitted) << 16,
        u32::from(line_inputs.received) | u32::from(line_inputs.waiting) << 16,
        u32::from(line_inputs.lost_bytes) | u32::from(line_inputs.out_of_band_stop) << 16,
    ]);
    words.put(done.outputs.digital);
    put_analog(words, done.outputs.analog);
    words.put_all(*done.stages);
    let Some(snapshot) = done.snapshot else {
        return;
    };
    let state = u32::from(snapshot.state.number());
    let flags =
        u32::from(snapshot.homed) | u32::from(snapshot.fault) << 2 | u32::from(snapshot.more) << 3;
    words.put_all([
        1 | u32::from(snapshot.compensated) << 1
            | state << 8
            | flags << 16
            | u32::from(snapshot.queued & 0xFFF) << 20,
        snapshot.setpoint,
        u32::from(snapshot.speed_factor) | u32::from(snapshot.spindle_rpm as u16) << 16,
    ]);
    words.put_long(snapshot.program_time);
    words.put_axes(&snapshot.commanded);
    words.put_axes(&snapshot.joints_commanded);
    words.put_axes(&snapshot.joints);
    words.put_axes(&snapshot.following_error);
    words.put_axes(&snapshot.drive);
    let (force, haptic) = (&snapshot.force, &snapshot.haptic);
    words.put_vector(&force.high);
    words.put_vector(&force.low);
    words.put_vector(&force.displacement);
    words.put_vector(&haptic.tip);
    words.put_vector(&haptic.force);
    words.put_vector(&haptic.feedback);
    words.put_vector(&haptic.fixture);
    let [x, z] = haptic.axes;
    let pair = |low: i16, high: i16| u32::from(low as u16) | u32::from(high as u16) << 16;
    words.put_all([pair(x[0], x[1]), pair(x[2], z[0]), pair(z[1], z[2])]);
    let io = &snapshot.io;
    words.put(u32::from(io.inputs) | u32::from(io.outputs) << 16);
    put_analog(words, io.analog_inputs);
    put_analog(words, io.analog_outputs);
}

fn take_directions(words: &mut Reader<'_>) -> [[i16; 3]; 2] {
    let [first, second, third] = words.take_all();
    let (low, high) = (|pair: u32| pair as i16, |pair: u32| (pair >> 16) as i16);
    [
        [low(first), high(first), low(second)],
        [high(second), low(third), high(third)],
    ]
}

fn take_io(words: &mut Reader<'_>) -> IoSnapshot {
    let pair = words.take();
    IoSnapshot {
        inputs: pair as u16,
        outputs: (pair >> 16) as u16,
        analog_inputs: take_analog(words),
        analog_outputs: take_analog(words),
    }
}

pub(super) fn take_done(words: &mut Reader<'_>) -> Result<Done, FrameError> {
    let mut done = Done {
        period: words.take_long(),
        ..Done::default()
    };
    for command in &mut done.outputs.joints {
        let [kind, delay, interval, ramp] = words.take_all();
        let value = (kind >> 16) as i16;
        *command = match kind & 0xFFFF {
            0 => DriveCommand::Off,
            1 => DriveCommand::Torque(value),
            2 => DriveCommand::Steps(StepSegment {
                count: value,
                delay,
                interval,
                ramp: ramp as i32,
            }),
            _ => return Err(FrameError::Content),
        };
    }
    done.outputs.haptic = take_currents(words);
    let [pair, bytes, rest] = words.take_all();
    done.outputs.spindle_rpm = pair as i16;
    done.transmitted = (pair >> 16) as u16;
    done.line_inputs = LineInputs {
        received: bytes as u16,
        waiting: (bytes >> 16) as u16,
        lost_bytes: rest as u16,
        out_of_band_stop: rest >> 16 & 1 != 0,
    };
    done.outputs.digital = words.take();
    done.outputs.analog = take_analog(words);
    done.stages = words.take_all();
    let head = words.take();
    if head & 1 == 0 {
        return Ok(done);
    }
    let state = State::ALL.get((head >> 8 & 0xFF) as usize);
    let [setpoint, pair] = words.take_all();
    done.snapshot = Some(Snapshot {
        state: *state.ok_or(FrameError::Content)?,
        homed: head >> 16 & 1 != 0,
        fault: head >> 18 & 1 != 0,
        compensated: head >> 1 & 1 != 0,
        more: head >> 19 & 1 != 0,
        queued: (head >> 20) as u16,
        setpoint,
        speed_factor: pair as u16,
        spindle_rpm: (pair >> 16) as i16,
        program_time: words.take_long(),
        commanded: words.take_row(),
        joints_commanded: words.take_row(),
        joints: words.take_row(),
        following_error: words.take_row(),
        drive: words.take_row(),
        force: ForceSnapshot {
            high: words.take_row(),
            low: words.take_row(),
            displacement: words.take_row(),
        },
        haptic: HapticSnapshot {
            tip: words.take_row(),
            force: words.take_row(),
            feedback: words.take_row(),
            fixture: words.take_row(),
            axes: take_directions(words),
        },
        io: take_io(words),
    });
    Ok(done)
}
