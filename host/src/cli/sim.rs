//! `haptimill sim serve`: the simulated machine as a device that any serial program can talk to, in real time.

use super::{CliError, Exit, MachineArg};
use crate::port::{TcpServer, Transport};
use crate::session::{self, interrupt};
use clap::Args;
use haptimill_hil_sim::fault::Fault;
use std::io::Write;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

const LONG: &str = "\
Serve the simulated machine in real time.

On a pseudo-terminal the path is the first line on standard output; on a TCP port the address is. Give it to another `haptimill` as --port. One \
host is served at a time. Ctrl-C ends it.";

/// Arguments of `haptimill sim serve`.
#[derive(Debug, Clone, Args)]
#[command(about = "Serve the simulated machine in real time", long_about = LONG)]
pub struct ServeArgs {
    /// Where: pty (a pseudo-terminal, its path is printed) or tcp:HOST:PORT (port 0 takes a free one)
    #[arg(long, value_name = "WHERE", default_value = "pty")]
    pub listen: Listen,
    /// Also make a symbolic link with this path to the pseudo-terminal
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Seed of the simulated machine, instead of the one in the machine file
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Something that goes wrong in the machine, as "slide-jammed axis=2 at=1.5s"; can be given several times
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<Fault>,
    /// End after so many seconds
    #[arg(long = "for", value_name = "SECONDS", value_parser = super::seconds)]
    pub duration: Option<f64>,
}

/// Where a simulator is served.
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
    // A port paces its bytes by itself; the simulated line in between adds nothing.
    let mut rig = session::rig(&machine, args.seed, None, args.fault.clone())?;
    let interrupted = interrupt::flag();
    let (mut port, link) = listen(&args)?;
    let output = |error: std::io::Error| CliError::new(Exit::Output, error);
    let mut out = std::io::stdout();
    writeln!(out, "{}", port.name())
        .and_then(|()| out.flush())
        .map_err(output)?;
    let begun = Instant::now();
    let mut buffer = [0; 4096];
    let mut said = Vec::new();
    while !interrupted.load(Ordering::Relaxed)
        && args
            .duration
            .is_none_or(|limit| begun.elapsed().as_secs_f64() < limit)
    {
        // Virtual time follows real time, and after a pause of this process it does not race to catch up.
        let now_ns = begun.elapsed().as_nanos() as u64;
        let mut behind = 0;
        while rig.time_ns() + u64::from(machine.config.period_us) * 1000 <= now_ns
            && behind < MOST_PERIODS
        {
            rig.step();
            behind += 1;
        }
        rig.host_read(&mut said);
        if !said.is_empty() {
            let taken = port.write(&said, Duration::ZERO)?;
            said.drain(..taken);
            // A host that does not read loses what is old; its link asks for it again.
            if said.len() > MOST_UNREAD {
                said.clear();
            }
        }
        let count = port.read(&mut buffer, POLL)?;
        rig.host_write(&buffer[..count]);
    }
    drop(link);
    Ok(())
}

/// Longest wait for bytes between two looks at the clock.
const POLL: Duration = Duration::from_micros(200);

/// Periods that are made up for at once when this process was held up.
const MOST_PERIODS: u32 = 5000;

/// Bytes that wait for a host that does not read.
const MOST_UNREAD: usize = 1 << 16;

/// A symbolic link that goes when the simulator goes.
struct Link(PathBuf);

impl Drop for Link {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn listen(args: &ServeArgs) -> Result<(Box<dyn Transport>, Option<Link>), CliError> {
    match &args.listen {
        Listen::Tcp(address) => {
            if args.link.is_some() {
                return Err(CliError::new(
                    Exit::Usage,
                    "--link is for a pseudo-terminal; leave it out with tcp:",
                ));
            }
            Ok((Box::new(TcpServer::listen(address)?), None))
        }
        #[cfg(unix)]
        Listen::Pty => {
            let port = crate::port::PtyServer::open()?;
            let link = match &args.link {
                Some(path) => {
                    std::os::unix::fs::symlink(port.name(), path).map_err(|error| {
                        CliError::new(
                            Exit::Output,
                            format!(
                                "{}: {error}; take another path, or remove it",
                                path.display()
                            ),
                        )
                    })?;
                    Some(Link(path.clone()))
                }
                None => None,
            };
            Ok((Box::new(port), link))
        }
        #[cfg(not(unix))]
        Listen::Pty => Err(CliError::new(
            Exit::Usage,
            "this system has no pseudo-terminals; use --listen tcp:HOST:PORT",
        )),
    }
}
