//! `haptimill tune`: gains from identified joints.

use super::args::MachineArg;
use super::identify_args::{folder, save, write};
use super::{CliError, Exit};
use clap::Args;
use haptimill_firmware::config::{Drive, ServoConfig};
use haptimill_identify::identify::{Identified, inertia_of};
use haptimill_identify::measure::count_of;
use haptimill_identify::page::{Tuned, margins, tuning};
use haptimill_identify::servo_loop::Gains;
use haptimill_identify::tune::{Joint, Requirement};
use haptimill_identify::{edit, record};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::PER_GAIN;
use std::path::PathBuf;

const LONG: &str = "\
Propose gains of the position loops from what `haptimill identify` measured: the fastest loop that \
keeps the margins, around both masses of a joint and around its motor alone.

Nothing moves. It writes the page OUT/tune.html with margins and step responses before and after. \
With --write it writes the gains into the machine file; the file before is kept beside it.";

/// Arguments of `haptimill tune`.
#[derive(Debug, Clone, Args)]
#[command(about = "Propose gains from the identified joints, with margins and step responses",
          long_about = LONG)]
pub struct TuneArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Folder of `haptimill identify`, and of the page [default: the name of the machine with
    /// .identify]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Smallest gain margin, dB
    #[arg(long, value_name = "DB", default_value_t = 6.0, value_parser = decibel)]
    pub gain_margin: f64,
    /// Smallest phase margin, degrees
    #[arg(long, value_name = "DEG", default_value_t = 40.0, value_parser = degrees)]
    pub phase_margin: f64,
    /// Write the gains into the machine file
    #[arg(long, requires = "machine")]
    pub write: bool,
}

fn within(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value = text.parse::<f64>().ok();
    let value = value.filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("write a number from {low} to {high}"))
}

fn decibel(text: &str) -> Result<f64, String> {
    within(text, 2.0, 30.0)
}

fn degrees(text: &str) -> Result<f64, String> {
    within(text, 20.0, 75.0)
}

/// Gains of a machine file.
fn gains_of(machine: &MachineFile, joint: usize) -> Gains {
    let law: &ServoConfig = &machine.config.joints[joint].law;
    Gains {
        kp: f64::from(law.kp.0) / PER_GAIN,
        kd: f64::from(law.kd.0) / PER_GAIN,
        ki: f64::from(law.ki.0) / PER_GAIN,
        rate_filter: f64::from(law.rate_filter_us) * 1e-6,
        inertia: inertia_of(machine, joint),
    }
}

/// The joint with its gains and the proposed ones.
fn tuned(
    machine: &MachineFile,
    found: &Identified,
    requirement: &Requirement,
) -> Result<Tuned, CliError> {
    let limit = match machine.config.joints[found.joint].drive {
        Drive::Torque { limit, .. } => f64::from(limit.0) / 65536.0,
        Drive::Steps { .. } => {
            let what = format!(
                "joint {} has a step drive, which has no gains; run `haptimill identify` again",
                found.name
            );
            return Err(CliError::new(Exit::BadInput, what));
        }
    };
    let joint = Joint {
        plant: found.plant,
        period: f64::from(machine.config.period_us) * 1e-6,
        count: count_of(machine, found.joint),
        limit,
    };
    let proposed = joint.propose(requirement).ok_or_else(|| {
        let what = format!(
            "joint {}: no gains keep {} dB and {} degrees; lower --gain-margin or --phase-margin, \
             or look for looseness: its resonance is at {:.1} Hz",
            found.name, requirement.gain_db, requirement.phase_deg, found.plant.mode_hz
        );
        CliError::new(Exit::Refused, what)
    })?;
    let before = gains_of(machine, found.joint);
    Ok(Tuned {
        name: found.name.clone(),
        kind: found.kind,
        joint,
        misses: joint.misses(&before, requirement),
        gains: [before, proposed],
        coulomb: found.coulomb(),
    })
}

/// Proposes gains.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: &TuneArgs) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    let folder = folder(args.out.as_ref(), &machine);
    let data = folder.join("identified.toml");
    let text = haptimill_machine_file::read_text(&data).map_err(|problems| {
        let what = format!("{problems}\nrun `haptimill identify` first");
        CliError::new(Exit::BadInput, what)
    })?;
    let found = record::read(&data.display().to_string(), &text, &machine)?;
    let requirement = Requirement {
        gain_db: args.gain_margin,
        phase_deg: args.phase_margin,
        ..Requirement::default()
    };
    let joints = found
        .iter()
        .map(|found| tuned(&machine, found, &requirement))
        .collect::<Result<Vec<_>, _>>()?;
    for joint in &joints {
        let [before, after] = margins(joint);
        print_line!("{}", joint.name);
        print_line!("  before  {before}");
        print_line!("          {}", joint.verdict());
        print_line!("  after   {after}");
    }
    let date = record::today();
    let gains: Vec<_> = joints
        .iter()
        .map(|it| (it.name.clone(), it.gains[1]))
        .collect();
    let (text, changes) = edit::with_gains(&machine, &gains, &date)?;
    let html = folder.join("tune.html");
    let name = machine.config.name.as_str();
    save(&html, &tuning(name, &date, &joints, &changes))?;
    print_line!("page        {}", html.display());
    let path = args.machine.machine.as_deref().filter(|_| args.write);
    write(path, &machine, (&text, changes.len()), &date)
}
