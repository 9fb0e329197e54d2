//! Commands of a person beside a simulated machine in real time: one after the other, each on its own.
#![cfg(unix)]

mod scene;

use scene::{Folder, Served, start};
use std::time::Duration;

#[test]
fn what_forbids_to_switch_the_drives_on_is_named() {
    for (spoilt, named) in [
        (
            "switch-stuck axis=l2 switch=limit-low active=yes",
            "l2 stands on its limit switch",
        ),
        ("drive-tripped axis=l4", "the drive of l4 is not ready"),
        ("emergency-stop", "remove the cause, then reset"),
    ] {
        let served = Served::on_tcp(&["--fault", spoilt]);
        let refused = served.tries(&["enable"]).ended_with(8);
        assert!(refused.err.contains(named), "{spoilt}: {}", refused.err);
    }
    let served = Served::on_tcp(&["--fault", "emergency-stop"]);
    let refused = served.tries(&["reset"]).ended_with(8);
    assert!(refused.err.contains("is pressed"), "{}", refused.err);
}

/// A jog that is under way on a machine that was homed.
fn jogging(served: &Served) -> scene::Started {
    served.does(&["home"]);
    let mut jog = start(&["jog", "x=2", "--for", "60", "--port", &served.port]);
    jog.says("jogging");
    jog
}

#[test]
fn ctrl_c_ends_a_jog_as_it_ends_a_job() {
    let served = Served::on_tcp(&[]);
    let jog = jogging(&served);
    std::thread::sleep(Duration::from_millis(500));
    jog.interrupt();
    let ended = jog.end().ended_with(7);
    assert!(ended.err.contains("stopped by the user"), "{}", ended.err);
    // It stood before it said so, on its way.
    let status = served.status();
    assert_eq!(status["state"], "Idle", "{status:#}");
    assert!(scene::number(&status["commanded"], "x") > 0.0, "{status:#}");
}

#[test]
fn an_emergency_stop_ends_a_jog_as_a_fault() {
    let served = Served::on_tcp(&["--fault", "emergency-stop at=12s"]);
    let ended = jogging(&served).end().ended_with(6);
    assert!(ended.err.contains("emergency stop"), "{}", ended.err);
}

#[test]
fn force_control_is_shown_and_set_and_refused_in_words() {
    let served = Served::on_tcp(&["--unconfigured"]);
    let nothing = served.tries(&["force", "show"]).ended_with(8);
    assert!(nothing.err.contains("haptimill home"), "{}", nothing.err);
    served.does(&["home", "--machine", "machines/h4.toml"]);
    let shown = served.does(&["force", "show", "--json"]).json();
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
        "--gate",
        "any",
        "--json",
    ];
    let set = served.does(&set).json();
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
            .tries(&["force", "set", "x", option, value])
            .ended_with(8);
        assert!(refused.err.contains("force loop of x"), "{}", refused.err);
        assert!(refused.err.contains(bound), "{}", refused.err);
    }
    served
        .tries(&["force", "set", "x", "--force-setpoint", "nan"])
        .ended_with(2);
    served.tries(&["force", "set", "alpha"]).ended_with(2);
    let none = served.does(&["force", "set", "none", "--json"]).json();
    assert_eq!(none["under_control"], serde_json::json!([]), "{none:#}");
}

#[test]
fn force_control_needs_a_sensor() {
    let folder = Folder::new();
    let text = include_str!("../../../machines/h4.toml");
    let begins = text.find("[force]").expect("there");
    let ends = text.find("[plant]").expect("there");
    let blind = folder.file(
        "blind.toml",
        format!("{}{}", &text[..begins], &text[ends..]),
    );
    let program = "examples/e7-slot.ngc";
    let refused =
        scene::haptimill(&["run", program, "--machine", &blind, "--force", "x"]).ended_with(3);
    assert!(refused.err.contains("no force sensor"), "{}", refused.err);
    let refused = scene::haptimill(&["run", program, "--force-setpoint", "5"]).ended_with(2);
    assert!(refused.err.contains("--force"), "{}", refused.err);
}

/// What a person sees who sets up force control by hand, word for word; forces are noise, and not shown.
#[test]
fn force_control_by_hand() {
    let served = Served::on("pty", &["--unconfigured"]);
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
            "--gate",
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
        let ran = served.tries(command);
        text.push_str(&format!("$ haptimill {}\n", command.join(" ")));
        if command[0] == "force" {
            let told = ran.out.lines();
            for line in told.filter(|line| !line.starts_with("force, ")) {
                text.push_str(&format!("{line}\n"));
            }
            text.push_str(&ran.err);
        }
        text.push_str(&format!("--- exit code {}\n", ran.code));
    }
    insta::assert_snapshot!(text);
}
