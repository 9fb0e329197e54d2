//! `haptimill teleop`: teleoperates the machine with force feedback.

mod args;
mod commands;
mod display;
mod master;
mod page;
mod session;

use super::run::results::ResultFolder;
use super::{CliError, Exit};
use args::line_rate;
use haptimill_client::port::{DEFAULT_BAUD, PortSpec};
use haptimill_client::session::{JobLine as _, PortLine, SimLine, fresh_number, rig};
use haptimill_machine_file::MachineFile;
use haptimill_teleop::arm::LinkRates;
use haptimill_teleop::input::{self, Joystick, Keyboard, SpaceMouse, VirtualHandle};
use haptimill_teleop::script::{BUILT_IN, ScriptedOperator};
use haptimill_teleop::{Arm, OperatorLine, Script, TeleopOptions};
use session::{TeleopSession, refuse_own_arm};

pub use args::TeleopArgs;
pub use master::MasterSpec;

/// Approximate bytes of a report of the machine, and of the master.
const MACHINE_REPORT_BYTES: u32 = 170;
const MASTER_REPORT_BYTES: u32 = 85;

/// The recording of the arm's controller.
const MASTER_RECORDING_FILE: &str = "master.hmr";

/// Teleoperates the machine.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: TeleopArgs) -> Result<(), CliError> {
    args.check()?;
    let chosen = args.machine.load()?;
    let machine = load_follower(&args, &chosen.file)?;
    let coordinates = args.followed_coordinates(&machine)?;
    // Mistakes in the arguments of the master are reported before the machine moves.
    let script = match &args.master {
        MasterSpec::Script(None) => Some(Script::parse("examples/teleop.toml", BUILT_IN)?),
        MasterSpec::Script(Some(file)) => Some(Script::load(file)?),
        _ => None,
    };
    let master_chosen = args.load_master()?;
    let master_machine = master_chosen.file.clone();
    Arm::<OperatorLine>::check(&master_machine)?;
    let stock = args.stock.load(&machine)?;
    let port = &args.port;
    let options = TeleopOptions {
        coordinates,
        scale: args.scale,
        every_us: args.report_interval_us(&port.port, port.baud, MACHINE_REPORT_BYTES),
        duration_s: args.duration.or(script.as_ref().map(Script::end_s)),
        spindle_rpm: args.spindle,
        commands: script.as_ref().map(Script::commands).unwrap_or_default(),
        stale_ms: machine
            .config
            .follow
            .as_ref()
            .map_or(u16::MAX, |follow| follow.stale_ms),
        real_time: port.port == PortSpec::Simulator && script.is_none(),
    };
    let session = TeleopSession {
        args: &args,
        machine: &machine,
        chosen: &chosen.completed(machine.clone()),
        stock: stock.as_ref(),
        options: &options,
        dir: &args.out,
    };
    match (&args.master, script) {
        (MasterSpec::Script(_), Some(script)) => run_script(&session, &script, &master_machine),
        (MasterSpec::Port(spec), _) => {
            let baud = args.master_baud;
            let line = PortLine::opened(spec, baud.unwrap_or(DEFAULT_BAUD))?;
            let rates = LinkRates {
                every_us: args.report_interval_us(spec, baud, MASTER_REPORT_BYTES),
                line_rate: line_rate(spec, baud),
            };
            let numbers = Box::new(fresh_number);
            let mut arm = Arm::new(line, &master_machine, Some(master_chosen), rates, numbers)?;
            session.run(&mut arm)
        }
        (MasterSpec::Joystick(path), _) => {
            let device = Joystick::new(input::open(path, "game controller", "js")?, args.speed);
            session.run(&mut VirtualHandle::new(device, &path.display().to_string()))
        }
        (MasterSpec::Mouse3d(path), _) => {
            let device = SpaceMouse::new(input::open(path, "3D mouse", "event")?, args.speed);
            session.run(&mut VirtualHandle::new(device, &path.display().to_string()))
        }
        _ => run_keyboard(&session),
    }
}

/// Machine file of the machine that follows, with its section [follow] and the settings of the
/// command line.
fn load_follower(args: &TeleopArgs, machine: &MachineFile) -> Result<MachineFile, CliError> {
    if machine.is_master() {
        let what = format!(
            "{}: the file describes a haptic arm; --machine is for the machine that follows it, \
             --master-machine for the arm",
            machine.file
        );
        return Err(CliError::new(Exit::BadInput, what));
    }
    refuse_own_arm(machine)?;
    let mut machine = machine.with_follow()?;
    if let Some(follow) = &mut machine.config.follow {
        follow.stale_ms = args.stale.unwrap_or(follow.stale_ms);
        if let Some(delay) = args.delay {
            check_delay(delay, follow.stale_ms)?;
        }
    }
    Ok(machine)
}

/// Refuses a delay that makes every master sample too old.
fn check_delay(delay: u16, stale: u16) -> Result<(), CliError> {
    if delay < stale {
        return Ok(());
    }
    // Twice the delay has a margin for the report interval and for variation of the delay.
    let remedy = match 2 * delay + 20 {
        enough @ ..=1000 => format!("--stale {enough}, or a shorter --delay"),
        _ if delay < 1000 => "--stale 1000, or a shorter --delay".to_string(),
        _ => "a shorter --delay".to_string(),
    };
    let what = format!(
        "--delay {delay}: every master pose is too old when it arrives, because --stale is \
         {stale} ms, and the tool would never move; give {remedy}"
    );
    Err(CliError::new(Exit::Usage, what))
}

/// Runs the simulated arm with an operator model.
fn run_script(
    session: &TeleopSession<'_>,
    script: &Script,
    master_machine: &MachineFile,
) -> Result<(), CliError> {
    let args = session.args;
    let rig = rig(master_machine, None, None, args.master_faults())?;
    let line = OperatorLine::new(SimLine::new(rig), ScriptedOperator::new(script));
    let folder = ResultFolder::open(&args.out)?;
    let rates = LinkRates {
        every_us: 1_000_000 / args.rate,
        line_rate: 0,
    };
    let mut number = 0;
    let numbers = Box::new(move || {
        number += 1;
        number
    });
    let mut arm = Arm::new(line, master_machine, None, rates, numbers)?;
    let ended = session.run_with(&mut arm, &folder, |arm| {
        let recording = session.create_recording(master_machine, MASTER_RECORDING_FILE)?;
        arm.line_mut().begin_recording(recording);
        Ok(())
    })?;
    let recorded = session.finish_recording(arm.line_mut().end_recording())?;
    session.report(ended, Some(recorded))
}

#[cfg(unix)]
fn run_keyboard(session: &TeleopSession<'_>) -> Result<(), CliError> {
    let terminal = input::terminal::Terminal::take()?;
    session.args.print_message(
        "arrows or wasd: x and y, r and f: z, + and -: the step; space holds, g resumes, q ends",
    );
    let keys = Keyboard::new(terminal, session.args.speed);
    session.run(&mut VirtualHandle::new(keys, "the keyboard"))
}

#[cfg(not(unix))]
fn run_keyboard(_: &TeleopSession<'_>) -> Result<(), CliError> {
    let what = "--master keyboard needs a Unix terminal";
    Err(CliError::new(Exit::Usage, what))
}
