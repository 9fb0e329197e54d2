//! A board keeps its configuration: no command replaces it without --machine, and none switches the
//! drives on with the configuration of another machine.
#![cfg(unix)]

use crate::scene;
use scene::{RunResult, SimServer, TestFolder, haptimill};

/// The built-in machine with another name and shorter strokes.
fn machine_of_other_name(folder: &TestFolder, name: &str) -> String {
    let text = haptimill_machine_file::BUILT_IN.replacen("name = \"h4\"", "name = \"mill2\"", 1);
    assert!(text.contains("mill2"));
    folder.file(name, text)
}

/// The built-in machine with its name and another heartbeat.
fn machine_of_other_version(folder: &TestFolder) -> String {
    let text = haptimill_machine_file::BUILT_IN;
    let changed = text.replacen("heartbeat_ms = 500", "heartbeat_ms = 600", 1);
    assert_ne!(text, changed);
    folder.file("variant.toml", changed)
}

fn program(folder: &TestFolder) -> String {
    folder.file("short.ngc", "G21 G90 F600\nG1 X1\nG1 X0\nM30\n")
}

/// Name, state and CRC of the configuration.
fn status(served: &SimServer) -> (String, String, String) {
    let status = served.status();
    let text = |key: &str| status[key].as_str().unwrap_or_default().to_string();
    (text("machine"), text("state"), text("configuration_crc"))
}

#[track_caller]
fn expect_machine_required(ran: &RunResult) {
    assert!(ran.err.contains("--machine"), "{ran:#?}");
}

#[test]
fn no_command_replaces_the_configuration_without_machine() {
    let folder = TestFolder::new();
    let own = machine_of_other_name(&folder, "own.toml");
    let served = SimServer::on_tcp(&["--machine", &own]);
    served.run_ok(&["enable", "--machine", &own]);
    served.run_ok(&["disable"]);
    let before = status(&served);
    assert_eq!(
        (before.0.as_str(), before.1.as_str()),
        ("mill2", "Disabled")
    );
    let (program, out) = (program(&folder), folder.path("out"));
    for command in [
        &["home"][..],
        &["home", "--at-preset"],
        &["jog", "x=1", "--for", "0.1"],
        &["run", &program, "--out", &out],
        &["teleop", "--master", "sim", "--for", "1", "--out", &out],
        &["run", &program, "--stream", "--out", &out],
        &["jog", "--by", "x=1"],
        &["move-off", "l1"],
        &["store"],
        &["mdi", "G0 X1"],
        &["probe", "z=-1"],
        &["probe", "edge", "z=-1", "--radius", "0"],
        &["probe", "bore", "--reach", "1"],
        &["probe", "boss", "--size", "9", "--depth", "1"],
        &["probe", "tool", "--tool", "1", "--height", "0"],
        &["offset", "touch", "g54", "x=1"],
        &["output", "set", "coolant", "on"],
        &["identify", "--yes", "--out", &out],
        &["bridge", "grbl"],
    ] {
        let ran = served.run(command);
        assert_eq!(status(&served), before, "{command:?}: {ran:#?}");
        assert_eq!(ran.code, 8, "{command:?}: {ran:#?}");
        assert!(ran.err.contains("configured as \"mill2\""), "{ran:#?}");
        expect_machine_required(&ran);
    }
    // Commands without geometry use the configuration of the board.
    let enabled = served.run_ok(&["enable", "--json"]).json();
    assert_eq!(
        (&enabled["machine"], &enabled["state"]),
        (&"mill2".into(), &"Idle".into())
    );
    served.run_ok(&["force", "tare"]);
    served.run_ok(&["stop"]);
    served.run_ok(&["disable"]);
    assert_eq!(status(&served), before);
    // Axes of an unknown machine do not get the names of another machine.
    let shown = served.run_ok(&["status"]);
    assert!(!shown.out.contains("theta"), "{}", shown.out);
    assert!(shown.out.contains("positions  not shown"), "{}", shown.out);
    assert!(!shown.out.contains("measured"), "{}", shown.out);
    expect_machine_required(&shown);
    // With its machine file the commands work.
    served.run_ok(&["home", "--machine", &own]);
    assert_eq!(status(&served).2, before.2);
}

