//! The bandwidth of force control: the amplitude of the force that a run-out of a lap causes, by
//! its frequency, by force and by feed. Prints a table. Arguments: [K_V in N s/mm] [SVG file of the
//! curve].
//!
//! The table of a stone of 2.5 mm is ground on a bed of 20 N/mm^3, a contact of about 200 N/mm. The
//! removal per second is that of the second default lap at 600 rev/min, at each speed.

use core::fmt::Write as _;
use haptimill_facet::{Gem, Job, JobSettings, Lap, Mode, RunOptions, cut, index_wraps, read};
use haptimill_machine_file::MachineFile;

const DESIGN: &str = "GemCad 5.0\ng 64 0.0\na -90 1.0 0 n G 16 32 48\na -45 0.72 0 n P 16 32 48\n\
a 40 0.70 0 n C 16 32 48\na 0 0.3 0 n T\n";
const MACHINE: &str = include_str!("../../../machines/facet.toml");
const RUN_OUT_MM: f64 = 0.02;
const SPEEDS: [f64; 10] = [
    20.0, 30.0, 45.0, 70.0, 100.0, 150.0, 250.0, 400.0, 700.0, 1200.0,
];

/// Median over turns of half the range of the force, N per um of half the run-out.
fn amplitude(machine: &str, rpm: f64, mode: Mode) -> Result<f64, Box<dyn std::error::Error>> {
    let machine = MachineFile::parse("facet.toml", machine)?;
    let gem = Gem::new(
        "table.asc",
        read("table.asc", DESIGN.as_bytes())?,
        2.5,
        None,
    )?;
    let settings = JobSettings {
        laps: vec![Lap {
            name: "1200".to_string(),
            rpm,
            stock_mm: 0.0,
            feed_mm_s: 0.006,
            force_n: 3.0,
            spark_out_s: 2.0,
            preston_mm2_n: 8e-6 * 600.0 / rpm,
        }],
        mode,
        index_wraps: index_wraps(&machine),
        ..JobSettings::default()
    };
    let options = RunOptions {
        run_out_mm: RUN_OUT_MM,
        bed_n_mm3: Some(20.0),
        only: vec![12],
        ..RunOptions::default()
    };
    let job = Job::new(&gem, settings)?;
    let cutting = cut(&gem, &job, &machine, &options, &mut |_, _| {})?.whole()?;
    let turns = &cutting.operations[0].turns;
    // The first contact is over after a third.
    let mut halves: Vec<f64> = turns[turns.len() / 3..]
        .iter()
        .map(|turn| 0.5 * (turn.range_n[1] - turn.range_n[0]))
        .collect();
    halves.sort_by(f64::total_cmp);
    let middle = halves.get(halves.len() / 2).ok_or("no turn of the lap")?;
    Ok(middle / (0.5e3 * RUN_OUT_MM))
}

/// A curve of the ratio over the frequency, both logarithmic.
fn curve(points: &[(f64, f64)]) -> String {
    let x = |hertz: f64| 70.0 + 560.0 * libm::log10(hertz / 0.2) / 2.1;
    let y = |ratio: f64| 40.0 + 300.0 * libm::log10(1.5 / ratio) / 2.0;
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 660 400\" \
         font-family=\"sans-serif\" font-size=\"13\"><rect width=\"660\" height=\"400\" \
         fill=\"#fff\"/><text x=\"70\" y=\"22\">Force of a run-out under force control, part of \
         that by feed</text>",
    );
    for hertz in [0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0] {
        let at = x(hertz);
        let _ = write!(
            svg,
            "<path d=\"M{at:.1} 40V340\" stroke=\"#ddd\"/><text x=\"{at:.1}\" y=\"358\" \
             text-anchor=\"middle\">{hertz}</text>"
        );
    }
    for ratio in [0.02, 0.05, 0.1, 0.2, 0.5, 1.0] {
        let at = y(ratio);
        let _ = write!(
            svg,
            "<path d=\"M70 {at:.1}H630\" stroke=\"#ddd\"/><text x=\"62\" y=\"{:.1}\" \
             text-anchor=\"end\">{ratio}</text>",
            at + 4.0
        );
    }
    let line: Vec<String> = points
        .iter()
        .map(|(hertz, ratio)| format!("{:.1} {:.1}", x(*hertz), y(*ratio)))
        .collect();
    let _ = write!(
        svg,
        "<path d=\"M{}\" fill=\"none\" stroke=\"#1f5fa8\" stroke-width=\"2\"/>",
        line.join("L")
    );
    for (hertz, ratio) in points {
        let (x, y) = (x(*hertz), y(*ratio));
        let _ = write!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"#1f5fa8\"/>"
        );
    }
    svg.push_str(
        "<text x=\"350\" y=\"384\" text-anchor=\"middle\">turns of the lap, Hz</text></svg>\n",
    );
    svg
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut machine = MACHINE.to_string();
    if let Some(damping) = arguments.next() {
        // The gains of z; a smaller K_V needs a smaller K_A, or the loop oscillates.
        let gains = "mass_n_s2_per_mm = 0.05       # K_A\ndamping_n_s_per_mm = 20.0 ";
        assert!(
            machine.contains(gains),
            "the gains of the machine file differ"
        );
        let gains_here = format!("mass_n_s2_per_mm = 0.02\ndamping_n_s_per_mm = {damping} ");
        machine = machine.replace(gains, &gains_here);
    }
    println!("rev/min     Hz   by force    by feed  N/um   ratio");
    let mut points = Vec::new();
    for rpm in SPEEDS {
        let force = amplitude(&machine, rpm, Mode::Force)?;
        let feed = amplitude(&machine, rpm, Mode::Feed)?;
        let hertz = rpm / 60.0;
        println!(
            "{rpm:7} {hertz:6.2} {force:10.4} {feed:10.4} {:13.3}",
            force / feed
        );
        points.push((hertz, force / feed));
    }
    if let Some(path) = arguments.next() {
        std::fs::write(path, curve(&points))?;
    }
    Ok(())
}
