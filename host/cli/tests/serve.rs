//! The served simulator with several hosts: simple commands, jobs, stops from another host, and
//! processes that die.
#![cfg(unix)]

use crate::scene;
use haptimill_trace::RECORD_BYTES;
use scene::{Running, SimServer, TestFolder, number, start};
use std::time::{Duration, Instant};

/// Moves back and forth for half a minute of machine time at 10 mm/s.
fn long_program(folder: &TestFolder) -> String {
    let turns: String = (0..15).map(|_| "G1 X20\nG1 X0\n").collect();
    folder.file("long.ngc", format!("G21 G90 F600\n{turns}M30\n"))
}

/// Moves out and back in about 2 s.
fn short_program(folder: &TestFolder) -> String {
    folder.file("short.ngc", "G21 G90 F600\nG1 X-5\nG3 X5 I5\nG1 X0\nM30\n")
}

/// Starts a run on a served machine and waits until it moves.
fn start_job(served: &SimServer, folder: &TestFolder, program: &str) -> Running {
    let mut run = start(&[
        "run",
        program,
        "--port",
        &served.port,
        "--out",
        &folder.path("out"),
    ]);
    run.wait_for_output("running");
    // The machine needs machine time to reach its speed, which may be slower than real time. The
    // size of the recording is the measure: one record every 20 ms.
    let recording = folder.path("out/recording.hmr");
    let size = || std::fs::metadata(&recording).map_or(0, |file| file.len());
    let mut header = 0;
    while header == 0 || size() < header + 40 * RECORD_BYTES as u64 {
        header = if header == 0 { size() } else { header };
        assert!(run.runs());
        std::thread::sleep(Duration::from_millis(5));
    }
    run
}

/// Checks that the job of [`start_job`] stopped along its path and kept its results.
#[track_caller]
fn expect_stopped(folder: &TestFolder) {
    let summary = folder.summary("out");
    assert_eq!(summary["completed"], false);
    assert_eq!(summary["final_state"], "Idle", "{summary:#}");
    assert_eq!(summary["position_kept"], true);
    assert_eq!(
        summary["faults"],
        serde_json::Value::Array(Vec::new()),
        "{summary:#}"
    );
    let (duration, length) = (
        number(&summary, "duration_s"),
        number(&summary, "path_length_mm"),
    );
    assert!((0.3..20.0).contains(&duration), "{summary:#}");
    assert!(length > 1.0 && length < 200.0, "{summary:#}");
    // After a stop along the path the tool is on the path.
    assert!(
        number(&summary, "contour_error_max_mm") < 0.1,
        "{summary:#}"
    );
    assert!(folder.read("out/trace.csv").lines().count() > 5);
    assert!(folder.read("out/report.html").contains("</html>"));
}

/// Checks that a job runs without homing again.
#[track_caller]
fn expect_run_without_homing(served: &SimServer, folder: &TestFolder) {
    let ran = served.run_ok(&[
        "run",
        &short_program(folder),
        "--out",
        &folder.path("again"),
    ]);
    assert!(!ran.out.contains("homing"), "{}", ran.out);
    assert_eq!(folder.summary("again")["completed"], true);
    assert_eq!(folder.summary("again")["final_state"], "Idle");
}

