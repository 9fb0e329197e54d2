//! All experiments of the thesis, as `haptimill scenario run all` runs them. Their results are
//! snapshots, so every change of a result shows.

use crate::scene;
use haptimill_trace::{Recording, flag};
use scene::{TestFolder, haptimill, number};
use serde_json::Value;
use std::path::Path;

/// A summary without the hashes, which every change of the controller changes.
fn without_hashes(summary: &Value) -> Value {
    let mut summary = summary.clone();
    for pass in summary["passes"].as_array_mut().unwrap() {
        let hash = pass.as_object_mut().unwrap().remove("trace_sha256");
        assert_eq!(hash.unwrap().as_str().unwrap().len(), 64);
    }
    summary
}

fn read(folder: &TestFolder, path: &str) -> Value {
    serde_json::from_str(&folder.read(path)).unwrap()
}

#[test]
fn all_experiments_write_their_tables_pages_and_recordings() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let ran = haptimill(&["scenario", "run", "all", "--out", &out]).expect_code(0);
    assert_eq!(ran.err, "");
    insta::assert_snapshot!("table", folder.redact(&ran.out));

    // A change of the model may not lose results of the thesis: raise these where it gains some.
    let counts = ran.out.lines().find(|line| line.starts_with("inside: "));
    let counts = counts.expect("the table ends with its counts");
    let inside = |source: &str| -> usize {
        let part = counts.trim_start_matches("inside: ").split(", ");
        let mut part = part.filter(|part| part.ends_with(source));
        let first = part.next().and_then(|part| part.split(" ").next());
        first.and_then(|text| text.parse().ok()).unwrap_or(0)
    };
    // Results that are inputs do not count.
    assert!(inside("stated") >= 43, "{counts}");
    assert!(inside("derived") >= 73, "{counts}");

    let index = folder.read("out/index.html");
    assert!(index.contains(counts), "{counts}");
    for experiment in haptimill_experiments::all().unwrap() {
        let name = &experiment.name[..];
        assert!(
            index.contains(&format!(">{}<", name.to_uppercase())),
            "{name}"
        );
        if !Path::new(&folder.path(&format!("out/{name}"))).exists() {
            assert!(experiment.needs_force_control(), "{name} was not run");
            continue;
        }
        let summary = read(&folder, &format!("out/{name}/summary.json"));
        for claim in summary["claims"].as_array().unwrap() {
            assert!(claim["ours"].is_number(), "{name}: no value: {claim:#}");
            let outside = !claim["inside"].as_bool().unwrap();
            assert_eq!(outside, claim["reason"].is_string(), "{name}: {claim:#}");
        }
        insta::assert_snapshot!(name, format!("{:#}", without_hashes(&summary)));

        let page = folder.read(&format!("out/{name}/index.html"));
        assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
        let pictures = page.matches("data:image/png;base64,").count();
        let passes = || experiment.passes.iter();
        let cuts = passes().filter(|pass| pass.has_cutting()).count();
        assert_eq!(pictures, cuts, "{name}");
        // Each cut: position, three forces, error or p_c, path, surface. Each teleoperated pass:
        // travel, force feedback, operator force.
        let teleoperated = passes().filter(|pass| pass.teleoperation.is_some());
        let curves = 7 * cuts + 3 * teleoperated.count();
        assert!(page.matches("<svg").count() >= curves, "{name}");
        // Each result outside its band has a chart with the band, and one of its cause.
        for (number, claim) in (1..).zip(summary["claims"].as_array().unwrap()) {
            let chart = |id: String| {
                let start = page.find(&format!("<svg id=\"{id}\" "))?;
                page[start..].split("</svg>").next()
            };
            let result = chart(format!("row-{number}"));
            let cause = chart(format!("row-{number}-cause"));
            if claim["inside"].as_bool().unwrap() {
                assert_eq!((result, cause), (None, None), "{name}: {claim:#}");
                continue;
            }
            let (Some(result), Some(cause)) = (result, cause) else {
                panic!("{name}: no charts: {claim:#}");
            };
            for part in ["<rect class=\"band\"", ">simulated<", "<circle"] {
                assert!(result.contains(part), "{name}: {part}: {claim:#}");
            }
            assert!(cause.contains("<path d=\"M"), "{name}: {claim:#}");
            let is_number = |svg: &str| !svg.contains("NaN") && !svg.contains("inf");
            assert!(is_number(result) && is_number(cause), "{name}: {claim:#}");
        }
        for pass in passes() {
            let file = folder.path(&format!("out/{name}/{}/recording.hmr", pass.name));
            let recording = Recording::open(Path::new(&file)).unwrap();
            let mut records = recording.iter().unwrap().map(Result::unwrap);
            // In E6 the tool waits at the home pose and does not cut.
            let cutting = records.find(|record| !pass.has_cutting() || record.true_force != [0; 3]);
            assert!(cutting.unwrap().has(flag::FORCE | flag::TOOL_TRUE));
            let table = format!("out/{name}/{}/teleop.csv", pass.name);
            if pass.teleoperation.is_some() {
                assert!(folder.read(&table).lines().count() > 1000);
            }
            assert!(
                folder
                    .read(&format!("out/{name}/{}/trace.csv", pass.name))
                    .len()
                    > 10_000
            );
        }
    }
}

