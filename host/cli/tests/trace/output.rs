//! Info, plots and exports of recordings, and their errors.

use super::record;
use crate::scene::{self, RunResult, TestFolder, haptimill};
use std::path::Path;
#[cfg(unix)]
use std::process::{Command, Stdio};

/// Replaces numbers and folder names in the output.
fn plain(folder: &TestFolder, ran: &RunResult) -> String {
    let text = folder.redact(&format!("{}{}", ran.out, ran.err));
    let mut plain = String::new();
    for line in text.lines() {
        let words: Vec<String> = line.split(' ').map(masked).collect();
        plain += words.join(" ").trim_end();
        plain.push('\n');
    }
    format!("{plain}--- exit code {}\n", ran.code)
}

/// Replaces the number in a word that is no name.
fn masked(word: &str) -> String {
    let hexadecimal = word.len() >= 8 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    let number = word.starts_with(|first: char| first.is_ascii_digit() || first == '-');
    match word {
        _ if hexadecimal => "HEX".to_string(),
        _ if number && word.bytes().any(|byte| byte.is_ascii_digit()) => {
            let rest = word.trim_start_matches(|c: char| c.is_ascii_digit() || "-.:".contains(c));
            format!("#{rest}")
        }
        _ => word.to_string(),
    }
}

#[test]
fn recording_info_and_plot() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    let info = haptimill(&["trace", "info", &trace]).expect_code(0);
    insta::assert_snapshot!("info", plain(&folder, &info));

    let plot = |more: &[&str]| haptimill(&[&["trace", "plot", &trace], more].concat());
    let sketch = plot(&["x_programmed_mm", "spindle_rpm"]).expect_code(0).out;
    let lines: Vec<&str> = sketch.lines().collect();
    assert_eq!(lines.len(), 18, "{sketch}");
    assert!(
        lines[0].starts_with("x_programmed_mm: -30.0") && lines[9].starts_with("spindle_rpm: "),
        "{sketch}"
    );
    // The curve goes from the start height to the end of the slot and back, so the first and the
    // last row have dots.
    let braille = |line: &str| line.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c));
    assert!(lines[1..9].iter().all(|line| braille(line)), "{sketch}");

    // The vertical axis has the values of the first row; the dotted line at zero has a dot in every
    // second character.
    let x: Vec<&str> = lines[0].split([' ', ',']).collect();
    assert!(
        lines[8].starts_with(x[1]) && lines[8].contains(" │"),
        "{sketch}"
    );
    assert!(lines[1].trim_start().starts_with(x[3]), "{sketch}");
    let error = plot(&["l1_joint_error_mm"]).expect_code(0).out;
    let zero = error.lines().find(|line| line.starts_with("      0 │"));
    let zero = zero.unwrap_or_else(|| panic!("no zero line: {error}"));
    let dots = zero.chars().filter(|c| braille(&c.to_string())).count();
    assert!(dots > 30, "{error}");

    let picture = folder.path("errors.svg");
    plot(&[
        "l?_joint_error_mm",
        "l1_drive_n",
        "--from",
        "2",
        "--to",
        "5",
        "--out",
        &picture,
    ])
    .expect_code(0);
    let svg = folder.read("errors.svg");
    assert!(svg.starts_with("<svg xmlns=") && svg.trim_end().ends_with("</svg>"));
    // Two units make two charts, with four curves and one.
    assert_eq!(svg.matches("<svg ").count(), 3);
    assert_eq!(svg.matches("<path").count(), 5);
    assert!(svg.contains("l3_joint_error_mm") && svg.contains("time after 2 s"));
    plot(&["x_force_high_n", "--from", "1000"]).expect_code(3);
    // States have names; other columns without a unit share the chart.
    plot(&["state", "line", "--out", &picture]).expect_code(0);
    let svg = folder.read("errors.svg");
    assert_eq!(svg.matches("<svg ").count(), 3);
    assert!(
        svg.contains(">Run</text>") && !svg.contains(">1.5</text>"),
        "{svg}"
    );
}

