//! Any command in any state.

use super::super::command;
use super::super::episode::{JobPlan, Stimulus, joint_of};
use super::super::machines::MachineKind;
use super::super::rng::Rng;
use super::operation::{jog, path};
use super::{Steps, joint_name, periods};
use haptimill_hil_sim::fault::{FaultKind, Switch};
use haptimill_protocol::message::Command;

/// Returns the stimuli of one step of this theme.
pub(super) fn stimuli(kind: MachineKind, rng: &mut Rng) -> Steps {
    let axis = joint_name(kind, rng);
    match rng.below(32) {
        0..=13 => vec![(Stimulus::Send(command::any(rng)), periods(rng))],
        14..=16 => vec![(Stimulus::Probe(command::any(rng)), 10)],
        17 | 18 => {
            let mut plan = path(rng);
            plan.absurd = if rng.chance(0.5) { 0.05 } else { 0.0 };
            vec![(Stimulus::Job(JobPlan::Path(plan)), periods(rng))]
        }
        19 => vec![(jog(rng), periods(rng))],
        20 => vec![(Stimulus::OutOfBandStop, periods(rng))],
        21 => {
            let length = rng.index(300);
            let bytes = (0..length).map(|_| rng.bits() as u8).collect();
            vec![(Stimulus::Garbage(bytes), periods(rng))]
        }
        22 => vec![(
            Stimulus::EmergencyStopCircuit(rng.chance(0.6)),
            periods(rng),
        )],
        23 => vec![(Stimulus::NewSession, periods(rng))],
        24 => vec![
            (
                Stimulus::HostAway(true),
                rng.log_uniform(20.0, 8000.0) as u32,
            ),
            (Stimulus::HostAway(false), 100),
        ],
        25 => vec![
            (
                Stimulus::InjectFault(FaultKind::DriveTripped { joint: axis }),
                periods(rng),
            ),
            (Stimulus::ClearFaults, 10),
        ],
        26 => {
            let number = joint_of(&axis).unwrap_or_default() as u8;
            let switch = rng.choose(&[Switch::LimitLow, Switch::LimitHigh]);
            let stuck = FaultKind::SwitchStuck {
                joint: axis,
                switch,
                active: true,
            };
            let mut steps = vec![(Stimulus::InjectFault(stuck), periods(rng))];
            if rng.chance(0.6) {
                let reset = Stimulus::Send(Command::Reset);
                let move_off = Stimulus::Send(Command::MoveOff { joint: number });
                steps.extend([(reset, 50), (move_off, periods(rng))]);
            }
            steps.push((Stimulus::ClearFaults, periods(rng)));
            steps
        }
        27 => vec![(Stimulus::StaleJog, 100)],
        28 => vec![(Stimulus::MissPeriods(1 + rng.below(6) as u16), periods(rng))],
        29 if matches!(kind, MachineKind::HapticArm | MachineKind::MasterAlone) => {
            let to = core::array::from_fn(|_| rng.uniform(-30.0, 30.0));
            vec![(Stimulus::MoveMaster(to, rng.chance(0.5)), periods(rng))]
        }
        29 => vec![(
            Stimulus::RemoteMaster(rng.bits(), rng.below(60) as u8),
            periods(rng),
        )],
        _ => vec![
            (Stimulus::EmergencyStopCircuit(false), 5),
            (Stimulus::Recover, periods(rng)),
        ],
    }
}
