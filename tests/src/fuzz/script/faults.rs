//! Faults of the machine, alone and in sequences that need a certain state.

use super::super::episode::{Stimulus, joint_of};
use super::super::machines::MachineKind;
use super::super::rng::Rng;
use super::operation::{jog, single_jog};
use super::{Steps, joint_name, periods};
use haptimill_hil_sim::fault::{
    Along, Channel, FaultKind, HapticEncoder, HapticFault, HapticSensor, Level, Switch,
};
use haptimill_protocol::message::Command;

/// Returns one fault of the simulator, and the periods until the next stimulus.
pub(super) fn single_fault(kind: MachineKind, rng: &mut Rng) -> (Stimulus, u32) {
    let axis = joint_name(kind, rng);
    let table = axis == "alpha";
    let channel = rng.choose(&[Channel::A, Channel::B]);
    let level = rng.choose(&[Level::Low, Level::High]);
    let along = rng.choose(&[Along::X, Along::Y, Along::Z]);
    let effort = if table { 50.0 } else { 1500.0 };
    let fault = match rng.below(if kind == MachineKind::HapticArm {
        21
    } else {
        19
    }) {
        0 => FaultKind::EncoderStuck {
            joint: axis,
            channel,
            level,
        },
        1 => FaultKind::EncoderSwapped { joint: axis },
        2 | 3 => {
            let size = rng.log_uniform(1.0, 6000.0) as i32;
            let counts = if rng.chance(0.5) { size } else { -size };
            FaultKind::EncoderSlip {
                joint: axis,
                counts,
            }
        }
        4 => FaultKind::EncoderNoise {
            joint: axis,
            per_second: rng.log_uniform(0.5, 50_000.0),
        },
        5 => FaultKind::IndexMissing { joint: axis },
        6 => FaultKind::DriveDead { joint: axis },
        7 => FaultKind::DriveTripped { joint: axis },
        8 => FaultKind::DriveWeak {
            joint: axis,
            gain: rng.choose(&[0.02, 0.1, 0.3, 0.7, 1.5, 3.0]),
        },
        9 => FaultKind::DriveReversed { joint: axis },
        10 => FaultKind::JointJammed {
            joint: axis,
            effort: rng
                .chance(0.6)
                .then(|| rng.log_uniform(effort * 0.02, effort)),
        },
        11 => {
            let size = rng.log_uniform(effort * 0.02, effort);
            let effort = if rng.chance(0.5) { size } else { -size };
            if rng.chance(0.8) {
                let joint = joint_of(&axis).unwrap_or(0);
                let over = rng.uniform(500.0, 8000.0) as u32;
                // The load is near the limit of the drive, where a following error grows.
                let max = if joint == 4 { 36.0 } else { 750.0 };
                let effort = effort.signum() * max * rng.uniform(0.5, 1.3);
                return (Stimulus::RampLoad(joint, effort), over);
            }
            FaultKind::Push {
                joint: axis,
                effort,
            }
        }
        12 => FaultKind::SwitchStuck {
            joint: axis,
            switch: rng.choose(&[Switch::Home, Switch::LimitLow, Switch::LimitHigh]),
            active: rng.chance(0.8),
        },
        13 => rng.choose(&[
            FaultKind::SensorStuck { along },
            FaultKind::SensorDropped { along },
            FaultKind::SensorReversed { along },
            FaultKind::SensorSaturated { along, level },
            FaultKind::SensorDrift { along, rate: 5.0 },
        ]),
        14 => FaultKind::SpindleStalled,
        15 => return (Stimulus::EmergencyStopCircuit(true), periods(rng)),
        16 | 17 => {
            let count = rng.log_uniform(1.0, 400.0) as u16;
            return (Stimulus::MissPeriods(count), 3000);
        }
        18 => return (Stimulus::HostAway(true), 6000),
        _ => {
            let place = HapticEncoder {
                leg: 1 + rng.below(3) as u8,
                sensor: rng.choose(&[HapticSensor::Slide, HapticSensor::Turn, HapticSensor::Hinge]),
            };
            FaultKind::HapticArm(rng.choose(&[
                HapticFault::EncoderStuck {
                    place,
                    channel,
                    level,
                },
                HapticFault::EncoderSwapped(place),
                HapticFault::EncoderSlip { place, counts: 500 },
                HapticFault::EncoderDropped(place),
                HapticFault::EncoderNoise {
                    place,
                    per_second: 20_000.0,
                },
                HapticFault::AmplifiersTripped,
            ]))
        }
    };
    (Stimulus::InjectFault(fault), periods(rng))
}

