//! `haptimill calibrate`: measures the geometric errors of the simulated machine, evaluates
//! readings of a real laser, and calibrates the H-4 arm.

use super::args::MachineArg;
use super::{CliError, Exit, interrupt, output};
use clap::{Args, Subcommand};
use haptimill_calibration::ball_bar::{self, CircleResult, CircleTest};
use haptimill_calibration::calibrate::{Conditions, Plan, calibrate, of_readings, write_readings};
use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::laser::{Environment, LaserOptions};
use haptimill_calibration::rewrite::rewritten_for;
use haptimill_calibration::scenario::{errors_of, travel};
use haptimill_client::Error;
use haptimill_machine_file::{MachineFile, input};
use haptimill_volumetric::errors::Squareness;
use haptimill_volumetric::file::{FileProblem, Limits};
use haptimill_volumetric::readings::Readings;
use haptimill_volumetric::{circle_readings, file, readings};
use std::path::{Path, PathBuf};

const LASER: &str = "\
Measure the geometric errors of the simulated machine with a laser interferometer, an instrument for \
roll and a square, by the cycles of ISO 230-2: each axis goes to its targets five times in each \
direction, through the controller.

Writes the 21 identified errors to FILE. `haptimill run --machine M --errors FILE` compensates with \
them. With --readings the readings of a real laser are evaluated instead, and nothing moves.";

const BALL_BAR: &str = "\
Run the circle test of ISO 230-4 on the simulated machine: a circle in both directions about the \
origin, read by a ball bar.

States the circular deviation G, the hysteresis H, the radial deviation F, and the squareness of x \
and y. With --errors the controller compensates these errors during the test. With --readings the \
readings of a real bar are evaluated instead, and nothing moves. --out writes the squareness as an \
error file; it takes the other errors as 0.";

const REWRITE: &str = "\
Correct all points of a part program by the errors of a machine, for a control without error tables. \
The machine has the chain [w Y b X Z t] (docs/volumetric.md), the program starts at its home pose.

Every move becomes straight moves of at most 1 mm. Moves, dwells, messages, spindle commands and tool \
changes can be rewritten; anything else is refused with its line. Run the result without compensation.";

const ARM: &str = "\
Find the true lengths and index positions of the simulated H-4 arm: the controller moves it to 40 \
poses, a laser tracker (2 um a coordinate) reads the tip, and a fit finds four lengths, an offset and \
the offsets of four joints.

Writes the machine file with the found values to FILE, and states the error of the tip at 20 other \
poses before and after. The values of [kinematics] and `index_mm` change, the simulated machine does \
not.";

/// Subcommands of `haptimill calibrate`.
#[derive(Debug, Clone, Subcommand)]
pub enum CalibrateCommand {
    #[allow(missing_docs)]
    Laser(LaserArgs),
    #[allow(missing_docs)]
    BallBar(BallBarArgs),
    #[allow(missing_docs)]
    Rewrite(RewriteArgs),
    #[allow(missing_docs)]
    Arm(ArmArgs),
}

/// Options of a measurement of the simulated machine, which readings from a file do not have.
const OF_A_MEASUREMENT: [&str; 7] = [
    "save_readings",
    "errors",
    "uncorrected",
    "interval",
    "no_roll",
    "no_noise",
    "seed",
];

/// Options of a circle test of the simulated machine, which readings from a file do not have.
const OF_A_CIRCLE: [&str; 4] = ["errors", "feed", "no_noise", "seed"];

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
    #[arg(long, value_name = "MM", default_value_t = 10.0, value_parser = interval)]
    pub interval: f64,
    /// Readings of a laser (CSV) to evaluate, instead of a measurement of the simulated machine
    #[arg(long, value_name = "FILE", conflicts_with_all = OF_A_MEASUREMENT)]
    pub readings: Option<PathBuf>,
    /// State of the volumetric compensation during the readings [default: on where the machine has
    /// error tables, and not stated with --readings]
    #[arg(long, value_name = "STATE", value_parser = ["on", "off"])]
    pub compensation: Option<String>,
    /// File for all readings (CSV)
    #[arg(long, value_name = "FILE")]
    pub save_readings: Option<PathBuf>,
    /// Errors that the controller compensates while it is measured
    #[arg(long, value_name = "FILE")]
    pub errors: Option<PathBuf>,
    /// Temperature of the air, degrees Celsius [default: 20, and not stated with --readings]
    #[arg(long, value_name = "C", value_parser = temperature)]
    pub air: Option<f64>,
    /// Pressure of the air, hPa [default: 1013.25, and not stated with --readings]
    #[arg(long, value_name = "HPA", value_parser = pressure)]
    pub pressure: Option<f64>,
    /// Temperature of the machine, degrees Celsius [default: 20, and not stated with --readings]
    #[arg(long, value_name = "C", value_parser = temperature)]
    pub machine_temperature: Option<f64>,
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

