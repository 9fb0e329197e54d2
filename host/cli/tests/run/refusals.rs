//! Programs, files and options that are refused before motion.

use crate::scene::{RunResult, TestFolder, haptimill, root};
use serde_json::Value;
use std::path::Path;

/// Runs a program with a mistake, checks that nothing was written, and returns the transcript.
fn refused(folder: &TestFolder, name: &str, text: impl AsRef<[u8]>, code: i32) -> String {
    let file = folder.file(name, text);
    let out = folder.path("out");
    let ran = haptimill(&["run", &file, "--out", &out]).expect_code(code);
    assert!(!Path::new(&out).exists(), "{name}: something was written");
    redacted_error(folder, name, &ran)
}

fn redacted_error(folder: &TestFolder, what: &str, ran: &RunResult) -> String {
    assert_eq!(ran.out, "", "{what}: {ran:?}");
    format!(
        "# {what}: exit code {}\n{}\n",
        ran.code,
        folder.redact(&ran.err)
    )
}

#[test]
fn program_that_leaves_the_workspace_late_is_refused_before_motion() {
    let folder = TestFolder::new();
    let mut program = String::from("G21 G90 G94 F600\n");
    for line in 2..1500 {
        program += &format!("G1 X{} Y{}\n", line % 7, line % 5);
    }
    program += "G1 X199 Y119 Z-59\nG1 X0 Y0 Z21\nM30\n";
    insta::assert_snapshot!(
        "leaves_workspace",
        refused(&folder, "late.ngc", &program, 4)
    );
    assert!(program.lines().nth(1499).unwrap().contains("Z-59"));
}

#[test]
fn program_mistakes_are_reported_by_line() {
    let folder = TestFolder::new();
    let mut text = refused(
        &folder,
        "unknown-word.ngc",
        "G21 G90\nG1 X1 F100\nG1 Q5 X2\nM98 P1\n",
        3,
    );
    text += &refused(
        &folder,
        "not-utf-8.ngc",
        b"G21 G90 (caf\xe9)\nG1 X1 F100\n\xff\xfe\n",
        3,
    );
    text += &refused(&folder, "no-feed.ngc", "G1 X5\n", 3);
    text += &refused(&folder, "binary.ngc", [0_u8, 1, 2, 3, 0, 255, 10, 0, 0], 3);
    text += &refused(
        &folder,
        "out-of-stroke.ngc",
        "G21 G90 F600\nG1 X199 Y119 Z-59\n",
        4,
    );
    insta::assert_snapshot!("program_mistakes", text);
}

/// F6000 is 100 mm/s, and the axis moves at 50 mm/s.
#[test]
fn a_feed_beyond_the_limits_is_lowered_with_a_notice() {
    let folder = TestFolder::new();
    let file = folder.file("fast.ngc", "G21 G90\nG1 X20 F100\nG1 Y20 F6000\n");
    let out = folder.path("out");
    let more: [&[&str]; 3] = [&["--check"], &["--out", &out], &["--out", &out, "--stream"]];
    for more in more {
        let ran = haptimill(&[&["run", &file], more].concat()).expect_code(0);
        let notice = "fast.ngc: notice: the limits of the machine keep 1 block below the feed";
        assert!(ran.out.contains(notice), "{}", ran.out);
    }
}

#[test]
fn unusable_files_have_distinct_messages() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let mut text = String::new();
    let mut tell = |what: &str, code: i32, arguments: &[&str]| {
        let ran = haptimill(arguments).expect_code(code);
        text += &redacted_error(&folder, what, &ran);
    };
    tell(
        "a program that is not there",
        3,
        &["run", &folder.path("none.ngc"), "--out", &out],
    );
    std::fs::create_dir(folder.path("folder.ngc")).unwrap();
    tell(
        "a folder for a program",
        3,
        &["run", &folder.path("folder.ngc"), "--out", &out],
    );
    let good = folder.file("good.ngc", "G1 X1 F100\n");
    let broken = folder.file(
        "broken.toml",
        "name = \"h4\"\nperiod_us = \"often\"\n[kinematics\n",
    );
    tell(
        "a broken machine file",
        3,
        &["run", &good, "--machine", &broken, "--out", &out],
    );
    let h4 = std::fs::read_to_string(root().join("machines/h4.toml")).unwrap();
    let wrong = folder.file(
        "wrong.toml",
        h4.replacen("a = 400.0", "a = -400.0", 1)
            .replacen("lead_mm = 10.0", "lead_mm = 0.0", 1),
    );
    tell(
        "a machine file that makes no sense",
        3,
        &["run", &good, "--machine", &wrong, "--out", &out],
    );
    tell(
        "a machine file that is not there",
        3,
        &[
            "run",
            &good,
            "--machine",
            &folder.path("none.toml"),
            "--out",
            &out,
        ],
    );
    assert!(!Path::new(&out).exists());
    // A file in place of the result folder is reported before homing, so standard output is empty.
    tell(
        "a folder that cannot be made",
        9,
        &["run", &good, "--out", &folder.file("taken", "")],
    );
    tell(
        "a fault that is none",
        2,
        &["run", &good, "--fault", "nonsense", "--out", &out],
    );
    tell(
        "a fault of an axis that is not there",
        2,
        &[
            "run",
            &good,
            "--fault",
            "joint-jammed joint=9",
            "--out",
            &out,
        ],
    );
    tell(
        "a fault on a real port",
        2,
        &[
            "run",
            &good,
            "--fault",
            "emergency-stop",
            "--port",
            "tcp:localhost:1",
            "--out",
            &out,
        ],
    );
    tell(
        "a port that is not there",
        5,
        &["run", &good, "--port", "/dev/there-is-none", "--out", &out],
    );
    insta::assert_snapshot!("unusable_files", text);
}

