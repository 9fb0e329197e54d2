//! `haptimill sim serve`: serves the simulated machine in real time on a pseudo-terminal or TCP
//! port.

use super::args::{MachineArg, OperatorArg, SimulatorArgs, StockArg, seconds};
use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::Error;
use haptimill_client::port::{TcpServer, Token, Transport};
use haptimill_client::session;
use haptimill_hil_sim::rig::{Control, Rig};
use haptimill_machine_file::input;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{AxisValues, State};
use haptimill_teleop::script::ScriptedOperator;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

const LONG: &str = "\
Serve the simulated machine in real time.

The first line on standard output is the path of the pseudo-terminal, or the address of the TCP \
port. Give it to another `haptimill` as --port. One host is served at a time. Ctrl-C ends the \
command. The board is configured as the machine that is served. A stock (--stock) is clamped when \
the machine is at its home pose for the first time.

An address that other computers can reach (any but 127.0.0.1 and ::1) requires a token, which is \
the second line; hosts give it with --token or in HAPTIMILL_TOKEN. The connection is not encrypted: \
use ssh -L on an untrusted network. A connection that sends nothing within 2 s is closed. A host that \
sends nothing for 2 s can be replaced by another one, and is closed after 30 s.";

/// Arguments of `haptimill sim serve`.
#[derive(Debug, Clone, Args)]
#[command(about = "Serve the simulated machine in real time", long_about = LONG, after_long_help = super::run::faults_help(),
          after_help = "`haptimill sim serve --help` has details and lists the faults.")]
pub struct ServeArgs {
    /// Where to listen: pty (a pseudo-terminal) or tcp:HOST:PORT (port 0 takes a free one)
    #[arg(long, value_name = "WHERE", default_value = "pty")]
    pub listen: Listen,
    /// File with the token of the TCP port [default: a new token for an address that other
    /// computers can reach]
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Also create a symbolic link with this path to the pseudo-terminal
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simulator: SimulatorArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub operator: OperatorArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stock: StockArg,
    /// Start the board without a configuration; the first command needs --machine
    #[arg(long)]
    pub unconfigured: bool,
    /// End after this time
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
}

/// Where the simulator listens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    /// A pseudo-terminal.
    Pty,
    /// A TCP port, `HOST:PORT`.
    Tcp(String),
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("tcp:") {
            _ if text == "pty" => Ok(Self::Pty),
            Some(address) if address.contains(':') => Ok(Self::Tcp(address.to_string())),
            _ => Err("write pty or tcp:HOST:PORT".to_string()),
        }
    }
}

/// Serves the simulated machine.
///
/// # Errors
/// See [`Exit`].
pub fn serve(args: ServeArgs) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    let script = args.operator.load(&machine)?;
    let mut stock = args.stock.load(&machine)?;
    let home = Model::new(&machine).home(&machine);
    let mut operator = script.as_ref().map(ScriptedOperator::new);
    // The port limits the byte rate, so the simulated line in between has no rate limit.
    let faults = args.simulator.fault.clone();
    let mut rig = session::rig(&machine, args.simulator.seed, None, faults)?;
    if !args.unconfigured {
        rig = session::commissioned(rig, &machine).unwrap_or_else(|(rig, error)| {
            eprintln!("the board is not configured: {error}");
            rig
        });
    }
    let interrupted = interrupt::flag();
    let (mut port, link, token) = listen(&args)?;
    let output = |error: std::io::Error| CliError::new(Exit::Output, error);
    let mut out = std::io::stdout();
    writeln!(out, "{}", port.name())
        .and_then(|()| match &token {
            Some(token) => writeln!(out, "token {}", token.reveal()),
            None => Ok(()),
        })
        .and_then(|()| out.flush())
        .map_err(output)?;
    let start = Instant::now();
    let mut time_sync = TimeSync::new(u64::from(machine.config.period_us) * 1000);
    let mut buffer = [0; 4096];
    let mut outgoing = Vec::new();
    let mut has_host = false;
    while !interrupted.load(Ordering::Relaxed)
        && args
            .duration
            .is_none_or(|limit| start.elapsed().as_secs_f64() < limit)
    {
        let now_ns = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        for _ in 0..time_sync.due(now_ns, rig.time_ns()) {
            if let Some(operator) = &mut operator {
                operator.act(&mut rig);
            }
            rig.step();
        }
        // The stock is clamped at the present place of the tool, so the tool must be at its home.
        if stock.is_some()
            && is_home(&rig, home.as_ref())
            && let Some(stock) = stock.take()
        {
            session::clamp(&mut rig, &stock)?;
            eprintln!("the stock is clamped on the simulated table");
        }
        rig.host_read(&mut outgoing);
        if !has_host {
            // A pseudo-terminal would buffer these bytes for the first host.
            outgoing.clear();
        }
        if !outgoing.is_empty() {
            let sent = port.write(&outgoing, Duration::ZERO)?;
            outgoing.drain(..sent);
            // A host that does not read loses the oldest bytes; its link requests them again.
            if outgoing.len() > MAX_UNREAD_BYTES {
                outgoing.clear();
            }
        }
        let count = port.read(&mut buffer, POLL)?;
        has_host |= count > 0;
        rig.host_write(&buffer[..count]);
    }
    drop(link);
    Ok(())
}

/// Whether the machine stands at its home pose after homing.
fn is_home<C: Control>(rig: &Rig<C>, home: Option<&AxisValues>) -> bool {
    let Some(snapshot) = rig.control().snapshot(rig.inputs()) else {
        return false;
    };
    let stands = snapshot.homed && snapshot.state == State::Idle;
    stands && home.is_some_and(|home| home.iter().eq(snapshot.commanded.iter().take(home.len())))
}

