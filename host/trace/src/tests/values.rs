//! Random records and periods.

use crate::*;
use haptimill_firmware::snapshot::{ForceSnapshot, IoSnapshot};
use proptest::prelude::*;

pub fn any_record() -> impl Strategy<Value = Record> {
    let axes = || prop::array::uniform6(any::<i32>());
    (
        (
            any::<u64>(),
            any::<u32>(),
            any::<u32>(),
            any::<u16>(),
            any::<u16>(),
        ),
        (0..State::ALL.len(), any::<u8>()),
        prop::array::uniform7(axes()),
        any::<[[i32; 3]; 4]>(),
        any::<(u16, u16, [i16; 4], [i16; 4])>(),
    )
        .prop_map(
            |(
                (period, setpoint, line, speed_factor, spindle_rpm),
                (state, flags),
                rows,
                [high, low, displacement, true_force],
                (inputs, outputs, analog_inputs, analog_outputs),
            )| {
                let [
                    commanded,
                    joints_commanded,
                    joints,
                    following_error,
                    drive,
                    tool,
                    programmed,
                ] = rows;
                Record {
                    period,
                    setpoint,
                    line,
                    speed_factor,
                    spindle_rpm: spindle_rpm as i16,
                    state: State::ALL[state],
                    flags,
                    commanded,
                    joints_commanded,
                    joints,
                    following_error,
                    drive,
                    tool,
                    programmed,
                    force: ForceSnapshot {
                        high,
                        low,
                        displacement,
                    },
                    true_force,
                    io: IoSnapshot {
                        inputs,
                        outputs,
                        analog_inputs,
                        analog_outputs,
                    },
                    ..Record::default()
                }
            },
        )
}

pub fn any_period() -> impl Strategy<Value = Period> {
    use haptimill_firmware::io::{DriveCommand, Inputs, JointInputs, StepSegment};
    // Small and large differences, and half words.
    let word = || {
        prop_oneof![
            -3..3_i32,
            -40_000..40_000_i32,
            (-3..3_i32).prop_map(|value| value << 16),
            any::<i32>()
        ]
    };
    let axis = (word(), word(), any::<u16>(), any::<u8>(), any::<bool>()).prop_map(
        |(counts, edge, illegal, index_pulses, bit)| JointInputs {
            counts,
            edge_time_ns: edge as u32,
            illegal,
            index_pulses,
            home: bit,
            drive_ready: !bit,
            ..JointInputs::default()
        },
    );
    let command = prop_oneof![
        Just(DriveCommand::Off),
        any::<i16>().prop_map(DriveCommand::Torque),
        (any::<i16>(), word(), word()).prop_map(|(count, delay, ramp)| DriveCommand::Steps(
            StepSegment {
                count,
                delay: delay as u32,
                interval: 0,
                ramp,
            }
        )),
    ];
    let bytes = || prop::collection::vec(any::<u8>(), 0..=64);
    (
        (
            any::<u64>(),
            any::<u16>(),
            word(),
            any::<[i16; 3]>(),
            any::<(u16, u16, bool, bool)>(),
        ),
        prop::array::uniform6(axis),
        prop::array::uniform6(command),
        (any::<i16>(), bytes(), bytes()),
    )
        .prop_map(
            |(
                (period, missed, time, codes, line),
                axes,
                commands,
                (spindle_rpm, received, transmit),
            )| {
                let mut inputs = Inputs {
                    period,
                    missed,
                    time_ns: time as u32,
                    joints: axes,
                    waiting: line.0,
                    lost_bytes: line.1,
                    out_of_band_stop: line.2,
                    emergency_stop: line.3,
                    received: heapless::Vec::from_slice(&received).unwrap(),
                    ..Inputs::default()
                };
                inputs.force.codes = codes;
                inputs.digital = u32::from(line.0) << 9;
                inputs.analog = [codes[0], 1, codes[1], -2];
                let mut period = Period {
                    inputs,
                    ..Period::default()
                };
                period.inputs.haptic.legs[1].counts = [period.inputs.joints[0].counts, 3, -7];
                period.outputs.haptic.currents[2] = [codes[1], codes[2]];
                period.outputs.joints = commands;
                period.outputs.spindle_rpm = spindle_rpm;
                period.outputs.digital = u32::from(line.1) << 3;
                period.outputs.analog = [-1, codes[2], 2, codes[0]];
                period.outputs.transmit = heapless::Vec::from_slice(&transmit).unwrap();
                period
            },
        )
}
