//! What the tests of the image share.

#![allow(dead_code, reason = "each test uses a part of it")]

pub mod chips;
pub mod table;

use haptimill_client::client::Options;
use haptimill_client::session::Session;
use haptimill_emulator::image::flash;
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::Outputs;
use haptimill_hil_sim::plant::Plant;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Fault;
use std::sync::Arc;

/// Entry of PendSV in the vector table.
const PEND_SV: u32 = 0x1000_0038;
/// A branch to itself.
pub const ENDLESS_LOOP: u32 = 0xE7FE;
/// An instruction that is a fault of the processor.
pub const UNDEFINED_INSTRUCTION: u32 = 0xDE00;

/// Replaces the first instruction of the handler of the control period.
pub fn replace_period(board: &mut Pico2, instruction: u32) {
    let handler = board.chip().memory(PEND_SV) & !1;
    let word = handler & !3;
    let code = match handler & 2 {
        0 => board.chip().memory(word) & 0xFFFF_0000 | instruction,
        _ => board.chip().memory(word) & 0xFFFF | instruction << 16,
    };
    board.chip().set_code(word, code);
}

/// The path that a variable has.
pub fn path(variable: &str) -> String {
    std::env::var(variable).unwrap_or_else(|_| {
        panic!("{variable} is the path of an image; `cargo xtask emulator` sets it")
    })
}

