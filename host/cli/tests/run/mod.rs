//! Jobs in the built-in simulator, from the part program to the result files.

use crate::scene;
mod process;
mod refusals;
mod stream;

use haptimill_trace::{RECORD_BYTES, Recording};
use scene::{TestFolder, haptimill, number, start};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// Aim for the largest tool error.
const AIM_MM: f64 = 0.005;

/// Runs a program of examples/ into `out` and returns its summary.
fn job(folder: &TestFolder, out: &str, program: &str, more: &[&str]) -> Value {
    run_file(folder, out, &format!("examples/{program}"), more)
}

fn run_file(folder: &TestFolder, out: &str, program: &str, more: &[&str]) -> Value {
    let ran = haptimill(
        &[
            &["run", program, "--json", "--out", &folder.path(out)],
            more,
        ]
        .concat(),
    )
    .expect_code(0);
    assert_eq!(ran.err, "", "{program}");
    let summary = folder.summary(out);
    assert_eq!(
        ran.json(),
        summary,
        "the summary printed is the summary written"
    );
    summary
}

/// Checks the summary of a completed job and its accuracy. The aim for the largest error is 5 um;
/// the programs that miss it have a bound of their own (docs/figures.md).
#[track_caller]
fn expect_small_errors(summary: &Value, largest_mm: f64) {
    println!(
        "{}: {:.2} s, {:.1} mm, tool {:.4} mm rms, {:.4} mm largest, slide {:.4} mm; {} setpoints of {:.1} bytes ({:.1} with all that is said besides)",
        summary["program"],
        number(summary, "duration_s"),
        number(summary, "path_length_mm"),
        number(summary, "tool_error_rms_mm"),
        number(summary, "tool_error_max_mm"),
        number(summary, "following_error_max_mm"),
        summary["setpoints"],
        number(summary, "bytes_per_setpoint"),
        number(summary, "line_bytes_per_setpoint"),
    );
    assert!(
        number(summary, "tool_error_rms_mm") <= 0.0015,
        "{summary:#}"
    );
    assert!(
        number(summary, "tool_error_max_mm") <= largest_mm,
        "{summary:#}"
    );
    // An error of exactly 0 would mean that nothing was measured.
    assert!(number(summary, "tool_error_rms_mm") > 0.0005, "{summary:#}");
    assert!(number(summary, "following_error_max_mm") > 0.0 && number(summary, "setpoints") > 10.0);
    assert_eq!(summary["underruns"], 0);
    assert_eq!(summary["faults"], Value::Array(Vec::new()));
    assert_eq!(summary["final_state"], "Idle");
    assert_eq!(summary["position_kept"], true);
    assert_eq!(summary["completed"], true);
    assert_eq!(summary["trace_sha256"].as_str().unwrap().len(), 64);
}

