//! Commands: any of them, with valid, boundary and absurd arguments.

use super::script::Dice;
use haptimill_protocol::force::{ForceLoop, Gate};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, MasterPose, VirtualFixture};
use haptimill_protocol::message::{
    Action, AxisValues, Command, ConfigChunk, SetpointBatch, SetpointDelta, Source,
};

/// A word: edges, small numbers, any.
pub fn word(dice: &mut Dice) -> i32 {
    match dice.below(6) {
        0 => dice.pick(&[0, 1, -1, i32::MAX, i32::MIN, i32::MAX - 1, i32::MIN + 1]),
        1 | 2 => dice.between(-300_000.0, 300_000.0) as i32,
        3 => 1_i32.wrapping_shl(dice.below(32) as u32).wrapping_neg(),
        _ => dice.bits() as i32,
    }
}

fn byte(dice: &mut Dice) -> u8 {
    dice.pick(&[0, 1, 2, 3, 4, 5, 6, 99, 100, 101, 200, 255])
}

fn half(dice: &mut Dice) -> u16 {
    match dice.below(3) {
        0 => dice.pick(&[0, 1, 2, 999, 1000, 1001, 0x7FFF, 0x8000, 0xFFFF]),
        1 => dice.below(6) as u16,
        _ => dice.bits() as u16,
    }
}

fn values(dice: &mut Dice) -> AxisValues {
    let count = dice.pick(&[5, 5, 5, 5, 5, 0, 4, 6]);
    let zeros = dice.happens(0.3);
    (0..count)
        .map(|_| {
            if zeros || dice.happens(0.4) {
                0
            } else {
                word(dice)
            }
        })
        .collect()
}

fn gate(dice: &mut Dice) -> Gate {
    dice.pick(&[
        Gate::AgainstMotion,
        Gate::Any,
        Gate::Positive,
        Gate::Negative,
    ])
}

/// Settings of a force loop near those of the machine file.
pub fn sound_loop(dice: &mut Dice) -> ForceLoop {
    ForceLoop {
        desired: (dice.between(1.0, 20.0) * 65_536.0) as i32,
        mass: (dice.spread(0.25, 40.0) * 65_536.0) as u32,
        damping: (dice.spread(1.0, 40.0) * 65_536.0) as u32,
        limit: (dice.between(1.0, 20.0) * 1_048_576.0) as i32,
        rate: (dice.between(1.0, 20.0) * 1_048_576.0) as i32,
        gate: gate(dice),
    }
}

/// Settings with which the tool yields to any force.
pub fn yielding_loop(dice: &mut Dice) -> ForceLoop {
    ForceLoop {
        desired: (dice.between(3.0, 8.0) * 65_536.0) as i32,
        mass: 65_536,
        damping: (dice.between(4.0, 8.0) * 65_536.0) as u32,
        limit: 10 << 20,
        rate: 20 << 20,
        gate: Gate::Any,
    }
}

/// Settings of the reflection.
pub fn reflect(dice: &mut Dice) -> Command {
    let axis = |dice: &mut Dice| ForceFeedbackAxis {
        percent: dice.pick(&[0, 20, 100, 100, 101]),
        limit: (dice.between(-1.0, 12.0) * 65_536.0) as i32,
    };
    Command::ForceFeedback(ForceFeedback {
        axes: [axis(dice), axis(dice), axis(dice)],
        damping: dice.bits() as u16,
        damping_below: (dice.between(0.0, 4.0) * 65_536.0) as i32,
    })
}

/// A virtual wall.
pub fn wall(dice: &mut Dice) -> Command {
    let wall = dice.happens(0.7).then(|| VirtualFixture {
        at: dice
            .happens(0.6)
            .then(|| (dice.between(-40.0, 40.0) * 1_048_576.0) as i32),
        rate: if dice.happens(0.6) { 0 } else { word(dice) },
    });
    Command::VirtualFixture {
        axis: dice.below(4) as u8,
        upper: dice.happens(0.5),
        fixture: wall,
    }
}

/// A force that a tool afar feels.
pub fn feel(dice: &mut Dice) -> Command {
    Command::RemoteForce {
        force: core::array::from_fn(|_| {
            if dice.happens(0.1) {
                dice.bits() as i16
            } else {
                dice.between(-500.0, 500.0) as i16
            }
        }),
    }
}

