//! `haptimill facet`: a stone that is not the design or is out of tolerance, the figures of its
//! report, outputs that are inputs, and the calibration.

use super::scene::{SimServer, TestFolder, haptimill};

/// A list of five facets for one lap.
const DESIGN: &str = "# gear = 64\n-90,0,1,G\n-90,16,1,G\n-90,32,1,G\n-90,48,1,G\n-0,0,0.4,P\n\
transfer\n0,0,0.4,T\n";

const LAPS: &str = "[[lap]]\nname = \"600\"\nrpm = 600.0\nstock_mm = 0.0\nfeed_mm_s = 0.08\n\
force_n = 3.0\nspark_out_s = 0.5\npreston_mm2_n = 4e-5\n";

const MACHINE: &str = include_str!("../../../machines/facet.toml");

/// The arm of the simulated machine is tilted by two degrees against the machine file: no facet of
/// the stone is one of the design. The results are written, and the exit code is that of lost
/// steps.
#[test]
fn a_stone_that_is_not_the_design_is_an_error() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("laps.toml", LAPS);
    let zero = "theta2_zero_deg = 180.0\n\n[plant.spindle]";
    assert!(MACHINE.contains(zero));
    for (name, zero_deg, code) in [("true", 180.0, 0), ("tilted", 178.0, 6)] {
        let other = format!("theta2_zero_deg = {zero_deg:.1}\n\n[plant.spindle]");
        let machine = folder.file(&format!("{name}.toml"), MACHINE.replace(zero, &other));
        for json in [false, true] {
            let out = folder.path(&format!("{name}-{json}"));
            let mut arguments = vec![
                "facet",
                "run",
                &design,
                "--laps",
                &laps,
                "--machine",
                &machine,
                "--out",
                &out,
                "--quiet",
            ];
            arguments.extend(json.then_some("--json"));
            let run = haptimill(&arguments);
            assert_eq!(run.code, code, "{name}: {}", run.err);
            for file in ["report.html", "stone.json", "job.ngc"] {
                let path = std::path::Path::new(&out).join(file);
                assert!(path.is_file(), "{name}: {file}");
            }
            if json {
                let figures: serde_json::Value = serde_json::from_str(&run.out).unwrap();
                let missing = figures["missing"].as_array().unwrap().len();
                assert_eq!(missing, if code == 0 { 0 } else { 6 });
            }
            let expected = format!(
                "{design}: the stone is not the design: 6 facets are missing, and 6 faces are \
                 not facets"
            );
            let is_told = run.err.contains(&expected) && run.err.contains("report.html");
            assert_eq!(is_told, code == 6, "{name}: {}", run.err);
        }
    }
}

/// The arm of the simulated machine is tilted: by a little less than the bound of the angle, and by
/// a little more. Out of tolerance the files are written, and the error names the worst facet.
#[test]
fn a_stone_out_of_tolerance_is_an_error() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("laps.toml", LAPS);
    let zero = "theta2_zero_deg = 180.0\n\n[plant.spindle]";
    for (tilt_deg, code) in [(0.008, 0), (0.035, 6)] {
        let other = format!(
            "theta2_zero_deg = {:.4}\n\n[plant.spindle]",
            180.0 - tilt_deg
        );
        let machine = folder.file("own.toml", MACHINE.replace(zero, &other));
        let out = folder.path(&format!("out-{code}"));
        let arguments = [
            "facet",
            "run",
            &design,
            "--laps",
            &laps,
            "--machine",
            &machine,
            "--out",
            &out,
            "--quiet",
        ];
        let run = haptimill(&arguments);
        assert_eq!(run.code, code, "{}", run.err);
        for file in ["report.html", "stone.json", "job.ngc"] {
            assert!(std::path::Path::new(&out).join(file).is_file(), "{file}");
        }
        let text = folder.read(&format!("out-{code}/stone.json"));
        let figures: serde_json::Value = serde_json::from_str(&text).unwrap();
        let angle = figures["angle_deg"].as_f64().unwrap();
        assert_eq!(angle > 0.02, code == 6, "{angle}");
        let lines: Vec<&str> = run.err.lines().collect();
        if code == 0 {
            assert_eq!(lines, [] as [&str; 0]);
            continue;
        }
        let facets = figures["facets"].as_array().unwrap();
        let is_worst = |it: &&serde_json::Value| it["normal_deg"].as_f64() == Some(angle);
        let worst = facets.iter().find(is_worst).unwrap()["name"]
            .as_str()
            .unwrap();
        assert_eq!(lines.len(), 1, "{lines:?}");
        let expected = format!(
            "{design}: the stone is out of tolerance: the angle of facet {worst} is off by \
             {angle:.4} deg, and 0.02 deg is the most"
        );
        assert!(lines[0].contains(&expected), "{lines:?}");
    }
}

