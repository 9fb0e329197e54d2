//! `haptimill scenario`: the experiments of four theses in the simulator, compared with their
//! numbers.

use super::args::MachineArg;
use super::{CliError, Exit, output};
use crate::commands::interrupt;
use clap::{Args, Subcommand};
use haptimill_client::Error;
use haptimill_client::port::PortSpec;
use haptimill_experiments::{Experiment, ExperimentResult, PassData, Target};
use haptimill_machine_file::MachineFile;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

const RUN: &str = "\
Run an experiment of a thesis, or `all`, in the simulator, and compare the results with the thesis.

Writes to DIR index.html and a folder for each experiment with
  index.html    charts of the figures of the thesis, the cut surface from above, the table of results
  summary.json  the same table for programs
  PASS/         recording, trace, summary and report of each pass, as `haptimill run` writes them
Ends with the table. A result outside its band is shown with the reason; it is not an error.";

/// Subcommands of `haptimill scenario`.
#[derive(Debug, Clone, Subcommand)]
pub enum ScenarioCommand {
    /// List the experiments
    List,
    #[allow(missing_docs)]
    Run(RunArgs),
}

/// Arguments of `haptimill scenario run`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run one experiment, or all", long_about = RUN)]
pub struct RunArgs {
    /// Name of an experiment, or `all` (e1 to e12)
    #[arg(value_name = "NAME")]
    pub name: String,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Where the controller runs: sim (in this process), pil:mps2 or pil:mps2-m7 (on an emulated
    /// Cortex-M4F or M7)
    #[arg(long, value_name = "PORT", default_value = "sim")]
    pub port: PortSpec,
    /// Folder for the results; created if missing
    #[arg(long, value_name = "DIR", default_value = "scenarios.out")]
    pub out: PathBuf,
    /// Print only the summaries as JSON on standard output
    #[arg(long)]
    pub json: bool,
    /// vmc: errors of the simulated machine (CSV) instead of those of its file
    #[arg(long, value_name = "FILE")]
    pub errors: Option<PathBuf>,
    /// vmc: few points and targets, and one circle test
    #[arg(long)]
    pub coarse: bool,
    /// vmc: side of the square along x from a measuring machine, as table 4.1 of the thesis (CSV:
    /// 15 positions and 3 runs, mm), instead of that of the simulated one
    #[arg(long, value_name = "FILE", requires = "cmm_y")]
    pub cmm_x: Option<PathBuf>,
    /// vmc: side along y, as table 4.2
    #[arg(long, value_name = "FILE", requires = "cmm_x")]
    pub cmm_y: Option<PathBuf>,
}

impl RunArgs {
    /// An option of the scenario `vmc`, if one is given.
    fn volumetric_option(&self) -> Option<&'static str> {
        match self {
            Self {
                errors: Some(_), ..
            } => Some("--errors"),
            Self { coarse: true, .. } => Some("--coarse"),
            Self { cmm_x: Some(_), .. } => Some("--cmm-x"),
            _ => None,
        }
    }
}

/// Lists or runs experiments.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: ScenarioCommand) -> Result<(), CliError> {
    match command {
        ScenarioCommand::List => {
            for experiment in haptimill_experiments::all()? {
                let passes = experiment.passes.len();
                let plural = if passes == 1 { "" } else { "es" };
                print_line!(
                    "{:<5} {:<34} {passes} pass{plural}; {}",
                    experiment.name,
                    experiment.title,
                    experiment.figures
                );
            }
            print_line!(
                "{ENGRAVER:<5} path analysis of the thesis on the engraver, with its pockets"
            );
            print_line!(
                "{FACETING:<5} equations of the thesis on the faceting machine; a stone by feed and \
                 by force"
            );
            print_line!("{VOLUMETRIC:<5} volumetric errors, calibration, compensation, test piece");
            Ok(())
        }
        ScenarioCommand::Run(args) => run_named(&args),
    }
}

/// Name of the scenario that closes the loop of measurement and compensation.
const VOLUMETRIC: &str = "vmc";

/// Name of the scenario that repeats the analysis of the thesis on the engraver.
const ENGRAVER: &str = "engraver";

/// Name of the scenario that repeats the statements of the thesis on the faceting machine.
const FACETING: &str = "faceting";

/// A statement of a thesis beside what is found here.
struct Statement<'a> {
    section: &'a str,
    what: &'a str,
    stated: &'a str,
    ours: &'a str,
    mark: &'static str,
    reason: &'a str,
}

/// Writes the rows as JSON; prints them as such, or as a table.
fn show<'a, T: serde::Serialize>(
    args: &RunArgs,
    name: &str,
    rows: &'a [T],
    of: impl Fn(&'a T) -> Statement<'a>,
) -> Result<(), CliError> {
    let json =
        serde_json::to_string_pretty(rows).map_err(|error| CliError::new(Exit::Internal, error))?;
    write(&args.out.join(name).join("summary.json"), &json)?;
    if args.json {
        print_line!("{json}");
        return Ok(());
    }
    print_line!("{:<7} {:<66} {:<27} ours", "section", "result", "stated");
    for row in rows.iter().map(of) {
        let mark = row.mark;
        print_line!(
            "{:<7} {:<66} {:<27} {}{mark}",
            row.section,
            row.what,
            row.stated,
            row.ours
        );
        if !row.reason.is_empty() {
            print_line!("{:<7} ({})", "", row.reason);
        }
    }
    Ok(())
}

