//! `haptimill home`, `status`, `enable`, `disable`, `store`, `move-off`, `stop`, `reset` and
//! `compensation`: one command to a running controller.

use super::args::{BoardArg, ConnectArgs, check_baud};
use super::board::{agree, file_of};
#[cfg(unix)]
use super::requests::STATUS_REQUEST;
use super::status::StatusReport;
use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::board::{Chosen, Need};
use haptimill_client::client::Options;
use haptimill_client::port::{self, DEFAULT_BAUD};
use haptimill_client::session::{self, PortLine, Session};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, Fault, State};

/// Arguments of the simple commands.
#[derive(Debug, Clone, Args)]
pub struct SimpleArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `haptimill stop`.
#[derive(Debug, Clone, Args)]
pub struct StopArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Switch the drives off at once instead of decelerating along the path; latched until
    /// `haptimill reset`
    #[arg(long)]
    pub emergency: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// A simple command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimpleCommand {
    /// Print the status.
    Status,
    /// Switch the drives on.
    Enable,
    /// Switch the drives off.
    Disable,
    /// Clear a latched fault.
    Reset,
    /// Let the board keep the machine file.
    Store,
}

/// Runs a simple command.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: SimpleCommand, args: SimpleArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    let mut session = match open(&args.connect, &chosen.file) {
        // A job of another process has the port: it knows the status.
        Err(error) if error.exit == Exit::Port && command == SimpleCommand::Status => {
            return print_status_of_other(&args).ok_or(error);
        }
        session => session?,
    };
    let need = match command {
        SimpleCommand::Enable => Need::Configuration,
        _ => Need::Nothing,
    };
    if command == SimpleCommand::Store {
        let machine = file_of(&chosen, &mut session)?;
        session.store(&machine)?;
        return print_status(&mut session, args.json);
    }
    agree(&chosen, &mut session, need)?;
    match command {
        SimpleCommand::Status | SimpleCommand::Store => {}
        SimpleCommand::Enable => session.enable()?,
        SimpleCommand::Disable => session.ask(Command::Disable)?,
        SimpleCommand::Reset => session.ask(Command::Reset)?,
    }
    print_status(&mut session, args.json)
}

/// Arguments of `haptimill compensation`.
#[derive(Debug, Clone, Args)]
pub struct CompensationArgs {
    /// Whether the controller compensates
    #[arg(value_name = "STATE", value_parser = ["on", "off"])]
    pub state: String,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simple: SimpleArgs,
}

/// Fades the volumetric compensation in or out, and prints the status.
///
/// # Errors
/// See [`Exit`].
pub fn compensation(args: CompensationArgs) -> Result<(), CliError> {
    let chosen = args.simple.machine.load()?;
    let mut session = open(&args.simple.connect, &chosen.file)?;
    agree(&chosen, &mut session, Need::Configuration)?;
    let on = args.state == "on";
    session.ask(Command::Compensation { on })?;
    if !args.simple.json {
        print_line!(
            "compensation fades {} within a second",
            if on { "in" } else { "out" }
        );
    }
    print_status(&mut session, args.simple.json)
}

/// Arguments of `haptimill home`.
#[derive(Debug, Clone, Args)]
pub struct HomeArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simple: SimpleArgs,
    /// The joints were moved to their presets by hand, drives off: take these as their positions
    /// (after the position was lost)
    #[arg(long)]
    pub at_preset: bool,
    /// Home again although the machine is homed
    #[arg(long)]
    pub again: bool,
}

/// Homes the machine.
///
/// # Errors
/// See [`Exit`].
pub fn home(args: HomeArgs) -> Result<(), CliError> {
    let chosen = args.simple.machine.load()?;
    if chosen.named {
        session::check_has_tool(&chosen.file)?;
    }
    let mut session = open(&args.simple.connect, &chosen.file)?;
    let machine = file_of(&chosen, &mut session)?;
    session::check_has_tool(&machine)?;
    if args.at_preset {
        // Checked before the position is set: afterwards the preset would be set without homing.
        let obstacle = match session.status()?.state {
            State::Disabled => None,
            State::Fault | State::EmergencyStop => Some("a fault is latched; `haptimill reset`"),
            _ => Some("the drives are on; `haptimill disable`"),
        };
        if let Some(obstacle) = obstacle {
            let what = format!(
                "home --at-preset: {obstacle}, move the joints to their presets by hand, then try \
                 again"
            );
            return Err(CliError::new(Exit::Command, what));
        }
        session.configure_at_preset(&machine)?;
    }
    session.enable()?;
    if args.again || !session.status()?.homed {
        let home = session::find_home_pose(&machine, session.model())?;
        session.go_home(&machine, &home)?;
    } else if !args.simple.json {
        print_line!("the machine is homed already; --again homes it again");
    }
    print_status(&mut session, args.simple.json)
}

