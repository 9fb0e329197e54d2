//! `haptimill home`, `status`, `enable`, `disable`, `stop`, `reset`: one command to a running controller.

use super::BoardArg;
use super::{CliError, ConnectArgs, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::board::{Chosen, Need};
use haptimill_client::client::Options;
use haptimill_client::port::{self, DEFAULT_BAUD, PortSpec};
use haptimill_client::session::{self, PortLine, Session};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{AxisValues, Command, State};

/// Arguments of the one-shot commands.
#[derive(Debug, Clone, Args)]
pub struct OneShotArgs {
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
    /// Drives off at once instead of slowing down along the path; latched until `haptimill reset`
    #[arg(long)]
    pub emergency: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Which one-shot command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// How things stand.
    Status,
    /// Drives on.
    Enable,
    /// Drives off.
    Disable,
    /// Clear a latched fault.
    Reset,
}

/// Carries out a one-shot command.
///
/// # Errors
/// See [`Exit`].
pub fn run(order: Order, args: OneShotArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    let mut session = open(&args.connect, &chosen.file)?;
    let need = match order {
        Order::Enable => Need::Configuration,
        _ => Need::Nothing,
    };
    chosen.agree(&mut session, need)?;
    match order {
        Order::Status => {}
        Order::Enable => session.enable()?,
        Order::Disable => session.ask(Command::Disable)?,
        Order::Reset => session.ask(Command::Reset)?,
    }
    report(&mut session, args.json)
}

/// Arguments of `haptimill home`.
#[derive(Debug, Clone, Args)]
pub struct HomeArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub one_shot: OneShotArgs,
    /// The joints have been set up at their presets by hand, drives off: count from there (after the position was lost)
    #[arg(long)]
    pub at_preset: bool,
    /// Search again although the machine is homed
    #[arg(long)]
    pub again: bool,
}

/// Finds the references.
///
/// # Errors
/// See [`Exit`].
pub fn home(args: HomeArgs) -> Result<(), CliError> {
    let chosen = args.one_shot.machine.load()?;
    if chosen.named {
        session::check_has_tool(&chosen.file)?;
    }
    let mut session = open(&args.one_shot.connect, &chosen.file)?;
    let machine = chosen.file_of(&mut session)?;
    session::check_has_tool(&machine)?;
    if args.at_preset {
        // Said before the position is set: afterwards it would be, and the search refused.
        let first = match session.status()?.state {
            State::Disabled => None,
            State::Fault | State::EmergencyStop => Some("a fault is latched; `haptimill reset`"),
            _ => Some("the drives are on; `haptimill disable`"),
        };
        if let Some(first) = first {
            let then = "set the joints up at their presets by hand, then try again";
            return Err(CliError::new(
                Exit::Command,
                format!("home --at-preset: {first}, {then}"),
            ));
        }
        session.configure_at_preset(&machine)?;
    }
    session.enable()?;
    if args.again || !session.status()?.homed {
        let home = session::find_home_pose(&machine, session.model())?;
        session.go_home(&machine, &home)?;
    } else if !args.one_shot.json {
        tell!("it was homed already; --again searches for the references once more");
    }
    report(&mut session, args.one_shot.json)
}

/// Stops.
///
/// # Errors
/// See [`Exit`].
pub fn stop(args: StopArgs) -> Result<(), CliError> {
    let machine = MachineFile::built_in()?;
    let mut session = match open(&args.connect, &machine) {
        Err(error) if error.exit == Exit::Port => return stop_unheard(&args, &error),
        session => session?,
    };
    if args.emergency {
        session.ask(Command::EmergencyStop)?;
    } else {
        session.client_mut().urgent_stop();
        session.ask(Command::Stop)?;
        // A machine that stood already tells of no change: it has to be asked.
        while session.client_mut().urgent().0 {
            session.status()?;
        }
    }
    Chosen::unnamed(machine).agree(&mut session, Need::Nothing)?;
    report(&mut session, args.json)
}

