//! `haptimill calibrate`: a measurement of the simulated machine, the readings of a laser as a
//! file, and the circle test.

mod scene;

use haptimill_volumetric::chain;
use haptimill_volumetric::file::{self, Limits};
use scene::{TestFolder, haptimill as run};

fn machine() -> String {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = root.join("../../machines/vmc3.toml");
    path.canonicalize().unwrap().to_str().unwrap().to_string()
}

/// The lines of an error file that are no comments.
fn errors(path: &str) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(str::to_string).collect()
}

/// The number of a line that begins with a name.
fn value(out: &str, name: &str) -> f64 {
    let line = out.lines().find(|line| line.starts_with(name));
    let rest = line.unwrap_or_else(|| panic!("no {name} in {out}"));
    let words = rest[name.len()..].split_whitespace();
    words.filter_map(|word| word.parse().ok()).next().unwrap()
}

/// The error of the tool by the model of the chain, mm.
fn error_of(errors: &str, point: [f64; 3]) -> [f64; 3] {
    let errors = file::read(errors, &Limits::default()).unwrap();
    chain::Model::default().error(&errors, point.into()).into()
}

/// Squareness, urad, that a circle test about the origin shows on a machine with these errors:
/// -4 / r times the mean of the radial error times sin 2a.
fn ellipse(errors: &str, radius: f64) -> f64 {
    let parts = (0..360).map(|step| {
        let angle = f64::from(step).to_radians();
        let (sine, cosine) = angle.sin_cos();
        let [x, y, _] = error_of(errors, [radius * cosine, radius * sine, 0.0]);
        (x * cosine + y * sine) * (2.0 * angle).sin() / 360.0
    });
    -4e6 / radius * parts.sum::<f64>()
}

/// The readings of a measurement, evaluated as those of a real laser, give its errors. A controller
/// with them makes the circle round, and readings of one axis alone are taken with zeros.
#[test]
fn readings_become_a_compensated_circle() {
    let folder = TestFolder::new();
    let path = |name: &str| folder.path(name);
    let (measured, evaluated, readings) = (path("a.csv"), path("b.csv"), path("readings.csv"));
    let machine = machine();
    let laser = ["calibrate", "laser", "--machine", &machine];
    let measure = [
        "--interval",
        "20",
        "--out",
        &measured,
        "--save-readings",
        &readings,
    ];
    run(&[&laser[..], &measure].concat()).expect_code(0);
    let evaluate = ["--readings", &readings, "--out", &evaluated];
    run(&[&laser[..], &evaluate].concat()).expect_code(0);
    // Five runs upwards and downwards at every target.
    let text = std::fs::read_to_string(&readings).unwrap();
    let of_x: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with("EXX,"))
        .collect();
    let targets: std::collections::BTreeSet<&str> = of_x
        .iter()
        .filter_map(|line| line.split(',').nth(1))
        .collect();
    assert!(targets.len() >= 30, "{targets:?}");
    for target in &targets {
        for run in 1..=5 {
            for direction in ["up", "down"] {
                let start = format!("EXX,{target},{run},{direction},");
                let found = of_x.iter().filter(|line| line.starts_with(&start));
                assert_eq!(found.count(), 1, "{start}");
            }
        }
    }
    assert_eq!(of_x.len(), 10 * targets.len());
    let [first, second] = [&measured, &evaluated].map(|file| errors(file));
    assert_eq!(first.len(), second.len());
    for (first, second) in first.iter().zip(&second).skip(1) {
        let split = |line: &str| -> Vec<String> { line.split(',').map(str::to_string).collect() };
        let (first, second) = (split(first), split(second));
        assert_eq!((&first[0], &first[1]), (&second[0], &second[1]));
        let of = |row: &[String]| row[3].parse::<f64>().unwrap();
        assert!(
            (of(&first) - of(&second)).abs() < 0.001,
            "{first:?} {second:?}"
        );
    }

    let circle = [
        "calibrate",
        "ball-bar",
        "--machine",
        &machine,
        "--feed",
        "20",
    ];
    let before = run(&circle).expect_code(0).out;
    let after = run(&[&circle[..], &["--errors", &evaluated]].concat())
        .expect_code(0)
        .out;
    assert!(before.contains("compensation none"), "{before}");
    assert!(after.contains("compensation 100 %"), "{after}");
    // The truth has 25 urad, and other errors that make the circle elliptic.
    let truth = include_str!("../../volumetric/data/vmc3_errors.csv");
    let expected = ellipse(truth, 100.0);
    let squareness = value(&before, "squareness");
    println!("squareness {squareness}, model {expected}");
    assert!((squareness - expected).abs() < 1.5, "{expected} {before}");
    assert!(value(&after, "squareness").abs() < 3.0, "{after}");
    assert!(value(&before, "G ccw") > 3.0, "{before}");
    assert!(value(&after, "G ccw") < 1.0, "{after}");

    // One axis alone.
    let text = std::fs::read_to_string(&readings).unwrap();
    let kept = |line: &&str| line.starts_with("function") || line.starts_with("EXX");
    let alone: Vec<&str> = text.lines().filter(kept).collect();
    std::fs::write(folder.path("exx.csv"), alone.join("\n")).unwrap();
    let exx = path("exx.csv");
    let done = run(&[&laser[..], &["--readings", &exx, "--out", &evaluated]].concat());
    let out = done.expect_code(0).out;
    assert!(out.contains("EYY not measured, taken as 0"), "{out}");
    let program = path("move.ngc");
    std::fs::write(&program, "G21 G90\nG1 X10 F600\nM30\n").unwrap();
    let moved = [
        "run",
        &program,
        "--machine",
        &machine,
        "--errors",
        &evaluated,
        "--quiet",
    ];
    run(&[&moved[..], &["--out", &path("out")]].concat()).expect_code(0);
    // The report of a job states the compensation.
    let summary = std::fs::read_to_string(folder.path("out") + "/summary.json").unwrap();
    assert!(
        summary.contains("\"volumetric_compensation\": \"on"),
        "{summary}"
    );
    let page = std::fs::read_to_string(folder.path("out") + "/report.html").unwrap();
    assert!(page.contains("<td>Volumetric compensation</td><td>on"));
}

