//! A whole stone on the simulated machine: both sides, three laps, the transfer.

use haptimill_facet::{Cutting, Gem, Job, JobSettings, Mode, RunOptions, cut, read};
use haptimill_machine_file::MachineFile;

/// A square stone of 13 facets.
const SMALL: &str = "GemCad 5.0\ng 64 0.0\ny 4 y\nI 1.54\nH Small\n\
a -90 1.0 0 n G 16 32 48\na -45 0.72 0 n P 16 32 48\n\
a 40 0.70 0 n C 16 32 48\na 0 0.3 0 n T\n";

fn machine() -> MachineFile {
    let text = include_str!("../../../machines/facet.toml");
    MachineFile::parse("facet.toml", text).unwrap_or_else(|problems| panic!("{problems}"))
}

fn stone(mode: Mode, options: &RunOptions) -> (Gem, Cutting) {
    let design = read("small.asc", SMALL.as_bytes()).unwrap();
    let gem = Gem::new("small.asc", design, 2.5, None).unwrap();
    let settings = JobSettings {
        mode,
        ..JobSettings::default()
    };
    let job = Job::new(&gem, settings).unwrap();
    let cutting = cut(&gem, &job, &machine(), options, &mut |_, _| {}).unwrap();
    (gem, cutting)
}

/// Every facet within 0.02 degrees, every meet point within 0.02 mm, and no face that is none of
/// the design.
fn check(gem: &Gem, cutting: &Cutting) {
    let measured = &cutting.measured;
    println!(
        "angle {:.5} deg, depth {:.5} mm, meet {:.5} mm",
        measured.worst_angle_deg(),
        measured.worst_depth_mm(),
        measured.worst_meet_mm()
    );
    assert_eq!(measured.missing, [] as [usize; 0]);
    assert_eq!(measured.strange, 0);
    assert_eq!(measured.facets.len(), gem.design.facets.len());
    assert!(measured.worst_angle_deg() < 0.02);
    assert!(measured.worst_meet_mm() < 0.02);
}

#[test]
fn a_stone_is_cut_by_feed() {
    let (gem, cutting) = stone(Mode::Feed, &RunOptions::default());
    check(&gem, &cutting);
    let volume = gem.body.volume();
    assert!((cutting.measured.volume_mm3 - volume).abs() < 0.03 * volume);
}
