//! Single commands on a served simulator in real time: enable, jog, force.
#![cfg(unix)]

use crate::scene;
use scene::{SimServer, TestFolder, start};
use std::time::Duration;

#[test]
fn enable_reports_what_prevents_it() {
    for (fault, named) in [
        (
            "switch-stuck joint=l2 switch=limit-low active=yes",
            "l2 is on its limit switch",
        ),
        ("drive-tripped joint=l4", "the drive of l4 is not ready"),
        ("emergency-stop", "remove the cause, then reset"),
    ] {
        let served = SimServer::on_tcp(&["--fault", fault]);
        let refused = served.run(&["enable"]).expect_code(8);
        assert!(refused.err.contains(named), "{fault}: {}", refused.err);
    }
    let served = SimServer::on_tcp(&["--fault", "emergency-stop"]);
    let refused = served.run(&["reset"]).expect_code(8);
    assert!(refused.err.contains("is pressed"), "{}", refused.err);
}

/// Starts a jog on a homed machine.
fn start_jog(served: &SimServer) -> scene::Running {
    served.run_ok(&["home"]);
    let mut jog = start(&["jog", "x=2", "--for", "60", "--port", &served.port]);
    jog.wait_for_output("jogging");
    jog
}

#[test]
fn ctrl_c_stops_a_jog() {
    let served = SimServer::on_tcp(&[]);
    let jog = start_jog(&served);
    std::thread::sleep(Duration::from_millis(500));
    jog.interrupt();
    let ended = jog.end().expect_code(7);
    assert!(ended.err.contains("stopped by the user"), "{}", ended.err);
    // The machine is at standstill before the command ends.
    let status = served.status();
    assert_eq!(status["state"], "Idle", "{status:#}");
    assert!(scene::number(&status["commanded"], "x") > 0.0, "{status:#}");
}

#[test]
fn emergency_stop_ends_a_jog_with_the_fault_code() {
    let served = SimServer::on_tcp(&["--fault", "emergency-stop at=12s"]);
    let ended = start_jog(&served).end().expect_code(6);
    assert!(ended.err.contains("emergency stop"), "{}", ended.err);
}

#[test]
fn force_settings_are_read_set_and_range_checked() {
    let served = SimServer::on_tcp(&["--unconfigured"]);
    let nothing = served.run(&["force", "show"]).expect_code(8);
    assert!(nothing.err.contains("haptimill home"), "{}", nothing.err);
    served.run_ok(&["home", "--machine", "machines/h4.toml"]);
    let shown = served.run_ok(&["force", "show", "--json"]).json();
    assert_eq!(shown["under_control"], serde_json::json!([]), "{shown:#}");
    assert_eq!(shown["tared"], false);
    let set = [
        "force",
        "set",
        "z,x",
        "--force-setpoint",
        "6",
        "--virtual-mass",
        "1.5",
        "--virtual-damping",
        "4",
        "--enable-condition",
        "any",
        "--json",
    ];
    let set = served.run_ok(&set).json();
    assert_eq!(
        set["under_control"],
        serde_json::json!(["x", "z"]),
        "{set:#}"
    );
    for (option, value, bound) in [
        ("--force-setpoint", "0", "0.500 N or more"),
        ("--force-setpoint", "-5", "0.500 N or more"),
        ("--force-setpoint", "90", "71.246 N or less"),
        ("--virtual-damping", "0.1", "0.406 N s/mm or more"),
        ("--virtual-mass", "0.0001", "N s^2/mm or more"),
        ("--rate", "0", "must be above 0"),
    ] {
        let refused = served
            .run(&["force", "set", "x", option, value])
            .expect_code(8);
        assert!(refused.err.contains("force loop of x"), "{}", refused.err);
        assert!(refused.err.contains(bound), "{}", refused.err);
    }
    served
        .run(&["force", "set", "x", "--force-setpoint", "nan"])
        .expect_code(2);
    served.run(&["force", "set", "alpha"]).expect_code(2);
    let none = served.run_ok(&["force", "set", "none", "--json"]).json();
    assert_eq!(none["under_control"], serde_json::json!([]), "{none:#}");
}

#[test]
fn force_control_needs_a_sensor() {
    let folder = TestFolder::new();
    let text = include_str!("../../../machines/h4.toml");
    let begins = text.find("[force]").expect("there");
    let ends = text.find("[plant]").expect("there");
    let blind = folder.file(
        "blind.toml",
        format!("{}{}", &text[..begins], &text[ends..]),
    );
    let program = "examples/e7-slot.ngc";
    let refused =
        scene::haptimill(&["run", program, "--machine", &blind, "--force", "x"]).expect_code(3);
    assert!(refused.err.contains("no force sensor"), "{}", refused.err);
    let refused = scene::haptimill(&["run", program, "--force-setpoint", "5"]).expect_code(2);
    assert!(refused.err.contains("--force"), "{}", refused.err);
}