#[test]
fn simple_commands_in_sequence() {
    let served = SimServer::on_tcp(&[]);
    let status = served.status();
    assert_eq!(
        (&status["state"], &status["homed"]),
        (&"Disabled".into(), &false.into()),
        "{status:#}"
    );
    // As docs/getting-started.md quotes it.
    let page = std::fs::read_to_string(scene::root().join("docs/getting-started.md")).unwrap();
    let shown = served.run_ok(&["status"]).out;
    let rows = [
        "h4: disabled, homed: no\n\
         positions  not referenced; `haptimill home` finds the reference\n",
        "\ncommanded  nothing: the drives are off\n",
    ];
    for row in rows {
        assert!(shown.contains(row), "{shown}");
        assert!(page.contains(row), "{row}");
    }
    // The machine is not homed: an error message with its exit code.
    let refused = served.run(&["home", "--timeout", "0"]);
    assert_eq!(refused.code, 2);
    assert_eq!(served.run_ok(&["enable", "--json"]).json()["state"], "Idle");
    let homed = served.run_ok(&["home", "--json"]).json();
    assert_eq!(
        (&homed["state"], &homed["homed"]),
        (&"Idle".into(), &true.into()),
        "{homed:#}"
    );
    assert_eq!(homed["machine"], "h4");
    assert_eq!(served.status()["speed_factor"], 0.0);
    // The home pose of the presets: X0 Y0 Z21.232.
    let at = |value: &serde_json::Value, name: &str| number(&value["commanded"], name);
    assert!(
        at(&homed, "x").abs() < 1e-3 && (at(&homed, "z") - 21.232).abs() < 1e-3,
        "{homed:#}"
    );
    assert!(number(&homed["following_error"], "l1").abs() < 0.02);

    // 10 mm/s for one second, less the acceleration; the stop follows.
    let jogged = served
        .run_ok(&["jog", "x=10", "z=-2", "--for", "1", "--json"])
        .json();
    assert_eq!(jogged["state"], "Idle");
    let (x, z) = (at(&jogged, "x"), at(&jogged, "z") - 21.232);
    assert!((8.5..12.0).contains(&x), "{jogged:#}");
    assert!(
        (z + x / 5.0).abs() < 0.1,
        "the ratio of the rates is kept: {jogged:#}"
    );
    // The machine is at standstill afterwards.
    assert_eq!(served.status()["commanded"], jogged["commanded"]);
    served.run_ok(&["jog", "theta=25", "--for", "1.3"]);
    let limited = served
        .run(&["jog", "theta=20", "--for", "1.5", "--json"])
        .expect_code(0);
    let theta = at(&limited.json(), "theta");
    // The stroke of a joint limits the jog before the soft limit of 35 degrees.
    assert!(theta > 29.0 && theta < 34.9, "{limited:?}");
    let expected = format!(
        "theta stopped at {theta:.3} deg, before its upper soft limit of 35 deg: farther on, l2 \
         would leave its stroke by "
    );
    assert!(limited.err.starts_with(&expected), "{limited:?}");
    assert_eq!(limited.err.lines().count(), 1, "{}", limited.err);
    served.run_ok(&["jog", "theta=-20", "--for", "1.5"]);
    let axis = served.run(&["jog", "q=1"]).expect_code(2);
    assert!(
        axis.err.contains("x, y, z, theta (or B), alpha (or A)"),
        "{}",
        axis.err
    );
    // Letters of part programs: A is the table, B the tilt.
    let turned = served
        .run_ok(&["jog", "a=5", "--for", "0.5", "--json"])
        .json();
    assert!(at(&turned, "alpha") > 1.5, "{turned:#}");
    let by = format!("alpha={:.3}", -39.0 - at(&turned, "alpha"));
    served.run_ok(&["jog", "--by", &by, "--feed", "1800"]);
    let limited = served
        .run(&["jog", "alpha=-10", "--for", "1", "--json"])
        .expect_code(0);
    let alpha = at(&limited.json(), "alpha");
    assert!((-40.0..-39.98).contains(&alpha), "{limited:?}");
    let expected = "alpha stopped at its lower soft limit of -40 deg; jog it the other way, or change \
                    `low_deg`";
    assert!(limited.err.starts_with(expected), "{limited:?}");
    let twice = served.run(&["jog", "A=5", "alpha=5"]).expect_code(2);
    assert!(twice.err.contains("alpha is given twice"), "{}", twice.err);
    let fast = served.run(&["jog", "x=500"]).expect_code(2);
    assert!(fast.err.contains("at most 50"), "{}", fast.err);

    assert_eq!(served.run_ok(&["stop", "--json"]).json()["state"], "Idle");
    assert_eq!(
        served.run_ok(&["disable", "--json"]).json()["state"],
        "Disabled"
    );
    let refused = served.run(&["jog", "x=1"]).expect_code(8);
    assert!(refused.err.starts_with("jog: "), "{}", refused.err);
    assert_eq!(
        served.run_ok(&["reset", "--json"]).json()["state"],
        "Disabled"
    );
    let shown = served.run_ok(&["status"]);
    assert!(
        shown.out.contains("h4: disabled, homed: yes"),
        "{}",
        shown.out
    );
    assert!(
        shown.out.contains(" mm  theta ") && shown.out.contains(" deg\n"),
        "{}",
        shown.out
    );
    assert!(!shown.out.contains("not referenced"), "{}", shown.out);
}

