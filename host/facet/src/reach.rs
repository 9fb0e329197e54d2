//! Whether a machine can make every motion of a job, before anything turns.

use crate::gem::Gem;
use crate::job::{Coolant, Job, Operation};
use crate::problem::{Problem, Problems, Refused};
use haptimill_client::session::find_home_pose;
use haptimill_hil_sim::process::LapConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use std::collections::BTreeSet;

/// Newtons of the force of the controller's unit.
const NEWTON: f64 = 65_536.0;

/// Largest part of the force at which the machine stops that a facet is ground with.
const FORCE_PART: f64 = 0.375;

/// Part of the force at which the machine stops that a job may ask for: the force of a turn of the
/// lap, and that of the landing, is above its mean.
const LARGEST_PART: f64 = 0.5;

/// Force at which the sensor of the machine stops it, N.
fn limit_n(machine: &MachineFile) -> Option<f64> {
    let force = machine.config.force.as_ref()?;
    Some(f64::from(force.sensor.limit.0) / NEWTON)
}

/// Largest steady force for the facets of a job on this machine, N: three eighths of the force at
/// which it stops, or the default without a sensor.
#[must_use]
pub fn max_force_n(machine: &MachineFile) -> f64 {
    let max = crate::job::MAX_FORCE_N;
    limit_n(machine).map_or(max, |limit| max.min(FORCE_PART * limit))
}

/// The coolant of a machine that a part program switches.
#[must_use]
pub fn coolant(machine: &MachineFile) -> Coolant {
    let outputs = settings(machine).outputs;
    match (outputs.flood, outputs.mist) {
        (Some(_), _) => Coolant::Flood,
        (None, Some(_)) => Coolant::Mist,
        (None, None) => Coolant::None,
    }
}

/// Whether the index of a machine wraps around, so that the sign of its word is a direction.
#[must_use]
pub fn index_wraps(machine: &MachineFile) -> bool {
    let mut pose = machine.pose.iter();
    pose.any(|axis| axis.name == "index" && axis.wraps())
}

/// Refuses a machine file of another model.
fn check_model(machine: &MachineFile) -> Option<Problem> {
    let code = machine.config.model.descriptor().code;
    (code != "facet").then(|| Problem {
        line: 0,
        facet: None,
        what: format!("the machine is of the model \"{code}\", no faceting machine"),
        remedy: "give the machine file of a faceting machine (model = \"facet\")".to_string(),
    })
}

/// The motions of an operation from above the lap, without the strokes between the first and the
/// last one: the pose of a stroke is between theirs, with the angle and index of the facet, and
/// joints are linear in it.
fn ends(job: &Job, operation: &Operation) -> String {
    let is_stroke = |line: &&str| line.starts_with("G1");
    let mut strokes = operation.grind.lines().filter(is_stroke);
    let approach = operation.grind.lines().filter(|line| !is_stroke(line));
    let above = job.above();
    let mut lines = vec![above.as_str()];
    lines.extend(approach);
    lines.extend(strokes.next());
    lines.extend(strokes.next_back());
    let sweep = operation.sweep.lines().filter(is_stroke);
    lines.extend(sweep.take(2));
    lines.extend(operation.retract.lines());
    lines.join("\n")
}

/// Checks a job against a machine: model, force, and the motions of every facet on every lap.
///
/// # Errors
/// Every facet that the machine cannot grind, by line of the design and name.
pub fn check_machine(gem: &Gem, job: &Job, machine: &MachineFile) -> Result<(), Refused> {
    let refuse = |problem| {
        Err(Refused {
            file: machine.file.clone(),
            problems: vec![problem],
            more: 0,
        })
    };
    if let Some(problem) = check_model(machine) {
        return refuse(problem);
    }
    let plain = |what: String, remedy: &str| Problem {
        line: 0,
        facet: None,
        what,
        remedy: remedy.to_string(),
    };
    if job.settings.index_wraps != index_wraps(machine) {
        let what = "the index of the machine is not that of the job: one wraps around";
        return refuse(plain(what.to_string(), "plan the job for this machine"));
    }
    if job.settings.mode.has_force() {
        let Some(limit) = limit_n(machine) else {
            let what = "the machine has no force sensor".to_string();
            return refuse(plain(
                what,
                "grind by feed, or add [force] to the machine file",
            ));
        };
        let max = LARGEST_PART * limit;
        if let Some(lap) = job.settings.laps.iter().find(|lap| lap.force_n > max) {
            let what = format!(
                "the force of lap {} is {} N, and the machine stops at {limit} N",
                lap.name, lap.force_n
            );
            let remedy = format!("lower force_n of the lap to {max} or less");
            return refuse(plain(what, &remedy));
        }
    }
    let model = Model::new(machine);
    let home = match find_home_pose(machine, &model) {
        Ok(home) => home,
        Err(error) => return refuse(plain(error.message, "correct the machine file")),
    };
    let mut problems = Problems::new(&gem.file);
    check_lap(gem, job, &mut problems);
    // Each operation from above the lap, so that a problem is that of its facet.
    let options = program_options(machine, model.to_engineering_units(&home));
    let (settings, mut seen) = (settings(machine), BTreeSet::new());
    for operation in job.passes.iter().flat_map(|pass| &pass.operations) {
        if seen.contains(&operation.facet) {
            continue;
        }
        let text = ends(job, operation);
        let planned = haptimill_gcode::read("job", text.as_bytes(), &options)
            .and_then(|program| Plan::new(&program, &settings, &model));
        let Err(refused) = planned else { continue };
        seen.insert(operation.facet);
        let facet = &gem.design.facets[operation.facet];
        let lap = &job.settings.laps[operation.lap].name;
        // One problem of a facet is enough.
        if let Some(problem) = refused.problems.first() {
            let what = format!("on lap {lap}: {}", problem.what);
            let remedy = "change the size of the stone, or the machine file";
            problems.report(facet.line, Some(&facet.name), what, remedy);
        }
    }
    problems.finish(Some(()))
}

/// Reports facets that reach beyond the lap.
fn check_lap(gem: &Gem, job: &Job, problems: &mut Problems) {
    let settings = &job.settings;
    let half = 0.5 * settings.sweep_mm;
    let rim = LapConfig::default().radius_mm;
    let inner = settings.radius_mm - half;
    let outer = rim - settings.radius_mm - half;
    let max = inner.min(outer);
    let mut seen = BTreeSet::new();
    for operation in job.passes.iter().flat_map(|pass| &pass.operations) {
        if operation.extent_mm > max && seen.insert(operation.facet) {
            let facet = &gem.design.facets[operation.facet];
            let what = format!(
                "reaches {:.1} mm from the axis of the dop on the lap, and the lap of {rim} mm \
                 radius has {max:.1} mm beside the sweep",
                operation.extent_mm
            );
            problems.report(facet.line, Some(&facet.name), what, "lower --width");
        }
    }
}
