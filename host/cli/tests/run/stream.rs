//! `haptimill run --stream`: programs that are checked while they run.

use crate::scene::{TestFolder, haptimill, number, start_with};
use std::process::Stdio;

/// Runs a program as a stream from a file.
fn stream(folder: &TestFolder, text: &str, code: i32) -> crate::scene::RunResult {
    let file = folder.file("stream.ngc", text);
    haptimill(&["run", &file, "--stream", "--out", &folder.path("out")]).expect_code(code)
}

/// A short program has the same motion as with a check before.
#[test]
fn a_stream_is_the_run_of_the_program() {
    let folder = TestFolder::new();
    for out in ["checked", "streamed"] {
        let path = folder.path(out);
        let run = ["run", "examples/e7-slot.ngc", "--out", &path];
        let more: &[&str] = if out == "streamed" {
            &["--stream"]
        } else {
            &[]
        };
        haptimill(&[&run, more].concat()).expect_code(0);
    }
    let [checked, streamed] =
        ["checked", "streamed"].map(|out| folder.read(&format!("{out}/trace.csv")));
    // Lines and programmed poses too.
    assert!(
        checked.contains("programmed"),
        "the trace has the programmed pose"
    );
    assert!(checked == streamed, "the traces differ");
}

/// Standard input has the same motion as a file, and loops go back in it.
#[test]
fn standard_input_is_run_with_its_loops() {
    let folder = TestFolder::new();
    let text = "G21 G90 G1 F900\n#1=0\nO1 while [#1 LT 40]\nX[#1/4] Y[#1 MOD 2]\n#1=[#1+1]\n\
                O1 endwhile\nM30\n";
    let file = folder.file("loop.ngc", text);
    haptimill(&["run", &file, "--out", &folder.path("file")]).expect_code(0);
    let input = Stdio::from(std::fs::File::open(&file).expect("it is there"));
    let run = ["run", "-", "--stream", "--out", &folder.path("input")];
    start_with(&run, input).end().expect_code(0);
    assert!(folder.read("file/trace.csv") == folder.read("input/trace.csv"));
    let refused = haptimill(&["run", "-"]).expect_code(2);
    assert!(refused.err.contains("add --stream"), "{}", refused.err);
}

/// A block that cannot be done ends the motion before it, at standstill.
#[test]
fn a_stream_stops_before_a_block_that_cannot_be_done() {
    let folder = TestFolder::new();
    let mistakes = [
        ("X500", 4, "5:1: ", "soft limits of X"),
        ("G7777", 3, "5:1: ", "G7777"),
        ("G38.2 Z0", 4, "5:", "probe"),
    ];
    for (mistake, code, place, word) in mistakes {
        let text = format!("G21 G90 F600\nG1 X4\nY3\nX6\n{mistake}\nX0 Y0\n");
        let ran = stream(&folder, &text, code);
        let error = ran.err.lines().next().unwrap_or_default().to_string();
        assert!(
            error.contains(&format!("stream.ngc:{place}")),
            "{mistake}: {error}"
        );
        assert!(error.contains(word), "{mistake}: {error}");
        assert!(error.contains("; "), "a remedy: {error}");
        let last = "the last block done is line 4";
        assert!(ran.err.contains(last), "{mistake}: {}", ran.err);
        let summary = folder.summary("out");
        assert_eq!(summary["final_state"], "Idle", "{mistake}");
        assert_eq!(summary["faults"].as_array().map(Vec::len), Some(0));
        let length = number(&summary, "path_length_mm");
        assert!((length - 9.0).abs() < 0.1, "{mistake}: {length} mm");
    }
    // Nothing moves for a mistake in the first block.
    let ran = stream(&folder, "G1 X1\n", 3);
    assert!(ran.err.contains("nothing moved"), "{}", ran.err);
}

/// The options that need the whole program are refused, and a file that is not there.
#[test]
fn a_stream_refuses_what_needs_the_whole_program() {
    let folder = TestFolder::new();
    let file = folder.file("a.ngc", "M30\n");
    for option in ["--check", "--dry", "--single", "--from-line=2"] {
        let refused = haptimill(&["run", &file, "--stream", option]).expect_code(2);
        assert!(
            refused.err.contains("cannot be used with"),
            "{}",
            refused.err
        );
    }
    let missing = folder.path("missing.ngc");
    let refused = haptimill(&["run", &missing, "--stream"]).expect_code(3);
    assert!(refused.err.contains("missing.ngc"), "{}", refused.err);
}
