//! Jobs of designs: approach, reach of the machine, laps, mounts.

use super::{SMALL, gem, small};
use haptimill_facet::{
    Coolant, Gem, Job, JobSettings, Mode, Side, check_machine, coolant, index_wraps, max_force_n,
    read,
};
use haptimill_hil_sim::polyhedron::Plane;
use haptimill_hil_sim::vector::{length, minus};
use haptimill_machine_file::MachineFile;

/// No part of the stone is on the lap before its facet is: at the retracted height whatever the
/// angle, and at the start of the feed with the angle of the facet.
#[test]
fn no_facet_is_touched_by_the_approach_of_another() {
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        let gem = gem(name);
        let job = Job::new(&gem, JobSettings::default()).unwrap();
        let mut stone = gem.rough_body();
        let mut count = 0;
        for operation in job.passes.iter().flat_map(|pass| &pass.operations) {
            for vertex in stone.vertices() {
                assert!(length(*vertex) < job.retracted_mm - 1.9);
            }
            let heights: Vec<f64> = operation
                .grind
                .split_whitespace()
                .filter_map(|word| word.strip_prefix('Z')?.parse().ok())
                .collect();
            let plane = Plane {
                distance: operation.depth_mm,
                ..gem.plane(operation.facet)
            };
            // Retracted, then straight down to the start of the feed, then never up again.
            assert!((heights[0] - job.retracted_mm).abs() < 1e-3);
            assert!(heights[1] > stone.reach(plane.normal) + 0.04);
            assert!(heights.windows(2).all(|pair| pair[1] <= pair[0]));
            let last = heights.last().unwrap();
            assert!((last - operation.depth_mm).abs() < 1e-4);
            stone.cut(plane, operation.facet);
            count += 1;
        }
        // Every facet on every lap.
        assert_eq!(count, 3 * gem.design.facets.len());
        // Eight decimals of a design leave slivers, which depend on the order.
        assert!((stone.volume() - gem.body.volume()).abs() < 1e-5);
    }
}

fn machine(from: &str, to: &str) -> MachineFile {
    let text = include_str!("../../../../machines/facet.toml");
    assert!(text.contains(from));
    let text = text.replacen(from, to, 1);
    MachineFile::parse("facet.toml", &text).unwrap_or_else(|problems| panic!("{problems}"))
}

/// A job that the machine cannot make is refused by line and facet, each facet once, before
/// anything turns.
#[test]
fn facets_that_the_machine_cannot_reach_are_refused() {
    let sized = |width: f64| Gem::new("small.asc", small(), width, None).unwrap();
    let refused = |gem: &Gem, machine: &MachineFile, mode: Mode| {
        let mut settings = JobSettings {
            mode,
            ..JobSettings::default()
        };
        for lap in &mut settings.laps {
            lap.preston_mm2_n *= 10.0;
        }
        let job = Job::new(gem, settings).unwrap();
        let refused = check_machine(gem, &job, machine);
        refused.map_or_else(|refused| refused.to_string(), |()| String::new())
    };
    let plain = machine("", "");
    for width in [2.5, 6.0, 15.0] {
        assert_eq!(refused(&sized(width), &plain, Mode::Feed), "");
        assert_eq!(refused(&sized(width), &plain, Mode::Force), "");
    }
    // Facets of the girdle need an angle of 90 degrees; they are in line 6.
    let flat = machine(
        "low_deg = -92.0\nhigh_deg = 92.0",
        "low_deg = -60.0\nhigh_deg = 60.0",
    );
    let found = refused(&sized(2.5), &flat, Mode::Feed);
    assert_eq!(found.lines().count(), 4, "{found}");
    for (line, name) in found.lines().zip(["G@0", "G@16", "G@32", "G@48"]) {
        let expected = format!("small.asc:6: facet {name}: on lap 260: A");
        assert!(line.starts_with(&expected), "{line}");
        assert!(line.contains("outside the soft limits"), "{line}");
    }
    // Facets nearer to the axis than the least height.
    let found = refused(&sized(0.38), &plain, Mode::Feed);
    assert!(
        found.starts_with("small.asc:6: facet G@0: on lap"),
        "{found}"
    );
    assert_eq!(found.lines().count(), 13, "{found}");
    // Too large for the lap.
    let found = refused(&sized(60.0), &plain, Mode::Feed);
    assert!(found.contains("small.asc:6: facet G@0: reaches"), "{found}");
    // Too large for the laps.
    let problem = Job::new(&sized(60.0), JobSettings::default()).unwrap_err();
    let expected = "small.asc:6: facet G@0 of 2956.8 mm^2 takes more than 20000 strokes on lap 260";
    assert!(problem.starts_with(expected), "{problem}");
    // No faceting machine; no sensor, or one that stops at less than the job asks for.
    let mill = include_str!("../../../../machines/mill3.toml");
    let mill = MachineFile::parse("mill3.toml", mill).unwrap();
    let found = refused(&sized(2.5), &mill, Mode::Feed);
    let expected = "mill3.toml: the machine is of the model \"cartesian\", no faceting machine";
    assert!(found.starts_with(expected), "{found}");
    let weak = machine("limit_n = 40.0 ", "limit_n = 7.0 ");
    assert_eq!(refused(&sized(2.5), &weak, Mode::Feed), "");
    let found = refused(&sized(2.5), &weak, Mode::Force);
    let expected = "facet.toml: the force of lap 260 is 4 N, and the machine stops at 7 N; lower";
    assert!(found.starts_with(expected), "{found}");
    assert!((max_force_n(&weak) - 2.625).abs() < 1e-9);
    assert!((max_force_n(&plain) - 15.0).abs() < 1e-9);
}

