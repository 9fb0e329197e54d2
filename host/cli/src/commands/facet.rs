//! `haptimill facet`: from a gem design to a cut stone.

mod args;
mod grind;

pub use args::{
    By, CalibrateArgs, CheckArgs, DesignArgs, FacetCommand, JobArgs, PlanArgs, RunArgs,
};

use super::{CliError, Exit, output};
use grind::grind;
use haptimill_facet::{
    Design, Gem, Job, JobSettings, Lap, calibrate, check_machine, coolant, index_wraps,
    max_force_n, read,
};
use haptimill_machine_file::{MachineFile, input};
use serde_json::json;
use std::path::Path;

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
    let notices = design.notices.clone();
    let cut = Gem::new(&file, design, args.width, args.rough);
    // A gem has those of its design, and those of the cut.
    let notices = cut.as_ref().map_or(&notices, |gem| &gem.design.notices);
    for notice in notices {
        eprintln!("notice: {}", notice.text(&file));
    }
    cut.map_err(bad)
}

fn settings(args: &JobArgs, machine: &MachineFile) -> Result<JobSettings, CliError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Laps {
        lap: Vec<Lap>,
    }
    let mut settings = JobSettings {
        mode: args.by.mode(),
        index_wraps: index_wraps(machine),
        max_force_n: max_force_n(machine),
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
    for tier in gem.design.tiers() {
        print_line!(
            "{:<11} {:<8} {:>6.2} deg  {}",
            tier.stage.name(),
            tier.name,
            tier.angle_deg,
            tier.index_text()
        );
    }
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

/// Refuses an output that is an input of the command.
fn keep_inputs(design: &DesignArgs, args: &JobArgs, out: &Path) -> Result<(), CliError> {
    let inputs = [
        (Some(&design.design), "design"),
        (args.laps.as_ref(), "file of laps"),
        (args.machine.as_ref(), "machine file"),
    ];
    for (input, what) in inputs {
        if let Some(input) = input {
            output::refuse_overwrite(input, out, what)?;
        }
    }
    Ok(())
}

fn plan(args: &PlanArgs) -> Result<(), CliError> {
    keep_inputs(&args.design, &args.job, &args.out)?;
    let (gem, job, machine) = planned(&args.design, &args.job)?;
    let text = job.program(&gem, coolant(&machine));
    if job.settings.mode.has_force() {
        eprintln!(
            "notice: the program is for a controller that holds the force of the height; without \
             force control it feeds the stone at up to {} mm/s",
            job.max_feed_mm_s()
        );
    }
    if args.out.as_os_str() == "-" {
        print_line!("{}", text.trim_end());
        return Ok(());
    }
    output::save(&args.out, &text)
}

/// Readings that differ by more than this from the lengths are refused, mm.
const RESIDUAL_MM: f64 = 0.01;

fn print_lengths(args: &CalibrateArgs) -> Result<(), CliError> {
    let found = calibrate(args.at_0, args.at_90, args.at_180);
    if found.residual > RESIDUAL_MM {
        return Err(bad(format!(
            "the readings contradict each other: they differ by up to {:.4} mm from those of one \
             arm, and {RESIDUAL_MM} mm is the most; measure again",
            found.residual
        )));
    }
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
    Ok(())
}