/// Stated and found results of the thesis on the engraver (docs/engraving.md).
fn run_engraver(args: &RunArgs) -> Result<(), CliError> {
    use haptimill_engrave::thesis::Verdict;
    let is_quiet = args.json;
    let mut progress = |what: &str| {
        if !is_quiet {
            eprintln!("{what}");
        }
    };
    let mut rows =
        haptimill_engrave::thesis::rows().map_err(|error| CliError::new(Exit::Internal, error))?;
    rows.extend(super::engrave::thesis::rows(
        &interrupt::flag(),
        &mut progress,
    )?);
    show(args, ENGRAVER, &rows, |row| Statement {
        section: row.section,
        what: &row.what,
        stated: &row.stated,
        ours: &row.ours,
        mark: match row.verdict {
            Verdict::Agrees => "",
            Verdict::SameKind => "  of the same kind",
            Verdict::Differs => "  differs",
        },
        reason: row.reason,
    })
}

/// Stated and found results of the thesis on the faceting machine (docs/faceting.md).
fn run_faceting(args: &RunArgs) -> Result<(), CliError> {
    let machine = match args.machine.machine {
        Some(_) => args.machine.load()?,
        None => MachineFile::parse("facet.toml", super::facet::MACHINE)?,
    };
    let options = haptimill_facet::RunOptions {
        interrupted: interrupt::flag(),
        ..haptimill_facet::RunOptions::default()
    };
    let is_quiet = args.json;
    let rows = haptimill_facet::thesis::rows(&machine, &options, &mut |what| {
        if !is_quiet {
            eprintln!("{what}");
        }
    })?;
    show(args, FACETING, &rows, |row| Statement {
        section: row.section,
        what: &row.what,
        stated: &row.stated,
        ours: &row.ours,
        mark: if row.agrees { "" } else { "  differs" },
        reason: row.reason,
    })
}

/// Errors, calibration, compensation and test piece in one run (docs/volumetric.md).
fn run_volumetric(args: &RunArgs) -> Result<(), CliError> {
    use haptimill_calibration::{page, scenario};
    let machine = match args.machine.machine {
        Some(_) => args.machine.load()?,
        None => scenario::machine()?,
    };
    let machine = match &args.errors {
        Some(path) => {
            let text = haptimill_machine_file::read_text(path)?;
            scenario::with_truth(&machine, &path.display().to_string(), &text)?
        }
        None => machine,
    };
    let sides = match (&args.cmm_x, &args.cmm_y) {
        (Some(x), Some(y)) => Some([side(x, 'x')?, side(y, 'y')?]),
        _ => None,
    };
    let extent = if args.coarse {
        scenario::Extent::coarse()
    } else {
        scenario::Extent::default()
    };
    let extent = scenario::Extent { sides, ..extent };
    let json = args.json;
    let outcome = scenario::run(&machine, &extent, &interrupt::flag(), &mut |line| {
        if !json {
            print_line!("{line}");
        }
    })?;
    let folder = args.out.join(VOLUMETRIC);
    let index = folder.join("index.html");
    write(&index, &page::page(&outcome))?;
    let errors = haptimill_volumetric::file::write(
        &outcome.calibration.errors,
        &outcome.calibration.report(),
    );
    write(&folder.join("errors.csv"), &errors)?;
    let [x, y] = &outcome.sides;
    write(&folder.join("side_x.csv"), &x.write("x", "y"))?;
    write(&folder.join("side_y.csv"), &y.write("y", "x"))?;
    write(&folder.join("summary.json"), &scenario::summary(&outcome))?;
    if json {
        print_line!("{}", scenario::summary(&outcome).trim_end());
    } else {
        print_line!("{}", scenario::table(&outcome).trim_end());
        print_line!("report      {}", index.display());
    }
    Ok(())
}

/// The side of the square along an axis, as a measuring machine wrote it.
fn side(
    path: &Path,
    along: char,
) -> Result<haptimill_calibration::comparison::SideTable, CliError> {
    use haptimill_calibration::comparison::{POINTS, RUNS, SideTable};
    let text = haptimill_machine_file::read_text(path)?;
    let read = SideTable::read(&text, along, RUNS, POINTS);
    Ok(read.map_err(|problem| Error::in_file(path.display(), problem))?)
}

