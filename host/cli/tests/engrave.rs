//! `haptimill engrave`: from a drawing to the cut plate, lost steps, and bad drawings.

use haptimill_machine_file::MachineFile;
use haptimill_trace::{Recording, flag};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A folder of a test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("haptimill-engrave-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Runs the command in the folder; returns exit code and the JSON on standard output.
    fn run(&self, arguments: &[&str]) -> (i32, serde_json::Value) {
        let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
            .arg("engrave")
            .args(arguments)
            .arg("--json")
            .current_dir(&self.0)
            .output()
            .unwrap();
        let text = String::from_utf8(ran.stdout).unwrap();
        let json = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
        (ran.status.code().unwrap(), json)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.join(name), text).unwrap();
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn plate() -> String {
    root().join("examples/plate.dxf").display().to_string()
}

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
    assert!(
        (number("greatest_depth_mm") - 0.5).abs() < 0.006,
        "{surface:#}"
    );
    // No ridge between two passes stands up: the least depth is that of the whole floor.
    assert!(number("least_depth_mm") > 0.49, "{surface:#}");
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
        assert!(
            (number("greatest_depth_mm") - 1.0).abs() < 0.006,
            "{surface:#}"
        );
        assert!(number("least_depth_mm") > 0.99, "{surface:#}");
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
        let least = cut.iter().copied().fold(f64::INFINITY, f64::min);
        (least, cut.iter().copied().fold(f64::NEG_INFINITY, f64::max))
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
            assert!((number(&time["lifts"]) - lifts * (3.0 / 1.0 + 3.0 / 20.0)).abs() < 1e-9);
        } else {
            // Half of the plunges end at 0.5 mm.
            assert!((number(&time["lifts"]) - lifts * (2.75 / 1.0 + 2.75 / 20.0)).abs() < 1e-9);
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

/// The machine is that of section 2 of the thesis: 0.005 mm a step in x and y, 0.001 mm in z, 5
/// mm/s at 120 rev/min, 110 x 250 mm, no encoder.
#[test]
fn the_engraver_is_the_machine_of_the_thesis() {
    let machine = MachineFile::load(&root().join("machines/engraver.toml")).unwrap();
    let area: Vec<[f64; 2]> = machine.pose[..2]
        .iter()
        .map(|one| [one.low, one.high])
        .collect();
    assert_eq!(area, [[0.0, 110.0], [0.0, 250.0]]);
    let file: toml::Table = toml::from_str(&machine.text).unwrap();
    let joints = file["joint"].as_array().unwrap();
    let steps: Vec<f64> = joints
        .iter()
        .map(|joint| {
            assert!(
                joint.get("encoder").is_none() && joint["drive"]["kind"].as_str() == Some("step")
            );
            let turn = joint["drive"]["steps_per_turn"].as_integer().unwrap();
            joint["lead_mm"].as_float().unwrap() / turn as f64
        })
        .collect();
    assert_eq!(steps, [0.005, 0.005, 0.001]);
    assert_eq!(5.0 / joints[0]["lead_mm"].as_float().unwrap() * 60.0, 120.0);
    for plant in file["plant"]["joint"].as_array().unwrap() {
        assert_eq!(plant["drive"]["steps"]["phases"].as_integer(), Some(5));
    }
}

/// A circle of 10 mm at 5 mm/s, from the program to the commanded positions: it takes the time of
/// its length, 12.566 s, and that of starting and stopping; its radius is kept within a step.
#[test]
fn the_time_of_a_circle_is_that_of_its_length() {
    let folder = Folder::new("circle");
    folder.write(
        "circle.ngc",
        "G21 G90 G17 G94\nG0 X40 Y30 Z1\nG1 Z0.5 F60\nG3 X40 Y30 I-10 J0 F300\nG0 Z2\nM2\n",
    );
    let machine = root().join("machines/engraver.toml");
    let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(["run", "circle.ngc", "--out", "out", "--quiet", "--machine"])
        .arg(&machine)
        .current_dir(&folder.0)
        .output()
        .unwrap();
    assert!(
        ran.status.success(),
        "{}",
        String::from_utf8_lossy(&ran.stderr)
    );
    let recording = Recording::open(&folder.0.join("out/recording.hmr")).unwrap();
    let units = recording.pose_units();
    let (mut periods, mut worst, mut turned, mut last) = (0_u32, 0.0_f64, 0.0_f64, None);
    let mut steady = 0_u32;
    for record in recording.iter().unwrap() {
        let record = record.unwrap();
        let at: [f64; 2] = std::array::from_fn(|k| f64::from(record.commanded[k]) * units[k]);
        let off = [at[0] - 30.0, at[1] - 30.0];
        if record.line != 4 {
            continue;
        }
        worst = worst.max((off[0].hypot(off[1]) - 10.0).abs());
        let angle = off[1].atan2(off[0]);
        if let Some(before) = last {
            let step: f64 = angle - before;
            let step = step - (step / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            periods += u32::from(step != 0.0);
            turned += step;
            steady += u32::from((0.5..5.5).contains(&turned));
        }
        last = Some(angle);
    }
    let seconds = f64::from(periods) * 200e-6;
    assert!((turned - std::f64::consts::TAU).abs() < 1e-3, "{turned}");
    assert!(worst <= 0.005, "{worst}");
    // 50 mm of the circle at the full feed, within a period; the whole with start and stop.
    assert!(
        (f64::from(steady) * 200e-6 - 10.0).abs() <= 200e-6,
        "{steady}"
    );
    assert!(seconds > 12.566 && seconds < 12.566 + 0.2, "{seconds}");
}

/// Distance of a point from the frame of the plate: a rectangle with rounded corners.
fn off_path(paths: &[haptimill_engrave::geometry::Path], at: [f64; 2]) -> f64 {
    let segments = paths
        .iter()
        .flat_map(haptimill_engrave::geometry::Path::segments);
    segments
        .map(|one| {
            let near = one.point(one.nearest(at));
            (near[0] - at[0]).hypot(near[1] - at[1])
        })
        .fold(f64::INFINITY, f64::min)
}

/// The simulated path of the tool against the entities of the drawing, lines and arcs, in both
/// directions. The commanded path and the steps that leave the controller are within a step of
/// 0.005 mm; the tool is within that and what friction and the swing of the motors add.
#[test]
fn the_tool_of_the_simulator_is_on_the_drawing() {
    let folder = Folder::new("frame");
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--layer",
        "FRAME",
        "--depth",
        "0.2",
        "-o",
        "frame.ngc",
        "--run",
    ]);
    assert_eq!(code, 0, "{result:#}");
    let bytes = std::fs::read(&plate).unwrap();
    let mut drawing =
        haptimill_engrave::read::read(&bytes, &haptimill_engrave::read::ReadOptions::default())
            .unwrap();
    let choice = haptimill_engrave::drawing::LayerChoice {
        only: vec!["FRAME".into()],
        without: Vec::new(),
    };
    drawing.select_layers(&choice).unwrap();
    let recording = Recording::open(&folder.0.join("frame.out/recording.hmr")).unwrap();
    let (units, joint_units) = (recording.pose_units(), recording.joint_units());
    let (mut tool, mut commanded, mut steps) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut cut = Vec::new();
    for record in recording.iter().unwrap() {
        let record = record.unwrap();
        if !record.has(flag::TOOL_TRUE) {
            continue;
        }
        let at: [f64; 3] = std::array::from_fn(|k| f64::from(record.tool[k]) * units[k]);
        let asked: [f64; 2] = std::array::from_fn(|k| f64::from(record.commanded[k]) * units[k]);
        if at[2] < -0.1 {
            tool = tool.max(off_path(&drawing.paths, [at[0], at[1]]));
            commanded = commanded.max(off_path(&drawing.paths, asked));
            // x and y are joints of this machine.
            let made = std::array::from_fn(|k| f64::from(record.joints[k]) * joint_units[k]);
            steps = steps.max(off_path(&drawing.paths, made));
            cut.push([at[0], at[1]]);
        }
    }
    let points = drawing.paths.iter().flat_map(|path| path.points(0.1));
    let missed = points
        .map(|at| {
            let off = cut
                .iter()
                .map(|one: &[f64; 2]| (one[0] - at[0]).hypot(one[1] - at[1]));
            off.fold(f64::INFINITY, f64::min)
        })
        .fold(0.0, f64::max);
    assert!(commanded <= 0.001, "{commanded}");
    // Half a step on each axis is 0.0035 mm across.
    assert!(steps > 0.0 && steps <= 0.0036, "{steps}");
    // Friction and the cutting force turn the motors by a part of a step.
    assert!(tool <= 0.006 && missed <= 0.005, "{tool} {missed}");
}

