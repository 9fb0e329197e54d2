//! Reactions of the controller to named inputs, and the outputs of a period.

use crate::comm::server::Server;
use crate::core::Core;
use crate::io::Outputs;
use crate::named_io::config::{ContactReaction, InputFunction};
use crate::named_io::{self, Probing};
use haptimill_kinematics::Kinematics;
use haptimill_protocol::message::{Event, Fault, State};

/// Reacts to the inputs of this period, and to the silence of the host.
#[inline]
pub(crate) fn react(core: &mut Core, server: &Server) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    if machine.config.io.is_empty() {
        return;
    }
    let heartbeat_us = (u64::from(machine.config.supervision.heartbeat_ms) + 1) * 1000;
    if server.silent_us() >= heartbeat_us && machine.io.make_safe(&machine.config.io, false) {
        core.safety.push_event(Event::OutputsSafe);
    }
    if (machine.io.levels() | machine.io.changed()) != 0 {
        react_to_inputs(core);
    }
}

#[inline(never)]
fn react_to_inputs(core: &mut Core) {
    react_to_probes(core);
    let Some(machine) = &core.machine else {
        return;
    };
    let (io, config) = (&machine.io, &machine.config.io);
    let state = core.safety.state();
    if let Some(input) = io.active_with(config, |it| matches!(it, InputFunction::Door { .. })) {
        core.job.spindle_stopped = true;
        core.job.resume_wait = 0;
        let moves = matches!(state, State::Run | State::Jog | State::Homing);
        if moves && !core.job.stopping {
            core.safety.push_event(Event::InputHold { input });
            core.hold();
        } else if state == State::Hold && !machine.motion.is_at_standstill() {
            // A jog moves a coordinate while the program holds.
            core.hold();
        }
    } else if let Some(input) = io.active_with(config, |it| it == InputFunction::FeedHold) {
        core.job.resume_wait = 0;
        if state == State::Run {
            core.safety.push_event(Event::InputHold { input });
            core.hold();
        }
    }
}

/// Ends a motion at the contact of its armed probe; a contact without armed probing is a fault or a
/// warning.
fn react_to_probes(core: &mut Core) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    let changed = machine.io.changed();
    if changed == 0 {
        return;
    }
    let armed = machine.io.probing();
    let is_moving = core.safety.active()
        && (core.safety.state() != State::Hold || !machine.motion.is_at_standstill());
    let mut contact = None;
    let mut unexpected = None;
    for (index, input) in machine.config.io.inputs.iter().enumerate() {
        if changed & named_io::bit(index) == 0 {
            continue;
        }
        if armed.is_some_and(|armed| usize::from(armed.input) == index) {
            contact = armed.filter(|_| machine.io.is_at_contact());
        } else if machine.io.is_active(index)
            && let InputFunction::Probe(reaction) | InputFunction::ToolSetter(reaction) =
                input.function
        {
            unexpected = Some((index as u8, reaction));
        }
    }
    if let Some(probing) = contact.filter(|_| core.safety.active()) {
        report_contact(core, probing);
        core.abort();
    }
    if let Some((input, reaction)) = unexpected.filter(|_| is_moving) {
        match reaction {
            ContactReaction::Fault => core.safety.raise(Fault::ProbeContact { input }),
            ContactReaction::Warning => core.safety.push_event(Event::ProbeContact { input }),
        }
    }
}

/// Reports the latched position of each coordinate, then the contact.
fn report_contact(core: &mut Core, probing: Probing) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    machine.io.take_probing();
    let latch = *machine.io.latch();
    let measured = machine.kinematics.forward(&latch.joints).ok();
    for axis in 0..machine.axes() {
        core.safety.push_event(Event::ProbedAt {
            coordinate: axis as u8,
            measured: measured.map_or(latch.commanded, |pose| pose).0[axis].0,
            commanded: latch.commanded.0[axis].0,
            joint: latch.joints.0[axis].0,
        });
    }
    core.safety.push_event(Event::Probed {
        input: probing.input,
        period: latch.period,
        is_measured: measured.is_some(),
    });
}

/// The outputs of this period. In a fault and in an emergency stop all have their safe values.
#[inline]
pub(crate) fn write_outputs(core: &mut Core, outputs: &mut Outputs) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    let config = &machine.config.io;
    if config.is_empty() {
        return;
    }
    let unsafe_state = matches!(core.safety.state(), State::Fault | State::EmergencyStop);
    if unsafe_state && machine.io.make_safe(config, true) {
        core.safety.push_event(Event::OutputsSafe);
    }
    machine.io.follow_spindle(config, outputs.spindle_rpm);
    outputs.digital = machine.io.digital_word(config);
    outputs.analog = machine.io.analog_codes(config);
}