/// Longest wait for bytes between two readings of the clock.
const POLL: Duration = Duration::from_micros(200);

/// Largest lag of virtual time behind real time that is caught up at once.
///
/// After a delay of this process the bytes of the host still wait in the port. A machine that
/// simulated the whole delay before it reads them would have a heartbeat timeout.
const MAX_LAG: Duration = Duration::from_millis(20);

/// Synchronises virtual time with real time.
pub(crate) struct TimeSync {
    period_ns: u64,
    /// Real time that virtual time does not catch up.
    skipped_ns: u64,
}

impl TimeSync {
    pub(crate) const fn new(period_ns: u64) -> Self {
        Self {
            period_ns,
            skipped_ns: 0,
        }
    }

    /// Number of control periods to simulate now. A lag above `MAX_LAG` is skipped.
    pub(crate) fn due(&mut self, real_ns: u64, virtual_ns: u64) -> u64 {
        let lag = real_ns.saturating_sub(virtual_ns.saturating_add(self.skipped_ns));
        let limit = MAX_LAG.as_nanos() as u64;
        let lag = if lag > limit {
            self.skipped_ns += lag - limit;
            limit
        } else {
            lag
        };
        lag / self.period_ns.max(1)
    }
}

/// Largest number of bytes kept for a host that does not read.
const MAX_UNREAD_BYTES: usize = 1 << 16;

/// A symbolic link that is removed at the end of the command.
struct Link(PathBuf);

impl Drop for Link {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// The token of a port, and whether it is new: an address that other computers can reach requires
/// one.
pub(crate) fn token_of(
    given: Option<Token>,
    is_local: bool,
) -> Result<(Option<Token>, bool), CliError> {
    match given {
        Some(token) => Ok((Some(token), false)),
        None if is_local => Ok((None, false)),
        None => {
            let token = Token::random();
            let token = token.map_err(|error| CliError::new(Exit::Internal, error))?;
            Ok((Some(token), true))
        }
    }
}

/// Reads a token from the first line of a file.
pub(super) fn read_token(path: &Path) -> Result<Token, CliError> {
    let bad = |what: &dyn std::fmt::Display| CliError::from(Error::in_file(path.display(), what));
    let bytes = input::read(path, input::SETTINGS_BYTES).map_err(|error| bad(&error))?;
    let text = String::from_utf8_lossy(&bytes);
    let line = text.lines().next().unwrap_or_default();
    line.trim().parse().map_err(|what: String| bad(&what))
}

/// A served port: its transport, its symbolic link, and a new token.
type Served = (Box<dyn Transport>, Option<Link>, Option<Token>);

fn listen(args: &ServeArgs) -> Result<Served, CliError> {
    if args.token_file.is_some() && args.listen == Listen::Pty {
        let what = "--token-file is for a TCP port; leave it out with pty";
        return Err(CliError::new(Exit::Usage, what));
    }
    match &args.listen {
        Listen::Tcp(address) => {
            if args.link.is_some() {
                return Err(CliError::new(
                    Exit::Usage,
                    "--link is for a pseudo-terminal; leave it out with tcp:",
                ));
            }
            let token = args.token_file.as_deref().map(read_token).transpose()?;
            let port = TcpServer::listen(address)?;
            let local = port.address().is_ok_and(|at| at.ip().is_loopback());
            let (token, new) = token_of(token, local)?;
            let Some(token) = token else {
                return Ok((Box::new(port), None, None));
            };
            let port = Box::new(port.with_token(&token));
            Ok((port, None, new.then_some(token)))
        }
        #[cfg(unix)]
        Listen::Pty => {
            let port = haptimill_client::port::PtyServer::open()?;
            let link = match &args.link {
                Some(path) => {
                    std::os::unix::fs::symlink(port.name(), path).map_err(|error| {
                        CliError::new(
                            Exit::Output,
                            format!(
                                "{}: {error}; use another path, or remove the file",
                                path.display()
                            ),
                        )
                    })?;
                    Some(Link(path.clone()))
                }
                None => None,
            };
            Ok((Box::new(port), link, None))
        }
        #[cfg(not(unix))]
        Listen::Pty => Err(CliError::new(
            Exit::Usage,
            "this system has no pseudo-terminals; use --listen tcp:HOST:PORT",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn virtual_time_follows_real_time_and_skips_long_delays() {
        let mut time_sync = TimeSync::new(200_000);
        let mut virtual_ns = 0;
        let mut step = |real_ns: u64| {
            let periods = time_sync.due(real_ns, virtual_ns);
            virtual_ns += periods * 200_000;
            (periods, virtual_ns)
        };
        // Short steps: synchronous to the period.
        for real_us in (0..100_000).step_by(130) {
            let (periods, virtual_ns) = step(real_us * 1000);
            assert!(periods <= 1);
            assert_eq!(virtual_ns / 200_000, real_us / 200);
        }
        // A short delay is caught up at once.
        assert_eq!(step(115 * MS).1, 115 * MS);
        // A delay of three seconds, longer than any heartbeat: the machine simulates 20 ms.
        let before = step(115 * MS).1;
        let (periods, after) = step(3_115 * MS);
        assert_eq!((periods, after - before), (100, 20 * MS));
        assert_eq!(step(3_115 * MS).0, 0);
        // Virtual time then follows real time again.
        assert_eq!(step(3_125 * MS).1, after + 10 * MS);
    }
}
