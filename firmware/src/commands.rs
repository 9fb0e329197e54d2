//! Command stage: executes one request or setpoint per period. A refused command changes nothing.

use crate::comm::server::Server;
use crate::config::Config;
use crate::config::HAND;
use crate::core::Core;
use crate::faults::hardware;
use crate::force::sensor::COMPONENTS;
use crate::force::{ForceControl, ForceLoop, LoopSettings};
use crate::haptics::Haptic;
use crate::haptics::config::scale_is_sound;
use crate::haptics::feedback_law;
use crate::haptics::mapping::LED;
use crate::io::Inputs;
use crate::machine::Machine;
use haptimill_math::{Length, Rate};
use haptimill_protocol::frame::crc32;
use haptimill_protocol::haptic::{ForceFeedback, MasterPose, VirtualFixture};
use haptimill_protocol::message::{
    AxisValues, Command, ConfigField, ConfigProblem, Event, Fault, InputProblem, MAX_AXES,
    RATE_SHIFT, Refusal, Source, State,
};

type Done = Result<(), Refusal>;

/// Costs of validating a setpoint, in units of the check of one coordinate: pose check, new
/// segment duration, enqueue.
const POSE: usize = 3;
const SPAN: usize = 1;
const TAKE: usize = 1;
/// Costs in the same units: check of one piece of a long segment, and decoding the next setpoint.
/// The piece check exceeds the budget of a period in which a frame came, so it runs in a later one.
const PIECE: usize = 5;
const READ: usize = 5;

/// Executes the received request and answers it.
pub(crate) fn execute(core: &mut Core, server: &mut Server, inputs: &Inputs) {
    let request = server.take_request();
    let result = match request.command {
        Command::Home | Command::JobStart { .. } | Command::Resume | Command::Jog { .. }
            if core.job.stale_commands =>
        {
            Err(Refusal::State(core.safety.state()))
        }
        // The server takes batches apart, one setpoint a period.
        Command::Setpoints(_) | Command::Ping => Ok(()),
        Command::Configure(chunk) => server.stage(&chunk),
        Command::Activate {
            length,
            crc,
            at_preset,
        } => activate(core, server, inputs, length, crc, at_preset),
        Command::Enable => match enable(core, inputs) {
            Ok(()) if settled(core).is_err() => {
                // The answer follows when the step motors have locked.
                core.job.enabling = request.id;
                return;
            }
            result => result,
        },
        Command::Disable => disable(core),
        Command::Home => home(core),
        Command::Reset => reset(core, inputs),
        Command::JobStart { job, pose } => start_job(core, server, job, &pose),
        Command::JobEnd { count } => end_job(core, count),
        Command::Hold => {
            core.hold();
            core.job.stale_commands = false;
            Ok(())
        }
        Command::Resume => resume(core),
        Command::Stop => {
            // The link delivers in order: everything that the host sent before has been received.
            core.job.stale_commands = false;
            if core.safety.active() {
                core.abort();
            }
            Ok(())
        }
        Command::EmergencyStop => {
            core.safety.emergency_stop();
            Ok(())
        }
        Command::Jog {
            epoch,
            deadline_ms,
            rates,
        } => jog(core, epoch, deadline_ms, &rates),
        Command::JogCancel { epoch } => cancel_jog(core, epoch),
        Command::Source { axis, source } => choose_source(core, axis, source),
        Command::Override { percent } => set_override(core, percent),
        Command::Telemetry { every } => {
            server.set_telemetry(every);
            Ok(())
        }
        Command::Status => {
            server.telemetry_now();
            Ok(())
        }
        Command::ForceMask { mask } => set_force_mask(core, mask),
        Command::ForceLoop { axis, settings } => set_force_loop(core, axis, &settings),
        Command::ForceSettings { axis } => report_force_settings(core, axis),
        Command::Tare => tare(core),
        Command::MasterPose {
            epoch,
            age_ms,
            pose: hand,
        } => set_remote_master(core, epoch, age_ms, &hand),
        Command::RemoteForce { force } => haptic_arm(core).map(|arm| arm.set_remote_force(force)),
        Command::ForceFeedback(settings) => set_feedback(core, &settings),
        Command::VirtualFixture {
            axis,
            upper,
            fixture: wall,
        } => set_wall(core, axis, upper, wall),
        Command::PositionScale { scale } => set_hand_scale(core, scale),
        Command::MasterTelemetry { every } => {
            server.set_hand_telemetry(every);
            Ok(())
        }
    };
    server.answer(request.id, result);
}

