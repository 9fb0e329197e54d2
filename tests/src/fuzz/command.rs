//! Random commands with valid, boundary and absurd arguments.

use super::rng::Rng;
use haptimill_protocol::force::{EnableCondition, ForceLoop};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, MasterPose, VirtualFixture};
use haptimill_protocol::message::{
    Action, AxisValues, Command, ConfigChunk, OverrideMode, SetpointBatch, SetpointDelta, Source,
};

/// Returns an edge value, a small or any 32-bit value.
pub fn word(rng: &mut Rng) -> i32 {
    match rng.below(6) {
        0 => rng.choose(&[0, 1, -1, i32::MAX, i32::MIN, i32::MAX - 1, i32::MIN + 1]),
        1 | 2 => rng.uniform(-300_000.0, 300_000.0) as i32,
        3 => 1_i32.wrapping_shl(rng.below(32) as u32).wrapping_neg(),
        _ => rng.bits() as i32,
    }
}

fn byte(rng: &mut Rng) -> u8 {
    rng.choose(&[0, 1, 2, 3, 4, 5, 6, 99, 100, 101, 200, 255])
}

fn half(rng: &mut Rng) -> u16 {
    match rng.below(3) {
        0 => rng.choose(&[0, 1, 2, 999, 1000, 1001, 0x7FFF, 0x8000, 0xFFFF]),
        1 => rng.below(6) as u16,
        _ => rng.bits() as u16,
    }
}

fn values(rng: &mut Rng) -> AxisValues {
    let count = rng.choose(&[5, 5, 5, 5, 5, 0, 4, 6]);
    let zeros = rng.chance(0.3);
    (0..count)
        .map(|_| {
            if zeros || rng.chance(0.4) {
                0
            } else {
                word(rng)
            }
        })
        .collect()
}

fn enable_condition(rng: &mut Rng) -> EnableCondition {
    rng.choose(&[
        EnableCondition::AgainstMotion,
        EnableCondition::Any,
        EnableCondition::Positive,
        EnableCondition::Negative,
    ])
}

/// Returns valid settings of force control.
pub fn valid_loop(rng: &mut Rng) -> ForceLoop {
    ForceLoop {
        setpoint: (rng.uniform(1.0, 20.0) * 65_536.0) as i32,
        mass: (rng.log_uniform(0.25, 40.0) * 65_536.0) as u32,
        damping: (rng.log_uniform(1.0, 40.0) * 65_536.0) as u32,
        limit: (rng.uniform(1.0, 20.0) * 1_048_576.0) as i32,
        rate: (rng.uniform(1.0, 20.0) * 1_048_576.0) as i32,
        enable_condition: enable_condition(rng),
    }
}

/// Returns settings with which the tool complies with any force.
pub fn compliant_loop(rng: &mut Rng) -> ForceLoop {
    ForceLoop {
        setpoint: (rng.uniform(3.0, 8.0) * 65_536.0) as i32,
        mass: 65_536,
        damping: (rng.uniform(4.0, 8.0) * 65_536.0) as u32,
        limit: 10 << 20,
        rate: 20 << 20,
        enable_condition: EnableCondition::Any,
    }
}

/// Returns settings of the force feedback.
pub fn force_feedback(rng: &mut Rng) -> Command {
    let axis = |rng: &mut Rng| ForceFeedbackAxis {
        percent: rng.choose(&[0, 20, 100, 100, 101]),
        limit: (rng.uniform(-1.0, 12.0) * 65_536.0) as i32,
    };
    Command::ForceFeedback(ForceFeedback {
        axes: [axis(rng), axis(rng), axis(rng)],
        damping: rng.bits() as u16,
        damping_below: (rng.uniform(0.0, 4.0) * 65_536.0) as i32,
    })
}

/// Returns a virtual fixture.
pub fn virtual_fixture(rng: &mut Rng) -> Command {
    let wall = rng.chance(0.7).then(|| VirtualFixture {
        at: rng
            .chance(0.6)
            .then(|| (rng.uniform(-40.0, 40.0) * 1_048_576.0) as i32),
        rate: if rng.chance(0.6) { 0 } else { word(rng) },
    });
    Command::VirtualFixture {
        axis: rng.below(4) as u8,
        upper: rng.chance(0.5),
        fixture: wall,
    }
}

