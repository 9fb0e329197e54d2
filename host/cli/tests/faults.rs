//! Jobs with injected faults: line errors never cause wrong motion, and machine faults stop the job
//! with a message.

use crate::scene;
use haptimill_trace::{Axes, Recording, flag};
use scene::{RunResult, TestFolder, haptimill};
use std::path::Path;

/// Lines, arcs and turns of both rotary axes, with a dwell; about 9 s.
const PROGRAM: &str = "G21 G90 F600
G1 X10 Y5
G2 X20 Y5 I5
G1 X15 Y-5 Z25 B4 A-3
G4 P0.2
G3 X0 Y0 R20
G1 Z21.232 B0 A0
M30
";

/// Runs the program with faults.
fn run(folder: &TestFolder, out: &str, faults: &[&str], more: &[&str]) -> RunResult {
    let program = folder.file("part.ngc", PROGRAM);
    let out = folder.path(out);
    let mut arguments = vec!["run", &program, "--json", "--out", &out];
    for fault in faults {
        arguments.extend(["--fault", fault]);
    }
    arguments.extend(more);
    haptimill(&arguments)
}

/// The commanded poses of a job without repetitions.
fn commanded_poses(folder: &TestFolder, out: &str) -> Vec<Axes> {
    let file = folder.path(&format!("{out}/recording.hmr"));
    let recording = Recording::open(Path::new(&file)).unwrap();
    let records = recording.iter().unwrap().map(Result::unwrap);
    let mut poses: Vec<Axes> = records
        .filter(|record| record.has(flag::PROGRAMMED))
        .map(|record| record.commanded)
        .collect();
    poses.dedup();
    poses
}

