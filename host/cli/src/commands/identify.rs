//! `haptimill identify`: measures the joints of a machine.

use super::args::{BoardArg, ConnectArgs, PortArgs};
use super::board::file_of;
use super::run::results::ResultFolder;
use super::simple::open;
use super::{CliError, Exit, output};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::client::Options as ClientOptions;
use haptimill_client::port::PortSpec;
use haptimill_client::session::{self, Line, Session, SimLine};
use haptimill_identify::edit;
use haptimill_identify::identify::{Identification, Identified, Options, lines, torque_joints};
use haptimill_identify::line::{Geometry, Line as Travel};
use haptimill_identify::{page, record};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::Command;
use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

const LONG: &str = "\
Measure the joints of a machine with torque drives: inertia, Coulomb friction in both directions, \
viscous friction, resonance.

The machine homes, then moves along the printed ranges: at constant rates in both directions, and \
with sines on top of a slow constant rate. Nothing may be in these ranges, and the spindle is at rest. \
Effort and motion come from the telemetry of the controller. The command asks before anything \
moves. Ctrl-C stops.

It writes OUT/identified.toml, the page OUT/identify.html, and the values into the machine file; the \
file before is kept beside it. Comments in the file stay.";

/// Arguments of `haptimill identify`.
#[derive(Debug, Clone, Args)]
#[command(about = "Measure inertia, friction and resonance of the joints, and write them into the \
                   machine file", long_about = LONG)]
pub struct IdentifyArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub port: PortArgs,
    /// Longest motion of a joint, mm or degrees
    #[arg(long, value_name = "MM", default_value_t = 80.0, value_parser = travel)]
    pub travel: f64,
    /// Part of the largest rate that a joint reaches
    #[arg(long, value_name = "PART", default_value_t = 0.8, value_parser = part)]
    pub rate: f64,
    /// Highest frequency of the sines, Hz
    #[arg(long, value_name = "HZ", default_value_t = 200.0, value_parser = highest)]
    pub highest: f64,
    /// Folder of the results [default: the name of the machine with .identify]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Do not ask before the machine moves
    #[arg(long)]
    pub yes: bool,
    /// Leave the machine file as it is
    #[arg(long)]
    pub no_write: bool,
}

fn number(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value = text.parse::<f64>().ok();
    let value = value.filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("write a number from {low} to {high}"))
}

fn travel(text: &str) -> Result<f64, String> {
    number(text, 20.0, 1000.0)
}

fn part(text: &str) -> Result<f64, String> {
    number(text, 0.1, 0.95)
}

fn highest(text: &str) -> Result<f64, String> {
    number(text, 40.0, 500.0)
}

/// Folder of the results of a machine.
pub(super) fn folder(out: Option<&PathBuf>, machine: &MachineFile) -> PathBuf {
    out.cloned()
        .unwrap_or_else(|| PathBuf::from(format!("{}.identify", machine.config.name)))
}

/// Writes a file of the results.
pub(super) fn save(path: &Path, text: &str) -> Result<(), CliError> {
    let failed = |error| output::write_error(path, error);
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    output::save(path, text)
}

/// Measures the joints.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: IdentifyArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    match &args.port.port {
        PortSpec::Emulated(_) | PortSpec::EmulatedPins => {
            let what = "--port: the emulated boards are for `haptimill run`; leave --port out for \
                the simulator";
            Err(CliError::new(Exit::Usage, what))
        }
        PortSpec::Simulator => {
            let machine = chosen.file;
            let ranges = plan(&args, &machine)?;
            let _folder = open_results(&args, &machine)?;
            confirm(&args, &machine, &ranges)?;
            let rig = session::rig(&machine, None, args.port.baud, Vec::new())?;
            let line = SimLine::new(rig).unrecorded();
            let options = ClientOptions::default();
            let mut session = Session::new(line, &machine, options, interrupt::flag());
            session.connect(1)?;
            session.configure(&machine)?;
            measure(&args, &machine, &mut session, &ranges)
        }
        PortSpec::Serial(_) | PortSpec::Tcp(_) => {
            let connect = ConnectArgs {
                port: args.port.port.clone(),
                baud: args.port.baud,
                timeout: 5.0,
            };
            let mut session = open(&connect, &chosen.file)?;
            let machine = file_of(&chosen, &mut session)?;
            let ranges = plan(&args, &machine)?;
            let _folder = open_results(&args, &machine)?;
            confirm(&args, &machine, &ranges)?;
            measure(&args, &machine, &mut session, &ranges)
        }
    }
}

fn options(args: &IdentifyArgs) -> Options {
    let baud = match args.port.port {
        PortSpec::Serial(_) => Some(args.port.baud_or_default()),
        _ => args.port.baud,
    };
    Options {
        travel: args.travel,
        rate_part: args.rate,
        frequencies: [4.0, args.highest],
        // Ten bits for a byte.
        line_rate: baud.map(|baud| baud / 10),
    }
}