/// Returns the force on a remote tool.
pub fn remote_force(rng: &mut Rng) -> Command {
    Command::RemoteForce {
        force: core::array::from_fn(|_| {
            if rng.chance(0.1) {
                rng.bits() as i16
            } else {
                rng.uniform(-500.0, 500.0) as i16
            }
        }),
    }
}

/// Returns any pose of a remote master.
pub fn any_master(rng: &mut Rng) -> MasterPose {
    MasterPose {
        tip: core::array::from_fn(|_| word(rng)),
        rate: core::array::from_fn(|_| word(rng)),
        axes: if rng.chance(0.6) {
            [[32_767, 0, 0], [0, 0, 32_767]]
        } else {
            [
                core::array::from_fn(|_| rng.bits() as i16),
                core::array::from_fn(|_| rng.bits() as i16),
            ]
        },
        enabling_switch: rng.chance(0.7),
    }
}

/// Returns an action of a setpoint.
fn action(rng: &mut Rng) -> Action {
    match rng.below(8) {
        0 => Action::Pause,
        1 => Action::Spindle(30_000),
        2 => Action::OverrideMode(override_mode(rng)),
        3 => Action::Output {
            output: rng.choose(&[0, 1, 2, 255]),
            on: rng.chance(0.5),
        },
        4 => Action::AnalogOutput {
            output: rng.choose(&[0, 1, 255]),
            code: half(rng) as i16,
        },
        _ => Action::None,
    }
}

/// Returns any override mode, most of them valid.
pub fn override_mode(rng: &mut Rng) -> OverrideMode {
    match rng.below(6) {
        0 => OverrideMode(rng.bits() as u8),
        1 => rng.choose(&[
            OverrideMode::RAPID,
            OverrideMode::FEED_AND_RAPID,
            OverrideMode::FIXED,
        ]),
        2 => OverrideMode::FEED,
        _ => OverrideMode::feed_up_to(rng.uniform(101.0, 200.0) as u8),
    }
}

/// Returns any command.
pub fn any(rng: &mut Rng) -> Command {
    let deltas = |rng: &mut Rng| {
        (0..rng.below(5))
            .map(|_| SetpointDelta {
                periods: half(rng),
                moved: rng.bits() as u8 & 0x3F,
                residuals: (0..rng.below(13)).map(|_| word(rng)).collect(),
                action: action(rng),
            })
            .collect()
    };
    match rng.below(44) {
        0 => Command::Ping,
        1 => Command::Enable,
        2 => Command::Disable,
        3 => Command::Home,
        4 => Command::Reset,
        5 => Command::Hold,
        6 | 7 => Command::Resume,
        8 => Command::Stop,
        9 => Command::EmergencyStop,
        10 => Command::Status,
        11 => Command::Activate {
            length: half(rng),
            crc: rng.bits() as u32,
            at_preset: rng.chance(0.5),
        },
        12 => Command::Configure(ConfigChunk {
            offset: half(rng),
            bytes: (0..rng.below(65)).map(|_| rng.bits() as u8).collect(),
        }),
        13 => Command::JobStart {
            job: rng.bits() as u32,
            pose: values(rng),
        },
        14 => Command::JobEnd {
            count: rng.below(70) as u32,
        },
        15 => Command::Setpoints(SetpointBatch {
            first: if rng.chance(0.5) {
                rng.below(70) as u32
            } else {
                rng.bits() as u32
            },
            items: deltas(rng),
        }),
        16..=19 => Command::Jog {
            epoch: half(rng),
            timeout_ms: half(rng),
            rates: values(rng),
        },
        20 => Command::JogCancel { epoch: half(rng) },
        21 | 22 => Command::Source {
            coordinate: rng.below(8) as u8,
            source: rng.choose(&[Source::Program, Source::Jog, Source::Hold, Source::Master]),
        },
        23 => Command::Override { percent: byte(rng) },
        24 => Command::Telemetry { every: half(rng) },
        25 => Command::ForceMask { mask: byte(rng) },
        26 | 27 => {
            let settings = if rng.chance(0.5) {
                valid_loop(rng)
            } else {
                ForceLoop {
                    setpoint: word(rng),
                    mass: word(rng) as u32,
                    damping: word(rng) as u32,
                    limit: word(rng),
                    rate: word(rng),
                    enable_condition: enable_condition(rng),
                }
            };
            Command::ForceLoop {
                axis: rng.below(5) as u8,
                settings,
            }
        }
        28 => Command::ForceSettings {
            axis: rng.below(5) as u8,
        },
        29 => Command::Tare,
        30 => force_feedback(rng),
        31 => virtual_fixture(rng),
        32 => Command::PositionScale { scale: half(rng) },
        33 => Command::SetOutput {
            output: rng.choose(&[0, 0, 1, 1, 2, 255]),
            on: rng.chance(0.6),
        },
        34 => Command::SetAnalogOutput {
            output: rng.choose(&[0, 0, 0, 1, 255]),
            code: half(rng) as i16,
        },
        35 => Command::ArmProbe {
            input: rng.choose(&[0, 0, 0, 1, 255]),
            active: rng.chance(0.8),
        },
        36 => Command::Compensation {
            on: rng.chance(0.5),
        },
        37 => Command::MasterTelemetry { every: half(rng) },
        38 => Command::MoveOff {
            joint: rng.below(7) as u8,
        },
        39 => Command::RapidOverride { percent: byte(rng) },
        40 => Command::SpindleOverride { percent: byte(rng) },
        41 => remote_force(rng),
        42 => Command::Store {
            length: half(rng),
            crc: rng.bits() as u32,
        },
        _ => Command::MasterPose {
            epoch: half(rng),
            age_ms: byte(rng),
            pose: any_master(rng),
        },
    }
}