/// Contents of the flash of an image that a variable names.
fn named(variable: &str) -> Vec<u8> {
    let path = path(variable);
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

/// The variable with the ELF file of the image with a log: it has the texts.
pub const LOG_IMAGE: &str = "HAPTIMILL_LOG_IMAGE";

/// The image with a log.
pub fn log_image() -> Vec<u8> {
    named(LOG_IMAGE)
}

/// The image with encoders.
pub fn encoder_image() -> Vec<u8> {
    named("HAPTIMILL_ENCODER_IMAGE")
}

/// The image with TMC5160 at its SPI.
pub fn spi_image() -> Vec<u8> {
    named("HAPTIMILL_SPI_IMAGE")
}

/// A machine whose first joints have encoders of this many counts in a turn of their motors.
pub fn with_encoders(text: &str, joints: usize, counts_per_turn: u32) -> String {
    let (machine, plant) = text.split_once("\n[plant]").expect("a simulated machine");
    let mut rotary = false;
    let mut left = joints;
    let mut changed = String::new();
    let of_unit = |text: &str, rotary: bool| match rotary {
        true => text.replace("_mm", "_deg"),
        false => text.to_string(),
    };
    for line in machine.lines() {
        let key = line.split(' ').next().unwrap_or_default();
        match key {
            // The drives have a kind, too.
            "kind" if line.contains("rotary") => rotary = true,
            "kind" if line.contains("linear") => rotary = false,
            "lead_mm" | "gear_ratio" if left > 0 => {
                let keys = format!(
                    "counts_per_turn = {counts_per_turn}\ndirection = 1\n\
                     following_error_mm = 0.3\nfollowing_error_lag_ms = 10\n\
                     encoder_stuck_mm = 0.2\nsearch_mm = 0.5\nindex_slack_counts = 0\n"
                );
                changed += &of_unit(&keys, rotary);
            }
            "preset_mm" | "preset_deg" if left > 0 => {
                let value = line.split([' ', '#']).nth(2).unwrap_or_default();
                changed += &of_unit(&format!("index_mm = {value}\n"), rotary);
            }
            "ticks_per_us" if left > 0 => {
                left -= 1;
                changed += &of_unit("lost_mm = 0.1\n", rotary);
            }
            "missed_periods" => changed += "illegal_transitions = 20\n",
            _ => {}
        }
        changed += line;
        changed.push('\n');
    }
    let mut left = joints;
    let mut preset = String::new();
    changed += "\n[plant]";
    for line in plant.lines() {
        let key = line.split(' ').next().unwrap_or_default();
        if key == "preset" {
            preset = line.split(' ').nth(2).unwrap_or_default().to_string();
        }
        if key == "start_spread" && left > 0 {
            left -= 1;
            let count = format!("counts_per_turn = {counts_per_turn}");
            changed += &format!("encoder = {{ {count}, index = {preset} }}\n");
        }
        changed += line;
        changed.push('\n');
    }
    changed
}

/// The mill with encoders and limit switches.
pub fn mill_with_encoders() -> MachineFile {
    parse(
        "mill3-encoders.toml",
        include_str!("../mill3-encoders.toml"),
    )
}

/// The motors on the bench, with encoders.
pub fn bench_with_encoders() -> MachineFile {
    let text = include_str!("../../../../machines/bench.toml");
    parse("bench-encoders.toml", &with_encoders(text, 3, 20_000))
}

fn parse(name: &str, text: &str) -> MachineFile {
    MachineFile::parse(name, text).unwrap_or_else(|error| panic!("{error}"))
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
    let own = format!("period_us = {}", period_us());
    let text = text.replacen("period_us = 200", &own, 1);
    let text = text.replacen("substep_us = 20", "substep_us = 10", 1);
    MachineFile::parse(name, &text).unwrap_or_else(|error| panic!("{error}"))
}

/// The machine of [`five`] with the control period of the image, and encoders on four joints with
/// as many counts as steps.
pub fn five_with_encoders() -> MachineFile {
    let text = with_encoders(include_str!("../five.toml"), 4, 100_000);
    in_period("five-encoders.toml", &text)
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
    in_period("three.toml", &fast_mill())
}

/// The machine of [`three_in_period`] with encoders that have as many counts as steps.
pub fn three_with_encoders() -> MachineFile {
    in_period(
        "three-encoders.toml",
        &with_encoders(&fast_mill(), 3, 100_000),
    )
}

/// The mill with joints of 1,000,000 steps/s.
fn fast_mill() -> String {
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
    changes.iter().fold(text.to_string(), change)
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

/// The fault of the controller, by the inputs that the board gave it.
pub fn fault(board: &Pico2, period_us: u16) -> Option<Fault> {
    let mut controller = Controller::new(period_us);
    let mut outputs = Outputs::default();
    for period in &board.periods {
        outputs.transmit.clear();
        controller.tick(&period.inputs, &mut outputs, &mut ());
        assert_eq!(outputs.joints[..period.commands.len()], period.commands);
    }
    controller.safety().fault()
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
    enabled_board(board(machine), machine)
}

/// The machine of [`five`] with a control period of 320 us, in which its joints can move at
/// 1,000,000 steps/s each without a missed period, and pulses of the first two of this length.
pub fn five_in_320_us(pulse_us: f64) -> MachineFile {
    let text = include_str!("../five.toml").replacen("period_us = 200", "period_us = 320", 1);
    let text = text.replacen("pulse_us = 0.4", &format!("pulse_us = {pulse_us}"), 2);
    let ns = format!("pulse_ns = {:.1}", 1000.0 * pulse_us);
    let text = text.replacen("pulse_ns = 400.0", &ns, 2);
    MachineFile::parse("five.toml", &text).unwrap_or_else(|error| panic!("{error}"))
}

/// As [`enabled`], with the image whose control period is 320 us.
pub fn enabled_in_320_us(machine: &MachineFile) -> Session<Pico2> {
    enabled_board(
        board_with(&named("HAPTIMILL_320_US_IMAGE"), machine),
        machine,
    )
}

/// As [`enabled`], with the image with encoders, whose inputs are known after a few periods.
pub fn enabled_with_encoders(machine: &MachineFile) -> Session<Pico2> {
    let mut board = board_with(&encoder_image(), machine);
    for _ in 0..10 {
        board.run_period().expect("the emulator runs");
    }
    enabled_board(board, machine)
}

/// As [`enabled`], with this board.
pub fn enabled_board(board: Pico2, machine: &MachineFile) -> Session<Pico2> {
    let mut session = session(board, machine);
    session.enable().expect("the drives are ready");
    session
}

/// Runs control periods of a session.
pub fn steps(session: &mut Session<Pico2>, periods: usize) {
    for _ in 0..periods {
        session.step().expect("the line works");
    }
}
