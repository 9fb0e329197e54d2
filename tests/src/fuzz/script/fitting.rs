//! Stimuli for other machine files than the H-4 ones: scripts that are made for five coordinates
//! and five joints are fitted to the machine, and what only such a machine has is added.

use super::super::command;
use super::super::episode::{H4_JOINTS, JobPlan, Step, Stimulus, Theme, joint_of};
use super::super::machines::{MachineKind, machine};
use super::super::rng::Rng;
use super::{Steps, joint_name, operation, periods};
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::named_io::config::OutputFunction;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::{FaultKind, Level, Switch};
use haptimill_protocol::message::{AxisValues, Command};

/// Returns stimuli that a theme of the H-4 machines does not have: inputs, outputs, probing,
/// compensation, overrides, and in themes with faults defective switches and inputs.
pub(super) fn own_stimuli(name: &'static str, theme: Theme, rng: &mut Rng) -> Steps {
    let file = machine(MachineKind::File(name));
    let inputs = file
        .plant()
        .map_or_else(|_| vec![], |plant: PlantConfig| plant.input);
    let axis = joint_name(MachineKind::File(name), rng);
    let faulty = matches!(theme, Theme::Fault | Theme::Faults | Theme::AnyCommand);
    match rng.below(8) {
        0 if !inputs.is_empty() => {
            let name = inputs[rng.index(inputs.len())].name.clone();
            let kind = if rng.chance(0.5) {
                FaultKind::InputBounce {
                    name,
                    hz: rng.log_uniform(1.0, 20_000.0),
                }
            } else {
                FaultKind::InputLevel {
                    name,
                    level: rng.choose(&[Level::Low, Level::High]),
                }
            };
            vec![
                (Stimulus::InjectFault(kind), periods(rng)),
                (Stimulus::ClearFaults, periods(rng)),
                (Stimulus::Recover, 500),
            ]
        }
        1 => {
            // A job that starts the spindle, with an open tool clamp.
            let mut functions = file.config.io.outputs.iter().map(|output| output.function);
            let clamp = functions.position(|function| function == OutputFunction::ToolClamp);
            let output = clamp.unwrap_or_default() as u8;
            let mut path = operation::path(rng);
            path.actions |= clamp.is_some();
            let set = |on| Stimulus::Send(Command::SetOutput { output, on });
            vec![
                (Stimulus::WaitIdle, 6000),
                (set(clamp.is_none()), periods(rng)),
                (Stimulus::Send(command::named_output(rng)), periods(rng)),
                (
                    Stimulus::Job(JobPlan::Path(path)),
                    rng.uniform(100.0, 3000.0) as u32,
                ),
                (set(true), periods(rng)),
            ]
        }
        2 => vec![(
            Stimulus::Send(Command::Compensation {
                on: rng.chance(0.5),
            }),
            periods(rng),
        )],
        3 => vec![
            (
                Stimulus::Send(Command::RapidOverride {
                    percent: rng.choose(&[0, 5, 25, 50, 100, 101, 255]),
                }),
                periods(rng),
            ),
            (
                Stimulus::Send(Command::SpindleOverride {
                    percent: rng.choose(&[0, 49, 50, 120, 200, 201, 255]),
                }),
                periods(rng),
            ),
        ],
        4 if faulty => {
            let switch = rng.choose(&[Switch::Home, Switch::LimitLow, Switch::LimitHigh]);
            let kind = match rng.below(3) {
                0 => FaultKind::SwitchInverted {
                    joint: axis,
                    switch,
                },
                1 => FaultKind::SwitchMissing {
                    joint: axis,
                    switch,
                },
                _ => FaultKind::SwitchBounces {
                    joint: axis,
                    switch,
                    ms: rng.log_uniform(0.1, 50.0),
                },
            };
            vec![
                (Stimulus::InjectFault(kind), periods(rng)),
                (Stimulus::Send(Command::Home), 4000),
                (Stimulus::ClearFaults, periods(rng)),
                (Stimulus::Recover, 500),
            ]
        }
        5 if faulty => off_a_limit_switch(axis, rng),
        6 | 7 if !inputs.is_empty() => {
            // A probe that is armed, and an input that changes during the motion.
            let configured = file.config.io.inputs.iter().zip(&file.io.inputs);
            let probes: Vec<(usize, &String)> = configured
                .enumerate()
                .filter(|(_, (input, _))| input.function.is_probe())
                .map(|(index, (_, name))| (index, name))
                .collect();
            let (input, name) = match probes.len() {
                0 => (0, inputs[rng.index(inputs.len())].name.clone()),
                count => {
                    let (index, name) = probes[rng.index(count)];
                    (index, name.clone())
                }
            };
            let level = rng.choose(&[Level::Low, Level::High, Level::High]);
            let arm = Command::ArmProbe {
                input: input as u8,
                active: true,
            };
            vec![
                (Stimulus::WaitIdle, 6000),
                (Stimulus::Send(arm), 20),
                (operation::job(rng), rng.uniform(100.0, 3000.0) as u32),
                (
                    Stimulus::InjectFault(FaultKind::InputLevel { name, level }),
                    periods(rng),
                ),
                (Stimulus::Send(command::any(rng)), periods(rng)),
                (Stimulus::ClearFaults, periods(rng)),
                (Stimulus::Recover, 500),
            ]
        }
        _ => vec![
            (Stimulus::WaitIdle, 6000),
            (Stimulus::Send(Command::Home), 6000),
            (Stimulus::WaitIdle, 20_000),
        ],
    }
}

