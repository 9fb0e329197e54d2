//! `haptimill facet`: from a gem design to a cut stone.

use super::run::results::ResultFolder;
use super::{CliError, Exit, interrupt, output};
use clap::{Args, Subcommand, ValueEnum};
use haptimill_facet::{
    Cutting, Design, Gem, Job, JobSettings, Lap, Mode, Reading, Rough, RunOptions, calibrate,
    check_machine, coolant, cut, most_force_n, read, report,
};
use haptimill_hil_sim::process::grinding::HardSpot;
use haptimill_machine_file::{MachineFile, input};
use serde_json::json;
use std::path::{Path, PathBuf};

const CHECK_LONG: &str = "\
Check a gem design. It is cut, plane by plane, out of its rough; a facet that cannot be cut is \
refused by line and name, as is a design that does not close or is larger than the rough, and a \
facet that the machine cannot reach.

Designs are GemCad ASCII files (.asc), or lists of facets (.toml, .csv) with depths in mm; \
docs/faceting.md has both formats.";

const RUN_LONG: &str = "\
Cut a gem in the simulator. All facets of a side are ground on one lap after the other, then the \
stone is turned over. The folder of results gets
  report.html  the stone in 3D, facets and meet points against the design, times and forces
  stone.json   the same figures
  job.ngc      the job as one part program

With --by feed the feed of the lap moves the stone to its depth. With --by force the stone \
complies above the force of the lap, and reaches its depth as material is removed. --by both does \
both.";

/// Commands of `haptimill facet`.
#[derive(Debug, Clone, Subcommand)]
pub enum FacetCommand {
    /// Check a gem design, and print its facets, size and meet points
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
    /// By feed, with the force held
    Both,
}

impl By {
    const fn mode(self) -> Mode {
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
    /// Volume that a lap loses for a volume of the stone
    #[arg(long, value_name = "PART", default_value_t = 0.0, value_parser = small)]
    pub wear: f64,
    /// Hard ball in the stone: centre x,y,z, radius, and its part of the removal
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

/// The built-in machine file.
pub(super) const MACHINE: &str = include_str!("../../../../machines/facet.toml");

/// Runs a command.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: FacetCommand) -> Result<(), CliError> {
    match command {
        FacetCommand::Check(args) => check(&args),
        FacetCommand::Plan(args) => plan(&args),
        FacetCommand::Run(args) => grind(&args),
        FacetCommand::Calibrate(args) => print_lengths(&args),
    }
}

fn bad(message: impl std::fmt::Display) -> CliError {
    CliError::new(Exit::BadInput, message)
}

fn read_design(path: &Path) -> Result<Design, CliError> {
    let file = path.display().to_string();
    let text = input::read(path, input::SETTINGS_BYTES)
        .map_err(|error| bad(format!("{file}: {error}")))?;
    read(&file, &text).map_err(bad)
}

fn gem(args: &DesignArgs) -> Result<Gem, CliError> {
    let design = read_design(&args.design)?;
    let file = args.design.display().to_string();
    for notice in &design.notices {
        eprintln!("notice: {}", notice.text(&file));
    }
    Gem::new(&file, design, args.width, args.rough).map_err(bad)
}

fn settings(args: &JobArgs, machine: &MachineFile) -> Result<JobSettings, CliError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Laps {
        lap: Vec<Lap>,
    }
    let mut settings = JobSettings {
        mode: args.by.mode(),
        most_force_n: most_force_n(machine),
        ..JobSettings::default()
    };
    if let Some(path) = &args.laps {
        let file = path.display();
        let text = input::read(path, input::SETTINGS_BYTES)
            .map_err(|error| bad(format!("{file}: {error}")))?;
        let text = String::from_utf8_lossy(&text);
        let laps: Laps = toml::from_str(&text).map_err(|error| {
            let offset = error.span().map_or(0, |span| span.start);
            let line = 1 + text.get(..offset).map_or(0, |it| it.matches('\n').count());
            bad(format!("{file}:{line}: {}", error.message()))
        })?;
        settings.laps = laps.lap;
        if let Some(problem) = settings.problem() {
            return Err(bad(format!("{file}: {problem}")));
        }
    }
    Ok(settings)
}

