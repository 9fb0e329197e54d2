//! Recordings and what reads them: replayed bit by bit, looked at, exported; and files that are damaged, cut off or foreign.

mod scene;

use haptimill_trace::replay::replay;
use haptimill_trace::{IoLog, Period, Record, Recorder, Recording};
use scene::{Folder, Ran, Served, haptimill, number, start};
use serde_json::Value;
use std::path::Path;
#[cfg(unix)]
use std::process::{Command, Stdio};
use std::time::Duration;

/// Runs a program of examples/ into `out`; where its recording is.
fn recorded(folder: &Folder, out: &str, program: &str, more: &[&str], code: i32) -> String {
    let program = format!("examples/{program}");
    let out = folder.path(out);
    let run = [&["run", &program, "--quiet", "--out", &out], more].concat();
    haptimill(&run).ended_with(code);
    format!("{out}/recording.hmr")
}

/// Replays a recording, which must be equal, and gives what is said of it.
#[track_caller]
fn replays(recording: &str) -> Value {
    let ran = haptimill(&["replay", recording, "--json"]).ended_with(0);
    assert_eq!(ran.err, "");
    let said = ran.json();
    assert_eq!(
        (&said["equal"], &said["whole"]),
        (&true.into(), &true.into())
    );
    said
}

#[test]
fn the_circle_replays_equal_and_its_hash_is_that_of_the_summary() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e11-circle.ngc", &[], 0);
    let said = replays(&trace);
    let summary = folder.summary("out");
    assert_eq!(said["sha256"], summary["trace_sha256"]);
    assert_eq!(said["records"], summary["periods"]);
    // Homing is in it too.
    let (all, job) = (number(&said, "periods"), number(&summary, "periods"));
    assert!(all > job + 10_000.0, "{all} of them, {job} in the job");

    let ran = haptimill(&["replay", &trace]).ended_with(0);
    assert!(
        ran.out.starts_with("the same bits in ") && ran.out.contains("times real time"),
        "{}",
        ran.out
    );
    let recording = Recording::open(Path::new(&trace)).unwrap();
    let per_period = recording.period_bytes() as f64 / recording.periods() as f64;
    println!(
        "{per_period:.1} bytes a period: {:.0} kB a second beside {:.0} kB of records",
        per_period / recording.period_s() / 1e3,
        haptimill_trace::RECORD_BYTES as f64 / recording.period_s() / 1e3
    );
    assert!(per_period < 60.0, "{per_period} bytes a period");
}

#[test]
fn a_scenario_under_force_control_replays_equal() {
    let folder = Folder::new();
    haptimill(&["scenario", "run", "e4", "--out", &folder.path("out")]).ended_with(0);
    for pass in ["ka0.25-kv5", "ka1-kv5", "ka1-kv20"] {
        let said = replays(&folder.path(&format!("out/e4/{pass}/recording.hmr")));
        assert!(number(&said, "records") > 10_000.0);
    }
}

#[test]
fn a_slot_led_by_hand_replays_equal_and_a_count_of_the_haptic_arm_is_missed() {
    let folder = Folder::new();
    haptimill(&["scenario", "run", "e8", "--out", &folder.path("out")]).ended_with(0);
    let passes = std::fs::read_dir(folder.path("out/e8")).unwrap();
    let traces: Vec<_> = passes
        .map(|pass| pass.unwrap().path().join("recording.hmr"))
        .filter(|trace| trace.exists())
        .collect();
    assert!(!traces.is_empty());
    for trace in &traces {
        let said = replays(trace.to_str().unwrap());
        assert!(number(&said, "records") > 50_000.0);
        // A hand was there: its button was pressed, and the arm's motors did something.
        let recording = Recording::open(trace).unwrap();
        let mut led = 0_u64;
        let mut pushed = 0_u64;
        for period in recording.read_periods().unwrap() {
            let period: Period = period.unwrap();
            led += u64::from(period.inputs.haptic.engaged);
            let currents = period.outputs.haptic.currents;
            pushed += u64::from(currents.iter().flatten().any(|current| *current != 0));
        }
        assert!(led > 10_000 && pushed > 10_000, "{led}, {pushed}");
    }
    // One count of one leg, for one period, while the hand leads.
    let recording = Recording::open(&traces[0]).unwrap();
    let changed = folder.path("changed.hmr");
    let mut recorder = Recorder::create(Path::new(&changed), recording.header()).unwrap();
    recorder.start_io_log(IoLog::new());
    let mut engaged = 0_u32;
    let mut flipped = 0;
    for period in recording.read_periods().unwrap() {
        let mut period: Period = period.unwrap();
        engaged += u32::from(period.inputs.haptic.engaged);
        if engaged == 5000 && flipped == 0 {
            flipped = period.inputs.period;
            period.inputs.haptic.legs[1].counts[0] ^= 1;
        }
        recorder.period(&period.inputs, &period.outputs);
    }
    recorder.finish().unwrap();
    let said = haptimill(&["replay", &changed, "--json"])
        .ended_with(8)
        .json();
    let difference = &said["difference"];
    assert_eq!(difference["period"], flipped);
    // The hand leads x, so the slides are told otherwise in the same period.
    assert_eq!(difference["field"], "the command to drive l1");
    assert_ne!(difference["recorded"], difference["replayed"]);
}

