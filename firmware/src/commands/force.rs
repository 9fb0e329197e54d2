//! Commands of force control.

use super::conditions::Done;
use crate::core::Core;
use crate::force::sensor::COMPONENTS;
use crate::force::{ForceControl, ForceLoop, LoopSettings};
use haptimill_protocol::message::{Event, Refusal, State};

fn force_control(core: &mut Core) -> Result<&mut ForceControl, Refusal> {
    let machine = core.configured()?;
    machine.force.as_mut().ok_or(Refusal::NoForceSensor)
}

/// Allowed in any state. An axis that leaves force control returns by its admittance law; one that
/// joins starts at its position.
pub(super) fn set_force_mask(core: &mut Core, mask: u8) -> Done {
    let force = force_control(core)?;
    if mask >> COMPONENTS != 0 {
        return Err(Refusal::Range);
    }
    let tared = force.conditioner().tared();
    let moving = core.safety.active();
    if mask != 0 && moving && !tared {
        return Err(Refusal::NotTared);
    }
    force_control(core)?.set_mask(mask);
    Ok(())
}

pub(super) fn set_force_loop(core: &mut Core, axis: u8, settings: &ForceLoop) -> Done {
    force_control(core)?
        .set(usize::from(axis), &LoopSettings::from(settings))
        .map_err(|refusal| Refusal::Force { axis, refusal })
}

pub(super) fn report_force_settings(core: &mut Core, axis: u8) -> Done {
    let settings = force_control(core)?.settings(usize::from(axis));
    let settings = settings.map(ForceLoop::from).ok_or(Refusal::Range)?;
    core.safety
        .push_event(Event::ForceSettings { axis, settings });
    Ok(())
}

/// Allowed in Disabled and Idle only: the machine is at rest and the spindle is off. Refused while
/// the tool has a compliant displacement.
pub(super) fn tare(core: &mut Core) -> Done {
    let state = core.safety.state();
    let force = force_control(core)?;
    if !matches!(state, State::Disabled | State::Idle) {
        return Err(Refusal::State(state));
    }
    if force.displaced() {
        return Err(Refusal::Compliant);
    }
    force.begin_tare();
    Ok(())
}