/// A machine that accelerates its motors beyond their torque loses steps, and the command says so.
#[test]
fn lost_steps_are_found() {
    let folder = Folder::new("lost");
    let machine = std::fs::read_to_string(root().join("machines/engraver.toml")).unwrap();
    let machine = machine
        .replace("acceleration_mm_s2 = 200.0", "acceleration_mm_s2 = 1500.0")
        .replace("acceleration_mm_s2 = 500.0", "acceleration_mm_s2 = 1600.0")
        .replace("jerk_mm_s3 = 4000.0", "jerk_mm_s3 = 900000.0")
        .replace("\nrate_mm_s = 20.0", "\nrate_mm_s = 60.0")
        .replace("\nrate_mm_s = 25.0", "\nrate_mm_s = 65.0");
    folder.write("fast.toml", &machine);
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--operation",
        "drill",
        "--layer",
        "HOLES",
        "--depth",
        "1",
        "--machine",
        "fast.toml",
        "-o",
        "holes.ngc",
        "--run",
    ]);
    assert_eq!(code, 6, "{result:#}");
    let off = result["off_mm"].as_array().unwrap();
    assert!(
        off.iter().any(|off| off.as_f64().unwrap().abs() > 0.05),
        "{result:#}"
    );
}

/// A cutting load beyond the pull-out force of the motors loses whole electrical turns, which are
/// ten full steps of a 5-phase motor; a load within it loses none. The command says where.
#[test]
fn a_load_beyond_the_motors_loses_steps() {
    let folder = Folder::new("load");
    folder.write(
        "hook.dxf",
        "0\nSECTION\n2\nENTITIES\n0\nLINE\n8\n0\n10\n10\n20\n10\n11\n22\n21\n10\n\
         0\nLINE\n8\n0\n10\n22\n20\n10\n11\n22\n21\n18\n0\nENDSEC\n0\nEOF\n",
    );
    let machine = std::fs::read_to_string(root().join("machines/engraver.toml")).unwrap();
    // The largest force is 1.2 N times the scale; 130 N less 20 N of friction move a slide.
    for (scale, is_lost) in [("60.0", false), ("400.0", true)] {
        let loaded = machine.replace("force_scale = 1.0", &format!("force_scale = {scale}"));
        assert_ne!(loaded, machine);
        folder.write("loaded.toml", &loaded);
        let (code, result) = folder.run(&[
            "hook.dxf",
            "--depth",
            "0.5",
            "--machine",
            "loaded.toml",
            "-o",
            "hook.ngc",
            "--run",
        ]);
        let off: Vec<f64> = result["off_mm"]
            .as_array()
            .unwrap()
            .iter()
            .map(|off| off.as_f64().unwrap())
            .collect();
        if !is_lost {
            assert_eq!(code, 0, "{result:#}");
            assert!(off.iter().all(|off| off.abs() < 0.008), "{result:#}");
            assert!(result["lost_at"].is_null(), "{result:#}");
            continue;
        }
        assert_eq!(code, 6, "{result:#}");
        assert!(off[..2].iter().any(|off| off.abs() > 1.0), "{result:#}");
        for off in &off[..2] {
            // 2 * 5 steps of 0.005 mm; friction holds the slide off by a part of a step.
            let turns = (off / 0.05).round();
            assert!((off - turns * 0.05).abs() < 0.008, "{result:#}");
        }
        assert!(
            result["lost_at"]["line"].as_u64().unwrap() > 0,
            "{result:#}"
        );
    }
}