/// Arguments of `haptimill move-off`.
#[derive(Debug, Clone, Args)]
pub struct MoveOffArgs {
    /// Name of the joint [default: that of the latched fault]
    #[arg(value_name = "JOINT")]
    pub joint: Option<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simple: SimpleArgs,
}

/// Moves a joint off its limit switch.
///
/// # Errors
/// See [`Exit`].
pub fn move_off(args: MoveOffArgs) -> Result<(), CliError> {
    let chosen = args.simple.machine.load()?;
    let mut session = open(&args.simple.connect, &chosen.file)?;
    // The names of the joints are those of the machine file; the fault has the number of its joint.
    let need = match args.joint {
        Some(_) => Need::File,
        None => Need::Configuration,
    };
    agree(&chosen, &mut session, need)?;
    let names = session.model().joint_names();
    let list = names.join(", ");
    let joint = match &args.joint {
        Some(name) => names
            .iter()
            .position(|joint| joint == name)
            .ok_or_else(|| {
                let what = format!("move-off: there is no joint {name:?}; the machine has {list}");
                CliError::new(Exit::Usage, what)
            })? as u8,
        None => match session.status()?.fault {
            Some(Fault::LimitSwitch { joint }) => joint,
            _ => {
                let what = format!(
                    "move-off: no fault of a limit switch is latched; name the joint ({list})"
                );
                return Err(CliError::new(Exit::Usage, what));
            }
        },
    };
    session.move_off(joint)?;
    print_status(&mut session, args.simple.json)
}

/// Stops the machine.
///
/// # Errors
/// See [`Exit`].
pub fn stop(args: StopArgs) -> Result<(), CliError> {
    let machine = MachineFile::built_in()?;
    let mut session = match open(&args.connect, &machine) {
        Err(error) if error.exit == Exit::Port => return stop_out_of_band(&args, &error),
        session => session?,
    };
    if args.emergency {
        session.ask(Command::EmergencyStop)?;
    } else {
        session.stop();
        session.ask(Command::Stop)?;
        // A machine at standstill reports no change of state, so its status is requested.
        while session.is_stopping() {
            session.status()?;
        }
    }
    agree(&Chosen::unnamed(machine), &mut session, Need::Nothing)?;
    print_status(&mut session, args.json)
}

/// Sends the out-of-band stop, which needs no session: another host has the port, or the connection
/// is lost.
fn stop_out_of_band(args: &StopArgs, why: &CliError) -> Result<(), CliError> {
    port::stop_past_lock(&args.connect.port)?;
    if args.emergency {
        // The drives can only be switched off in a session.
        let what = format!(
            "{why}\nan emergency stop needs the port; the stop that decelerates along the path was \
             sent instead"
        );
        return Err(CliError::new(Exit::Port, what));
    }
    if args.json {
        print_line!(
            "{:#}",
            serde_json::json!({ "sent": "stop", "answered": false, "why": why.message })
        );
    } else {
        print_line!(
            "out-of-band stop sent past the host that has the port; the machine decelerates along \
             its path"
        );
    }
    Ok(())
}

/// Opens a session with the controller of a port.
///
/// # Errors
/// The port cannot be opened, or the controller refuses the session.
pub(super) fn open(
    connect: &ConnectArgs,
    machine: &MachineFile,
) -> Result<Session<PortLine>, CliError> {
    check_baud(&connect.port, connect.baud)?;
    let baud = connect.baud.unwrap_or(DEFAULT_BAUD);
    let line = PortLine::opened(&connect.port, baud)?;
    let options = Options {
        connect_us: (connect.timeout * 1e6) as u64,
        ..Options::default()
    };
    let mut session = Session::new(line, machine, options, interrupt::flag());
    session.connect(session::fresh_number())?;
    Ok(session)
}

/// Prints the status of the machine.
pub(super) fn print_status(session: &mut Session<PortLine>, json: bool) -> Result<(), CliError> {
    let status = session.status()?;
    let machine = session.machine_name();
    let configuration = session.configuration_crc();
    let kept = session.kept();
    let report = StatusReport::new(&machine, (configuration, kept), session.model(), &status);
    report.print(json);
    Ok(())
}

/// Prints the status that the process reports which has the port; none without such a process.
#[cfg(unix)]
fn print_status_of_other(args: &SimpleArgs) -> Option<()> {
    let answer = port::ask(&args.connect.port, STATUS_REQUEST).ok()?;
    StatusReport::of_answer(&answer)?.print(args.json);
    Some(())
}

/// Other systems have no requests to another process.
#[cfg(not(unix))]
fn print_status_of_other(_: &SimpleArgs) -> Option<()> {
    None
}
