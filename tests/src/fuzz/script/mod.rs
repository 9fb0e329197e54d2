//! Scripts: the stimuli of an episode, by theme.

mod any_command;
mod configuration;
mod faults;
mod fitting;
mod force;
mod line;
mod operation;
mod teleoperation;

use super::episode::{H4_JOINTS, JOINTS, Step, Stimulus, Theme};
use super::machines::{MachineKind, machine};
use super::rng::Rng;
use haptimill_protocol::message::Command;

/// Stimuli, each with the control periods until the next one.
type Steps = Vec<(Stimulus, u32)>;

/// Returns a random number of control periods.
fn periods(rng: &mut Rng) -> u32 {
    match rng.below(6) {
        0 | 1 => rng.uniform(1.0, 50.0) as u32,
        2 | 3 => rng.uniform(50.0, 800.0) as u32,
        _ => rng.uniform(800.0, 3000.0) as u32,
    }
}

/// Returns the name of a random joint of a machine.
fn joint_name(kind: MachineKind, rng: &mut Rng) -> String {
    let count = match kind {
        MachineKind::File(_) => machine(kind).config.joints.len(),
        _ => H4_JOINTS,
    };
    rng.choose(&JOINTS[..count]).to_string()
}

/// Returns the script of an episode.
pub(super) fn script(theme: Theme, kind: MachineKind, rng: &mut Rng) -> Vec<Step> {
    let mut script = Vec::new();
    let mut add = |stimulus, periods| script.push(Step { stimulus, periods });
    if theme == Theme::Files {
        for _ in 0..40 {
            add(Stimulus::CorruptFile(rng.bits()), 0);
        }
        return script;
    }
    let count = 3 + rng.index(9);
    let early = matches!(theme, Theme::AnyCommand | Theme::Line | Theme::Config);
    if !(early && rng.chance(0.4)) {
        add(Stimulus::Recover, 200);
        if rng.chance(0.6) {
            let every = rng.choose(&[1, 20, 50, 200]);
            add(Stimulus::Send(Command::Telemetry { every }), 5);
        }
    }
    if theme == Theme::Force {
        add(Stimulus::Send(Command::Tare), 1500);
    }
    let mut injected = 0;
    for index in 0..count {
        if matches!(theme, Theme::Fault) && injected == 0 && (rng.chance(0.4) || index == count - 3)
        {
            injected = 1;
            if rng.chance(0.3) {
                for (stimulus, periods) in faults::fault_sequence(kind, rng) {
                    add(stimulus, periods);
                }
                continue;
            }
            let (stimulus, after) = faults::single_fault(kind, rng);
            add(stimulus, after);
            continue;
        }
        if theme == Theme::Fault && injected == 1 && rng.chance(0.25) {
            injected = 2;
            add(Stimulus::ClearFaults, periods(rng));
            add(Stimulus::Recover, 500);
            continue;
        }
        if theme == Theme::Faults && rng.chance(0.35) {
            let (stimulus, after) = faults::single_fault(kind, rng);
            add(stimulus, after.min(400));
            continue;
        }
        if theme == Theme::Faults && rng.chance(0.12) {
            for (stimulus, periods) in faults::fault_sequence(kind, rng) {
                add(stimulus, periods);
            }
            continue;
        }
        if theme == Theme::Faults && rng.chance(0.15) {
            add(Stimulus::ClearFaults, periods(rng));
            add(Stimulus::Recover, 500);
            continue;
        }
        let step = match theme {
            Theme::AnyCommand => any_command::stimuli(kind, rng),
            Theme::Line => line::stimuli(rng),
            Theme::Config => configuration::stimuli(rng),
            Theme::Teleoperation => teleoperation::stimuli(kind, rng),
            Theme::Force => force::stimuli(rng),
            _ => operation::valid_operation(rng),
        };
        for (stimulus, periods) in step {
            add(stimulus, periods);
        }
        if let Some(name) = kind.file()
            && rng.chance(0.25)
        {
            for (stimulus, periods) in fitting::own_stimuli(name, theme, rng) {
                add(stimulus, periods);
            }
        }
    }
    if theme.is_healthy() || theme == Theme::Fault {
        add(Stimulus::WaitIdle, 20_000);
        add(Stimulus::Wait, 1500);
    }
    if kind.file().is_some() {
        fitting::fit(&mut script, kind, rng);
    }
    script
}