#[test]
fn slot_writes_all_files_bit_identically() {
    let folder = TestFolder::new();
    let first = job(&folder, "first", "e7-slot.ngc", &[]);
    expect_small_errors(&first, AIM_MM);
    // 2 mm down, 30 mm along, 4 mm up, 30 mm back, 2 mm down.
    assert!(
        (number(&first, "path_length_mm") - 68.0).abs() < 0.01,
        "{first:#}"
    );
    // 2 s at 1 mm/s, 7.5 s and 0.5 s at 4 mm/s, and the return.
    assert!(
        (10.5..13.0).contains(&number(&first, "duration_s")),
        "{first:#}"
    );

    // The recording is readable and matches the summary.
    let file = folder.path("first/recording.hmr");
    let recording = Recording::open(Path::new(&file)).unwrap();
    assert_eq!(recording.records(), first["periods"].as_u64().unwrap());
    assert_eq!(recording.cut_bytes(), 0);
    assert_eq!(recording.header().machine, "h4");
    let last = recording.iter().unwrap().last().unwrap().unwrap();
    assert!(last.has(haptimill_trace::flag::TOOL_TRUE | haptimill_trace::flag::HOMED));
    use sha2::{Digest, Sha256};
    let bytes = std::fs::read(&file).unwrap();
    assert!(bytes.len() > recording.records() as usize * RECORD_BYTES);
    let hash: String = Sha256::digest(&bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    assert_eq!(first["trace_sha256"], hash.as_str());

    // The trace has units in the column names, a row every 25 periods, and ends at the end of the
    // program.
    let text = folder.read("first/trace.csv");
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names: Vec<String> = reader
        .headers()
        .unwrap()
        .iter()
        .map(str::to_string)
        .collect();
    let column = |name: &str| {
        names
            .iter()
            .position(|known| known == name)
            .unwrap_or_else(|| panic!("no {name} in {names:?}"))
    };
    assert_eq!(column("time_s"), 0);
    let (x, l1, alpha) = (
        column("x_tool_mm"),
        column("l1_joint_error_mm"),
        column("alpha_commanded_deg"),
    );
    column("l4_drive_n");
    column("alpha_drive_n_m");
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let rows_wanted = recording.records().div_ceil(25);
    assert!(
        (rows_wanted..=rows_wanted + 1).contains(&(rows.len() as u64)),
        "{}",
        rows.len()
    );
    let value = |row: &csv::StringRecord, column: usize| row[column].parse::<f64>().unwrap();
    let min = rows
        .iter()
        .map(|row| value(row, x))
        .fold(f64::INFINITY, f64::min);
    assert!((min + 30.0).abs() < 0.05, "the slot ends at {min}");
    assert!(value(rows.last().unwrap(), x).abs() < 0.05);
    assert!(rows.iter().any(|row| value(row, l1).abs() > 1e-4));
    assert!(rows.iter().all(|row| value(row, alpha).abs() < 1e-3));

    // The report is one self-contained file.
    let page = folder.read("first/report.html");
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    for needs in [
        "<script", "src=", "href=", "url(", "@import", "http://", "https://",
    ] {
        assert!(!page.contains(needs), "the report has {needs}");
    }
    assert!(page.matches("<svg").count() >= 6 && page.contains("e7-slot.ngc"));

    let again = job(&folder, "again", "e7-slot.ngc", &[]);
    assert_eq!(again, first);
    assert_eq!(
        bytes,
        std::fs::read(folder.path("again/recording.hmr")).unwrap()
    );
    let other = job(&folder, "other", "e7-slot.ngc", &["--seed", "2"]);
    expect_small_errors(&other, 0.010);
    assert_ne!(other["trace_sha256"], first["trace_sha256"]);
}

#[test]
fn pocket_and_circle_keep_their_tolerances() {
    let folder = TestFolder::new();
    let pocket = job(&folder, "pocket", "e9-pocket.ngc", &[]);
    expect_small_errors(&pocket, AIM_MM);
    // All bytes from the host to the controller: setpoints, acknowledgements, keep-alive frames.
    assert!(
        number(&pocket, "line_bytes_per_setpoint") <= 22.5,
        "{pocket:#}"
    );
    let circle = job(&folder, "circle", "e11-circle.ngc", &[]);
    expect_small_errors(&circle, AIM_MM);
    // The columns of the trace are a circle of 30 mm.
    let text = folder.read("circle/trace.csv");
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names = reader.headers().unwrap().clone();
    let column = |name: &str| names.iter().position(|known| known == name).unwrap();
    let (x, y, line) = (column("x_tool_mm"), column("y_tool_mm"), column("line"));
    let (mut min, mut max, mut rows) = (f64::INFINITY, 0.0_f64, 0);
    for row in reader
        .records()
        .map(Result::unwrap)
        .filter(|row| &row[line] == "7")
    {
        let value = |column: usize| row[column].parse::<f64>().unwrap();
        let radius = (value(x) + 15.0).hypot(value(y));
        (min, max, rows) = (min.min(radius), max.max(radius), rows + 1);
    }
    assert!(rows > 4000, "{rows} rows on the circle");
    println!("circle: radius {min:.4} to {max:.4} mm");
    assert!(
        max - min < 0.05 && (max - 15.0).abs() < 0.03,
        "{min} to {max}"
    );
}

#[test]
fn a_circle_at_20_mm_s_keeps_its_tolerance() {
    let folder = TestFolder::new();
    let slow = std::fs::read_to_string(scene::root().join("examples/e11-circle.ngc")).unwrap();
    let fast = slow.replace("F240", "F1200");
    assert_ne!(fast, slow);
    let program = folder.file("fast.ngc", &fast);
    expect_small_errors(&run_file(&folder, "circle", &program, &[]), AIM_MM);
}

#[test]
fn dome_streams_at_115200_baud_without_underrun() {
    let folder = TestFolder::new();
    let dome = job(&folder, "dome", "dome.ngc", &["--baud", "115200"]);
    expect_small_errors(&dome, AIM_MM);
    assert!(number(&dome, "setpoints") > 2000.0);
    assert!(number(&dome, "angle_error_max_deg") < 0.05, "{dome:#}");
    assert!(number(&dome, "line_bytes_per_setpoint") <= 24.0, "{dome:#}");
}

#[test]
fn feed_and_depth_sweeps_run() {
    let folder = TestFolder::new();
    expect_small_errors(&job(&folder, "feed", "e1-feed-sweep.ngc", &[]), 0.010);
    expect_small_errors(&job(&folder, "depth", "e2-depth-sweep.ngc", &[]), 0.010);
}

#[test]
fn job_prints_a_short_summary() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let ran = haptimill(&["run", "examples/e7-slot.ngc", "--out", &out]).expect_code(0);
    insta::assert_snapshot!("run_e7", folder.redact(&ran.out));
    assert_eq!(ran.err, "");
    let quiet =
        haptimill(&["run", "examples/e7-slot.ngc", "--out", &out, "--quiet"]).expect_code(0);
    assert!(
        !quiet.out.contains("homing") && quiet.out.contains("tool error"),
        "{}",
        quiet.out
    );
    let check = haptimill(&[
        "run",
        "examples/e7-slot.ngc",
        "--out",
        &folder.path("none"),
        "--check",
    ])
    .expect_code(0);
    assert!(
        check.out.contains("68.0 mm") && !Path::new(&folder.path("none")).exists(),
        "{}",
        check.out
    );
}