/// The report states the conditions: a warm machine, a wavelength that is not corrected, no
/// instrument for roll, and a compensation that stays.
#[test]
fn the_report_states_the_conditions() {
    let folder = TestFolder::new();
    let (machine, out) = (machine(), folder.path("e.csv"));
    let laser = ["calibrate", "laser", "--machine", &machine, "--out", &out];
    let options = [
        "--interval",
        "150",
        "--machine-temperature",
        "23",
        "--air",
        "21",
    ];
    let more = ["--uncorrected", "--no-roll", "--no-noise"];
    let done = run(&[&laser[..], &options, &more].concat())
        .expect_code(0)
        .out;
    for expected in [
        "WARNING     the machine has 23 deg C and not 20",
        "+-6.0 um per metre",
        "wavelength NOT corrected: readings are off by -0.93 ppm",
        "roll        not measured, taken as 0",
        "volumetric compensation the machine has none",
    ] {
        assert!(done.contains(expected), "{expected}\n{done}");
    }
    // Roll is 0 in the file. Positioning is off by the wavelength: 0.6 um at 650 mm.
    let written = errors(&out);
    let numbers = |name: &str| -> Vec<f64> {
        let lines = written.iter().filter(|line| line.starts_with(name));
        lines
            .map(|line| line.split(',').nth(3).unwrap().parse().unwrap())
            .collect()
    };
    assert!(numbers("EAX,").iter().all(|value| *value == 0.0));
    assert!(numbers("ECX,").iter().any(|value| *value != 0.0));
    let corrected = [&laser[..], &options[..2], &["--no-noise"]].concat();
    let good = run(&corrected).expect_code(0).out;
    assert!(!good.contains("WARNING"), "{good}");
    let warm = numbers("EXX,");
    let written = errors(&out);
    let cold: Vec<[f64; 2]> = written
        .iter()
        .filter(|line| line.starts_with("EXX,"))
        .map(|line| {
            let words: Vec<&str> = line.split(',').collect();
            [words[1], words[3]].map(|word| word.parse().unwrap())
        })
        .collect();
    for (warm, [at, cold]) in warm.iter().zip(&cold) {
        // The difference is zero at the origin.
        assert!(
            (warm - cold + 0.93e-3 * at).abs() < 0.03,
            "{at} {warm} {cold}"
        );
    }
    assert!(
        written
            .iter()
            .any(|line| line.starts_with("EAX,") && !line.contains(",0.0000,"))
    );
}

/// Readings that cannot be used: the line and the remedy, and no error file.
#[test]
fn wrong_readings_are_refused() {
    let folder = TestFolder::new();
    let good = "function,target_mm,run,direction,reading,unit\nEXX,-10,1,up,0.5,um\n\
                EXX,-10,1,down,0.6,um\nEXX,10,1,up,0.5,um\nEXX,10,1,down,0.6,um\n";
    for (from, to, expected) in [
        (
            "EXX,10,1,down,0.6,um\n",
            "",
            "line 4: EXX has 0 readings down at 10 mm, and 1",
        ),
        (
            "0.5,um",
            "0.5,urad",
            "line 2: EXX is a translation, its unit is \"urad\"",
        ),
        (
            "-10,1,up,0.5",
            "-10,1,up,",
            "line 2: EXX has a gap: reading is empty",
        ),
        (
            "1,down",
            "1,back",
            "line 3: direction = \"back\"; write up or down",
        ),
        (
            "function,target_mm",
            "name,target_mm",
            "line 1: the header is",
        ),
        (
            "EXX,-10,1,up,0.5,um",
            "EXX,-10,1,up,0.5",
            "line 2: has 5 values",
        ),
        (
            "EXX,-10,1,up",
            "EQQ,-10,1,up",
            "line 2: \"EQQ\" is no error of an axis",
        ),
    ] {
        assert!(good.contains(from), "{from}");
        std::fs::write(folder.path("r.csv"), good.replacen(from, to, 1)).unwrap();
        let (file, out) = (folder.path("r.csv"), folder.path("e.csv"));
        let machine = machine();
        let arguments = [
            "calibrate",
            "laser",
            "--machine",
            &machine,
            "--readings",
            &file,
        ];
        let refused = run(&[&arguments[..], &["--out", &out]].concat()).expect_code(3);
        assert!(
            refused.err.contains(expected),
            "{expected}\n{}",
            refused.err
        );
        assert!(!std::path::Path::new(&out).exists());
    }
}

