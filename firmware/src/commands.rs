//! Command stage: executes one request or setpoint per period. A refused command changes nothing.

mod conditions;
mod force;
mod haptics;
mod motion;
mod named_io;
mod setpoint;
mod store;

use conditions::{Done, in_state, settled};
pub(crate) use setpoint::enqueue_setpoint;
pub(crate) use store::{follow as follow_store, restore};

use crate::comm::server::Server;
use crate::comm::telemetry::Stream;
use crate::config::Config;
use crate::config::HAPTICS;
use crate::core::Core;
use crate::faults::hardware;
use crate::io::Inputs;
use crate::machine::Machine;
use crate::named_io::Probing;
use haptimill_protocol::frame::crc32;
use haptimill_protocol::message::{
    AxisValues, Command, ConfigField, ConfigProblem, Fault, InputProblem, Refusal, State,
};

/// Executes the received request and answers it.
pub(crate) fn execute(core: &mut Core, server: &mut Server, inputs: &Inputs) {
    let request = server.take_request();
    let result = match request.command {
        Command::Home
        | Command::JobStart { .. }
        | Command::Resume
        | Command::Jog { .. }
        | Command::MoveOff { .. }
            if core.job.stale_commands =>
        {
            Err(Refusal::RecentStop)
        }
        // The server takes batches apart, one setpoint a period.
        Command::Setpoints(_) | Command::Ping => Ok(()),
        Command::Configure(chunk) => server.stage(&chunk),
        Command::Activate {
            length,
            crc,
            at_preset,
        } => activate(core, server, inputs, length, crc, at_preset),
        Command::Store { length, crc } => {
            match store::store(core, server, inputs, request.id, (length, crc)) {
                // The answer follows when it is kept.
                Ok(()) => return,
                refused => refused,
            }
        }
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
            timeout_ms,
            rates,
        } => motion::jog(core, epoch, timeout_ms, &rates),
        Command::JogCancel { epoch } => motion::cancel_jog(core, epoch),
        Command::Source { coordinate, source } => motion::choose_source(core, coordinate, source),
        Command::Override { percent } => motion::set_override(core, percent),
        Command::RapidOverride { percent } => motion::set_rapid_override(core, percent),
        Command::SpindleOverride { percent } => motion::set_spindle_override(core, percent),
        Command::Telemetry { every } => {
            server.streams().set(Stream::Machine, every);
            Ok(())
        }
        Command::Status => {
            server.streams().request();
            Ok(())
        }
        Command::ForceMask { mask } => force::set_force_mask(core, mask),
        Command::ForceLoop { axis, settings } => force::set_force_loop(core, axis, &settings),
        Command::ForceSettings { axis } => force::report_force_settings(core, axis),
        Command::Tare => force::tare(core),
        Command::MasterPose {
            epoch,
            age_ms,
            pose: master,
        } => haptics::set_remote_master(core, epoch, age_ms, &master),
        Command::RemoteForce { force } => {
            haptics::haptic_arm(core).map(|arm| arm.set_remote_force(force))
        }
        Command::ForceFeedback(settings) => haptics::set_feedback(core, &settings),
        Command::VirtualFixture {
            axis,
            upper,
            fixture,
        } => haptics::set_fixture(core, axis, upper, fixture),
        Command::PositionScale { scale } => haptics::set_position_scale(core, scale),
        Command::MasterTelemetry { every } => {
            server.streams().set(Stream::Haptic, every);
            Ok(())
        }
        Command::SetOutput { output, on } => named_io::set_output(core, output, on),
        Command::SetAnalogOutput { output, code } => {
            named_io::set_analog_output(core, output, code)
        }
        Command::Compensation { on } => set_compensation(core, on),
        Command::MoveOff { joint } => move_off(core, joint, inputs),
        Command::ArmProbe { input, active } => {
            named_io::arm_probe(core, Probing { input, active }, inputs)
        }
    };
    server.answer(request.id, result);
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
    store::not_storing(core)?;
    let staged = server.staged();
    if staged.len() != usize::from(length) || crc32(staged) != crc {
        return Err(Refusal::ConfigCheck);
    }
    install(core, staged, crc, inputs, at_preset)
}

