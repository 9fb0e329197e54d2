//! Mutated configurations.

use super::super::episode::Stimulus;
use super::super::rng::Rng;
use super::Steps;
use super::operation::valid_operation;
use haptimill_protocol::message::Command;

/// Returns the stimuli of one step of this theme.
pub(super) fn stimuli(rng: &mut Rng) -> Steps {
    let mutations = if rng.chance(0.15) {
        0
    } else {
        1 + rng.below(4) as u8
    };
    let mut steps = vec![
        (Stimulus::Send(Command::Stop), 2500),
        (Stimulus::Send(Command::Disable), 1500),
        (
            Stimulus::Configure {
                seed: rng.bits(),
                mutations,
                preset: rng.chance(0.3),
            },
            50,
        ),
    ];
    if rng.chance(0.7) {
        steps.push((Stimulus::Recover, 200));
    }
    for _ in 0..rng.below(3) {
        steps.extend(valid_operation(rng));
    }
    steps
}