/// Readings whose errors no controller takes are refused with their place: targets outside the
/// travel, too little of it, a gap, a step. Options of a measurement have no meaning for them.
#[test]
fn readings_beyond_the_limits_are_refused() {
    let folder = TestFolder::new();
    let (file, out, machine) = (folder.path("r.csv"), folder.path("e.csv"), machine());
    let laser = ["calibrate", "laser", "--machine", &machine, "--out", &out];
    let readings = |targets: &[(f64, f64)]| {
        let mut text = "function,target_mm,run,direction,reading,unit\n".to_string();
        for (target, um) in targets {
            for direction in ["up", "down"] {
                text.push_str(&format!("EXX,{target},1,{direction},{um},um\n"));
            }
        }
        std::fs::write(&file, text).unwrap();
        run(&[&laser[..], &["--readings", &file]].concat())
    };
    for (targets, expected) in [
        (
            &[
                (-300.0, 0.0),
                (-150.0, 0.0),
                (0.0, 0.0),
                (150.0, 0.0),
                (340.0, 0.0),
            ][..],
            "r.csv: line 10: at 340.0000 mm: EXX has a position at 340 mm, the travel is -325 to 325 mm",
        ),
        (
            &[(-10.0, 0.0), (10.0, 0.0)],
            "EXX covers -10 to 10 mm of the travel -325 to 325 mm",
        ),
        (
            &[(-300.0, 0.0), (-50.0, 0.0), (100.0, 0.0), (300.0, 0.0)],
            "r.csv: line 4: at -50.0000 mm: EXX has a gap of 250 mm",
        ),
        (
            &[
                (-300.0, 0.0),
                (-150.0, 0.0),
                (0.0, 0.0),
                (10.0, 400.0),
                (200.0, 400.0),
            ],
            "r.csv: line 8: at 10.0000 mm: EXX changes by 40.000 um per mm",
        ),
        (
            &[(-200.0, -600.0), (0.0, 0.0), (200.0, 0.0)],
            "r.csv: line 2: at -200.0000 mm: EXX is -600.0000 um, the controller takes at most 500",
        ),
    ] {
        let refused = readings(targets).expect_code(3);
        assert!(
            refused.err.contains(expected),
            "{expected}\n{}",
            refused.err
        );
        assert!(refused.err.contains("r.csv"), "{}", refused.err);
        assert!(!std::path::Path::new(&out).exists(), "{expected}");
    }
    // What was not stated is named, and what was stated is in the report and in the file.
    let good = [(-200.0, 1.0), (0.0, 0.0), (200.0, -1.0)];
    let report = readings(&good).expect_code(0).out;
    for expected in [
        "load not stated; temperature not stated; volumetric compensation not stated: the readings of",
        "air         temperature not stated, pressure not stated;",
    ] {
        assert!(report.contains(expected), "{expected}\n{report}");
    }
    assert!(!report.contains("WARNING"), "{report}");
    let stated = [
        "--air",
        "21.5",
        "--pressure",
        "990",
        "--machine-temperature",
        "24",
    ];
    let all = [
        &laser[..],
        &["--readings", &file, "--compensation", "on"],
        &stated,
    ]
    .concat();
    let report = run(&all).expect_code(0).out;
    let written = std::fs::read_to_string(&out).unwrap();
    for expected in [
        "temperature 24 deg C; volumetric compensation ON: positioning, straightness",
        "air         temperature 21.5 deg C, pressure 990 hPa;",
        "WARNING     the machine has 24 deg C and not 20",
        "+-8.0 um per metre",
    ] {
        assert!(report.contains(expected), "{expected}\n{report}");
        assert!(written.contains(expected), "{expected}\n{written}");
    }
    for option in [
        &["--uncorrected"][..],
        &["--errors", &out],
        &["--interval", "20"],
        &["--no-roll"],
        &["--no-noise"],
        &["--seed", "2"],
        &["--save-readings", "x.csv"],
    ] {
        let refused = run(&[&laser[..], &["--readings", &file], option].concat()).expect_code(2);
        assert!(
            refused.err.contains("cannot be used with"),
            "{}",
            refused.err
        );
    }
    let refused = run(&[&laser[..], &["--compensation", "on"]].concat()).expect_code(2);
    assert!(refused.err.contains("no error tables"), "{}", refused.err);
}