#[test]
fn job_runs_on_a_pseudo_terminal_and_again_without_homing() {
    let folder = TestFolder::new();
    let link = folder.path("machine");
    let mut served = SimServer::on("pty", &["--link", &link]);
    assert!(served.port.starts_with("/dev/"), "{}", served.port);
    served.port = link.clone();
    let ran = served.run_ok(&[
        "run",
        &short_program(&folder),
        "--out",
        &folder.path("out"),
        "--json",
    ]);
    let summary = ran.json();
    assert_eq!(
        (&summary["completed"], &summary["underruns"]),
        (&true.into(), &0.into()),
        "{summary:#}"
    );
    assert_eq!(summary["tool_is_true"], false);
    assert!(number(&summary, "tool_error_max_mm") < 0.05, "{summary:#}");
    assert!(
        (number(&summary, "path_length_mm") - (10.0 + 5.0 * std::f64::consts::PI)).abs() < 1.0,
        "{summary:#}"
    );
    expect_run_without_homing(&served, &folder);
    // The symbolic link is removed with the process.
    served.process.interrupt();
    assert_eq!(served.process.end().code, 0);
    assert!(!std::path::Path::new(&link).exists());
}

#[test]
fn second_host_is_refused_and_its_stop_is_obeyed() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let run = start_job(&served, &folder, &long_program(&folder));
    let second = served.run(&["disable", "--json"]).expect_code(5);
    assert!(
        second.err.contains("another host is connected")
            && second.err.contains("haptimill watch")
            && !second.err.contains("fuser"),
        "{}",
        second.err
    );
    assert_eq!(second.json()["exit_code"], 5);
    assert_eq!(second.json()["error"].as_str(), Some(second.err.trim_end()));
    let second = served
        .run(&[
            "run",
            &short_program(&folder),
            "--out",
            &folder.path("second"),
        ])
        .expect_code(5);
    assert!(
        second.err.contains("another host is connected"),
        "{}",
        second.err
    );
    let stop = served.run_ok(&["stop"]);
    assert!(
        stop.out.contains("stop sent") && !stop.out.contains("another host"),
        "{}",
        stop.out
    );
    let ran = run.end().expect_code(7);
    assert!(ran.err.contains("stopped from elsewhere"), "{}", ran.err);
    expect_stopped(&folder);
    let status = served.status();
    assert_eq!(
        (&status["state"], &status["homed"]),
        (&"Idle".into(), &true.into()),
        "{status:#}"
    );
    expect_run_without_homing(&served, &folder);
}

#[test]
fn second_host_on_a_pseudo_terminal_is_refused_and_its_stop_is_obeyed() {
    let folder = TestFolder::new();
    let served = SimServer::on("pty", &[]);
    let run = start_job(&served, &folder, &long_program(&folder));
    let second = served.run(&["disable"]).expect_code(5);
    assert!(
        second.err.contains("another program uses it") && second.err.contains("fuser /dev/"),
        "{}",
        second.err
    );
    served.run_ok(&["stop"]);
    let ran = run.end().expect_code(7);
    assert!(ran.err.contains("stopped from elsewhere"), "{}", ran.err);
    expect_stopped(&folder);
    assert_eq!(served.status()["state"], "Idle");
}

#[test]
fn ctrl_c_stops_a_job_along_its_path() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let run = start_job(&served, &folder, &long_program(&folder));
    run.interrupt();
    let ran = run.end().expect_code(7);
    assert!(
        ran.err
            .contains("stopped by the user; the position is kept"),
        "{}",
        ran.err
    );
    expect_stopped(&folder);
    expect_run_without_homing(&served, &folder);
}

