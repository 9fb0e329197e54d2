//! What a careful host does with a healthy machine: jobs, jogs, holds, stops.

use super::super::command;
use super::super::episode::{JobPlan, PathPlan, Stimulus};
use super::super::rng::Rng;
use super::super::units::unit;
use super::{Steps, periods};
use haptimill_protocol::message::{Command, Source};

/// Returns a jog of one coordinate that is sent once, with a timeout of a second.
pub(super) fn single_jog(rng: &mut Rng) -> Stimulus {
    let axis = rng.index(5);
    let unit = unit(axis);
    let speed = rng.choose(&[-1.0, 1.0]) * rng.log_uniform(0.01, 16.0);
    let mut rates = [0; 5];
    rates[axis] = (speed * unit / 256.0) as i32;
    Stimulus::Send(Command::Jog {
        epoch: 1000 + rng.below(20_000) as u16,
        timeout_ms: 1000,
        rates: rates.into_iter().collect(),
    })
}

/// Returns a valid path.
pub(super) fn path(rng: &mut Rng) -> PathPlan {
    let tight = rng.chance(0.15);
    PathPlan {
        seed: rng.bits(),
        count: if tight {
            40 + rng.below(300) as u16
        } else {
            6 + rng.below(60) as u16
        },
        span: if tight {
            rng.log_uniform(10.0, 40.0) as u16
        } else {
            rng.log_uniform(40.0, 900.0) as u16
        },
        speed: rng.log_uniform(0.02, 0.9),
        actions: rng.chance(0.4),
        gap: if rng.chance(0.2) {
            rng.log_uniform(100.0, 4000.0) as u16
        } else {
            0
        },
        absurd: 0.0,
        open: rng.chance(0.08),
    }
}

/// Returns a job of a valid path.
pub(super) fn job(rng: &mut Rng) -> Stimulus {
    Stimulus::Job(JobPlan::Path(path(rng)))
}

/// Returns repeated jogs with random rates.
pub(super) fn jog(rng: &mut Rng) -> Stimulus {
    let mut rates = [0.0; 5];
    for rate in &mut rates {
        if rng.chance(0.4) {
            *rate = rng.choose(&[-1.0, 1.0]) * rng.log_uniform(0.01, 1.2);
        }
    }
    Stimulus::Jog {
        rates,
        timeout_ms: rng.choose(&[60, 150, 300, 1000]),
        every: rng.choose(&[50, 200, 250]),
        epoch: 1,
        cancel: rng.chance(0.6),
    }
}

/// Returns valid commands for a healthy machine.
pub(super) fn valid_operation(rng: &mut Rng) -> Steps {
    let percent = rng.choose(&[1, 10, 37, 50, 80, 100, 130, 200]);
    match rng.below(20) {
        0 => {
            // The override of a long job persists through a hold.
            let long = Stimulus::Job(JobPlan::Path(PathPlan {
                seed: rng.bits(),
                count: 40,
                span: 400,
                speed: rng.log_uniform(0.05, 0.5),
                actions: rng.chance(0.3),
                gap: 0,
                absurd: 0.0,
                open: false,
            }));
            let percent = rng.choose(&[20, 37, 50, 80, 150, 200]);
            vec![
                (Stimulus::WaitIdle, 6000),
                (long, 1000),
                (Stimulus::Send(Command::Override { percent }), 1500),
                (
                    Stimulus::Send(Command::Hold),
                    rng.uniform(100.0, 2500.0) as u32,
                ),
                (Stimulus::Send(Command::Resume), 6000),
                (Stimulus::Send(Command::Override { percent: 100 }), 500),
            ]
        }
        1..=6 => {
            let run = rng.log_uniform(200.0, 8000.0) as u32;
            let mut steps = vec![(Stimulus::WaitIdle, 6000), (job(rng), run)];
            for _ in 0..rng.below(4) {
                let wait = rng.log_uniform(20.0, 4000.0) as u32;
                match rng.below(6) {
                    0 | 1 => {
                        steps.push((Stimulus::Send(Command::Hold), wait));
                        if rng.chance(0.3) {
                            let half = Command::Override {
                                percent: percent.max(20),
                            };
                            steps.push((Stimulus::Send(half), 100));
                        }
                        steps.push((Stimulus::Send(Command::Resume), 3000));
                    }
                    2 | 3 => steps.push((Stimulus::Send(Command::Override { percent }), wait)),
                    4 => steps.push((Stimulus::Send(Command::Stop), wait + 3000)),
                    _ => {
                        steps.push((Stimulus::OutOfBandStop, 2600));
                        steps.push((Stimulus::Send(Command::Resume), wait));
                    }
                }
            }
            steps.push((Stimulus::Send(Command::Override { percent: 100 }), 200));
            steps
        }
        7 => {
            // Move to a bound of the workspace, and fast along it.
            let far = rng.uniform(8000.0, 30_000.0) as u32;
            vec![
                (Stimulus::WaitIdle, 6000),
                (jog(rng), far),
                (jog(rng), far / 3),
                (jog(rng), 3000),
            ]
        }
        8..=11 => {
            let long = rng.log_uniform(300.0, 20_000.0) as u32;
            vec![(Stimulus::WaitIdle, 6000), (jog(rng), long)]
        }
        12 => vec![(Stimulus::WaitIdle, 6000), (Stimulus::StaleJog, 400)],
        13 => vec![
            (Stimulus::WaitIdle, 6000),
            (Stimulus::Send(Command::Disable), periods(rng)),
            (Stimulus::Send(Command::Enable), 400),
        ],
        14 => vec![
            (Stimulus::WaitIdle, 6000),
            (Stimulus::Probe(command::any(rng)), 20),
            (Stimulus::Probe(command::any(rng)), 20),
            (Stimulus::Probe(command::refused(rng)), 20),
            (Stimulus::Recover, 100),
        ],
        15 => {
            let held = rng.log_uniform(1.0, 2000.0) as u32;
            vec![
                (Stimulus::EmergencyStopCircuit(true), held),
                (Stimulus::EmergencyStopCircuit(false), periods(rng)),
                (Stimulus::Recover, 200),
            ]
        }
        16 => vec![
            (Stimulus::Send(Command::EmergencyStop), periods(rng)),
            (Stimulus::Recover, 200),
        ],
        17 => vec![(Stimulus::NewSession, 400), (Stimulus::Recover, 100)],
        18 => vec![
            (Stimulus::WaitIdle, 6000),
            (Stimulus::Send(Command::Home), 4000),
        ],
        _ => {
            let coordinate = rng.below(5) as u8;
            let source = rng.choose(&[Source::Hold, Source::Jog]);
            vec![
                (Stimulus::WaitIdle, 6000),
                (Stimulus::Send(Command::Source { coordinate, source }), 20),
                (job(rng), 4000),
                (jog(rng), 3000),
                (Stimulus::WaitIdle, 20_000),
                (
                    Stimulus::Send(Command::Source {
                        coordinate,
                        source: Source::Program,
                    }),
                    20,
                ),
            ]
        }
    }
}
