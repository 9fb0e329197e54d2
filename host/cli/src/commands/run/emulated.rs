//! A run with the controller on an emulated board.

use super::job::{Job, Work};
use super::{CliError, Exit};
#[cfg(unix)]
use super::{Session, SimLine, paced_options, session};
#[cfg(unix)]
use crate::commands::interrupt;
use haptimill_client::port;

/// Runs a part program with the controller on an emulated board and the machine in the simulator.
#[cfg(unix)]
pub(super) fn run(job: Job<'_>, work: Work, board: port::Board) -> Result<(), CliError> {
    use haptimill_client::session::pil::{self, Instructions};
    use haptimill_hil_sim::remote::RemoteController;
    let (args, machine) = (job.args, job.machine);
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
    let simulator = &args.simulator;
    let faults = simulator.fault.clone();
    let rig = session::rig_around(remote, machine, simulator.seed, args.port.baud, faults)?;
    let line = SimLine::named(rig, &board.to_string());
    let options = paced_options(args.port.baud);
    let mut session = Session::new(line, machine, options, interrupt::flag());
    session.connect(1)?;
    session.configure(machine)?;
    job.run(&mut session, work)?;
    // The board reports its stack and its receive ring when the controller ends.
    drop(session);
    let instructions = Instructions::write_to(&cost, &args.out_dir())?;
    args.print_message(&format!(
        "{board}  {:.0} instructions per control period, at most {:.0}; {} bytes of stack; at most \
         {} bytes in the receive ring; {} to {} setpoints in the queue",
        instructions.mean,
        instructions.worst,
        instructions.stack_bytes,
        instructions.ring_peak,
        instructions.queue_low.unwrap_or(instructions.queue_high),
        instructions.queue_high
    ));
    if instructions.missed > 0 {
        args.print_message(&format!(
            "{board}  {} control periods were missed, because earlier ones exceeded the budget of \
             instructions",
            instructions.missed
        ));
    }
    Ok(())
}

/// Runs a part program with the image of a board on an emulated chip, and the machine at its pins.
#[cfg(unix)]
pub(super) fn run_with_pins(job: Job<'_>, work: Work) -> Result<(), CliError> {
    use haptimill_client::session::pins::PinLine;
    let (args, machine) = (job.args, job.machine);
    let line = PinLine::start(machine, args.image.as_deref(), args.vcd.as_deref())?;
    let mut session = Session::new(line, machine, paced_options(None), interrupt::flag());
    session.connect(1)?;
    session.configure(machine)?;
    let ran = job.run(&mut session, work);
    // The pins are checked after a failed job, too.
    let checked = session.into_line().finish();
    ran?;
    args.print_message(&checked?);
    Ok(())
}

/// Reports that emulated boards need a Unix system.
#[cfg(not(unix))]
pub(super) fn run_with_pins(_: Job<'_>, _: Work) -> Result<(), CliError> {
    let what = "emu:pico2: emulated boards need a Unix system";
    Err(CliError::new(Exit::Usage, what))
}

/// Reports that emulated boards need named pipes.
#[cfg(not(unix))]
pub(super) fn run(_: Job<'_>, _: Work, board: port::Board) -> Result<(), CliError> {
    Err(CliError::new(
        Exit::Usage,
        format!("{board}: emulated boards need a Unix system"),
    ))
}
