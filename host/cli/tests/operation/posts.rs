//! The post-processors of `posts/`, and the programs that they wrote.

use crate::scene::{TestFolder, haptimill, number, root};
use std::process::Command;

/// The output of a program on the part of a post-processor; none where it is not installed.
fn output_of(program: &str, part: &str) -> Option<String> {
    let Ok(output) = Command::new(program).arg(root().join(part)).output() else {
        eprintln!("{program} is not installed: {part} was not run");
        return None;
    };
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{part}: {errors}");
    Some(String::from_utf8(output.stdout).unwrap())
}

/// Checks that the example is what the post-processor writes, and that the mill runs it.
#[track_caller]
fn expect_run(example: &str, written: Option<String>, moves_mm: std::ops::Range<f64>) {
    let path = format!("examples/{example}");
    let text = std::fs::read_to_string(root().join(&path)).unwrap();
    if let Some(written) = written {
        assert_eq!(written, text, "write {path} again with its post-processor");
    }
    let folder = TestFolder::new();
    let machine = ["--machine", "machines/mill3-servo.toml", "--json"];
    let out = folder.path("out");
    let ran = haptimill(&[&["run", &path, "--out", &out], &machine[..]].concat());
    let summary = ran.expect_code(0).json();
    assert_eq!(summary["completed"], true, "{summary:#}");
    assert!(
        moves_mm.contains(&number(&summary, "path_length_mm")),
        "{summary:#}"
    );
}

#[test]
fn freecad_programs_run_unedited() {
    let written = output_of("python3", "posts/tests/freecad_part.py");
    expect_run("freecad-plate.ngc", written, 600.0..2000.0);
}

#[test]
fn fusion_programs_run_unedited() {
    let written = output_of("node", "posts/tests/fusion_part.js");
    expect_run("fusion-cover.ngc", written, 600.0..2500.0);
}