/// Cells of the rows of a table of a page.
fn rows(page: &str, title: &str) -> Vec<Vec<String>> {
    let (_, table) = page.split_once(&format!("<h2>{title}</h2>")).unwrap();
    let (table, _) = table.split_once("</table>").unwrap();
    let rows = table.split("<tr><td>").skip(1);
    let cells = |row: &str| {
        let cells = row
            .split("<td")
            .map(|cell| cell.trim_start_matches(" class=over"));
        cells
            .map(|cell| cell.trim_start_matches('>').to_string())
            .collect()
    };
    rows.map(cells).collect()
}

/// The numbers of the page are those of stone.json: each facet, the yield, and the times of the
/// stages.
#[test]
fn the_report_has_the_figures_of_the_stone() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("laps.toml", LAPS);
    let out = folder.path("out");
    let arguments = [
        "facet", "run", &design, "--laps", &laps, "--out", &out, "--quiet",
    ];
    haptimill(&arguments).expect_code(0);
    let page = folder.read("out/report.html");
    let figures: serde_json::Value = serde_json::from_str(&folder.read("out/stone.json")).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let facets = figures["facets"].as_array().unwrap();
    let found = rows(&page, "Facets");
    assert_eq!((found.len(), facets.len()), (6, 6));
    for (row, facet) in found.iter().zip(facets) {
        assert_eq!(facet["name"], row[0].as_str());
        let expected = [
            format!("{:+.4}", number(&facet["angle_deg"])),
            format!("{:+.4}", number(&facet["azimuth_deg"])),
            format!("{:.4}", number(&facet["normal_deg"])),
            format!("{:+.2}", 1e3 * number(&facet["depth_mm"])),
            format!("{:.2}", 1e3 * number(&facet["proud_mm"])),
            format!("{:.3}", number(&facet["area_mm2"])),
        ];
        assert_eq!(row[3..], expected);
    }
    let yield_part = format!(
        "<b>{:.1} %</b>of the rough",
        1e2 * number(&figures["yield"])
    );
    assert!(page.contains(&yield_part), "{yield_part}");
    let time = |of: &dyn Fn(&str) -> bool| {
        let operations = figures["operations"].as_array().unwrap().iter();
        let operations = operations.filter(|it| of(it["facet"].as_str().unwrap()));
        let seconds: f64 = operations.map(|it| number(&it["seconds"])).sum();
        let whole = seconds.round();
        format!("{:.0} min {:02.0} s", (whole / 60.0).floor(), whole % 60.0)
    };
    let stages = rows(&page, "Job");
    assert_eq!(stages.len(), 3);
    for (row, (stage, first)) in
        stages
            .iter()
            .zip([("girdle", "G@"), ("pavilion", "P@"), ("table", "T@")])
    {
        assert_eq!(row[2], stage);
        assert_eq!(row[4], time(&|name| name.starts_with(first)), "{stage}");
    }
    assert!(page.contains(&format!("<b>{}</b>on the machine", time(&|_| true))));
    // `check` prints the tiers.
    let run = haptimill(&["facet", "check", &design]).expect_code(0);
    for expected in [
        "girdle      G         90.00 deg  0-16-32-48\n",
        "table       T          0.00 deg  0\n",
    ] {
        assert!(run.out.contains(expected), "{}", run.out);
    }
}

/// A program that is ground by both says how fast the stone is fed without force control.
#[test]
fn a_plan_states_the_feed_of_its_laps() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("laps.toml", LAPS);
    for (by, feed) in [("both", "0.08"), ("force", "0.15")] {
        let run = haptimill(&["facet", "plan", &design, "--laps", &laps, "--by", by]);
        assert_eq!(run.code, 0, "{}", run.err);
        let notice = format!("it feeds the stone at up to {feed} mm/s");
        assert!(run.err.contains(&notice), "{}", run.err);
        let header = format!("(without it the stone is fed at up to {feed} mm/s whatever");
        assert!(run.out.contains(&header), "{}", &run.out[..1000]);
    }
}

