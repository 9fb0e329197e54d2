//! Validation of setpoints, spread over periods.
//!
//! The checks of one setpoint take longer than a period has time for. A slice does as many of them
//! as its budget allows; the progress waits in the server for the next slice.

use super::conditions::in_state;
use crate::comm::server::Server;
use crate::core::Core;
use haptimill_protocol::message::{Refusal, State};

/// Costs of validating a setpoint, in units of the check of one coordinate: pose check, new
/// segment duration, enqueue.
const POSE: usize = 3;
const NEW_DURATION: usize = 1;
const ENQUEUE: usize = 1;
/// Costs in the same units: check of one piece of a long segment, and decoding the next setpoint.
/// The piece check exceeds the budget of a period in which a frame came, so it runs in a later one.
const PIECE: usize = 5;
const DECODE: usize = 5;

/// Validates a setpoint as far as the slice budget of this period allows: its pose, then each
/// coordinate, then the joint rates. Enqueues it when it is valid, and decodes the next one if the
/// budget is left. A later period continues what did not fit.
#[inline(never)]
pub(crate) fn enqueue_setpoint(core: &mut Core, server: &mut Server, number: u32, validated: u8) {
    let mut budget = server.budget();
    match validate_setpoint(core, server, number, usize::from(validated), &mut budget) {
        Ok(None) => server.accept_setpoint(budget >= DECODE),
        Ok(Some(validated)) => server.continue_setpoint(validated),
        Err(refusal) => server.refuse_setpoints(refusal),
    }
}

/// Continues the validation of a setpoint. `validated` is the progress: 0 for none, 1 after the
/// pose check, then 1 more for each coordinate and each piece. Returns the new progress, or `None`
/// when the setpoint is in the queue.
fn validate_setpoint(
    core: &mut Core,
    server: &Server,
    number: u32,
    validated: usize,
    budget: &mut usize,
) -> Result<Option<u8>, Refusal> {
    in_state(core, &[State::Run, State::Hold])?;
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    let setpoint = server.setpoint();
    let expected = machine.motion.program.accepted();
    if number != expected {
        return Err(Refusal::OutOfOrder { expected });
    }
    if validated == 0 {
        machine.check_action(&setpoint.action)?;
        machine.check_setpoint_pose(number, setpoint)?;
        *budget = budget.saturating_sub(POSE);
        if !machine.motion.program.expects(setpoint.periods) {
            *budget = budget.saturating_sub(NEW_DURATION);
        }
    }
    let axes = machine.axes();
    let first = validated.saturating_sub(1).min(axes);
    let last = axes.min(first + *budget);
    *budget -= last - first;
    machine.motion.program.allows(setpoint, first..last)?;
    if last < axes {
        return Ok(Some(last as u8 + 1));
    }
    let pieces = machine.pieces(setpoint);
    let mut piece = validated.saturating_sub(axes + 1) as u8;
    while piece < pieces {
        // The last piece ends at the pose that was checked. Any other one uses up the budget.
        let (min, left) = if piece + 1 == pieces {
            (ENQUEUE, budget.saturating_sub(ENQUEUE))
        } else {
            (PIECE, 0)
        };
        if *budget < min {
            break;
        }
        *budget = left;
        machine.check_piece(number, setpoint, piece, pieces)?;
        piece += 1;
    }
    if piece < pieces || *budget < ENQUEUE {
        return Ok(Some((axes + 1) as u8 + piece));
    }
    *budget -= ENQUEUE;
    machine.motion.program.push_checked(setpoint, axes)?;
    machine.accept_end();
    Ok(None)
}