#[test]
fn csv_has_the_selected_columns_rows_and_times() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    let whole = folder.path("whole.csv");
    haptimill(&["trace", "csv", &trace, "--every", "25", "--out", &whole]).expect_code(0);
    assert_eq!(folder.read("whole.csv"), folder.read("out/trace.csv"));
    let columns = "time_s,x_*_mm,state";
    let window = ["--from", "1", "--to", "1.01", "--every", "5"];
    let ran = haptimill(&[&["trace", "csv", &trace, "--columns", columns], &window[..]].concat())
        .expect_code(0);
    let rows: Vec<&str> = ran.out.lines().collect();
    assert_eq!(
        rows[0],
        "time_s,x_commanded_mm,x_programmed_mm,x_tool_mm,x_displacement_mm,state"
    );
    assert_eq!(rows.len(), 12, "{}", ran.out);
    assert!(
        rows[1].starts_with("1.000000,")
            && rows[11].starts_with("1.010000,")
            && rows[11].ends_with(",Run")
    );
}

#[test]
fn damaged_files_have_distinct_messages() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    let whole = std::fs::read(&trace).unwrap();
    let mut damaged = whole.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    let damaged = folder.file("damaged.hmr", damaged);
    let cut = folder.file("cut.hmr", &whole[..whole.len() * 2 / 3]);
    let foreign = folder.file("foreign.hmr", b"time_s,period,state\n0.0,0,Run\n");
    let mut old = whole.clone();
    old[8] = 2;
    let old = folder.file("old.hmr", old);
    let missing = folder.path("none.hmr");
    let mut text = String::new();
    for (arguments, code) in [
        (&["replay", &damaged][..], 3),
        (&["trace", "info", &damaged], 3),
        (&["trace", "info", &damaged, "--json"], 3),
        (&["replay", &cut], 0),
        (
            &[
                "trace",
                "csv",
                &cut,
                "--columns",
                "period",
                "--every",
                "1000000",
            ],
            0,
        ),
        (&["trace", "info", &foreign], 3),
        (&["replay", &old], 3),
        (&["trace", "mcap", &missing], 3),
        (&["replay", &missing], 3),
        (&["trace", "csv", &trace, "--from", "1000"], 3),
        (&["trace", "plot", &trace, "line", "--from", "1000"], 3),
        (&["trace", "csv", &trace, "--columns", "x_mm"], 2),
        (
            &["trace", "plot", &trace, "--from", "2", "--to", "1", "line"],
            2,
        ),
        (&["trace", "mcap", &trace, "--out", &trace], 2),
    ] {
        let ran = haptimill(arguments).expect_code(code);
        text += &format!(
            "$ haptimill {}\n{}\n",
            folder.redact(&arguments.join(" ")),
            plain(&folder, &ran)
        );
    }
    insta::assert_snapshot!("damaged_files", text);
}

/// Other paths of a file: another spelling, and links.
#[cfg(unix)]
fn names(folder: &TestFolder, path: &str) -> Vec<String> {
    let file = Path::new(path);
    let (dir, name) = (file.parent().unwrap(), file.file_name().unwrap());
    let spelled = dir.join(".").join(name).to_str().unwrap().to_string();
    let [symbolic, hard] = ["symbolic", "hard"].map(|name| folder.path(name));
    std::os::unix::fs::symlink(file, &symbolic).unwrap();
    std::fs::hard_link(file, &hard).unwrap();
    vec![path.to_string(), spelled, symbolic, hard]
}

