//! Faults at a board: each ends safe, and the board or its controller says why.

mod common;

use common::{
    ENDLESS_LOOP, board_with, enabled, fault, image, mill, replace_period, session, uart_image,
};
use haptimill_client::session::{Homing, Session};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::io::DriveCommand;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, Fault, State};

/// Pins of the home switches of the joints, and of the alarm of the drives.
const HOME_PINS: u32 = 0x1F << 15;
const ALARM_PIN: u32 = 1 << 28;
/// Control periods of the watchdog: 20 ms.
const WATCHDOG: usize = 100;

/// The mill whose controller waits for the host no longer than this, ms.
fn mill_with_heartbeat(heartbeat_ms: u32) -> MachineFile {
    let text = include_str!("mill3-short.toml");
    let own = format!("heartbeat_ms = {heartbeat_ms} ");
    let changed = text.replace("heartbeat_ms = 500 ", &own);
    assert_ne!(changed, text);
    MachineFile::parse("mill3-short.toml", &changed).unwrap_or_else(|error| panic!("{error}"))
}

fn steps(session: &mut Session<Pico2>, periods: usize) {
    for _ in 0..periods {
        session.step().expect("the line works");
    }
}

/// Runs the board without its host.
fn alone(board: &mut Pico2, periods: usize) {
    for _ in 0..periods {
        board.run_period().expect("the emulator runs");
    }
}

/// A control period that never ends: the charge pump stands, no pulse leaves, the watchdog resets
/// the chip, the drives are off, and the board says that it was the watchdog. It then takes a new
/// session on its USB port.
#[test]
fn a_control_period_that_never_ends_is_ended_by_the_watchdog() {
    let machine = mill();
    let mut session = enabled(&machine);
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    let board = session.line_mut();
    assert!(board.is_enabled());
    assert_eq!(board.periods.last().map(|it| it.cause), Some(1), "power");
    let (pump, before) = (board.pump, board.steps);
    alone(board, 10);
    assert!(board.pump >= pump + 9, "the pump works");
    assert_ne!(board.steps, before, "the joint moves");
    replace_period(board, ENDLESS_LOOP);
    // The words of two control periods have been handed over.
    alone(board, 3);
    let (pump, before) = (board.pump, board.steps);
    alone(board, WATCHDOG - 10);
    assert_eq!(board.chip().resets(), 0);
    assert_eq!((board.pump, board.steps), (pump, before), "no pulse");
    alone(board, 10);
    assert_eq!(board.chip().resets(), 1);
    assert!(!board.is_enabled());
    alone(board, 50);
    assert_eq!(board.periods.last().map(|it| it.cause), Some(2), "watchdog");
    assert!(!board.is_enabled());
    let mut session = common::session(session.into_line(), &machine);
    let status = session.status().expect("the board answers");
    assert_ne!(status.state, State::Fault);
    assert_eq!(session.line_mut().chip().wrong_usb_writes(), 0);
}

/// The supply of the board sags in a search. Its brown-out detector resets the chip, which starts
/// as after power-on while a joint still moves: no pulse leaves, the drives stay off, the position
/// is not known.
#[test]
fn a_brown_out_in_motion_leaves_the_drives_off() {
    let machine = mill();
    let mut session = enabled(&machine);
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    let before = session.line_mut().steps;
    steps(&mut session, 5);
    let board = session.into_line();
    assert_ne!(board.steps, before, "the joint moves");
    let mut board = Pico2::new(&image(), board.into_plant()).expect("the emulator starts");
    alone(&mut board, 50);
    assert_eq!(board.periods.last().map(|it| it.cause), Some(1), "power");
    let mut session = common::session(board, &machine);
    let status = session.status().expect("the board answers");
    assert_eq!((status.state, status.homed), (State::Disabled, false));
    let board = session.line_mut();
    assert!(board.lines.enable.changes.is_empty(), "it never rose");
    assert_eq!(board.steps, [0; 5]);
}

/// Pulls the cable while a joint moves: the controller misses its host after the heartbeat of the
/// machine file, and stops. The host then finds the board again, and the fault.
#[test]
fn a_cable_that_is_pulled_stops_the_machine() {
    let heartbeat_ms = 100;
    let machine = mill_with_heartbeat(heartbeat_ms);
    let mut session = enabled(&machine);
    let _homing = Homing::start(&mut session);
    steps(&mut session, 400);
    let board = session.line_mut();
    let before = board.steps;
    alone(board, 5);
    assert_ne!(board.steps, before, "the joint moves");
    let now = board.cycles();
    board.chip().usb_host.leave(now);
    let pulled = board.periods.len();
    alone(board, 900);
    let moved = |commands: &[DriveCommand]| {
        let steps = |command: &DriveCommand| match command {
            DriveCommand::Steps(segment) => segment.count != 0,
            _ => false,
        };
        commands.iter().any(steps)
    };
    let periods = &board.periods[pulled..];
    let stopped = periods.iter().rposition(|it| moved(&it.commands));
    let stopped = stopped.expect("it moved on at first") as u32;
    println!("at rest {} us after the cable was pulled", 200 * stopped);
    assert!(
        stopped >= 5 * heartbeat_ms - 400 && stopped < 5 * heartbeat_ms + 300,
        "{stopped}"
    );
    let reason = fault(board, machine.config.period_us);
    assert!(matches!(reason, Some(Fault::LostHost { .. })), "{reason:?}");
    let now = board.cycles();
    board.chip().usb_host.come_back(now);
    session.connect(2).expect("the board answers again");
    let status = session.status().expect("the board answers");
    assert_eq!(status.state, State::Fault);
    assert_eq!(status.fault, reason, "what the host reads");
    assert_eq!(session.line_mut().chip().wrong_usb_writes(), 0);
}

