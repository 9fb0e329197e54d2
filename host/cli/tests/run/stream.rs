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
        let last = "the last executed block is line 4";
        assert!(ran.err.contains(last), "{mistake}: {}", ran.err);
        let summary = folder.summary("out");
        assert_eq!(summary["final_state"], "Idle", "{mistake}");
        assert_eq!(summary["completed"], false, "{mistake}");
        assert_eq!(summary["faults"].as_array().map(Vec::len), Some(0));
        let length = number(&summary, "path_length_mm");
        assert!((length - 9.0).abs() < 0.1, "{mistake}: {length} mm");
    }
    // Nothing moves for a mistake in the first block.
    let ran = stream(&folder, "G1 X1\n", 3);
    assert!(ran.err.contains("nothing moved"), "{}", ran.err);
}

/// With --json standard output is one document: the summary with the error that ended the program.
#[test]
fn an_error_of_a_stream_is_in_its_json() {
    let folder = TestFolder::new();
    for (text, code, line, moved) in [
        ("G21 G90 F600\nG1 X4\nX500\n", 4, 3, true),
        ("G21 G90 F600\nG1 X4\nG7777\n", 3, 3, true),
        ("G1 X1\n", 3, 1, false),
    ] {
        let file = folder.file("stream.ngc", text);
        let out = folder.path("out");
        let run = ["run", &file, "--stream", "--json", "--out", &out];
        let ran = haptimill(&run).expect_code(code);
        let document = ran.json();
        assert_eq!(document["exit_code"], code, "{document:#}");
        assert_eq!(document["problems"][0]["line"], line, "{document:#}");
        let error = document["error"].as_str().expect("a text");
        assert_eq!(error, ran.err.trim_end());
        assert_eq!(error.contains("nothing moved"), !moved, "{error}");
        assert_eq!(document["completed"], false);
        assert_eq!(
            number(&document, "path_length_mm") > 3.9,
            moved,
            "{document:#}"
        );
    }
    // A program without an error has none in its summary.
    let file = folder.file("stream.ngc", "G21 G90 F600\nG1 X1\nM2\n");
    let run = [
        "run",
        &file,
        "--stream",
        "--json",
        "--out",
        &folder.path("out"),
    ];
    let document = haptimill(&run).expect_code(0).json();
    assert_eq!(document["completed"], true);
    assert!(document.get("error").is_none(), "{document:#}");
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

/// Exit code, standard error and peak memory in KiB of a command.
fn watched(arguments: &[&str]) -> (i32, String, u64) {
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0;
    while child.try_wait().expect("a status").is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok());
        peak = peak.max(kib.unwrap_or(0));
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let ended = child.wait_with_output().expect("its output");
    let error = String::from_utf8_lossy(&ended.stderr).into_owned();
    (ended.status.code().unwrap_or(-1), error, peak)
}

/// The memory of a run does not grow with its program, neither in the check nor while it moves: one
/// of 60,000 blocks, which took 80 MB more when its steps and setpoints were kept.
#[test]
fn the_memory_of_a_run_does_not_grow_with_its_program() {
    use std::fmt::Write as _;
    let folder = TestFolder::new();
    let run = |blocks: u32| {
        // Back and forth along 10 mm.
        let mut text = String::from("G21 G90 F2400\n");
        for block in 0..blocks {
            let x = f64::from((block % 2000).abs_diff(1000)) * 0.01;
            let _ = writeln!(text, "N{block} G1 X{x:.3} Y{:.3}", x * 0.5);
        }
        let file = folder.file("part.ngc", text + "M2\n");
        let out = folder.path("out");
        let arguments = [
            "run", &file, "--out", &out, "--quiet", "--record", "last=1s",
        ];
        let (code, error, peak) = watched(&arguments);
        assert_eq!(code, 0, "{error}");
        let summary = folder.summary("out");
        assert_eq!(summary["completed"], true, "{summary}");
        peak
    };
    let peaks = [run(1000), run(60_000)];
    println!("peaks {peaks:?} KiB");
    assert!(peaks[1] < peaks[0] + (20 << 10), "{peaks:?} KiB");
}

/// A program beyond 64 MiB is refused where it would be kept in memory, with the remedy; its check
/// finds the mistake in its last block in much less memory than it is long.
#[test]
fn a_program_beyond_64_mib() {
    use std::fmt::Write as _;
    let folder = TestFolder::new();
    let comment = "x".repeat(135);
    let mut text = String::from("G21 G90 F600\n");
    for block in 0..520_000 {
        let _ = writeln!(text, "G1 X{} ({comment})", block % 2);
    }
    assert!(text.len() > 65 << 20);
    let blocks = 520_002;
    let file = folder.file("long.ngc", &(text.clone() + "X1\nM2\n"));
    let kept = haptimill(&["run", &file, "--dry"]).expect_code(3);
    for part in [
        "long.ngc: it is larger than 64 MiB",
        "without --from-line, --dry",
    ] {
        assert!(kept.err.contains(part), "{}", kept.err);
    }
    let (code, error, peak) = watched(&["run", &file, "--check"]);
    assert_eq!(code, 0, "{error}");
    println!("{} MiB, peak {peak} KiB", text.len() >> 20);
    assert!(peak > 0 && peak < 32 << 10, "{peak} KiB");
    let file = folder.file("wrong.ngc", &(text + "X5000\nM2\n"));
    let (code, error, peak) = watched(&["run", &file, "--check"]);
    assert_eq!(code, 4, "{error}");
    assert!(error.contains(&format!("wrong.ngc:{blocks}:1:")), "{error}");
    assert!(peak < 32 << 10, "{peak} KiB");
}

/// Work offsets and tool tables that are damaged on disk: a run and its check name the file, what
/// is wrong, and the backup or that there is none, before anything moves.
#[test]
fn damaged_tables_are_refused_with_their_backup() {
    let folder = TestFolder::new();
    let machine = folder.machine_with("");
    let name = std::path::Path::new(&machine).file_stem();
    let name = name
        .and_then(|name| name.to_str())
        .expect("a name")
        .to_owned();
    let file = folder.file("part.ngc", "G21 G90 F600\nG1 X4\nM2\n");
    for kind in ["offsets", "tools"] {
        let table = format!("{name}.{kind}.toml");
        for (text, backup) in [
            ("[g54\nx = 1", true),
            ("[g54]\nx = nan\n[t1]\nz = nan\n", false),
        ] {
            folder.file(&table, text);
            if backup {
                folder.file(&format!("{table}.bak"), "");
            }
            for option in ["--check", "--dry"] {
                let out = folder.path("out");
                let ran = ["run", &file, option, "--machine", &machine, "--out", &out];
                let refused = haptimill(&ran).expect_code(3);
                let hint = if backup {
                    format!(
                        "restore its backup {}",
                        folder.path(&format!("{table}.bak"))
                    )
                } else {
                    "it has no backup".to_owned()
                };
                let error = &refused.err;
                assert!(error.contains(&table) && error.contains(&hint), "{error}");
                assert!(!std::path::Path::new(&out).exists(), "{kind} {option}");
            }
            let _ = std::fs::remove_file(folder.path(&format!("{table}.bak")));
        }
        std::fs::remove_file(folder.path(&table)).expect("removed");
    }
}
