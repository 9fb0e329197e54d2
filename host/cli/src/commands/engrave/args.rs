//! Arguments of `haptimill engrave`.

use super::super::{CliError, Exit, output};
use clap::{Args, ValueEnum};
use haptimill_engrave::drawing::short;
use haptimill_engrave::geometry::Point;
use haptimill_engrave::job::{Operation, Options, Ordering, Side};
use haptimill_engrave::shape::Clearing;
use haptimill_engrave::times::Speeds;
use haptimill_engrave::toolpath::Tabs;
use std::path::{Path, PathBuf};

const LONG: &str = "\
Write the part program that engraves a drawing.

DRAWING is an ASCII DXF or an SVG. Lines and arcs stay what they are; splines, ellipses and Bezier \
curves become arcs within 0.0025 mm. Whatever is left out of the drawing is reported. Text becomes \
outlines of the font of --font, or is refused.

The top of the plate is Z0. The origin is that of the drawing: in an SVG the lower left corner of the \
page. --origin and --at move it. The tool starts and ends above X0 Y0.

The order of the paths is the shortest that is found: open paths may be reversed, closed paths may \
start anywhere. --order greedy uses the four conditions of Mitravakin (2002) instead.";

/// Names of [`Operation`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OperationName {
    /// Trace the paths
    Outline,
    /// Clear what closed paths enclose; paths in it are islands
    Pocket,
    /// Drill at points and at the centres of circles
    Drill,
}

/// Names of [`Side`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SideName {
    /// The centre of the tool is on the path
    On,
    /// The tool runs outside of closed paths: the enclosed material remains
    Outside,
    /// The tool runs inside of closed paths: the enclosed material is removed
    Inside,
}

/// Names of [`Ordering`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OrderName {
    /// The shortest that is found
    Short,
    /// The best of file order and four greedy conditions, without reversal
    Greedy,
    /// As in the file
    File,
}

/// Names of [`Clearing`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ClearName {
    /// Contours at equal distances from the boundary
    Contour,
    /// Rows in alternating directions, and the contour
    Zigzag,
    /// Rows in one direction, and the contour
    OneWay,
}

/// Where the origin of the drawing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OriginName {
    /// That of the file
    Drawing,
    /// The lower left corner of what is cut
    LowerLeft,
    /// The middle of what is cut
    Centre,
}

/// Width of a tab without --tab-width, mm.
const TAB_WIDTH: f64 = 2.0;

/// Height of a tab without --tab-height, mm.
const TAB_HEIGHT: f64 = 0.5;

/// Distance of rows without --overlap.
const OVERLAP: f64 = 0.5;

