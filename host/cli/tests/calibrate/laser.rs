//! Measurement with a laser, and the evaluation of its readings from a file.

use super::{ellipse, errors, machine, value};
use crate::scene::{TestFolder, haptimill as run};

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
    let truth = include_str!("../../../volumetric/data/vmc3_errors.csv");
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
