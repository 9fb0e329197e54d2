//! Tests of the console in a pseudo-terminal with a real controller: in its own process, in a
//! server process, or in this process, where its motion is recorded.
#![cfg(target_os = "linux")]

use crate::scene;
use crate::terminal;
mod closing;
mod jogging;
mod latency;
mod link;
mod machine;
mod master;
mod programs;
mod screen;

use scene::root;
use std::path::Path;
use terminal::console::*;
use terminal::{Keyboard, Terminal};

/// The console in a terminal of 80 columns and 24 rows.
fn console(arguments: &[&str], keyboard: Keyboard) -> Terminal {
    let program = Path::new(env!("CARGO_BIN_EXE_haptimill"));
    let arguments = [&["console"], arguments].concat();
    Terminal::start(program, &arguments, &root(), (80, 24), keyboard)
}

/// The console with its machine enabled and homed by keys.
fn homed(arguments: &[&str], keyboard: Keyboard) -> Terminal {
    let terminal = console(arguments, keyboard);
    home(&terminal);
    terminal
}
