//! A whole stone on the simulated machine: both sides, three laps, the transfer.

use haptimill_facet::thesis::{SMALL, SMALL_MM};
use haptimill_facet::{
    Cutting, Gem, Job, JobSettings, Mode, RunOptions, Side, cut, index_wraps, read,
};
use haptimill_hil_sim::process::grinding::HardSpot;
use haptimill_hil_sim::vector::dot;
use haptimill_machine_file::MachineFile;

fn machine() -> MachineFile {
    let text = include_str!("../../../machines/facet.toml");
    MachineFile::parse("facet.toml", text).unwrap_or_else(|problems| panic!("{problems}"))
}

fn stone(mode: Mode, options: &RunOptions) -> (Gem, Cutting) {
    let design = read("small.asc", SMALL.as_bytes()).unwrap();
    let gem = Gem::new("small.asc", design, SMALL_MM, None).unwrap();
    let settings = JobSettings {
        mode,
        ..JobSettings::default()
    };
    let job = Job::new(&gem, settings).unwrap();
    let cutting = cut(&gem, &job, &machine(), options, &mut |_, _| {}).unwrap();
    (gem, cutting.whole().unwrap())
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
    only_its_own_facet(gem, cutting);
}

/// The plant records each contact of the stone with a lap. There is one for each operation, with
/// the normal of its facet: no facet was touched by the approach of another.
fn only_its_own_facet(gem: &Gem, cutting: &Cutting) {
    assert_eq!(cutting.ground.len(), cutting.operations.len());
    for (ground, operation) in cutting.ground.iter().zip(&cutting.operations) {
        let designed = gem.plane(operation.facet);
        // As the stone sits on the dop: turned over about x for the pavilion.
        let is_over = gem.design.facets[operation.facet].side == Side::Pavilion;
        let flip = if is_over { -1.0 } else { 1.0 };
        let [x, y, z] = designed.normal;
        let cosine = dot(ground.plane.normal, [x, flip * y, flip * z]);
        assert!(
            cosine > 0.02_f64.to_radians().cos() - 1e-12,
            "{operation:?}"
        );
        // And down to its depth and the stock of its lap, no deeper.
        assert!(ground.plane.distance > designed.distance - 0.001);
        assert!(ground.plane.distance < designed.distance + 0.06);
    }
}

#[test]
fn a_stone_is_cut_by_feed() {
    let (gem, cutting) = stone(Mode::Feed, &RunOptions::default());
    check(&gem, &cutting);
    let volume = gem.body.volume();
    assert!((cutting.measured.volume_mm3 - volume).abs() < 0.03 * volume);
}

/// On a machine whose index wraps around the stone is the design, too: a negative word of the index
/// would be another angle.
#[test]
fn a_stone_is_cut_where_the_index_wraps() {
    let text = include_str!("../../../machines/facet.toml");
    let text = text
        .replace("low_deg = -165.0\nhigh_deg = 165.0", "wrap = true")
        .replace("low_deg = -166.5\nhigh_deg = 166.5", "wrap = true")
        .replace("low = -200.0\nhigh = 200.0", "low = -1e5\nhigh = 1e5");
    let machine = MachineFile::parse("facet.toml", &text);
    let machine = machine.unwrap_or_else(|problems| panic!("{problems}"));
    let design = read("small.asc", SMALL.as_bytes()).unwrap();
    let gem = Gem::new("small.asc", design, SMALL_MM, None).unwrap();
    let mut settings = JobSettings {
        index_wraps: index_wraps(&machine),
        ..JobSettings::default()
    };
    settings.laps.remove(1);
    let job = Job::new(&gem, settings).unwrap();
    let cutting = cut(&gem, &job, &machine, &RunOptions::default(), &mut |_, _| {});
    let cutting = cutting.unwrap().whole().unwrap();
    check(&gem, &cutting);
}

/// The same stone with the table, the facet 0, cut first: it is as large as the rough.
fn table_first(width_mm: f64) -> Gem {
    let text = "g 64 0.0\na 0 0.3 0 n T\na 40 0.70 0 n C 16 32 48\n\
                a -90 1.0 0 n G 16 32 48\na -45 0.72 0 n P 16 32 48\n";
    let design = read("table.asc", text.as_bytes()).unwrap();
    Gem::new("table.asc", design, width_mm, None).unwrap()
}