fn in_state(core: &Core, allowed: &[State]) -> Done {
    let state = core.safety.state();
    if allowed.contains(&state) {
        Ok(())
    } else {
        Err(Refusal::State(state))
    }
}

/// Refuses while the step motors lock: nothing may be moved.
fn settled(core: &Core) -> Done {
    match &core.machine {
        Some(machine) if machine.is_locking() => Err(Refusal::Input(InputProblem::Settling)),
        _ => Ok(()),
    }
}

/// Checks the staged configuration and makes it the active one.
///
/// The joint positions come from one of three sources, otherwise they are lost:
/// - the presets, as the operator states (`at_preset`);
/// - the presets at power-on plus the counts since then, for the first configuration;
/// - the previous configuration, if both scale the encoders alike.
#[cold]
#[inline(never)]
fn activate(
    core: &mut Core,
    server: &Server,
    inputs: &Inputs,
    length: u16,
    crc: u32,
    at_preset: bool,
) -> Done {
    in_state(core, &[State::Disabled, State::Fault, State::EmergencyStop])?;
    if core.safety.drives_on() {
        return Err(Refusal::State(core.safety.state()));
    }
    let staged = server.staged();
    if staged.len() != usize::from(length) || crc32(staged) != crc {
        return Err(Refusal::ConfigCheck);
    }
    let problem = |field| Refusal::Config(ConfigProblem { field, axis: None });
    // CRC and schema match, so an unreadable part is one that this controller was built without.
    let unreadable = if HAND {
        ConfigField::Encoding
    } else {
        ConfigField::Haptic
    };
    let (config, rest) =
        postcard::take_from_bytes::<Config>(staged).map_err(|_| problem(unreadable))?;
    if !rest.is_empty() {
        return Err(problem(ConfigField::Encoding));
    }
    if config.period_us != core.period_us {
        return Err(problem(ConfigField::Period));
    }
    let standing = core.machine.as_ref().map(Machine::standing);
    let hand = core
        .machine
        .as_ref()
        .and_then(Machine::haptic_encoder_state);
    Machine::install(&mut core.machine, config, crc, inputs).map_err(Refusal::Config)?;
    let first = !core::mem::replace(&mut core.job.configured, true);
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if at_preset || first {
        core.safety.set_homed(false);
        core.job.preset_valid = at_preset || machine.count_from(&core.power_on);
    } else if !standing.is_some_and(|standing| machine.take_over(&standing, inputs)) {
        core.safety.lose_position();
        core.job.preset_valid = false;
    }
    if let (Some(standing), false) = (&hand, at_preset) {
        machine.take_over_haptics(standing);
    }
    Ok(())
}

fn enable(core: &mut Core, inputs: &Inputs) -> Done {
    in_state(core, &[State::Disabled])?;
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if inputs.emergency_stop {
        return Err(Refusal::Input(InputProblem::EmergencyStop));
    }
    match hardware(&inputs.axes[..machine.axes()]) {
        Some(Fault::LimitSwitch { axis }) => {
            return Err(Refusal::Input(InputProblem::LimitSwitch { axis }));
        }
        Some(Fault::Drive { axis }) => {
            return Err(Refusal::Input(InputProblem::Drive { axis }));
        }
        _ => {}
    }
    // Enabling a coasting machine would stop it with the full force of its drives.
    if !machine.is_at_standstill() {
        return Err(Refusal::Input(InputProblem::Coasting));
    }
    let counted = machine.encoders_counted();
    machine.enable().map_err(Refusal::MeasuredPose)?;
    if !counted {
        // The count of illegal transitions is above its limit. Nothing supervised the encoders
        // while the drives were off, and the machine may have been moved by hand.
        core.safety.lose_position();
        core.job.preset_valid = false;
    }
    core.job.saturated = 0;
    core.job.missed = 0;
    core.safety.enter(State::Idle);
    Ok(())
}