/// A drawing above the limit of 512 MiB is refused by its size, with less memory than the limit. A
/// large one below it that is no drawing is refused after it is read. Both files are sparse.
#[test]
fn large_drawings_are_refused_or_read_to_their_end() {
    let folder = Folder::new("large");
    for (name, bytes, memory_kib, why) in [
        ("huge.dxf", 600_u64 << 30, 300_000, "larger than 512 MiB"),
        ("zeros.dxf", 300 << 20, 800_000, "is not a group code"),
    ] {
        let file = std::fs::File::create(folder.0.join(name)).unwrap();
        file.set_len(bytes).unwrap();
        let ran = Command::new("sh")
            .args(["-c", "ulimit -v $0; exec \"$1\" engrave \"$2\" -o out.ngc"])
            .arg(memory_kib.to_string())
            .args([env!("CARGO_BIN_EXE_haptimill"), name])
            .current_dir(&folder.0)
            .output()
            .unwrap();
        let text = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(ran.status.code(), Some(3), "{name}: {text}");
        assert!(text.contains(name) && text.contains(why), "{name}: {text}");
        assert!(text.len() < 400, "{name}: {text}");
    }
    assert!(!folder.0.join("out.ngc").exists());
}

/// A drawing outside of the plate, and a damaged one: refused with line, entity and remedy, and no
/// program is written.
#[test]
fn bad_drawings_are_refused_before_anything_is_written() {
    let folder = Folder::new("bad");
    let plate = plate();
    let (code, result) = folder.run(&[&plate, "--at", "80,0", "-o", "out.ngc"]);
    assert_eq!(code, 4, "{result:#}");
    let problem = &result["problems"][0];
    assert!(
        problem["message"]
            .as_str()
            .unwrap()
            .contains("LWPOLYLINE handle 22 on layer FRAME")
    );
    assert!(problem["remedy"].as_str().unwrap().contains("--origin"));
    // In metres the pocket is not planned: it would take hours.
    let metres = [
        "--unit",
        "1000",
        "--operation",
        "pocket",
        "--layer",
        "PICTURE",
    ];
    let (code, result) = folder.run(&[&[&*plate, "-o", "out.ngc"], &metres[..]].concat());
    assert_eq!(code, 4, "{result:#}");
    let text = std::fs::read_to_string(&plate).unwrap();
    folder.write("cut.dxf", &text[..text.len() / 2]);
    let (code, result) = folder.run(&["cut.dxf", "-o", "out.ngc"]);
    assert_eq!(code, 3, "{result:#}");
    assert!(
        result["error"].as_str().unwrap().contains("truncated"),
        "{result:#}"
    );
    assert!(result["problems"][0]["line"].as_u64().unwrap() > 0);
    folder.write(
        "text.svg",
        "<svg xmlns='http://www.w3.org/2000/svg' width='9mm' height='9mm'>\n<text>AB</text></svg>",
    );
    let (code, result) = folder.run(&["text.svg", "-o", "out.ngc"]);
    assert_eq!(code, 3, "{result:#}");
    assert!(
        result["error"].as_str().unwrap().contains("'AB' is text"),
        "{result:#}"
    );
    assert!(!folder.0.join("out.ngc").exists());
}

