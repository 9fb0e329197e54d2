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

/// The H-4 mill with step drives.
pub fn h4() -> MachineFile {
    MachineFile::parse("h4-pins.toml", include_str!("../h4-pins.toml"))
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Motors on the bench, of which the first motion of a new board is made.
pub fn bench() -> MachineFile {
    let text = include_str!("../../../../machines/bench.toml");
    MachineFile::parse("bench.toml", text).unwrap_or_else(|error| panic!("{error}"))
}

/// Control period of the image, us.
pub fn period_us() -> u16 {
    std::env::var("HAPTIMILL_PERIOD_US").map_or(200, |period| {
        period
            .parse()
            .unwrap_or_else(|_| panic!("HAPTIMILL_PERIOD_US is '{period}'"))
    })
}

/// A machine with the control period of the image. All of them are multiples of the shorter step of
/// the simulated machine.
fn in_period(name: &str, text: &str) -> MachineFile {
    let text = text.replacen(
        "period_us = 200",
        &format!("period_us = {}", period_us()),
        1,
    );
    let text = text.replacen("substep_us = 20", "substep_us = 10", 1);
    MachineFile::parse(name, &text).unwrap_or_else(|error| panic!("{error}"))
}

/// The machine of [`five`] with the control period of the image.
pub fn five_in_period() -> MachineFile {
    in_period("five.toml", include_str!("../five.toml"))
}

/// The machine of [`h4`] with the control period of the image.
pub fn h4_in_period() -> MachineFile {
    in_period("h4-pins.toml", include_str!("../h4-pins.toml"))
}

/// A mill whose three joints search their switches together, and move, at 1,000,000 steps/s each,
/// with the control period of the image.
pub fn three_in_period() -> MachineFile {
    let text = include_str!("../mill3-short.toml");
    let changes = [
        ("home_order = ", "# home_order = "),
        ("steps_per_turn = 3200 ", "steps_per_turn = 100000 "),
        ("microsteps = 16\n", "microsteps = 500\n"),
        ("pulse_us = 2.5", "pulse_us = 0.4"),
        ("setup_us = 5.0", "setup_us = 0.4"),
        ("hold_us = 5.0", "hold_us = 0.4"),
        ("pulse_ns = 2500.0", "pulse_ns = 400.0"),
        ("_ns = 1000.0", "_ns = 200.0"),
        ("_ns = 5000.0", "_ns = 200.0"),
        ("\nrate_mm_s = 20.0 ", "\nrate_mm_s = 50.0 "),
        ("rate_mm_s = 40.0", "rate_mm_s = 50.0"),
        (
            "\nrate_mm_s = 50.0\nacceleration_mm_s2 = 1000",
            "\nrate_mm_s = 55.0\nacceleration_mm_s2 = 4000",
        ),
    ];
    let change = |text: String, (from, to): &(&str, &str)| {
        assert!(text.contains(from), "mill3-short.toml has no '{from}'");
        text.replace(from, to)
    };
    in_period("three.toml", &changes.iter().fold(text.to_string(), change))
}

/// A board with this image whose pins are wired to a machine.
pub fn board_with(image: &[u8], machine: &MachineFile) -> Pico2 {
    let config = machine.plant().expect("the file has a plant");
    let plant = Plant::new(&config, machine.config.period_us).expect("a sound plant");
    let mut board = Pico2::new(image, plant).expect("an emulator");
    board.connect_chips(machine);
    board
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
