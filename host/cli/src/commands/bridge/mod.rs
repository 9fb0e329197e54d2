//! `haptimill bridge`: existing senders operate the machine in the dialect of their controller.

mod feed;
mod grbl;
mod input;
mod report;

use super::args::{BoardArg, PortArgs, SimulatorArgs, StockArg, check_baud, seconds};
use super::board::file_of;
use super::real_time_sim::RealTimeSim;
use super::{CliError, Exit};
use crate::commands::interrupt;
use crate::commands::requests::Requests;
use clap::{Args, Subcommand};
use haptimill_client::client::Options;
use haptimill_client::port::{MAX_UNREAD, PortSpec, PtyServer, Transport};
use haptimill_client::session::{self, Line, PortLine, Session, check_has_tool, find_home_pose};
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::work_data::WorkData;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

const LONG: &str = "\
Present the machine as a Grbl 1.1h controller on a pseudo-terminal, so that existing senders \
operate it: banner, ?, $$, $#, $G, $I, $H, $X, $J=, !, ~, Ctrl-X, jog cancel, overrides.

The first line on standard output is the path of the pseudo-terminal; --link makes a symbolic link \
to it. Open it with any baud rate. Blocks are those of docs/gcode.md. A refused block is answered \
with an error number after a [MSG:...] that names the cause. G38 and M66 are refused.

Jog buttons of a sender that sends $J= with a distance move that distance: there is no jog \
timeout. Ctrl-C stops the machine and ends the command.";

/// Bridges.
#[derive(Debug, Clone, Subcommand)]
#[command(about = "Present the machine as a Grbl controller to programs that send G-code to Grbl")]
pub enum BridgeCommand {
    /// Present the machine as a Grbl 1.1h controller on a pseudo-terminal
    Grbl(GrblArgs),
}

/// Arguments of `haptimill bridge grbl`.
#[derive(Debug, Clone, Args)]
#[command(long_about = LONG)]
pub struct GrblArgs {
    /// Symbolic link to the pseudo-terminal, for the settings of a sender
    #[arg(long, value_name = "PTY")]
    pub link: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub port: PortArgs,
    /// Time to wait for the first answer of the controller
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = seconds)]
    pub timeout: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stock: StockArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simulator: SimulatorArgs,
}

/// Runs a bridge.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: BridgeCommand) -> Result<(), CliError> {
    let BridgeCommand::Grbl(args) = command;
    let (mut session, machine, stock) = open(&args)?;
    check_has_tool(&machine)?;
    find_home_pose(&machine, session.model())?;
    let data = WorkData::beside(&machine).map_err(|error| CliError::new(Exit::BadInput, error))?;
    let mut pty = PtyServer::open()?;
    let link = args.link.as_deref().map(|path| Link::new(pty.name(), path));
    let _link = link.transpose()?;
    // Rotors move when their drives are switched on, so this comes last.
    session.enable()?;
    let mut bridge = grbl::Bridge::new(session, machine, stock, data)?;
    match Requests::listen(&args.port.port) {
        Ok(requests) => bridge.requests = requests,
        // The bridge works without them.
        Err(error) => eprintln!("{error}"),
    }
    let mut out = std::io::stdout();
    writeln!(out, "{}", pty.name())
        .and_then(|()| out.flush())
        .map_err(|error| CliError::new(Exit::Output, error))?;
    let mut buffer = [0; 4096];
    let mut answers = Vec::new();
    let mut has_sender = false;
    loop {
        let count = pty.read(&mut buffer, Duration::ZERO)?;
        has_sender |= count > 0;
        if let Some(ended) = bridge.advance(&buffer[..count], &mut answers)? {
            return Err(CliError::new(Exit::Stopped, ended));
        }
        if !has_sender {
            // A pseudo-terminal would keep these bytes for the first sender.
            answers.clear();
        }
        let sent = pty.write(&answers, Duration::ZERO)?;
        answers.drain(..sent);
        if answers.len() > MAX_UNREAD {
            answers.clear();
        }
    }
}

/// A session, the machine on it, and the stock of a simulated one.
type Opened = (Session<Box<dyn Line>>, MachineFile, Option<CuttingConfig>);

fn open(args: &GrblArgs) -> Result<Opened, CliError> {
    let chosen = args.machine.load()?;
    let mut stock = None;
    let port = &args.port.port;
    let is_simulated = *port == PortSpec::Simulator;
    let line: Box<dyn Line> = match port {
        PortSpec::Simulator => {
            stock = args.stock.load(&chosen.file)?;
            let faults = args.simulator.fault.clone();
            Box::new(RealTimeSim::new(
                &chosen.file,
                args.simulator.seed,
                faults,
                None,
            )?)
        }
        PortSpec::Emulated(_) | PortSpec::EmulatedPins => {
            let what = format!(
                "{port}: an emulated controller is slower than real time; use --port sim, or a \
                 machine"
            );
            return Err(CliError::new(Exit::Usage, what));
        }
        PortSpec::Tcp(_) | PortSpec::Serial(_) => {
            args.stock.check_unused()?;
            args.simulator.check_unused()?;
            check_baud(port, args.port.baud)?;
            Box::new(PortLine::opened(port, args.port.baud_or_default())?)
        }
    };
    let options = Options {
        connect_us: (args.timeout * 1e6) as u64,
        ..Options::default()
    };
    let mut session = Session::new(line, &chosen.file, options, interrupt::flag());
    session.connect(session::fresh_number())?;
    if is_simulated {
        session.configure(&chosen.file)?;
        return Ok((session, chosen.file, stock));
    }
    let machine = file_of(&chosen, &mut session)?;
    Ok((session, machine, stock))
}

/// A symbolic link that is removed at the end.
struct Link(PathBuf);

impl Link {
    fn new(target: &str, path: &Path) -> Result<Self, CliError> {
        // A link of a bridge that was killed points to a pseudo-terminal that is gone or another's.
        if path.is_symlink()
            && path
                .read_link()
                .is_ok_and(|old| old.starts_with("/dev/pts"))
        {
            let _ = std::fs::remove_file(path);
        }
        std::os::unix::fs::symlink(target, path).map_err(|error| {
            let path = path.display();
            let what = format!("--link {path}: {error}; use another path, or remove the file");
            CliError::new(Exit::Output, what)
        })?;
        Ok(Self(path.to_path_buf()))
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