/// Before each pause the lap and the coolant stop, and a facet is ground with both. The stone is
/// turned over once. By force the program says that it needs force control.
#[test]
fn the_program_pauses_with_the_lap_at_a_standstill() {
    let gem = Gem::new("small.asc", small(), 2.5, None).unwrap();
    let counter_clockwise = |mut settings: JobSettings| {
        settings.laps[1].rpm = -600.0;
        settings
    };
    for (mode, coolant, on) in [
        (Mode::Feed, Coolant::None, ""),
        (Mode::Feed, Coolant::Mist, "M7"),
        (Mode::Force, Coolant::Flood, "M8"),
        (Mode::Both, Coolant::None, ""),
    ] {
        let settings = counter_clockwise(JobSettings {
            mode,
            ..JobSettings::default()
        });
        let job = Job::new(&gem, settings).unwrap();
        let text = job.program(&gem, coolant);
        let (mut lap, mut wet, mut pauses, mut cuts) = (false, false, Vec::new(), 0);
        for line in text.lines() {
            match line.split_whitespace().last().unwrap() {
                "M3" | "M4" => lap = true,
                "M5" => lap = false,
                "M7" | "M8" => {
                    assert!(line == on && lap, "{line}");
                    wet = true;
                }
                "M9" => wet = false,
                _ if line.starts_with("M0") => {
                    assert!(!lap && !wet, "{line}");
                    pauses.push(line);
                }
                _ if line.starts_with("G1") => {
                    assert!(lap && wet == (coolant != Coolant::None), "{line}");
                    cuts += 1;
                }
                _ => {}
            }
        }
        assert!(cuts > 100);
        assert!(!lap && !wet && text.ends_with("M30\n"));
        assert_eq!(pauses.len(), job.passes.len());
        let over = pauses.iter().filter(|pause| pause.contains("transfer"));
        assert_eq!(over.count(), 1);
        let says_force = |text: &str| text.contains("force");
        assert_eq!(says_force(pauses[0]), mode.has_force());
        let (header, _) = text.split_once("M0 (MSG").unwrap();
        assert_eq!(says_force(header), mode.has_force());
        // The limit of the feed without force control is that of the strokes.
        let limit = match mode {
            Mode::Feed => "",
            Mode::Force => "fed at up to 0.15 mm/s whatever",
            Mode::Both => "fed at up to 0.08 mm/s whatever",
        };
        assert!(header.contains(limit), "{header}");
        let over = pauses.iter().filter(|pause| {
            pause
                .contains("turn the stone over on a new dop about the axis through index 64 and 32")
        });
        assert_eq!(over.count(), 1);
        assert!(!says_force(pauses[1]));
    }
    assert_eq!(coolant(&machine("", "")), Coolant::None);
    let output = "[[output]]\nname = \"pump\"\nfunction = \"coolant\"\nchannel = 5\nsafe = \"off\"\n\n[planner]";
    assert_eq!(coolant(&machine("[planner]", output)), Coolant::Flood);
}