/// A table of 115 mm^2: with the feed of the lap its force would be 80 N, beyond the 40 N at which
/// the machine stops. By feed the planned force is at most 15 N, and so is the mean of each turn,
/// but for the friction of the lift.
#[test]
fn the_force_of_a_large_facet_is_limited_by_feed() {
    let gem = table_first(8.0);
    let mut settings = JobSettings::default();
    settings.laps.truncate(1);
    settings.laps[0].stock_mm = 0.0;
    let max = settings.max_force_n;
    let job = Job::new(&gem, settings).unwrap();
    let area = job.passes[0].operations[0].area_mm2;
    assert!((area - 115.0).abs() < 5.0, "{area} mm^2");
    let options = RunOptions {
        only: vec![0],
        ..RunOptions::default()
    };
    let cutting = cut(&gem, &job, &machine(), &options, &mut |_, _| {}).unwrap();
    let cutting = cutting.whole().unwrap();
    let force = &cutting.operations[0].force;
    println!("turns {:.2} to {:.2} N", force.min_turn_n, force.max_turn_n);
    assert!(force.max_turn_n < max + 3.0, "{force:?}");
    // The limit is used.
    assert!(force.max_turn_n > 0.8 * max, "{force:?}");
}

/// A stone that is ground 60 times slower than planned is displaced when the program ends. It
/// sparks out as long as material is removed, here more than 60 times, and is at its depth.
#[test]
fn a_slow_facet_sparks_out_to_its_depth() {
    let gem = table_first(2.5);
    let mut settings = JobSettings {
        mode: Mode::Force,
        ..JobSettings::default()
    };
    settings.laps.truncate(1);
    settings.laps[0].stock_mm = 0.0;
    let job = Job::new(&gem, settings).unwrap();
    let options = RunOptions {
        only: vec![0],
        hard_spot: Some(HardSpot {
            centre: [0.0; 3],
            radius_mm: 9.0,
            part: 1.0 / 60.0,
        }),
        ..RunOptions::default()
    };
    let cutting = cut(&gem, &job, &machine(), &options, &mut |_, _| {}).unwrap();
    let cutting = cutting.whole().unwrap();
    println!("{} spark-outs", cutting.operations[0].sweeps);
    assert!(cutting.operations[0].sweeps > 60);
    let height = cutting.stone.reach([0.0, 0.0, 1.0]);
    let depth = height - gem.plane(0).distance;
    assert!(depth.abs() < 0.005, "{depth}");
}

/// A job that the machine stops names the facet, its line and the lap, and keeps the stone as it is
/// then, with the facets that are done.
#[test]
fn a_job_that_stops_keeps_its_facets() {
    let gem = table_first(8.0);
    let mut settings = JobSettings {
        max_force_n: 1000.0,
        ..JobSettings::default()
    };
    // The second lap takes 0.15 mm in one stroke.
    settings.laps[0].stock_mm = 0.15;
    settings.laps[0].feed_mm_s = 0.01;
    settings.laps[1].feed_mm_s = 4.0;
    let job = Job::new(&gem, settings).unwrap();
    let options = RunOptions {
        only: vec![0],
        ..RunOptions::default()
    };
    let cutting = cut(&gem, &job, &machine(), &options, &mut |_, _| {}).unwrap();
    let error = cutting.stopped.as_ref().unwrap();
    assert_eq!(error.kind, haptimill_client::ErrorKind::Fault);
    let expected = "table.asc:2: facet T@0 on lap 1200: machine fault: the force on the tool was";
    assert!(error.message.starts_with(expected), "{error}");
    assert_eq!(cutting.operations.len(), 1);
    assert!(cutting.measured.volume_mm3 < gem.rough_body().volume());
    assert!(cutting.whole().is_err());
}

/// By force the job ends each facet at its depth. Before, the further sweeps ran with the lap at a
/// standstill, and a stone that was displaced stayed high.
#[test]
fn a_stone_is_cut_by_force() {
    let (gem, cutting) = stone(Mode::Force, &RunOptions::default());
    check(&gem, &cutting);
    assert!(cutting.measured.worst_depth_mm() < 0.005);
}

/// By the feed of the lap, with the force held.
#[test]
fn a_stone_is_cut_by_both() {
    let (gem, cutting) = stone(Mode::Both, &RunOptions::default());
    check(&gem, &cutting);
    assert_eq!(cutting.measured.beyond(&gem), None);
    assert!(cutting.measured.worst_depth_mm() < 0.005);
}