fn check(args: &CheckArgs) -> Result<(), CliError> {
    let (gem, _, _) = planned(&args.design, &args.job)?;
    let ends = |axis: usize| {
        let mut direction = [0.0; 3];
        direction[axis] = 1.0;
        gem.body.reach(direction) + gem.body.reach(direction.map(|value| -value))
    };
    let gain = gem.meets.iter().map(|meet| meet.gain).fold(0.0, f64::max);
    if args.json {
        let facets = gem.design.facets.iter().map(|facet| {
            json!({
                "name": facet.name, "line": facet.line, "stage": facet.stage.name(),
                "angle_deg": facet.angle_deg, "azimuth_deg": gem.design.azimuth_deg(facet.index),
                "index": facet.index, "depth_mm": facet.distance * gem.scale_mm,
            })
        });
        let notices = gem.design.notices.iter().map(|it| {
            json!({ "line": it.line, "facet": it.facet, "what": it.what, "remedy": it.remedy })
        });
        let value = json!({
            "title": gem.design.title, "gear": gem.design.gear,
            "notices": notices.collect::<Vec<_>>(),
            "size_mm": [ends(0), ends(1), ends(2)], "yield": gem.yield_part(),
            "volume_mm3": gem.body.volume(), "meet_points": gem.meets.len(), "gain": gain,
            "facets": facets.collect::<Vec<_>>(),
        });
        print_line!("{value:#}");
        return Ok(());
    }
    let facets = gem.body.faces().len();
    print_line!(
        "{}: no problem; {facets} facets on a wheel of {} teeth",
        args.design.design.display(),
        gem.design.gear
    );
    print_line!(
        "size        {:.3} x {:.3} x {:.3} mm, {:.3} mm^3, {:.1} % of the rough of {:.3} x {:.3} mm",
        ends(0),
        ends(1),
        ends(2),
        gem.body.volume(),
        100.0 * gem.yield_part(),
        gem.rough.diameter_mm,
        gem.rough.height_mm
    );
    print_line!(
        "meet points {}; a depth error of 1 um moves one by up to {gain:.1} um, so 0.02 mm need \
         {:.1} um",
        gem.meets.len(),
        20.0 / gain
    );
    Ok(())
}

/// The gem, its job and the machine, on which every facet can be ground.
fn planned(design: &DesignArgs, args: &JobArgs) -> Result<(Gem, Job, MachineFile), CliError> {
    let machine = match &args.machine {
        Some(path) => MachineFile::load(path)?,
        None => MachineFile::parse("facet.toml", MACHINE)?,
    };
    let gem = gem(design)?;
    let job = job(&gem, args, &machine)?;
    Ok((gem, job, machine))
}

/// The job of a gem, which the machine can do.
fn job(gem: &Gem, args: &JobArgs, machine: &MachineFile) -> Result<Job, CliError> {
    let job = Job::new(gem, settings(args, machine)?).map_err(bad)?;
    check_machine(gem, &job, machine).map_err(|refused| CliError::new(Exit::Refused, refused))?;
    Ok(job)
}

/// Notice on a program that is ground by force.
const BY_FORCE: &str = "notice: the program is for a controller that holds the force of the height; \
                        without force control it feeds the stone at up to 0.15 mm/s";

fn plan(args: &PlanArgs) -> Result<(), CliError> {
    let (gem, job, machine) = planned(&args.design, &args.job)?;
    let text = job.program(&gem.design.title, coolant(&machine));
    if job.settings.mode.has_force() {
        eprintln!("{BY_FORCE}");
    }
    if args.out.as_os_str() == "-" {
        print_line!("{}", text.trim_end());
        return Ok(());
    }
    output::save(&args.out, &text)
}

