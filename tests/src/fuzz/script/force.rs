//! Force control: settings, tares, walls and workpieces.

use super::super::command;
use super::super::episode::{JobPlan, Stimulus};
use super::super::rng::Rng;
use super::Steps;
use super::operation::valid_operation;
use haptimill_protocol::message::Command;

/// Returns the stimuli of one step of this theme.
pub(super) fn stimuli(rng: &mut Rng) -> Steps {
    let axis = rng.below(3) as u8;
    match rng.below(9) {
        0 => vec![
            (Stimulus::WaitIdle, 20_000),
            (Stimulus::VirtualFixture(None), 400),
            (Stimulus::Send(Command::Tare), 1500),
        ],
        1 | 2 => {
            let settings = command::valid_loop(rng);
            vec![(Stimulus::Send(Command::ForceLoop { axis, settings }), 400)]
        }
        3 => {
            let mask = rng.below(8) as u8;
            vec![(Stimulus::Send(Command::ForceMask { mask }), 400)]
        }
        4 | 5 => {
            let gap = rng.uniform(0.2, 3.0);
            let stiffness = rng.log_uniform(2.0, 60.0);
            // The line enters the wall no farther than the force limit allows.
            let depth = (30.0 / stiffness).min(6.0);
            approach(axis, gap, stiffness, rng, |rng| JobPlan::Line {
                axis,
                distance_um: ((gap + depth) * 1000.0) as u32,
                speed: rng.uniform(0.03, 0.08),
            })
        }
        6 => cut_workpiece(rng),
        8 => {
            // A compliant tool approaches a wall so slowly that the slides stick and slip.
            let gap = rng.uniform(0.02, 0.3);
            let stiffness = rng.log_uniform(2.0, 60.0);
            approach(axis, gap, stiffness, rng, |rng| JobPlan::Line {
                axis,
                distance_um: rng.uniform(300.0, 1500.0) as u32,
                speed: rng.log_uniform(0.0004, 0.01),
            })
        }
        _ => valid_operation(rng),
    }
}

/// Returns a line of a compliant tool into a wall, and the way back.
fn approach(
    axis: u8,
    gap: f64,
    stiffness: f64,
    rng: &mut Rng,
    line: impl FnOnce(&mut Rng) -> JobPlan,
) -> Steps {
    let settings = command::compliant_loop(rng);
    vec![
        (Stimulus::WaitIdle, 20_000),
        (Stimulus::Send(Command::ForceMask { mask: 0 }), 800),
        (Stimulus::Send(Command::Tare), 1500),
        (Stimulus::Send(Command::ForceLoop { axis, settings }), 400),
        (Stimulus::Send(Command::ForceMask { mask: 1 << axis }), 20),
        (Stimulus::VirtualFixture(Some((axis, gap, stiffness))), 20),
        (Stimulus::Job(line(rng)), 14_000),
        (Stimulus::Send(Command::Stop), 3000),
        (Stimulus::VirtualFixture(None), 6000),
        (Stimulus::Send(Command::ForceMask { mask: 0 }), 400),
    ]
}

fn cut_workpiece(rng: &mut Rng) -> Steps {
    // Unused; it keeps the episodes of all seeds as they were.
    let _ = rng.bits();
    let line = JobPlan::Line {
        axis: 0,
        distance_um: 25_000,
        speed: rng.uniform(0.02, 0.06),
    };
    vec![
        (Stimulus::WaitIdle, 20_000),
        (Stimulus::Send(Command::ForceMask { mask: 0 }), 800),
        (Stimulus::Send(Command::Tare), 1500),
        (Stimulus::Send(Command::ForceMask { mask: 1 }), 20),
        (Stimulus::ClampStock, 20),
        (Stimulus::Job(line), 20_000),
        (Stimulus::Send(Command::Stop), 3000),
        (Stimulus::VirtualFixture(None), 8000),
        (Stimulus::Send(Command::ForceMask { mask: 0 }), 400),
    ]
}
