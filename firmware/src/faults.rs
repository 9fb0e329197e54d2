//! Stage *supervise*: the fault checks of measurement and link, in a fixed order. An immediate
//! fault replaces a pending controlled one, so the order does not decide which of the two stops the
//! machine.

use crate::comm::server::Server;
use crate::core::Core;
use crate::force::sensor::is_force;
use crate::io::{Inputs, JointInputs, first_alarm};
use crate::machine::Machine;
use crate::safety::{keeps_position, suspected};
use haptimill_protocol::message::{Event, Fault, State};

/// Program time of the retraction after a force beyond its limit, microseconds.
const RETRACT_US: u32 = 1_000_000;

/// On-time periods that cancel one missed period. At 4, missing every other period would go
/// undetected.
const ON_TIME_PER_MISSED: u16 = 16;

/// Control periods between two integrity checks.
const INTEGRITY_PERIODS: u64 = 16;

/// Backlog of integrity checks from which on a period is reserved for one.
pub(crate) const DIGEST_OVERDUE: u8 = 2;

/// Runs all checks and raises the faults.
#[inline]
pub(crate) fn check(core: &mut Core, server: &mut Server, inputs: &Inputs) {
    if inputs.emergency_stop && core.safety.state() != State::EmergencyStop {
        core.safety.emergency_stop();
    }
    if core.machine.is_none() || !check_configuration(core, server, inputs) {
        return;
    }
    check_devices(core);
    check_counters(core);
    if !core.safety.drives_on() {
        return;
    }
    check_locking(core);
    check_force(core);
    let missed = check_missed_periods(core, inputs);
    check_joints(core, inputs, missed);
    check_host(core, server);
}

/// Compares one part of the configuration with its digest. False where there is no machine any
/// more.
///
/// A period with other work leaves the check to the next one.
fn check_configuration(core: &mut Core, server: &mut Server, inputs: &Inputs) -> bool {
    let Some(machine) = &mut core.machine else {
        return false;
    };
    if inputs.period.is_multiple_of(INTEGRITY_PERIODS) {
        core.job.digest_backlog = core.job.digest_backlog.saturating_add(1);
    }
    let reserved =
        server.is_deferred() && core.job.digest_backlog >= DIGEST_OVERDUE + u8::from(core.job.busy);
    if core.job.digest_backlog == 0 || !(reserved || server.try_background()) {
        return true;
    }
    core.job.digest_backlog = 0;
    if machine.check_next_digest() {
        return true;
    }
    core.safety.raise(Fault::Configuration);
    if core.safety.fault() == Some(Fault::Configuration) {
        return true;
    }
    // Another fault is latched already. The configuration must not be used after its reset.
    core.safety.lose_position();
    core.job.preset_valid = false;
    core.machine = None;
    false
}

/// Results of a tare, and problems of the haptic arm.
#[inline]
fn check_devices(core: &mut Core) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    if let Some(force) = &mut machine.force
        && let Some(result) = force.take_tare_result()
    {
        core.safety.push_event(match result {
            Ok(()) => Event::Tared,
            Err(refusal) => Event::TareRefused(refusal),
        });
    }
    if let Some(problem) = machine.take_haptic_problem() {
        if core.safety.drives_on() && machine.is_led_by_haptics() {
            core.safety.raise(Fault::Master(problem));
        } else {
            core.safety.push_event(Event::Master(problem));
        }
    }
}

/// Counters that changed by more than their joint can move, in every state, and counters with a
/// stuck channel while the drives are off.
#[inline]
fn check_counters(core: &mut Core) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    if !core.safety.drives_on() {
        // The index pulses decide about an encoder that is suspected already.
        let suspect = core.safety.fault().and_then(|fault| suspected(&fault));
        machine.supervise_unpowered(suspect);
    }
    if let Some(fault) = machine.counter_fault() {
        // The position is lost at once. While another fault is latched, this one is raised after
        // its reset.
        core.safety.lose_position();
        core.job.preset_valid = false;
        core.safety.raise(fault);
        if core.safety.fault() == Some(fault) {
            machine.acknowledge_counter_fault();
        }
    }
}

/// Rotors of step motors that do not lock after `Enable`.
#[inline]
fn check_locking(core: &mut Core) {
    if let Some(machine) = &mut core.machine
        && machine.is_locking()
        && let Err(fault) = machine.lock()
    {
        core.safety.raise(fault);
    }
}

/// The force sensor, and the force on the tool.
#[inline]
fn check_force(core: &mut Core) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    if core.safety.active()
        && let Some(force) = &machine.force
        && let Some(problem) = force.stop_condition(core.safety.state() == State::Jog)
    {
        if is_force(&problem) && core.safety.pending().is_none() {
            // A force this large is a collision, not a cut: retract along the path.
            let periods = RETRACT_US / u32::from(core.period_us.max(1));
            machine.motion.program.retract(periods);
        }
        core.safety.raise(Fault::Force(problem));
    }
}