fn plan(args: &IdentifyArgs, machine: &MachineFile) -> Result<Vec<Travel>, CliError> {
    session::check_has_tool(machine)?;
    Ok(lines(machine, &options(args))?)
}

/// Opens the folder of the results, and checks that the machine file can be replaced. The
/// measurement takes minutes, so its results must not be lost at its end.
fn open_results(args: &IdentifyArgs, machine: &MachineFile) -> Result<ResultFolder, CliError> {
    let folder = ResultFolder::open(&folder(args.out.as_ref(), machine))?;
    if let Some(path) = args.machine.machine.as_deref().filter(|_| !args.no_write) {
        output::check_writable(path)?;
    }
    Ok(folder)
}

/// Prints what will move, and asks.
fn confirm(args: &IdentifyArgs, machine: &MachineFile, ranges: &[Travel]) -> Result<(), CliError> {
    let geometry = Geometry::new(machine);
    let model = Model::new(machine);
    print_line!("the machine homes, and then moves, one line after the other, in these ranges:");
    for line in ranges {
        let names: Vec<&str> = line
            .joints
            .iter()
            .map(|joint| machine.joints[*joint].name.as_str())
            .collect();
        let units = model.pose_units();
        let moved = geometry.ranges(line).into_iter().zip(&machine.pose);
        let moved: Vec<String> = moved
            .zip(units)
            .filter(|(((low, high), _), _)| high - low > 0.01)
            .map(|(((low, high), axis), unit)| {
                format!("{} {low:.1} to {high:.1} {unit}", axis.name)
            })
            .collect();
        let is_rotary = |joint: &usize| machine.joints[*joint].kind.is_rotary();
        let unit = if line.joints.iter().any(is_rotary) {
            "deg/s"
        } else {
            "mm/s"
        };
        print_line!(
            "  joint {}: {}, at up to {:.1} {unit}",
            names.join(", "),
            moved.join(", "),
            line.rate * args.rate
        );
    }
    let measured = torque_joints(machine);
    let others = machine.joints.iter().enumerate();
    let others = others.filter(|(joint, _)| !measured.contains(joint));
    let others: Vec<&str> = others.map(|(_, joint)| joint.name.as_str()).collect();
    if !others.is_empty() {
        print_line!(
            "not measured, because they have no torque drive with an encoder: {}",
            others.join(", ")
        );
    }
    if args.yes {
        return Ok(());
    }
    if !std::io::stdin().is_terminal() {
        let what = "standard input is no terminal to confirm the motion on; clear the ranges and \
            give --yes";
        return Err(CliError::new(Exit::Usage, what));
    }
    print!("Are they clear, and is the spindle off? Type yes: ");
    let _ = std::io::stdout().flush();
    let mut answer = String::new();
    let _ = std::io::stdin().lock().read_line(&mut answer);
    if answer.trim() == "yes" {
        return Ok(());
    }
    Err(CliError::new(Exit::Stopped, "not confirmed; nothing moved"))
}

fn move_and_measure<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    ranges: &[Travel],
) -> Result<Vec<Identified>, CliError> {
    let mut found = Vec::new();
    let mut identification = Identification::new(session, machine, options(args))?;
    identification.home()?;
    for line in ranges {
        found.extend(identification.measure(line, &mut |what| print_line!("{what}"))?);
    }
    Ok(found)
}

fn measure<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    ranges: &[Travel],
) -> Result<(), CliError> {
    session.enable()?;
    let found = move_and_measure(args, machine, session, ranges);
    // Also after an error: nobody works at the machine now. A fault has switched the drives off.
    let disabled = session.ask(Command::Disable);
    let mut found = found?;
    disabled?;
    found.sort_by_key(|it| it.joint);
    for joint in &found {
        print_line!("{}", page::summary(joint));
    }
    let date = record::today();
    let folder = folder(args.out.as_ref(), machine);
    let name = machine.config.name.as_str();
    let (text, changes) = edit::with_identified(machine, &found, &date)?;
    let data = folder.join("identified.toml");
    save(&data, &record::write(name, &date, &found))?;
    let html = folder.join("identify.html");
    save(&html, &page::identification(name, &date, &found, &changes))?;
    print_line!("data        {}", data.display());
    print_line!("page        {}", html.display());
    write(
        args.machine.machine.as_deref().filter(|_| !args.no_write),
        machine,
        (&text, changes.len()),
        &date,
    )
}

/// Writes the new text of a machine file, and prints where.
pub(super) fn write(
    path: Option<&Path>,
    machine: &MachineFile,
    (text, changes): (&str, usize),
    date: &str,
) -> Result<(), CliError> {
    let Some(path) = path else {
        print_line!("the machine file is not changed");
        return Ok(());
    };
    let backup = edit::replace(path, &machine.text, text, date)?;
    print_line!(
        "machine     {} ({changes} values changed; before: {})",
        path.display(),
        backup.display()
    );
    Ok(())
}
