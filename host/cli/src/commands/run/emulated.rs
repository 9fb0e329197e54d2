//! A run whose controller is on an emulated board.

use super::folder::Folder;
use super::{CliError, Exit, MachineFile, RunArgs, port};
#[cfg(unix)]
use super::{Running, Session, SimLine, paced, say, session};
#[cfg(unix)]
use crate::commands::interrupt;
use crate::commands::part::{PartProgram, Planned};
use haptimill_protocol::message::AxisValues;

/// Runs a part program on an emulated board, with the simulated machine around it.
#[cfg(unix)]
pub(super) fn emulated(
    args: &RunArgs,
    machine: &MachineFile,
    job: &PartProgram,
    home: AxisValues,
    planned: Planned,
    folder: Folder,
    board: port::Board,
) -> Result<(), CliError> {
    use haptimill_client::session::pil::{self, Instructions};
    use haptimill_hil_sim::remote::RemoteController;
    let setup = pil::EmulatorOptions {
        arguments: args.image_word.clone(),
        log: args.log.clone(),
    };
    let image = match &args.image {
        Some(image) => image.clone(),
        None => pil::image_for(board, machine)?,
    };
    let emulator = pil::Emulator::start_with(board, &image, &setup)?;
    let period_us = machine.config.period_us;
    let mut remote = RemoteController::begin(emulator, period_us)
        .map_err(|reason| CliError::new(Exit::Port, format!("{board}: {reason}")))?;
    let budget = args.budget.unwrap_or_else(|| pil::budget(period_us));
    remote.set_budget(pil::counts(budget));
    let cost = remote.cost();
    let rig = session::rig_around(remote, machine, args.seed, args.baud, args.fault.clone())?;
    let line = SimLine::named(rig, &board.to_string());
    let work = args.clamped(machine)?;
    let mut session = Session::new(line, machine, paced(args.baud), interrupt::flag());
    session.connect(1)?;
    session.configure(machine)?;
    Running {
        args,
        machine,
        job,
        home,
        work,
        folder,
    }
    .carry_out(session, planned)?;
    let instructions = Instructions::write_to(&cost, &args.out_dir())?;
    say(
        args,
        &format!(
            "{board}  {:.0} instructions a control period, at most {:.0}; {} bytes of stack; at most {} bytes in the receive ring; {} to {} setpoints \
             in the queue",
            instructions.mean,
            instructions.worst,
            instructions.stack_bytes,
            instructions.ring_peak,
            instructions.queue_low.unwrap_or(instructions.queue_high),
            instructions.queue_high
        ),
    );
    if instructions.missed > 0 {
        say(
            args,
            &format!(
                "{board}  {} control periods were missed: one before took more instructions than there are in a period",
                instructions.missed
            ),
        );
    }
    Ok(())
}

/// Emulated boards need named pipes.
#[cfg(not(unix))]
pub(super) fn emulated(
    _: &RunArgs,
    _: &MachineFile,
    _: &PartProgram,
    _: AxisValues,
    _: Planned,
    _: Folder,
    board: port::Board,
) -> Result<(), CliError> {
    Err(CliError::new(
        Exit::Usage,
        format!("{board}: emulated boards need a Unix system"),
    ))
}