#[test]
fn a_job_that_ends_in_a_fault_over_a_bad_line_replays_equal() {
    let folder = Folder::new();
    let fault = [
        "--fault",
        "encoder-stuck axis=l2 channel=a level=high at=6s",
        "--fault",
        "missed-periods count=2 at=5.5s",
        "--baud",
        "115200",
    ];
    let trace = recorded(&folder, "out", "e7-slot.ngc", &fault, 6);
    replays(&trace);
    let info = haptimill(&["trace", "info", &trace, "--json"])
        .ended_with(0)
        .json();
    let events = info["events"].as_array().unwrap();
    assert!(
        events.iter().any(
            |event| event["level"] == "error" && event["text"].as_str().unwrap().contains("l2")
        )
    );
    // And a machine with step motors.
    let steps = ["--machine", "machines/h4-step.toml"];
    replays(&recorded(&folder, "steps", "e7-slot.ngc", &steps, 0));
}

#[test]
fn one_bit_of_one_input_is_named_with_both_values() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
    let recording = Recording::open(Path::new(&trace)).unwrap();
    let first = recording.iter().unwrap().next().unwrap().unwrap().period;
    let flipped = first + 20_000;
    let changed = folder.path("changed.hmr");
    let mut recorder = Recorder::create(Path::new(&changed), recording.header()).unwrap();
    recorder.start_io_log(IoLog::new());
    for period in recording.read_periods().unwrap() {
        let mut period: Period = period.unwrap();
        if period.inputs.period == flipped {
            period.inputs.axes[2].counts ^= 1;
        }
        recorder.period(&period.inputs, &period.outputs);
    }
    for record in recording.iter().unwrap() {
        let record: Record = record.unwrap();
        recorder.record(&record);
    }
    recorder.finish().unwrap();
    let ran = haptimill(&["replay", &changed]).ended_with(8);
    assert_eq!(ran.out, "");
    let expected = format!("control period {flipped} (");
    assert!(
        ran.err.starts_with(&expected) && ran.err.contains(" l3 was "),
        "{}",
        ran.err
    );
    let said = haptimill(&["replay", &changed, "--json"])
        .ended_with(8)
        .json();
    assert_eq!(said["equal"], false);
    let difference = &said["difference"];
    assert_eq!(difference["period"], flipped);
    assert!(difference["field"].as_str().unwrap().ends_with("l3"));
    assert_ne!(difference["recorded"], difference["replayed"]);
    // The periods alone differ, the records do not.
    haptimill(&["trace", "diff", &trace, &changed]).ended_with(0);
}

/// Numbers and names of folders taken out of what was said.
fn plain(folder: &Folder, ran: &Ran) -> String {
    let text = folder.anonymous(&format!("{}{}", ran.out, ran.err));
    let mut plain = String::new();
    for line in text.lines() {
        let words: Vec<String> = line.split(' ').map(masked).collect();
        plain += words.join(" ").trim_end();
        plain.push('\n');
    }
    format!("{plain}--- exit code {}\n", ran.code)
}

