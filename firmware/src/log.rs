//! Log of what no event of the controller reports: missed control periods, and alarms of drives.

use crate::core::Core;
use crate::io::Inputs;
use haptimill_protocol::message::Alarms;

/// Logs the missed control periods before this one, and the alarms that changed since the call
/// before: those of the joints of the machine.
#[inline]
pub(crate) fn inputs(core: &mut Core, inputs: &Inputs) {
    if inputs.missed != 0 {
        defmt::warn!("missed control periods: {=u16}", inputs.missed);
    }
    let alarms = inputs.alarms();
    if alarms != core.alarms {
        log_alarms(core, alarms);
    }
}

#[cold]
#[inline(never)]
fn log_alarms(core: &mut Core, alarms: Alarms) {
    // Without a machine it is not known which joints have a drive. They are logged once it is.
    let Some(machine) = &core.machine else {
        return;
    };
    for joint in 0..machine.joint_count() {
        let (before, now) = (core.alarms.of(joint), alarms.of(joint));
        match now {
            _ if before == now => {}
            Some(alarm) => defmt::warn!("drive of joint {}: {}", joint, alarm),
            None => defmt::info!("drive of joint {}: ready", joint),
        }
    }
    core.alarms = alarms;
}
