//! Conditions of commands.

use crate::core::Core;
use haptimill_protocol::message::{InputProblem, Refusal, State};

/// Result of a command.
pub(super) type Done = Result<(), Refusal>;

/// Refuses in any other state than the `allowed` ones.
pub(super) fn in_state(core: &Core, allowed: &[State]) -> Done {
    let state = core.safety.state();
    if allowed.contains(&state) {
        Ok(())
    } else {
        Err(Refusal::State(state))
    }
}

/// Refuses while the step motors lock: nothing may be moved.
pub(super) fn settled(core: &Core) -> Done {
    match &core.machine {
        Some(machine) if machine.is_locking() => Err(Refusal::Input(InputProblem::Settling)),
        _ => Ok(()),
    }
}