/// A word with a number in it, but for names.
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
fn a_recording_tells_what_it_is_and_is_drawn() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
    let info = haptimill(&["trace", "info", &trace]).ended_with(0);
    insta::assert_snapshot!("info", plain(&folder, &info));

    let plot = |more: &[&str]| haptimill(&[&["trace", "plot", &trace], more].concat());
    let sketch = plot(&["x_programmed_mm", "spindle_rpm"]).ended_with(0).out;
    let lines: Vec<&str> = sketch.lines().collect();
    assert_eq!(lines.len(), 18, "{sketch}");
    assert!(
        lines[0].starts_with("x_programmed_mm: -30.0") && lines[9].starts_with("spindle_rpm: "),
        "{sketch}"
    );
    // From the height of the start down to the end of the slot and back: dots in the first and the last row, on the way and at both ends.
    let braille = |line: &str| line.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c));
    assert!(lines[1..9].iter().all(|line| braille(line)), "{sketch}");

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
    .ended_with(0);
    let svg = folder.read("errors.svg");
    assert!(svg.starts_with("<svg xmlns=") && svg.trim_end().ends_with("</svg>"));
    // Two units, two charts; four lines and one.
    assert_eq!(svg.matches("<svg ").count(), 3);
    assert_eq!(svg.matches("<path").count(), 5);
    assert!(svg.contains("l3_joint_error_mm") && svg.contains("time after 2 s"));
    plot(&["x_force_high_n", "--from", "1000"]).ended_with(3);
    // States have names, beside whatever else has no unit.
    plot(&["state", "line", "--out", &picture]).ended_with(0);
    let svg = folder.read("errors.svg");
    assert_eq!(svg.matches("<svg ").count(), 3);
    assert!(
        svg.contains(">Run</text>") && !svg.contains(">1.5</text>"),
        "{svg}"
    );
}

#[test]
fn a_table_has_the_columns_rows_and_time_that_were_asked_for() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
    let whole = folder.path("whole.csv");
    haptimill(&["trace", "csv", &trace, "--every", "25", "--out", &whole]).ended_with(0);
    assert_eq!(folder.read("whole.csv"), folder.read("out/trace.csv"));
    let columns = "time_s,x_*_mm,state";
    let window = ["--from", "1", "--to", "1.01", "--every", "5"];
    let ran = haptimill(&[&["trace", "csv", &trace, "--columns", columns], &window[..]].concat())
        .ended_with(0);
    let rows: Vec<&str> = ran.out.lines().collect();
    assert_eq!(
        rows[0],
        "time_s,x_commanded_mm,x_programmed_mm,x_tool_mm,x_yielded_mm,state"
    );
    assert_eq!(rows.len(), 12, "{}", ran.out);
    assert!(
        rows[1].starts_with("1.000000,")
            && rows[11].starts_with("1.010000,")
            && rows[11].ends_with(",Run")
    );
}

#[test]
fn files_that_are_no_good_are_told_apart() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
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
        let ran = haptimill(arguments).ended_with(code);
        text += &format!(
            "$ haptimill {}\n{}\n",
            folder.anonymous(&arguments.join(" ")),
            plain(&folder, &ran)
        );
    }
    insta::assert_snapshot!("no_good", text);
}

/// Other names of a file: spelled differently, and links.
#[cfg(unix)]
fn names(folder: &Folder, path: &str) -> Vec<String> {
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
fn what_is_read_is_never_written_over() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
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
fn a_table_that_fails_leaves_the_one_before() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
    let mut damaged = std::fs::read(&trace).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    let damaged = folder.file("damaged.hmr", damaged);
    let table = folder.file("table.csv", "before");
    haptimill(&["trace", "csv", &damaged, "--out", &table]).ended_with(3);
    haptimill(&["trace", "csv", &trace, "--from", "1000", "--out", &table]).ended_with(3);
    assert_eq!(folder.read("table.csv"), "before");
    haptimill(&["trace", "csv", &trace, "--columns", "line", "--out", &table]).ended_with(0);
    assert!(folder.read("table.csv").starts_with("line\n"));
    let files = std::fs::read_dir(folder.path("")).unwrap();
    assert_eq!(files.count(), 3, "something was left behind");
}

