//! The mean force of each turn of the lap in every operation of a job by force. Prints, for each
//! lap and stage, how many operations hold their force within 10 % while the program lowers a stone
//! that force control displaces, from 0.6 s after its beginning. Arguments: MACHINE DESIGN WIDTH
//! RUN_OUT_MM [BED_N_MM3] [force|both].

use haptimill_facet::{Gem, Job, JobSettings, Mode, RunOptions, cut, index_wraps, read};
use haptimill_machine_file::MachineFile;
use std::collections::BTreeMap;

/// Time from the first displacement to the first turn that counts, s.
const SETTLED_S: f64 = 0.6;

/// What the operations of a lap and stage did.
#[derive(Default)]
struct Row {
    operations: usize,
    /// Operations with a turn that counts, and those of them whose turns are all within 10 %.
    counted: usize,
    held: usize,
    turns: usize,
    turns_held: usize,
    min: f64,
    max: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, machine, design, width, run_out, rest @ ..] = &arguments[..] else {
        return Err("write MACHINE DESIGN WIDTH RUN_OUT_MM [BED_N_MM3] [force|both]".into());
    };
    let machine = MachineFile::parse(machine, &std::fs::read_to_string(machine)?)?;
    let text = std::fs::read(design)?;
    let gem = Gem::new(design, read(design, &text)?, width.parse()?, None)?;
    let settings = JobSettings {
        mode: match rest.get(1).map(String::as_str) {
            Some("both") => Mode::Both,
            _ => Mode::Force,
        },
        index_wraps: index_wraps(&machine),
        ..JobSettings::default()
    };
    let job = Job::new(&gem, settings)?;
    let options = RunOptions {
        run_out_mm: run_out.parse()?,
        bed_n_mm3: rest.first().map(|text| text.parse()).transpose()?,
        ..RunOptions::default()
    };
    let cutting = cut(&gem, &job, &machine, &options, &mut |_, _| {})?.whole()?;
    let mut rows: BTreeMap<(usize, String, &str), Row> = BTreeMap::new();
    for result in &cutting.operations {
        let pass = &job.passes[result.pass];
        let facet = &gem.design.facets[result.facet];
        let lap = &job.settings.laps[pass.lap];
        let key = (result.pass, lap.name.clone(), facet.stage.name());
        let row = rows.entry(key).or_default();
        row.operations += 1;
        let after = (SETTLED_S * lap.rpm.abs() / 60.0).ceil() as usize;
        let operation = pass.operations.iter().find(|it| it.facet == result.facet);
        let setpoint = operation.map_or(lap.force_n, |it| it.force_n);
        let parts: Vec<f64> = result
            .held
            .iter()
            .skip(after)
            .map(|turn| turn.force_n / setpoint)
            .collect();
        if parts.is_empty() {
            continue;
        }
        let min = parts.iter().copied().fold(f64::INFINITY, f64::min);
        let max = parts.iter().copied().fold(0.0, f64::max);
        println!(
            "{} {} {}: {setpoint:.2} N, {} turns, {min:.3} to {max:.3}",
            lap.name,
            facet.stage.name(),
            facet.name,
            parts.len()
        );
        if row.counted == 0 {
            row.min = f64::INFINITY;
        }
        row.counted += 1;
        row.turns += parts.len();
        let held = parts
            .iter()
            .filter(|part| (*part - 1.0).abs() <= 0.1)
            .count();
        row.turns_held += held;
        row.held += usize::from(held == parts.len());
        row.min = row.min.min(min);
        row.max = row.max.max(max);
    }
    println!("pass lap stage: operations, with turns that count, held, turns, held, least, most");
    for ((pass, lap, stage), row) in rows {
        println!(
            "{pass} {lap} {stage}: {}, {}, {}, {}, {}, {:.3}, {:.3}",
            row.operations, row.counted, row.held, row.turns, row.turns_held, row.min, row.max
        );
    }
    let measured = &cutting.measured;
    let seconds: f64 = cutting.operations.iter().map(|it| it.seconds).sum();
    println!(
        "normal {:.4} deg, depth {:.2} um, meet {:.2} um, {:.1} min",
        measured.worst_angle_deg(),
        1e3 * measured.worst_depth_mm(),
        1e3 * measured.worst_meet_mm(),
        seconds / 60.0
    );
    Ok(())
}