fn disable(core: &mut Core) -> Done {
    in_state(core, &[State::Idle, State::Disabled])?;
    core.safety.enter(State::Disabled);
    Ok(())
}

fn home(core: &mut Core) -> Done {
    in_state(core, &[State::Idle])?;
    settled(core)?;
    if !core.job.preset_valid {
        return Err(Refusal::PresetLost);
    }
    core.configured()?.begin_homing();
    core.safety.set_homed(false);
    core.job.stopping = false;
    core.safety.enter(State::Homing);
    Ok(())
}

fn reset(core: &mut Core, inputs: &Inputs) -> Done {
    if inputs.emergency_stop {
        return Err(Refusal::Input(InputProblem::EmergencyStop));
    }
    if core.safety.drives_on()
        && core.safety.state() == State::Fault
        && let Some(machine) = &mut core.machine
    {
        // The tool stays at the compliant displacement. The operator decides how to move it back.
        machine.rebase_on_compliance();
    }
    if let Some(machine) = &mut core.machine
        && let Some(arm) = machine.masters.arm_mut()
    {
        arm.reset();
    }
    core.safety.reset();
    Ok(())
}

fn start_job(core: &mut Core, server: &mut Server, job: u32, pose: &AxisValues) -> Done {
    in_state(core, &[State::Idle])?;
    settled(core)?;
    if !core.safety.homed() || !core.safety.position_kept() {
        return Err(Refusal::NotHomed);
    }
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    let commanded = machine.commanded_values();
    if pose.len() != commanded.len() {
        return Err(Refusal::AxisCount);
    }
    if let Some(axis) = pose
        .iter()
        .zip(&commanded)
        .position(|(said, is)| said != is)
    {
        return Err(Refusal::StartPose { axis: axis as u8 });
    }
    if let Some(force) = &machine.force
        && force.mask() != 0
    {
        // Force control needs a valid, tared force.
        if !force.conditioner().tared() {
            return Err(Refusal::NotTared);
        }
        if let Some(problem) = force.condition() {
            return Err(Refusal::ForceSensor(problem));
        }
    }
    machine.motion.begin_program();
    machine.begin_joint_rates();
    server.begin_job(pose);
    core.job.number = Some(job);
    core.job.stopping = false;
    core.job.saturated = 0;
    core.safety.enter(State::Run);
    Ok(())
}

/// Validates a setpoint as far as the slice budget of this period allows: its pose, then each
/// coordinate, then the joint rates. Enqueues it when it is valid, and decodes the next one if the
/// budget is left. A later period continues what did not fit.
#[inline(never)]
pub(crate) fn enqueue_setpoint(core: &mut Core, server: &mut Server, number: u32, tried: u8) {
    let mut budget = server.budget();
    match validate_setpoint(core, server, number, usize::from(tried), &mut budget) {
        Ok(None) => server.accept_setpoint(budget >= READ),
        Ok(Some(tried)) => server.pass_setpoint(tried),
        Err(refusal) => server.refuse_setpoints(refusal),
    }
}

/// Continues the validation of a setpoint. `tried` is the progress: 0 for none, 1 after the pose
/// check, then 1 more for each coordinate and each piece. Returns the new progress, or `None` when
/// the setpoint is in the queue.
fn validate_setpoint(
    core: &mut Core,
    server: &Server,
    number: u32,
    tried: usize,
    budget: &mut usize,
) -> Result<Option<u8>, Refusal> {
    in_state(core, &[State::Run, State::Hold])?;
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    let setpoint = server.setpoint();
    let expected = machine.motion.program.accepted();
    if number != expected {
        return Err(Refusal::OutOfOrder { expected });
    }
    if tried == 0 {
        machine.can_reach(number, setpoint)?;
        *budget = budget.saturating_sub(POSE);
        if !machine.motion.program.expects(setpoint.periods) {
            *budget = budget.saturating_sub(SPAN);
        }
    }
    let axes = machine.axes();
    let first = tried.saturating_sub(1).min(axes);
    let last = axes.min(first + *budget);
    *budget -= last - first;
    machine.motion.program.allows(setpoint, first..last)?;
    if last < axes {
        return Ok(Some(last as u8 + 1));
    }
    let pieces = machine.pieces(setpoint);
    let mut piece = tried.saturating_sub(axes + 1) as u8;
    while piece < pieces {
        // The last piece ends at the pose that was checked.
        let cost = if piece + 1 == pieces { TAKE } else { PIECE };
        if *budget < cost {
            break;
        }
        *budget -= cost;
        machine.check_piece(number, setpoint, piece, pieces)?;
        piece += 1;
    }
    if piece < pieces || *budget < TAKE {
        return Ok(Some((axes + 1) as u8 + piece));
    }
    *budget -= TAKE;
    machine.motion.program.push_tried(setpoint, axes)?;
    machine.take_end();
    Ok(None)
}