/// Angle and index of the machine put the normal of a facet on the lap, and stay off the ends of
/// the spin.
#[test]
fn the_mounts_put_each_facet_on_the_lap() {
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        let gem = gem(name);
        let job = Job::new(&gem, JobSettings::default()).unwrap();
        for pass in &job.passes {
            for operation in &pass.operations {
                let normal = gem.plane(operation.facet).normal;
                let [angle, index] = pass.mount.pose(normal, false);
                assert!((-90.0..=90.0).contains(&angle), "{angle}");
                assert!(index.abs() <= 160.0, "{name}: {index}");
                // The tip in the lap frame: turned by the spin, then tilted; z of the lap is
                // against z of the tip where the dop points down.
                let axes = pass.mount.axes();
                let v: [f64; 3] =
                    std::array::from_fn(|i| (0..3).map(|k| axes[k][i] * normal[k]).sum());
                let (s3, c3) = index.to_radians().sin_cos();
                let (s2, c2) = angle.to_radians().sin_cos();
                let spun = [c3 * v[0] - s3 * v[1], s3 * v[0] + c3 * v[1], v[2]];
                let tilted = [
                    c2 * spun[0] + s2 * spun[2],
                    spun[1],
                    c2 * spun[2] - s2 * spun[0],
                ];
                assert!(length(minus(tilted, [0.0, 0.0, 1.0])) < 1e-9, "{tilted:?}");
            }
        }
    }
}

#[test]
fn laps_that_leave_stock_are_refused() {
    let gem = gem("pentagon.asc");
    let mut settings = JobSettings::default();
    settings.laps.swap(0, 1);
    assert!(
        Job::new(&gem, settings.clone())
            .unwrap_err()
            .contains("as much stock")
    );
    settings.laps.truncate(1);
    assert!(
        Job::new(&gem, settings.clone())
            .unwrap_err()
            .contains("write stock_mm = 0")
    );
    settings.laps.clear();
    assert!(Job::new(&gem, settings).unwrap_err().contains("no lap"));
}

/// The index as the program of a machine has it whose index wraps around: an angle below a turn
/// with the direction of the shorter way as its sign. The angle of the dop is that of the facet.
#[test]
fn an_index_that_wraps_is_an_angle_with_a_direction() {
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        let gem = gem(name);
        let settings = JobSettings {
            index_wraps: true,
            ..JobSettings::default()
        };
        let job = Job::new(&gem, settings).unwrap();
        let (mut at, mut back) = (0.0, 0);
        for operation in job.passes.iter().flat_map(|pass| &pass.operations) {
            let is_number = |word: &&str| word.parse::<f64>().is_ok();
            let word = |letter: char| {
                let mut words = operation.grind.split_whitespace();
                let found = words.find_map(|it| it.strip_prefix(letter).filter(is_number));
                found.unwrap()
            };
            let facet = &gem.design.facets[operation.facet];
            assert_eq!(word('A'), format!("{:.6}", facet.angle_deg));
            let flip = if facet.side == Side::Pavilion {
                -1.0
            } else {
                1.0
            };
            let azimuth = flip * gem.design.azimuth_deg(facet.index);
            let due = if facet.angle_deg == 0.0 {
                0.0
            } else {
                180.0 - azimuth
            };
            let text = word('C');
            let index: f64 = text.trim_start_matches('-').parse().unwrap();
            assert!((0.0..360.0).contains(&index), "{text}");
            let off = (index - due + 180.0).rem_euclid(360.0) - 180.0;
            assert!(off.abs() < 1e-6, "{text}, {due} is due");
            let is_back = text.starts_with('-');
            let turn = (index - at).rem_euclid(360.0);
            assert!(is_back == (turn > 180.0), "from {at} to {text}");
            back += usize::from(is_back);
            at = index;
        }
        assert!(back > 0, "{name}");
    }
}

/// The job and the machine agree on the direction of the index.
#[test]
fn a_job_for_another_index_is_refused() {
    let limits = "low_deg = -165.0\nhigh_deg = 165.0";
    let stroke = "low_deg = -166.5\nhigh_deg = 166.5";
    let text = include_str!("../../../../machines/facet.toml");
    let text = text
        .replace(limits, "wrap = true")
        .replace(stroke, "wrap = true");
    let wrapped = MachineFile::parse("facet.toml", &text);
    let wrapped = wrapped.unwrap_or_else(|problems| panic!("{problems}"));
    let gem = Gem::new("small.asc", small(), 2.5, None).unwrap();
    for (machine, wraps) in [(machine("", ""), false), (wrapped, true)] {
        assert_eq!(index_wraps(&machine), wraps);
        let check = |index_wraps| {
            let settings = JobSettings {
                index_wraps,
                ..JobSettings::default()
            };
            check_machine(&gem, &Job::new(&gem, settings).unwrap(), &machine)
        };
        assert_eq!(check(wraps), Ok(()));
        let refused = check(!wraps).unwrap_err().to_string();
        assert!(
            refused.contains("plan the job for this machine"),
            "{refused}"
        );
    }
}