#[test]
fn mistakes_are_reported_as_json() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let bad = folder.file("bad.ngc", "G21 G90\nG1 X1 F100\nG1 Q5 X2\n   M98 P1\n");
    let far = folder.file("far.ngc", "G21 G90 F600\n\nG1 X1999\n");
    let wrong = folder.file("wrong.toml", "format = 2\nname = 5\n");
    for (arguments, code, places) in [
        (
            &["run", &bad, "--json", "--out", &out][..],
            3,
            &[(3, 4), (4, 4)][..],
        ),
        (&["run", &bad, "--check", "--json"], 3, &[(3, 4), (4, 4)]),
        (&["run", &far, "--json", "--out", &out], 4, &[(3, 4)]),
        (&["run", &bad, "--machine", &wrong, "--json"], 3, &[(2, 8)]),
    ] {
        let ran = haptimill(arguments).expect_code(code);
        let reported = ran.json();
        assert_eq!(reported["exit_code"], code, "{reported:#}");
        assert_eq!(
            reported["error"].as_str(),
            Some(ran.err.trim_end()),
            "{reported:#}"
        );
        let problems = reported["problems"].as_array().unwrap();
        for (line, column) in places {
            let found = problems
                .iter()
                .find(|problem| problem["line"] == *line && problem["column"] == *column)
                .unwrap_or_else(|| panic!("nothing at {line}:{column} in {reported:#}"));
            // The JSON message equals the text message.
            let words = format!(
                "{}:{line}:{column}: {}",
                found["file"].as_str().unwrap(),
                found["message"].as_str().unwrap()
            );
            assert!(ran.err.contains(&words), "{words}\n{}", ran.err);
        }
    }
    assert!(!Path::new(&out).exists());
    let missing = haptimill(&["run", "none.ngc", "--json"]).expect_code(3);
    assert_eq!(missing.json()["problems"], Value::Array(Vec::new()));
}

/// Runs a program on the board that is emulated with its pins, with this program as the emulator.
#[cfg(unix)]
fn emulated(folder: &TestFolder, emulator: &str, code: i32) -> String {
    let ran = std::process::Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .current_dir(root())
        .args([
            "run",
            "host/emulator/tests/short.ngc",
            "--port",
            "emu:pico2",
        ])
        .args(["--machine", "host/emulator/tests/mill3-short.toml"])
        .args(["--out", &folder.path("out")])
        .env("HAPTIMILL_EMULATOR", emulator)
        .env("HAPTIMILL_IMAGE", "none.uf2")
        .output()
        .expect("haptimill");
    let text = String::from_utf8_lossy(&ran.stderr).into_owned();
    assert_eq!(ran.status.code(), Some(code), "{text}");
    text
}

#[cfg(unix)]
#[test]
fn an_emulator_that_is_missing_or_fails_is_reported_with_the_remedy() {
    let folder = TestFolder::new();
    let text = emulated(&folder, &folder.path("none"), 5);
    assert!(text.contains("cargo xtask emulator --build"), "{text}");
    let text = emulated(&folder, "/bin/false", 5);
    assert!(
        text.contains("the emulator ended (exit status: 1)"),
        "{text}"
    );
    // It sends something else, and has ended.
    let text = emulated(&folder, "/bin/echo", 5);
    assert!(text.contains("emu:pico2: a frame of"), "{text}");
}

#[test]
fn options_of_emulated_boards_are_refused_elsewhere() {
    let run = ["run", "examples/e11-circle.ngc"];
    for (options, part) in [
        (&["--port", "emu:nano"][..], "emu:pico2"),
        (&["--vcd", "x.vcd"], "--vcd is for --port emu:pico2"),
        (
            &["--image", "x"],
            "--image is for --port pil:mps2 or emu:pico2",
        ),
        (
            &["--port", "emu:pico2", "--log", "x"],
            "--log is for --port pil:mps2",
        ),
        (
            &["--port", "emu:pico2", "--seed", "3"],
            "--seed is for --port sim or pil:mps2",
        ),
    ] {
        let ran = haptimill(&[&run[..], options].concat()).expect_code(2);
        assert!(ran.err.contains(part), "{options:?}: {}", ran.err);
    }
}