/// The errors that a controller compensates while it is measured are in full effect: the report
/// says so, and positioning and straightness are what they leave.
#[test]
fn a_compensated_machine_is_measured() {
    let folder = TestFolder::new();
    let (machine, out) = (machine(), folder.path("e.csv"));
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let truth = root
        .join("../volumetric/data/vmc3_errors.csv")
        .display()
        .to_string();
    let laser = ["calibrate", "laser", "--machine", &machine, "--out", &out];
    let options = ["--errors", &truth, "--interval", "150", "--no-noise"];
    let report = run(&[&laser[..], &options].concat()).expect_code(0).out;
    let expected = "machine     unloaded; volumetric compensation ON (100 %): positioning";
    assert!(report.contains(expected), "{report}");
    for line in errors(&out).iter().skip(1) {
        let words: Vec<&str> = line.split(',').collect();
        let value: f64 = words[3].parse().unwrap();
        if words[4] == "um" {
            assert!(value.abs() < 0.2, "{line}");
        }
    }
    // They are no errors to compensate.
    let again = ["--errors", &out, "--interval", "150"];
    let refused = run(&[&laser[..], &again].concat()).expect_code(3);
    assert!(
        refused.err.contains("--compensation off"),
        "{}",
        refused.err
    );
    // Without compensation the same machine has its errors.
    let off = [&laser[..], &options, &["--compensation", "off"]].concat();
    let report = run(&off).expect_code(0).out;
    assert!(report.contains("volumetric compensation off"), "{report}");
    let largest = errors(&out).iter().skip(1).fold(0.0_f64, |largest, line| {
        let words: Vec<&str> = line.split(',').collect();
        let value: f64 = words[3].parse().unwrap();
        largest.max(if words[4] == "um" { value.abs() } else { 0.0 })
    });
    assert!(largest > 1.0, "{largest}");
}

/// A machine without errors has nothing to measure, and a circle beyond its reach is refused.
#[test]
fn machines_that_cannot_be_measured_are_refused() {
    let folder = TestFolder::new();
    let out = folder.path("e.csv");
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mill = root.join("../../machines/mill3.toml");
    let laser = ["calibrate", "laser", "--machine", mill.to_str().unwrap()];
    let refused = run(&[&laser[..], &["--out", &out]].concat()).expect_code(3);
    assert!(
        refused.err.contains("has no errors to measure"),
        "{}",
        refused.err
    );
    assert!(!std::path::Path::new(&out).exists());
    let machine = machine();
    let circle = [
        "calibrate",
        "ball-bar",
        "--machine",
        &machine,
        "--radius",
        "300",
    ];
    let refused = run(&circle).expect_code(4);
    assert!(refused.err.contains("circle test"), "{}", refused.err);
}