/// A hand afar.
pub fn any_hand(dice: &mut Dice) -> MasterPose {
    MasterPose {
        tip: core::array::from_fn(|_| word(dice)),
        rate: core::array::from_fn(|_| word(dice)),
        axes: if dice.happens(0.6) {
            [[32_767, 0, 0], [0, 0, 32_767]]
        } else {
            [
                core::array::from_fn(|_| dice.bits() as i16),
                core::array::from_fn(|_| dice.bits() as i16),
            ]
        },
        engaged: dice.happens(0.7),
    }
}

/// Any command.
pub fn any(dice: &mut Dice) -> Command {
    let deltas = |dice: &mut Dice| {
        (0..dice.below(5))
            .map(|_| SetpointDelta {
                periods: half(dice),
                moved: dice.bits() as u8 & 0x3F,
                residuals: (0..dice.below(13)).map(|_| word(dice)).collect(),
                action: dice.pick(&[Action::None, Action::Pause, Action::Spindle(30_000)]),
            })
            .collect()
    };
    match dice.below(34) {
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
            length: half(dice),
            crc: dice.bits() as u32,
            at_preset: dice.happens(0.5),
        },
        12 => Command::Configure(ConfigChunk {
            offset: half(dice),
            bytes: (0..dice.below(65)).map(|_| dice.bits() as u8).collect(),
        }),
        13 => Command::JobStart {
            job: dice.bits() as u32,
            pose: values(dice),
        },
        14 => Command::JobEnd {
            count: dice.below(70) as u32,
        },
        15 => Command::Setpoints(SetpointBatch {
            first: if dice.happens(0.5) {
                dice.below(70) as u32
            } else {
                dice.bits() as u32
            },
            items: deltas(dice),
        }),
        16..=19 => Command::Jog {
            epoch: half(dice),
            deadline_ms: half(dice),
            rates: values(dice),
        },
        20 => Command::JogCancel { epoch: half(dice) },
        21 | 22 => Command::Source {
            axis: dice.below(8) as u8,
            source: dice.pick(&[Source::Program, Source::Jog, Source::Hold, Source::Master]),
        },
        23 => Command::Override {
            percent: byte(dice),
        },
        24 => Command::Telemetry { every: half(dice) },
        25 => Command::ForceMask { mask: byte(dice) },
        26 | 27 => {
            let settings = if dice.happens(0.5) {
                sound_loop(dice)
            } else {
                ForceLoop {
                    desired: word(dice),
                    mass: word(dice) as u32,
                    damping: word(dice) as u32,
                    limit: word(dice),
                    rate: word(dice),
                    gate: gate(dice),
                }
            };
            Command::ForceLoop {
                axis: dice.below(5) as u8,
                settings,
            }
        }
        28 => Command::ForceSettings {
            axis: dice.below(5) as u8,
        },
        29 => Command::Tare,
        30 => reflect(dice),
        31 => wall(dice),
        32 => Command::PositionScale { scale: half(dice) },
        _ => Command::MasterPose {
            epoch: half(dice),
            age_ms: byte(dice),
            pose: any_hand(dice),
        },
    }
}

/// A command that an idle machine refuses.
pub fn refused(dice: &mut Dice) -> Command {
    match dice.below(9) {
        0 => Command::Override {
            percent: dice.pick(&[0, 101, 255]),
        },
        1 => Command::Resume,
        2 => Command::JobEnd {
            count: dice.below(9) as u32,
        },
        3 => Command::Jog {
            epoch: 0x4000_u16.wrapping_add(dice.bits() as u16 & 0xFFF),
            deadline_ms: dice.pick(&[0, 1001, 0xFFFF]),
            rates: (0..5).map(|_| 4096).collect(),
        },
        4 => Command::Jog {
            epoch: 0x4000_u16.wrapping_add(dice.bits() as u16 & 0xFFF),
            deadline_ms: 100,
            rates: (0..4).map(|_| 4096).collect(),
        },
        5 => Command::ForceMask {
            mask: dice.pick(&[8, 16, 255]),
        },
        6 => Command::Source {
            axis: dice.pick(&[5, 6, 255]),
            source: Source::Hold,
        },
        7 => Command::JobStart {
            job: 7,
            pose: (0..5).map(|_| word(dice)).collect(),
        },
        _ => Command::ForceLoop {
            axis: dice.below(3) as u8,
            settings: ForceLoop {
                desired: 0,
                mass: 0,
                damping: 0,
                limit: -1,
                rate: 0,
                gate: Gate::Any,
            },
        },
    }
}