fn end_job(core: &mut Core, count: u32) -> Done {
    in_state(core, &[State::Run, State::Hold])?;
    core.configured()?.motion.program.end(count)
}

fn resume(core: &mut Core) -> Done {
    in_state(core, &[State::Hold, State::Run])?;
    if core.job.stopping {
        return Err(Refusal::State(State::Hold));
    }
    core.configured()?.motion.program.leave_pause();
    core.safety.enter(State::Run);
    Ok(())
}

fn jog(core: &mut Core, epoch: u16, deadline_ms: u16, rates: &AxisValues) -> Done {
    if !core.safety.homed() {
        return Err(Refusal::NotHomed);
    }
    settled(core)?;
    if !(1..=1000).contains(&deadline_ms) {
        return Err(Refusal::Range);
    }
    // Epochs wrap around: one is older when it lies less than half the range behind.
    let age = epoch_age(core, epoch);
    if age > 0 || (age == 0 && core.job.jog_cancelled) {
        return Err(Refusal::OldEpoch);
    }
    let period_us = u32::from(core.period_us);
    let state = core.safety.state();
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if rates.len() != machine.axes() {
        return Err(Refusal::AxisCount);
    }
    let beside_program =
        matches!(state, State::Run | State::Hold) && machine.motion.has_jog_source();
    if core.job.stopping || !(beside_program || matches!(state, State::Idle | State::Jog)) {
        return Err(Refusal::State(state));
    }
    if state == State::Idle {
        machine.motion.begin_jog(true);
        core.safety.enter(State::Jog);
    }
    let mut commanded = [0_i64; MAX_AXES];
    for (index, (slot, rate)) in commanded.iter_mut().zip(rates).enumerate() {
        if !beside_program || machine.motion.source(index) == Source::Jog {
            *slot = i64::from(*rate) << RATE_SHIFT;
        }
    }
    machine
        .motion
        .jog
        .aim(&commanded, u32::from(deadline_ms) * 1000 / period_us);
    core.job.jog_epoch = Some(epoch);
    core.job.jog_cancelled = false;
    Ok(())
}

/// Number of epochs by which this one is older than the newest; negative when it is newer or when
/// there is none yet.
fn epoch_age(core: &Core, epoch: u16) -> i16 {
    core.job
        .jog_epoch
        .map_or(-1, |newest| newest.wrapping_sub(epoch) as i16)
}

fn cancel_jog(core: &mut Core, epoch: u16) -> Done {
    if epoch_age(core, epoch) <= 0 {
        core.job.jog_epoch = Some(epoch);
        core.job.jog_cancelled = true;
        if let Some(machine) = &mut core.machine
            && core.safety.state() != State::Homing
        {
            machine.motion.jog.release();
        }
    }
    Ok(())
}

/// Selects the source of a coordinate.
///
/// A change to or from jog needs standstill; other changes are allowed while the coordinate moves.
/// The command is also accepted while a fault is latched: a broken master would otherwise latch
/// its fault again after each reset.
fn choose_source(core: &mut Core, axis: u8, source: Source) -> Done {
    in_state(core, &[State::Idle, State::Hold, State::Run, State::Fault])?;
    let state = core.safety.state();
    let machine = core.configured()?;
    if usize::from(axis) >= machine.axes() {
        return Err(Refusal::Range);
    }
    let follows = HAND && machine.config.follow.is_some() && usize::from(axis) < LED;
    if source == Source::Master && !follows {
        return Err(Refusal::NoMaster);
    }
    machine.masters.mapping.release_one(usize::from(axis));
    // Without the feature `hand` no source takes over a moving coordinate.
    let jogs =
        !HAND || source == Source::Jog || machine.motion.source(usize::from(axis)) == Source::Jog;
    if jogs && state == State::Run {
        return Err(Refusal::State(state));
    }
    if jogs && state == State::Hold && !machine.motion.is_at_standstill() {
        return Err(Refusal::State(state));
    }
    machine.motion.set_source(usize::from(axis), source);
    Ok(())
}