#[test]
fn an_experiment_is_deterministic() {
    let folder = TestFolder::new();
    let mut hashes = Vec::new();
    for out in ["first", "second"] {
        let out = folder.path(out);
        let ran = haptimill(&["scenario", "run", "E7", "--json", "--out", &out]).expect_code(0);
        let results = ran.json();
        assert_eq!(results.as_array().unwrap().len(), 1);
        hashes.push(results[0]["passes"][0]["trace_sha256"].clone());
    }
    assert_eq!(hashes[0], hashes[1]);
    assert_eq!(
        folder.read("first/e7/index.html"),
        folder.read("second/e7/index.html")
    );
}

/// The path analysis of the thesis: figure 4.8 to the last digit, the pockets, and the reasons of
/// what differs.
#[test]
fn the_engraver_repeats_the_analysis_of_its_thesis() {
    let folder = TestFolder::new();
    let out = folder.path("engraver");
    let ran = haptimill(&["scenario", "run", "engraver", "--out", &out]).expect_code(0);
    let table = ran.out;
    for part in [
        "113.705 mm",
        "97.854 mm",
        "114.061 mm",
        "146.290 mm",
        "lines 1 2 4 3",
        "differs",
        "of the same kind",
        "stands in",
    ] {
        assert!(table.contains(part), "{part}: {table}");
    }
    // Of the texts, in other fonts than those of the thesis, one saves as much: no verdict hides
    // that.
    let rows: serde_json::Value =
        serde_json::from_str(&folder.read("engraver/engraver/summary.json")).expect("JSON");
    let rows = rows.as_array().expect("rows");
    let of = |part: &'static str| {
        rows.iter()
            .filter(move |row| row["what"].as_str().is_some_and(|what| what.contains(part)))
    };
    let verdicts: Vec<&str> = of("DejaVu")
        .filter_map(|row| row["verdict"].as_str())
        .collect();
    let expected = [
        "differs",
        "differs",
        "same-kind",
        "differs",
        "differs",
        "differs",
    ];
    assert_eq!(verdicts, expected, "{table}");
    // The simulated tool follows the drawing, and saves the time that the rules of the thesis give.
    assert_eq!(of("simulated tool").count(), 2);
    assert!(
        of("simulated tool").all(|row| row["verdict"] == "agrees"),
        "{table}"
    );
    let percent = |row: &serde_json::Value| -> f64 {
        let ours = row["ours"].as_str().unwrap_or_default();
        let number = ours.split(' ').next().unwrap_or_default();
        number.parse().expect("percent")
    };
    // Accelerations, and the contours of the pockets, are not in the rules.
    for shape in ["here five squares", "here S1", "here S3"] {
        let shown = |simulated: bool| {
            let mut found = of(shape).filter(move |row| {
                row["what"]
                    .as_str()
                    .is_some_and(|what| what.contains("simulator"))
                    == simulated
            });
            percent(found.next().expect("a row"))
        };
        let (computed, simulated) = (shown(false), shown(true));
        println!("{shape}: computed {computed} %, simulated {simulated} %");
        assert!(
            (computed - simulated).abs() < 2.0,
            "{shape}: {computed} {simulated}"
        );
    }
}