/// Arguments of `haptimill engrave`.
#[derive(Debug, Clone, Args)]
#[command(about = "Write the part program that engraves a drawing", long_about = LONG)]
pub struct EngraveArgs {
    /// Drawing: ASCII DXF or SVG
    #[arg(value_name = "DRAWING")]
    pub drawing: PathBuf,
    /// What is done with the paths
    #[arg(long, value_enum, default_value_t = OperationName::Outline)]
    pub operation: OperationName,
    /// Diameter of the tool, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 1.0,
        allow_negative_numbers = true
    )]
    pub tool: f64,
    /// Depth below the surface, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 1.0,
        allow_negative_numbers = true
    )]
    pub depth: f64,
    /// Largest depth of a pass, mm [default: the diameter of the tool]
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub step_down: Option<f64>,
    /// Feed along the paths, mm/min
    #[arg(
        long,
        value_name = "MM/MIN",
        default_value_t = 300.0,
        allow_negative_numbers = true
    )]
    pub feed: f64,
    /// Feed of plunges, mm/min
    #[arg(
        long,
        value_name = "MM/MIN",
        default_value_t = 60.0,
        allow_negative_numbers = true
    )]
    pub plunge: f64,
    /// Spindle speed, rev/min; 0 for a pen
    #[arg(
        long,
        value_name = "REV/MIN",
        default_value_t = 10_000.0,
        allow_negative_numbers = true
    )]
    pub speed: f64,
    /// Height of lifted moves above the plate, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 1.0,
        allow_negative_numbers = true
    )]
    pub lift: f64,
    /// Outline: where the tool runs beside closed paths
    #[arg(long, value_enum, default_value_t = SideName::On)]
    pub side: SideName,
    /// Order of the paths of an outline
    #[arg(long, value_enum, default_value_t = OrderName::Short)]
    pub order: OrderName,
    /// Pocket: how it is cleared
    #[arg(long, value_enum, default_value_t = ClearName::Contour)]
    pub clear: ClearName,
    /// Pocket: distance of rows or contours as a fraction of the tool's diameter
    #[arg(
        long,
        value_name = "PART",
        default_value_t = OVERLAP,
        allow_negative_numbers = true
    )]
    pub overlap: f64,
    /// Pocket: angle of the rows, degrees
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 0.0,
        allow_hyphen_values = true
    )]
    pub angle: f64,
    /// Leave this material at the walls for a last pass, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub finish: f64,
    /// Descend along the path at this angle, degrees [default: plunge]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub ramp: Option<f64>,
    /// Radius of the arcs that lead onto contours, mm; with --side outside or inside
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub lead: Option<f64>,
    /// Holding tabs on each closed contour
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub tabs: Option<usize>,
    /// Width of a tab, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = TAB_WIDTH,
        allow_negative_numbers = true
    )]
    pub tab_width: f64,
    /// Height of a tab above the floor, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = TAB_HEIGHT,
        allow_negative_numbers = true
    )]
    pub tab_height: f64,
    /// Conventional (up-cut) milling [default: climb milling]
    #[arg(long)]
    pub conventional: bool,
    /// Join ends of paths that are at most this far apart, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 0.01,
        allow_negative_numbers = true
    )]
    pub join: f64,
    /// Only this layer; repeatable
    #[arg(long, value_name = "NAME")]
    pub layer: Vec<String>,
    /// Not this layer; repeatable
    #[arg(long, value_name = "NAME")]
    pub without_layer: Vec<String>,
    /// Unit of the drawing: mm, cm, inch, pt, or millimetres per unit [default: the file's]
    #[arg(long, value_name = "UNIT", value_parser = unit, allow_hyphen_values = true)]
    pub unit: Option<f64>,
    /// Factor of the drawing's size
    #[arg(
        long,
        value_name = "FACTOR",
        default_value_t = 1.0,
        allow_negative_numbers = true
    )]
    pub scale: f64,
    /// Point of the drawing that is placed at --at
    #[arg(long, value_enum, default_value_t = OriginName::Drawing)]
    pub origin: OriginName,
    /// Position of that point, mm
    #[arg(long, value_name = "X,Y", default_value = "0,0", value_parser = place)]
    #[arg(allow_hyphen_values = true)]
    pub at: Place,
    /// Font of text: a TrueType or OpenType file
    #[arg(long, value_name = "FILE")]
    pub font: Option<PathBuf>,
    /// Leave text without a font out, with a notice
    #[arg(long)]
    pub skip_text: bool,
    /// Cut elements with a clip path or a mask whole, with a notice; without it they are refused
    #[arg(long)]
    pub ignore_clips: bool,
    /// Machine file, for the area and the rapid speed [default: the built-in
    /// machines/engraver.toml]
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Part program to write [default: the drawing's name with .ngc]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write a page that shows the job before it is cut
    #[arg(long, value_name = "FILE")]
    pub preview: Option<PathBuf>,
    /// Cut the plate on the simulated machine, and compare its surface with the drawing
    #[arg(long)]
    pub run: bool,
    /// Print the result as JSON on standard output
    #[arg(long)]
    pub json: bool,
}

/// A point of the plate, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place(pub Point);

fn place(text: &str) -> Result<Place, String> {
    let parsed = text.split_once(',').and_then(|(x, y)| {
        let number = |word: &str| {
            word.trim()
                .parse()
                .ok()
                .filter(|value: &f64| value.is_finite())
        };
        Some(Place([number(x)?, number(y)?]))
    });
    parsed.ok_or_else(|| "write X,Y in mm, as 10,20".to_string())
}

/// Whether two files that need not exist have the same folder and name. A device is no file.
fn is_same_place(one: &Path, other: &Path) -> bool {
    let place = |path: &Path| {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(folder.join(path.file_name()?))
    };
    let is_device = one.exists() && !one.is_file();
    !is_device && place(one).is_some_and(|one| place(other) == Some(one))
}

fn unit(text: &str) -> Result<f64, String> {
    Ok(match text.to_lowercase().as_str() {
        "mm" => 1.0,
        "cm" => 10.0,
        "m" => 1000.0,
        "inch" | "in" => 25.4,
        "pt" => 25.4 / 72.0,
        "px" => 25.4 / 96.0,
        other => other
            .parse::<f64>()
            .ok()
            .filter(|value| *value > 0.0 && value.is_finite())
            .ok_or("write mm, cm, m, inch, pt, px, or millimetres per unit")?,
    })
}

impl EngraveArgs {
    /// Options of the job.
    pub(super) fn options(&self) -> Options {
        Options {
            operation: match self.operation {
                OperationName::Outline => Operation::Outline,
                OperationName::Pocket => Operation::Pocket,
                OperationName::Drill => Operation::Drill,
            },
            side: match self.side {
                SideName::On => Side::On,
                SideName::Outside => Side::Outside,
                SideName::Inside => Side::Inside,
            },
            ordering: match self.order {
                OrderName::Short => Ordering::Short,
                OrderName::Greedy => Ordering::Greedy,
                OrderName::File => Ordering::File,
            },
            clearing: match self.clear {
                ClearName::Contour => Clearing::Contour,
                ClearName::Zigzag => Clearing::Zigzag,
                ClearName::OneWay => Clearing::OneWay,
            },
            tool_mm: self.tool,
            depth_mm: self.depth,
            step_mm: self.step_down.unwrap_or(self.tool),
            overlap: self.overlap,
            angle_deg: self.angle,
            finish_mm: self.finish,
            ramp_deg: self.ramp,
            lead_mm: self.lead,
            tabs: self.tabs.map(|count| Tabs {
                count,
                width_mm: self.tab_width,
                height_mm: self.tab_height,
            }),
            conventional: self.conventional,
            join_mm: self.join,
            reference: [0.0; 2],
            speeds: Speeds::default(),
        }
    }