fn grind(args: &RunArgs) -> Result<(), CliError> {
    let (gem, job, machine) = planned(&args.design, &args.job)?;
    let dir = args.out.clone().unwrap_or_else(|| {
        let name = args.design.design.file_stem().unwrap_or_default();
        PathBuf::from(name).with_extension("out")
    });
    // Locked to the end of the command.
    let _folder = ResultFolder::open(&dir)?;
    let options = RunOptions {
        seed: args.seed,
        run_out_mm: args.run_out,
        bed_n_mm3: args.bed,
        wear: args.wear,
        hard_spot: args.hard_spot,
        interrupted: interrupt::flag(),
        ..RunOptions::default()
    };
    let bar = if args.quiet || args.json {
        indicatif::ProgressBar::hidden()
    } else {
        indicatif::ProgressBar::new(0)
    };
    let other = match args.beside {
        None => None,
        Some(by) if by == args.job.by => {
            return Err(CliError::new(
                Exit::Usage,
                "--beside is the same as --by; choose another of feed, force and both",
            ));
        }
        Some(by) => {
            let by = JobArgs {
                by,
                ..args.job.clone()
            };
            Some(self::job(&gem, &by, &machine)?)
        }
    };
    let jobs: Vec<&Job> = std::iter::once(&job).chain(&other).collect();
    let mut cuttings = cut_all(&gem, &jobs, &machine, &options, &bar)?.into_iter();
    bar.finish_and_clear();
    let Some(cutting) = cuttings.next() else {
        return Err(CliError::new(Exit::Internal, "no stone was cut"));
    };
    let second = cuttings.next();
    let beside = other.as_ref().zip(second.as_ref());
    let mut figures = figures(&gem, &cutting);
    if let Some((_, second)) = beside {
        figures["beside"] = self::figures(&gem, second);
    }
    output::save(
        &dir.join("report.html"),
        report(&gem, &job, &cutting, beside),
    )?;
    output::save(&dir.join("stone.json"), format!("{figures:#}\n"))?;
    output::save(
        &dir.join("job.ngc"),
        job.program(&gem.design.title, coolant(&machine)),
    )?;
    if args.json {
        print_line!("{figures:#}");
        return stopped(&cutting, second.as_ref());
    }
    let design = args.design.design.display();
    print_stone(&format!("{design}"), &gem, &cutting);
    if let Some((_, second)) = beside {
        print_stone(&format!("{design}, beside"), &gem, second);
    }
    print_line!("report      {}", dir.join("report.html").display());
    stopped(&cutting, second.as_ref())
}

/// The error of a job that ended before its last facet; its report is written.
fn stopped(cutting: &Cutting, second: Option<&Cutting>) -> Result<(), CliError> {
    let errors = [Some(cutting), second];
    let mut errors = errors
        .into_iter()
        .flatten()
        .filter_map(|it| it.stopped.clone());
    errors.next().map_or(Ok(()), |error| Err(error.into()))
}

/// Cuts the jobs of a design at the same time, each on a simulated machine of its own.
fn cut_all(
    gem: &Gem,
    jobs: &[&Job],
    machine: &MachineFile,
    options: &RunOptions,
    bar: &indicatif::ProgressBar,
) -> Result<Vec<Cutting>, CliError> {
    let count = jobs.iter().flat_map(|job| &job.passes);
    let count: usize = count.map(|pass| pass.operations.len()).sum();
    bar.set_length(count as u64);
    std::thread::scope(|scope| {
        let run = |job| {
            let mut progress = |_, _| bar.inc(1);
            cut(gem, job, machine, options, &mut progress)
        };
        let threads: Vec<_> = jobs
            .iter()
            .map(|job| scope.spawn(move || run(job)))
            .collect();
        let results = threads.into_iter().map(|thread| match thread.join() {
            Ok(result) => result.map_err(CliError::from),
            Err(panic) => std::panic::resume_unwind(panic),
        });
        results.collect()
    })
}

