use super::*;
use crate::io::{
    DriveCommand, ForceSample, HapticInputs, HapticOutputs, JointInputs, LegInputs, StepSegment,
};
use crate::snapshot::{ForceSnapshot, HapticSnapshot, IoSnapshot};
use haptimill_protocol::message::{DriveAlarm, MAX_AXES, State};
use proptest::prelude::*;

fn config() -> ProptestConfig {
    ProptestConfig {
        rng_seed: proptest::test_runner::RngSeed::Fixed(3),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

prop_compose! {
    fn joint()(
        counts: i32, edge_time_ns: u32, illegal: u16, index_counts: i32, index_pulses: u8, steps: i32,
        (home, limit_low, limit_high, drive_ready) in any::<(bool, bool, bool, bool)>(),
        alarm in prop::sample::select(DriveAlarm::ALL.to_vec()),
    ) -> JointInputs {
        JointInputs { counts, edge_time_ns, illegal, index_counts, index_pulses, steps, home, limit_low, limit_high, drive_ready, alarm }
    }
}

prop_compose! {
    fn haptic()(counts: [[i32; 3]; 3], illegal: [[u16; 3]; 3], enabling_switch: bool, drives_ready: bool) -> HapticInputs {
        let legs = core::array::from_fn(|leg| LegInputs { counts: counts[leg], illegal: illegal[leg] });
        HapticInputs { legs, enabling_switch, drives_ready }
    }
}

fn command() -> impl Strategy<Value = DriveCommand> {
    prop_oneof![
        Just(DriveCommand::Off),
        any::<i16>().prop_map(DriveCommand::Torque),
        any::<(i16, u32, u32, i32)>().prop_map(|(count, delay, interval, ramp)| {
            DriveCommand::Steps(StepSegment {
                count,
                delay,
                interval,
                ramp,
            })
        }),
    ]
}

prop_compose! {
    fn snapshot()(
        state in prop::sample::select(State::ALL.to_vec()),
        (homed, fault, compensated, more, queued) in (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>(), 0_u16..0x1000),
        (setpoint, speed_factor, spindle_rpm, program_time) in any::<(u32, u16, i16, u64)>(),
        rows: [[i32; MAX_AXES]; 5],
        [high, low, displacement]: [[i32; 3]; 3],
        [tip, force, feedback, fixture]: [[i32; 3]; 4], directions: [[i16; 3]; 2],
        (inputs, outputs, analog_inputs, analog_outputs) in any::<(u16, u16, [i16; 4], [i16; 4])>(),
    ) -> Snapshot {
        let [commanded, joints_commanded, joints, following_error, drive] = rows;
        Snapshot {
            state, homed, fault, compensated, more, queued, setpoint, speed_factor, spindle_rpm, program_time,
            commanded, joints_commanded, joints, following_error, drive,
            force: ForceSnapshot { high, low, displacement },
            haptic: HapticSnapshot { tip, force, feedback, fixture, axes: directions },
            io: IoSnapshot { inputs, outputs, analog_inputs, analog_outputs },
        }
    }
}

prop_compose! {
    fn done()(
        period: u64,
        joints in prop::array::uniform6(command()),
        (spindle_rpm, transmitted) in any::<(i16, u16)>(),
        (digital, analog) in any::<(u32, [i16; 4])>(),
        (received, waiting, lost_bytes, out_of_band_stop) in any::<(u16, u16, u16, bool)>(),
        stages: [u32; STAGES],
        (enabled, currents) in any::<(bool, [[i16; 2]; 3])>(),
        snapshot in prop::option::of(snapshot()),
    ) -> Done {
        Done {
            period,
            outputs: Outputs { joints, spindle_rpm, digital, analog, haptic: HapticOutputs { enabled, currents }, ..Outputs::default() },
            transmitted,
            line_inputs: LineInputs { received, waiting, lost_bytes, out_of_band_stop },
            stages,
            snapshot,
        }
    }
}

proptest! {
    #![proptest_config(config())]

    /// Every frame to the board decodes to what was encoded.
    #[test]
    fn inputs_arrive(
        period: u64, missed: u16, time_ns: u32, transmit_room: u16, emergency_stop: bool, arrived: u32, storage in 0_u8..5,
        joints in prop::array::uniform6(joint()), period_us: u16, haptic in haptic(), (codes, conversions, overload, digital, analog) in any::<([i16; 3], u8, bool, u32, [i16; 4])>(),
    ) {
        let force = ForceSample { codes, conversions, overload };
        let inputs = Inputs { force, haptic, period, missed, time_ns, transmit_room, emergency_stop, storage: crate::io::Storage::of_code(storage), joints, digital, analog, ..Inputs::default() };
        for message in [ToBoard::Begin { period_us }, ToBoard::Period { inputs, arrived }, ToBoard::End] {
            prop_assert_eq!(ToBoard::decode(&message.encode()), Ok(message));
        }
    }

    /// Every frame from the board decodes to what was encoded.
    #[test]
    fn outputs_arrive(done in done(), stack_bytes: u32, ring_peak: u32) {
        for message in [FromBoard::Hello, FromBoard::Done(done), FromBoard::Ended { stack_bytes, ring_peak }] {
            prop_assert_eq!(FromBoard::decode(&message.encode()), Ok(message));
        }
    }

    /// A frame with a changed bit, or one that starts at another byte, is refused.
    #[test]
    fn damage_is_seen(done in done(), bit in 0..FROM_BOARD_BYTES * 8, shift in 1..FROM_BOARD_BYTES) {
        let mut frame = FromBoard::Done(done).encode();
        let mut shifted = frame;
        shifted.rotate_left(shift);
        prop_assume!(shifted != frame);
        prop_assert!(FromBoard::decode(&shifted).is_err());
        frame[bit / 8] ^= 1 << (bit % 8);
        prop_assert_eq!(FromBoard::decode(&frame), Err(FrameError::Check));
    }

    /// Random bytes are refused without a panic, and leave the inputs unchanged.
    #[test]
    fn noise_is_refused(bytes in prop::collection::vec(any::<u8>(), TO_BOARD_BYTES)) {
        let frame: [u8; TO_BOARD_BYTES] = bytes.try_into().unwrap();
        prop_assert!(ToBoard::decode(&frame).is_err());
        let mut inputs = Inputs { period: 7, ..Inputs::default() };
        let before = inputs.clone();
        prop_assert!(read(&from_bytes(&frame), &mut inputs).is_err());
        prop_assert_eq!(inputs, before);
    }
}

#[test]
fn a_frame_is_sealed_as_it_was() {
    let whole = ToBoard::Begin { period_us: 200 }.encode();
    let mut kept = ToBoard::Begin { period_us: 200 }.encode_unsealed();
    assert_eq!(ToBoard::decode(&kept), Err(FrameError::Check));
    seal(&mut kept);
    assert_eq!(kept, whole);
    for (number, state) in State::ALL.iter().enumerate() {
        assert_eq!(usize::from(state.number()), number);
    }
}