    /// Refuses options that make no job, or contradict each other.
    pub(super) fn check(&self) -> Result<(), CliError> {
        let usage = |what: String| Err(CliError::new(Exit::Usage, what));
        let with_tabs = |value| self.tabs.map(|_| value);
        let positive = [
            ("--feed", Some(self.feed)),
            ("--plunge", Some(self.plunge)),
            ("--lift", Some(self.lift)),
            ("--scale", Some(self.scale)),
            ("--lead", self.lead),
            ("--tab-width", with_tabs(self.tab_width)),
            ("--tab-height", with_tabs(self.tab_height)),
        ];
        for (option, value) in positive {
            if let Some(value) = value
                && !(value > 0.0 && value.is_finite())
            {
                return usage(format!("{option} {}: it must be above 0", short(value)));
            }
        }
        if !(self.finish >= 0.0 && self.join >= 0.0 && self.speed >= 0.0) {
            return usage("--finish, --join and --speed must not be negative".into());
        }
        if !self.angle.is_finite() {
            return usage("--angle must be a number of degrees".into());
        }
        let outline = self.operation == OperationName::Outline;
        let pocket = self.operation == OperationName::Pocket;
        let beside = outline && self.side != SideName::On;
        let tabs = [(self.tab_width, TAB_WIDTH), (self.tab_height, TAB_HEIGHT)];
        let misplaced = [
            (
                self.side != SideName::On && !outline,
                "--side is for --operation outline",
            ),
            (
                self.order != OrderName::Short && (!outline || beside),
                "--order is for --operation outline with --side on",
            ),
            (
                self.lead.is_some() && !beside,
                "--lead needs --side outside or --side inside",
            ),
            (
                self.tabs.is_some() && !outline,
                "--tabs is for --operation outline",
            ),
            (
                self.tabs.is_some() && self.order != OrderName::Short,
                "--tabs needs --order short: the other orders cut chains as single lines, which \
                 have no tabs",
            ),
            (
                self.tabs.is_none() && tabs.iter().any(|(given, usual)| given != usual),
                "--tab-width and --tab-height need --tabs",
            ),
            (
                self.clear != ClearName::Contour && !pocket,
                "--clear is for --operation pocket",
            ),
            (
                self.overlap != OVERLAP && !pocket,
                "--overlap is for --operation pocket",
            ),
            (
                self.angle != 0.0 && (!pocket || self.clear == ClearName::Contour),
                "--angle needs --operation pocket and --clear zigzag or one-way",
            ),
            (
                self.finish != 0.0 && !pocket && !beside,
                "--finish needs --operation pocket, or --side outside or inside",
            ),
            (
                self.conventional && !pocket && !beside,
                "--conventional needs --operation pocket, or --side outside or inside",
            ),
            (
                self.ramp.is_some() && !pocket && !outline,
                "--ramp is for --operation outline or pocket",
            ),
        ];
        match misplaced.iter().find(|(misplaced, _)| *misplaced) {
            Some((_, what)) => usage((*what).to_string()),
            None => self
                .options()
                .check()
                .map_err(|what| CliError::new(Exit::Usage, what)),
        }
    }

    /// Refuses outputs that are inputs of the command, or each other.
    pub(super) fn keep_inputs(&self) -> Result<(), CliError> {
        let inputs = [
            (Some(&self.drawing), "drawing"),
            (self.font.as_ref(), "font"),
            (self.machine.as_ref(), "machine file"),
        ];
        let out = self.out();
        for (input, what) in inputs {
            let Some(input) = input else { continue };
            output::refuse_overwrite(input, &out, what)?;
            if let Some(preview) = &self.preview {
                output::refuse_overwrite(input, preview, what).map_err(|_| {
                    let file = preview.display();
                    let what = format!(
                        "{file}: the {what} would be overwritten; name another file with --preview"
                    );
                    CliError::new(Exit::Usage, what)
                })?;
            }
        }
        let Some(preview) = &self.preview else {
            return Ok(());
        };
        let is_same = is_same_place(&out, preview)
            || output::refuse_overwrite(&out, preview, "program").is_err();
        if is_same {
            let what = format!(
                "{}: the program and the preview are the same file; name another file with --preview",
                preview.display()
            );
            return Err(CliError::new(Exit::Usage, what));
        }
        Ok(())
    }

    /// The part program to write.
    pub(super) fn out(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| {
            let mut name = self.drawing.file_stem().unwrap_or_default().to_os_string();
            name.push(".ngc");
            PathBuf::from(name)
        })
    }
}

impl OperationName {
    /// Name as on the command line.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Outline => "outline",
            Self::Pocket => "pocket",
            Self::Drill => "drill",
        }
    }
}