/// A whole example of 6 mm by force, as docs/faceting.md measures it.
#[test]
fn an_example_is_cut_by_force() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/pentagon.asc");
    let design = read("pentagon.asc", &std::fs::read(path).unwrap()).unwrap();
    let gem = Gem::new("pentagon.asc", design, 6.0, None).unwrap();
    let settings = JobSettings {
        mode: Mode::Force,
        ..JobSettings::default()
    };
    let job = Job::new(&gem, settings).unwrap();
    let cutting = cut(
        &gem,
        &job,
        &machine(),
        &RunOptions::default(),
        &mut |_, _| {},
    );
    let cutting = cutting.unwrap().whole().unwrap();
    check(&gem, &cutting);
    assert!(cutting.measured.worst_depth_mm() < 0.02);
}

/// With a run-out of 20 um and a hard spot in a facet, by force: flat and at depth.
#[test]
fn a_run_out_and_a_hard_spot_leave_flat_facets_at_depth() {
    let options = RunOptions {
        run_out_mm: 0.02,
        hard_spot: Some(HardSpot {
            centre: [0.0, 0.0, 0.3],
            radius_mm: 0.25,
            part: 0.2,
        }),
        ..RunOptions::default()
    };
    let (gem, cutting) = stone(Mode::Force, &options);
    check(&gem, &cutting);
    assert!(cutting.measured.worst_depth_mm() < 0.01);
    // The spot is in the table, the last facet.
    let proud = cutting.measured.facets.iter().map(|facet| facet.proud_mm);
    let proud = proud.fold(0.0, f64::max);
    println!("hard spot {proud:.5} mm");
    assert!(proud > 0.0 && proud < 0.003);
}

/// A run-out of 20 um at 600 rev/min on a bed of 20 N/mm^3, a contact of 200 N/mm: the mean of each
/// turn is within 10 % of the setpoint from 0.6 s after the first contact until the stone is within
/// 10 um of its depth. By feed the force is what the feed makes it.
#[test]
fn the_mean_force_of_each_turn_is_held() {
    let options = RunOptions {
        run_out_mm: 0.02,
        bed_n_mm3: Some(20.0),
        only: vec![12],
        ..RunOptions::default()
    };
    let setpoints = JobSettings::default().laps;
    let turns = |mode| {
        let (_, cutting) = stone(mode, &options);
        let turns = cutting.operations[1].turns.iter();
        turns.map(|turn| turn.force_n).collect::<Vec<f64>>()
    };
    let (force, feed) = (turns(Mode::Force), turns(Mode::Feed));
    println!("by force {force:.2?}\nby feed {feed:.2?}");
    assert!(force.len() > 20, "{} turns", force.len());
    let setpoint = setpoints[1].force_n;
    for mean in &force[6..] {
        assert!(
            (mean / setpoint - 1.0).abs() < 0.1,
            "{mean} of {setpoint} N"
        );
    }
    let off = |mean: &&f64| (*mean / setpoint - 1.0).abs() > 0.1;
    assert!(2 * feed.iter().filter(off).count() > feed.len(), "{feed:?}");
}

/// The sweep wears the lap evenly: in the whole rings of the swept annulus the wear differs by the
/// ratio that docs/faceting.md states, and beyond the annulus there is none. By force the last
/// facets of a job are ground where the sweep happens to be, so five jobs with slightly different
/// wear are judged by their median, and by their largest ratio.
#[test]
fn the_sweep_wears_the_lap_evenly() {
    for (mode, median, largest) in [(Mode::Feed, 1.1, 1.1), (Mode::Force, 1.35, 1.5)] {
        let ratios = [0.0100, 0.0101, 0.0102, 0.0103, 0.0104].map(|wear| {
            let options = RunOptions {
                wear,
                only: vec![12],
                ..RunOptions::default()
            };
            let (_, cutting) = stone(mode, &options);
            let settings = JobSettings::default();
            let ring = 75.0 / cutting.wear.len() as f64;
            let half = 0.5 * settings.sweep_mm;
            let [inner, outer] = [settings.radius_mm - half, settings.radius_mm + half];
            let (mut within, mut beyond) = (Vec::new(), 0.0);
            for (cell, wear) in cutting.wear.iter().enumerate() {
                let [low, high] = [cell as f64 * ring, (cell + 1) as f64 * ring];
                if low >= inner && high <= outer {
                    within.push(*wear);
                } else if high < inner - 0.1 || low > outer + 0.1 {
                    beyond += wear;
                }
            }
            assert!(within.len() >= 7 && beyond == 0.0);
            let min = within.iter().copied().fold(f64::INFINITY, f64::min);
            assert!(min > 0.0);
            within.iter().copied().fold(0.0, f64::max) / min
        });
        println!("{mode:?}: {ratios:.2?}");
        let mut sorted = ratios;
        sorted.sort_by(f64::total_cmp);
        assert!(sorted[2] < median && sorted[4] < largest, "{ratios:?}");
    }
}