/// One command from an error file to the compensated part and its report: the errors of the file in
/// the simulated machine, calibration, volume, test piece, circle test and page.
#[test]
fn scenario_goes_from_error_file_to_compensated_part() {
    let folder = TestFolder::new();
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = root.join("../volumetric");
    let text = std::fs::read_to_string(data.join("data/vmc3_errors.csv")).unwrap();
    // Another machine than that of the file: y is 40 urad out of square to x instead of 25.
    let other = text.replace("EC0Y,urad,25,", "EC0Y,urad,40,");
    assert_ne!(text, other);
    std::fs::write(folder.path("truth.csv"), &other).unwrap();
    let (truth, out) = (folder.path("truth.csv"), folder.path("out"));
    let tables = ["table_4_1_cmm_x_side.csv", "table_4_2_cmm_y_side.csv"]
        .map(|name| data.join("tests/data").join(name).display().to_string());
    let [x, y] = &tables;
    let vmc = [
        "scenario", "run", "vmc", "--coarse", "--json", "--out", &out,
    ];
    let vmc = [&vmc[..], &["--cmm-x", x, "--cmm-y", y, "--errors", &truth]].concat();
    let printed = run(&vmc).expect_code(0).out;
    let summary: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let [before, exact, measured] = [0, 1, 2].map(|state| &summary["states"][state]);
    // Before: largest and rms at the points of the grid, um, from the closed forms of the file by a
    // program in Python. At standstill the drives are off by 0.1 um at most.
    let volume = |state: &serde_json::Value, size: &str| number(&state["volume"][size]);
    let (largest, rms) = (volume(before, "largest_um"), volume(before, "rms_um"));
    println!("before: {largest} um, rms {rms} um");
    assert!((largest - 5.973).abs() <= 0.1, "{largest}");
    assert!((rms - 3.830).abs() <= 0.1, "{rms}");
    assert!(volume(exact, "largest_um") <= 0.1, "{exact}");
    let rest = volume(measured, "largest_without_motion_um");
    assert!(rest <= 0.35, "{rest}");
    // An instrument sees no motion of the whole workpiece, but it leaves less than there was.
    assert!(volume(measured, "largest_um") < 0.5 * largest, "{measured}");
    let rows = |state: &serde_json::Value| state["test_piece"].as_array().unwrap().clone();
    assert_eq!(rows(before).len(), 28);
    let mut improved = 0;
    for ((before, exact), measured) in rows(before).iter().zip(rows(exact)).zip(rows(measured)) {
        let [before, exact, measured] =
            [before, &exact, &measured].map(|row| number(&row["value_um"]));
        if before.abs() > 1.0 {
            improved += 1;
            assert!(exact.abs() < before.abs(), "{before} {exact}");
            assert!(measured.abs() < before.abs(), "{before} {measured}");
        }
    }
    assert!(improved >= 10, "{improved}");
    // The errors of the machine file would show 15 urad less.
    let expected = ellipse(&other, 100.0);
    for (index, feed) in [30.0, 45.0, 60.0].into_iter().enumerate() {
        let circle = |state: &serde_json::Value| state["circles"][index].clone();
        assert_eq!(number(&circle(before)["feed_mm_s"]), feed);
        let squareness = number(&circle(before)["squareness_urad"]);
        println!("{feed} mm/s: squareness {squareness}, model {expected}");
        assert!((squareness - expected).abs() < 1.5);
        for state in [exact, measured] {
            let square = number(&circle(state)["squareness_urad"]);
            assert!(square.abs() < 3.0, "{feed} mm/s: {square}");
            // Both directions.
            for turn in 0..2 {
                let [left, there_was] =
                    [state, before].map(|state| number(&circle(state)["deviation_um"][turn]));
                assert!(left < 0.5 * there_was, "{feed} mm/s: {left} of {there_was}");
            }
            // The contour error itself, with the radius and the dynamic error of the loops.
            let [left, there_was] = [state, before].map(|state| {
                let radial = &circle(state)["radial_um"];
                number(&radial[0]).abs().max(number(&radial[1]).abs())
            });
            println!("{feed} mm/s: contour error {left} of {there_was} um");
            assert!(left < there_was, "{feed} mm/s: {left} of {there_was}");
        }
    }
    // The machine with errors ten times as large: the same with exact tables; measured ones are off
    // between their targets of 25 mm.
    let worn = |state: usize, size: &str| number(&summary["worn"][state][size]);
    assert_eq!(summary["worn"].as_array().unwrap().len(), 3);
    assert!(
        (worn(0, "largest_um") - 59.73).abs() <= 0.15,
        "{}",
        summary["worn"]
    );
    assert!(
        (worn(0, "rms_um") - 38.30).abs() <= 0.15,
        "{}",
        summary["worn"]
    );
    assert!(worn(1, "largest_um") <= 0.1, "{}", summary["worn"]);
    assert!(
        worn(2, "largest_without_motion_um") <= 1.5,
        "{}",
        summary["worn"]
    );
    // Static and dynamic error apart: at standstill exact tables leave nothing.
    let still = |state: &serde_json::Value| number(&state["circle_at_standstill_um"]);
    assert!(still(before) > 5.0, "{before}");
    assert!(still(exact) <= 0.15, "{}", still(exact));
    assert!(still(measured) <= 0.5, "{}", still(measured));
    // Table 5.1 with the published tables: the model has fits of them.
    let of_x = &summary["comparison"][0];
    assert!(number(&of_x["r_squared"]) > 0.8, "{of_x}");
    assert!(number(&of_x["p"]) < 0.001, "{of_x}");
    // The sides are written in the form of the tables; here they are the tables.
    for (name, table) in ["side_x.csv", "side_y.csv"].iter().zip(&tables) {
        let written = std::fs::read_to_string(folder.path("out/vmc/") + name).unwrap();
        let given = std::fs::read_to_string(table).unwrap();
        let rows = |text: &str| -> Vec<Vec<f64>> {
            let numbers = |line: &str| line.split(',').map(|word| word.parse().ok()).collect();
            text.lines().filter_map(numbers).collect()
        };
        let (written, given) = (rows(&written), rows(&given));
        assert_eq!((written.len(), written[0].len()), (15, 5));
        for (written, given) in written.iter().zip(&given) {
            let pairs = written.iter().zip(given);
            assert!(
                pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-4),
                "{written:?}"
            );
        }
    }
    let square = number(&summary["squareness_of_sides_urad"]);
    assert!((square - 26.8).abs() < 0.1, "{square}");
    let page = std::fs::read_to_string(folder.path("out/vmc/index.html")).unwrap();
    // The page states these sizes.
    let states = [before, exact, measured].map(|state| &state["volume"]);
    for sizes in states
        .into_iter()
        .chain(summary["worn"].as_array().unwrap())
    {
        let names = ["largest_um", "rms_um", "largest_without_motion_um"];
        let row = names.map(|name| format!("<td class=\"n\">{:.3}</td>", number(&sizes[name])));
        assert!(page.contains(&row.concat()), "{row:?}");
    }
    for part in [
        "at standstill",
        "What exact tables leave",
        "Side 4 of the diamond",
        "errors x 10, measured tables",
        "exact tables",
        "measured tables",
        "tolerance",
        "table 5.1",
        "ISO 230-2",
    ] {
        assert!(page.contains(part), "{part}");
    }
}

