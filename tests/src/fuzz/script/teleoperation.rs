//! Teleoperation: a master that moves the tool, and a master alone.

use super::super::command;
use super::super::episode::{JobPlan, Stimulus};
use super::super::machines::MachineKind;
use super::super::rng::Rng;
use super::Steps;
use super::operation::valid_operation;
use haptimill_protocol::message::{Command, Source};

/// Returns the stimuli of one step of this theme.
pub(super) fn stimuli(kind: MachineKind, rng: &mut Rng) -> Steps {
    let to = core::array::from_fn(|_| rng.uniform(-15.0, 15.0));
    let move_master = Stimulus::MoveMaster(to, rng.chance(0.8));
    if kind == MachineKind::MasterAlone {
        return match rng.below(6) {
            0 => vec![
                (Stimulus::Send(Command::Disable), 200),
                (Stimulus::Recover, 100),
            ],
            1 => vec![(Stimulus::Send(command::force_feedback(rng)), 200)],
            2 => vec![(Stimulus::Send(command::virtual_fixture(rng)), 1000)],
            3 => vec![(Stimulus::Send(command::remote_force(rng)), 400)],
            4 => vec![(
                Stimulus::Send(Command::MasterTelemetry {
                    every: rng.choose(&[1, 10, 50]),
                }),
                200,
            )],
            _ => vec![(move_master, 3000)],
        };
    }
    match rng.below(6) {
        0 | 1 => {
            let master = |coordinate| {
                Stimulus::Send(Command::Source {
                    coordinate,
                    source: Source::Master,
                })
            };
            let back = |coordinate| {
                Stimulus::Send(Command::Source {
                    coordinate,
                    source: Source::Program,
                })
            };
            let mut steps = vec![(Stimulus::WaitIdle, 20_000)];
            for axis in 0..3 {
                if rng.chance(0.6) {
                    steps.push((master(axis), 20));
                }
            }
            steps.push((Stimulus::Job(JobPlan::Dwell { periods: 60_000 }), 60));
            if kind == MachineKind::HapticArm {
                steps.push((move_master, 6000));
                steps.push((Stimulus::MoveMaster([0.0; 3], true), 6000));
            } else {
                steps.push((
                    Stimulus::RemoteMaster(rng.bits(), rng.below(20) as u8),
                    8000,
                ));
            }
            steps.push((Stimulus::Send(Command::Stop), 4000));
            for axis in 0..3 {
                steps.push((back(axis), 20));
            }
            steps
        }
        2 => vec![(Stimulus::Send(command::force_feedback(rng)), 200)],
        3 => vec![(
            Stimulus::Send(Command::PositionScale {
                scale: rng.uniform(410.0, 8192.0) as u16,
            }),
            200,
        )],
        _ => valid_operation(rng),
    }
}
