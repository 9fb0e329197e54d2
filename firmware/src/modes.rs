//! Stage *interpolate*: what each state does in a control period, and the commanded pose of it.

use crate::comm::server::Server;
use crate::core::Core;
use crate::faults;
use crate::io::Inputs;
use crate::machine::Machine;
use crate::machine::masters::MasterMotion;
use crate::motion::Mode;
use crate::motion::interpolator::Progress;
use crate::safety::homing::{HomingProgress, Searched};
use haptimill_protocol::message::{Action, Event, Fault, Refusal, State};

/// One period of the present state.
#[inline]
pub(crate) fn advance(core: &mut Core, server: &mut Server, inputs: &Inputs) {
    if core.safety.pending().is_some() && !core.job.stopping {
        core.abort();
    }
    if core.job.resume_wait != 0 {
        core.wait_for_spindle();
    }
    follow_master(core);
    advance_motion(core, server, inputs);
    faults::close_aborted_job(core);
    if core.job.enabling != 0 {
        answer_enable(core, server);
    }
}

/// A master moves coordinates of a running job. The job holds when its samples are stale.
fn follow_master(core: &mut Core) {
    let running = core.safety.state() == State::Run && !core.job.stopping;
    let Some(machine) = &mut core.machine else {
        return;
    };
    if !running {
        machine.release_master();
    } else if let MasterMotion::Lost(age_ms) = machine.advance_master() {
        core.safety.push_event(Event::MasterLost { age_ms });
        core.hold();
    }
}

#[inline]
fn advance_motion(core: &mut Core, server: &mut Server, inputs: &Inputs) {
    let state = core.safety.state();
    let Some(machine) = &mut core.machine else {
        return;
    };
    let mode = match state {
        State::Run => Mode::Program { halt: false },
        State::Hold => Mode::Program { halt: true },
        State::Jog | State::Homing => Mode::Jog,
        _ => Mode::Still,
    };
    let (progress, limited) = machine.advance(mode);
    if let Some(coordinate) = limited
        && state != State::Homing
    {
        machine.motion.jog.release();
        core.safety.push_event(Event::JogLimited { coordinate });
    }
    if let Some(coordinate) = machine.motion.take_limited() {
        core.safety.push_event(Event::MasterLimited { coordinate });
    }
    match state {
        State::Run | State::Hold => follow_program(core, server, state, &progress),
        State::Jog if machine.motion.jog.is_at_standstill() => core.finish_at_standstill(),
        State::Homing => follow_homing(core, inputs, limited.is_some()),
        _ => {}
    }
}

/// Events of the program, and its end.
#[inline]
fn follow_program(core: &mut Core, server: &mut Server, state: State, progress: &Progress) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    let deferred = server.is_deferred();
    let program = &mut machine.motion.program;
    program.prefetch(deferred, || server.try_background_idle());
    if let Some(underrun) = program.take_underrun() {
        core.safety.push_event(Event::Underrun {
            setpoint: underrun.setpoint,
            late_periods: underrun.periods,
        });
    }
    if progress.queue_empty {
        core.safety.raise(Fault::Internal {
            line: line!() as u16,
        });
        return;
    }
    let commanded = machine.motion.commanded().pose;
    if let Some(coordinate) = machine.beyond_soft_limit(&commanded) {
        core.safety.raise(Fault::SoftLimit { coordinate });
    }
    match progress.action {
        Action::None | Action::Pause | Action::OverrideMode(_) => {}
        Action::Spindle(speed) => core.set_spindle_of_job(speed),
        Action::Output { output, on } => core.set_output_of_job(output, on),
        Action::AnalogOutput { output, code } => machine.io.set_analog(output, code),
    }
    let Some(machine) = &mut core.machine else {
        return;
    };
    if progress.blocked && state == State::Run {
        core.safety.push_event(Event::Blocked {
            setpoint: machine.motion.program.reached(),
        });
        core.safety.enter(State::Hold);
    }
    if let Some(setpoint) = progress.paused {
        core.safety.push_event(Event::Paused { setpoint });
        core.safety.enter(State::Hold);
    }
    let at_standstill = machine.motion.is_at_standstill();
    if progress.finished && at_standstill {
        let setpoints = machine.motion.program.reached();
        if let Some(job) = core.job.number.take() {
            core.safety.push_event(Event::JobDone { job, setpoints });
            core.end_coolant();
        }
        core.finish_at_standstill();
    } else if state == State::Hold && core.job.stopping && at_standstill {
        core.finish_at_standstill();
    }
}

/// One period of homing.
#[inline(never)]
fn follow_homing(core: &mut Core, inputs: &Inputs, limited: bool) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    if machine.is_moving_off() {
        return advance_move_off(core, inputs);
    }
    if machine.searches_switches() {
        match machine.advance_switches(inputs, core.job.stopping) {
            Ok(true) if core.job.stopping => core.finish_at_standstill(),
            Ok(_) => {}
            Err(fault) => core.safety.raise(fault),
        }
        return;
    }
    if core.job.stopping {
        if machine.motion.jog.is_at_standstill() {
            core.finish_at_standstill();
        }
        return;
    }
    if let Err(fault) = machine.check_index_pulses() {
        core.safety.raise(fault);
        return;
    }
    let pose = machine.motion.commanded().pose;
    let searched = Searched {
        config: &machine.config,
        kinematics: &machine.kinematics,
    };
    match machine
        .homing
        .advance(&searched, &pose, &mut machine.motion.jog, limited)
    {
        HomingProgress::Searching => {}
        HomingProgress::Failed(fault) => core.safety.raise(fault),
        HomingProgress::Found(corrections) => match machine.apply_homing(&corrections, inputs) {
            Ok(()) => {
                for event in machine.homing_events() {
                    core.safety.push_event(event);
                }
                core.safety.set_homed(true);
                core.finish_at_standstill();
            }
            Err(error) => core.safety.raise(Fault::Pose(error)),
        },
    }
}

/// One period in which a joint moves off its limit switch.
#[cold]
#[inline(never)]
fn advance_move_off(core: &mut Core, inputs: &Inputs) {
    let Some(machine) = &mut core.machine else {
        return;
    };
    let joint = machine.move_off_joint();
    match machine.advance_move_off(inputs, core.job.stopping) {
        Ok(false) => {}
        Ok(true) => {
            let holds = machine.end_move_off(inputs);
            if !core.job.stopping {
                core.safety.push_event(Event::MovedOff { joint });
            }
            core.finish_at_standstill();
            if !holds {
                match core.safety.state() {
                    State::Idle => core.safety.enter(State::Disabled),
                    // A fault that ended the motion: there is no pose to hold.
                    _ => core.safety.end_holding(),
                }
            }
        }
        Err(fault) => core.safety.raise(fault),
    }
}

/// Answers `Enable` when the step motors have locked, or when the state has changed before.
#[cold]
#[inline(never)]
fn answer_enable(core: &mut Core, server: &mut Server) {
    let locking = core.machine.as_ref().is_some_and(Machine::is_locking);
    let result = match core.safety.state() {
        State::Idle if locking => return,
        State::Idle => Ok(()),
        state => Err(Refusal::State(state)),
    };
    // The answer to the request of this period may have taken the last place in the queue.
    if server.can_answer() {
        server.answer(core.job.enabling, result);
        core.job.enabling = 0;
    }
}
