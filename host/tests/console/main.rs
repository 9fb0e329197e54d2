//! The console in a real terminal (a pseudo-terminal), with a real controller behind it: built in, served by another process, or in this one, where what
//! it does is seen from outside.
#![cfg(target_os = "linux")]

mod closing;
mod jogging;
mod latency;
mod links;
mod machine;
mod programs;
#[path = "../scene/mod.rs"]
mod scene;
mod screen;
#[path = "../terminal/mod.rs"]
mod terminal;

use scene::root;
use std::path::Path;
use terminal::{Keyboard, Terminal};

/// The console in a terminal of 80 columns and 24 rows.
fn console(arguments: &[&str], keyboard: Keyboard) -> Terminal {
    let program = Path::new(env!("CARGO_BIN_EXE_haptimill"));
    let arguments = [&["console"], arguments].concat();
    Terminal::start(program, &arguments, &root(), (80, 24), keyboard)
}

/// The same with its machine enabled and homed, by keys.
fn homed(arguments: &[&str], keyboard: Keyboard) -> Terminal {
    let terminal = console(arguments, keyboard);
    home(&terminal);
    terminal
}

fn home(terminal: &Terminal) {
    terminal.state("DISABLED");
    terminal.keys(b"e");
    terminal.state("IDLE");
    terminal.keys(b"h");
    terminal.sees("Home? The machine moves");
    terminal.keys(b"\r");
    terminal.sees("way to the home pose: done");
    terminal.state("IDLE");
}

const RIGHT: &[u8] = b"\x1b[C";
const LEFT: &[u8] = b"\x1b[D";
const UP: &[u8] = b"\x1b[A";
const DOWN: &[u8] = b"\x1b[B";
const PAGE_UP: &[u8] = b"\x1b[5~";
const PAGE_DOWN: &[u8] = b"\x1b[6~";
const ENTER: &[u8] = b"\r";
const SPACE: &[u8] = b" ";
const RESUME: &[u8] = b"\x12";
const STOP: &[u8] = b"\x18";
const EMERGENCY: &[u8] = b"\x05";
