//! `haptimill sim serve`: the simulated machine as a device that any serial program can talk to, in real time.

use super::{CliError, Exit, MachineArg};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::port::{TcpServer, Token, Transport};
use haptimill_client::session::{self};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::Fault;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::input;
use haptimill_teleop::script::{Script, ScriptedOperator};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

const LONG: &str = "\
Serve the simulated machine in real time.

On a pseudo-terminal the path is the first line on standard output; on a TCP port the address is. Give it to another `haptimill` as --port. One \
host is served at a time. Ctrl-C ends it. An address that other computers reach (any but 127.0.0.1 and ::1) asks every host for a token, which is the second \
line; hosts give it with --token or in HAPTIMILL_TOKEN. It is not encrypted: on a network that is not trusted use ssh -L. A connection that says nothing within \
2 s is closed; a host that was silent for 2 s makes room for another one, and is closed after 30 s. The board is configured as the machine that is served.";

/// Arguments of `haptimill sim serve`.
#[derive(Debug, Clone, Args)]
#[command(about = "Serve the simulated machine in real time", long_about = LONG, after_long_help = super::run::faults_help(),
          after_help = "`haptimill sim serve --help` says more, and lists the faults.")]
pub struct ServeArgs {
    /// Where: pty (a pseudo-terminal, its path is printed) or tcp:HOST:PORT (port 0 takes a free one)
    #[arg(long, value_name = "WHERE", default_value = "pty")]
    pub listen: Listen,
    /// File with the token that a host has to give on a TCP port. Without it an address that other computers reach gets a new token, which is printed
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Also make a symbolic link with this path to the pseudo-terminal
    #[arg(long, value_name = "PATH")]
    pub link: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Seed of the simulated machine, instead of the one in the machine file
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Something that goes wrong in the machine, as "slide-jammed axis=l3 at=1.5s"; can be given several times. --help lists all faults
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<Fault>,
    /// A person at the haptic arm of the machine file, who does what this script says once the arm's motors are on (as examples/teleop.toml; orders in it are not heard)
    #[arg(long, value_name = "FILE")]
    pub person: Option<PathBuf>,
    /// A board without a configuration, as it comes from its maker; the first command needs --machine
    #[arg(long)]
    pub unconfigured: bool,
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
    let person = person(args.person.as_deref(), &machine)?;
    let mut person = person.as_ref().map(ScriptedOperator::new);
    // A port paces its bytes by itself; the simulated line in between adds nothing.
    let mut rig = session::rig(&machine, args.seed, None, args.fault.clone())?;
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
    let begun = Instant::now();
    let mut pace = Pace::new(u64::from(machine.config.period_us) * 1000);
    let mut buffer = [0; 4096];
    let mut said = Vec::new();
    let mut spoken_to = false;
    while !interrupted.load(Ordering::Relaxed)
        && args
            .duration
            .is_none_or(|limit| begun.elapsed().as_secs_f64() < limit)
    {
        let now_ns = u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
        for _ in 0..pace.due(now_ns, rig.time_ns()) {
            if let Some(person) = &mut person {
                person.act(&mut rig);
            }
            rig.step();
        }
        rig.host_read(&mut said);
        if !spoken_to {
            // A pseudo-terminal would keep it for the first host.
            said.clear();
        }
        if !said.is_empty() {
            let taken = port.write(&said, Duration::ZERO)?;
            said.drain(..taken);
            // A host that does not read loses what is old; its link asks for it again.
            if said.len() > MOST_UNREAD {
                said.clear();
            }
        }
        let count = port.read(&mut buffer, POLL)?;
        spoken_to |= count > 0;
        rig.host_write(&buffer[..count]);
    }
    drop(link);
    Ok(())
}

/// What the person at the simulated arm of a machine does, as `--person` says.
///
/// # Errors
/// Nobody can be at an arm that is not there, or the script makes no sense.
pub(crate) fn person(
    file: Option<&Path>,
    machine: &MachineFile,
) -> Result<Option<Script>, CliError> {
    let Some(file) = file else { return Ok(None) };
    let plant: PlantConfig = machine.plant()?;
    if plant.hand.is_none() {
        let what = format!(
            "--person: {}: has no [plant.haptic] and [plant.hand] to lead it; use machines/hand-master.toml, or append machines/hand.toml",
            machine.file
        );
        return Err(CliError::new(Exit::Usage, what));
    }
    Ok(Some(Script::load(file)?))
}