#[cfg(unix)]
#[test]
fn input_is_never_overwritten() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    let before = std::fs::read(&trace).unwrap();
    for name in names(&folder, &trace) {
        for command in [
            &["trace", "csv", &trace, "--out", &name][..],
            &["trace", "mcap", &trace, "--out", &name],
            &["trace", "plot", &trace, "line", "--out", &name],
        ] {
            let ran = haptimill(command);
            assert!(
                ran.code == 2 && ran.err.contains("would be overwritten"),
                "{command:?} {ran:?}"
            );
            assert!(std::fs::read(&trace).unwrap() == before, "{command:?}");
        }
    }
}

#[test]
fn failed_export_keeps_the_earlier_file() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    let mut damaged = std::fs::read(&trace).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    let damaged = folder.file("damaged.hmr", damaged);
    let table = folder.file("table.csv", "before");
    haptimill(&["trace", "csv", &damaged, "--out", &table]).expect_code(3);
    haptimill(&["trace", "csv", &trace, "--from", "1000", "--out", &table]).expect_code(3);
    assert_eq!(folder.read("table.csv"), "before");
    haptimill(&["trace", "csv", &trace, "--columns", "line", "--out", &table]).expect_code(0);
    assert!(folder.read("table.csv").starts_with("line\n"));
    let files = std::fs::read_dir(folder.path("")).unwrap();
    assert_eq!(files.count(), 3, "something was left behind");
}

/// Commands with their result on standard output.
#[cfg(unix)]
fn printing_commands(trace: &str, out: &str) -> Vec<Vec<String>> {
    [
        "run examples/e7-slot.ngc --check",
        "run examples/e7-slot.ngc --check --json",
        "run examples/e7-slot.ngc --out OUT",
        "run examples/e7-slot.ngc --json --out OUT",
        "trace info TRACE",
        "trace info TRACE --json",
        "trace csv TRACE",
        "trace plot TRACE line",
        "trace diff TRACE TRACE",
        "replay TRACE",
        "replay TRACE --json",
        "machine check machines/h4.toml",
        "machine check machines/h4.toml --json",
        "scenario list",
        "ports",
        "ports --json",
        "kin ik --in tests/golden/h4_ik.csv",
    ]
    .map(|command| {
        let word = |word: &str| word.replace("TRACE", trace).replace("OUT", out);
        command.split(' ').map(word).collect()
    })
    .to_vec()
}

/// Runs a command with this standard output; returns its exit code and standard error.
#[cfg(unix)]
fn run_with_output(command: &[String], out: impl Into<Stdio>) -> (Option<i32>, String) {
    let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(command)
        .current_dir(scene::root())
        .stdout(out)
        .output()
        .unwrap();
    (ran.status.code(), String::from_utf8(ran.stderr).unwrap())
}

#[cfg(target_os = "linux")]
#[test]
fn unwritable_result_ends_with_9() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    for command in printing_commands(&trace, &folder.path("again")) {
        let full = std::fs::File::options().write(true).open("/dev/full");
        let (code, complaint) = run_with_output(&command, full.unwrap());
        assert_eq!(code, Some(9), "{command:?} {complaint}");
        let said = "standard output: No space left on device (os error 28)";
        assert!(complaint.contains(said), "{command:?} {complaint}");
    }
    let ran = haptimill(&["trace", "csv", &trace, "--out", "/dev/full"]).expect_code(9);
    assert_eq!(
        ran.err,
        "/dev/full: No space left on device (os error 28)\n"
    );
    // The first error determines the exit code.
    let missing = ["trace", "info", "none.hmr", "--json"].map(str::to_string);
    let full = std::fs::File::options().write(true).open("/dev/full");
    assert_eq!(run_with_output(&missing, full.unwrap()).0, Some(3));
}

#[cfg(unix)]
#[test]
fn closed_pipe_is_no_error() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    for command in printing_commands(&trace, &folder.path("again")) {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let (code, complaint) = run_with_output(&command, writer);
        assert_eq!(code, Some(0), "{command:?} {complaint}");
        assert!(!complaint.contains("roken pipe"), "{command:?} {complaint}");
    }
}
