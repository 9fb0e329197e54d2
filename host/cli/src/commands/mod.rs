//! Command-line parsing and dispatch.

/// Prints a line on standard output. A failure is reported at the end of the command as
/// [`Exit::Output`]; a closed pipe (`| head`) is no error.
macro_rules! print_line {
    ($($argument:tt)*) => {
        $crate::commands::output::print_line(format_args!($($argument)*))
    };
}

pub mod args;
mod board;
#[cfg(unix)]
pub mod bridge;
pub mod calibrate;
mod changes;
pub mod console;
pub mod dnc;
pub mod engrave;
pub mod examples;
pub(crate) mod exit;
pub mod facet;
pub mod flash;
pub mod force;
pub mod identify;
pub mod identify_args;
mod index_pulses;

pub(crate) mod interrupt;
mod io_status;
pub mod jog;
pub mod kin;
mod lost_motion;
pub mod machine;
pub mod mdi;
pub mod named_io;
pub mod offset;
pub(crate) mod operate;
mod operator_input;
mod output;
pub mod ports;
pub mod preview;
pub mod probe_cycle;
mod probing;
pub(crate) mod program;
pub mod pulses;
pub(crate) mod real_time_sim;
pub mod replay;
pub(crate) mod requests;
pub mod run;
pub mod scenario;
pub mod serve;
pub mod sim;
pub mod simple;
pub(crate) mod status;
pub mod teleop;
pub mod trace;
pub mod tune;
pub mod watch;

pub use exit::{CliError, EXIT_CODES, Exit};

use clap::{Parser, Subcommand};
use haptimill_client::port::{TOKEN_VARIABLE, Token, use_token};
use std::process::ExitCode;
#[cfg(unix)]
use std::sync::Arc;

const ABOUT: &str = "Runs part programs on milling machines, real or simulated.";

const LONG_ABOUT: &str = "\
Runs part programs on milling machines, real or simulated.

`haptimill run FILE.ngc` checks a part program against the machine, homes the machine if it is not \
homed, streams the \
program to the controller and writes a recording, a trace, a summary and a report. Without --port \
the controller and the machine are the built-in simulator: the same controller code and the same \
protocol with a simulated machine. Without --machine the machine is the built-in \
machines/h4.toml.

A board behind --port has an active configuration, or none after power-on. Without --machine a \
command uses the active configuration and sends none. A command that computes positions (run, home, \
jog, teleop, console) needs the machine file of a configuration that is not built in. With --machine \
the file is sent while the drives are off, and the command reports it. The file does not replace the \
configuration of a machine of another name without --replace-machine.";