/// Lengths from exact readings of an arm, and readings that no arm has.
#[test]
fn the_lengths_of_the_arm_are_printed_or_refused() {
    // The readings of docs/faceting.md.
    let readings = [
        "--at-0",
        "280.24,1.66",
        "--at-90",
        "281.66,-0.24",
        "--at-180",
        "279.76,-1.66",
    ];
    let run = haptimill(&[&["facet", "calibrate"], &readings[..]].concat()).expect_code(0);
    assert_eq!(
        run.out,
        "[kinematics]\nl2 = 280.000000\nl3 = 0.240000\nl4 = 1.660000\n"
    );
    let json = [&["facet", "calibrate", "--json"], &readings[..]].concat();
    let run = haptimill(&json).expect_code(0);
    let figures: serde_json::Value = serde_json::from_str(&run.out).unwrap();
    for (key, length) in [
        ("l2", 280.0),
        ("l3", 0.24),
        ("l4", 1.66),
        ("residual_mm", 0.0),
    ] {
        assert!(
            (figures[key].as_f64().unwrap() - length).abs() < 1e-9,
            "{key}: {figures}"
        );
    }
    let mut wrong = readings;
    wrong[1] = "280.24,1.80";
    let run = haptimill(&[&["facet", "calibrate"], &wrong[..]].concat());
    assert_eq!((run.code, run.out.as_str()), (3, ""));
    let expected = "the readings contradict each other";
    assert!(
        run.err.contains(expected) && run.err.contains("0.01 mm is the most"),
        "{}",
        run.err
    );
}

/// No output takes the place of an input.
#[test]
fn inputs_are_not_overwritten() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("stone.json", LAPS);
    let machine = folder.file("job.ngc", MACHINE);
    let options = ["--laps", &laps, "--machine", &machine];
    for (out, what, text) in [
        (&design, "design", DESIGN),
        (&laps, "file of laps", LAPS),
        (&machine, "machine file", MACHINE),
    ] {
        let run = haptimill(&[&["facet", "plan", &design, "--out", out], &options[..]].concat());
        assert_eq!(run.code, 2, "{}", run.err);
        let expected = format!("{out}: the {what} would be overwritten; name another file");
        assert!(run.err.contains(&expected), "{}", run.err);
        assert_eq!(std::fs::read_to_string(out).unwrap(), text);
    }
    let out = folder.path("");
    let run = haptimill(&[&["facet", "run", &design, "--out", &out], &options[..]].concat());
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("would be overwritten"), "{}", run.err);
    assert_eq!(std::fs::read_to_string(&laps).unwrap(), LAPS);
}

/// Jogs have the coordinates of the machine: the lift moves with the height and holds it while the
/// arm tilts, the slide follows the tip.
#[test]
fn jogs_move_height_angle_and_index() {
    let machine = ["--machine", "machines/facet.toml"];
    let served = SimServer::on_tcp(&machine);
    let run = |words: &[&str]| served.run_ok(&[words, &machine].concat());
    run(&["home"]);
    let value = |status: &serde_json::Value, list: &str, name: &str| {
        status[list][name]
            .as_f64()
            .unwrap_or_else(|| panic!("{name}: {status:#}"))
    };
    let status = || run(&["status", "--json"]).json();
    let before = status();
    let jog = ["jog", "--by", "height=-3", "angle=20", "index=-45"];
    run(&[&jog[..], &["--feed", "600"]].concat());
    let after = status();
    for (name, by) in [("height", -3.0), ("angle", 20.0), ("index", -45.0)] {
        let moved = value(&after, "commanded", name) - value(&before, "commanded", name);
        assert!((moved - by).abs() < 1e-3, "{name}: {moved}");
    }
    // L3 = 0.24 mm and L4 = 1.66 mm, with theta2 = 180 degrees at the angle 0.
    let (sine, cosine) = 200.0_f64.to_radians().sin_cos();
    let slide = 0.24 * (cosine + 1.0) + 1.66 * sine;
    let lift = -3.0 + 0.24 * sine - 1.66 * (cosine + 1.0);
    for (name, by) in [("lap_x", slide), ("d1", lift)] {
        let moved = value(&after, "joints", name) - value(&before, "joints", name);
        assert!((moved - by).abs() < 5e-3, "{name}: {moved} {by}");
    }
    let refused = served
        .run(&[&["jog", "d1=5"][..], &machine].concat())
        .expect_code(2);
    assert!(
        refused
            .err
            .contains("height (or Z), angle (or A), index (or C)")
    );
}
