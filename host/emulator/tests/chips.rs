//! Chips of the drives at GP0 and GP1: the image sets the TMC2209 of a machine file before it
//! switches the drives on, watches them, and stops the machine when one of them fails.

mod common;

use common::chips::{
    CHIPS, alarms, assert_heat_ends_safe, assert_no_bus, move_by_one_millimetre, only, with_chips,
};
use common::{bench, board, board_with, mill, session, steps, uart_image};
use haptimill_emulator::pico2::Pico2;
use haptimill_hil_sim::tmc2209::GSTAT;
use haptimill_protocol::message::{Command, DriveAlarm, Fault};

/// Registers of the pins GP0 and GP1 (RP2350 datasheet, 9.11): function, and the outputs of UART0.
const IO_BANK0: u32 = 0x4002_8000;
const UART: u32 = 2;

fn functions(board: &mut Pico2) -> [u32; 2] {
    [0, 1].map(|pin| board.chip().register(IO_BANK0 + 4 + 8 * pin) & 0x1F)
}

/// The chips have the settings of the machine file: currents up to the configured ones, less than a
/// step of the range of 325 mV and 0.13 ohm, 55 mA, below it.
fn assert_set(board: &mut Pico2) {
    for (joint, (_, run, hold)) in CHIPS.into_iter().enumerate() {
        let chip = board.drive_chip(joint);
        assert_eq!(chip.microsteps(), 16, "joint {joint}");
        let set = chip.currents(0.11).expect("the internal reference");
        for (set, configured) in set.into_iter().zip([run, hold]) {
            assert!(
                set <= configured + 1e-9 && set > configured - 0.056,
                "joint {joint}: {set}"
            );
        }
        assert_eq!(chip.register(GSTAT), 0, "joint {joint}");
    }
}

/// Without chips in the machine file the pins stay free; with them they are set before the enable
/// line rises for the first time, and the machine moves as with other drives.
#[test]
fn the_image_configures_the_chips_of_a_machine_file() {
    let plain = bench();
    let machine = with_chips(&plain);
    let mut session = session(board(&machine), &plain);
    let free = functions(session.line_mut());
    assert!(!free.contains(&UART), "{free:?}");
    assert_eq!(session.line_mut().chips.wire.sent, 0);
    let before = session.line_mut().cycles();
    session
        .configure(&machine)
        .expect("the board accepts the file");
    session.set_machine(&machine);
    // The chips still have the currents of the factory.
    let alarms = session.status().expect("an answer").lines().alarms;
    for joint in 0..3 {
        assert_eq!(alarms.of(joint), Some(DriveAlarm::Setting));
        assert_eq!(session.line_mut().drive_chip(joint).currents(0.11), None);
    }
    // The first request comes too early, and is repeated.
    session
        .ask(Command::Enable)
        .expect("the drives are ready in time");
    let board = session.line_mut();
    assert!(board.is_enabled());
    assert_set(board);
    assert_eq!(functions(board), [UART; 2]);
    assert_eq!(board.chips.wire.early_replies, 0);
    let rise = board.lines.enable.changes[0] as f64 / 1e15;
    let start = before as f64 / 150e6;
    println!("drives on {:.3} s after the machine file", rise - start);
    assert!(rise - start < 0.3, "{rise} {start}");

    let sent = session.line_mut().chips.wire.sent;
    move_by_one_millimetre(&mut session, &machine);
    let asked = session.line_mut().chips.wire.sent - sent;
    assert!(asked > 0, "the chips are asked meanwhile");
}

/// A chip without its supply keeps the drives off and names its joint. With its supply it is
/// configured, and the drives go on.
#[test]
fn a_silent_chip_keeps_the_drives_off_and_names_its_joint() {
    let machine = with_chips(&bench());
    let mut board = board(&machine);
    board.drive_chip(1).set_powered(false);
    let mut session = session(board, &machine);
    let refused = session.enable().expect_err("a chip is silent");
    assert!(
        refused
            .message
            .contains("the drive of y is not ready: its driver chip (address 0) does not answer"),
        "{refused:?}"
    );
    assert_eq!(alarms(&mut session), only(1, DriveAlarm::Silent));
    let board = session.line_mut();
    assert!(!board.is_enabled());
    assert!(board.lines.enable.changes.is_empty(), "it never rose");
    board.drive_chip(1).set_powered(true);
    session.enable().expect("the drives are ready");
    let board = session.line_mut();
    assert!(board.is_enabled());
    assert_set(board);
}

/// See [`assert_heat_ends_safe`].
#[test]
fn an_overheated_chip_in_motion_ends_safe() {
    let machine = with_chips(&mill());
    let set_temperature = |board: &mut Pico2, joint: usize, celsius: f64| {
        let chip = board.drive_chip(joint);
        chip.set_temperature(celsius);
        chip.drives()
    };
    assert_heat_ends_safe(
        session(board(&machine), &machine),
        set_temperature,
        assert_set,
    );
}

/// A reset of a chip by its supply in standstill, with the drives on, is a fault of its joint: its
/// motor would go on with other currents and microsteps.
#[test]
fn a_chip_that_was_reset_is_a_fault_of_its_joint() {
    let machine = with_chips(&bench());
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    steps(&mut session, 50);
    let chip = session.line_mut().drive_chip(2);
    chip.set_powered(false);
    chip.set_powered(true);
    assert_eq!(chip.microsteps(), 32, "that of its pins");
    // 60 ms.
    steps(&mut session, 300);
    let status = session.status().expect("the board answers");
    let alarm = DriveAlarm::Reset;
    assert_eq!(status.fault, Some(Fault::Drive { joint: 2, alarm }));
    assert!(!session.line_mut().is_enabled());
    assert_set(session.line_mut());
}

/// The image whose line is the UART has no bus: it never switches such a machine on.
#[test]
fn the_image_for_the_uart_refuses_joints_with_chips() {
    let machine = with_chips(&bench());
    let board = board_with(&uart_image(), &machine);
    assert_no_bus(board, &machine, "address 2");
}