/// Files of a measuring machine with missing rows, and errors that no controller takes: nothing
/// runs, and no file is written.
#[test]
fn wrong_files_of_the_scenario_are_refused() {
    let folder = TestFolder::new();
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = root.join("../volumetric");
    let table = data.join("tests/data/table_4_1_cmm_x_side.csv");
    let text = std::fs::read_to_string(&table).unwrap();
    let missing: Vec<&str> = text.lines().take(13).collect();
    std::fs::write(folder.path("x.csv"), missing.join("\n")).unwrap();
    let beyond = text.replace("\n60,", "\n90,");
    assert_ne!(beyond, text);
    let beyond = beyond.replace("\nx_mm,", "\ny_mm,");
    std::fs::write(folder.path("beyond.csv"), beyond).unwrap();
    let beyond = folder.path("beyond.csv");
    let steep = std::fs::read_to_string(data.join("data/vmc3_errors.csv")).unwrap();
    let steep = steep.replace("EXX,um,0,0.008,", "EXX,um,0,1.5,");
    std::fs::write(folder.path("steep.csv"), steep).unwrap();
    let (x, errors, out) = (
        folder.path("x.csv"),
        folder.path("steep.csv"),
        folder.path("out"),
    );
    let y = table.display().to_string();
    let vmc = ["scenario", "run", "vmc", "--coarse", "--out", &out];
    let machine = machine();
    let program = folder.path("part.ngc");
    std::fs::write(&program, "G21 G90\nG1 X10 F600\nM30\n").unwrap();
    let of = ["--machine", &machine, "--errors", &errors, "--out", &out];
    for (arguments, expected) in [
        (
            [&vmc[..], &["--cmm-x", &x, "--cmm-y", &y]].concat(),
            "x.csv: line 13: the table has 10 of 15 rows and ends here; probe the missing",
        ),
        (
            [&vmc[..], &["--cmm-x", &y, "--cmm-y", &beyond]].concat(),
            "beyond.csv: line 5: value 1 is 90 mm, the side has -80 to 80 mm there; write mm",
        ),
        (
            [&vmc[..], &["--cmm-x", &beyond, "--cmm-y", &y]].concat(),
            "the first column is \"y_mm\" and the side is along x; exchange the files",
        ),
        (
            [&vmc[..], &["--errors", &errors]].concat(),
            "EXX changes by 1.510 um per mm",
        ),
        (
            [&["run", &program][..], &of].concat(),
            "steep.csv: line 7: EXX changes by 1.510 um per mm",
        ),
        (
            [&["calibrate", "rewrite", &program][..], &of].concat(),
            "EXX changes by 1.510 um per mm",
        ),
    ] {
        let refused = run(&arguments).expect_code(3);
        assert!(
            refused.err.contains(expected),
            "{expected}\n{}",
            refused.err
        );
        assert!(!std::path::Path::new(&out).exists(), "{arguments:?}");
    }
    let e1 = ["scenario", "run", "e1", "--coarse", "--out", &out];
    let refused = run(&e1).expect_code(2);
    assert!(
        refused.err.contains("belongs to `scenario run vmc`"),
        "{}",
        refused.err
    );
}

/// The written machine file of an arm is calibrated: a second calibration finds nothing more.
#[test]
fn a_calibrated_arm_stays_calibrated() {
    let folder = TestFolder::new();
    let (first, second) = (folder.path("a.toml"), folder.path("b.toml"));
    let command = ["calibrate", "arm", "--perturb", "0.1", "--out", &first];
    let elsewhere =
        |out: &str, when: &str| value(out, &format!("error of the tip elsewhere, {when}"));
    let out = run(&command).expect_code(0).out;
    println!("{out}");
    assert!(elsewhere(&out, "before") > 100.0, "{out}");
    assert!(elsewhere(&out, "after") < 5.0, "{out}");
    assert!(
        out.contains("Readings of the tip do not distinguish w from x_off"),
        "{out}"
    );
    run(&["machine", "check", &first]).expect_code(0);
    let again = ["calibrate", "arm", "--machine", &first, "--out", &second];
    let out = run(&[&again[..], &["--seed", "2"]].concat())
        .expect_code(0)
        .out;
    assert!(elsewhere(&out, "before") < 5.0, "{out}");
    assert!(elsewhere(&out, "after") < 5.0, "{out}");
    let mill = [
        "calibrate",
        "arm",
        "--machine",
        &machine(),
        "--out",
        &second,
    ];
    let refused = run(&mill).expect_code(3);
    assert!(refused.err.contains("is no H-4 arm"), "{}", refused.err);
    let refused = run(&["calibrate", "arm", "--perturb", "3"]).expect_code(2);
    assert!(
        refused.err.contains("write mm from 0 to 0.2"),
        "{}",
        refused.err
    );
}