/// Names of facets and laps are comments of the program: whatever they have, the program has the
/// same blocks.
#[test]
fn names_add_nothing_to_the_program() {
    let blocks = |facet: &str, lap: &str| {
        let text = format!(
            "gear = 64\n[[facet]]\nname = \"{facet}\"\nangle = -90\nindex = [0, 16, 32, 48]\n\
             depth = 1.25\n[[facet]]\nangle = -45\nindex = [0, 16, 32, 48]\ndepth = 0.9\n\
             [[facet]]\ntransfer = true\n[[facet]]\nangle = 0\nindex = 0\ndepth = 0.5\n"
        );
        let design = read("a.toml", text.as_bytes()).unwrap_or_else(|it| panic!("{it}"));
        assert!(design.facets[0].name.lines().count() == 1);
        let gem = Gem::new("a.toml", design, 2.5, None).unwrap_or_else(|it| panic!("{it}"));
        let mut settings = JobSettings::default();
        settings.laps[2].name = lap.to_string();
        let job = Job::new(&gem, settings).unwrap();
        let program = job.program(&gem, Coolant::None);
        let blocks: Vec<String> = program
            .lines()
            .filter(|line| !line.starts_with('(') || line.matches(')').count() > 1)
            .map(|line| line.split(" (").next().unwrap().to_string())
            .collect();
        assert_eq!(check_machine(&gem, &job, &machine("", "")), Ok(()));
        blocks
    };
    let plain = blocks("P", "polish");
    assert!(plain.len() > 100);
    for name in ["50k (diamond)", "p) G0 Z0.3 (p", "%", "a;b"] {
        assert_eq!(blocks("P", name), plain, "{name}");
        assert_eq!(blocks(name, "polish"), plain, "{name}");
    }
    assert_eq!(blocks("P", "polish\nG0 Z0.3\r"), plain);
    assert_eq!(blocks("P\\nG0 Z0.3\\r", "polish"), plain);
    let laps = "name = \"a\\nb\"\nrpm = 1\nstock_mm = 0\nfeed_mm_s = 1\nforce_n = 1\n\
                spark_out_s = 1\npreston_mm2_n = 1";
    let lap: haptimill_facet::Lap = toml::from_str(laps).unwrap();
    assert_eq!(lap.name, "a b");
}

/// By feed and by both no stroke is faster than the program says.
#[test]
fn the_stated_feed_is_that_of_the_strokes() {
    let gem = Gem::new("small.asc", small(), 2.5, None).unwrap();
    for mode in [Mode::Both, Mode::Force] {
        let mut settings = JobSettings {
            mode,
            ..JobSettings::default()
        };
        settings.laps[0].feed_mm_s = 0.05;
        let stroke_s = settings.sweep_mm / settings.sweep_mm_s;
        let job = Job::new(&gem, settings).unwrap();
        let mut max = 0.0_f64;
        for operation in job.passes.iter().flat_map(|pass| &pass.operations) {
            let strokes = operation
                .grind
                .lines()
                .filter(|line| line.starts_with("G1"));
            let words = strokes.flat_map(str::split_whitespace);
            let heights: Vec<f64> = words
                .filter_map(|word| word.strip_prefix('Z')?.parse().ok())
                .collect();
            for pair in heights.windows(2) {
                max = max.max((pair[0] - pair[1]) / stroke_s);
            }
        }
        let stated = job.max_feed_mm_s();
        assert!(
            max < stated + 1e-4 && max > 0.5 * stated,
            "{mode:?}: {max}, {stated}"
        );
        let expected = if mode == Mode::Both { 0.05 } else { 0.15 };
        assert_eq!(stated, expected);
    }
}

