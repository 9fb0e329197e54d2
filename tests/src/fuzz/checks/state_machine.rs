//! State machine: each transition is allowed and has its cause.

use super::super::bench::{FuzzBench, name};
use super::{CheckResult, Checks, commanded_pose};
use haptimill_protocol::message::State;

/// Returns the commands that may cause a transition; none if the transition is not allowed.
///
/// An empty list means that the transition needs no command.
fn commands_for(from: State, to: State) -> Option<&'static [&'static str]> {
    use State::{Disabled, EmergencyStop, Fault, Hold, Homing, Idle, Jog, Run};
    Some(match (from, to) {
        (_, EmergencyStop) => &[],
        (Disabled, Idle) => &["Enable"],
        (Idle, Disabled) => &["Disable"],
        (Idle, Homing) => &["Home"],
        (Disabled, Homing) => &["MoveOff"],
        // A joint that moved off its limit switch where the joints give no pose.
        (Homing, Disabled) => &[],
        (Idle, Run) => &["JobStart"],
        (Idle, Jog) => &["Jog"],
        (Hold, Run) => &["Resume"],
        (Fault, Disabled | Idle) | (EmergencyStop, Disabled) => &["Reset"],
        (Disabled | Idle | Homing | Run | Jog | Hold, Fault)
        | (Homing | Jog | Run | Hold, Idle)
        | (Run, Hold) => &[],
        _ => return None,
    })
}

impl Checks {
    /// Checks the transition of this period, and starts and ends the planned job.
    pub(super) fn check_transition(&mut self, bench: &mut FuzzBench) -> CheckResult {
        let state = bench.controller().safety().state();
        let from = self.previous.state;
        while bench
            .abandoned
            .front()
            .is_some_and(|_| bench.period > bench.session_start + 3000)
        {
            bench.abandoned.pop_front();
        }
        if from != state {
            self.timeouts.settled = 0;
            self.following.standstill = 0;
            let Some(commands) = commands_for(from, state) else {
                violated!(bench, "transition", "{from:?} -> {state:?}");
            };
            // The request was unanswered before this period, or was answered in it.
            let requested = commands.is_empty()
                || bench
                    .pending
                    .iter()
                    .chain(&bench.abandoned)
                    .any(|pending| commands.contains(&name(&pending.command)))
                || bench
                    .answered_names
                    .iter()
                    .any(|name| commands.contains(name));
            if !requested {
                violated!(
                    bench,
                    "transition without cause",
                    "{from:?} -> {state:?}, and none of {commands:?} was requested"
                );
            }
        }
        let in_job = matches!(state, State::Run | State::Hold);
        if state == State::Run && !matches!(from, State::Run | State::Hold) {
            self.job.begin(commanded_pose(bench));
        }
        if !in_job {
            self.job.end();
        }
        Ok(())
    }
}