/// Makes a configuration the active one.
#[cold]
#[inline(never)]
fn install(core: &mut Core, staged: &[u8], crc: u32, inputs: &Inputs, at_preset: bool) -> Done {
    let mut config = None;
    decode(staged, &mut config)?;
    let config = config.as_ref().ok_or(Refusal::ConfigCheck)?;
    if config.period_us != core.period_us {
        return Err(Refusal::Config(ConfigProblem {
            field: ConfigField::Period,
            index: None,
        }));
    }
    let positions = core.machine.as_ref().map(Machine::positions);
    let master = core
        .machine
        .as_ref()
        .and_then(Machine::haptic_encoder_state);
    Machine::install(&mut core.machine, config, crc, inputs).map_err(Refusal::Config)?;
    let first = !core::mem::replace(&mut core.job.configured, true);
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    let open_loop = machine.open_loop() != 0;
    core.safety
        .set_open_loop(open_loop, machine.loses_position_without_drives());
    if at_preset || first {
        core.safety.set_homed(false);
        core.job.preset_valid = at_preset || machine.count_from(&core.power_on);
    } else if !positions.is_some_and(|positions| machine.take_over(&positions, inputs)) {
        core.safety.lose_position();
        core.job.preset_valid = false;
    }
    if let (Some(positions), false) = (&master, at_preset) {
        machine.take_over_haptics(positions);
    }
    #[cfg(feature = "defmt")]
    defmt::info!("configuration {=u32:08x}: {}", crc, config.name.as_str());
    Ok(())
}

/// Decodes a configuration into `decoded`. A function of its own that does not return the
/// configuration keeps copies of it off the stack while the machine is built.
#[inline(never)]
fn decode(staged: &[u8], decoded: &mut Option<Config>) -> Done {
    let problem = |field| Refusal::Config(ConfigProblem { field, index: None });
    // CRC and schema match, so an unreadable part is one that this controller was built without.
    let unreadable = if HAPTICS {
        ConfigField::Encoding
    } else {
        ConfigField::Haptic
    };
    let (config, rest) =
        postcard::take_from_bytes::<Config>(staged).map_err(|_| problem(unreadable))?;
    if !rest.is_empty() {
        return Err(problem(ConfigField::Encoding));
    }
    *decoded = Some(config);
    Ok(())
}

fn enable(core: &mut Core, inputs: &Inputs) -> Done {
    in_state(core, &[State::Disabled])?;
    store::not_storing(core)?;
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if inputs.emergency_stop {
        return Err(Refusal::Input(InputProblem::EmergencyStop));
    }
    match hardware(machine, inputs, core.safety.homed()) {
        Some(Fault::LimitSwitch { joint }) => {
            return Err(Refusal::Input(InputProblem::LimitSwitch { joint }));
        }
        Some(Fault::Drive { joint, alarm }) => {
            return Err(Refusal::Input(InputProblem::Drive { joint, alarm }));
        }
        _ => {}
    }
    // Enabling a coasting machine would stop it with the full force of its drives.
    if !machine.is_at_standstill() {
        return Err(Refusal::Input(InputProblem::Coasting));
    }
    if !core.safety.homed() {
        machine.forget_joints(inputs);
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
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if machine.needs_presets() && !core.job.preset_valid {
        return Err(Refusal::PresetLost);
    }
    machine.check_inputs(false)?;
    machine.begin_homing(core.safety.homed());
    core.safety.set_homed(false);
    core.job.stopping = false;
    core.safety.enter(State::Homing);
    Ok(())
}

/// Moves a joint off its limit switch. The drives stay on afterwards where no limit switch is
/// active.
#[cold]
#[inline(never)]
fn move_off(core: &mut Core, joint: u8, inputs: &Inputs) -> Done {
    in_state(core, &[State::Disabled])?;
    store::not_storing(core)?;
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if inputs.emergency_stop {
        return Err(Refusal::Input(InputProblem::EmergencyStop));
    }
    machine.check_inputs(false)?;
    let counted = machine.encoders_counted();
    machine.begin_move_off(joint, inputs)?;
    core.safety.lose_position();
    core.job.preset_valid &= counted;
    core.job.saturated = 0;
    core.job.missed = 0;
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
    if !core.safety.homed() {
        return Err(Refusal::NotHomed);
    }
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    machine.check_inputs(true)?;
    let commanded = machine.commanded_values();
    if pose.len() != commanded.len() {
        return Err(Refusal::CoordinateCount);
    }
    if let Some(coordinate) = pose
        .iter()
        .zip(&commanded)
        .position(|(stated, actual)| stated != actual)
    {
        return Err(Refusal::StartPose {
            coordinate: coordinate as u8,
        });
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
    core.job.spindle_stopped = false;
    core.job.saturated = 0;
    core.safety.enter(State::Run);
    Ok(())
}

fn set_compensation(core: &mut Core, on: bool) -> Done {
    let machine = core.configured()?;
    let compensation = machine.compensation.as_mut();
    compensation.ok_or(Refusal::NoErrorTables)?.request(on);
    Ok(())
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
    let run_up = {
        let machine = core.configured()?;
        machine.check_inputs(true)?;
        machine.run_up_periods()
    };
    if core.job.resume_wait != 0 {
        return Ok(());
    }
    let restarts = core::mem::take(&mut core.job.spindle_stopped) && core.job.spindle_rpm != 0;
    if restarts && run_up != 0 {
        core.job.resume_wait = run_up;
        return Ok(());
    }
    core.configured()?.motion.program.leave_pause();
    core.safety.enter(State::Run);
    Ok(())
}
