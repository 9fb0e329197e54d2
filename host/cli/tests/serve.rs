//! The simulated machine as a device in real time, and everything that several programs can do to it: one-shot commands, jobs, stops
//! from elsewhere, and processes that die.
#![cfg(unix)]

mod scene;

use haptimill_trace::RECORD_BYTES;
use scene::{Folder, Served, Started, number, start};
use std::time::{Duration, Instant};

/// Back and forth for half a minute of machine time, at 10 mm/s.
fn long_program(folder: &Folder) -> String {
    let turns: String = (0..15).map(|_| "G1 X20\nG1 X0\n").collect();
    folder.file("long.ngc", format!("G21 G90 F600\n{turns}M30\n"))
}

/// There and back, about 2 s.
fn short_program(folder: &Folder) -> String {
    folder.file("short.ngc", "G21 G90 F600\nG1 X-5\nG3 X5 I5\nG1 X0\nM30\n")
}

/// A run on a served machine that is in the middle of its way.
fn under_way(served: &Served, folder: &Folder, program: &str) -> Started {
    let mut run = start(&[
        "run",
        program,
        "--port",
        &served.port,
        "--out",
        &folder.path("out"),
    ]);
    run.says("running");
    // Machine time has to pass until it is at speed, and it may be slower than real time: the recording tells, a record every 20 ms.
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

/// The job of [`under_way`] was stopped on its path, and everything was kept.
#[track_caller]
fn was_stopped(folder: &Folder) {
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
    // A stop along the path leaves the tool on the path.
    assert!(
        number(&summary, "contour_error_max_mm") < 0.1,
        "{summary:#}"
    );
    assert!(folder.read("out/trace.csv").lines().count() > 5);
    assert!(folder.read("out/report.html").contains("</html>"));
}

/// A whole job runs, without homing again.
#[track_caller]
fn runs_without_homing(served: &Served, folder: &Folder) {
    let ran = served.does(&[
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
fn one_shot_commands_follow_each_other() {
    let served = Served::on_tcp(&[]);
    let status = served.status();
    assert_eq!(
        (&status["state"], &status["homed"]),
        (&"Disabled".into(), &false.into()),
        "{status:#}"
    );
    // Nothing to be done yet: told in words, with its own code.
    let refused = served.tries(&["home", "--timeout", "0"]);
    assert_eq!(refused.code, 2);
    assert_eq!(served.does(&["enable", "--json"]).json()["state"], "Idle");
    let homed = served.does(&["home", "--json"]).json();
    assert_eq!(
        (&homed["state"], &homed["homed"]),
        (&"Idle".into(), &true.into()),
        "{homed:#}"
    );
    assert_eq!(homed["machine"], "h4");
    // The home pose of the presets: X0 Y0 Z21.232.
    let at = |value: &serde_json::Value, name: &str| number(&value["commanded"], name);
    assert!(
        at(&homed, "x").abs() < 1e-3 && (at(&homed, "z") - 21.232).abs() < 1e-3,
        "{homed:#}"
    );
    assert!(number(&homed["following_error"], "l1").abs() < 0.02);

    // 10 mm/s for a second, less the time to speed up; the stop comes after.
    let jogged = served
        .does(&["jog", "x=10", "z=-2", "--for", "1", "--json"])
        .json();
    assert_eq!(jogged["state"], "Idle");
    let (x, z) = (at(&jogged, "x"), at(&jogged, "z") - 21.232);
    assert!((8.5..12.0).contains(&x), "{jogged:#}");
    assert!(
        (z + x / 5.0).abs() < 0.1,
        "the ratio of the rates is kept: {jogged:#}"
    );
    // Nothing moves afterwards.
    assert_eq!(served.status()["commanded"], jogged["commanded"]);
    served.does(&["jog", "theta=25", "--for", "1.3"]);
    let limited = served
        .tries(&["jog", "theta=20", "--for", "1.5", "--json"])
        .ended_with(0);
    let theta = at(&limited.json(), "theta");
    assert!(
        limited.err.contains("theta stopped in front of its limit"),
        "{limited:?}"
    );
    // Here it is a slide's stroke that ends it, before the soft limit of 35 degrees.
    assert!(theta > 29.0 && theta <= 35.0, "{limited:?}");
    assert_eq!(limited.err.lines().count(), 1, "{}", limited.err);
    served.does(&["jog", "theta=-20", "--for", "1.5"]);
    let axis = served.tries(&["jog", "q=1"]).ended_with(2);
    assert!(
        axis.err.contains("x, y, z, theta (or B), alpha (or A)"),
        "{}",
        axis.err
    );
    // By the letters of part programs: A is the table, B the tilt.
    let turned = served
        .does(&["jog", "a=5", "--for", "0.5", "--json"])
        .json();
    assert!(at(&turned, "alpha") > 1.5, "{turned:#}");
    let twice = served.tries(&["jog", "A=5", "alpha=5"]).ended_with(2);
    assert!(twice.err.contains("alpha is given twice"), "{}", twice.err);
    let fast = served.tries(&["jog", "x=500"]).ended_with(2);
    assert!(fast.err.contains("at most 50"), "{}", fast.err);

    assert_eq!(served.does(&["stop", "--json"]).json()["state"], "Idle");
    assert_eq!(
        served.does(&["disable", "--json"]).json()["state"],
        "Disabled"
    );
    let refused = served.tries(&["jog", "x=1"]).ended_with(8);
    assert!(refused.err.starts_with("jog: "), "{}", refused.err);
    assert_eq!(
        served.does(&["reset", "--json"]).json()["state"],
        "Disabled"
    );
    let shown = served.does(&["status"]);
    assert!(
        shown
            .out
            .contains("h4: Disabled, homed: yes, position kept: yes"),
        "{}",
        shown.out
    );
}

#[test]
fn a_job_runs_on_a_pseudo_terminal_and_again_without_homing() {
    let folder = Folder::new();
    let link = folder.path("machine");
    let mut served = Served::on("pty", &["--link", &link]);
    assert!(served.port.starts_with("/dev/"), "{}", served.port);
    served.port = link.clone();
    let ran = served.does(&[
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
    runs_without_homing(&served, &folder);
    // The link goes with the machine.
    served.process.interrupt();
    assert_eq!(served.process.end().code, 0);
    assert!(!std::path::Path::new(&link).exists());
}

#[test]
fn a_second_program_is_sent_away_and_a_stop_from_it_is_heard() {
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    let run = under_way(&served, &folder, &long_program(&folder));
    let second = served.tries(&["status", "--json"]).ended_with(5);
    assert!(
        second.err.contains("another host is connected") && !second.err.contains("fuser"),
        "{}",
        second.err
    );
    assert_eq!(second.json()["exit_code"], 5);
    assert_eq!(second.json()["error"].as_str(), Some(second.err.trim_end()));
    let second = served
        .tries(&[
            "run",
            &short_program(&folder),
            "--out",
            &folder.path("second"),
        ])
        .ended_with(5);
    assert!(
        second.err.contains("another host is connected"),
        "{}",
        second.err
    );
    let stop = served.does(&["stop"]);
    assert!(stop.out.contains("stop sent"), "{}", stop.out);
    let ran = run.end().ended_with(7);
    assert!(ran.err.contains("stopped from elsewhere"), "{}", ran.err);
    was_stopped(&folder);
    let status = served.status();
    assert_eq!(
        (&status["state"], &status["position_kept"]),
        (&"Idle".into(), &true.into()),
        "{status:#}"
    );
    runs_without_homing(&served, &folder);
}

#[test]
fn a_second_program_on_a_pseudo_terminal_is_sent_away_and_its_stop_is_heard() {
    let folder = Folder::new();
    let served = Served::on("pty", &[]);
    let run = under_way(&served, &folder, &long_program(&folder));
    let second = served.tries(&["status"]).ended_with(5);
    assert!(
        second.err.contains("another program uses it") && second.err.contains("fuser /dev/"),
        "{}",
        second.err
    );
    served.does(&["stop"]);
    let ran = run.end().ended_with(7);
    assert!(ran.err.contains("stopped from elsewhere"), "{}", ran.err);
    was_stopped(&folder);
    assert_eq!(served.status()["state"], "Idle");
}

#[test]
fn ctrl_c_stops_a_job_on_its_path() {
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    let run = under_way(&served, &folder, &long_program(&folder));
    run.interrupt();
    let ran = run.end().ended_with(7);
    assert!(
        ran.err
            .contains("stopped by the user; the position is kept"),
        "{}",
        ran.err
    );
    was_stopped(&folder);
    runs_without_homing(&served, &folder);
}

#[test]
fn a_host_that_dies_is_noticed_and_the_machine_stops_on_its_path() {
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    let mut run = under_way(&served, &folder, &long_program(&folder));
    run.kill();
    // The heartbeat is 500 ms, slowing down 300 ms. A new host that comes at once is sent away until the machine brakes for want of the old
    // one: it must not hide the loss.
    let lost = Instant::now();
    let status = loop {
        assert!(lost.elapsed() < Duration::from_secs(10));
        let ran = served.tries(&["status", "--json"]);
        if ran.code != 0 {
            let why = "another program is connected";
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
    assert_eq!(status["position_kept"], true, "{status:#}");
    // On the line from X0 to X20.
    let x = number(&status["commanded"], "x");
    assert!(
        (-0.01..=20.01).contains(&x) && number(&status["commanded"], "y").abs() < 1e-3,
        "{status:#}"
    );
    let refused = served
        .tries(&[
            "run",
            &short_program(&folder),
            "--out",
            &folder.path("again"),
        ])
        .ended_with(6);
    assert!(refused.err.contains("haptimill reset"), "{}", refused.err);
    served.does(&["reset"]);
    runs_without_homing(&served, &folder);
}

#[test]
fn a_machine_that_dies_is_noticed_and_the_trace_is_kept() {
    let folder = Folder::new();
    let mut served = Served::on_tcp(&[]);
    let run = under_way(&served, &folder, &long_program(&folder));
    served.process.kill();
    let died = Instant::now();
    let ran = run.end().ended_with(5);
    assert!(
        died.elapsed() < Duration::from_secs(5),
        "{:?}",
        died.elapsed()
    );
    assert!(ran.err.contains("the other end is gone"), "{}", ran.err);
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
fn a_frozen_machine_is_given_up_after_a_second() {
    let folder = Folder::new();
    let served = Served::on("pty", &[]);
    let run = under_way(&served, &folder, &long_program(&folder));
    served.process.freeze();
    let froze = Instant::now();
    let ran = run.end().ended_with(5);
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
fn an_emergency_stop_is_latched_until_it_is_reset() {
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    served.does(&["home"]);
    let stopped = served.does(&["stop", "--emergency", "--json"]).json();
    assert_eq!(stopped["state"], "EmergencyStop", "{stopped:#}");
    assert_eq!(served.status()["state"], "EmergencyStop");
    let refused = served.tries(&["enable"]).ended_with(8);
    assert!(refused.err.starts_with("enable: "), "{}", refused.err);
    let refused = served
        .tries(&["run", &short_program(&folder), "--out", &folder.path("out")])
        .ended_with(6);
    assert!(refused.err.contains("haptimill reset"), "{}", refused.err);
    assert_eq!(
        served.does(&["reset", "--json"]).json()["state"],
        "Disabled"
    );
    assert_eq!(served.does(&["enable", "--json"]).json()["state"], "Idle");
    served.does(&["run", &short_program(&folder), "--out", &folder.path("out")]);
    assert_eq!(folder.summary("out")["completed"], true);
}

#[test]
fn a_machine_that_lost_its_position_is_homed_from_its_presets() {
    // The machine is long at its home pose, which is that of the presets, when the encoder goes mad.
    let fault = "encoder-noise axis=l2 per-second=5000 at=10s for=200ms";
    let served = Served::on_tcp(&["--fault", fault]);
    served.does(&["home"]);
    let refused = served.tries(&["home", "--at-preset"]).ended_with(8);
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
        // Periods of 200 us: the noise is over.
        if status["state"] == "Fault" && number(&status, "period") > 52_000.0 {
            break status;
        }
        assert!(begun.elapsed() < scene::LIMIT, "{status:#}");
        std::thread::sleep(Duration::from_millis(100));
    };
    assert_eq!(
        (&lost["position_kept"], &lost["homed"]),
        (&false.into(), &false.into()),
        "{lost:#}"
    );
    let refused = served.tries(&["home", "--at-preset"]).ended_with(8);
    assert!(
        refused
            .err
            .contains("a fault is latched; `haptimill reset`"),
        "{}",
        refused.err
    );
    served.does(&["reset"]);
    // Nothing was set by the attempt: the search still has nothing to begin from.
    let refused = served.tries(&["home"]).ended_with(8);
    assert!(refused.err.contains("--at-preset"), "{}", refused.err);
    served.does(&["disable"]);
    let homed = served.does(&["home", "--at-preset", "--json"]).json();
    assert_eq!(
        (&homed["homed"], &homed["position_kept"], &homed["state"]),
        (&true.into(), &true.into(), &"Idle".into()),
        "{homed:#}"
    );
    for (joint, preset) in [("l1", 1135.0), ("l2", 485.0), ("l3", 1135.0), ("l4", 485.0)] {
        let at = number(&homed["joints"], joint);
        assert!((at - preset).abs() < 0.05, "{joint} at {at}");
    }
}

#[test]
fn a_run_refuses_what_means_nothing_on_a_port() {
    let folder = Folder::new();
    let program = short_program(&folder);
    let out = folder.path("none");
    for (option, value, part) in [
        ("--seed", "7", "--seed 7 is for the simulator"),
        ("--fault", "drive-dead axis=l1 at=1s", "haptimill sim serve"),
        ("--baud", "9600", "leave it out with tcp:"),
    ] {
        let run = ["run", &program, "--port", "tcp:localhost:1", "--out", &out];
        let ran = scene::haptimill(&[&run[..], &[option, value]].concat()).ended_with(2);
        assert!(ran.err.contains(part), "{}", ran.err);
    }
    assert!(!std::path::Path::new(&out).exists());
}

#[test]
fn a_pause_waits_for_enter_and_for_no_enter_of_before() {
    use haptimill_client::port::{PtyServer, Transport};
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    let program = folder.file("pause.ngc", "G1 X3 F600\nM0 (turn the work)\nG1 X0\nM30\n");
    // A person's terminal.
    let mut terminal = PtyServer::open().unwrap();
    let input = std::fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(terminal.name())
        .unwrap();
    let mut enter = || {
        // With a key in front that is no text.
        let pressed = terminal.write(b"\xe9\n", Duration::from_secs(1)).unwrap();
        assert_eq!(pressed, 2);
    };
    let out = folder.path("out");
    let run = ["run", &program, "--port", &served.port, "--out", &out];
    let mut run = scene::start_with(&run, input.into());
    // Impatience while it homes passes nothing.
    enter();
    run.complains("line 2: the program pauses; Enter goes on");
    let paused = Instant::now();
    while paused.elapsed() < Duration::from_millis(700) {
        assert!(run.runs(), "{:?}", run.end());
        std::thread::sleep(Duration::from_millis(20));
    }
    enter();
    run.end().ended_with(0);
    let summary = folder.summary("out");
    assert_eq!(summary["completed"], true, "{summary:#}");
    // The pause is in the time that the job took: there and back is 0.8 s.
    assert!(number(&summary, "duration_s") > 1.2, "{summary:#}");
}