/// The comments of a program have the design, the rough on the dop, and each tier with its note
/// before its facets.
#[test]
fn the_program_has_what_the_cutter_must_know() {
    let text = SMALL
        .replace("H Small", "H\nF Use (quartz) only")
        .replace("to a point", "to a (sharp) point");
    let design = read("small.asc", text.as_bytes()).unwrap();
    let gem = Gem::new("small.asc", design, 2.5, None).unwrap();
    let job = Job::new(&gem, JobSettings::default()).unwrap();
    let program = job.program(&gem, Coolant::None);
    let place = |what: &str| {
        let found = program.find(what);
        found.unwrap_or_else(|| panic!("{what}\n{}", &program[..2000]))
    };
    // A design without a title has the name of its file.
    assert!(
        program.starts_with("(design small.asc)\n"),
        "{}",
        &program[..200]
    );
    place("(remark: Use quartz only)\n");
    place("(index wheel of 64 teeth; refractive index 1.54; symmetry 4-fold, mirror-image)\n");
    assert!(
        place("(tier P, pavilion: angle 45.00 deg, index 0-16-32-48 of 64)") < place("(facet P@0")
    );
    assert!(place("(note: to a sharp point)") < place("(facet P@0"));
    // The pavilion points to the lap: its end of the rough is beyond the tip.
    let half = 0.5 * gem.rough.height_mm;
    let [beyond, behind] = [half - gem.rough_middle_mm, half + gem.rough_middle_mm];
    assert!(beyond > behind);
    let header = program.split("M0").next().unwrap().replace(")\n(", " ");
    let expected = format!(
        "rough of {:.3} mm diameter and {:.3} mm height, centred on the axis of the dop; its ends \
         are {beyond:.3} mm beyond the tip, on the side of the lap, and {behind:.3} mm behind it; \
         the tip is the origin of the design",
        gem.rough.diameter_mm, gem.rough.height_mm
    );
    assert!(header.contains(&expected), "{header}");
    // Turned over, the culet is behind the tip; the facet of index 64 keeps C180.
    let over = program.replace(")\n(", " ");
    let culet = gem.body.reach([0.0, 0.0, -1.0]);
    let expected = format!(
        "the new dop holds the pavilion; index 64 stays where it was, at C180; the lower end of \
         the stone is {culet:.3} mm behind the tip"
    );
    assert!(over.contains(&expected));
    for name in ["P@0", "C@0"] {
        let (_, facet) = program.split_once(&format!("(facet {name}")).unwrap();
        let index = facet
            .lines()
            .find_map(|line| line.strip_prefix("G0 C"))
            .unwrap();
        let angle = facet
            .lines()
            .find_map(|line| line.strip_prefix("G0 A"))
            .unwrap();
        // The other branch has C0 and a negative angle.
        let is_at = (index == "180.000000" && !angle.starts_with('-'))
            || (index.trim_start_matches('-') == "0.000000" && angle.starts_with('-'));
        assert!(is_at, "{name}: C{index} A{angle}");
    }
    // Notes of any length are comments that senders take.
    let design = read(
        "small.asc",
        SMALL.replace("to a point", &"x".repeat(900)).as_bytes(),
    );
    let gem = Gem::new("small.asc", design.unwrap(), 2.5, None).unwrap();
    let program = job.program(&gem, Coolant::None);
    assert!(program.lines().all(|line| line.len() <= 256));
    let (_, note) = program.split_once("(note").unwrap();
    let (note, _) = note.split_once("(facet").unwrap();
    assert_eq!(note.matches('x').count(), 900);
}

/// A preform that stays on the stone is ground on all laps, with a notice; one that is cut away is
/// ground on the first lap only.
#[test]
fn a_preform_that_stays_is_a_facet() {
    let job = |text: String| {
        let design = read("small.asc", text.as_bytes()).unwrap();
        let gem = Gem::new("small.asc", design, 2.5, None).unwrap_or_else(|it| panic!("{it}"));
        let job = Job::new(&gem, JobSettings::default()).unwrap();
        let notices = gem.design.notices.iter().map(|it| it.text("small.asc"));
        let notices: Vec<String> = notices.collect();
        let operations = job.passes.iter().flat_map(|pass| &pass.operations);
        (operations.count(), notices)
    };
    assert_eq!(job(SMALL.to_string()), (39, vec![]));
    let (count, notices) = job(SMALL.replace("n C 16", "n pfC 16"));
    assert_eq!((count, notices.len()), (39, 1), "{notices:?}");
    let expected = "small.asc:8: facet pfC@0: is a preform that no later facet cuts away, as are 3 \
                    more of its tier; it is ground on all laps; check the later facets";
    assert!(notices[0].starts_with(expected), "{notices:?}");
    let before = "a -50 0.9 0 n pf 16 32 48\na -90 1.0";
    assert_eq!(job(SMALL.replace("a -90 1.0", before)), (43, vec![]));
}