const EXAMPLES: &str = "\
Examples:
  haptimill run examples/e11-circle.ngc
      run a part program in the simulator
  haptimill run part.ngc --check
      check a part program; nothing moves
  haptimill preview part.ngc
      write a page with its path in 3D; nothing moves
  haptimill run part.ngc --port /dev/ttyACM0 --out job7
      run it on a machine
  haptimill run examples/e7-slot.ngc --stock examples/block.toml
      cut a stock in the simulator
  haptimill run part.ngc --force x,z --force-setpoint 5
      with force control of x and z: a compliant displacement above 5 N
  haptimill scenario run all
      run the experiments e1 to e12 and compare the results with the thesis
  haptimill sim serve --listen tcp:127.0.0.1:7000
      serve the simulated machine on a TCP port
  haptimill home --port tcp:localhost:7000
      home it from another terminal
  haptimill jog x=5 z=-2 --for 1.5 --port /dev/ttyACM0
      jog at 5 and -2 mm/s for 1.5 s
  haptimill jog --by x=10 --port /dev/ttyACM0
      move x by 10 mm
  haptimill mdi \"G0 X10\" \"G1 Y5 F300\" --port /dev/ttyACM0
      run blocks; without blocks, at a prompt
  haptimill override --feed 60 --port /dev/ttyACM0
      change the feed of a job that another terminal runs; see also hold, resume and stop
  haptimill console --port /dev/ttyACM0 part.ngc
      operate the machine on a full screen
  haptimill teleop --master sim --stock examples/block.toml --spindle 5000
      teleoperation with the simulated master arm; cutting forces are fed back
  haptimill facet run examples/round-brilliant.asc --width 6
      cut a gem on the simulated faceting machine; the report shows it in 3D
  haptimill status --port /dev/ttyACM0 --json
      print the status of the machine for a script
  haptimill force tare --port /dev/ttyACM0
      zero the force sensor
  haptimill output set coolant on --for 10 --port /dev/ttyACM0
      switch an output on for 10 s
  haptimill probe z=-20 --feed 60 --port /dev/ttyACM0
      move down until the probe makes contact, and print the position
  haptimill probe bore --reach 20 --set g54 --machine mill.toml --port /dev/ttyACM0
      find the centre of a bore and make it the zero; see also probe edge, boss and tool
  haptimill machine init mill --out mill.toml
      write a machine-file template
  haptimill machine check mill.toml
      list every mistake in a machine file
  haptimill machine keys joint
      list the keys of a section with unit, range, default and meaning
  haptimill machine migrate mill.toml
      rewrite a machine file of an earlier format
  haptimill offset set g54 x=12.5 y=-3 --machine mill.toml
      set the origin of a work coordinate system
  haptimill identify --machine mill.toml --port /dev/ttyACM0 --baud 2000000
      measure inertia, friction and resonance, and write them into the machine file
  haptimill tune --machine mill.toml
      propose gains from it, with margins and step responses
  haptimill replay e11-circle.out/recording.hmr
      replay a job through a new controller and compare bit by bit
  haptimill trace plot e11-circle.out/recording.hmr 'l?_joint_error_mm'
      plot on the terminal; see also trace info, csv and mcap
  haptimill flash
      write the image into a board in boot mode, and check that it answers
  haptimill kin ik --in poses.csv --out joints.csv
      compute the kinematics of the controller for a table of poses";

fn after_help() -> String {
    format!("{EXAMPLES}\n\n{EXIT_CODES}")
}

/// The command line.
#[derive(Debug, Parser)]
#[command(name = "haptimill", version, about = ABOUT, long_about = LONG_ABOUT,
          after_long_help = after_help(),
          after_help = "`haptimill --help` has examples and the exit codes.", max_term_width = 120)]
