//! Chips of the drives at GP0 and GP1: the image sets the TMC2209 of a machine file before it
//! switches the drives on, watches them, and stops the machine when one of them fails.

mod common;

use common::{
    CHIPS, alarms, bench, board, board_with, mill, only, session, steps, uart_image, with_chips,
};
use haptimill_client::client::Options;
use haptimill_client::session::{Homing, NoObserver, Session, plan_straight_move};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_hil_sim::tmc2209::GSTAT;
use haptimill_protocol::message::{Command, DriveAlarm, Fault, State};
use std::sync::Arc;

/// Registers of the pins GP0 and GP1 (RP2350 datasheet, 9.11): function, and the outputs of UART0.
const IO_BANK0: u32 = 0x4002_8000;
const UART: u32 = 2;
const ENABLE: u32 = 12;

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

    session.home().expect("the joints are at their presets");
    let from = session.status().expect("the board answers").commanded;
    let mut to = session.model().to_engineering_units(&from);
    to[0] += 1.0;
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(&machine, session.model(), &from, &to, Some(600.0))
        .expect("the machine can make the move");
    let sent = session.line_mut().chips.wire.sent;
    let end = session
        .run_job(2, from, plan.setpoints, &mut NoObserver)
        .expect("the move begins");
    session.check_completed(&end).expect("the move is complete");
    steps(&mut session, 20);
    let board = session.line_mut();
    assert_eq!(board.steps, [640, 0, 0, 0, 0], "1 mm of 5 mm a turn");
    assert!(
        board.chips.wire.sent > sent,
        "the chips are asked meanwhile"
    );
    let late = board.periods.iter().map(|period| period.late).max();
    println!("control periods begin {late:?} cycles late at most");
    let checks = Checks::of(board, &machine);
    println!("{checks}");
    assert!(checks.passed());
    assert_eq!(checks.missed_enabled, 0);
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

/// A chip that switches its motor off because of its temperature, in a search for a switch: the
/// enable line falls, no pulse leaves from then on, and the fault names the joint. After it has
/// cooled down the drives go on again.
#[test]
fn an_overheated_chip_in_motion_ends_safe() {
    let machine = with_chips(&mill());
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    let joint = (0..3)
        .find(|joint| session.line_mut().steps[*joint] != 0)
        .expect("a joint searches");
    let board = session.line_mut();
    assert!(board.is_enabled());
    board.drive_chip(joint).set_temperature(150.0);
    assert!(!board.drive_chip(joint).drives());
    let hot = board.cycles();
    while session.line_mut().is_enabled() {
        steps(&mut session, 1);
        assert!(session.line_mut().cycles() < hot + 150 * 60_000, "60 ms");
    }
    let board = session.line_mut();
    let after = (board.cycles() - hot) as f64 / 150e3;
    println!("drives off {after:.1} ms after the chip switched its motor off");
    // Those of a control period that was handed over before.
    steps(&mut session, 2);
    let before = session.line_mut().steps;
    steps(&mut session, 200);
    let status = session.status().expect("the board answers");
    assert_eq!(session.line_mut().steps, before, "no pulse");
    assert_eq!(status.state, State::Fault);
    let alarm = DriveAlarm::Overheated;
    let fault = Fault::Drive {
        joint: joint as u8,
        alarm,
    };
    assert_eq!(status.fault, Some(fault));
    let said = session.fault(&fault).message;
    assert!(
        said.contains("is too hot and switched the motor off"),
        "{said}"
    );
    assert!(!session.line_mut().is_enabled());
    assert_eq!(alarms(&mut session), only(joint, alarm), "it is still hot");
    session.line_mut().drive_chip(joint).set_temperature(60.0);
    session.ask(Command::Reset).expect("the fault is reset");
    session.enable().expect("the drives are ready");
    assert!(session.line_mut().is_enabled());
    assert_set(session.line_mut());
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
    let mut session = Session::new(board, &machine, Options::default(), Arc::default());
    session.connect(1).expect("the board answers");
    session.configure(&machine).expect("it takes the file");
    let refused = session.enable().expect_err("no bus");
    assert!(
        refused
            .message
            .contains("the drive of x is not ready: its driver chip (address 2) has no bus"),
        "{refused:?}"
    );
    let board = session.line_mut();
    assert!(!board.level(ENABLE));
    assert!(board.lines.enable.changes.is_empty(), "it never rose");
}