/// Arguments of `haptimill calibrate ball-bar`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run a circle test on the simulated machine", long_about = BALL_BAR)]
pub struct BallBarArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Errors that the controller compensates during the test
    #[arg(long, value_name = "FILE")]
    pub errors: Option<PathBuf>,
    /// State of the volumetric compensation [default: on where the machine has error tables, and
    /// not stated with --readings]
    #[arg(long, value_name = "STATE", value_parser = ["on", "off"])]
    pub compensation: Option<String>,
    /// Radius of the circle, which is the nominal length of the bar, mm
    #[arg(long, value_name = "MM", default_value_t = 100.0, value_parser = radius)]
    pub radius: f64,
    /// Readings of a ball bar (CSV) to evaluate, instead of a test of the simulated machine
    #[arg(long, value_name = "FILE", conflicts_with_all = OF_A_CIRCLE)]
    pub readings: Option<PathBuf>,
    /// Error file to write: the squareness, and 0 for the other errors
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Feed, mm/s
    #[arg(long, value_name = "MM/S", default_value_t = 30.0, value_parser = feed)]
    pub feed: f64,
    /// A ball bar without noise
    #[arg(long)]
    pub no_noise: bool,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// Arguments of `haptimill calibrate rewrite`.
#[derive(Debug, Clone, Args)]
#[command(about = "Correct the points of a part program by an error file", long_about = REWRITE)]
pub struct RewriteArgs {
    /// Part program (G-code)
    #[arg(value_name = "PROGRAM")]
    pub program: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Errors of the machine (CSV)
    #[arg(long, value_name = "FILE")]
    pub errors: PathBuf,
    /// Corrected program to write
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Arguments of `haptimill calibrate arm`.
#[derive(Debug, Clone, Args)]
#[command(about = "Find the lengths and index positions of the simulated H-4 arm", long_about = ARM)]
pub struct ArmArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Machine file to write
    #[arg(long, value_name = "FILE", default_value = "calibrated.toml")]
    pub out: PathBuf,
    /// Change each length and index position of the simulated arm at random, by at most this, mm
    #[arg(long, value_name = "MM", value_parser = perturbation)]
    pub perturb: Option<f64>,
    /// A tracker without noise
    #[arg(long)]
    pub no_noise: bool,
    /// Seed of the changes, of the poses and of the noise
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

fn radius(text: &str) -> Result<f64, String> {
    number(text, 5.0, 500.0, "mm")
}

fn perturbation(text: &str) -> Result<f64, String> {
    number(text, 0.0, 0.2, "mm")
}

fn feed(text: &str) -> Result<f64, String> {
    number(text, 1.0, 500.0, "mm/s")
}

/// Runs a calibration.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: CalibrateCommand) -> Result<(), CliError> {
    match command {
        CalibrateCommand::Laser(args) => match &args.readings {
            Some(path) => evaluate(&args, path),
            None => measure(&args),
        },
        CalibrateCommand::BallBar(args) => circle(&args),
        CalibrateCommand::Rewrite(args) => rewrite(&args),
        CalibrateCommand::Arm(args) => arm(&args),
    }
}

fn load(machine: &MachineArg, errors: Option<&PathBuf>) -> Result<MachineFile, CliError> {
    let file = machine.load()?;
    match errors {
        Some(path) => super::args::with_errors(&file, path),
        None => Ok(file),
    }
}

/// Text of a table of readings.
fn table(path: &Path) -> Result<String, Error> {
    let name = path.display();
    let bytes =
        input::read(path, input::TABLE_BYTES).map_err(|error| Error::in_file(&name, error))?;
    String::from_utf8(bytes).map_err(|_| {
        let what = "is no text; give a table of readings (CSV, UTF-8)";
        Error::in_file(&name, what)
    })
}

