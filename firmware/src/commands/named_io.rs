//! Commands of named outputs and of probing.

use super::conditions::{Done, in_state};
use crate::core::Core;
use crate::io::Inputs;
use crate::named_io::{NamedIo, Probing};
use haptimill_protocol::message::{Refusal, State};

/// Outputs have their safe values while a fault or an emergency stop is latched.
fn settable(core: &Core) -> Done {
    match core.safety.state() {
        state @ (State::Fault | State::EmergencyStop) => Err(Refusal::State(state)),
        _ => Ok(()),
    }
}

#[inline(never)]
pub(super) fn set_output(core: &mut Core, output: u8, on: bool) -> Done {
    settable(core)?;
    // The commanded speed: a spindle that an open door stopped turns again with the next resume.
    let spindle_rpm = core.job.spindle_rpm;
    let machine = core.configured()?;
    machine
        .io
        .may_set(&machine.config.io, output, spindle_rpm)?;
    machine.io.set(output, on);
    Ok(())
}

#[inline(never)]
pub(super) fn set_analog_output(core: &mut Core, output: u8, code: i16) -> Done {
    settable(core)?;
    let machine = core.configured()?;
    NamedIo::may_set_analog(&machine.config.io, output, code)?;
    machine.io.set_analog(output, code);
    Ok(())
}

#[inline(never)]
pub(super) fn arm_probe(core: &mut Core, probing: Probing, inputs: &Inputs) -> Done {
    in_state(core, &[State::Idle])?;
    let machine = core.configured()?;
    // The machine is at standstill: a level that is changing already is latched here.
    let latch = machine.probe_latch(inputs.period);
    let before = machine.io.armed();
    machine.io.arm(&machine.config.io, probing, latch)?;
    let refused = machine.check_inputs(false);
    if refused.is_err() {
        // A refused command changes nothing: a probe that was armed before stays armed.
        machine.io.rearm(before);
    }
    refused
}