#[test]
fn empty_program_completes_at_once() {
    let folder = TestFolder::new();
    for (name, text) in [
        ("empty.ngc", ""),
        ("comment.ngc", "(nothing)\n\n; nothing\n"),
        ("end.ngc", "G21 G90\nM30\n"),
    ] {
        let file = folder.file(name, text);
        let ran = haptimill(&["run", &file, "--json", "--out", &folder.path("out")]).expect_code(0);
        let summary = ran.json();
        assert_eq!(summary["final_state"], "Idle", "{name}");
        assert_eq!(number(&summary, "path_length_mm"), 0.0, "{name}");
        assert!(folder.read("out/report.html").contains("</html>"));
    }
}

#[test]
fn pauses_are_skipped_in_the_simulator_and_need_a_terminal_on_a_machine() {
    let folder = TestFolder::new();
    let file = folder.file("pause.ngc", "G1 X5 F600\nM0 (turn the work)\nG1 X0\nM30\n");
    let ran = haptimill(&["run", &file, "--json", "--out", &folder.path("out")]).expect_code(0);
    assert_eq!(ran.json()["completed"], true);
    assert!((number(&ran.json(), "path_length_mm") - 10.0).abs() < 0.01);
    // Without a terminal the program is refused before the port is opened.
    let ran = haptimill(&[
        "run",
        &file,
        "--port",
        "tcp:localhost:1",
        "--out",
        &folder.path("none"),
    ])
    .expect_code(2);
    assert!(
        ran.err.contains("pause.ngc:2") && ran.err.contains("--skip-pauses"),
        "{}",
        ran.err
    );
}