/// Returns a joint that is pushed onto its limit switch with the drives off and moves off it, with
/// an interruption in most cases.
fn off_a_limit_switch(axis: String, rng: &mut Rng) -> Steps {
    let number = joint_of(&axis).unwrap_or_default() as u8;
    let effort = rng.choose(&[-1.0, 1.0]) * rng.log_uniform(10.0, 200.0);
    let mut steps = vec![
        (Stimulus::WaitIdle, 6000),
        (Stimulus::Send(Command::Disable), 100),
        (
            Stimulus::InjectFault(FaultKind::Push {
                joint: axis,
                effort,
            }),
            rng.uniform(3000.0, 20_000.0) as u32,
        ),
        (Stimulus::ClearFaults, periods(rng)),
        (
            Stimulus::Send(Command::MoveOff { joint: number }),
            rng.log_uniform(10.0, 20_000.0) as u32,
        ),
    ];
    match rng.below(6) {
        0 => steps.push((Stimulus::Send(command::any(rng)), periods(rng))),
        1 => steps.push((Stimulus::Send(Command::Stop), periods(rng))),
        2 => steps.extend([
            (Stimulus::HostAway(true), 4000),
            (Stimulus::HostAway(false), 100),
        ]),
        3 => steps.push((
            Stimulus::MissPeriods(1 + rng.below(100) as u16),
            periods(rng),
        )),
        4 => steps.extend([
            (Stimulus::EmergencyStopCircuit(true), periods(rng)),
            (Stimulus::EmergencyStopCircuit(false), periods(rng)),
        ]),
        _ => {}
    }
    steps.push((Stimulus::Recover, 500));
    steps
}

/// Fits a script of five coordinates and five joints to a machine.
pub(super) fn fit(script: &mut [Step], kind: MachineKind, rng: &mut Rng) {
    let config = &machine(kind).config;
    let (axes, joints) = (config.pose.len(), config.joints.len());
    let values = |list: &mut AxisValues| {
        if list.len() != H4_JOINTS {
            return;
        }
        list.truncate(axes);
        for (value, limits) in list.iter_mut().zip(&config.pose) {
            if limits.kind == AxisKind::MultiTurn {
                *value >>= 10;
            }
        }
    };
    for step in script {
        match &mut step.stimulus {
            Stimulus::Send(command) | Stimulus::Probe(command) => match command {
                Command::Jog { rates, .. } => values(rates),
                Command::JobStart { pose, .. } => values(pose),
                _ => {}
            },
            Stimulus::RampLoad(joint, effort) => {
                *joint %= joints;
                // Small machines have drives of a few newtons.
                *effort *= rng.choose(&[0.02, 0.1, 0.3, 1.0]);
            }
            _ => {}
        }
    }
}
