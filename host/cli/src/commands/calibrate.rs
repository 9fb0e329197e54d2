//! `haptimill calibrate`: measures the geometric errors of the simulated machine.

use super::args::MachineArg;
use super::interrupt;
use super::{CliError, Exit};
use clap::{Args, Subcommand};
use haptimill_calibration::calibrate::{Plan, calibrate};
use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::laser::{Environment, LaserOptions};
use haptimill_volumetric::file;
use std::path::PathBuf;

const LASER: &str = "\
Measure the geometric errors of the simulated machine with a laser interferometer, an instrument for \
roll and a square, by the cycles of ISO 230-2: each axis goes to its targets five times in each \
direction, through the controller.

Writes the 21 identified errors to FILE. `haptimill run --machine M --errors FILE` compensates with \
them. A table of a real laser in the same form (docs/volumetric.md) does the same.";

/// Subcommands of `haptimill calibrate`.
#[derive(Debug, Clone, Subcommand)]
pub enum CalibrateCommand {
    #[allow(missing_docs)]
    Laser(LaserArgs),
}

/// Arguments of `haptimill calibrate laser`.
#[derive(Debug, Clone, Args)]
#[command(about = "Measure the geometric errors of the simulated machine", long_about = LASER)]
pub struct LaserArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Error file to write
    #[arg(long, value_name = "FILE", default_value = "errors.csv")]
    pub out: PathBuf,
    /// Nominal interval of the targets, mm
    #[arg(long, value_name = "MM", default_value_t = 20.0, value_parser = interval)]
    pub interval: f64,
    /// Errors that the controller compensates while it is measured
    #[arg(long, value_name = "FILE")]
    pub errors: Option<PathBuf>,
    /// Temperature of the air, degrees Celsius
    #[arg(long, value_name = "C", default_value_t = 20.0, value_parser = temperature)]
    pub air: f64,
    /// Pressure of the air, hPa
    #[arg(long, value_name = "HPA", default_value_t = 1013.25, value_parser = pressure)]
    pub pressure: f64,
    /// Temperature of the machine, degrees Celsius
    #[arg(long, value_name = "C", default_value_t = 20.0, value_parser = temperature)]
    pub machine_temperature: f64,
    /// Do not correct the wavelength by the sensors of the air
    #[arg(long)]
    pub uncorrected: bool,
    /// There is no instrument for roll: it is taken as 0
    #[arg(long)]
    pub no_roll: bool,
    /// Instruments without noise
    #[arg(long)]
    pub no_noise: bool,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

fn number(text: &str, low: f64, high: f64, what: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok();
    let value = value.filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("write {what} from {low} to {high}"))
}

fn interval(text: &str) -> Result<f64, String> {
    number(text, 5.0, 200.0, "mm")
}

fn temperature(text: &str) -> Result<f64, String> {
    number(text, 0.0, 50.0, "degrees Celsius")
}

fn pressure(text: &str) -> Result<f64, String> {
    number(text, 500.0, 1200.0, "hPa")
}

/// Runs a calibration.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: CalibrateCommand) -> Result<(), CliError> {
    let CalibrateCommand::Laser(args) = command;
    let mut machine_file = args.machine.load()?;
    if let Some(path) = &args.errors {
        machine_file = super::args::with_errors(&machine_file, path)?;
    }
    let exact = if args.no_noise {
        LaserOptions::ideal()
    } else {
        LaserOptions::default()
    };
    let laser = LaserOptions {
        roll: exact.roll.filter(|_| !args.no_roll),
        corrects_wavelength: !args.uncorrected,
        environment: Environment {
            air_c: args.air,
            pressure_hpa: args.pressure,
            machine_c: args.machine_temperature,
            ..Environment::default()
        },
        seed: args.seed,
        ..exact
    };
    let plan = Plan {
        interval: args.interval,
        laser,
        ..Plan::default()
    };
    let mut machine = Machine::new(&machine_file, SLOW, &interrupt::flag())?;
    let calibration = calibrate(&mut machine, &machine_file, &plan, |line| {
        print_line!("{line}");
    })?;
    let report = calibration.report();
    let text = file::write(&calibration.errors, &report);
    std::fs::write(&args.out, text)
        .map_err(|error| CliError::new(Exit::Output, format!("{}: {error}", args.out.display())))?;
    print_line!("\n{report}");
    print_line!("errors      {}", args.out.display());
    Ok(())
}