/// Writes a program of one hour of machine time.
fn write_long_program(folder: &TestFolder) -> String {
    let lines: String = (0..900)
        .map(|turn| format!("G1 X{} Y0\nG1 Y5\nG1 X0\nG1 Y0\n", 10 + turn % 3))
        .collect();
    folder.file("long.ngc", format!("G21 G90 F300\n{lines}"))
}

/// Size of a recording with some seconds of machine time, bytes.
const SOME_SECONDS: u64 = 100_000;

/// Starts that program and waits until its recording has some seconds of machine time. One period
/// of 100 is recorded: the whole program would need 9 GB of disk.
fn start_long_program(folder: &TestFolder) -> scene::Running {
    let program = write_long_program(folder);
    let out = folder.path("out");
    let mut run = start(&["run", &program, "--record", "every=100", "--out", &out]);
    run.wait_for_output("running");
    let recording = folder.path("out/recording.hmr");
    while std::fs::metadata(&recording).map_or(0, |file| file.len()) < SOME_SECONDS {
        assert!(run.runs());
        std::thread::sleep(Duration::from_millis(2));
    }
    run
}

#[test]
fn result_folder_is_locked_until_its_run_ends() {
    let folder = TestFolder::new();
    let mut first = start_long_program(&folder);
    let recording = folder.path("out/recording.hmr");
    let short = folder.file("short.ngc", "G1 X1 F600\nM30\n");
    let out = folder.path("out");
    let second = haptimill(&["run", &short, "--json", "--out", &out]).expect_code(9);
    let said = "another run is writing its results there; choose another folder with --out";
    assert!(second.err.contains(said), "{}", second.err);
    assert_eq!(second.json()["exit_code"], 9);
    // The recording of the first run still exists and grows.
    assert!(first.runs() && std::fs::metadata(&recording).unwrap().len() >= SOME_SECONDS);
    first.kill();
    haptimill(&["run", &short, "--out", &out]).expect_code(0);
    assert_eq!(folder.summary("out")["program"], "short.ngc");
    // The folder has result files only.
    let mut names: Vec<String> = std::fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(
        names,
        ["recording.hmr", "report.html", "summary.json", "trace.csv"]
    );
}

/// A program as CAM systems write it: passes of short lines with a feed each, rapid moves between
/// them.
fn cam_program() -> String {
    let mut text = String::from("N10 G21 G90 G17\nN20 G0 Z25\n");
    for pass in 0..6 {
        let y = f64::from(pass) * 1.5;
        text += &format!("G0 X-20 Y{y}\nG0 Z22\nG1 Z21 F200\n");
        for step in 0..80 {
            let x = f64::from(step) * 0.5 - 20.0;
            let (z, feed) = (21.0 + (x * 0.4).sin() * 0.6, 600 + 40 * (step % 9));
            text += &format!("N{} X{x:.3} Z{z:.4} F{feed}\n", 100 * pass + step);
        }
        text += "G0 Z25\n";
    }
    text + "M30\n"
}

