//! The command line: help, exit codes, machine files, kinematics tables, ports.

mod scene;

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
        "kin ik",
        "--port",
    ] {
        assert!(ran.out.contains(part), "no {part} in\n{}", ran.out);
    }
    let first = ran.out.lines().next().unwrap_or_default();
    assert!(!first.contains("H-4"), "{first}");
    for command in [
        "run", "jog", "home", "console", "teleop", "status", "enable", "disable", "stop", "reset",
        "scenario", "force", "sim", "machine", "ports", "trace", "replay", "kin",
    ] {
        let ran = haptimill(&[command, "--help"], "");
        assert_eq!(ran.code, 0, "{command}");
        assert!(ran.out.contains("Usage: haptimill"), "{}", ran.out);
    }
}

#[test]
fn every_template_passes_machine_check_and_is_not_overwritten() {
    let folder = std::env::temp_dir().join(format!("haptimill-init-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for template in ["h4", "h4-step", "haptic-arm"] {
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
    assert_eq!(header, ["l1_mm", "l2_mm", "l3_mm", "l4_mm", "status"]);
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
        assert_eq!(result[4], status, "{row:?} gave {result:?}");
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
        assert_eq!(result[..4], ["", "", "", ""]);
        assert_eq!(result[4], "unreachable");
    }
}

#[test]
fn inverse_kinematics_match_the_golden_table() {
    let (_, rows) = golden("h4_fk.csv");
    let ran = haptimill(&["kin", "fk", "--in", "tests/golden/h4_fk.csv"], "");
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    let (header, results) = table(&ran.out);
    assert_eq!(header, ["x_mm", "y_mm", "z_mm", "theta_deg", "status"]);
    for (row, result) in rows.iter().zip(&results) {
        assert_eq!(result[4], "ok", "{row:?}");
        for column in 0..4 {
            let commanded: f64 = row[4 + column].parse().unwrap();
            let value: f64 = result[column].parse().unwrap();
            // 0.1 um; 1 urad is 5.7e-5 degrees.
            let bound = if column < 3 { 1e-4 } else { 5.7e-5 };
            assert!((commanded - value).abs() < bound, "{row:?} gave {result:?}");
        }
    }
}

#[test]
fn invalid_tables_report_line_and_column() {
    let ik = |input: &str| transcript(&["kin", "ik"], input);
    let header = "xw_mm,yw_mm,zw_mm,theta_deg,alpha_deg\n";
    let mut text = ik(&format!(
        "{header}0,0,21.232,0,0\n10,-5,40,10,0\n10,-5,40,0,15\n"
    ));
    text += &ik(&format!(
        "{header}0,0,21.232,95,0\n0,0,9999,0,0\n0,0,21.232,0,200\n0,0,21.232,0,50\n"
    ));
    text += &ik(&format!("{header}0,0,x,0,0\n0,0,inf,0\n1,2,3,4,5\n"));
    text += &ik(&format!("{header}0,0,21,232,0,0\n1,0,2,5,40,0,1,0,0,0\n"));
    text += &ik("xw_mm,yw_mm,zw_mm,theta_deg\n0,0,0,0\n");
    text += &ik("xw_mm,yw_mm,zw_mm,theta_deg,alpha_deg,note,note,xw_mm\n0,0,0,0,0,,,1\n");
    text += &ik("");
    text += &ik(
        "alpha_deg, theta_deg, zw_mm, yw_mm, xw_mm, note\r\n15, 0, 40, -5, 10, turned round\r\n",
    );
    text += &transcript(
        &["kin", "ik", "--strokes"],
        &format!(
            "{header}0,0,21.232,0,50\n0,0,21.232,0,-180\n0,0,21.232,0,180\n0,0,21.232,0,3600\n"
        ),
    );
    let fk = |input: &str| transcript(&["kin", "fk"], input);
    text += &fk(
        "l1_mm,l2_mm,l3_mm,l4_mm\n1135,485,1135,485\n1120,480,1110,470\n1135,485,1135,9485\n1135,1135,485,485\n",
    );
    text += &transcript(&["kin", "fk", "--in", "there-is-none.csv"], "");
    text += &transcript(
        &["kin", "fk", "--out", "/there/is/none.csv"],
        "l1_mm,l2_mm,l3_mm,l4_mm\n",
    );
    insta::assert_snapshot!("kin", text);
}

#[test]
fn input_table_is_not_overwritten() {
    let folder = scene::TestFolder::new();
    let slides = "l1_mm,l2_mm,l3_mm,l4_mm\n1135,485,1135,485\n";
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