/// Returns a command that an idle machine refuses.
pub fn refused(rng: &mut Rng) -> Command {
    match rng.below(9) {
        0 => Command::Override {
            percent: rng.choose(&[201, 230, 255]),
        },
        1 => Command::Resume,
        2 => Command::JobEnd {
            count: rng.below(9) as u32,
        },
        3 => Command::Jog {
            epoch: 0x4000_u16.wrapping_add(rng.bits() as u16 & 0xFFF),
            timeout_ms: rng.choose(&[0, 1001, 0xFFFF]),
            rates: (0..5).map(|_| 4096).collect(),
        },
        4 => Command::Jog {
            epoch: 0x4000_u16.wrapping_add(rng.bits() as u16 & 0xFFF),
            timeout_ms: 100,
            rates: (0..4).map(|_| 4096).collect(),
        },
        5 => Command::ForceMask {
            mask: rng.choose(&[8, 16, 255]),
        },
        6 => Command::Source {
            coordinate: rng.choose(&[5, 6, 255]),
            source: Source::Hold,
        },
        7 => Command::JobStart {
            job: 7,
            pose: (0..5).map(|_| word(rng)).collect(),
        },
        _ => Command::ForceLoop {
            axis: rng.below(3) as u8,
            settings: ForceLoop {
                setpoint: 0,
                mass: 0,
                damping: 0,
                limit: -1,
                rate: 0,
                enable_condition: EnableCondition::Any,
            },
        },
    }
}

/// Returns a command for a named output, an analog output or the probe.
pub fn named_output(rng: &mut Rng) -> Command {
    match rng.below(3) {
        0 => Command::SetOutput {
            output: rng.below(6) as u8,
            on: rng.chance(0.6),
        },
        1 => Command::SetAnalogOutput {
            output: 0,
            code: half(rng) as i16,
        },
        _ => Command::ArmProbe {
            input: rng.below(3) as u8,
            active: rng.chance(0.8),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// The number of a variant is the first byte of its encoding.
    #[test]
    fn any_command_has_all_variants() {
        let mut buffer = [0; 2048];
        let mut found = BTreeSet::new();
        for seed in 0..4000 {
            let command = any(&mut Rng::new(seed, 0));
            found.insert(postcard::to_slice(&command, &mut buffer).expect("fits")[0]);
        }
        let is_variant = |number: &u8| {
            let mut bytes = [0; 256];
            bytes[0] = *number;
            postcard::from_bytes::<Command>(&bytes).is_ok()
        };
        let all: BTreeSet<u8> = (0..128).filter(is_variant).collect();
        assert!(all.len() > 30, "{all:?}");
        assert_eq!(found, all);
    }
}