/// The announced time is the one that the run takes, at any override.
#[test]
fn announced_time_is_the_time_taken() {
    let folder = TestFolder::new();
    let overrides: [&[&str]; 4] = [
        &["--override", "50"],
        &[],
        &["--override", "200"],
        &["--override", "130", "--rapid-override", "25"],
    ];
    let cam = folder.file("cam.ngc", cam_program());
    let example = |name: &str| format!("examples/{name}.ngc");
    let programs = [
        example("e11-circle"),
        example("dome"),
        example("e9-pocket"),
        cam,
    ];
    for (file, given) in programs
        .iter()
        .flat_map(|it| overrides.map(|more| (it, more)))
    {
        let check = ["run", file, "--check", "--json"];
        let checked = haptimill(&[&check, given].concat()).expect_code(0);
        let announced = number(&checked.json(), "duration_s");
        let out = folder.path("out");
        let run = ["run", file, "--record", "every=100", "--out", &out];
        let ran = haptimill(&[&run[..], given].concat()).expect_code(0);
        let took = number(&folder.summary("out"), "duration_s");
        let error = (announced / took - 1.0).abs();
        assert!(
            error < 0.02,
            "{file} {given:?}: {announced} s announced, {took} s taken"
        );
        let Some(percent) = given.get(1) else {
            continue;
        };
        let line = format!("running, {}", haptimill_report::duration(announced));
        assert!(
            ran.out.contains(&format!("{line} at {percent} %")),
            "{}",
            ran.out
        );
    }
}

#[test]
fn optional_stop_pauses_with_its_option() {
    let folder = TestFolder::new();
    let file = folder.file("m1.ngc", "G1 X5 F600\nM1\nG1 X0\nM30\n");
    let out = folder.path("none");
    let run = ["run", &file, "--port", "tcp:localhost:1", "--out", &out];
    // Without the option the program has no pause, and the port is opened.
    haptimill(&run).expect_code(5);
    let ran = haptimill(&[&run[..], &["--optional-stop"]].concat()).expect_code(2);
    assert!(
        ran.err.contains("m1.ngc:2:1: the program pauses"),
        "{}",
        ran.err
    );
}

