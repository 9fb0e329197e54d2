//! `haptimill jog`: move at a rate for a time, with a dead-man deadline.

use super::{CliError, ConnectArgs, Exit, MachineArg, seconds};
use clap::Args;
use std::str::FromStr;

const LONG: &str = "\
Move pose coordinates at a rate for a time.

Rates are in mm/s and degrees/s: `haptimill jog x=5 theta=-2 --for 1.5`. The controller clips the motion to the soft limits, and stops by itself \
when this command falls silent for --deadline milliseconds. Ctrl-C stops.";

/// Arguments of `haptimill jog`.
#[derive(Debug, Clone, Args)]
#[command(about = "Move pose coordinates at a rate for a time", long_about = LONG)]
pub struct JogArgs {
    /// Pose coordinates and rates, mm/s or deg/s
    #[arg(
        value_name = "AXIS=RATE",
        required = true,
        allow_negative_numbers = true
    )]
    pub axes: Vec<AxisRate>,
    /// How long
    #[arg(long = "for", value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
    pub duration: f64,
    /// Dead-man: the machine stops when nothing is heard for so long
    #[arg(long, value_name = "MS", default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub deadline: u16,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// A pose coordinate and its rate.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisRate {
    /// Name of the coordinate, as in the machine file.
    pub axis: String,
    /// Rate, mm/s or deg/s; finite.
    pub rate: f64,
}

impl FromStr for AxisRate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (axis, rate) = text.split_once('=').ok_or("write AXIS=RATE, as x=5")?;
        match rate.trim().parse::<f64>() {
            Ok(rate) if rate.is_finite() && !axis.trim().is_empty() => Ok(Self {
                axis: axis.trim().to_lowercase(),
                rate,
            }),
            _ => Err("write AXIS=RATE, as x=5 or theta=-2".to_string()),
        }
    }
}

/// Jogs.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: JogArgs) -> Result<(), CliError> {
    let _ = args.machine.load()?;
    Err(CliError::new(
        Exit::Internal,
        "haptimill jog: not built yet",
    ))
}
