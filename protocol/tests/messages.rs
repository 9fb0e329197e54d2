//! The largest encoding of every message fits its frame, and each decodes to the same value.

use haptimill_protocol::force::{
    COMPONENTS, EnableCondition, ForceLoop, ForceParameter, ForceProblem, ForceRefusal,
    ForceTelemetry, TareRefusal,
};
use haptimill_protocol::frame::MAX_PAYLOAD;
use haptimill_protocol::haptic::{
    ForceFeedback, ForceFeedbackAxis, MasterPose, MasterProblem, MasterTelemetry, VirtualFixture,
};
use haptimill_protocol::link::SHORT_REPORT;
use haptimill_protocol::message::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;

/// Returns the bytes of a message, after a round trip without change.
fn size<T: Serialize + DeserializeOwned + PartialEq + Debug>(message: &T) -> usize {
    let mut buffer = [0; 1024];
    let bytes = postcard::to_slice(message, &mut buffer).unwrap();
    assert_eq!(postcard::from_bytes::<T>(bytes).as_ref(), Ok(message));
    bytes.len()
}

/// Values with the longest encoding.
fn values() -> AxisValues {
    [i32::MIN; MAX_AXES].into_iter().collect()
}

/// A master pose with the longest encoding.
const HAPTICS: MasterPose = MasterPose {
    tip: [i32::MIN; COMPONENTS],
    rate: [i32::MIN; COMPONENTS],
    axes: [[i16::MIN; COMPONENTS]; 2],
    enabling_switch: true,
};

#[test]
fn every_request_fits_a_frame() {
    let delta = SetpointDelta {
        periods: u16::MAX,
        moved: 0b11_1111,
        residuals: [i32::MIN; 2 * MAX_AXES].into_iter().collect(),
        action: Action::AnalogOutput {
            output: u8::MAX,
            code: i16::MIN,
        },
    };
    let items = core::iter::repeat_n(delta, SETPOINT_BATCH).collect();
    let chunk = ConfigChunk {
        offset: u16::MAX,
        bytes: [255; CONFIG_CHUNK].into_iter().collect(),
    };
    let commands = [
        Command::Setpoints(SetpointBatch {
            first: u32::MAX,
            items,
        }),
        Command::Configure(chunk),
        Command::Activate {
            length: u16::MAX,
            crc: u32::MAX,
            at_preset: true,
        },
        Command::JobStart {
            job: u32::MAX,
            pose: values(),
        },
        Command::JobEnd { count: u32::MAX },
        Command::Jog {
            epoch: u16::MAX,
            timeout_ms: u16::MAX,
            rates: values(),
        },
        Command::Source {
            coordinate: 5,
            source: Source::Hold,
        },
        Command::Telemetry { every: u16::MAX },
        Command::Status,
        Command::ForceMask { mask: u8::MAX },
        Command::ForceLoop {
            axis: u8::MAX,
            settings: ForceLoop {
                setpoint: i32::MIN,
                mass: u32::MAX,
                damping: u32::MAX,
                limit: i32::MIN,
                rate: i32::MIN,
                enable_condition: EnableCondition::Negative,
            },
        },
        Command::Tare,
        Command::MasterPose {
            epoch: u16::MAX,
            age_ms: u8::MAX,
            pose: HAPTICS,
        },
        Command::RemoteForce {
            force: [i16::MIN; COMPONENTS],
        },
        Command::ForceFeedback(ForceFeedback {
            axes: [ForceFeedbackAxis {
                percent: u8::MAX,
                limit: i32::MIN,
            }; COMPONENTS],
            damping: u16::MAX,
            damping_below: i32::MIN,
        }),
        Command::VirtualFixture {
            axis: u8::MAX,
            upper: true,
            fixture: Some(VirtualFixture {
                at: Some(i32::MIN),
                rate: i32::MIN,
            }),
        },
        Command::PositionScale { scale: u16::MAX },
        Command::MasterTelemetry { every: u16::MAX },
        Command::SetAnalogOutput {
            output: u8::MAX,
            code: i16::MIN,
        },
        Command::ArmProbe {
            input: u8::MAX,
            active: true,
        },
        Command::Compensation { on: true },
        Command::MoveOff { joint: u8::MAX },
    ];
    let sizes = commands.map(|command| size(&Request { id: 255, command }));
    println!("requests: {sizes:?} bytes");
    assert!(sizes.into_iter().all(|bytes| bytes <= MAX_PAYLOAD));
}

#[test]
fn hello_and_welcome_fit_a_frame() {
    let hello = Hello {
        version: u16::MAX,
        schema: u64::MAX,
        session: u32::MAX,
    };
    let welcome = Welcome {
        version: u16::MAX,
        schema: u64::MAX,
        session: u32::MAX,
        refused: Some(HelloRefusal::Schema),
        machine: "ABCDEFGHIJKLMNOPQRSTUVWX".try_into().unwrap(),
        config_crc: u32::MAX,
        period_us: u16::MAX,
        axes: 255,
        queue: u16::MAX,
        kept: Kept::Refused(Refusal::JointRate {
            setpoint: u32::MAX,
            joint: u8::MAX,
            rate: i32::MIN,
            limit: i32::MIN,
        }),
    };
    assert!(size(&hello) <= MAX_PAYLOAD && size(&welcome) <= MAX_PAYLOAD);
}

