//! Arguments of the probing cycles.

use crate::commands::args::{BoardArg, ConnectArgs};
use crate::commands::jog::CoordinateValue;
use clap::{Args, Subcommand};

/// A probing cycle.
#[derive(Debug, Clone, Subcommand)]
pub enum ProbeCycle {
    /// Find an edge or a face along one coordinate, and optionally make it the zero of a work
    /// offset
    Edge(EdgeArgs),
    /// Find the centre of a bore from inside, and move there
    Bore(BoreArgs),
    /// Find the centre of a boss from above its middle, and move there
    Boss(BossArgs),
    /// Measure the length of a tool on the tool setter, and write it into the tool table
    Tool(ToolArgs),
}

/// Arguments that all cycles share.
#[derive(Debug, Clone, Args)]
pub struct CycleArgs {
    /// Feed of the measuring touch, mm/min
    #[arg(long, value_name = "FEED", default_value_t = 60.0)]
    pub feed: f64,
    /// Feed of the first touch, which finds the surface, and of the moves between, mm/min
    #[arg(long, value_name = "FEED", default_value_t = 300.0)]
    pub search_feed: f64,
    /// Distance back between the two touches, mm
    #[arg(long, value_name = "MM", default_value_t = 2.0)]
    pub back_off: f64,
    /// Input of the contact [default: the one with the function of the cycle]
    #[arg(long, value_name = "NAME")]
    pub input: Option<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// The work offset that a cycle sets.
#[derive(Debug, Clone, Args)]
pub struct ZeroArgs {
    /// Set the origin of this work coordinate system there: g54 to g59, g59.1 to g59.3; needs
    /// --machine
    #[arg(long, value_name = "SYSTEM")]
    pub set: Option<String>,
    /// With --set: the coordinate that the edge or the centre gets, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.0,
        requires = "set",
        allow_negative_numbers = true
    )]
    pub to: f64,
}

/// Arguments of `haptimill probe edge`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Find an edge or a face along one coordinate",
    long_about = "Find an edge or a face along one coordinate: `haptimill probe edge z=-20 --radius 0` \
                  moves down by at most 20 mm until the probe touches, goes back, touches again \
                  slowly, and returns to its start. The printed position is that of the surface: \
                  the contact and the radius of the ball."
)]
pub struct EdgeArgs {
    /// Coordinate and largest distance with its sign, mm, as x=10 or z=-20
    #[arg(value_name = "COORDINATE=DISTANCE", allow_negative_numbers = true)]
    pub coordinate: CoordinateValue,
    /// Radius of the ball of the probe along the axis, mm; 0 if the tip itself touches, as along Z
    /// with a tool that was measured with its tip
    #[arg(long, value_name = "MM")]
    pub radius: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub zero: ZeroArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Arguments of `haptimill probe bore`.
#[derive(Debug, Clone, Args)]
pub struct BoreArgs {
    /// Largest distance from the start to the wall, mm
    #[arg(long, value_name = "MM")]
    pub reach: f64,
    /// Radius of the ball of the probe, mm; the diameter depends on it, the centre does not
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    pub radius: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub zero: ZeroArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Arguments of `haptimill probe boss`.
#[derive(Debug, Clone, Args)]
pub struct BossArgs {
    /// Size of the boss along x and y, mm, as 40x35, or its diameter
    #[arg(long, value_name = "MM[xMM]", value_parser = size)]
    pub size: [f64; 2],
    /// Distance down beside the boss, mm
    #[arg(long, value_name = "MM")]
    pub depth: f64,
    /// Distance from the wall at which the probe goes down, ball included, mm
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    pub clearance: f64,
    /// Radius of the ball of the probe, mm; the size depends on it, the centre does not
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    pub radius: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub zero: ZeroArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Arguments of `haptimill probe tool`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Measure the length of a tool on the tool setter",
    long_about = "Measure the length of a tool on the tool setter, and write it into the tool \
                  table beside the machine file.\n\nThe tool must be above the setter. The command \
                  moves down to the contact, goes back, touches again slowly, and returns. The \
                  length is the machine's Z at the contact less --height, the Z at which a tool of \
                  length 0 touches: that of the reference tool."
)]
pub struct ToolArgs {
    /// Number of the tool
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=99_999))]
    pub tool: u32,
    /// Machine Z at which the reference tool touches the setter, mm
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub height: f64,
    /// Largest distance down, mm
    #[arg(long, value_name = "MM", default_value_t = 50.0)]
    pub reach: f64,
    /// Diameter to write with it, mm [default: that of the table]
    #[arg(long, value_name = "MM")]
    pub diameter: Option<f64>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub cycle: CycleArgs,
}

/// Parses `40x35` or `40`.
fn size(text: &str) -> Result<[f64; 2], String> {
    let (x, y) = text.split_once('x').unwrap_or((text, text));
    match (x.parse::<f64>(), y.parse::<f64>()) {
        (Ok(x), Ok(y)) if x > 0.0 && y > 0.0 && x < 1e4 && y < 1e4 => Ok([x, y]),
        _ => Err("write the size in mm, as 40x35, or a diameter".to_string()),
    }
}

impl ProbeCycle {
    /// Whether standard output is JSON.
    pub(in crate::commands) const fn is_json(&self) -> bool {
        self.shared().json
    }

    /// The work offset to set; none of a cycle that sets no offset.
    pub(super) const fn zero(&self) -> Option<&ZeroArgs> {
        match self {
            Self::Edge(args) => Some(&args.zero),
            Self::Bore(args) => Some(&args.zero),
            Self::Boss(args) => Some(&args.zero),
            Self::Tool(_) => None,
        }
    }

    pub(super) const fn shared(&self) -> &CycleArgs {
        match self {
            Self::Edge(args) => &args.cycle,
            Self::Bore(args) => &args.cycle,
            Self::Boss(args) => &args.cycle,
            Self::Tool(args) => &args.cycle,
        }
    }
}
