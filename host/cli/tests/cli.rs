//! The command line: help, exit codes, machine files, kinematics tables, ports.

mod scene;

use haptimill_kinematics::descriptor::AxisKind;
use haptimill_machine_file::MachineFile;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Exit code and output of a command.
struct RunResult {
    code: i32,
    out: String,
    err: String,
}

/// Runs the command in the root of the workspace.
fn haptimill(arguments: &[&str], input: &str) -> RunResult {
    let mut child = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(arguments)
        .current_dir(root())
        .env("COLUMNS", "120")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A command that does not read standard input closes it.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let output = child.wait_with_output().unwrap();
    RunResult {
        code: output.status.code().unwrap(),
        out: String::from_utf8(output.stdout).unwrap(),
        err: String::from_utf8(output.stderr).unwrap(),
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// The command, its output and its exit code as one text.
fn transcript(arguments: &[&str], input: &str) -> String {
    let ran = haptimill(arguments, input);
    let mut text = format!("$ haptimill {}\n{}", arguments.join(" "), ran.out);
    if !ran.err.is_empty() {
        text.push_str("--- standard error\n");
        text.push_str(&ran.err);
    }
    text.push_str(&format!("--- exit code {}\n", ran.code));
    text
}

/// A golden table as rows of cells, with its column names.
fn table(text: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names = reader
        .headers()
        .unwrap()
        .iter()
        .map(str::to_string)
        .collect();
    let rows = reader.records();
    let rows = rows.map(|row| row.unwrap().iter().map(str::to_string).collect());
    (names, rows.collect())
}

fn golden(name: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let path = root().join("tests/golden").join(name);
    table(&std::fs::read_to_string(path).unwrap())
}

#[test]
fn help_names_every_command() {
    let ran = haptimill(&["--help"], "");
    assert_eq!(ran.code, 0);
    for part in [
        "Examples:",
        "Exit codes:",
        "sim serve",
        "machine init",
        "machine check",
        "machine keys",
        "machine migrate",
        "kin ik",
        "--port",
    ] {
        assert!(ran.out.contains(part), "no {part} in\n{}", ran.out);
    }
    let first = ran.out.lines().next().unwrap_or_default();
    assert!(!first.contains("H-4"), "{first}");
    for command in [
        "run", "jog", "home", "console", "teleop", "status", "enable", "disable", "stop", "reset",
        "scenario", "force", "sim", "machine", "ports", "flash", "trace", "replay", "kin",
        "offset", "preview",
    ] {
        let ran = haptimill(&[command, "--help"], "");
        assert_eq!(ran.code, 0, "{command}");
        assert!(ran.out.contains("Usage: haptimill"), "{}", ran.out);
    }
}

#[test]
fn work_offsets_are_kept_beside_the_machine_file() {
    let folder = std::env::temp_dir().join(format!("haptimill-offset-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let machine = folder.join("mill.toml");
    let machine = machine.to_str().unwrap();
    std::fs::write(machine, include_str!("../../../machines/h4.toml")).unwrap();
    let set = |values: &[&str]| {
        let mut arguments = vec!["offset", "set"];
        arguments.extend(values);
        arguments.extend(["--machine", machine]);
        haptimill(&arguments, "")
    };
    let ran = set(&["g54", "x=10", "z=21.232"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let ran = set(&["g55", "c=1"]);
    assert_eq!(ran.code, 2);
    assert!(
        ran.err.contains("no such axis; it has x, y, z, b, a"),
        "{}",
        ran.err
    );
    let ran = haptimill(&["offset", "show", "--machine", machine], "");
    assert!(ran.out.contains("G54   x=10 y=0 z=21.232"), "{}", ran.out);

    // The program is in the coordinates of G54; G53 is in those of the machine.
    let program = folder.join("part.ngc");
    std::fs::write(&program, "G54 G0 X0 Z0\nM8\nG53 G0 X0\nM2\n").unwrap();
    let program = program.to_str().unwrap();
    let check = |more: &[&str]| {
        let mut arguments = vec!["run", program, "--check", "--machine", machine];
        arguments.extend(more);
        haptimill(&arguments, "")
    };
    let ran = check(&[]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(
        ran.out.contains("2 blocks") && ran.out.contains("20.0 mm"),
        "{}",
        ran.out
    );
    assert!(
        ran.out
            .contains("part.ngc:2:1: notice: this machine has no coolant"),
        "{}",
        ran.out
    );
    let ran = check(&["--strict"]);
    assert_eq!(ran.code, 3);
    assert!(
        ran.err
            .contains("part.ngc:2:1: this machine has no coolant"),
        "{}",
        ran.err
    );

    std::fs::write(folder.join("mill.offsets.toml"), "[g54]\nx = \"1\"\n").unwrap();
    let ran = check(&[]);
    assert_eq!(ran.code, 3);
    assert!(
        ran.err
            .contains("mill.offsets.toml: [g54] x is not a number"),
        "{}",
        ran.err
    );
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_preview_is_one_page_with_the_extremes_of_the_joints() {
    let folder = std::env::temp_dir().join(format!("haptimill-preview-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let page = folder.join("pocket.html");
    let page = page.to_str().unwrap();
    let ran = haptimill(&["preview", "examples/e9-pocket.ngc", "--out", page], "");
    assert_eq!((ran.code, ran.out.trim()), (0, page), "{}", ran.err);
    let text = std::fs::read_to_string(page).unwrap();
    for part in [
        "at feed",
        "rapid moves",
        "feed, mm/min",
        "l1",
        "nearest to an end",
    ] {
        assert!(text.contains(part), "{part}");
    }
    // A program that the machine cannot run has no page.
    let program = folder.join("far.ngc");
    std::fs::write(&program, "G0 X9999\n").unwrap();
    let page = folder.join("far.html");
    let arguments = [
        "preview",
        program.to_str().unwrap(),
        "--out",
        page.to_str().unwrap(),
    ];
    let ran = haptimill(&arguments, "");
    assert_eq!(ran.code, 4, "{}", ran.err);
    assert!(ran.err.contains("far.ngc:1:4: X9999"), "{}", ran.err);
    assert!(!page.exists());
}

#[test]
fn every_template_passes_machine_check_and_is_not_overwritten() {
    let folder = std::env::temp_dir().join(format!("haptimill-init-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for template in [
        "mill3",
        "mill3-servo",
        "mill4",
        "router3",
        "trunnion5",
        "h4",
        "h4-step",
        "haptic-arm",
    ] {
        let path = folder.join(format!("{template}.toml"));
        let file = path.to_str().unwrap();
        let init = [
            "machine",
            "init",
            "mill-7",
            "--template",
            template,
            "--out",
            file,
        ];
        let ran = haptimill(&init, "");
        assert_eq!(ran.code, 0, "{template}: {}", ran.err);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\nname = \"mill-7\"\n"), "{template}");
        let ran = haptimill(&["machine", "check", file], "");
        assert_eq!(ran.code, 0, "{template}: {}", ran.err);
        assert!(ran.out.contains("mill-7"), "{template}: {}", ran.out);
        let ran = haptimill(&init, "");
        assert_eq!(ran.code, 2, "{template}");
        assert!(ran.err.contains("not overwritten"), "{}", ran.err);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text, "{template}");
    }
    for name in ["", "two words", "a/b", &"n".repeat(200)] {
        let path = folder.join("none.toml");
        let ran = haptimill(
            &["machine", "init", name, "--out", path.to_str().unwrap()],
            "",
        );
        assert_eq!(ran.code, 2, "{name:?}: {}", ran.err);
        assert!(!path.exists(), "{name:?}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn invalid_command_lines_end_with_2() {
    for arguments in [
        &["fly"][..],
        &["run"],
        &["run", "a.ngc", "--port", "tcp:nowhere"],
        &["run", "a.ngc", "--override", "0"],
        &["home"],
        &["jog", "x5", "--port", "p"],
        &["jog", "x=nan", "--port", "p"],
        &["jog", "x=5", "--for", "-1", "--port", "p"],
        &["status", "--port", "p", "--baud", "3"],
        &["sim", "serve", "--listen", "udp:1"],
        // Names of earlier versions.
        &["run", "a.ngc", "--work", "b.toml"],
        &["run", "a.ngc", "--go-on"],
        &["run", "a.ngc", "--force", "x", "--fd", "5"],
        &["teleop", "--hand", "sim"],
        &["sim", "serve", "--person", "a.toml"],
        &["machine", "init"],
        &["machine", "init", "m", "--template", "none"],
    ] {
        let ran = haptimill(arguments, "");
        assert_eq!(ran.code, 2, "{arguments:?}\n{}", ran.err);
        assert!(ran.err.contains("error:"), "{}", ran.err);
    }
}

#[test]
fn machine_check_lists_problems() {
    let mut text = transcript(&["machine", "check", "machines/h4.toml"], "");
    text += &transcript(&["machine", "check", "machines/h4-step.toml", "--json"], "");
    text += &transcript(&["machine", "check", "machines/there-is-none.toml"], "");
    text += &transcript(&["kin", "ik", "--machine", "Cargo.toml"], "");
    insta::assert_snapshot!("machine_check", text);
}

#[test]
fn forward_kinematics_match_the_golden_table() {
    let (names, rows) = golden("h4_ik.csv");
    let ran = haptimill(
        &["kin", "ik", "--strokes", "--in", "tests/golden/h4_ik.csv"],
        "",
    );
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    let (header, results) = table(&ran.out);
    let columns = [
        "l1_mm",
        "l2_mm",
        "l3_mm",
        "l4_mm",
        "alpha_deg",
        "singularity_mm",
        "status",
    ];
    assert_eq!(header, columns);
    assert_eq!(results.len(), rows.len());
    // Ends of the strokes of machines/h4.toml.
    let ends = [
        (885.0, 1385.0),
        (235.0, 735.0),
        (885.0, 1385.0),
        (235.0, 735.0),
    ];
    let (mut inside, mut outside) = (0, 0);
    for (row, result) in rows.iter().zip(&results) {
        let alpha: f64 = row[4].parse().unwrap();
        let mut in_stroke = alpha.abs() <= 45.0;
        for slide in 0..4 {
            let column = names
                .iter()
                .position(|name| *name == header[slide])
                .unwrap();
            let commanded: f64 = row[column].parse().unwrap();
            let given: f64 = result[slide].parse().unwrap();
            assert!((commanded - given).abs() < 1e-4, "{row:?} gave {result:?}");
            assert_eq!(result[slide].split_once('.').unwrap().1.len(), 9);
            in_stroke &= commanded >= ends[slide].0 && commanded <= ends[slide].1;
        }
        let status = if in_stroke { "ok" } else { "out_of_stroke" };
        assert_eq!(result[6], status, "{row:?} gave {result:?}");
        // The rotary joint is the coordinate: the resolution is 84 ndeg.
        let turned: f64 = result[4].parse().unwrap();
        assert!((alpha - turned).abs() < 1e-7, "{row:?} gave {result:?}");
        let distance: f64 = result[5].parse().unwrap();
        assert!(distance > 0.0, "{row:?} gave {result:?}");
        *(if in_stroke { &mut inside } else { &mut outside }) += 1;
    }
    assert!(
        inside > 1000 && outside > 100,
        "{inside} inside, {outside} outside"
    );
}

#[test]
fn unreachable_poses_have_no_joint_positions() {
    let ran = haptimill(
        &["kin", "ik", "--in", "tests/golden/h4_unreachable.csv"],
        "",
    );
    let (_, results) = table(&ran.out);
    assert_eq!(results.len(), 200);
    for result in results {
        assert_eq!(result[..5], ["", "", "", "", ""]);
        assert_eq!(result[6], "unreachable");
    }
}

/// A simulated machine with rods half a millimetre longer is used, with a warning; one with rods
/// 40 mm longer is refused by every command.
#[test]
fn a_simulated_machine_that_differs_is_reported() {
    let folder = scene::TestFolder::new();
    let with_rods = |length: &str| {
        let text = haptimill_machine_file::BUILT_IN;
        let (controller, plant) = text.split_once("[plant]").unwrap();
        let plant = plant.replacen("r = 480.0", &format!("r = {length}"), 1);
        folder.file("rods.toml", format!("{controller}[plant]{plant}"))
    };
    let file = with_rods("480.5");
    for arguments in [
        &["machine", "check", &file][..],
        &["machine", "check", &file, "--json"],
    ] {
        let ran = haptimill(arguments, "");
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(
            ran.err.contains("warning: the simulated machine: "),
            "{}",
            ran.err
        );
        assert!(ran.err.contains("theta = "), "{}", ran.err);
    }
    let file = with_rods("520.0");
    for arguments in [
        &["machine", "check", &file][..],
        &[
            "run",
            "examples/e11-circle.ngc",
            "--check",
            "--machine",
            &file,
        ],
    ] {
        let ran = haptimill(arguments, "");
        assert_eq!(ran.code, 3, "{}", ran.err);
        assert!(
            ran.err.contains("the simulated machine is another one"),
            "{}",
            ran.err
        );
    }
}

#[test]
fn inverse_kinematics_match_the_golden_table() {
    // The golden poses are in the frame of the base; machines/h4.toml has the origin of the work at
    // p + x_off = 810 mm along x, and at h = 600 mm below along z.
    let (_, rows) = golden("h4_fk.csv");
    let folder = scene::TestFolder::new();
    let mut joints = String::from("alpha_deg,l1_mm,l2_mm,l3_mm,l4_mm\n");
    for row in &rows {
        joints.push_str(&format!("0,{}\n", row[..4].join(",")));
    }
    let joints = folder.file("joints.csv", joints);
    let ran = haptimill(&["kin", "fk", "--in", &joints], "");
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    let (header, results) = table(&ran.out);
    let columns = [
        "x_mm",
        "y_mm",
        "z_mm",
        "theta_deg",
        "alpha_deg",
        "singularity_mm",
        "status",
    ];
    assert_eq!(header, columns);
    assert_eq!(results.len(), rows.len());
    for (row, result) in rows.iter().zip(&results) {
        assert_eq!(result[6], "ok", "{row:?}");
        for (column, offset) in [810.0, 0.0, -600.0, 0.0].into_iter().enumerate() {
            let commanded: f64 = row[4 + column].parse().unwrap();
            let value = offset + result[column].parse::<f64>().unwrap();
            // 0.1 um; 1 urad is 5.7e-5 degrees.
            let bound = if column < 3 { 1e-4 } else { 5.7e-5 };
            assert!((commanded - value).abs() < bound, "{row:?} gave {result:?}");
        }
    }
}

/// Tables of every whole machine: forward kinematics of the joints of a grid of poses give the
/// poses, under the names of the descriptor.
#[test]
fn tables_of_every_machine_invert_each_other() {
    let folder = scene::TestFolder::new();
    for descriptor in haptimill_kinematics::DESCRIPTORS {
        let file = machine_of(descriptor.code);
        let machine = MachineFile::load(&root().join(&file)).unwrap();
        let mut arguments = vec!["kin".to_string(), "ik".to_string(), "--strokes".to_string()];
        arguments.extend(["--machine".to_string(), file.clone()]);
        // A hundred poses or more: the strokes leave out the corners of the grid.
        let axes = descriptor.pose.len() as u32;
        let levels = (4_usize..).find(|levels| levels.pow(axes) >= 100).unwrap();
        for axis in &machine.pose {
            // A coordinate that wraps around has no limits.
            let (low, high) = match axis.low.is_finite() {
                true => (axis.low, axis.high),
                false => (-150.0, 150.0),
            };
            let step = (high - low) / (levels - 1) as f64;
            arguments.push("--grid".to_string());
            arguments.push(format!("{}={low}:{high}:{step}", axis.name));
        }
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let ran = haptimill(&arguments, "");
        assert_eq!((ran.code, ran.err.as_str()), (0, ""), "{file}");
        let (header, results) = table(&ran.out);
        let axes = descriptor.pose.len();
        assert_eq!(results.len(), levels.pow(axes as u32), "{file}");
        let singular = usize::from(header.contains(&"singularity_mm".to_string()));
        assert_eq!(header.len(), 2 * axes + singular + 1, "{file}: {header:?}");
        let reached: Vec<_> = results
            .iter()
            .filter(|row| row.last().is_some_and(|status| status == "ok"))
            .collect();
        assert!(reached.len() > 20, "{file}: {} poses", reached.len());
        let unit = |kind| match kind {
            AxisKind::Linear => "mm",
            AxisKind::Rotary | AxisKind::MultiTurn => "deg",
        };
        let joints = descriptor.joints.iter();
        let names: Vec<_> = joints
            .map(|joint| format!("{}_{}", joint.name, unit(joint.kind)))
            .collect();
        let mut text = names.join(",") + "\n";
        for row in &reached {
            text.push_str(&(row[axes..2 * axes].join(",") + "\n"));
        }
        let joints = folder.file("joints.csv", text);
        let ran = haptimill(&["kin", "fk", "--machine", &file, "--in", &joints], "");
        assert_eq!((ran.code, ran.err.as_str()), (0, ""), "{file}");
        let (header, poses) = table(&ran.out);
        for (index, axis) in descriptor.pose.iter().enumerate() {
            assert_eq!(header[index], format!("{}_{}", axis.name, unit(axis.kind)));
        }
        for (row, pose) in reached.iter().zip(&poses) {
            assert_eq!(pose.last().unwrap(), "ok", "{file}: {row:?}");
            for index in 0..axes {
                let commanded: f64 = row[index].parse().unwrap();
                let value: f64 = pose[index].parse().unwrap();
                // 1 um and 60 urad: the joints have the resolution of the controller.
                let bound = if descriptor.pose[index].kind == AxisKind::Linear {
                    1e-3
                } else {
                    3.4e-3
                };
                assert!(
                    (commanded - value).abs() < bound,
                    "{file}: {row:?} {pose:?}"
                );
            }
        }
    }
}

/// The first file of `machines/` of a model.
fn machine_of(model: &str) -> String {
    let mut files: Vec<PathBuf> = std::fs::read_dir(root().join("machines"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let found = files.iter().find(|path| {
        let text = std::fs::read_to_string(path).unwrap();
        text.contains(&format!("\nmodel = \"{model}\"\n"))
    });
    let found = found.unwrap_or_else(|| panic!("no machine file of the model {model}"));
    format!("machines/{}", found.file_name().unwrap().to_str().unwrap())
}

#[test]
fn invalid_grids_name_the_axis() {
    let mut text = transcript(
        &["kin", "ik", "--grid", "x=-10:10:10", "--grid", "b=0:1:1"],
        "",
    );
    for grid in ["x=1", "x=5:1:1", "x=0:1:0", "x=0:inf:1", "x=0:a:1"] {
        text += &transcript(&["kin", "ik", "--grid", grid], "");
    }
    text += &transcript(
        &["kin", "fk", "--grid", "l1=0:1:1", "--grid", "l1=0:1:1"],
        "",
    );
    text += &transcript(&["kin", "fk", "--grid", "l1=0:1:1e-9"], "");
    text += &transcript(
        &[
            "kin",
            "ik",
            "--grid",
            "x=-10:10:10",
            "--grid",
            "theta=0:6:3",
        ],
        "",
    );
    insta::assert_snapshot!("kin_grid", text);
}

#[test]
fn invalid_tables_report_line_and_column() {
    let ik = |input: &str| transcript(&["kin", "ik"], input);
    let header = "x_mm,y_mm,z_mm,theta_deg,alpha_deg\n";
    let mut text = ik(&format!(
        "{header}0,0,21.232,0,0\n10,-5,40,10,0\n10,-5,40,0,15\n"
    ));
    text += &ik(&format!(
        "{header}0,0,21.232,95,0\n0,0,9999,0,0\n0,0,21.232,0,200\n0,0,21.232,0,50\n"
    ));
    text += &ik(&format!("{header}0,0,x,0,0\n0,0,inf,0\n1,2,3,4,5\n"));
    text += &ik(&format!("{header}0,0,21,232,0,0\n1,0,2,5,40,0,1,0,0,0\n"));
    text += &ik("x_mm,y_mm,z_mm,theta_deg\n0,0,0,0\n");
    text += &ik("x_mm,y_mm,z_mm,theta_deg,alpha_deg,note,note,x_mm\n0,0,0,0,0,,,1\n");
    text += &ik("");
    text +=
        &ik("alpha_deg, theta_deg, z_mm, y_mm, x_mm, note\r\n15, 0, 40, -5, 10, turned round\r\n");
    text += &transcript(
        &["kin", "ik", "--strokes"],
        &format!(
            "{header}0,0,21.232,0,50\n0,0,21.232,0,-180\n0,0,21.232,0,180\n0,0,21.232,0,3600\n"
        ),
    );
    let fk = |input: &str| transcript(&["kin", "fk"], input);
    text += &fk(
        "l1_mm,l2_mm,l3_mm,l4_mm,alpha_deg\n1135,485,1135,485,0\n1120,480,1110,470,10\n1135,485,1135,9485,0\n1135,1135,485,485,0\n",
    );
    text += &transcript(&["kin", "fk", "--in", "there-is-none.csv"], "");
    text += &transcript(
        &["kin", "fk", "--out", "/there/is/none.csv"],
        "l1_mm,l2_mm,l3_mm,l4_mm,alpha_deg\n",
    );
    insta::assert_snapshot!("kin", text);
}

#[test]
fn input_table_is_not_overwritten() {
    let folder = scene::TestFolder::new();
    let slides = "l1_mm,l2_mm,l3_mm,l4_mm,alpha_deg\n1135,485,1135,485,0\n";
    let table = folder.file("b.csv", slides);
    let other = folder.path("./b.csv");
    for arguments in [
        ["kin", "fk", "--in", &table, "--out", &table],
        ["kin", "ik", "--in", &table, "--out", &other],
    ] {
        let ran = haptimill(&arguments, "");
        assert!(
            ran.code == 2 && ran.err.contains("would be overwritten"),
            "{}",
            ran.err
        );
        assert_eq!(folder.read("b.csv"), slides);
    }
    let ran = haptimill(
        &["kin", "fk", "--in", &table, "--out", &folder.path("c.csv")],
        "",
    );
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(folder.read("c.csv").ends_with(",ok\n"));
}

#[test]
fn ports_list_the_simulator() {
    let ran = haptimill(&["ports", "--json"], "");
    assert_eq!(ran.code, 0, "{}", ran.err);
    let list: Vec<serde_json::Value> = serde_json::from_str(&ran.out).unwrap();
    assert!(list.iter().any(|row| row["port"] == "sim"));
    assert!(haptimill(&["ports"], "").out.contains("sim serve"));
}
