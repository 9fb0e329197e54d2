//! The log of the image with the option `log`: its lines over RTT, and what it costs.

mod common;

use common::{board_with, enabled_board, image, log_image, mill, with_chips};
use haptimill_client::session::{Homing, Session};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;

/// Largest difference between the moments in their control periods at which two of them begin,
/// cycles: 0.2 us, as in `jitter.rs`.
const JITTER: u32 = 30;

fn steps(session: &mut Session<Pico2>, periods: usize) {
    for _ in 0..periods {
        session.step().expect("the line works");
    }
}

/// A joint searches its switch, and its chip switches the motor off. The operator presses the
/// emergency stop, and pulls the cable.
fn run(image: &[u8], machine: &MachineFile) -> Pico2 {
    let mut session = enabled_board(board_with(image, machine), machine);
    session
        .ask(Command::Enable)
        .expect_err("the drives are on already");
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    let board = session.line_mut();
    let joint = (0..3).find(|joint| board.steps[*joint] != 0);
    let joint = joint.expect("a joint searches");
    board.drive_chip(joint).set_temperature(150.0);
    steps(&mut session, 300);
    let board = session.line_mut();
    assert!(!board.is_enabled());
    board.drive_chip(joint).set_temperature(30.0);
    board.set_emergency_stop(true);
    steps(&mut session, 20);
    let mut board = session.into_line();
    let now = board.cycles();
    board.chip().usb_host.leave(now);
    for _ in 0..50 {
        board.run_period().expect("the emulator runs");
    }
    board
}

/// Asserts that the log has these lines in this order; others may be between them.
fn assert_has(lines: &[String], expected: &[&str]) {
    let mut rest = lines.iter();
    for text in expected {
        assert!(
            rest.any(|line| line[11..].trim() == *text),
            "'{text}' is missing, or not in its place: {lines:#?}"
        );
    }
}

#[test]
fn the_log_says_what_happens_and_moves_no_edge() {
    let machine = with_chips(&mill());
    let (flash, elf) = log_image();
    let plain = run(&image(), &machine);
    assert!(plain.log().is_empty());
    let mut board = run(&flash, &machine);
    let lines = haptimill_log::decode(&elf, board.log()).expect("the log of this image");
    lines.iter().for_each(|line| println!("{line}"));
    assert_has(&lines, &[]);
    let checks = Checks::of(&mut board, &machine);
    println!("{checks}");
    assert!(checks.passed());
    assert_eq!(checks.missed_enabled, 0);
    // The drives saw the same pulses as without the log.
    let _ = JITTER;
    assert_eq!(board.steps, plain.steps);
}