/// A host that sleeps shorter than the heartbeat goes on with the open port; the bytes of the
/// controller of meanwhile are lost, which the link repeats.
#[test]
fn a_host_that_sleeps_for_a_moment_goes_on() {
    let machine = mill();
    let mut session = enabled(&machine);
    for _ in 0..3 {
        let now = session.line_mut().cycles();
        session.line_mut().chip().usb_host.leave(now);
        alone(session.line_mut(), 40);
        let now = session.line_mut().cycles();
        session.line_mut().chip().usb_host.wake(now);
        let status = session.status().expect("the board answers");
        assert_ne!(status.state, State::Fault);
    }
    assert_eq!(session.line_mut().chip().wrong_usb_writes(), 0);
}

/// A program that does not read its port for longer than the board waits: old bytes are dropped,
/// and the session goes on.
#[test]
fn a_host_that_does_not_read_gets_no_old_frames() {
    let machine = mill();
    let mut session = enabled(&machine);
    session.line_mut().chip().usb_host.set_read(false);
    alone(session.line_mut(), 700);
    let board = session.line_mut();
    let room = board.periods.last().map(|it| it.inputs.transmit_room);
    println!("room for {room:?} bytes");
    board.chip().usb_host.set_read(true);
    session.connect(2).expect("the board answers");
    session.status().expect("the board answers");
}

/// Switches and the alarm of the drives chatter: no level of a control period counts, and the board
/// counts them.
#[test]
fn inputs_that_chatter_do_not_reach_the_controller() {
    let machine = mill();
    let mut session = enabled(&machine);
    let before = session
        .line_mut()
        .periods
        .last()
        .map_or(0, |it| it.glitches);
    let first = session.line_mut().periods.len();
    session.line_mut().set_noise(HOME_PINS | ALARM_PIN);
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    session.line_mut().set_noise(0);
    steps(&mut session, 5);
    let board = session.line_mut();
    for period in &board.periods[first..] {
        let axes = &period.inputs.joints[..3];
        assert!(axes.iter().all(|axis| !axis.home && axis.drive_ready));
    }
    assert_ne!(board.steps, [0; 5], "the joint moves");
    let counted = board.periods.last().map_or(0, |it| it.glitches) - before;
    println!("{counted} changes were suppressed");
    // Six inputs, every other of 300 control periods.
    assert!((800..=910).contains(&counted), "{counted}");
    // A level that lasts counts.
    let first = board.periods.len();
    board.set_alarm(true);
    steps(&mut session, 10);
    let periods = &session.line_mut().periods[first..];
    assert!(periods.iter().any(|it| !it.inputs.joints[0].drive_ready));
}

/// The image with a UART: noise between the frames does not disturb the session.
#[test]
fn noise_on_the_uart_does_not_disturb_the_session() {
    let machine = mill();
    let board = board_with(&uart_image(), &machine);
    let mut session = session(board, &machine);
    assert!(!session.line_mut().chip().uses_usb());
    session.enable().expect("the drives are ready");
    let mut noise = 0x2545_F491_u32;
    for _ in 0..300 {
        noise ^= noise << 13;
        noise ^= noise >> 17;
        noise ^= noise << 5;
        if noise.is_multiple_of(4) {
            session.line_mut().chip().receive(&noise.to_le_bytes()[..2]);
        }
        session.step().expect("the line works");
    }
    let status = session.status().expect("the board answers");
    assert_ne!(status.state, State::Fault);
    assert!(session.line_mut().is_enabled());
}

/// A host that floods the port while a joint moves: no pulse is late, no control period is missed.
#[test]
fn a_flood_of_bytes_does_not_disturb_the_pulses() {
    let machine = mill();
    let mut session = enabled(&machine);
    let _homing = Homing::start(&mut session);
    // Frames that are not sound, nearly as fast as the controller takes bytes.
    let mut junk = [0x55; 48];
    junk[47] = 0;
    for _ in 0..600 {
        session.line_mut().chip().receive(&junk);
        session.step().expect("the line works");
    }
    session.ask(Command::Stop).expect("the joint stops");
    steps(&mut session, 500);
    let mut board = session.into_line();
    let received: usize = board
        .periods
        .iter()
        .map(|it| it.inputs.received.len())
        .sum();
    println!("{received} bytes received");
    assert!(received > 28_000, "{received}");
    let checks = Checks::of(&mut board, &machine);
    println!("{checks}");
    assert!(checks.passed());
    assert_eq!(checks.missed_enabled, 0);
    assert!(checks.pulses.axes[2].pulses > 100);
}
