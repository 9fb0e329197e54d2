//! Cuts a design on a simulated machine and prints the measurement; the report is `stone.html`.
//! Arguments: MACHINE DESIGN WIDTH [feed|force|both] [FROM..TO] [RUN_OUT].

use haptimill_facet::{Gem, Job, JobSettings, Mode, RunOptions, cut, index_wraps, read};
use haptimill_machine_file::MachineFile;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, machine, design, width, rest @ ..] = &arguments[..] else {
        return Err("write MACHINE DESIGN WIDTH [feed|force|both] [FROM..TO] [RUN_OUT]".into());
    };
    let machine = MachineFile::parse(machine, &std::fs::read_to_string(machine)?)?;
    let text = std::fs::read(design)?;
    let gem = Gem::new(design, read(design, &text)?, width.parse()?, None)?;
    let settings = JobSettings {
        mode: match rest.first().map(String::as_str) {
            Some("force") => Mode::Force,
            Some("both") => Mode::Both,
            _ => Mode::Feed,
        },
        index_wraps: index_wraps(&machine),
        ..JobSettings::default()
    };
    let job = Job::new(&gem, settings)?;
    let only = match rest.get(1).and_then(|facets| facets.split_once("..")) {
        Some((from, to)) => (from.parse()?..to.parse()?).collect(),
        None => Vec::new(),
    };
    let run_out_mm = rest.get(2).map_or(Ok(0.0), |text| text.parse())?;
    let options = RunOptions {
        only,
        run_out_mm,
        ..RunOptions::default()
    };
    let began = std::time::Instant::now();
    let cutting = cut(&gem, &job, &machine, &options, &mut |done, of| {
        if done % 10 == 0 {
            eprintln!("{done}/{of} after {:?}", began.elapsed());
        }
    })?;
    for operation in &cutting.operations {
        let facet = &gem.design.facets[operation.facet];
        println!(
            "{} {} {:.1} s, {} sweeps, {:?}",
            operation.pass, facet.name, operation.seconds, operation.sweeps, operation.force
        );
        let every = (operation.turns.len() / 40).max(1);
        let turns = operation.turns.iter().step_by(every);
        let shown: Vec<String> = turns.map(|turn| format!("{:.2}", turn.force_n)).collect();
        println!("  mean force of turns, N: {}", shown.join(" "));
    }
    std::fs::write(
        "stone.html",
        haptimill_facet::report(&gem, &job, &cutting, None),
    )?;
    let measured = &cutting.measured;
    for facet in &measured.facets {
        println!(
            "{:10} {:.4} deg, depth {:+.2} um, area {:.3}",
            gem.design.facets[facet.facet].name,
            facet.error_deg,
            1e3 * facet.depth_mm,
            facet.area_mm2
        );
    }
    println!(
        "missing {:?}, strange {}, angle {:.4} deg, depth {:.2} um, meet {:.2} um, yield {:.3}",
        measured.missing,
        measured.strange,
        measured.worst_angle_deg(),
        1e3 * measured.worst_depth_mm(),
        1e3 * measured.worst_meet_mm(),
        measured.yield_part
    );
    let seconds: f64 = cutting.operations.iter().map(|it| it.seconds).sum();
    println!("{seconds:.0} s of the machine in {:?}", began.elapsed());
    Ok(())
}