/// Longest wait for bytes between two looks at the clock.
const POLL: Duration = Duration::from_micros(200);

/// Virtual time that is made up for at once when this process was held up. What the host said in the meantime still waits in the port: a machine
/// that lived through all that time before it listens would find its host silent, and a job would end for nothing but a busy computer.
const MOST_BEHIND: Duration = Duration::from_millis(20);

/// Keeps virtual time with real time.
pub(crate) struct Pace {
    period_ns: u64,
    /// Real time that virtual time has given up for good.
    given_up_ns: u64,
}

impl Pace {
    pub(crate) const fn new(period_ns: u64) -> Self {
        Self {
            period_ns,
            given_up_ns: 0,
        }
    }

    /// Periods to go through now. Of a longer delay the most that may be made up for is, and the rest is given up: for the machine this process stood
    /// still, with the time in it.
    pub(crate) fn due(&mut self, real_ns: u64, virtual_ns: u64) -> u64 {
        let behind = real_ns.saturating_sub(virtual_ns.saturating_add(self.given_up_ns));
        let most = MOST_BEHIND.as_nanos() as u64;
        let behind = if behind > most {
            self.given_up_ns += behind - most;
            most
        } else {
            behind
        };
        behind / self.period_ns.max(1)
    }
}

/// Bytes that wait for a host that does not read.
const MOST_UNREAD: usize = 1 << 16;

/// A symbolic link that goes when the simulator goes.
struct Link(PathBuf);

impl Drop for Link {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Reads a token from the first line of a file.
fn token(path: &Path) -> Result<Token, CliError> {
    let bad = |what: &dyn std::fmt::Display| {
        CliError::new(Exit::BadInput, format!("{}: {what}", path.display()))
    };
    let bytes = input::read(path, input::SETTINGS_BYTES).map_err(|error| bad(&error))?;
    let text = String::from_utf8_lossy(&bytes);
    let line = text.lines().next().unwrap_or_default();
    line.trim().parse().map_err(|what: String| bad(&what))
}

/// A port that is served: its transport, its link, and a token that was made for it.
type Served = (Box<dyn Transport>, Option<Link>, Option<Token>);

fn listen(args: &ServeArgs) -> Result<Served, CliError> {
    if args.token_file.is_some() && args.listen == Listen::Pty {
        let what = "--token-file is for a TCP port; the system guards a pseudo-terminal";
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
            let token = args.token_file.as_deref().map(token).transpose()?;
            let port = TcpServer::listen(address)?;
            let local = port.address().is_ok_and(|at| at.ip().is_loopback());
            let (token, new) = match token {
                Some(token) => (Some(token), false),
                None if local => (None, false),
                None => {
                    let made = Token::random();
                    let made = made.map_err(|error| CliError::new(Exit::Internal, error))?;
                    (Some(made), true)
                }
            };
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
                                "{}: {error}; take another path, or remove it",
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
    fn virtual_time_follows_real_time_and_gives_up_what_it_cannot_make_up() {
        let mut pace = Pace::new(200_000);
        let mut virtual_ns = 0;
        let mut step = |real_ns: u64| {
            let periods = pace.due(real_ns, virtual_ns);
            virtual_ns += periods * 200_000;
            (periods, virtual_ns)
        };
        // Looked at often: exactly in step, to the period.
        for real_us in (0..100_000).step_by(130) {
            let (periods, virtual_ns) = step(real_us * 1000);
            assert!(periods <= 1);
            assert_eq!(virtual_ns / 200_000, real_us / 200);
        }
        // Held up a little: made up for at once.
        assert_eq!(step(115 * MS).1, 115 * MS);
        // Held up for three seconds, longer than any heartbeat: 20 ms pass for the machine, then it hears its host.
        let before = step(115 * MS).1;
        let (periods, after) = step(3_115 * MS);
        assert_eq!((periods, after - before), (100, 20 * MS));
        assert_eq!(step(3_115 * MS).0, 0);
        // And goes on at its pace.
        assert_eq!(step(3_125 * MS).1, after + 10 * MS);
    }
}