/// The transcript of force commands, without the measured forces, which are noise.
#[test]
fn force_command_transcript() {
    let served = SimServer::on("pty", &["--unconfigured"]);
    let mut text = String::new();
    for command in [
        &["force", "show"][..],
        &["force", "tare"],
        &["force", "set", "x", "--force-setpoint", "4"],
        &["home", "--machine", "machines/h4.toml"],
        &["force", "show"],
        &["force", "tare"],
        &[
            "force",
            "set",
            "x,z",
            "--force-setpoint",
            "4",
            "--virtual-damping",
            "8",
            "--enable-condition",
            "any",
        ],
        &["force", "set", "z", "--limit", "3"],
        &["force", "set", "x", "--force-setpoint", "0"],
        &["force", "set", "x", "--force-setpoint", "90"],
        &["force", "set", "x", "--virtual-damping", "0.1"],
        &["force", "set", "x", "--virtual-mass", "0.001"],
        &["force", "set", "x", "--limit", "100"],
        &["force", "set", "none"],
    ] {
        let ran = served.run(command);
        text.push_str(&format!("$ haptimill {}\n", command.join(" ")));
        if command[0] == "force" {
            let reported = ran.out.lines();
            // The noise of the sensor differs from run to run.
            let is_measured = |line: &str| {
                let rows = ["peak force", "opposite end"];
                rows.iter().any(|row| line.starts_with(row))
            };
            for line in reported.filter(|line| !is_measured(line)) {
                text.push_str(&format!("{line}\n"));
            }
            text.push_str(&ran.err);
        }
        text.push_str(&format!("--- exit code {}\n", ran.code));
    }
    insta::assert_snapshot!(text);
}

#[test]
fn a_joint_is_moved_off_its_limit_switch() {
    let mill = "machines/mill3-servo.toml";
    let push = "push joint=x effort=45 at=1s for=5s";
    let served = SimServer::on_tcp(&["--machine", mill, "--fault", push]);
    let run = |command: &[&str]| served.run(&[command, &["--machine", mill]].concat());
    run(&["status"]).expect_code(0);
    // The push moves the joint with the drives off, onto its switch at 158 mm.
    let mut tries = 0;
    while !run(&["enable"])
        .err
        .contains("x is on its limit switch; move it off")
    {
        tries += 1;
        assert!(tries < 100, "{:?}", run(&["enable"]));
        run(&["disable"]);
        std::thread::sleep(Duration::from_millis(200));
    }
    std::thread::sleep(Duration::from_secs(6));
    let refused = run(&["move-off", "w"]).expect_code(2);
    assert!(
        refused.err.contains("the machine has x, y, z"),
        "{}",
        refused.err
    );
    let refused = run(&["move-off"]).expect_code(2);
    assert!(refused.err.contains("name the joint"), "{}", refused.err);
    let refused = run(&["move-off", "y"]).expect_code(8);
    assert!(
        refused.err.contains("y is on no limit switch"),
        "{}",
        refused.err
    );
    let done = run(&["move-off", "x", "--json"]).expect_code(0).json();
    assert_eq!(
        (&done["state"], &done["homed"]),
        (&"Idle".into(), &false.into()),
        "{done:#}"
    );
    let x = scene::number(&done["joints"], "x");
    assert!((140.0..155.0).contains(&x), "{x}");
    run(&["home"]).expect_code(0);
    // A switch that stays active ends the motion with a fault.
    let stuck = "switch-stuck joint=l2 switch=limit-low active=yes";
    let served = SimServer::on_tcp(&["--fault", stuck]);
    let ended = served.run(&["move-off", "l2"]).expect_code(6);
    assert!(ended.err.contains("did not open"), "{}", ended.err);
}

/// A board without a memory for it says so, and `status` has no row about one.
#[test]
fn store_is_refused_by_a_board_that_keeps_no_configuration() {
    let served = SimServer::on_tcp(&[]);
    let refused = served.run(&["store"]).expect_code(8);
    assert!(
        refused.err.contains("this board keeps no configuration"),
        "{refused:#?}"
    );
    let status = served.run(&["status"]).expect_code(0).out;
    assert!(!status.contains("kept "), "{status}");
    served.run(&["enable"]).expect_code(0);
    let refused = served.run(&["store"]).expect_code(8);
    assert!(refused.err.contains("the drives are on"), "{refused:#?}");
}

/// What a person needs who wires a board: each switch, alarm and the emergency stop by name.
#[test]
fn status_names_the_active_switches_alarms_and_emergency_stop() {
    let machine = "machines/mill3.toml";
    let serve = |faults: &[&str]| {
        let faults: Vec<&str> = faults.iter().flat_map(|it| ["--fault", *it]).collect();
        SimServer::on_tcp(&[&["--machine", machine], &faults[..]].concat())
    };
    let status = |served: &SimServer| {
        let text = served
            .run(&["status", "--machine", machine])
            .expect_code(0)
            .out;
        let lines = text.lines().find(|line| line.starts_with("lines"));
        let json = served
            .run(&["status", "--machine", machine, "--json"])
            .expect_code(0);
        (lines.unwrap_or(&text).to_string(), json.json())
    };
    let (lines, json) = status(&serve(&[]));
    let none = "lines      no switch, alarm or emergency stop is active";
    assert_eq!(lines, none);
    assert_eq!(json["active_lines"], serde_json::json!({}));
    assert_eq!(json["emergency_stop_open"], false);
    let (lines, json) = status(&serve(&[
        "switch-stuck joint=y switch=limit-high active=yes",
        "switch-stuck joint=y switch=home active=yes",
        "drive-tripped joint=z",
    ]));
    assert_eq!(lines, "lines      active: y home and limit-high, z alarm");
    let expected = serde_json::json!({ "y": ["home", "limit-high"], "z": ["alarm"] });
    assert_eq!(json["active_lines"], expected);
    let why = "the drive of z is not ready: its alarm input is active; check the drive and its \
               alarm line";
    assert_eq!(json["alarms"], serde_json::json!([why]));
    let (lines, json) = status(&serve(&["emergency-stop"]));
    assert!(lines.ends_with(", emergency stop"), "{lines}");
    assert_eq!(json["emergency_stop_open"], true);
}