/// The equations of the faceting machine as printed and as corrected, and a stone by feed and by
/// force within its aims.
#[test]
fn the_faceting_machine_repeats_the_equations_of_its_thesis() {
    let folder = TestFolder::new();
    let out = folder.path("faceting");
    let ran = haptimill(&["scenario", "run", "faceting", "--json", "--out", &out]).expect_code(0);
    let rows: serde_json::Value = serde_json::from_str(&ran.out).expect("JSON");
    assert_eq!(
        folder.read("faceting/faceting/summary.json").trim(),
        ran.out.trim()
    );
    let rows = rows.as_array().expect("rows");
    let of = |section: &'static str| rows.iter().filter(move |row| row["section"] == section);
    assert_eq!(
        of("4.13").next().expect("a row")["stated"],
        "22.3130 mm, -45.000, -30.000 deg"
    );
    for row in of("4.2").chain(of("-")) {
        assert_eq!(row["agrees"], true, "{row}");
        assert_ne!(row["reason"], "", "{row}");
    }
    assert_eq!(of("-").count(), 6);
}

#[test]
fn experiments_are_listed_and_others_refused() {
    let list = haptimill(&["scenario", "list"]).expect_code(0).out;
    for number in 1..=12 {
        let name = &format!("e{number} ");
        assert!(list.lines().any(|line| line.starts_with(name)), "{list}");
    }
    for name in ["engraver ", "faceting ", "vmc "] {
        assert!(list.lines().any(|line| line.starts_with(name)), "{list}");
    }
    let ran = haptimill(&["scenario", "run", "e13"]).expect_code(2);
    assert_eq!(
        ran.err,
        "there is no experiment \"e13\"; write one of e1, e2, e3, e4, e5, e6, e7, e8, e9, e10, e11, e12, engraver, faceting, vmc, or all\n"
    );
}

#[test]
fn a_job_cuts_only_a_clamped_stock() {
    let folder = TestFolder::new();
    let run = |out: &str, more: &[&str]| {
        let dir = folder.path(out);
        let program = "examples/e7-slot.ngc";
        let ran = haptimill(&[&["run", program, "--json", "--out", &dir], more].concat());
        assert_eq!(ran.code, 0, "{ran:?}");
        let file = folder.path(&format!("{out}/recording.hmr"));
        let recording = Recording::open(Path::new(&file)).unwrap();
        let records = recording.iter().unwrap().map(Result::unwrap);
        let largest = records
            .map(|record| record.true_force.map(i32::abs).into_iter().max().unwrap())
            .max();
        (ran.json(), f64::from(largest.unwrap()) / 65_536.0)
    };
    let (air, none) = run("air", &[]);
    assert_eq!(none, 0.0, "no stock is clamped");
    let (cut, force) = run("cut", &["--stock", "examples/block.toml"]);
    assert!((4.0..12.0).contains(&force), "{force} N");
    // 7 N on a structure of 500 N/mm give 14 um, and the slides deflect too.
    let error = |summary: &Value| number(summary, "tool_error_max_mm");
    let more = error(&cut) - error(&air);
    assert!((0.005..0.06).contains(&more), "{more} mm");

    let bad = folder.file("work.toml", "top_mm = 21.0\ncell_mm = 7.0\n");
    let out = folder.path("bad");
    let ran = haptimill(&[
        "run",
        "examples/e7-slot.ngc",
        "--stock",
        &bad,
        "--out",
        &out,
    ]);
    assert_eq!(ran.code, 3);
    assert_eq!(
        folder.redact(&ran.err),
        "DIR/work.toml:2:11: cell_mm: 7 is out of range, allowed is 0.01 to 1; lower it\n"
    );
    let port = [
        "run",
        "examples/e7-slot.ngc",
        "--stock",
        &bad,
        "--port",
        "tcp:127.0.0.1:1",
    ];
    assert!(haptimill(&port).expect_code(2).err.starts_with("--stock"));
}
