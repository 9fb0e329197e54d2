//! Arguments of `haptimill facet`.

use clap::{Args, Subcommand, ValueEnum};
use haptimill_facet::{Mode, Reading, Rough};
use haptimill_hil_sim::process::grinding::HardSpot;
use std::path::PathBuf;

const CHECK_LONG: &str = "\
Check a gem design. It is cut, plane by plane, out of its rough; a facet that cannot be cut is \
refused by line and name, as is a design that does not close or is larger than the rough, and a \
facet that the machine cannot reach.

It prints the tiers with angle and positions of the wheel, the size of the stone, and its meet \
points. --json has every facet.

Designs are GemCad ASCII files (.asc), or lists of facets (.toml, .csv) with depths in mm; \
docs/faceting.md has both formats.";

const RUN_LONG: &str = "\
Cut a gem in the simulator. All facets of a side are ground on one lap after the other, then the \
stone is turned over. The folder of results gets
  report.html  the stone in 3D, facets and meet points against the design, times and forces
  stone.json   the same figures
  job.ngc      the job as one part program
A stone that lacks facets of the design, has other faces, or is out of tolerance (0.02 degrees for \
a facet, 0.02 mm for a meet point) is an error (exit code 6); the files are written.

With --by feed the feed of the lap moves the stone to its depth. With --by force the stone \
complies above the force of the lap, and reaches its depth as material is removed. --by both does \
both.";

/// Commands of `haptimill facet`.
#[derive(Debug, Clone, Subcommand)]
pub enum FacetCommand {
    /// Check a gem design, and print its tiers, size and meet points
    #[command(long_about = CHECK_LONG)]
    Check(CheckArgs),
    /// Write the job of a design as a part program
    Plan(PlanArgs),
    /// Cut a gem in the simulator
    #[command(long_about = RUN_LONG)]
    Run(Box<RunArgs>),
    /// Compute the lengths of the arm from three readings of its tip
    Calibrate(CalibrateArgs),
}

impl FacetCommand {
    /// Whether standard output is JSON.
    #[must_use]
    pub fn is_json(&self) -> bool {
        match self {
            Self::Check(args) => args.json,
            Self::Run(args) => args.json,
            Self::Plan(_) => false,
            Self::Calibrate(args) => args.json,
        }
    }
}

/// A design and its rough.
#[derive(Debug, Clone, Args)]
pub struct DesignArgs {
    /// Gem design (.asc, .toml, .csv)
    #[arg(value_name = "DESIGN")]
    pub design: PathBuf,
    /// Width of the stone, the smaller one of x and y; a list has its size in mm
    #[arg(long, value_name = "MM", default_value_t = 6.0, value_parser = millimetres)]
    pub width: f64,
    /// Rough, a round preform [default: 8 % larger than the stone]
    #[arg(long, value_name = "DIAMETERxHEIGHT", value_parser = rough)]
    pub rough: Option<Rough>,
}

/// Laps of a job, and its machine.
#[derive(Debug, Clone, Args)]
pub struct JobArgs {
    /// Laps, a TOML file of `[[lap]]` [default: 260, 1200 and polish for quartz]
    #[arg(long, value_name = "FILE")]
    pub laps: Option<PathBuf>,
    /// How facets are ground
    #[arg(long, value_enum, default_value = "feed")]
    pub by: By,
    /// Machine file [default: the built-in faceting machine]
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
}

/// How facets are ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum By {
    /// By feed to the depth
    Feed,
    /// By force to the depth
    Force,
    /// By feed; above the force of the lap the stone complies
    Both,
}

impl By {
    pub(super) const fn mode(self) -> Mode {
        match self {
            Self::Feed => Mode::Feed,
            Self::Force => Mode::Force,
            Self::Both => Mode::Both,
        }
    }
}

/// Arguments of `haptimill facet check`.
#[derive(Debug, Clone, Args)]
pub struct CheckArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub design: DesignArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub job: JobArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `haptimill facet plan`.
#[derive(Debug, Clone, Args)]
pub struct PlanArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub design: DesignArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub job: JobArgs,
    /// Part program; - is standard output
    #[arg(short, long, value_name = "FILE", default_value = "-")]
    pub out: PathBuf,
}