#[test]
fn dead_host_is_detected_and_the_machine_stops_along_its_path() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let mut run = start_job(&served, &folder, &long_program(&folder));
    run.kill();
    // The heartbeat is 500 ms, the deceleration 300 ms. A new host is refused until the heartbeat
    // stop has begun, so that it cannot hide the loss of the old one.
    let lost = Instant::now();
    let status = loop {
        assert!(lost.elapsed() < Duration::from_secs(10));
        let ran = served.run(&["status", "--json"]);
        if ran.code != 0 {
            let why = "another host is connected";
            assert!(ran.code == 5 && ran.err.contains(why), "{ran:?}");
            continue;
        }
        let status = ran.json();
        if status["state"] == "Fault" {
            break status;
        }
        assert_eq!(status["state"], "Hold", "{status:#}");
    };
    assert!(
        status["fault"].as_str().unwrap().contains("host"),
        "{status:#}"
    );
    assert_eq!(status["homed"], true, "{status:#}");
    // On the line from X0 to X20.
    let x = number(&status["commanded"], "x");
    assert!(
        (-0.01..=20.01).contains(&x) && number(&status["commanded"], "y").abs() < 1e-3,
        "{status:#}"
    );
    let refused = served
        .run(&[
            "run",
            &short_program(&folder),
            "--out",
            &folder.path("again"),
        ])
        .expect_code(6);
    assert!(refused.err.contains("haptimill reset"), "{}", refused.err);
    served.run_ok(&["reset"]);
    expect_run_without_homing(&served, &folder);
}

#[test]
fn dead_controller_is_detected_and_the_trace_is_kept() {
    let folder = TestFolder::new();
    let mut served = SimServer::on_tcp(&[]);
    let run = start_job(&served, &folder, &long_program(&folder));
    served.process.kill();
    let died = Instant::now();
    let ran = run.end().expect_code(5);
    assert!(
        died.elapsed() < Duration::from_secs(5),
        "{:?}",
        died.elapsed()
    );
    assert!(ran.err.contains("the connection is lost"), "{}", ran.err);
    let summary = folder.summary("out");
    assert_eq!(
        (&summary["final_state"], &summary["completed"]),
        (&"Unknown".into(), &false.into()),
        "{summary:#}"
    );
    assert!(number(&summary, "duration_s") > 0.3, "{summary:#}");
    assert!(folder.read("out/trace.csv").lines().count() > 5);
    assert!(folder.read("out/report.html").contains("</html>"));
}

#[test]
fn suspended_controller_times_out_after_one_second() {
    let folder = TestFolder::new();
    let served = SimServer::on("pty", &[]);
    let run = start_job(&served, &folder, &long_program(&folder));
    served.process.suspend();
    let froze = Instant::now();
    let ran = run.end().expect_code(5);
    assert!(
        froze.elapsed() < Duration::from_secs(5),
        "{:?}",
        froze.elapsed()
    );
    assert!(
        ran.err.contains("nothing was received from the controller"),
        "{}",
        ran.err
    );
    assert_eq!(folder.summary("out")["final_state"], "Unknown");
}

#[test]
fn emergency_stop_is_latched_until_reset() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let stopped = served.run_ok(&["stop", "--emergency", "--json"]).json();
    assert_eq!(stopped["state"], "EmergencyStop", "{stopped:#}");
    assert_eq!(served.status()["state"], "EmergencyStop");
    let refused = served.run(&["enable"]).expect_code(8);
    assert!(refused.err.starts_with("enable: "), "{}", refused.err);
    let refused = served
        .run(&["run", &short_program(&folder), "--out", &folder.path("out")])
        .expect_code(6);
    assert!(refused.err.contains("haptimill reset"), "{}", refused.err);
    assert_eq!(
        served.run_ok(&["reset", "--json"]).json()["state"],
        "Disabled"
    );
    assert_eq!(served.run_ok(&["enable", "--json"]).json()["state"], "Idle");
    served.run_ok(&["run", &short_program(&folder), "--out", &folder.path("out")]);
    assert_eq!(folder.summary("out")["completed"], true);
}

