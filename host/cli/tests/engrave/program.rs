//! The written part program: its cuts against the drawing, options, and times.

use super::{Folder, plate};

/// One command goes from the drawing to the plate; its surface is what the drawing asks for.
#[test]
fn the_cut_plate_is_the_drawing() {
    let folder = Folder::new("plate");
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--operation",
        "pocket",
        "--layer",
        "PICTURE",
        "--tool",
        "1",
        "--depth",
        "0.5",
        "--feed",
        "900",
        "-o",
        "plate.ngc",
        "--preview",
        "plate.html",
        "--run",
    ]);
    assert_eq!(code, 0, "{result:#}");
    let surface = &result["surface"];
    let number = |name: &str| surface[name].as_f64().unwrap();
    assert!(number("asked_mm2") > 200.0, "{surface:#}");
    // 0.1 mm2 is a hundredth of the least pocket.
    assert!(
        number("uncut_mm2") < 0.1 && number("over_cut_mm2") < 0.1,
        "{surface:#}"
    );
    // Z has 0.001 mm a step; friction holds it a step or two off.
    assert!((number("mean_depth_mm") - 0.5).abs() < 0.004, "{surface:#}");
    assert!((number("max_depth_mm") - 0.5).abs() < 0.006, "{surface:#}");
    // No ridge between two passes stands up: the least depth is that of the whole floor.
    assert!(number("min_depth_mm") > 0.49, "{surface:#}");
    for name in [
        "plate.ngc",
        "plate.html",
        "plate.out/report.html",
        "plate.out/recording.hmr",
    ] {
        assert!(folder.0.join(name).exists(), "{name}");
    }
}

/// The command of the documentation, without an option: the outline of the whole
/// plate, 1 mm deep. And the holes.
#[test]
fn outline_and_holes_are_cut_as_drawn() {
    let folder = Folder::new("outline");
    let plate = plate();
    for (arguments, program) in [
        (&["--run"][..], "plate.ngc"),
        (
            &[
                "--operation",
                "drill",
                "--layer",
                "HOLES",
                "-o",
                "holes.ngc",
                "--run",
            ][..],
            "holes.ngc",
        ),
    ] {
        let all: Vec<&str> = std::iter::once(&*plate)
            .chain(arguments.iter().copied())
            .collect();
        let (code, result) = folder.run(&all);
        assert_eq!(code, 0, "{result:#}");
        let surface = &result["surface"];
        let number = |name: &str| surface[name].as_f64().unwrap();
        assert!(number("asked_mm2") > 2.0, "{surface:#}");
        assert!(
            number("uncut_mm2") < 0.1 && number("over_cut_mm2") < 0.1,
            "{surface:#}"
        );
        assert!((number("mean_depth_mm") - 1.0).abs() < 0.004, "{surface:#}");
        assert!((number("max_depth_mm") - 1.0).abs() < 0.006, "{surface:#}");
        assert!(number("min_depth_mm") > 0.99, "{surface:#}");
        for off in result["off_mm"].as_array().unwrap() {
            assert!(off.as_f64().unwrap().abs() < 0.008, "{result:#}");
        }
        assert!(folder.0.join(program).exists());
    }
}

/// Words of a part program with one letter.
fn words(text: &str, letter: char) -> Vec<f64> {
    let lines = text.lines().filter(|line| !line.starts_with(';'));
    lines
        .flat_map(str::split_whitespace)
        .filter_map(|word| word.strip_prefix(letter)?.parse().ok())
        .collect()
}