fn run_named(args: &RunArgs) -> Result<(), CliError> {
    if args.name.eq_ignore_ascii_case(VOLUMETRIC) {
        return run_volumetric(args);
    }
    if let Some(option) = args.volumetric_option() {
        let what = format!("{option} belongs to `scenario run {VOLUMETRIC}`; leave it out");
        return Err(CliError::new(Exit::Usage, what));
    }
    if args.name.eq_ignore_ascii_case(ENGRAVER) {
        return run_engraver(args);
    }
    if args.name.eq_ignore_ascii_case(FACETING) {
        return run_faceting(args);
    }
    let machine = args.machine.load()?;
    let mut experiments = haptimill_experiments::all()?;
    if !args.name.eq_ignore_ascii_case("all") {
        let names: Vec<String> = experiments.iter().map(|e| e.name.clone()).collect();
        experiments.retain(|experiment| experiment.name.eq_ignore_ascii_case(&args.name));
        if experiments.is_empty() {
            let what = format!(
                "there is no experiment \"{}\"; write one of {}, or all",
                args.name,
                [
                    &names[..],
                    &[ENGRAVER.into(), FACETING.into(), VOLUMETRIC.into()]
                ]
                .concat()
                .join(", ")
            );
            return Err(CliError::new(Exit::Usage, what));
        }
    }
    if let [only] = &experiments[..]
        && let Some(obstacle) = only.obstacle(&machine)
    {
        let what = format!("{}: {obstacle}", only.name);
        return Err(CliError::new(Exit::Refused, what));
    }
    let possible = experiments.iter();
    let possible: Vec<&Experiment> = possible
        .filter(|experiment| experiment.obstacle(&machine).is_none())
        .collect();
    let target = target(&args.port)?;
    let mut data = run_all(&machine, &possible, &args.out, target)?.into_iter();
    let mut results = Vec::new();
    for experiment in &experiments {
        results.push(match experiment.obstacle(&machine) {
            None => write_result(experiment, &data.next().unwrap_or_default(), &args.out)?,
            Some(obstacle) => ExperimentResult::not_run(experiment, obstacle),
        });
    }
    let index = args.out.join("index.html");
    write(
        &index,
        &haptimill_experiments::index(&machine.config.name, &results),
    )?;
    if args.json {
        let json = serde_json::to_string_pretty(&results)
            .map_err(|error| CliError::new(Exit::Internal, error))?;
        print_line!("{json}");
    } else {
        print_line!("{}", haptimill_experiments::table(&results).trim_end());
        print_line!("report      {}", index.display());
    }
    Ok(())
}

/// Evaluates an experiment; writes its page and its summary.
fn write_result(
    experiment: &Experiment,
    data: &[PassData],
    out: &Path,
) -> Result<ExperimentResult, CliError> {
    let result = ExperimentResult::new(experiment, data);
    let dir = out.join(&experiment.name);
    let page = haptimill_experiments::page(experiment, data, &result);
    write(&dir.join("index.html"), &page)?;
    let json = serde_json::to_string_pretty(&result)
        .map_err(|error| CliError::new(Exit::Internal, error))?;
    write(&dir.join("summary.json"), &(json + "\n"))?;
    Ok(result)
}

/// Where the controller runs.
fn target(port: &PortSpec) -> Result<Target, CliError> {
    match port {
        PortSpec::Simulator => Ok(Target::InProcess),
        PortSpec::Emulated(board) => Ok(Target::Board(*board)),
        other => {
            let what = format!(
                "an experiment cuts a simulated stock and measures its surface, so the machine is \
                 simulated: --port sim, pil:mps2 or pil:mps2-m7, not {other}; on a real machine, \
                 use `haptimill run`"
            );
            Err(CliError::new(Exit::Usage, what))
        }
    }
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    path.parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .map_err(|error| output::write_error(path, error))?;
    output::save(path, text)
}

/// Runs every pass of the experiments on as many threads as there are processors. Each pass is a
/// simulation of its own, so their order does not affect the results.
fn run_all(
    machine: &MachineFile,
    experiments: &[&Experiment],
    out: &Path,
    target: Target,
) -> Result<Vec<Vec<PassData>>, CliError> {
    let interrupted: Arc<AtomicBool> = interrupt::flag();
    let mut jobs = Vec::new();
    for experiment in experiments {
        for pass in &experiment.passes {
            jobs.push((pass, out.join(&experiment.name).join(&pass.name)));
        }
    }
    let next = AtomicUsize::new(0);
    let done: Vec<Mutex<Option<Result<PassData, CliError>>>> =
        jobs.iter().map(|_| Mutex::new(None)).collect();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads.min(jobs.len()) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let (Some((pass, dir)), Some(slot)) = (jobs.get(index), done.get(index)) else {
                        break;
                    };
                    let run = haptimill_experiments::run_pass;
                    let data = run(machine, pass, dir, target, &interrupted);
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) =
                        Some(data.map_err(CliError::from));
                }
            });
        }
    });
    let mut done = done.into_iter();
    let mut all = Vec::new();
    for experiment in experiments {
        let mut passes = Vec::new();
        for slot in done.by_ref().take(experiment.passes.len()) {
            let data = slot.into_inner().unwrap_or_else(PoisonError::into_inner);
            let missing = || Err(CliError::new(Exit::Internal, "a pass was not run"));
            passes.push(data.unwrap_or_else(missing)?);
        }
        all.push(passes);
    }
    Ok(all)
}