/// Levels that the travel of z does not have, and negative numbers, are refused with the option,
/// and nothing is written.
#[test]
fn wrong_depths_and_heights_are_refused() {
    let folder = Folder::new("levels");
    for (option, code, text) in [
        (
            ["--depth", "6"],
            4,
            "--depth 6: Z-6 is outside of the travel",
        ),
        (
            ["--lift", "30"],
            4,
            "--lift 30: Z30 is outside of the travel",
        ),
        (["--depth", "-1"], 2, "depth"),
        (["--tool", "-1"], 2, "tool"),
        (["--lift", "-1"], 2, "--lift -1: it must be above 0"),
    ] {
        let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
            .args(["engrave", &plate(), "--skip-text", "-o", "part.ngc"])
            .args(option)
            .current_dir(&folder.0)
            .output()
            .unwrap();
        let err = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(ran.status.code(), Some(code), "{option:?}: {err}");
        assert!(err.contains(text), "{option:?}: {err}");
        assert!(!err.contains("unexpected argument"), "{err}");
        assert!(!folder.0.join("part.ngc").exists(), "{option:?}");
    }
}

/// An option that the job would ignore is refused by name; tabs that do not fit are a notice.
#[test]
fn options_that_do_nothing_are_refused() {
    let folder = Folder::new("ignored");
    let plate = plate();
    let drill = ["--operation", "drill", "--layer", "HOLES"];
    let pocket = ["--operation", "pocket", "--layer", "PICTURE"];
    let cases: [(&[&str], &[&str], &str); 10] = [
        (
            &[],
            &["--clear", "zigzag"],
            "--clear is for --operation pocket",
        ),
        (
            &[],
            &["--overlap", "0.4"],
            "--overlap is for --operation pocket",
        ),
        (
            &[],
            &["--angle", "45"],
            "--angle needs --operation pocket and --clear",
        ),
        (
            &pocket,
            &["--angle", "45"],
            "--angle needs --operation pocket and --clear",
        ),
        (
            &[],
            &["--finish", "0.2"],
            "--finish needs --operation pocket, or --side",
        ),
        (
            &[],
            &["--conventional"],
            "--conventional needs --operation pocket, or --side",
        ),
        (
            &drill,
            &["--ramp", "5"],
            "--ramp is for --operation outline or pocket",
        ),
        (
            &drill,
            &["--finish", "0.2"],
            "--finish needs --operation pocket, or --side",
        ),
        (
            &[],
            &["--tab-width", "3"],
            "--tab-width and --tab-height need --tabs",
        ),
        (
            &pocket,
            &["--tabs", "4"],
            "--tabs is for --operation outline",
        ),
    ];
    for (job, ignored, expected) in cases {
        let command = [&[plate.as_str()][..], job, ignored].concat();
        let (code, result) = folder.run(&command);
        assert_eq!(code, 2, "{command:?}: {result}");
        let text = result.to_string();
        assert!(text.contains(expected), "{command:?}: {text}");
    }
    assert!(!folder.0.join("plate.ngc").exists());
    let frame = [&plate, "--layer", "FRAME", "--side", "outside", "--tabs"];
    let notices = |count| {
        let (code, result) = folder.run(&[&frame[..], &[count]].concat());
        assert_eq!(code, 0, "{result}");
        result["notices"].to_string()
    };
    assert!(!notices("4").contains("tabs"), "{}", notices("4"));
    let many = notices("400");
    assert!(
        many.contains("cut through without tabs: 400 tabs"),
        "{many}"
    );
    assert!(many.contains("use fewer or narrower tabs"), "{many}");
}