fn set_override(core: &mut Core, percent: u8) -> Done {
    if !(1..=100).contains(&percent) {
        return Err(Refusal::Range);
    }
    core.configured()?.motion.program.set_override(percent);
    Ok(())
}

fn haptic_arm(core: &mut Core) -> Result<&mut Haptic, Refusal> {
    let machine = core.configured()?;
    machine.masters.arm_mut().ok_or(Refusal::NoMaster)
}

/// Stores a pose of the remote master. Its epochs work as those of jogs.
fn set_remote_master(core: &mut Core, epoch: u16, age_ms: u8, hand: &MasterPose) -> Done {
    if !HAND || core.configured()?.config.follow.is_none() {
        return Err(Refusal::NoMaster);
    }
    let newest = core.job.master_epoch;
    let age = newest.map_or(-1, |newest| newest.wrapping_sub(epoch) as i16);
    if age > 0 || (age == 0 && core.job.master_cancelled) {
        return Err(Refusal::OldEpoch);
    }
    core.job.master_epoch = Some(epoch);
    core.job.master_cancelled = false;
    core.configured()?.set_remote_master(hand, age_ms);
    Ok(())
}

fn set_feedback(core: &mut Core, settings: &ForceFeedback) -> Done {
    let arm = haptic_arm(core)?;
    if !feedback_law::is_sound(settings) {
        return Err(Refusal::Range);
    }
    arm.set_feedback(settings);
    Ok(())
}

fn set_wall(core: &mut Core, axis: u8, upper: bool, wall: Option<VirtualFixture>) -> Done {
    let arm = haptic_arm(core)?;
    let wall = match wall {
        None => None,
        Some(VirtualFixture { at, rate }) => {
            let rate = rate.checked_mul(1 << RATE_SHIFT).ok_or(Refusal::Range)?;
            Some((at.map(Length), Rate(rate)))
        }
    };
    if usize::from(axis) >= COMPONENTS {
        return Err(Refusal::Range);
    }
    arm.set_wall(usize::from(axis), upper, wall)
        .map_err(|_| Refusal::FixturesTooNear)
}

/// Latches master and tool positions anew, so the tool does not jump.
fn set_hand_scale(core: &mut Core, scale: u16) -> Done {
    let machine = core.configured()?;
    if !HAND || machine.config.follow.is_none() {
        return Err(Refusal::NoMaster);
    }
    if !scale_is_sound(scale) {
        return Err(Refusal::Range);
    }
    let frame = machine.hand();
    machine.masters.mapping.set_scale(scale, frame.as_ref());
    Ok(())
}

fn force_control(core: &mut Core) -> Result<&mut ForceControl, Refusal> {
    let machine = core.configured()?;
    machine.force.as_mut().ok_or(Refusal::NoForceSensor)
}

/// Allowed in any state. An axis that leaves force control returns by its admittance law; one that
/// joins starts at its position.
fn set_force_mask(core: &mut Core, mask: u8) -> Done {
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

fn set_force_loop(core: &mut Core, axis: u8, settings: &ForceLoop) -> Done {
    force_control(core)?
        .set(usize::from(axis), &LoopSettings::from(settings))
        .map_err(|refusal| Refusal::Force { axis, refusal })
}

fn report_force_settings(core: &mut Core, axis: u8) -> Done {
    let settings = force_control(core)?.settings(usize::from(axis));
    let settings = settings.map(ForceLoop::from).ok_or(Refusal::Range)?;
    core.safety
        .push_event(Event::ForceSettings { axis, settings });
    Ok(())
}

/// Allowed in Disabled and Idle only: the machine is at rest and the spindle is off. Refused while
/// the tool has a compliant displacement.
fn tare(core: &mut Core) -> Done {
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