/// Errors of the readings of a real laser.
fn evaluate(args: &LaserArgs, path: &Path) -> Result<(), CliError> {
    let machine_file = args.machine.load()?;
    let name = path.display();
    let text = table(path)?;
    let found = readings::read(&text).map_err(|problem| Error::in_file(&name, problem))?;
    let conditions = Conditions {
        air_c: args.air,
        pressure_hpa: args.pressure,
        machine_c: args.machine_temperature,
        compensated: args.compensation.as_deref().map(|state| state == "on"),
    };
    let (errors, report) = of_readings(&found, &travel(&machine_file), &conditions);
    let written = file::write(&errors, &report);
    // What the controller would refuse is refused here, where the readings can be repeated.
    let limits = Limits {
        travel: Some(travel(&machine_file)),
        ..Limits::default()
    };
    file::read(&written, &limits).map_err(|problem| {
        let place = place_of(&problem, &written, &found);
        let what = format!("{place}{}; {}", problem.what, problem.remedy);
        Error::in_file(&name, what)
    })?;
    output::save(&args.out, &written)?;
    print_line!("{report}");
    print_line!("errors      {}", args.out.display());
    Ok(())
}

/// The place in the readings of a problem of their error file: line and target. The line of the
/// problem is one of the error file, which is never written.
fn place_of(problem: &FileProblem, written: &str, found: &Readings) -> String {
    let line = usize::try_from(problem.line)
        .ok()
        .and_then(|line| line.checked_sub(1));
    let line = line.and_then(|line| written.lines().nth(line));
    let mut words = line.unwrap_or_default().split(',').map(str::trim);
    let name = words.next().unwrap_or_default();
    let at = words.next().unwrap_or_default();
    let Ok(position) = at.parse::<f64>() else {
        return String::new();
    };
    let function = found
        .functions
        .iter()
        .find(|readings| readings.function.to_string() == name);
    let targets = function.map(|readings| readings.targets.iter().zip(&readings.lines));
    let nearest = targets.and_then(|targets| {
        targets.min_by(|(a, _), (b, _)| (*a - position).abs().total_cmp(&(*b - position).abs()))
    });
    let line = nearest.map_or(String::new(), |(_, line)| format!("line {line}: "));
    format!("{line}at {at} mm: ")
}