/// Distance of a pose from the segment between two others, axis units.
fn distance_to_segment(pose: &Axes, from: &Axes, to: &Axes) -> f64 {
    let difference = |a: &Axes, b: &Axes| -> [f64; 6] {
        std::array::from_fn(|i| f64::from(a[i]) - f64::from(b[i]))
    };
    let dot = |a: &[f64; 6], b: &[f64; 6]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let (way, here) = (difference(to, from), difference(pose, from));
    let part = if dot(&way, &way) > 0.0 {
        (dot(&here, &way) / dot(&way, &way)).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let rest: [f64; 6] = std::array::from_fn(|i| here[i] - part * way[i]);
    dot(&rest, &rest).sqrt()
}

/// 0.2 um and 2e-5 degrees, because the path between two periods is approximated by a line.
const TOLERANCE: f64 = 210.0;

/// Checks that every pose is on the path of the fault-free job, in order.
#[track_caller]
fn expect_on_path(poses: &[Axes], clean: &[Axes]) {
    let mut at = 0;
    for (index, pose) in poses.iter().enumerate() {
        while at + 1 < clean.len()
            && distance_to_segment(pose, &clean[at], &clean[at + 1]) > TOLERANCE
        {
            at += 1;
        }
        assert!(
            at + 1 < clean.len(),
            "pose {index} of {} is not on the way: {pose:?}",
            poses.len()
        );
    }
}

#[test]
fn serial_line_errors_never_cause_wrong_motion() {
    let folder = TestFolder::new();
    run(&folder, "clean", &[], &["--baud", "115200"]).expect_code(0);
    let clean = commanded_poses(&folder, "clean");
    assert!(clean.len() > 10_000, "{}", clean.len());
    let mut ended = 0;
    let lines = [
        "link-errors rate=1e-6",
        "link-errors rate=1e-5",
        "link-errors rate=1e-4",
        "link-errors rate=1e-3",
        "link-errors rate=1e-2 at=6s",
        "link-drop rate=1e-3",
        "link-duplicate rate=1e-3",
        "link-delay ms=30",
        "link-cut at=6s for=300ms",
        "link-cut at=6s",
        "link-cut at=6s direction=to-host",
    ];
    for line in lines {
        let ran = run(&folder, "out", &[line], &["--baud", "115200"]);
        let poses = commanded_poses(&folder, "out");
        expect_on_path(&poses, &clean);
        let summary = folder.summary("out");
        println!(
            "{line}: exit code {}, {} of {} poses, {} underruns, {}",
            ran.code,
            poses.len(),
            clean.len(),
            summary["underruns"],
            ran.err.trim_end()
        );
        match ran.code {
            0 => {
                ended += 1;
                assert_eq!(poses.last(), clean.last(), "{line}");
                assert_eq!(
                    (&summary["completed"], &summary["position_kept"]),
                    (&true.into(), &true.into()),
                    "{line}"
                );
                if summary["underruns"] == 0 {
                    assert_eq!(poses, clean, "{line}");
                }
            }
            5 | 6 => {
                assert!(ran.err.len() > 40, "{line}: {}", ran.err);
                assert_eq!(summary["completed"], false, "{line}");
            }
            _ => panic!("{line}: {ran:?}"),
        }
    }
    assert!(ended >= 7, "only {ended} jobs came to their end");
}

#[test]
fn machine_faults_stop_the_job_with_a_remedy() {
    let folder = TestFolder::new();
    let mut text = String::new();
    let faults = [
        ("encoder-stuck joint=l2 channel=a level=high at=6s", "l2"),
        ("encoder-swapped joint=l3 at=6s", "l3"),
        ("joint-jammed joint=l1 at=6s", "l1"),
        ("drive-dead joint=l4 at=6s", "l4"),
        ("drive-tripped joint=l1 at=6s", "l1"),
        ("drive-reversed joint=alpha at=6s", "alpha"),
        ("encoder-noise joint=l2 per-second=2000 at=6s", "l2"),
        ("missed-periods count=5 at=6s", ""),
        ("emergency-stop at=6s", ""),
        ("joint-jammed joint=l3", "l3"),
        ("index-missing joint=l2", "l2"),
    ];
    for (fault, joint) in faults {
        let ran = run(&folder, "out", &[fault], &[]).expect_code(6);
        assert!(ran.err.contains(joint), "{fault}: {}", ran.err);
        text += &format!("{fault}\n    {}\n", folder.redact(ran.err.trim_end()));
        if fault.contains("at=") {
            // A fault during the job: the results up to the stop are kept.
            let summary = folder.summary("out");
            assert_eq!(summary["completed"], false, "{fault}");
            assert_eq!(
                summary["faults"].as_array().unwrap().len(),
                1,
                "{fault}: {summary:#}"
            );
            let state = summary["final_state"].as_str().unwrap();
            assert!(
                ["Fault", "EmergencyStop"].contains(&state),
                "{fault}: {state}"
            );
            assert!(folder.read("out/trace.csv").lines().count() > 10);
            assert!(folder.read("out/report.html").contains("Faults"));
        }
    }
    insta::assert_snapshot!("machine_faults", text);
}

#[test]
fn faults_of_step_motors_stop_the_job_with_a_remedy() {
    let folder = TestFolder::new();
    let mut text = String::new();
    // The dead motor is pushed while the rotors lock.
    let not_locked: &[&str] = &["drive-dead joint=l2", "push joint=l2 effort=80 at=20ms"];
    let lists: [&[&str]; 4] = [
        &["joint-jammed joint=l1 at=8s"],
        &["encoder-stuck joint=l2 channel=a level=high at=8s"],
        &["drive-dead joint=l2"],
        not_locked,
    ];
    for faults in lists {
        let more = ["--machine", "machines/h4-step.toml"];
        let ran = run(&folder, "out", faults, &more).expect_code(6);
        let (joint, what) = (faults[0].contains("l1"), faults == not_locked);
        assert!(ran.err.contains(if joint { "l1" } else { "l2" }));
        assert_eq!(ran.err.contains("did not lock"), what, "{}", ran.err);
        let said = folder.redact(ran.err.trim_end());
        text += &format!("{}\n    {said}\n", faults.join(" --fault "));
    }
    insta::assert_snapshot!("step_motor_faults", text);
}

/// A controller without encoders cannot detect lost steps. The simulator can: a run that lost steps
/// did not succeed. It ends with the joint, its distance and the code of a fault.
#[test]
fn lost_steps_without_encoders_are_no_success() {
    let folder = TestFolder::new();
    // Longer than homing, in which the joint finds its place again.
    let text = format!("G21 G90 F600\n{}G1 X0\nM30\n", "G1 X20\nX-20\n".repeat(6));
    let program = folder.file("part.ngc", &text);
    let run = |faults: &[&str]| {
        let out = folder.path("out");
        let job = [
            "run",
            &program,
            "--json",
            "--machine",
            "machines/mill3.toml",
            "--out",
            &out,
        ];
        haptimill(&[&job[..], faults].concat())
    };
    let whole = run(&[]).expect_code(0).json();
    assert_eq!(whole["faults"], serde_json::json!([]), "{whole:#}");
    let lost = run(&["--fault", "joint-jammed joint=x at=30s for=100ms"]).expect_code(6);
    let summary = lost.json();
    let fault = summary["faults"][0].as_str().unwrap_or_default();
    for part in ["steps were lost", "x is ", " mm off", "home again"] {
        assert!(
            fault.contains(part) && lost.err.contains(part),
            "{part}: {lost:?}"
        );
    }
    assert_eq!(summary["position_kept"], false, "{summary:#}");
    assert_eq!(summary["completed"], false, "{summary:#}");
    // The true tool is as far away.
    let mm = fault
        .split("x is ")
        .nth(1)
        .and_then(|rest| rest.split(' ').next());
    let off: f64 = mm.and_then(|mm| mm.parse().ok()).expect("a distance");
    let file = folder.path("out/recording.hmr");
    let recording = Recording::open(Path::new(&file)).unwrap();
    let last = recording
        .iter()
        .unwrap()
        .map(Result::unwrap)
        .last()
        .unwrap();
    let per_mm = f64::from(1 << 20);
    let tool = f64::from(last.tool[0] - last.commanded[0]) / per_mm;
    println!("the joint is {off} mm off, the tool {tool} mm");
    assert!(
        off.abs() > 0.05 && (tool - off).abs() < 0.02,
        "{off} {tool}"
    );
    // In the move to the home pose, before the program.
    let before = run(&["--fault", "joint-jammed joint=x at=20s for=100ms"]).expect_code(6);
    let before = before.json();
    assert_eq!(before["position_kept"], false, "{before:#}");
}

/// A program that asks the machine runs in parts; it is no success either.
#[test]
fn lost_steps_of_a_program_in_parts_are_no_success() {
    let folder = TestFolder::new();
    let mill = std::fs::read_to_string(scene::root().join("machines/mill3.toml")).unwrap();
    let (controller, plant) = mill.split_once("[plant]").unwrap();
    let input = "name = \"ready\"\nchannel = 0\n";
    let machine = format!(
        "{controller}[[input]]\n{input}function = \"general\"\nactive = \"high\"\n\
         filter_ms = 2.0\n\n[plant]{plant}\n[[plant.input]]\n{input}"
    );
    let machine = folder.file("own.toml", &machine);
    let text = format!(
        "G21 G90 F600\nM66 P0 L0\n{}G1 X0\nM30\n",
        "G1 X20\nX-20\n".repeat(6)
    );
    let program = folder.file("part.ngc", &text);
    let job = ["run", &program, "--machine", &machine];
    haptimill(&job).expect_code(0);
    let fault = ["--fault", "joint-jammed joint=x at=30s for=100ms"];
    let lost = haptimill(&[&job[..], &fault].concat()).expect_code(6);
    assert!(lost.err.contains("steps were lost"), "{lost:?}");
}

#[test]
fn fault_before_the_job_prevents_motion() {
    let folder = TestFolder::new();
    let ran = run(&folder, "out", &["drive-dead joint=l2"], &[]).expect_code(6);
    assert!(ran.err.contains("l2"), "{}", ran.err);
    assert!(!Path::new(&folder.path("out/recording.hmr")).exists());
}

#[test]
fn emergency_stop_during_homing_ends_with_the_fault_code() {
    let folder = TestFolder::new();
    let ran = run(&folder, "out", &["emergency-stop at=1s"], &[]).expect_code(6);
    let reported = ran.json();
    let what = reported["error"].as_str().unwrap();
    assert!(
        what.contains("the emergency stop is latched"),
        "{reported:#}"
    );
    assert_eq!(reported["exit_code"], 6);
    let ran = run(&folder, "out", &["emergency-stop at=4s"], &[]).expect_code(6);
    assert!(
        ran.err.contains("the emergency stop is latched"),
        "{}",
        ran.err
    );
    // The summary names the injected faults.
    let summary = folder.summary("out");
    let reported = [&summary["injected"][0], &summary["final_state"]];
    assert_eq!(
        reported,
        ["emergency-stop at=4s", "EmergencyStop"],
        "{summary:#}"
    );
    let page = folder.read("out/report.html");
    assert!(page.contains("<li>emergency-stop at=4s</li>"));
    // The terminal and the page have the words, and not the name in the code.
    for part in [
        "<b>Emergency stop</b><span>final state",
        "<td>Emergency stop, position kept</td>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    let out = folder.path("reported");
    let program = folder.file("reported.ngc", "G21 G90 G1 X5 F100\nM30\n");
    let stop = ["--fault", "emergency-stop at=4s"];
    let reported = haptimill(&[&["run", &program, "--out", &out], &stop[..]].concat());
    let reported = reported.expect_code(6);
    assert!(
        reported.out.contains("\nemergency stop, position kept\n"),
        "{}",
        reported.out
    );
    assert!(!page.contains("EmergencyStop") && !reported.out.contains("EmergencyStop"));
}