/// A program is rewritten by an error file; what cannot be rewritten is refused with its line.
#[test]
fn a_program_is_rewritten() {
    let folder = TestFolder::new();
    let errors = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let errors = errors
        .join("../volumetric/data/vmc3_errors.csv")
        .display()
        .to_string();
    let (machine, program, out) = (machine(), folder.path("a.ngc"), folder.path("b.ngc"));
    std::fs::write(&program, "G21 G90\n(MSG,go)\nG1 X80 Y80 Z-10 F600\nM30\n").unwrap();
    let command = ["calibrate", "rewrite", &program, "--machine", &machine];
    let command = [&command[..], &["--errors", &errors, "--out", &out]].concat();
    run(&command).expect_code(0);
    let text = std::fs::read_to_string(&out).unwrap();
    assert!(text.contains("(MSG,go)"), "{text}");
    let last = text.lines().rfind(|line| line.starts_with("G1")).unwrap();
    let words: Vec<f64> = last
        .split_whitespace()
        .filter_map(|word| word[1..].parse().ok())
        .collect();
    let [.., x, y, z] = words[..] else {
        panic!("{last}")
    };
    // The point less the error there, to the last digit of the program.
    let truth = include_str!("../../volumetric/data/vmc3_errors.csv");
    let point = [80.0, 80.0, -10.0];
    for ((point, error), word) in point.iter().zip(error_of(truth, point)).zip([x, y, z]) {
        assert!((point - error - word).abs() < 1e-6, "{last} {error}");
    }
    let checked = ["run", &out, "--machine", &machine, "--check"];
    run(&checked).expect_code(0);
    // The test piece, with its tools.
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let part = root.join("../../examples/a160.ngc").display().to_string();
    let of_part = ["calibrate", "rewrite", &part, "--machine", &machine];
    run(&[&of_part[..], &["--errors", &errors, "--out", &out]].concat()).expect_code(0);
    let text = std::fs::read_to_string(&out).unwrap();
    let tools: Vec<&str> = text.lines().filter(|line| line.contains("M6")).collect();
    assert_eq!(tools, ["T3 M6", "T2 M6", "T3 M6", "T4 M6"]);
    for program in [&part, &out] {
        run(&["run", program, "--machine", &machine, "--check"]).expect_code(0);
    }
    std::fs::write(&program, "G21 G90\nG1 X10 F600\nG38.2 X20 F60\nM30\n").unwrap();
    let refused = run(&command).expect_code(3);
    assert!(refused.err.contains("a.ngc:3: "), "{}", refused.err);
}

/// Machines with other joints than x, y and z are refused, and no file is written.
#[test]
fn a_program_is_rewritten_for_three_axes_only() {
    let folder = TestFolder::new();
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let errors = root.join("../volumetric/data/vmc3_errors.csv");
    let (errors, out) = (errors.display().to_string(), folder.path("b.ngc"));
    let program = folder.path("a.ngc");
    std::fs::write(&program, "G21 G90\nG1 X1 F600\nM30\n").unwrap();
    for (name, model) in [
        ("h4", "h4"),
        ("mill4", "four_axis"),
        ("trunnion5", "trunnion"),
    ] {
        let machine = root.join(format!("../../machines/{name}.toml"));
        let machine = machine.display().to_string();
        let command = ["calibrate", "rewrite", &program, "--machine", &machine];
        let refused = run(&[&command[..], &["--errors", &errors, "--out", &out]].concat());
        let err = refused.expect_code(3).err;
        let expected =
            format!("{name}.toml: the joints of the model \"{model}\" are not x, y and z");
        assert!(err.contains(&expected), "{err}");
        assert!(!std::path::Path::new(&out).exists());
    }
}

