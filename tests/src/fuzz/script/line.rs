//! A bad serial line, and hosts that vanish and return.

use super::super::episode::Stimulus;
use super::super::rng::Rng;
use super::operation::valid_operation;
use super::{Steps, periods};

/// Returns the stimuli of one step of this theme.
pub(super) fn stimuli(rng: &mut Rng) -> Steps {
    match rng.below(8) {
        0..=2 => {
            let way = |rng: &mut Rng| {
                [
                    if rng.chance(0.5) {
                        rng.log_uniform(1e-6, 1e-2)
                    } else {
                        0.0
                    },
                    if rng.chance(0.4) {
                        rng.log_uniform(1e-5, 0.1)
                    } else {
                        0.0
                    },
                    if rng.chance(0.4) {
                        rng.log_uniform(1e-5, 0.1)
                    } else {
                        0.0
                    },
                ]
            };
            vec![(Stimulus::LineNoise([way(rng), way(rng)]), periods(rng))]
        }
        3 => vec![(Stimulus::LineNoise([[0.0; 3]; 2]), periods(rng))],
        4 => {
            let length = rng.index(300);
            let bytes = (0..length).map(|_| rng.bits() as u8).collect();
            vec![(Stimulus::Garbage(bytes), periods(rng))]
        }
        5 => vec![
            (
                Stimulus::HostAway(true),
                rng.log_uniform(20.0, 8000.0) as u32,
            ),
            (Stimulus::HostAway(false), periods(rng)),
        ],
        6 => vec![
            (Stimulus::NewSession, periods(rng)),
            (Stimulus::Recover, 200),
        ],
        _ => {
            let mut steps = vec![
                (Stimulus::LineNoise([[0.0; 3]; 2]), 2000),
                (Stimulus::Recover, 100),
            ];
            steps.extend(valid_operation(rng));
            steps
        }
    }
}