/// A tool change names the tool; a pause in a called file names that file and its comment, and
/// not the one that the program has in the same line.
#[test]
fn a_pause_names_its_tool_and_its_file() {
    let folder = TestFolder::new();
    folder.file(
        "turn.ngc",
        "O<turn> sub\n\nM0 (turn it)\nO<turn> endsub\nM2\n",
    );
    let text = "G21 G90 F600\nT4 M6 (long drill)\nG0 X1 (wrong comment)\nO<turn> call\nM30\n";
    let file = folder.file("part.ngc", text);
    let port = ["--port", "tcp:localhost:1"];
    let refused = haptimill(&[&["run", &file], &port[..]].concat()).expect_code(2);
    assert!(
        refused.err.contains("part.ngc:2:4: the program pauses"),
        "{}",
        refused.err
    );
    for more in [&[][..], &["--stream"], &["--dry"]] {
        let out = folder.path("out");
        let run = ["run", &file, "--skip-pauses", "--out", &out];
        let ran = haptimill(&[&run[..], more].concat()).expect_code(0);
        let said = ran.out + &ran.err;
        assert!(
            said.contains("line 2, fit tool 4 (long drill): pause skipped"),
            "{said}"
        );
        let in_file = said.lines().find(|line| line.starts_with("line 3 of "));
        let in_file = in_file.unwrap_or_else(|| panic!("{said}"));
        assert!(
            in_file.ends_with("turn.ngc (turn it): pause skipped"),
            "{said}"
        );
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_along_the_path_and_keeps_the_trace() {
    let folder = TestFolder::new();
    let run = start_long_program(&folder);
    run.interrupt();
    let ran = run.end().expect_code(7);
    assert!(
        ran.err.contains("stopped by the user") && ran.err.contains("position is kept"),
        "{}",
        ran.err
    );
    let summary = folder.summary("out");
    assert_eq!(
        (&summary["final_state"], &summary["position_kept"]),
        (&"Idle".into(), &true.into()),
        "{summary:#}"
    );
    assert_eq!(summary["completed"], false);
    assert_eq!(summary["faults"], Value::Array(Vec::new()));
    assert!(number(&summary, "duration_s") < 3600.0);
    assert!(folder.read("out/trace.csv").lines().count() > 10);
    assert!(ran.out.contains("stopped"), "{}", ran.out);
}

/// A recording of a part of the control periods: the figures are those of all, bit by bit.
#[test]
fn figures_of_a_partial_recording_are_those_of_the_whole_one() {
    let folder = TestFolder::new();
    let stock = ["--stock", "examples/block.toml"];
    let whole = job(&folder, "all", "e7-slot.ngc", &stock);
    let bytes = |out: &str| folder.path(&format!("{out}/recording.hmr"));
    let size = |out: &str| std::fs::metadata(bytes(out)).unwrap().len();
    for (out, part, records) in [
        (
            "every",
            "every=50",
            whole["periods"].as_u64().unwrap().div_ceil(50),
        ),
        ("last", "last=3s", 15_000),
    ] {
        let more = [&stock[..], &["--record", part]].concat();
        let thinned = job(&folder, out, "e7-slot.ngc", &more);
        for (name, value) in whole.as_object().unwrap() {
            if !matches!(name.as_str(), "periods" | "trace_sha256") {
                assert_eq!(&thinned[name], value, "{part}: {name}");
            }
        }
        assert_eq!(thinned["periods"], records, "{part}");
        assert!(
            size(out) < size("all") / 3,
            "{part}: {} of {}",
            size(out),
            size("all")
        );
        let refused = haptimill(&["replay", &bytes(out)]).expect_code(3);
        assert!(
            refused.err.contains("with --record every or last"),
            "{refused:?}"
        );
        let info = haptimill(&["trace", "info", &bytes(out)]).expect_code(0);
        assert!(info.out.contains("recorded: "), "{}", info.out);
        let page = folder.read(&format!("{out}/report.html"));
        assert!(page.contains("Recorded part") && !page.contains("from the path (contour)"));
    }
    let last = Recording::open(Path::new(&bytes("last"))).unwrap();
    let end = Recording::open(Path::new(&bytes("all"))).unwrap();
    let (last, end) = (last.last().unwrap(), end.last().unwrap());
    assert_eq!(last, end, "the last record is the same one");
    for wrong in ["every=1", "last=10", "some"] {
        let refused = haptimill(&["run", "examples/e7-slot.ngc", "--record", wrong]).expect_code(2);
        assert!(refused.err.contains("write all, every=N"), "{refused:?}");
    }
}

/// The size of a long recording is printed before the run: that of the file within a fifth.
#[test]
fn a_long_recording_is_announced_with_its_size() {
    let folder = TestFolder::new();
    let program = folder.file("long.ngc", "G21 G90 G1 F1 X1.15\nM30\n");
    let out = folder.path("out");
    let run = |program: &str, more: &[&str]| {
        haptimill(&[&["run", program, "--out", &out], more].concat()).expect_code(0)
    };
    let announced = |text: &str, unit: &str| -> f64 {
        let reported = text.lines().find(|line| line.starts_with("the recording"));
        let mut words = reported.expect(text).split(' ');
        let index = words.clone().position(|word| word == unit).expect(unit);
        words.nth(index - 1).unwrap().parse().unwrap()
    };
    let size = || {
        let file = std::fs::metadata(folder.path("out/recording.hmr")).unwrap();
        file.len() as f64 / 1e6
    };
    let reported = announced(&run(&program, &[]).out, "MB");
    assert!(
        reported > 100.0 && (reported / size() - 1.0).abs() < 0.2,
        "{reported} of {} MB",
        size()
    );
    // The length of a stream is not known. A short recording is not announced.
    let short = folder.file(
        "short.ngc",
        "G21 G90 G1 F60 X5
M30
",
    );
    let growth = announced(&run(&short, &["--stream"]).out, "MB/s");
    let per_s = size() / number(&folder.summary("out"), "duration_s");
    assert!(
        (growth / per_s - 1.0).abs() < 0.2,
        "{growth} of {per_s} MB/s"
    );
    let silent = run(&short, &[]).out;
    assert!(!silent.contains("the recording"), "{silent}");
}
