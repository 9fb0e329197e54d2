//! `haptimill scenario`: runs the experiments of the thesis in the simulator.

use super::args::MachineArg;
use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::{Args, Subcommand};
use haptimill_client::port::PortSpec;
use haptimill_experiments::{self, Cut, On, Result as Outcome, Scenario};
use haptimill_machine_file::MachineFile;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

const RUN: &str = "\
Run a scenario, or `all`: cut in the simulator, measure, and compare with the numbers of the thesis.

Writes index.html to DIR and, for each scenario, a folder with
  index.html    the curves of the figures of the thesis, the cut surface from above, and the table
                of expected values, tolerances and results
  summary.json  the same table as JSON
  PASS/         recording, trace, summary and report of each cut, as `haptimill run` writes them
Prints the table. A result outside its tolerance is marked with the reason; the exit code is still 0.";

/// A command on scenarios.
#[derive(Debug, Clone, Subcommand)]
pub enum ScenarioCommand {
    /// List the scenarios
    List,
    #[allow(missing_docs)]
    Run(RunArgs),
}

/// Arguments of `haptimill scenario run`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run a scenario, or all of them", long_about = RUN)]
pub struct RunArgs {
    /// Name of a scenario, or `all`
    #[arg(value_name = "NAME")]
    pub name: String,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: MachineArg,
    /// Controller of the simulated machine: sim (in this process), pil:mps2 or pil:mps2-m7 (on an
    /// emulated Cortex-M4F or M7)
    #[arg(long, value_name = "PORT", default_value = "sim")]
    pub port: PortSpec,
    /// Folder for the results; created if it does not exist
    #[arg(long, value_name = "DIR", default_value = "scenarios.out")]
    pub out: PathBuf,
    /// Print only the summaries as JSON on standard output
    #[arg(long)]
    pub json: bool,
}

/// Lists or runs scenarios.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: ScenarioCommand) -> Result<(), CliError> {
    match command {
        ScenarioCommand::List => {
            for scenario in haptimill_experiments::all() {
                let passes = scenario.passes.len();
                let plural = if passes == 1 { "" } else { "es" };
                print_line!(
                    "{:<5} {:<34} {passes} pass{plural}; {}",
                    scenario.name,
                    scenario.title,
                    scenario.figures
                );
            }
            Ok(())
        }
        ScenarioCommand::Run(args) => run_named(&args),
    }
}

fn run_named(args: &RunArgs) -> Result<(), CliError> {
    let machine = args.machine.load()?;
    let scenarios = if args.name.eq_ignore_ascii_case("all") {
        haptimill_experiments::all()
    } else {
        let known = haptimill_experiments::named(&args.name).ok_or_else(|| {
            let names: Vec<&str> = haptimill_experiments::all()
                .iter()
                .map(|known| known.name)
                .collect();
            let what = format!(
                "there is no scenario \"{}\"; write one of {}, or all",
                args.name,
                names.join(", ")
            );
            CliError::new(Exit::Usage, what)
        })?;
        vec![known]
    };
    if let [only] = &scenarios[..]
        && let Some(why) = only.lacks(&machine)
    {
        let what = format!("{}: {why}", only.name);
        return Err(CliError::new(Exit::Refused, what));
    }
    let (runnable, _): (Vec<&Scenario>, Vec<&Scenario>) = scenarios
        .iter()
        .partition(|scenario| scenario.lacks(&machine).is_none());
    let on = controller_of(&args.port)?;
    let mut cut = run_passes(&machine, &runnable, &args.out, on)?.into_iter();
    let mut results = Vec::new();
    for scenario in &scenarios {
        let lacks = scenario.lacks(&machine);
        let result = if lacks.is_none() {
            let cuts = cut.next().unwrap_or_default();
            let result = Outcome::of(scenario, &cuts);
            let dir = args.out.join(scenario.name);
            let page = haptimill_experiments::page(scenario, &cuts, &result);
            write(&dir.join("index.html"), &page)?;
            let json = serde_json::to_string_pretty(&result)
                .map_err(|error| CliError::new(Exit::Internal, error))?;
            write(&dir.join("summary.json"), &(json + "\n"))?;
            result
        } else {
            Outcome::not_run(scenario, lacks.unwrap_or_default())
        };
        results.push(result);
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

/// The controller of the scenarios.
fn controller_of(port: &PortSpec) -> Result<On, CliError> {
    match port {
        PortSpec::Simulator => Ok(On::Here),
        PortSpec::Emulated(board) => Ok(On::Board(*board)),
        other => {
            let what = format!(
                "--port {other}: a scenario cuts and measures a simulated stock; use --port sim, \
                 pil:mps2 or pil:mps2-m7, or run the part program with `haptimill run`"
            );
            Err(CliError::new(Exit::Usage, what))
        }
    }
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    let failed = |error| CliError::new(Exit::Output, format!("{}: {error}", path.display()));
    path.parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .and_then(|()| std::fs::write(path, text))
        .map_err(failed)
}

/// Runs every pass of the scenarios, one thread per processor. The passes are independent
/// simulations, so their order does not change the results.
fn run_passes(
    machine: &MachineFile,
    scenarios: &[&Scenario],
    out: &Path,
    on: On,
) -> Result<Vec<Vec<Cut>>, CliError> {
    let interrupted: Arc<AtomicBool> = interrupt::flag();
    let mut jobs = Vec::new();
    for scenario in scenarios {
        for pass in &scenario.passes {
            jobs.push((pass, out.join(scenario.name).join(pass.name)));
        }
    }
    let next = AtomicUsize::new(0);
    let done: Vec<Mutex<Option<Result<Cut, CliError>>>> =
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
                    let cut = haptimill_experiments::carry(machine, pass, dir, on, &interrupted)
                        .map_err(CliError::from);
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(cut);
                }
            });
        }
    });
    let mut done = done.into_iter();
    let mut all = Vec::new();
    for scenario in scenarios {
        let mut cuts = Vec::new();
        for slot in done.by_ref().take(scenario.passes.len()) {
            let cut = slot.into_inner().unwrap_or_else(PoisonError::into_inner);
            let lost = || {
                Err(CliError::new(
                    Exit::Internal,
                    "a pass of a scenario did not run",
                ))
            };
            cuts.push(cut.unwrap_or_else(lost)?);
        }
        all.push(cuts);
    }
    Ok(all)
}