pub struct Cli {
    /// Token of a TCP port that requires one; the environment variable HAPTIMILL_TOKEN is safer,
    /// because other users of the computer cannot read it
    #[arg(
        long,
        global = true,
        value_name = "TOKEN",
        help_heading = "Global options",
        display_order = 1000
    )]
    token: Option<Token>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::RunArgs),
    Engrave(engrave::EngraveArgs),
    Dnc(dnc::DncArgs),
    Jog(jog::JogArgs),
    Mdi(mdi::MdiArgs),
    /// Home all joints
    Home(simple::HomeArgs),
    Console(console::ConsoleArgs),
    Teleop(teleop::TeleopArgs),
    /// Cut a gem: check a design, plan its job, cut it in the simulator
    #[command(subcommand)]
    Facet(facet::FacetCommand),
    /// Print the status of the machine
    Status(simple::SimpleArgs),
    /// Switch the drives on; the measured position becomes the commanded one, so nothing moves
    Enable(simple::SimpleArgs),
    /// Switch the drives off, from standstill
    Disable(simple::SimpleArgs),
    /// Let the board keep the machine file in its memory; after a reset it activates the file by
    /// itself. Drives off only
    Store(simple::SimpleArgs),
    /// Decelerate along the path and abort the job; the position is kept
    Stop(simple::StopArgs),
    /// Move a joint off its limit switch, slowly; the switch must open within a sixteenth of the
    /// stroke. A latched fault of a limit switch is reset first
    MoveOff(simple::MoveOffArgs),
    /// Clear a latched fault or emergency stop
    Reset(simple::SimpleArgs),
    /// Fade the volumetric compensation in or out. A new configuration switches it on; it fades in
    /// when the machine is homed
    Compensation(simple::CompensationArgs),
    Override(operate::OverrideArgs),
    /// Decelerate a job that another process runs along its path, and hold it
    Hold(operate::OperateArgs),
    /// End the hold or the pause of a job that another process runs
    Resume(operate::OperateArgs),
    /// Run the experiments of four theses in the simulator and compare the results with theirs
    #[command(subcommand)]
    Scenario(scenario::ScenarioCommand),
    /// Measure geometric errors, correct programs by them, and calibrate an arm
    #[command(subcommand)]
    Calibrate(calibrate::CalibrateCommand),
    Identify(identify_args::IdentifyArgs),
    Tune(tune::TuneArgs),
    /// Read and set the force sensor and the force control
    #[command(subcommand)]
    Force(force::ForceCommand),
    /// Set the named outputs of the machine
    #[command(subcommand)]
    Output(named_io::OutputCommand),
    Probe(named_io::ProbeArgs),
    /// Serve the simulated machine
    #[command(subcommand)]
    Sim(SimCommand),
    /// Write and check machine files
    #[command(subcommand)]
    Machine(machine::MachineCommand),
    /// Print and set the work offsets of a machine
    #[command(subcommand)]
    Offset(offset::OffsetCommand),
    Serve(serve::ServeArgs),
    #[cfg(unix)]
    #[command(subcommand)]
    Bridge(bridge::BridgeCommand),
    Watch(watch::WatchArgs),
    Examples(examples::ExamplesArgs),
    Ports(ports::PortsArgs),
    Flash(flash::FlashArgs),
    Preview(preview::PreviewArgs),
    Pulses(pulses::PulsesArgs),
    /// Read recordings: content, CSV, plots, MCAP, the first difference of two
    Trace(trace::TraceArgs),
    Replay(replay::ReplayArgs),
    /// Compute the kinematics of the controller for a table
    #[command(subcommand)]
    Kin(KinCommand),
}

impl Command {
    /// Whether standard output is JSON.
    fn is_json(&self) -> bool {
        match self {
            Self::Run(args) => args.json,
            Self::Engrave(args) => args.json,
            Self::Dnc(args) => args.run.json,
            Self::Watch(args) => args.json,
            Self::Jog(args) => args.json,
            Self::Mdi(args) => args.json,
            Self::Teleop(args) => args.json,
            Self::Facet(command) => command.is_json(),
            Self::Home(args) => args.simple.json,
            Self::MoveOff(args) => args.simple.json,
            Self::Compensation(args) => args.simple.json,
            Self::Status(args)
            | Self::Enable(args)
            | Self::Disable(args)
            | Self::Store(args)
            | Self::Reset(args) => args.json,
            Self::Stop(args) => args.json,
            Self::Override(args) => args.job.json,
            Self::Hold(args) | Self::Resume(args) => args.json,
            Self::Ports(args) => args.json,
            Self::Flash(args) => args.json,
            Self::Pulses(args) => args.json,
            Self::Force(command) => command.is_json(),
            Self::Output(command) => command.is_json(),
            Self::Probe(args) => args.is_json(),
            Self::Machine(command) => command.is_json(),
            Self::Scenario(scenario::ScenarioCommand::Run(args)) => args.json,
            Self::Trace(args) => args.command.is_json(),
            Self::Replay(args) => args.json,
            Self::Identify(args) => args.json,
            Self::Scenario(_)
            | Self::Console(_)
            | Self::Sim(_)
            | Self::Kin(_)
            | Self::Preview(_)
            | Self::Offset(_)
            | Self::Calibrate(_)
            | Self::Tune(_)
            | Self::Serve(_) => false,
            #[cfg(unix)]
            Self::Bridge(_) => false,
            Self::Examples(_) => false,
        }
    }
}

#[derive(Debug, Subcommand)]
enum SimCommand {
    Serve(sim::ServeArgs),
}