/// Returns faults that need a certain state: drives off, a jog, other faults of the same joint.
pub(super) fn fault_sequence(kind: MachineKind, rng: &mut Rng) -> Steps {
    let axis = joint_name(kind, rng);
    let joint = joint_of(&axis).unwrap_or(0);
    let part = if joint == 4 { 0.04 } else { 1.0 };
    let slip = |rng: &mut Rng, max| {
        let size = rng.log_uniform(1.0, max) as i32;
        FaultKind::EncoderSlip {
            joint: axis.clone(),
            counts: if rng.chance(0.5) { size } else { -size },
        }
    };
    let push = |rng: &mut Rng| rng.choose(&[-1.0, 1.0]) * rng.log_uniform(30.0, 300.0) * part;
    match rng.below(if kind == MachineKind::Step { 4 } else { 3 }) {
        0 => vec![
            // A counter jumps while the drives are off.
            (Stimulus::WaitIdle, 20_000),
            (Stimulus::Send(Command::Disable), periods(rng)),
            (Stimulus::InjectFault(slip(rng, 60_000.0)), periods(rng)),
            (Stimulus::Send(Command::Enable), 1200),
            (Stimulus::Recover, 200),
        ],
        1 => {
            // An encoder is reversed, or loses a channel, in a jog.
            let mut steps = vec![
                (Stimulus::WaitIdle, 20_000),
                (single_jog(rng), rng.uniform(50.0, 2500.0) as u32),
                (
                    Stimulus::InjectFault(if rng.chance(0.6) {
                        FaultKind::EncoderSwapped { joint: axis }
                    } else {
                        FaultKind::EncoderStuck {
                            joint: axis,
                            channel: rng.choose(&[Channel::A, Channel::B]),
                            level: rng.choose(&[Level::Low, Level::High]),
                        }
                    }),
                    2500,
                ),
            ];
            if rng.chance(0.5) {
                // It is repaired, and the machine is not homed.
                steps.extend([
                    (Stimulus::ClearFaults, 50),
                    (Stimulus::Send(Command::Reset), 50),
                    (Stimulus::Send(Command::Enable), 1200),
                ]);
            }
            steps
        }
        2 => {
            // Slip, noise, a stuck channel and a push follow each other on one joint.
            let channel = rng.choose(&[Channel::A, Channel::B]);
            let mut steps = vec![(Stimulus::WaitIdle, 20_000), (single_jog(rng), 200)];
            for _ in 0..3 {
                let hold = 5 + rng.log_uniform(10.0, 1500.0) as u32;
                let kind = match rng.below(4) {
                    0 => slip(rng, 1000.0),
                    1 => FaultKind::EncoderNoise {
                        joint: axis.clone(),
                        per_second: rng.log_uniform(1.0, 200.0),
                    },
                    2 => FaultKind::EncoderStuck {
                        joint: axis.clone(),
                        channel,
                        level: rng.choose(&[Level::Low, Level::High]),
                    },
                    _ => FaultKind::Push {
                        joint: axis.clone(),
                        effort: push(rng),
                    },
                };
                steps.push((Stimulus::InjectFault(kind), hold));
                if rng.chance(0.4) {
                    steps.push((Stimulus::ClearFaults, 5));
                }
            }
            steps
        }
        _ => vec![
            // Step motors lose their current in motion, and a load moves them.
            (Stimulus::WaitIdle, 20_000),
            (jog(rng), rng.uniform(300.0, 2500.0) as u32),
            (single_jog(rng), rng.uniform(50.0, 900.0) as u32),
            (
                Stimulus::EmergencyStopCircuit(true),
                rng.uniform(1.0, 400.0) as u32,
            ),
            (
                Stimulus::InjectFault(FaultKind::Push {
                    joint: axis,
                    effort: push(rng) * 0.3,
                }),
                rng.uniform(5.0, 300.0) as u32,
            ),
            (Stimulus::ClearFaults, periods(rng)),
            (Stimulus::Recover, 500),
        ],
    }
}
