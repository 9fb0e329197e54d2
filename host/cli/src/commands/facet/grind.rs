//! `haptimill facet run`: cuts a gem in the simulator, and writes and prints its errors.

use super::args::{JobArgs, RunArgs};
use super::{job, keep_inputs, planned};
use crate::commands::run::results::ResultFolder;
use crate::commands::{CliError, Exit, interrupt, output};
use haptimill_facet::{Cutting, Gem, Job, RunOptions, coolant, cut, report};
use haptimill_machine_file::MachineFile;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Files of the folder of results.
const REPORT: &str = "report.html";
const FIGURES: &str = "stone.json";
const PROGRAM: &str = "job.ngc";

pub(super) fn grind(args: &RunArgs) -> Result<(), CliError> {
    let (gem, job, machine) = planned(&args.design, &args.job)?;
    let dir = args.out.clone().unwrap_or_else(|| {
        let name = args.design.design.file_stem().unwrap_or_default();
        PathBuf::from(name).with_extension("out")
    });
    for name in [REPORT, FIGURES, PROGRAM] {
        keep_inputs(&args.design, &args.job, &dir.join(name))?;
    }
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
    output::save(&dir.join(REPORT), report(&gem, &job, &cutting, beside))?;
    output::save(&dir.join(FIGURES), format!("{figures:#}\n"))?;
    output::save(&dir.join(PROGRAM), job.program(&gem, coolant(&machine)))?;
    let path = dir.join(REPORT);
    let end = ended(&gem, [Some(&cutting), second.as_ref()], &path);
    if args.json {
        print_line!("{figures:#}");
        return end.map_err(CliError::reported);
    }
    let design = args.design.design.display();
    print_stone(&format!("{design}"), &gem, &cutting);
    if let Some((_, second)) = beside {
        print_stone(&format!("{design}, beside"), &gem, second);
    }
    print_line!("report      {}", path.display());
    end
}

/// The error of a job that ended before its last facet, of a stone that is not the design, or of
/// one that is out of tolerance. Its report is written.
fn ended(gem: &Gem, cuttings: [Option<&Cutting>; 2], report: &Path) -> Result<(), CliError> {
    let all = cuttings.into_iter().flatten();
    if let Some(error) = all.clone().find_map(|it| it.stopped.clone()) {
        return Err(error.into());
    }
    let file = &gem.file;
    if let Some(cutting) = all.clone().find(|it| !it.measured.is_design()) {
        let measured = &cutting.measured;
        let what = format!(
            "{file}: the stone is not the design: {} facets are missing, and {} faces are not \
             facets; {} shows them; check the machine file and the disturbances",
            measured.missing.len(),
            measured.strange,
            report.display()
        );
        return Err(CliError::new(Exit::Fault, what));
    }
    let beyond = all.clone().find_map(|it| it.measured.beyond(gem));
    beyond.map_or(Ok(()), |beyond| {
        let what = format!(
            "{file}: the stone is out of tolerance: {beyond}; {} shows all errors; check the \
             machine file and the disturbances, or cut a smaller stone",
            report.display()
        );
        Err(CliError::new(Exit::Fault, what))
    })
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
    if !measured.is_design() {
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
            "min_turn_n": force.min_turn_n, "max_turn_n": force.max_turn_n,
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
