//! What the tests of the image share.

#![allow(dead_code, reason = "each test uses a part of it")]

use haptimill_client::client::Options;
use haptimill_client::session::Session;
use haptimill_emulator::image::flash;
use haptimill_emulator::pico2::Pico2;
use haptimill_hil_sim::plant::Plant;
use haptimill_machine_file::MachineFile;
use std::sync::Arc;

/// Contents of the flash of an image that a variable names.
fn named(variable: &str) -> Vec<u8> {
    let path = std::env::var(variable).unwrap_or_else(|_| {
        panic!("{variable} is the path of an image; `cargo xtask emulator` sets it")
    });
    let file = std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    flash(&file).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The image.
pub fn image() -> Vec<u8> {
    named("HAPTIMILL_IMAGE")
}

/// The image with a UART as its line.
pub fn uart_image() -> Vec<u8> {
    named("HAPTIMILL_UART_IMAGE")
}

pub fn mill() -> MachineFile {
    MachineFile::parse("mill3-short.toml", include_str!("../mill3-short.toml"))
        .unwrap_or_else(|error| panic!("{error}"))
}

pub fn five() -> MachineFile {
    MachineFile::parse("five.toml", include_str!("../five.toml"))
        .unwrap_or_else(|error| panic!("{error}"))
}

/// A board with this image whose pins are wired to a machine.
pub fn board_with(image: &[u8], machine: &MachineFile) -> Pico2 {
    let config = machine.plant().expect("the file has a plant");
    let plant = Plant::new(&config, machine.config.period_us).expect("a sound plant");
    Pico2::new(image, plant).expect("an emulator")
}

/// A board whose pins are wired to a machine.
pub fn board(machine: &MachineFile) -> Pico2 {
    board_with(&image(), machine)
}

/// A session with a board that has its configuration.
pub fn session(board: Pico2, machine: &MachineFile) -> Session<Pico2> {
    let mut session = Session::new(board, machine, Options::default(), Arc::default());
    session.connect(1).expect("the board answers");
    session
        .configure(machine)
        .expect("the board accepts the file");
    session
}

/// A session with a board whose drives are enabled.
pub fn enabled(machine: &MachineFile) -> Session<Pico2> {
    let mut session = session(board(machine), machine);
    session.enable().expect("the drives are ready");
    session
}
