//! Arguments of `haptimill identify`, and the output of its measurements.

use super::args::{BoardArg, PortArgs};
use super::{CliError, output};
use clap::Args;
use haptimill_client::port::PortSpec;
use haptimill_identify::edit::{self, Change};
use haptimill_identify::identify::Options;
use haptimill_machine_file::MachineFile;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const LONG: &str = "\
Measure the joints of a machine.

Joints with torque drives: inertia, Coulomb friction in both directions, viscous friction, resonance. \
The joint moves at constant rates in both directions, and with sines on top of a slow constant rate. \
Effort and motion come from the telemetry of the controller.

Joints with step drives, a home switch and no encoder: the largest rate and acceleration without lost \
steps, and rates at which a resonance causes lost steps. Each test moves the joint, and homes: lost steps \
shift the count at which the switch trips. 70 % of the limits are proposed.

With --lost-motion each joint moves to the same position from below and from above, five times, and \
a dial gauge measures the driven part. The simulated machine has one; on others the command asks for \
each reading.

With --index the machine searches its index pulses five times in each direction. The positions of \
the pulses, relative to the presets at power-on, and their slack go into the machine file.

The machine homes, then moves along the printed ranges. Nothing may be in these ranges, and the spindle \
is at rest. The command asks before anything moves. Ctrl-C stops.

It writes OUT/identified.toml, the page OUT/identify.html, and the values into the machine file; the \
file before is kept beside it. Comments in the file stay.";

/// Arguments of `haptimill identify`.
#[derive(Debug, Clone, Args)]
#[command(about = "Measure inertia, friction and resonance of the joints, and limits of step motors, \
                   and write them into the machine file", long_about = LONG)]
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
    /// Fraction of the maximum rate that a joint reaches
    #[arg(long, value_name = "PART", default_value_t = 0.8, value_parser = part)]
    pub rate: f64,
    /// Highest frequency of the sines, Hz
    #[arg(long, value_name = "HZ", default_value_t = 200.0, value_parser = highest)]
    pub highest: f64,
    /// Maximum rate and acceleration in the test for lost steps, as a multiple of those of the
    /// machine file [default: 1.43, so that 70 % of it are those of the machine file]
    #[arg(long, value_name = "FACTOR", value_parser = beyond)]
    pub beyond: Option<f64>,
    /// Measure this joint only; more than once for several joints
    #[arg(long = "joint", value_name = "NAME")]
    pub joints: Vec<String>,
    /// Measure only the lost motion of the joints, with a dial gauge, and write it as backlash. The
    /// simulated machine has a gauge; on others the command asks for readings
    #[arg(long)]
    pub lost_motion: bool,
    /// Measure only the positions of the index pulses and their slack, by repeated reference
    /// searches
    #[arg(long, conflicts_with = "lost_motion")]
    pub index: bool,
    /// Reading of the gauge, mm or degrees, in place of a question; give all, in the order of the
    /// motions
    #[arg(
        long = "reading",
        value_name = "MM",
        requires = "lost_motion",
        allow_negative_numbers = true
    )]
    pub readings: Vec<f64>,
    /// Folder of the results [default: the name of the machine with .identify]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the results as JSON; the progress goes to standard error
    #[arg(long, requires = "yes")]
    pub json: bool,
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

fn beyond(text: &str) -> Result<f64, String> {
    number(text, 0.1, 20.0)
}

/// Prints what happens; with --json on standard error.
pub(super) fn say(args: &IdentifyArgs, what: &str) {
    if args.json {
        eprintln!("{what}");
    } else {
        print_line!("{what}");
    }
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

pub(super) fn options(args: &IdentifyArgs) -> Options {
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

/// Writes the machine file, and prints what changed: as JSON in `value`, or as text.
pub(super) fn finish(
    args: &IdentifyArgs,
    machine: &MachineFile,
    mut value: Value,
    (text, changes): (&str, &[Change]),
    date: &str,
) -> Result<(), CliError> {
    let path = args.machine.machine.as_deref().filter(|_| !args.no_write);
    if !args.json {
        return write(path, machine, (text, changes.len()), date);
    }
    let path = path.filter(|_| !changes.is_empty());
    let backup = path
        .map(|path| edit::replace(path, &machine.text, text, date))
        .transpose()?;
    let changes = changes
        .iter()
        .map(|it| json!({ "key": it.key, "before": it.before, "after": it.after }));
    value["changes"] = changes.collect();
    value["written"] = json!(path);
    value["before"] = json!(backup);
    print_line!("{value:#}");
    Ok(())
}

/// Writes the new text of a machine file, and prints where.
pub(super) fn write(
    path: Option<&Path>,
    machine: &MachineFile,
    (text, changes): (&str, usize),
    date: &str,
) -> Result<(), CliError> {
    let Some(path) = path.filter(|_| changes > 0) else {
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
