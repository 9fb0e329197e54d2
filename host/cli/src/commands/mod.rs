//! The command line: what can be asked, and which room does it.

/// Prints a line on standard output. If that fails the command ends with [`Exit::Output`]; a reader that has gone (`| head`) is no error.
macro_rules! tell {
    ($($argument:tt)*) => {
        $crate::commands::out::tell(format_args!($($argument)*))
    };
}

mod board;
pub mod console;
mod exit;
pub mod force;

pub(crate) mod interrupt;
pub mod jog;
pub mod kin;
pub mod machine;
pub mod one_shot;
mod out;
pub(crate) mod part;
pub mod ports;
pub mod replay;
pub mod run;
pub mod scenario;
pub mod sim;
pub mod teleop;
pub mod trace;

pub use board::BoardArg;
pub use exit::{CliError, EXIT_CODES, Exit};

use clap::{Args, Parser, Subcommand};
use haptimill_client::port::{PortSpec, TOKEN_VARIABLE, Token, use_token};
use haptimill_machine_file::MachineFile;
use std::path::PathBuf;
use std::process::ExitCode;
#[cfg(unix)]
use std::sync::Arc;

const ABOUT: &str = "Runs part programs on an H-4 parallel milling arm, real or simulated.";

const LONG_ABOUT: &str = "\
Runs part programs on an H-4 parallel milling arm, real or simulated.

`haptimill run FILE.ngc` checks a part program against the machine, homes, streams it to the controller and leaves a recording, a trace, a \
summary and a report with pictures. Without --port the controller and the machine are the built-in simulator: the same controller code, the \
same protocol, a simulated arm. Without --machine the machine is the built-in H-4 arm.

A board behind --port keeps the configuration that it has. Without --machine a command goes by that configuration and never sends another one; a command that \
computes positions (run, home, jog, teleop, console) needs the machine file of a configuration that is not built in. With --machine the file is \
sent, drives off, and the command says so; a board that is configured as a machine of another name refuses it without --replace-machine.";

const EXAMPLES: &str = "\
Examples:
  haptimill run examples/e11-circle.ngc                   a job in the simulator
  haptimill run part.ngc --check                         would it run? nothing moves
  haptimill run part.ngc --port /dev/ttyACM0 --out job7  a job on a machine
  haptimill run examples/e7-slot.ngc --work examples/block.toml   the same, and it cuts
  haptimill scenario run all                             the thesis's experiments, beside what the thesis states
  haptimill sim serve --listen tcp:127.0.0.1:7000        a machine for other programs to talk to
  haptimill home --port tcp:localhost:7000               home it from another terminal
  haptimill jog x=5 z=-2 --for 1.5 --port /dev/ttyACM0   5 and -2 mm/s for 1.5 s
  haptimill console --port /dev/ttyACM0 part.ngc         the operator's full-screen console
  haptimill teleop --hand sim --work examples/block.toml --spindle 5000   a hand leads the tool, and feels what it cuts
  haptimill status --port /dev/ttyACM0 --json            how things stand, for a script
  haptimill run part.ngc --force x,z --fd 5              the tool yields to more than 5 N in x and z
  haptimill force tare --port /dev/ttyACM0               what the force sensor shows now is none
  haptimill machine check mine.toml                      every mistake in a machine file
  haptimill replay e11-circle.out/recording.hmr          the job again through a new controller: the same bits?
  haptimill trace plot e11-circle.out/recording.hmr 'l?_joint_error_mm'   on the terminal; info, csv and mcap too
  haptimill kin ik --in poses.csv --out slides.csv       the firmware's kinematics over a table";

fn after_help() -> String {
    format!("{EXAMPLES}\n\n{EXIT_CODES}")
}

/// The command line.
#[derive(Debug, Parser)]
#[command(name = "haptimill", version, about = ABOUT, long_about = LONG_ABOUT, after_long_help = after_help(),
          after_help = "`haptimill --help` has examples and the exit codes.", max_term_width = 120)]
pub struct Cli {
    /// Token of a TCP port that asks for one; better in the environment variable HAPTIMILL_TOKEN, which other users do not see
    #[arg(long, global = true, value_name = "TOKEN")]
    token: Option<Token>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::RunArgs),
    Jog(jog::JogArgs),
    /// Find the reference of all axes, as one transaction
    Home(one_shot::HomeArgs),
    Console(console::ConsoleArgs),
    Teleop(teleop::TeleopArgs),
    /// How things stand
    Status(one_shot::OneShotArgs),
    /// Drives on; wanted becomes measured, nothing moves
    Enable(one_shot::OneShotArgs),
    /// Drives off, from standstill
    Disable(one_shot::OneShotArgs),
    /// Slow down along the path and drop the job; the position is kept
    Stop(one_shot::StopArgs),
    /// Clear a latched fault or emergency stop
    Reset(one_shot::OneShotArgs),
    /// The thesis's experiments in the simulator, beside what the thesis states
    #[command(subcommand)]
    Scenario(scenario::ScenarioCommand),
    /// The force sensor and the force loop
    #[command(subcommand)]
    Force(force::ForceCommand),
    /// The simulated machine
    #[command(subcommand)]
    Sim(SimCommand),
    /// Machine files
    #[command(subcommand)]
    Machine(MachineCommand),
    Ports(ports::PortsArgs),
    /// Recordings: what is in them, as CSV, as a picture, as MCAP, the first difference of two
    Trace(trace::TraceArgs),
    Replay(replay::ReplayArgs),
    /// The firmware's kinematics over a table
    #[command(subcommand)]
    Kin(KinCommand),
}