#[derive(Debug, Subcommand)]
enum KinCommand {
    Ik(kin::IkArgs),
    Fk(kin::FkArgs),
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    use std::io::Write as _;
    let cli = Cli::parse();
    // With a file size limit (ulimit -f) a write beyond it must be an ordinary error; by default
    // the signal ends the process.
    #[cfg(unix)]
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    let json = cli.command.is_json();
    let error = set_token(cli.token.clone())
        .and_then(|()| dispatch(cli))
        .err();
    if let Some(error) = &error
        && json
        && !error.reported
    {
        print_line!("{:#}", error.to_json());
    }
    // The first error determines the exit code.
    let errors: Vec<CliError> = error.into_iter().chain(output::take_error()).collect();
    for error in &errors {
        // Standard error may be closed.
        let _ = writeln!(std::io::stderr(), "{}", error.message);
    }
    let exit = errors.first().map_or(Exit::Done, |error| error.exit);
    ExitCode::from(exit as u8)
}

/// Sets the token for TCP ports from the command line or the environment.
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
    use simple::SimpleCommand;
    match cli.command {
        Command::Run(args) => run::run(args),
        Command::Engrave(args) => engrave::run(args),
        Command::Dnc(args) => dnc::run(args),
        Command::Jog(args) => jog::run(args),
        Command::Mdi(args) => mdi::run(args),
        Command::Console(args) => console::run(args),
        Command::Teleop(args) => teleop::run(args),
        Command::Facet(command) => facet::run(command),
        Command::Home(args) => simple::home(args),
        Command::Status(args) => simple::run(SimpleCommand::Status, args),
        Command::Enable(args) => simple::run(SimpleCommand::Enable, args),
        Command::Disable(args) => simple::run(SimpleCommand::Disable, args),
        Command::Store(args) => simple::run(SimpleCommand::Store, args),
        Command::MoveOff(args) => simple::move_off(args),
        Command::Stop(args) => simple::stop(args),
        Command::Reset(args) => simple::run(SimpleCommand::Reset, args),
        Command::Compensation(args) => simple::compensation(args),
        Command::Override(args) => operate::set_overrides(&args),
        Command::Hold(args) => operate::hold(&args),
        Command::Resume(args) => operate::resume(&args),
        Command::Scenario(command) => scenario::run(command),
        Command::Calibrate(command) => calibrate::run(command),
        Command::Identify(args) => identify::run(args),
        Command::Tune(args) => tune::run(&args),
        Command::Force(command) => force::run(command),
        Command::Output(command) => named_io::run(command),
        Command::Probe(args) => named_io::probe(args),
        Command::Sim(SimCommand::Serve(args)) => sim::serve(args),
        Command::Machine(command) => machine::run(command),
        Command::Offset(command) => offset::run(command),
        Command::Serve(args) => serve::run(args),
        #[cfg(unix)]
        Command::Bridge(command) => bridge::run(command),
        Command::Watch(args) => watch::run(&args),
        Command::Examples(args) => examples::run(&args),
        Command::Ports(args) => ports::run(args),
        Command::Flash(args) => flash::run(&args),
        Command::Preview(args) => preview::run(args),
        Command::Pulses(args) => pulses::run(&args),
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
    fn command_definition_is_valid() {
        Cli::command().debug_assert();
    }

    /// Other computers reach only an address that the command line names.
    #[test]
    fn default_addresses_are_local() {
        fn defaults(command: &clap::Command) -> Vec<String> {
            let listens = |arg: &&clap::Arg| arg.get_long() == Some("listen");
            let own = command.get_arguments().filter(listens);
            let own = own.flat_map(clap::Arg::get_default_values);
            let own = own.map(|value| value.to_string_lossy().into_owned());
            own.chain(command.get_subcommands().flat_map(defaults))
                .collect()
        }
        let found = defaults(&Cli::command());
        assert!(found.len() >= 2, "{found:?}");
        for value in found {
            let address = value.parse::<std::net::SocketAddr>();
            let is_local = address.is_ok_and(|address| address.ip().is_loopback());
            assert!(value == "pty" || is_local, "{value}");
        }
    }
}