/// Missed periods, in a row or too often. Returns whether the limit is exceeded.
#[inline]
fn check_missed_periods(core: &mut Core, inputs: &Inputs) -> bool {
    let Some(machine) = &core.machine else {
        return false;
    };
    let limit = machine.config.supervision.missed_periods;
    core.job.missed = match inputs.missed {
        0 => core.job.missed.saturating_sub(1),
        missed => core
            .job
            .missed
            .saturating_add(missed.saturating_mul(ON_TIME_PER_MISSED)),
    };
    let missed =
        inputs.missed >= limit || core.job.missed >= limit.saturating_mul(4 * ON_TIME_PER_MISSED);
    if missed {
        core.job.missed = 0;
        core.safety.raise(Fault::MissedPeriods {
            missed: inputs.missed,
        });
    }
    missed
}

/// Limit switches, drives, and the joint monitors.
#[inline]
fn check_joints(core: &mut Core, inputs: &Inputs, missed: bool) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    if let Some(fault) = hardware(machine, inputs, core.safety.homed())
        .or_else(|| machine.supervise(inputs.missed != 0))
        .or_else(|| machine.racked(core.safety.homed()))
    {
        // After missed periods a large change of the counts is legitimate.
        let jumped = matches!(
            fault,
            Fault::EncoderIllegal { .. } | Fault::CounterJump { .. }
        );
        if !(missed && jumped && machine.encoders_counted()) {
            core.safety.raise(fault);
        }
    }
}

/// Silence of the host while the machine is active.
#[inline]
fn check_host(core: &mut Core, server: &Server) {
    let Some(machine) = &core.machine else {
        return;
    };
    let heartbeat_us = (u64::from(machine.config.supervision.heartbeat_ms) + 1) * 1000;
    let silent_us = server.silent_us();
    if core.safety.active() && silent_us >= heartbeat_us {
        core.safety.raise(Fault::LostHost {
            silent_ms: (silent_us / 1000).min(u64::from(u32::MAX)) as u32,
        });
    }
}

/// A limit switch that is active, or a drive that reports a fault. A check without the
/// configuration, where it suffices, saves instructions of every period
/// (docs/decisions/0036-short-forms-of-hot-functions.md).
#[inline]
pub(crate) fn hardware(machine: &Machine, inputs: &Inputs, homed: bool) -> Option<Fault> {
    if !machine.has_only_plain_switches() {
        return machine.hardware_fault(&inputs.joints, homed);
    }
    let joints = inputs.joints.get(..machine.joint_count())?;
    let healthy = |joint: &JointInputs| joint.drive_ready & !(joint.limit_low | joint.limit_high);
    if joints.iter().fold(true, |all, joint| all & healthy(joint)) {
        return None;
    }
    name_hardware_fault(joints)
}

#[cold]
#[inline(never)]
fn name_hardware_fault(joints: &[JointInputs]) -> Option<Fault> {
    for (index, joint) in joints.iter().enumerate() {
        if joint.limit_low || joint.limit_high {
            return Some(Fault::LimitSwitch { joint: index as u8 });
        }
        if !joint.drive_ready {
            let (joint, alarm) = first_alarm(joints)?;
            return Some(Fault::Drive { joint, alarm });
        }
    }
    None
}

/// Consequences of a latched fault or an emergency stop for the job, and of a fault for the
/// position.
#[inline]
pub(crate) fn close_aborted_job(core: &mut Core) {
    if matches!(
        core.safety.state(),
        State::Fault | State::EmergencyStop | State::Disabled
    ) {
        core.drop_job();
        core.job.stopping = false;
        core.job.spindle_rpm = 0;
        if let Some(machine) = &mut core.machine {
            machine.io.take_probing();
        }
    }
    if core.safety.has_latched() {
        invalidate_preset(core);
    }
    if core.safety.take_position_loss() {
        core.job.preset_valid = false;
    }
}

#[cold]
#[inline(never)]
fn invalidate_preset(core: &mut Core) {
    if let Some(fault) = core.safety.take_latched() {
        // Homing checks a suspected encoder by its index pulse: the preset stays until then.
        let index_decides = suspected(&fault)
            .zip(core.machine.as_ref())
            .is_some_and(|(axis, machine)| machine.index_decides(axis));
        core.job.preset_valid &= index_decides || keeps_position(&fault);
        if fault == Fault::Configuration {
            // The host must send the configuration again.
            core.machine = None;
        }
    }
}