/// Commands whose result is on standard output.
#[cfg(unix)]
fn tellers(trace: &str, out: &str) -> Vec<Vec<String>> {
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

/// Runs a command with this standard output; its exit code and what it complains of.
#[cfg(unix)]
fn telling(command: &[String], out: impl Into<Stdio>) -> (Option<i32>, String) {
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
fn a_result_that_cannot_be_written_ends_with_9() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
    for command in tellers(&trace, &folder.path("again")) {
        let full = std::fs::File::options().write(true).open("/dev/full");
        let (code, complaint) = telling(&command, full.unwrap());
        assert_eq!(code, Some(9), "{command:?} {complaint}");
        let said = "standard output: No space left on device (os error 28)";
        assert!(complaint.contains(said), "{command:?} {complaint}");
    }
    let ran = haptimill(&["trace", "csv", &trace, "--out", "/dev/full"]).ended_with(9);
    assert_eq!(
        ran.err,
        "/dev/full: No space left on device (os error 28)\n"
    );
    // What is wrong first is what the command ends with.
    let missing = ["trace", "info", "none.hmr", "--json"].map(str::to_string);
    let full = std::fs::File::options().write(true).open("/dev/full");
    assert_eq!(telling(&missing, full.unwrap()).0, Some(3));
}

#[cfg(unix)]
#[test]
fn a_reader_that_has_gone_is_no_error() {
    let folder = Folder::new();
    let trace = recorded(&folder, "out", "e7-slot.ngc", &[], 0);
    for command in tellers(&trace, &folder.path("again")) {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let (code, complaint) = telling(&command, writer);
        assert_eq!(code, Some(0), "{command:?} {complaint}");
        assert!(!complaint.contains("roken pipe"), "{command:?} {complaint}");
    }
}

#[test]
fn what_a_killed_host_left_replays_as_far_as_it_goes() {
    let folder = Folder::new();
    let lines: String = (0..900)
        .map(|turn| format!("G1 X{} Y0\nG1 Y5\nG1 X0\nG1 Y0\n", 10 + turn % 3))
        .collect();
    let program = folder.file("long.ngc", format!("G21 G90 F300\n{lines}"));
    let out = folder.path("out");
    let mut run = start(&["run", &program, "--out", &out]);
    run.says("running");
    let trace = folder.path("out/recording.hmr");
    while std::fs::metadata(&trace).map_or(0, |file| file.len()) < 8_000_000 {
        assert!(run.runs());
        std::thread::sleep(Duration::from_millis(2));
    }
    run.kill();
    let ran = haptimill(&["replay", &trace, "--json"]).ended_with(0);
    let said = ran.json();
    assert_eq!(
        (&said["equal"], &said["whole"]),
        (&true.into(), &false.into())
    );
    assert!(
        number(&said, "periods") > 20_000.0 && number(&said, "records") > 10_000.0,
        "{said:#}"
    );
    assert!(ran.err.contains("was cut off"), "{}", ran.err);
    let recording = Recording::open(Path::new(&trace)).unwrap();
    assert_eq!(
        replay(&recording).unwrap().unwrap().periods,
        recording.periods()
    );
}

#[test]
fn a_job_through_a_port_cannot_be_replayed_and_says_so() {
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    let program = folder.file("short.ngc", "G21 G90 F600\nG1 X1\nG1 X0\nM30\n");
    let out = folder.path("out");
    haptimill(&[
        "run",
        &program,
        "--port",
        &served.port,
        "--quiet",
        "--out",
        &out,
    ])
    .ended_with(0);
    let trace = folder.path("out/recording.hmr");
    let ran = haptimill(&["replay", &trace]).ended_with(3);
    let said =
        "has the telemetry of its controller, but not its inputs: it was recorded through a port";
    assert!(ran.err.contains(said), "{}", ran.err);
    let info = haptimill(&["trace", "info", &trace, "--json"])
        .ended_with(0)
        .json();
    assert_eq!(info["replayable"], false);
    // What happened is known all the same.
    let events = info["events"].as_array().unwrap();
    assert!(
        events
            .iter()
            .any(|event| event["text"].as_str().unwrap().contains("done")),
        "{info:#}"
    );
    haptimill(&["trace", "plot", &trace, "x_tool_mm"]).ended_with(0);
}