/// Tool, feed and place of the command line are those of the program.
#[test]
fn the_options_reach_the_program() {
    let folder = Folder::new("options");
    let square = "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n\
        0\nLWPOLYLINE\n8\nCut\n90\n4\n70\n1\n10\n200\n20\n300\n10\n220\n20\n300\n10\n220\n20\n310\n\
        10\n200\n20\n310\n0\nENDSEC\n0\nEOF\n";
    folder.write("square.dxf", square);
    let program = |more: &[&str]| {
        let all: Vec<&str> = ["square.dxf", "-o", "square.ngc"]
            .into_iter()
            .chain(more.iter().copied())
            .collect();
        let (code, result) = folder.run(&all);
        assert_eq!(code, 0, "{result:#}");
        (
            std::fs::read_to_string(folder.0.join("square.ngc")).unwrap(),
            result,
        )
    };
    // Box of the cuts; the origin is where the tool starts and ends.
    let sides = |text: &str, letter| {
        let all = words(text, letter);
        let cut = &all[1..all.len() - 1];
        let min = cut.iter().copied().fold(f64::INFINITY, f64::min);
        (min, cut.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    };
    for (place, x, y) in [
        (
            &["--origin", "centre", "--at", "50,60"][..],
            (40.0, 60.0),
            (55.0, 65.0),
        ),
        (
            &["--origin", "lower-left", "--at", "5,7"],
            (5.0, 25.0),
            (7.0, 17.0),
        ),
        (&["--at", "-150,-280"], (50.0, 70.0), (20.0, 30.0)),
        (
            &["--origin", "lower-left", "--scale", "0.5", "--at", "5,7"],
            (5.0, 15.0),
            (7.0, 12.0),
        ),
        (
            &[
                "--origin",
                "lower-left",
                "--unit",
                "cm",
                "--scale",
                "0.1",
                "--at",
                "1,2",
            ],
            (1.0, 21.0),
            (2.0, 12.0),
        ),
    ] {
        let (text, _) = program(place);
        assert_eq!((sides(&text, 'X'), sides(&text, 'Y')), (x, y), "{place:?}");
    }
    let place = ["--origin", "lower-left", "--at", "5,7"];
    let more = |options: &[&'static str]| program(&[&place[..], options].concat());
    let (text, _) = more(&["--feed", "432", "--plunge", "54", "--depth", "0.7"]);
    assert_eq!(words(&text, 'F'), [54.0, 432.0]);
    assert!(words(&text, 'Z').contains(&-0.7));
    // Rows half a diameter apart, contours half a diameter inside.
    for (tool, rows) in [("1", 0.5), ("2", 1.0)] {
        let (text, _) = more(&["--operation", "pocket", "--clear", "zigzag", "--tool", tool]);
        let (low, high) = sides(&text, 'Y');
        assert_eq!((low, high), (7.0 + rows, 17.0 - rows));
        let mut levels = words(&text, 'Y');
        levels.sort_by(f64::total_cmp);
        levels.dedup();
        let gaps = levels.windows(2).map(|two| two[1] - two[0]);
        let spacing = gaps.filter(|gap| *gap < 3.0).fold(0.0, f64::max);
        assert!((spacing - rows).abs() < 1e-9, "{spacing}");
    }
    for bad in [
        ["--feed", "0"],
        ["--plunge", "0"],
        ["--lift", "NaN"],
        ["--scale", "0"],
    ] {
        let (code, result) = folder.run(&[&["square.dxf", "-o", "bad.ngc"][..], &bad].concat());
        assert_eq!(code, 2, "{result:#}");
        assert!(
            result["error"].as_str().unwrap().contains(bad[0]),
            "{result:#}"
        );
    }
    assert!(!folder.0.join("bad.ngc").exists());
}

/// The times of the report: `L_cut / v + L_air / v_air + n Tz`, and the analysis. The pocket is
/// done twice in two depths.
#[test]
fn the_report_has_the_times_of_the_lengths() {
    let folder = Folder::new("times");
    let plate = plate();
    for operation in ["outline", "pocket"] {
        let (code, result) = folder.run(&[
            &plate,
            "--operation",
            operation,
            "--layer",
            "PICTURE",
            "--depth",
            "1",
            "--step-down",
            "0.5",
            "--feed",
            "300",
            "--plunge",
            "60",
            "--lift",
            "2",
            "-o",
            "time.ngc",
        ]);
        assert_eq!(code, 0, "{result:#}");
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let time = &result["time_s"];
        // Rapid moves of machines/engraver.toml: 20 mm/s.
        assert!((number(&time["cut"]) - number(&result["cut_mm"]) / 5.0).abs() < 1e-9);
        assert!((number(&time["air"]) - number(&result["air_mm"]) / 20.0).abs() < 1e-9);
        let sum = number(&time["cut"]) + number(&time["air"]) + number(&time["lifts"]);
        assert!((number(&time["total"]) - sum).abs() < 1e-9);
        let analysed = number(&time["total_with_analysis"]);
        assert!((analysed - sum - number(&time["analysis"])).abs() < 1e-9);
        assert!(number(&time["analysis"]) > 0.0);
        let lifts = number(&result["lifts"]);
        if operation == "outline" {
            // One plunge from 2 mm above to 1 mm below for each lift.
            assert!((number(&time["lifts"]) - lifts * (3.0 / 1.0 + 3.0 / 4.0)).abs() < 1e-9);
        } else {
            // Half of the plunges end at 0.5 mm.
            assert!((number(&time["lifts"]) - lifts * (2.75 / 1.0 + 2.75 / 4.0)).abs() < 1e-9);
        }
        let orders = result["orders"].as_array().unwrap();
        let chosen = orders.last().unwrap();
        assert!((number(&chosen["time_s"]) - sum).abs() < 1e-9, "{result:#}");
        for order in orders {
            assert!(
                number(&order["time_s"]) > number(&order["cut_mm"]) / 5.0,
                "{order:#}"
            );
        }
    }
}
