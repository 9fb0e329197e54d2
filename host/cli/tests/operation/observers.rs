//! `run --serve` and `haptimill watch`: observers of a machine that another process commands.

use crate::scene::{Running, SimServer, TestFolder, root, start};
use crate::terminal::{Keyboard, Terminal};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;

/// The address that a run prints.
fn address_of(run: &mut Running) -> String {
    run.error_line("observers  ")
}

#[test]
fn any_number_of_observers_see_a_run_and_command_nothing() {
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let folder = TestFolder::new();
    let part = folder.file("part.ngc", "G21 G90 F300\nG1 X10\nG1 X0\nG1 X5\nM30\n");
    let out = folder.path("out");
    let serve = [
        "--serve",
        "tcp:127.0.0.1:0",
        "--out",
        &out,
        "--port",
        &served.port,
    ];
    let mut run = start(&[&["run", &part], &serve[..]].concat());
    let address = address_of(&mut run);
    let watch = || start(&["watch", "--json", "--from", &address]);
    let (first, second) = (watch(), watch());
    let reader = start(&["watch", "--from", &address]);
    // One that talks, one that never reads, one that leaves at once.
    let host = address.strip_prefix("tcp:").unwrap();
    let mut rude = TcpStream::connect(host).unwrap();
    rude.write_all(&[0, 0x18, 0, b'x']).unwrap();
    let silent = TcpStream::connect(host).unwrap();
    drop(TcpStream::connect(host).unwrap());
    run.end().expect_code(0);
    assert_eq!(folder.summary("out")["completed"], true);
    // The axes in the order of the machine, with their units.
    let seen = reader.end().expect_code(0).out;
    let row = seen.lines().find(|row| row.starts_with("running, line 2"));
    let words: Vec<&str> = row.expect(&seen).split_whitespace().skip(3).collect();
    let at = |index: usize| {
        words
            .iter()
            .skip(index)
            .step_by(3)
            .copied()
            .collect::<Vec<_>>()
    };
    assert_eq!(at(0), ["x", "y", "z", "theta", "alpha"], "{words:?}");
    assert_eq!(at(2), ["mm", "mm", "mm", "deg", "deg"], "{words:?}");
    assert!(
        at(1).iter().all(|value| value.parse::<f64>().is_ok()),
        "{words:?}"
    );
    for observer in [first, second] {
        let seen = observer.end().expect_code(0);
        let reports: Vec<serde_json::Value> = seen
            .out
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        let lines: Vec<u64> = reports
            .iter()
            .filter_map(|it| it["line"].as_u64())
            .collect();
        assert!(reports.len() > 50, "{}", seen.out);
        assert!(lines.contains(&2) && lines.contains(&3), "{lines:?}");
        assert!(
            reports.iter().any(|it| it["state"] == "running"),
            "{}",
            seen.out
        );
    }
    let mut text = Vec::new();
    let _ = rude.read_to_end(&mut text);
    drop(silent);
    assert!(String::from_utf8_lossy(&text).contains("commanded"));
}

/// Before homing the positions are not those of the machine; with the drives off nothing is
/// commanded.
#[test]
fn observers_see_which_positions_are_not_referenced() {
    let served = SimServer::on_tcp(&[]);
    let folder = TestFolder::new();
    let status = served.status();
    assert_eq!(
        (&status["state"], &status["homed"]),
        (&"Disabled".into(), &false.into())
    );
    assert_eq!(status["commanded"], serde_json::Value::Null);
    let part = folder.file("part.ngc", "G21 G90 F300\nG1 X1\nM30\n");
    let out = folder.path("out");
    let serve = ["--serve", "tcp:127.0.0.1:0", "--port", &served.port];
    let mut run = start(&[&["run", &part, "--out", &out], &serve[..]].concat());
    let address = address_of(&mut run);
    let seen = start(&["watch", "--from", &address]).end().expect_code(0);
    run.end().expect_code(0);
    let (before, after) = seen.out.split_once("homing -> idle").expect(&seen.out);
    let positions = |text: &str| -> Vec<String> {
        let rows = text.lines().filter(|row| row.contains("  x "));
        rows.map(ToString::to_string).collect()
    };
    let (before, after) = (positions(before), positions(after));
    assert!(!before.is_empty() && !after.is_empty(), "{}", seen.out);
    for row in before {
        assert!(row.contains("? mm") && row.contains("? deg"), "{row}");
    }
    for row in after {
        assert!(!row.contains('?'), "{row}");
    }
    let status = served.status();
    assert_eq!(status["homed"], true);
    assert!(status["commanded"]["x"].is_number(), "{status:#}");
}

#[test]
fn observers_need_the_token_of_the_run() {
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let folder = TestFolder::new();
    let part = folder.file("part.ngc", "G21 G90 F300\nG1 X10\nG1 X0\nM30\n");
    let token = folder.file("token", "0123456789abcdef\n");
    let out = folder.path("out");
    let run = [
        "run",
        &part,
        "--serve",
        "tcp:127.0.0.1:0",
        "--token-file",
        &token,
        "--out",
        &out,
    ];
    let mut run = start(&[&run[..], &["--port", &served.port]].concat());
    let address = address_of(&mut run);
    let denied = start(&["watch", "--from", &address]).end().expect_code(5);
    assert!(denied.err.contains("token"), "{}", denied.err);
    let watch = ["watch", "--from", &address, "--token", "0123456789abcdef"];
    let seen = start(&watch).end().expect_code(0);
    assert!(seen.out.contains("running, line"), "{}", seen.out);
    run.end().expect_code(0);
    let refused = start(&["run", &part, "--serve", "tcp:127.0.0.1:0"])
        .end()
        .expect_code(2);
    assert!(refused.err.contains("sim serve"), "{}", refused.err);
}

/// The screen has the state, the positions and the line of the program. Its keys command nothing.
#[test]
fn the_screen_of_an_observer_shows_a_run_and_commands_nothing() {
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let folder = TestFolder::new();
    let part = folder.file("part.ngc", "G21 G90 F300\nG1 X20\nG1 X0\nG1 X5\nM30\n");
    let out = folder.path("out");
    let serve = ["--serve", "tcp:127.0.0.1:0", "--port", &served.port];
    let mut run = start(&[&["run", &part, "--out", &out], &serve[..]].concat());
    let address = address_of(&mut run);
    let watch = |keyboard| {
        let program = Path::new(env!("CARGO_BIN_EXE_haptimill"));
        let watch = ["watch", "--screen", "--from", &address];
        Terminal::start(program, &watch, &root(), (80, 24), keyboard)
    };
    let mut screen = watch(Keyboard::Plain);
    let mut other = watch(Keyboard::Plain);
    for text in [
        "RUNNING",
        "homed  read-only",
        " line 2, path speed",
        " theta ",
        " deg",
    ] {
        screen.expect_text(text);
    }
    // Hold, emergency stop and jog of the console.
    screen.press(b" \x05\x1b[C");
    screen.expect_text(" line 3, path speed");
    screen.press(b"q");
    assert_eq!(screen.exit_code(), 0, "{}", screen.text());
    assert!(screen.is_restored());
    run.end().expect_code(0);
    assert_eq!(folder.summary("out")["completed"], true);
    assert_eq!(other.exit_code(), 0, "{}", other.text());
    let refused = start(&["watch", "--screen", "--from", &served.port]).end();
    assert_eq!(refused.code, 2, "{refused:?}");
    assert!(refused.err.contains("is not a terminal"), "{refused:?}");
}