#[test]
fn every_report_fits_a_frame_and_answers_and_events_are_short() {
    let fault = Fault::FollowingError {
        joint: 255,
        error: i32::MIN,
        limit: i32::MIN,
    };
    let problem = ForceProblem::Limit {
        component: 255,
        force: i32::MIN,
    };
    let telemetry = Telemetry {
        period: u64::MAX,
        state: State::EmergencyStop,
        homed: true,
        credit: u32::MAX,
        setpoint: u32::MAX,
        program_periods: u32::MAX,
        speed_factor: u16::MAX,
        commanded: values(),
        measured: values(),
        joints: values(),
        turns: values(),
        following_error: values(),
        open_loop: u8::MAX,
        drive: values(),
        fault: Some(fault),
        deferred_bytes: u32::MAX,
        bad_frames: u32::MAX,
        lost_bytes: u32::MAX,
        force: None,
        io: Some(IoTelemetry {
            inputs: u16::MAX,
            outputs: u16::MAX,
            analog_inputs: [i16::MIN; ANALOG].into_iter().collect(),
            analog_outputs: [i16::MIN; ANALOG].into_iter().collect(),
        }),
        more: MoreTelemetry::CompensationAndLines(
            u8::MAX,
            ActiveLines {
                switches: [u8::MAX; 3],
                alarms: Alarms::of_bits(u32::MAX),
                emergency_stop: true,
            },
        ),
    };
    let without = size(&Report::Telemetry(telemetry.clone()));
    let telemetry = Telemetry {
        force: Some(ForceTelemetry {
            high: [i32::MIN; COMPONENTS],
            low: [i32::MIN; COMPONENTS],
            displacement: [i32::MIN; COMPONENTS],
            mask: u8::MAX,
            tared: true,
            problem: Some(problem),
        }),
        ..telemetry
    };
    let long = size(&Report::Telemetry(telemetry));
    println!("telemetry without a force sensor: {without} bytes");
    println!("telemetry: {long} bytes");
    // The value in the documentation of MAX_PAYLOAD.
    assert_eq!(long, 345);
    assert!(long <= MAX_PAYLOAD);
    let hand = size(&Report::Master(MasterTelemetry {
        period: u64::MAX,
        pose: HAPTICS,
        force: [i16::MIN; COMPONENTS],
        feedback: [i16::MIN; COMPONENTS],
        fixture: [i16::MIN; COMPONENTS],
        energy: i16::MIN,
        enabled: true,
        problem: Some(MasterProblem::Encoder {
            leg: u8::MAX,
            by: i32::MIN,
        }),
    }));
    println!("hand: {hand} bytes");
    assert!(hand <= MAX_PAYLOAD);

    let pose = PoseError::OutOfStroke {
        joint: 255,
        by: i32::MIN,
    };
    let period = u64::MAX;
    let short = [
        Report::Event {
            period,
            event: Event::ProbedAt {
                coordinate: 255,
                measured: i32::MIN,
                commanded: i32::MIN,
                joint: i32::MIN,
            },
        },
        Report::Event {
            period,
            event: Event::Probed {
                input: 255,
                period,
                is_measured: true,
            },
        },
        Report::Answer {
            id: 255,
            result: Err(Refusal::AnalogOutput {
                output: 255,
                problem: OutputProblem::SpindleTurns,
            }),
        },
        Report::Answer {
            id: 255,
            result: Err(Refusal::Pose {
                setpoint: u32::MAX,
                error: pose,
            }),
        },
        Report::Answer {
            id: 255,
            result: Ok(()),
        },
        Report::Event {
            period,
            event: Event::Fault(fault),
        },
        Report::Event {
            period,
            event: Event::Fault(Fault::Pose(pose)),
        },
        Report::Event {
            period,
            event: Event::Fault(Fault::StepsLost {
                joint: 255,
                by: i32::MIN,
            }),
        },
        Report::Event {
            period,
            event: Event::Fault(Fault::Racking {
                joint: 255,
                by: i32::MIN,
            }),
        },
        Report::Event {
            period,
            event: Event::ReferenceShift {
                joint: 255,
                by: i32::MIN,
            },
        },
        Report::Event {
            period,
            event: Event::Fault(Fault::Force(problem)),
        },
        Report::Event {
            period,
            event: Event::TareRefused(TareRefusal::Moving {
                component: 255,
                spread: u16::MAX,
            }),
        },
        Report::Event {
            period,
            event: Event::Fault(Fault::Master(MasterProblem::Encoder {
                leg: u8::MAX,
                by: i32::MIN,
            })),
        },
        Report::Answer {
            id: 255,
            result: Err(Refusal::ForceSensor(problem)),
        },
        Report::Answer {
            id: 255,
            result: Err(Refusal::Force {
                axis: 255,
                refusal: ForceRefusal {
                    parameter: ForceParameter::Busy,
                    bound: i32::MIN,
                },
            }),
        },
        Report::Event {
            period,
            event: Event::JobDone {
                job: u32::MAX,
                setpoints: u32::MAX,
            },
        },
        Report::Event {
            period,
            event: Event::Underrun {
                setpoint: u32::MAX,
                late_periods: u32::MAX,
            },
        },
    ];
    let sizes = short.map(|report| size(&report));
    println!("answers and events: {sizes:?} bytes");
    assert!(sizes.into_iter().all(|bytes| bytes <= SHORT_REPORT));
}