/// Arguments of `haptimill facet run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub design: DesignArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub job: JobArgs,
    /// Folder for the results [default: the design's name with .out]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Seed of the simulated machine
    #[arg(long)]
    pub seed: Option<u64>,
    /// Run-out of the laps
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = small)]
    pub run_out: f64,
    /// Stiffness of the bed of the laps [default: 200]
    #[arg(long, value_name = "N/MM3", value_parser = bed)]
    pub bed: Option<f64>,
    /// Volume that a lap loses, divided by the volume that it removes from the stone
    #[arg(long, value_name = "PART", default_value_t = 0.0, value_parser = small)]
    pub wear: f64,
    /// Hard ball in the stone: centre x,y,z, radius, and its removal divided by that of the stone
    #[arg(long, value_name = "X,Y,Z,RADIUS,PART", allow_hyphen_values = true, value_parser = hard_spot)]
    pub hard_spot: Option<HardSpot>,
    /// Cut the design a second time, ground in this way, and show both side by side
    #[arg(long, value_enum, value_name = "BY")]
    pub beside: Option<By>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Print no progress
    #[arg(long)]
    pub quiet: bool,
}

/// Arguments of `haptimill facet calibrate`.
#[derive(Debug, Clone, Args)]
pub struct CalibrateArgs {
    /// Tip at theta2 = 0: p_x, and p_z less d1 if it was read
    #[arg(long, value_name = "X[,Z]", allow_hyphen_values = true, value_parser = reading)]
    pub at_0: Reading,
    /// Tip at theta2 = 90 degrees
    #[arg(long, value_name = "X[,Z]", allow_hyphen_values = true, value_parser = reading)]
    pub at_90: Reading,
    /// Tip at theta2 = 180 degrees
    #[arg(long, value_name = "X[,Z]", allow_hyphen_values = true, value_parser = reading)]
    pub at_180: Reading,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

fn numbers(text: &str, separator: char) -> Result<Vec<f64>, String> {
    text.split(separator)
        .map(|part| match part.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("\"{part}\" is no number")),
        })
        .collect()
}

fn millimetres(text: &str) -> Result<f64, String> {
    match numbers(text, ' ')?[..] {
        [value] if (0.5..=60.0).contains(&value) => Ok(value),
        _ => Err("write 0.5 to 60 mm".to_string()),
    }
}

fn small(text: &str) -> Result<f64, String> {
    match numbers(text, ' ')?[..] {
        [value] if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("write 0 to 1".to_string()),
    }
}

fn bed(text: &str) -> Result<f64, String> {
    match numbers(text, ' ')?[..] {
        [value] if (1.0..=1e5).contains(&value) => Ok(value),
        _ => Err("write 1 to 100000 N/mm^3".to_string()),
    }
}

fn rough(text: &str) -> Result<Rough, String> {
    match numbers(text, 'x')?[..] {
        [diameter_mm, height_mm]
            if (0.5..=100.0).contains(&diameter_mm) && (0.5..=60.0).contains(&height_mm) =>
        {
            Ok(Rough {
                diameter_mm,
                height_mm,
            })
        }
        _ => Err("write DIAMETERxHEIGHT in mm, at most 100x60".to_string()),
    }
}

fn hard_spot(text: &str) -> Result<HardSpot, String> {
    match numbers(text, ',')?[..] {
        [x, y, z, radius_mm, part] if radius_mm > 0.0 && part > 0.0 && part <= 1.0 => {
            Ok(HardSpot {
                centre: [x, y, z],
                radius_mm,
                part,
            })
        }
        _ => Err("write X,Y,Z,RADIUS,PART; radius above 0, part above 0 to 1".to_string()),
    }
}

fn reading(text: &str) -> Result<Reading, String> {
    match numbers(text, ',')?[..] {
        [x] => Ok(Reading { x, z: None }),
        [x, z] => Ok(Reading { x, z: Some(z) }),
        _ => Err("write X or X,Z in mm".to_string()),
    }
}
