//! Key sequences of an operator at the console.

use super::Terminal;
use std::time::Duration;

pub const RIGHT: &[u8] = b"\x1b[C";
pub const LEFT: &[u8] = b"\x1b[D";
pub const UP: &[u8] = b"\x1b[A";
pub const DOWN: &[u8] = b"\x1b[B";
pub const PAGE_UP: &[u8] = b"\x1b[5~";
pub const PAGE_DOWN: &[u8] = b"\x1b[6~";
pub const ENTER: &[u8] = b"\r";
pub const SPACE: &[u8] = b" ";
pub const RESUME: &[u8] = b"\x12";
pub const STOP: &[u8] = b"\x18";
pub const EMERGENCY: &[u8] = b"\x05";

/// Presses a key and confirms the question.
#[track_caller]
pub fn confirm(terminal: &Terminal, key: &[u8], question: &str) {
    terminal.press_expect(key, question);
    terminal.press(ENTER);
}

/// Enables the drives and homes the machine to its home pose.
#[track_caller]
pub fn home(terminal: &Terminal) {
    terminal.expect_state("DISABLED");
    terminal.press(b"e");
    terminal.expect_state("IDLE");
    confirm(terminal, b"h", "Home? The machine moves");
    terminal.expect_text("move to the home pose: done");
    terminal.expect_state("IDLE");
}

/// Checks and starts the given program.
#[track_caller]
pub fn run(terminal: &Terminal) {
    terminal.press_expect(b"p", "Enter checks it");
    terminal.press_expect(ENTER, "The machine moves.");
    // The Enter that selects the file does not confirm.
    std::thread::sleep(Duration::from_millis(600));
    terminal.press(ENTER);
    terminal.expect_state("RUN");
}