impl Command {
    /// Whether a program reads the standard output.
    fn json(&self) -> bool {
        match self {
            Self::Run(args) => args.json,
            Self::Jog(args) => args.json,
            Self::Teleop(args) => args.json,
            Self::Home(args) => args.one_shot.json,
            Self::Status(args) | Self::Enable(args) | Self::Disable(args) | Self::Reset(args) => {
                args.json
            }
            Self::Stop(args) => args.json,
            Self::Ports(args) => args.json,
            Self::Force(command) => command.json(),
            Self::Machine(MachineCommand::Check(args)) => args.json,
            Self::Scenario(scenario::ScenarioCommand::Run(args)) => args.json,
            Self::Trace(args) => args.what.json(),
            Self::Replay(args) => args.json,
            Self::Scenario(_) | Self::Console(_) | Self::Sim(_) | Self::Kin(_) => false,
        }
    }
}

#[derive(Debug, Subcommand)]
enum SimCommand {
    Serve(sim::ServeArgs),
}

#[derive(Debug, Subcommand)]
enum MachineCommand {
    Check(machine::CheckArgs),
}

#[derive(Debug, Subcommand)]
enum KinCommand {
    Ik(kin::IkArgs),
    Fk(kin::FkArgs),
}

/// Which machine.
#[derive(Debug, Clone, Args)]
pub struct MachineArg {
    /// Machine file; without it the built-in H-4 arm (machines/h4.toml)
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
}

impl MachineArg {
    /// The machine file that was named, or the built-in one.
    ///
    /// # Errors
    /// Every problem of the file.
    pub fn load(&self) -> Result<MachineFile, CliError> {
        Ok(match &self.machine {
            Some(path) => MachineFile::load(path)?,
            None => MachineFile::built_in()?,
        })
    }
}

/// Where a running controller is.
#[derive(Debug, Clone, Args)]
pub struct ConnectArgs {
    /// Serial port or pseudo-terminal by its path, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    pub port: PortSpec,
    /// Baud rate of a serial port (default 115200)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Give up when the controller has not answered for so long
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = seconds)]
    pub timeout: f64,
}

/// Reads a time in seconds, above 0 and at most an hour.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 3600.0 => Ok(value),
        _ => Err("write seconds, above 0 and at most 3600".to_string()),
    }
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    use std::io::Write as _;
    let cli = Cli::parse();
    // Where the size of files is limited (ulimit -f), a write beyond it is an error, told as any other, and not the end of the process.
    #[cfg(unix)]
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    let json = cli.command.json();
    let error = set_token(cli.token.clone())
        .and_then(|()| dispatch(cli))
        .err();
    if let Some(error) = &error
        && json
        && !error.told
    {
        tell!("{:#}", error.to_json());
    }
    // What went wrong first is what the command ends with.
    let errors: Vec<CliError> = error.into_iter().chain(out::failed()).collect();
    for error in &errors {
        // A terminal that was closed is no reason for a panic on top.
        let _ = writeln!(std::io::stderr(), "{}", error.message);
    }
    let exit = errors.first().map_or(Exit::Done, |error| error.exit);
    ExitCode::from(exit as u8)
}

/// The token for TCP ports: that of the command line, or of the environment.
fn set_token(given: Option<Token>) -> Result<(), CliError> {
    let token = match (given, std::env::var(TOKEN_VARIABLE)) {
        (Some(token), _) => Some(token),
        (None, Ok(text)) if !text.is_empty() => Some(
            text.parse()
                .map_err(|what| CliError::new(Exit::Usage, format!("{TOKEN_VARIABLE}: {what}")))?,
        ),
        _ => None,
    };
    if let Some(token) = token {
        use_token(token);
    }
    Ok(())
}

fn dispatch(cli: Cli) -> Result<(), CliError> {
    use one_shot::Order;
    match cli.command {
        Command::Run(args) => run::run(args),
        Command::Jog(args) => jog::run(args),
        Command::Console(args) => console::run(args),
        Command::Teleop(args) => teleop::run(args),
        Command::Home(args) => one_shot::home(args),
        Command::Status(args) => one_shot::run(Order::Status, args),
        Command::Enable(args) => one_shot::run(Order::Enable, args),
        Command::Disable(args) => one_shot::run(Order::Disable, args),
        Command::Stop(args) => one_shot::stop(args),
        Command::Reset(args) => one_shot::run(Order::Reset, args),
        Command::Scenario(command) => scenario::run(command),
        Command::Force(command) => force::run(command),
        Command::Sim(SimCommand::Serve(args)) => sim::serve(args),
        Command::Machine(MachineCommand::Check(args)) => machine::check(args),
        Command::Ports(args) => ports::run(args),
        Command::Trace(args) => trace::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Kin(KinCommand::Ik(args)) => kin::ik(args),
        Command::Kin(KinCommand::Fk(args)) => kin::fk(args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_is_sound() {
        Cli::command().debug_assert();
    }
}
