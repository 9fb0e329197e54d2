//! Keys of an operator at a terminal: the prompt of `mdi` with its history, and the keys of `run`.

use crate::scene::{SimServer, TestFolder, number, root};
use crate::terminal::{Keyboard, Terminal};
use std::path::Path;

/// Starts the command in a terminal, with a history of its own in the folder.
fn at_terminal(folder: &TestFolder, arguments: &[&str]) -> Terminal {
    let state = format!("XDG_STATE_HOME={}", folder.path("state"));
    let program = env!("CARGO_BIN_EXE_haptimill");
    let arguments = [&[state.as_str(), program], arguments].concat();
    let size = (100, 40);
    Terminal::start(Path::new("env"), &arguments, &root(), size, Keyboard::Plain)
}

#[test]
fn the_prompt_has_a_history_over_its_sessions() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let mdi = ["mdi", "--port", &served.port];
    let mut terminal = at_terminal(&folder, &mdi);
    terminal.expect_text("mdi> ");
    terminal.press(b"G91 G0 X1\r");
    terminal.expect_text("X1.0000 Y0.0000");
    terminal.press(b"G0 Y2\r");
    terminal.expect_text("X1.0000 Y2.0000");
    // The last block, and the one before it.
    terminal.press(b"\x1b[A\r");
    terminal.expect_text("X1.0000 Y4.0000");
    terminal.press(b"\x1b[A\x1b[A\x1b[A\r");
    terminal.expect_text("X2.0000 Y4.0000");
    // A mistake is named, and the session goes on.
    terminal.press(b"G0 Q1\r");
    terminal.expect_text("Q1 belongs to no word");
    terminal.press(b"\x04");
    assert_eq!(terminal.exit_code(), 0, "{}", terminal.text());
    assert!(terminal.is_restored());
    // Another session begins with absolute coordinates, and has the blocks of the first one.
    let mut terminal = at_terminal(&folder, &mdi);
    terminal.expect_text("mdi> ");
    terminal.press(b"\x1b[A\x1b[A");
    terminal.expect_text("mdi> G91 G0 X1");
    terminal.press(b"\r");
    terminal.expect_text("X3.0000 Y4.0000");
    terminal.press(b"\x04");
    assert_eq!(terminal.exit_code(), 0);
    let status = served.status();
    assert!(
        (number(&status["commanded"], "x") - 3.0).abs() < 1e-6,
        "{status}"
    );
}

#[test]
fn keys_of_a_run_hold_and_continue_and_change_the_feed() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    // 20 s at 100 %, 10 s at 200 %.
    let part = folder.file("part.ngc", "G21 G90 F60\nG1 X10\nX0\nM30\n");
    let out = folder.path("out");
    let run = ["run", &part, "--port", &served.port, "--out", &out];
    let mut terminal = at_terminal(&folder, &run);
    terminal.expect_text("line 2");
    for key in [b" ", b"p"] {
        terminal.press(key);
        terminal.expect_text("held by the operator; press Enter to continue");
        // A second process sees the hold.
        let held = |state: &str| (0..400).any(|_| served.status()["state"] == state);
        assert!(held("Hold"));
        terminal.press(b"\r");
        assert!(held("Run"));
    }
    terminal.press(b"++++++++++");
    terminal.expect_text("overrides: feed 200 %");
    assert_eq!(terminal.exit_code(), 0, "{}", terminal.text());
    assert!(terminal.is_restored());
    let summary = folder.summary("out");
    assert_eq!(summary["completed"], true, "{summary}");
}

#[test]
fn single_blocks_wait_for_enter() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let part = folder.file("part.ngc", "G21 G90 F600\nG1 X1\nX2\nX3\nM30\n");
    let out = folder.path("out");
    let run = [
        "run",
        &part,
        "--single",
        "--port",
        &served.port,
        "--out",
        &out,
    ];
    let mut terminal = at_terminal(&folder, &run);
    for line in [3, 4] {
        terminal.expect_text(&format!("line {line}: the program pauses; press Enter"));
        let held = (0..400)
            .map(|_| served.status())
            .find(|it| it["state"] == "Hold");
        let status = held.expect("a pause is a hold");
        let at = number(&status["commanded"], "x");
        assert!((at - f64::from(line - 2)).abs() < 1e-6, "line {line}: {at}");
        terminal.press(b"\r");
    }
    assert_eq!(terminal.exit_code(), 0, "{}", terminal.text());
    assert!((number(&served.status()["commanded"], "x") - 3.0).abs() < 1e-6);
}