/// Readings of a real ball bar, evaluated without a machine that moves: the squareness becomes an
/// error file, which a controller takes, and whose effect the operator switches.
#[test]
fn readings_of_a_ball_bar_make_an_error_file() {
    let folder = TestFolder::new();
    let machine = machine();
    let (bar, errors) = (folder.path("bar.csv"), folder.path("errors.csv"));
    let evaluate = |text: &str| {
        std::fs::write(&bar, text).unwrap();
        let command = ["calibrate", "ball-bar", "--machine", &machine];
        let files = ["--radius", "150", "--readings", &bar, "--out", &errors];
        run(&[&command[..], &files].concat())
    };
    // y out of square by 30 urad moves x by -30e-6 y, a long bar adds 2 um, and the clockwise
    // circle is 1 um smaller.
    let mut text = String::from("angle_deg,direction,reading_um\n");
    for (direction, offset) in [("ccw", 2.0), ("cw", 1.0)] {
        for step in 0..=240 {
            let angle = f64::from(step) * 1.5;
            let (sine, cosine) = angle.to_radians().sin_cos();
            let reading = offset - 30e-6 * 150e3 * sine * cosine;
            text += &format!("{angle},{direction},{reading:.4}\n");
        }
    }
    let out = evaluate(&text).expect_code(0).out;
    let close = |name: &str, expected: f64| {
        let found = value(&out, name);
        assert!((found - expected).abs() < 0.02, "{name} {expected}: {out}");
    };
    close("squareness", 30.0);
    // The radius changes by up to 15e-6 of 150 mm in both directions.
    close("G ccw", 4.5);
    close("G cw", 4.5);
    close("H", 1.0);
    close("F", -1.25);
    let written = std::fs::read_to_string(&errors).unwrap();
    let [x, y, z] = error_of(&written, [0.0, 100.0, 0.0]);
    assert!(
        (x + 3e-3).abs() < 2e-6 && y == 0.0 && z == 0.0,
        "{x} {y} {z}"
    );

    // The same squareness as a result, beside no readings of a laser.
    let laser = folder.path("laser.csv");
    let header = "function,target_mm,run,direction,reading,unit";
    std::fs::write(&laser, format!("{header}\nEC0Y,,,,30,urad\n")).unwrap();
    let command = ["calibrate", "laser", "--machine", &machine];
    let files = ["--readings", &laser, "--out", &errors];
    run(&[&command[..], &files].concat()).expect_code(0);
    let alone = std::fs::read_to_string(&errors).unwrap();
    assert!((error_of(&alone, [0.0, 100.0, 0.0])[0] + 3e-3).abs() < 1e-9);

    // What is wrong is named, and nothing is written.
    std::fs::remove_file(&errors).unwrap();
    let without = |part: &str| -> String {
        let lines = text.lines().filter(|line| !line.starts_with(part));
        lines.map(|line| format!("{line}\n")).collect()
    };
    for (text, expected) in [
        (
            without("3"),
            "ccw has no reading between 28.5 and 40.5 degrees",
        ),
        (
            text.replace(",cw,", ",ccw,"),
            "no readings with direction cw",
        ),
        (text.replace(",cw,", ",back,"), "write ccw or cw"),
        (text.replace("4.5,cw,", "4.5,cw,x"), "is not a number"),
        (
            text.replace("_um", "_mm"),
            "write \"angle_deg,direction,reading_um\"",
        ),
    ] {
        let refused = evaluate(&text).expect_code(3);
        assert!(
            refused.err.contains(expected),
            "{expected}: {}",
            refused.err
        );
        assert!(refused.err.contains("bar.csv"), "{}", refused.err);
        assert!(!std::path::Path::new(&errors).exists());
    }
    // A file of what compensation left is marked as such, and refused as the errors of a machine.
    let marked = folder.path("marked.csv");
    std::fs::write(&bar, &text).unwrap();
    let command = ["calibrate", "ball-bar", "--machine", &machine];
    let files = ["--readings", &bar, "--compensation", "on", "--out", &marked];
    run(&[&command[..], &files].concat()).expect_code(0);
    let of_rest = [&command[..], &["--errors", &marked]].concat();
    let refused = run(&of_rest).expect_code(3);
    assert!(refused.err.contains("compensat"), "{}", refused.err);
    let both = ["--readings", &bar, "--feed", "20"];
    run(&[&["calibrate", "ball-bar"][..], &both].concat()).expect_code(2);

    // The controller compensates from homing on, until the operator ends it.
    let plain = std::fs::read_to_string(&machine).unwrap();
    let compensated = folder.path("compensated.toml");
    let section = format!("\n[compensation]\nchain = \"wYbXZt\"\nerrors = '''\n{written}'''\n");
    std::fs::write(&compensated, plain + &section).unwrap();
    let served = scene::SimServer::on_tcp(&["--machine", &compensated]);
    let run = |command: &[&str]| served.run(&[command, &["--machine", &compensated]].concat());
    run(&["home"]).expect_code(0);
    let faded = |expected: i64| {
        let shown =
            || run(&["status", "--json"]).expect_code(0).json()["compensation_percent"].clone();
        let mut tries = 0;
        while shown() != expected {
            tries += 1;
            assert!(tries < 100, "{} instead of {expected}", shown());
        }
    };
    faded(100);
    run(&["compensation", "off"]).expect_code(0);
    faded(0);
    let reported = run(&["compensation", "on"]).expect_code(0).out;
    assert!(reported.contains("compensation fades in"), "{reported}");
    faded(100);
    let shown = run(&["status"]).expect_code(0).out;
    assert!(shown.contains("compensation  100 %"), "{shown}");
    // A machine without error tables.
    let refused = scene::SimServer::on_tcp(&[]).run(&["compensation", "off"]);
    assert!(refused.err.contains("no error tables"), "{refused:?}");
}
