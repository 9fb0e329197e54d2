//! A board keeps its configuration: no command replaces it unasked, and none switches the drives on with another machine's.
#![cfg(unix)]

mod scene;

use scene::{Folder, Ran, Served, haptimill};

/// The built-in machine with another name and shorter strokes.
fn other(folder: &Folder, name: &str) -> String {
    let text = haptimill_machine_file::BUILT_IN.replacen("name = \"h4\"", "name = \"mill2\"", 1);
    assert!(text.contains("mill2"));
    folder.file(name, text)
}

/// The built-in machine with its name and another heartbeat.
fn variant(folder: &Folder) -> String {
    let text = haptimill_machine_file::BUILT_IN;
    let changed = text.replacen("heartbeat_ms = 500", "heartbeat_ms = 600", 1);
    assert_ne!(text, changed);
    folder.file("variant.toml", changed)
}

fn program(folder: &Folder) -> String {
    folder.file("short.ngc", "G21 G90 F600\nG1 X1\nG1 X0\nM30\n")
}

/// Name, state and CRC of the configuration.
fn stands(served: &Served) -> (String, String, String) {
    let status = served.status();
    let text = |key: &str| status[key].as_str().unwrap_or_default().to_string();
    (text("machine"), text("state"), text("configuration_crc"))
}

#[track_caller]
fn names_machine(ran: &Ran) {
    assert!(ran.err.contains("--machine"), "{ran:#?}");
}

#[test]
fn without_machine_no_command_replaces_another_configuration() {
    let folder = Folder::new();
    let own = other(&folder, "own.toml");
    let served = Served::on_tcp(&["--machine", &own]);
    served.does(&["enable", "--machine", &own]);
    served.does(&["disable"]);
    let before = stands(&served);
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
    ] {
        let ran = served.tries(command);
        assert_eq!(stands(&served), before, "{command:?}: {ran:#?}");
        assert_eq!(ran.code, 8, "{command:?}: {ran:#?}");
        assert!(ran.err.contains("configured as \"mill2\""), "{ran:#?}");
        names_machine(&ran);
    }
    // What needs no geometry goes by what the board has.
    let enabled = served.does(&["enable", "--json"]).json();
    assert_eq!(
        (&enabled["machine"], &enabled["state"]),
        (&"mill2".into(), &"Idle".into())
    );
    served.does(&["force", "tare"]);
    served.does(&["stop"]);
    served.does(&["disable"]);
    assert_eq!(stands(&served), before);
    // Axes of a machine that is not known are not called by another one's names.
    let shown = served.does(&["status"]);
    assert!(!shown.out.contains("theta"), "{}", shown.out);
    names_machine(&shown);
    // And with its file all goes on.
    served.does(&["home", "--machine", &own]);
    assert_eq!(stands(&served).2, before.2);
}

#[test]
fn a_file_of_another_name_needs_a_word_more() {
    let folder = Folder::new();
    let own = other(&folder, "own.toml");
    let served = Served::on_tcp(&[]);
    served.does(&["home", "--machine", "machines/h4.toml"]);
    served.does(&["disable"]);
    let before = stands(&served);
    assert_eq!(before.0, "h4");
    for command in [&["enable"][..], &["home"], &["jog", "x=1", "--for", "0.1"]] {
        let ran = served.tries(&[command, &["--machine", &own]].concat());
        assert_eq!(stands(&served), before, "{command:?}: {ran:#?}");
        assert_eq!(ran.code, 8, "{ran:#?}");
        assert!(ran.err.contains("--replace-machine"), "{ran:#?}");
    }
    let ran = served.does(&["enable", "--machine", &own, "--replace-machine"]);
    assert!(ran.err.contains("is replaced by \"mill2\""), "{ran:#?}");
    assert!(ran.err.contains("the position is "), "{ran:#?}");
    assert_eq!(stands(&served).0, "mill2");
    // Not while the drives are on.
    let h4 = ["--machine", "machines/h4.toml", "--replace-machine"];
    let ran = served.tries(&[&["enable"][..], &h4].concat()).ended_with(8);
    assert_eq!(stands(&served).0, "mill2", "{ran:#?}");
    served.tries(&["enable", "--replace-machine"]).ended_with(2);
}

#[test]
fn another_version_of_the_same_machine_is_sent_and_said() {
    let folder = Folder::new();
    let variant = variant(&folder);
    let served = Served::on_tcp(&[]);
    served.does(&["home", "--machine", "machines/h4.toml"]);
    served.does(&["disable"]);
    let before = stands(&served);
    let ran = served.does(&["enable", "--machine", &variant]);
    assert!(ran.err.contains("is replaced by"), "{ran:#?}");
    // The simulated encoders count alike: the controller says itself that it takes the position over.
    assert!(ran.err.contains("the position is kept"), "{ran:#?}");
    assert_eq!(served.status()["homed"], true);
    let after = stands(&served);
    assert_eq!(after.0, "h4");
    assert_ne!(after.2, before.2);
    // The built-in file is not that of the board any more.
    let ran = served.tries(&["jog", "x=1", "--for", "0.1"]).ended_with(8);
    names_machine(&ran);
    assert_eq!(stands(&served), after);
}

#[test]
fn a_board_without_a_configuration_asks_for_a_machine_file() {
    let folder = Folder::new();
    let (program, out) = (program(&folder), folder.path("out"));
    let served = Served::on_tcp(&["--unconfigured"]);
    for command in [
        &["enable"][..],
        &["home"],
        &["jog", "x=1", "--for", "0.1"],
        &["run", &program, "--out", &out],
        &["teleop", "--master", "sim", "--for", "1", "--out", &out],
    ] {
        let ran = served.tries(command).ended_with(8);
        assert!(ran.err.contains("has no configuration"), "{ran:#?}");
        names_machine(&ran);
        assert_eq!(
            stands(&served),
            (String::new(), "Disabled".into(), "00000000".into())
        );
    }
    let ran = served.does(&["home", "--machine", "machines/h4.toml"]);
    assert!(ran.err.contains("configured as \"h4\""), "{ran:#?}");
    // From now on the file need not be named: it is the built-in one.
    served.does(&["jog", "x=1", "--for", "0.2"]);
}

#[test]
fn a_served_simulator_is_configured_as_the_machine_that_it_serves() {
    let served = Served::on_tcp(&[]);
    let status = served.status();
    assert_eq!(status["machine"], "h4", "{status:#}");
    assert_eq!(status["state"], "Disabled");
    assert_eq!(status["fault"], serde_json::Value::Null);
    served.does(&["home"]);
}

/// A hand's board is a board too.
#[test]
fn an_arm_keeps_its_configuration_as_well() {
    let folder = Folder::new();
    let text = haptimill_machine_file::MASTER.replacen("name = \"", "name = \"my-", 1);
    let own = folder.file("arm.toml", text);
    let machine = Served::on_tcp(&[]);
    let arm = Served::on_tcp(&["--machine", &own]);
    arm.does(&["enable", "--machine", &own]);
    arm.does(&["disable"]);
    let before = stands(&arm);
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
    let ran = haptimill(&teleop).ended_with(8);
    assert_eq!(stands(&arm), before, "{ran:#?}");
    assert!(ran.err.contains("--master-machine"), "{ran:#?}");
    let master = ["--master-machine", "machines/hand-master.toml"];
    let ran = haptimill(&[&teleop[..], &master].concat()).ended_with(8);
    assert_eq!(stands(&arm), before, "{ran:#?}");
    assert!(ran.err.contains("--replace-master-machine"), "{ran:#?}");
    assert!(!std::path::Path::new(&out).join("recording.hmr").exists());
}
