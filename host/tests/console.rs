//! The console in a real terminal, with a real controller behind it.
#![cfg(target_os = "linux")]

mod scene;
mod terminal;

use scene::{Folder, Served, haptimill, number, root};
use std::path::Path;
use std::time::Duration;
use terminal::{Keyboard, Terminal};

fn console(arguments: &[&str], size: (u16, u16), keyboard: Keyboard) -> Terminal {
    let program = Path::new(env!("CARGO_BIN_EXE_haptimill"));
    let arguments = [&["console"], arguments].concat();
    Terminal::start(program, &arguments, &root(), size, keyboard)
}

const RIGHT: &[u8] = b"\x1b[C";
const LEFT: &[u8] = b"\x1b[D";
const UP: &[u8] = b"\x1b[A";
const DOWN: &[u8] = b"\x1b[B";
const PAGE_UP: &[u8] = b"\x1b[5~";
const PAGE_DOWN: &[u8] = b"\x1b[6~";

#[test]
fn looks() {
    let t = console(&[], (80, 24), Keyboard::Plain);
    t.state("DISABLED");
    println!("{}", t.text());
    t.keys(b"e");
    t.state("IDLE");
    t.keys(b"h");
    t.sees("Home?");
    println!("{}", t.text());
    t.keys(b"\r");
    t.state("HOMING");
    t.state("IDLE");
    t.sees("way to the home pose: done");
    println!("{}", t.text());
    t.keys(RIGHT);
    t.state("JOG");
    println!("{}", t.text());
    t.state("IDLE");
    t.resize(40, 10);
    std::thread::sleep(Duration::from_millis(300));
    println!("{}", t.text());
    t.resize(200, 60);
    std::thread::sleep(Duration::from_millis(300));
    t.keys(b"?");
    std::thread::sleep(Duration::from_millis(300));
    println!("{}", t.text());
    t.keys(b"\x1b");
    t.keys(b"q");
    std::thread::sleep(Duration::from_millis(300));
    println!("{}", t.text());
}