#[test]
fn lost_position_is_homed_from_presets() {
    // The machine has reached its home pose, which is that of the presets, when the encoder fault
    // begins.
    let fault = "encoder-noise joint=l2 per-second=5000 at=10s for=200ms";
    let served = SimServer::on_tcp(&["--fault", fault]);
    served.run_ok(&["home"]);
    let refused = served.run(&["home", "--at-preset"]).expect_code(8);
    assert!(
        refused
            .err
            .contains("the drives are on; `haptimill disable`"),
        "{}",
        refused.err
    );
    let begun = Instant::now();
    let lost = loop {
        let status = served.status();
        // Control periods of 200 us: the fault has ended.
        if status["state"] == "Fault" && number(&status, "period") > 52_000.0 {
            break status;
        }
        assert!(begun.elapsed() < scene::LIMIT, "{status:#}");
        std::thread::sleep(Duration::from_millis(100));
    };
    assert_eq!(lost["homed"], false, "{lost:#}");
    let refused = served.run(&["home", "--at-preset"]).expect_code(8);
    assert!(
        refused
            .err
            .contains("a fault is latched; `haptimill reset`"),
        "{}",
        refused.err
    );
    served.run_ok(&["reset"]);
    // The refused attempt set no position.
    let refused = served.run(&["home"]).expect_code(8);
    assert!(refused.err.contains("--at-preset"), "{}", refused.err);
    served.run_ok(&["disable"]);
    let homed = served.run_ok(&["home", "--at-preset", "--json"]).json();
    assert_eq!(
        (&homed["homed"], &homed["state"]),
        (&true.into(), &"Idle".into()),
        "{homed:#}"
    );
    for (joint, preset) in [("l1", 1135.0), ("l2", 485.0), ("l3", 1135.0), ("l4", 485.0)] {
        let at = number(&homed["joints"], joint);
        assert!((at - preset).abs() < 0.05, "{joint} at {at}");
    }
}

#[test]
fn run_refuses_simulator_options_on_a_port() {
    let folder = TestFolder::new();
    let program = short_program(&folder);
    let out = folder.path("none");
    for (option, value, part) in [
        ("--seed", "7", "--seed 7 is for the simulator"),
        (
            "--fault",
            "drive-dead joint=l1 at=1s",
            "haptimill sim serve",
        ),
        ("--baud", "9600", "leave it out with tcp:"),
    ] {
        let run = ["run", &program, "--port", "tcp:localhost:1", "--out", &out];
        let ran = scene::haptimill(&[&run[..], &[option, value]].concat()).expect_code(2);
        assert!(ran.err.contains(part), "{}", ran.err);
    }
    assert!(!std::path::Path::new(&out).exists());
}

#[test]
fn pause_waits_for_enter_and_ignores_an_earlier_one() {
    use haptimill_client::port::{PtyServer, Transport};
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let program = folder.file("pause.ngc", "G1 X3 F600\nM0 (turn the work)\nG1 X0\nM30\n");
    // A terminal on standard input.
    let mut terminal = PtyServer::open().unwrap();
    let input = std::fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(terminal.name())
        .unwrap();
    let mut enter = || {
        // With a byte before Enter that is not text.
        let pressed = terminal.write(b"\xe9\n", Duration::from_secs(1)).unwrap();
        assert_eq!(pressed, 2);
    };
    let out = folder.path("out");
    let run = ["run", &program, "--port", &served.port, "--out", &out];
    let mut run = scene::start_with(&run, input.into());
    // An Enter during homing skips no pause.
    enter();
    run.wait_for_error("line 2 (turn the work): the program pauses; press Enter");
    let paused = Instant::now();
    while paused.elapsed() < Duration::from_millis(700) {
        assert!(run.runs(), "{:?}", run.end());
        std::thread::sleep(Duration::from_millis(20));
    }
    enter();
    run.end().expect_code(0);
    let summary = folder.summary("out");
    assert_eq!(summary["completed"], true, "{summary:#}");
    // The duration of the job includes the pause; the motion takes 0.8 s.
    assert!(number(&summary, "duration_s") > 1.2, "{summary:#}");
}