/// Measures the simulated machine.
fn measure(args: &LaserArgs) -> Result<(), CliError> {
    let machine_file = load(&args.machine, args.errors.as_ref())?;
    for path in std::iter::once(&args.out).chain(&args.save_readings) {
        output::check_writable(path)?;
    }
    let exact = if args.no_noise {
        LaserOptions::ideal()
    } else {
        LaserOptions::default()
    };
    let usual = Environment::default();
    let laser = LaserOptions {
        roll: exact.roll.filter(|_| !args.no_roll),
        corrects_wavelength: !args.uncorrected,
        environment: Environment {
            air_c: args.air.unwrap_or(usual.air_c),
            pressure_hpa: args.pressure.unwrap_or(usual.pressure_hpa),
            machine_c: args.machine_temperature.unwrap_or(usual.machine_c),
            ..usual
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
    compensate(&mut machine, &machine_file, args.compensation.as_deref())?;
    let calibration = calibrate(&mut machine, &machine_file, &plan, |line| {
        print_line!("{line}");
    })?;
    let report = calibration.report();
    output::save(&args.out, file::write(&calibration.errors, &report))?;
    print_line!("\n{report}");
    print_line!("errors      {}", args.out.display());
    if let Some(path) = &args.save_readings {
        output::save(path, write_readings(&calibration))?;
        print_line!("readings    {}", path.display());
    }
    Ok(())
}

/// Switches compensation to a state, on by default, and waits for the end of its fade: readings
/// during the fade would be of no state. A machine without error tables has only the state off.
fn compensate(
    machine: &mut Machine,
    machine_file: &MachineFile,
    state: Option<&str>,
) -> Result<(), CliError> {
    let has_tables = machine_file.config.volumetric.is_some();
    if !has_tables && state == Some("on") {
        let what = "--compensation on: the machine has no error tables; give them with --errors";
        return Err(CliError::new(Exit::Usage, what));
    }
    if has_tables {
        machine.compensate(state != Some("off"))?;
    }
    Ok(())
}

/// Corrects the points of a part program.
fn rewrite(args: &RewriteArgs) -> Result<(), CliError> {
    let machine_file = args.machine.load()?;
    let text = haptimill_machine_file::read_text(&args.errors)?;
    let errors = errors_of(&machine_file, &args.errors.display().to_string(), &text)?;
    let program = haptimill_machine_file::read_text(&args.program)?;
    let name = args.program.display().to_string();
    let corrected = rewritten_for(&machine_file, &name, &program, &errors)?;
    output::save(&args.out, corrected)?;
    print_line!("program     {}", args.out.display());
    Ok(())
}

/// Calibrates the simulated H-4 arm.
fn arm(args: &ArmArgs) -> Result<(), CliError> {
    use haptimill_calibration::arm::{Plan, calibrate, perturbed};
    let machine_file = args.machine.load()?;
    output::check_writable(&args.out)?;
    let machine_file = match args.perturb {
        Some(by) => perturbed(&machine_file, by, args.seed)?,
        None => machine_file,
    };
    let plan = Plan {
        seed: args.seed,
        ..Plan::default()
    };
    let plan = Plan {
        noise: if args.no_noise { 0.0 } else { plan.noise },
        ..plan
    };
    let found = calibrate(&machine_file, &plan, &interrupt::flag(), |line| {
        print_line!("{line}");
    })?;
    output::save(&args.out, &found.machine.text)?;
    print_line!("\n{found}\nmachine     {}", args.out.display());
    Ok(())
}

/// Runs a circle test on the simulated machine.
fn circle(args: &BallBarArgs) -> Result<(), CliError> {
    if let Some(path) = &args.out {
        output::check_writable(path)?;
    }
    let (machine_file, result, compensated) = match &args.readings {
        Some(path) => {
            let machine_file = args.machine.load()?;
            let name = path.display();
            let readings = circle_readings::read(&table(path)?)
                .map_err(|problem| Error::in_file(&name, problem))?;
            let result = ball_bar::of_readings(&readings, args.radius).ok_or_else(|| {
                Error::in_file(
                    &name,
                    "the readings make no circle; check --radius and the units",
                )
            })?;
            print_line!("circle      radius {} mm, readings of {name}", args.radius);
            let compensated = args.compensation.as_deref().map(|state| state == "on");
            (machine_file, result, compensated)
        }
        None => circle_test(args)?,
    };
    let um = |value: f64| value * 1e3;
    let [ccw, cw] = result.deviation.map(um);
    let [max, min] = result.radial.map(um);
    print_line!("G ccw       {ccw:>8.3} um");
    print_line!("G cw        {cw:>8.3} um");
    print_line!("H           {:>8.3} um", um(result.hysteresis));
    print_line!("F           {min:>8.3} to {max:.3} um");
    print_line!("squareness  {:>8.2} urad", result.squareness * 1e6);
    let Some(out) = &args.out else {
        return Ok(());
    };
    let found = Readings {
        functions: Vec::new(),
        squareness: Squareness {
            c0y: result.squareness,
            ..Squareness::default()
        },
    };
    let conditions = Conditions {
        compensated,
        ..Conditions::default()
    };
    let (errors, report) = of_readings(&found, &travel(&machine_file), &conditions);
    let report = format!("squareness of x and y by a circle test\n{report}");
    output::save(out, file::write(&errors, &report))?;
    print_line!("errors      {}", out.display());
    Ok(())
}

/// A circle test of the simulated machine, and whether the controller compensated.
fn circle_test(args: &BallBarArgs) -> Result<(MachineFile, CircleResult, Option<bool>), CliError> {
    let machine_file = load(&args.machine, args.errors.as_ref())?;
    let at = CircleTest::at(args.feed);
    let test = CircleTest {
        radius: args.radius,
        noise: if args.no_noise { 0.0 } else { at.noise },
        seed: args.seed,
        ..at
    };
    // Eight samples in a degree, where a control period is short enough.
    let degree_s = args.radius * 1_f64.to_radians() / args.feed;
    let every = (degree_s * 1e6 / f64::from(machine_file.config.period_us) / 8.0) as u64;
    let mut machine = Machine::new(&machine_file, every.clamp(1, SLOW), &interrupt::flag())?;
    compensate(&mut machine, &machine_file, args.compensation.as_deref())?;
    let compensation = machine.status()?.compensation();
    let result = ball_bar::run(&mut machine, &test)?;
    print_line!(
        "circle      radius {} mm, {} mm/s, both directions",
        args.radius,
        args.feed
    );
    print_line!(
        "compensation {}",
        compensation.map_or("none".to_string(), |percent| format!("{percent} %"))
    );
    Ok((machine_file, result, Some(compensation.unwrap_or(0) > 0)))
}