/// Prints the errors of a stone.
fn print_stone(name: &str, gem: &Gem, cutting: &Cutting) {
    let measured = &cutting.measured;
    let seconds: f64 = cutting.operations.iter().map(|it| it.seconds).sum();
    print_line!(
        "{name}: {} facets in {:.1} min of the machine, {:.1} % of the rough",
        measured.facets.len(),
        seconds / 60.0,
        100.0 * measured.yield_part
    );
    print_line!(
        "largest error: angle {:.4} deg, depth {:.4} mm, meet point {:.4} mm",
        measured.worst_angle_deg(),
        measured.worst_depth_mm(),
        measured.worst_meet_mm()
    );
    if !measured.missing.is_empty() || measured.strange > 0 {
        print_line!(
            "{} facets are missing, {} faces are not facets",
            measured.missing.len(),
            measured.strange
        );
    }
    let lost: Vec<usize> = measured.lost_meets().collect();
    if let Some(first) = lost.first() {
        let facets = gem.meets[*first].facets.iter();
        let names: Vec<&str> = facets
            .map(|facet| gem.design.facets[*facet].name.as_str())
            .collect();
        print_line!(
            "of {} of {} meet points the stone has no vertex, the first one is that of {}",
            lost.len(),
            gem.meets.len(),
            names.join(", ")
        );
    }
}

fn figures(gem: &Gem, cutting: &Cutting) -> serde_json::Value {
    let measured = &cutting.measured;
    let name = |facet: usize| gem.design.facets[facet].name.clone();
    let facets = measured.facets.iter().map(|it| {
        json!({
            "name": name(it.facet), "normal_deg": it.error_deg, "angle_deg": it.angle_deg,
            "azimuth_deg": it.azimuth_deg, "depth_mm": it.depth_mm, "proud_mm": it.proud_mm,
            "area_mm2": it.area_mm2,
        })
    });
    let meets = measured.meets.iter().map(|it| {
        let meet = &gem.meets[it.meet];
        let names: Vec<String> = meet.facets.iter().map(|it| name(*it)).collect();
        json!({
            "at_mm": meet.at, "facets": names, "gain": meet.gain, "error_mm": it.error_mm,
            "found": it.is_found,
        })
    });
    let operations = cutting.operations.iter().map(|it| {
        let force = &it.force;
        json!({
            "pass": it.pass, "facet": name(it.facet), "seconds": it.seconds, "sweeps": it.sweeps,
            "peak_n": force.peak_n, "mean_n": force.mean_n, "turns": force.turns,
            "least_turn_n": force.least_turn_n, "most_turn_n": force.most_turn_n,
        })
    });
    json!({
        "angle_deg": measured.worst_angle_deg(), "depth_mm": measured.worst_depth_mm(),
        "meet_mm": measured.worst_meet_mm(), "yield": measured.yield_part,
        "volume_mm3": measured.volume_mm3, "strange": measured.strange,
        "missing": measured.missing.iter().map(|it| name(*it)).collect::<Vec<_>>(),
        "stopped": cutting.stopped.as_ref().map(|error| error.message.clone()),
        "facets": facets.collect::<Vec<_>>(), "meet_points": meets.collect::<Vec<_>>(),
        "operations": operations.collect::<Vec<_>>(), "wear_mm": cutting.wear,
    })
}

/// A reading that differs by more than this from the lengths is reported, mm.
const RESIDUAL_MM: f64 = 0.01;

fn print_lengths(args: &CalibrateArgs) -> Result<(), CliError> {
    let found = calibrate(args.at_0, args.at_90, args.at_180);
    if args.json {
        let value = json!({
            "l2": found.l2, "l3": found.l3, "l4": found.l4, "residual_mm": found.residual,
        });
        print_line!("{value:#}");
        return Ok(());
    }
    print_line!("[kinematics]");
    print_line!("l2 = {:.6}", found.l2);
    print_line!("l3 = {:.6}", found.l3);
    print_line!("l4 = {:.6}", found.l4);
    if found.residual > RESIDUAL_MM {
        eprintln!(
            "the readings differ by up to {:.4} mm from these lengths; measure again",
            found.residual
        );
    }
    Ok(())
}
