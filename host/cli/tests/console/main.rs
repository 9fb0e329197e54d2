//! The console in a real terminal (a pseudo-terminal), with a real controller behind it: built in, served by another process, or in this one, where what
//! it does is seen from outside.
#![cfg(target_os = "linux")]

mod closing;
mod jogging;
mod latency;
mod link;
mod machine;
mod master;
mod programs;
#[path = "../scene/mod.rs"]
mod scene;
mod screen;
#[path = "../terminal/mod.rs"]
mod terminal;

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

/// The same with its machine enabled and homed, by keys.
fn homed(arguments: &[&str], keyboard: Keyboard) -> Terminal {
    let terminal = console(arguments, keyboard);
    home(&terminal);
    terminal
}
