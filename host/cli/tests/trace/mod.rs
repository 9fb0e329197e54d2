//! Recordings: bit-exact replay, info, export; damaged, truncated and foreign files.

use crate::scene;
mod output;

use haptimill_trace::replay::replay;
use haptimill_trace::{IoLog, Period, Record, Recorder, Recording};
use scene::{SimServer, TestFolder, haptimill, number, start};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// Runs a program of examples/ into `out` and returns the path of its recording.
fn record(folder: &TestFolder, out: &str, program: &str, more: &[&str], code: i32) -> String {
    let program = format!("examples/{program}");
    let out = folder.path(out);
    let run = [&["run", &program, "--quiet", "--out", &out], more].concat();
    haptimill(&run).expect_code(code);
    format!("{out}/recording.hmr")
}

/// Replays a recording, which must be equal, and returns the JSON result.
#[track_caller]
fn replays(recording: &str) -> Value {
    let ran = haptimill(&["replay", recording, "--json"]).expect_code(0);
    assert_eq!(ran.err, "");
    let said = ran.json();
    assert_eq!(
        (&said["equal"], &said["whole"]),
        (&true.into(), &true.into())
    );
    said
}

#[test]
fn circle_replays_equal_with_the_hash_of_the_summary() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e11-circle.ngc", &[], 0);
    let said = replays(&trace);
    let summary = folder.summary("out");
    assert_eq!(said["sha256"], summary["trace_sha256"]);
    assert_eq!(said["records"], summary["periods"]);
    // The recording includes homing.
    let (all, job) = (number(&said, "periods"), number(&summary, "periods"));
    assert!(all > job + 10_000.0, "{all} of them, {job} in the job");

    let ran = haptimill(&["replay", &trace]).expect_code(0);
    assert!(
        ran.out.starts_with("bit-identical in ") && ran.out.contains("times real time"),
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
fn force_control_scenario_replays_equal() {
    let folder = TestFolder::new();
    haptimill(&["scenario", "run", "e4", "--out", &folder.path("out")]).expect_code(0);
    for pass in ["ka0.25-kv5", "ka1-kv5", "ka1-kv20"] {
        let said = replays(&folder.path(&format!("out/e4/{pass}/recording.hmr")));
        assert!(number(&said, "records") > 10_000.0);
    }
}

#[test]
fn teleoperated_slot_replays_equal_and_a_changed_arm_count_is_detected() {
    let folder = TestFolder::new();
    haptimill(&["scenario", "run", "e8", "--out", &folder.path("out")]).expect_code(0);
    let passes = std::fs::read_dir(folder.path("out/e8")).unwrap();
    let traces: Vec<_> = passes
        .map(|pass| pass.unwrap().path().join("recording.hmr"))
        .filter(|trace| trace.exists())
        .collect();
    assert!(!traces.is_empty());
    for trace in &traces {
        let said = replays(trace.to_str().unwrap());
        assert!(number(&said, "records") > 50_000.0);
        // The enabling switch was pressed, and the motors of the arm had torque.
        let recording = Recording::open(trace).unwrap();
        let mut enabled = 0_u64;
        let mut pushed = 0_u64;
        for period in recording.read_periods().unwrap() {
            let period: Period = period.unwrap();
            enabled += u64::from(period.inputs.haptic.enabling_switch);
            let currents = period.outputs.haptic.currents;
            pushed += u64::from(currents.iter().flatten().any(|current| *current != 0));
        }
        assert!(enabled > 10_000 && pushed > 10_000, "{enabled}, {pushed}");
    }
    // One encoder count of one leg in one period during teleoperation.
    let recording = Recording::open(&traces[0]).unwrap();
    let changed = folder.path("changed.hmr");
    let mut recorder = Recorder::create(Path::new(&changed), recording.header()).unwrap();
    recorder.start_io_log(IoLog::new());
    let mut pressed = 0_u32;
    let mut flipped = 0;
    for period in recording.read_periods().unwrap() {
        let mut period: Period = period.unwrap();
        pressed += u32::from(period.inputs.haptic.enabling_switch);
        if pressed == 5000 && flipped == 0 {
            flipped = period.inputs.period;
            period.inputs.haptic.legs[1].counts[0] ^= 1;
        }
        recorder.period(&period.inputs, &period.outputs);
    }
    recorder.finish().unwrap();
    let said = haptimill(&["replay", &changed, "--json"])
        .expect_code(8)
        .json();
    let difference = &said["difference"];
    assert_eq!(difference["period"], flipped);
    // The master moves x, so the commands of the joints differ in the same period.
    assert_eq!(difference["field"], "the command to drive l1");
    assert_ne!(difference["recorded"], difference["replayed"]);
}

#[test]
fn faulted_job_over_a_bad_line_replays_equal() {
    let folder = TestFolder::new();
    let fault = [
        "--fault",
        "encoder-stuck joint=l2 channel=a level=high at=6s",
        "--fault",
        "missed-periods count=2 at=5.5s",
        "--baud",
        "115200",
    ];
    let trace = record(&folder, "out", "e7-slot.ngc", &fault, 6);
    replays(&trace);
    let info = haptimill(&["trace", "info", &trace, "--json"])
        .expect_code(0)
        .json();
    let events = info["events"].as_array().unwrap();
    assert!(
        events.iter().any(
            |event| event["level"] == "error" && event["text"].as_str().unwrap().contains("l2")
        )
    );
    // A machine with step motors.
    let steps = ["--machine", "machines/h4-step.toml"];
    replays(&record(&folder, "steps", "e7-slot.ngc", &steps, 0));
}

#[test]
fn one_changed_input_bit_is_reported_with_both_values() {
    let folder = TestFolder::new();
    let trace = record(&folder, "out", "e7-slot.ngc", &[], 0);
    let recording = Recording::open(Path::new(&trace)).unwrap();
    let first = recording.iter().unwrap().next().unwrap().unwrap().period;
    let flipped = first + 20_000;
    let changed = folder.path("changed.hmr");
    let mut recorder = Recorder::create(Path::new(&changed), recording.header()).unwrap();
    recorder.start_io_log(IoLog::new());
    for period in recording.read_periods().unwrap() {
        let mut period: Period = period.unwrap();
        if period.inputs.period == flipped {
            period.inputs.joints[2].counts ^= 1;
        }
        recorder.period(&period.inputs, &period.outputs);
    }
    for record in recording.iter().unwrap() {
        let record: Record = record.unwrap();
        recorder.record(&record);
    }
    recorder.finish().unwrap();
    let ran = haptimill(&["replay", &changed]).expect_code(8);
    assert_eq!(ran.out, "");
    let expected = format!("control period {flipped} (");
    assert!(
        ran.err.starts_with(&expected) && ran.err.contains(" l3 was "),
        "{}",
        ran.err
    );
    let said = haptimill(&["replay", &changed, "--json"])
        .expect_code(8)
        .json();
    assert_eq!(said["equal"], false);
    let difference = &said["difference"];
    assert_eq!(difference["period"], flipped);
    assert!(difference["field"].as_str().unwrap().ends_with("l3"));
    assert_ne!(difference["recorded"], difference["replayed"]);
    // Only the periods differ, not the records.
    haptimill(&["trace", "diff", &trace, &changed]).expect_code(0);
}

#[test]
fn truncated_recording_replays_to_its_end() {
    let folder = TestFolder::new();
    let lines: String = (0..40)
        .map(|turn| format!("G1 X{} Y0\nG1 Y5\nG1 X0\nG1 Y0\n", 10 + turn % 3))
        .collect();
    let program = folder.file("long.ngc", format!("G21 G90 F300\n{lines}"));
    let out = folder.path("out");
    let mut run = start(&["run", &program, "--out", &out]);
    run.wait_for_output("running");
    let trace = folder.path("out/recording.hmr");
    while std::fs::metadata(&trace).map_or(0, |file| file.len()) < 8_000_000 {
        assert!(run.runs());
        std::thread::sleep(Duration::from_millis(2));
    }
    run.kill();
    let ran = haptimill(&["replay", &trace, "--json"]).expect_code(0);
    let said = ran.json();
    assert_eq!(
        (&said["equal"], &said["whole"]),
        (&true.into(), &false.into())
    );
    assert!(
        number(&said, "periods") > 20_000.0 && number(&said, "records") > 10_000.0,
        "{said:#}"
    );
    assert!(
        ran.err.contains("the recording is truncated"),
        "{}",
        ran.err
    );
    let recording = Recording::open(Path::new(&trace)).unwrap();
    assert_eq!(
        replay(&recording).unwrap().unwrap().periods,
        recording.periods()
    );
}

#[test]
fn job_on_a_port_is_reported_as_not_replayable() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
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
    .expect_code(0);
    let trace = folder.path("out/recording.hmr");
    let ran = haptimill(&["replay", &trace]).expect_code(3);
    let said =
        "has the telemetry of its controller, but not its inputs: it was recorded through a port";
    assert!(ran.err.contains(said), "{}", ran.err);
    let info = haptimill(&["trace", "info", &trace, "--json"])
        .expect_code(0)
        .json();
    assert_eq!(info["replayable"], false);
    // The events are in the recording.
    let events = info["events"].as_array().unwrap();
    assert!(
        events
            .iter()
            .any(|event| event["text"].as_str().unwrap().contains("done")),
        "{info:#}"
    );
    haptimill(&["trace", "plot", &trace, "x_tool_mm"]).expect_code(0);
}