#[test]
fn machine_of_another_name_needs_replace_machine() {
    let folder = TestFolder::new();
    let own = machine_of_other_name(&folder, "own.toml");
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home", "--machine", "machines/h4.toml"]);
    served.run_ok(&["disable"]);
    let before = status(&served);
    assert_eq!(before.0, "h4");
    for command in [&["enable"][..], &["home"], &["jog", "x=1", "--for", "0.1"]] {
        let ran = served.run(&[command, &["--machine", &own]].concat());
        assert_eq!(status(&served), before, "{command:?}: {ran:#?}");
        assert_eq!(ran.code, 8, "{ran:#?}");
        assert!(ran.err.contains("--replace-machine"), "{ran:#?}");
    }
    let ran = served.run_ok(&["enable", "--machine", &own, "--replace-machine"]);
    assert!(ran.err.contains("is replaced by \"mill2\""), "{ran:#?}");
    assert!(ran.err.contains("the position is "), "{ran:#?}");
    assert_eq!(status(&served).0, "mill2");
    // Refused while the drives are on.
    let h4 = ["--machine", "machines/h4.toml", "--replace-machine"];
    let ran = served.run(&[&["enable"][..], &h4].concat()).expect_code(8);
    assert_eq!(status(&served).0, "mill2", "{ran:#?}");
    served.run(&["enable", "--replace-machine"]).expect_code(2);
}

#[test]
fn another_version_of_the_machine_is_sent_and_reported() {
    let folder = TestFolder::new();
    let machine_of_other_version = machine_of_other_version(&folder);
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home", "--machine", "machines/h4.toml"]);
    served.run_ok(&["disable"]);
    let before = status(&served);
    let ran = served.run_ok(&["enable", "--machine", &machine_of_other_version]);
    assert!(ran.err.contains("is replaced by"), "{ran:#?}");
    // The simulated encoders have the same scale, so the controller keeps the position and reports
    // it.
    assert!(ran.err.contains("the position is kept"), "{ran:#?}");
    assert_eq!(served.status()["homed"], true);
    let after = status(&served);
    assert_eq!(after.0, "h4");
    assert_ne!(after.2, before.2);
    // The built-in file is no longer the configuration of the board.
    let ran = served.run(&["jog", "x=1", "--for", "0.1"]).expect_code(8);
    expect_machine_required(&ran);
    assert_eq!(status(&served), after);
}

#[test]
fn unconfigured_board_requires_a_machine_file() {
    let folder = TestFolder::new();
    let (program, out) = (program(&folder), folder.path("out"));
    let served = SimServer::on_tcp(&["--unconfigured"]);
    for command in [
        &["enable"][..],
        &["home"],
        &["jog", "x=1", "--for", "0.1"],
        &["run", &program, "--out", &out],
        &["teleop", "--master", "sim", "--for", "1", "--out", &out],
    ] {
        let ran = served.run(command).expect_code(8);
        assert!(ran.err.contains("has no configuration"), "{ran:#?}");
        expect_machine_required(&ran);
        assert_eq!(
            status(&served),
            (String::new(), "Disabled".into(), "00000000".into())
        );
    }
    let ran = served.run_ok(&["home", "--machine", "machines/h4.toml"]);
    assert!(ran.err.contains("configured as \"h4\""), "{ran:#?}");
    // The configuration is now the built-in one, so --machine is not needed.
    served.run_ok(&["jog", "x=1", "--for", "0.2"]);
}

#[test]
fn served_simulator_is_configured() {
    let served = SimServer::on_tcp(&[]);
    let status = served.status();
    assert_eq!(status["machine"], "h4", "{status:#}");
    assert_eq!(status["state"], "Disabled");
    assert_eq!(status["fault"], serde_json::Value::Null);
    served.run_ok(&["home"]);
}

/// The same for the board of a haptic arm.
#[test]
fn haptic_arm_keeps_its_configuration() {
    let folder = TestFolder::new();
    let text = haptimill_machine_file::MASTER.replacen("name = \"", "name = \"my-", 1);
    let own = folder.file("arm.toml", text);
    let machine = SimServer::on_tcp(&[]);
    let arm = SimServer::on_tcp(&["--machine", &own]);
    arm.run_ok(&["enable", "--machine", &own]);
    arm.run_ok(&["disable"]);
    let before = status(&arm);
    assert!(before.0.starts_with("my-"), "{before:?}");
    let out = folder.path("out");
    let teleop = [
        "teleop",
        "--port",
        &machine.port,
        "--master",
        &arm.port,
        "--out",
        &out,
        "--for",
        "1",
    ];
    let ran = haptimill(&teleop).expect_code(8);
    assert_eq!(status(&arm), before, "{ran:#?}");
    assert!(ran.err.contains("--master-machine"), "{ran:#?}");
    let master = ["--master-machine", "machines/haptic-master.toml"];
    let ran = haptimill(&[&teleop[..], &master].concat()).expect_code(8);
    assert_eq!(status(&arm), before, "{ran:#?}");
    assert!(ran.err.contains("--replace-master-machine"), "{ran:#?}");
    assert!(!std::path::Path::new(&out).join("recording.hmr").exists());
}