/// Another host has the port, or the link is broken: sends the stop that needs neither session nor frame.
fn stop_unheard(args: &StopArgs, why: &CliError) -> Result<(), CliError> {
    port::stop_past_lock(&args.connect.port)?;
    if args.emergency {
        // The drives can only be switched off in a session; slowing down is the best there is.
        let what = format!(
            "{why}\nthe stop that slows down along the path was sent instead; an emergency stop needs the port"
        );
        return Err(CliError::new(Exit::Port, what));
    }
    if args.json {
        tell!(
            "{:#}",
            serde_json::json!({ "sent": "stop", "heard": false, "why": why.message })
        );
    } else {
        tell!(
            "stop sent past the host that has the port; it sees the machine slow down along its path ({why})"
        );
    }
    Ok(())
}

/// Opens a session with the controller of a port.
///
/// # Errors
/// The port, or the session.
pub(super) fn open(
    connect: &ConnectArgs,
    machine: &MachineFile,
) -> Result<Session<PortLine>, CliError> {
    if let (PortSpec::Tcp(_), Some(baud)) = (&connect.port, connect.baud) {
        let what = format!("--baud {baud} is for a serial port; leave it out with tcp:");
        return Err(CliError::new(Exit::Usage, what));
    }
    let baud = connect.baud.unwrap_or(DEFAULT_BAUD);
    let line = PortLine::new(port::open(&connect.port, baud)?);
    let options = Options {
        connect_us: (connect.timeout * 1e6) as u64,
        ..Options::default()
    };
    let mut session = Session::new(line, machine, options, interrupt::flag());
    session.connect(session::fresh_number())?;
    Ok(session)
}

/// Says how things stand.
pub(super) fn report(session: &mut Session<PortLine>, json: bool) -> Result<(), CliError> {
    let status = session.status()?;
    let machine = session.machine_name();
    let configuration = session.configuration_crc();
    let model = session.model();
    let fault = status.fault.map(|fault| session.describe(&fault));
    let pose = |values: &AxisValues| -> Vec<(String, f64)> {
        let people = model.to_people(values);
        model
            .pose_names()
            .iter()
            .zip(people)
            .take(values.len())
            .map(|(name, value)| ((*name).to_string(), value))
            .collect()
    };
    let joints = |values: &AxisValues| -> Vec<(String, f64)> {
        model
            .joint_names()
            .iter()
            .map(ToString::to_string)
            .zip(model.joints_to_people(values))
            .collect()
    };
    if json {
        let map = |values: Vec<(String, f64)>| serde_json::Value::from_iter(values);
        let value = serde_json::json!({
            "machine": machine,
            "configuration_crc": format!("{configuration:08x}"),
            "state": format!("{:?}", status.state),
            "homed": status.homed,
            "position_kept": status.position_kept,
            "fault": fault,
            "period": status.period,
            "setpoint": status.setpoint,
            "path_rate": f64::from(status.path_rate) / 65_535.0,
            "commanded": map(pose(&status.commanded)),
            "measured": map(pose(&status.measured)),
            "joints": map(joints(&status.joints)),
            "following_error": map(joints(&status.following_error)),
            "bad_frames": status.bad_frames,
            "lost_bytes": status.lost_bytes,
        });
        tell!("{value:#}");
        return Ok(());
    }
    let line = |values: Vec<(String, f64)>| -> String {
        values
            .iter()
            .map(|(name, value)| format!("  {name} {value:.4}"))
            .collect()
    };
    let yes = |flag: bool| if flag { "yes" } else { "no" };
    let name = if machine.is_empty() {
        "no configuration".to_string()
    } else {
        machine
    };
    tell!(
        "{name}: {:?}, homed: {}, position kept: {}",
        status.state,
        yes(status.homed),
        yes(status.position_kept)
    );
    if let Some(fault) = fault {
        tell!("fault     {fault}");
    }
    if status.lost_bytes > 0 {
        tell!(
            "line      the controller lost {} bytes for want of room",
            status.lost_bytes
        );
    }
    if !status.measured.is_empty() {
        tell!("measured{}", line(pose(&status.measured)));
        tell!("commanded  {}", line(pose(&status.commanded)));
        tell!("joints  {}", line(joints(&status.joints)));
    }
    Ok(())
}
