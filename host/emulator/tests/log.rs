//! The log of the image with the option `log`: its lines over RTT, and what it costs.

mod common;

use common::chips::with_chips;
use common::{
    ENDLESS_LOOP, LOG_IMAGE, board_with, enabled_board, image, log_image, mill, path,
    replace_period, steps,
};
use haptimill_client::session::pins::record::Period;
use haptimill_client::session::{Homing, Session};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::io::DriveCommand;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;
use haptimill_pulses::FaultKind;
use std::path::Path;
use std::process;

/// Largest difference between the moments in their control periods at which two of them begin,
/// cycles: 0.2 us, as in `jitter.rs`.
const JITTER: u32 = 30;
/// Largest numbers of cycles by which a control period is longer than without a log: with the three
/// lines of a fault, and on average without a line.
const FAULT_CYCLES: i64 = 6000;
const SILENT_CYCLES: f64 = 150.0;
/// Control periods in which the watchdog has reset the chip, and the image runs again: its start
/// takes some.
const WATCHDOG: usize = 150;
/// Refusals whose lines need more room than the buffer has.
const REFUSALS: usize = 100;

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

/// The lines of a log, by the program that prints the log of the emulated Cortex-M4F: it has the
/// decoder of defmt, and a lock file of its own.
fn decoded(board: &Pico2) -> Vec<String> {
    let log = &board.log.as_ref().expect("the image has a log").bytes;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}.log", log.len()));
    std::fs::write(&file, log).expect("written");
    let output = process::Command::new(env!("CARGO"))
        .args(["run", "--quiet", "--locked", "--manifest-path"])
        .arg(root.join("tests/log/Cargo.toml"))
        .arg("--")
        .args([Path::new(&path(LOG_IMAGE)), &file])
        .output()
        .expect("cargo starts");
    let [text, problem] = [output.stdout, output.stderr].map(String::from_utf8);
    assert!(output.status.success(), "{}", problem.expect("text"));
    let text = text.expect("text");
    println!("{text}{} bytes", log.len());
    text.lines().map(String::from).collect()
}

/// The control periods from the first one with a drive on.
fn with_drives(board: &Pico2) -> &[Period] {
    let is_on = |period: &Period| period.commands.iter().any(|it| *it != DriveCommand::Off);
    let first = board.periods.iter().position(is_on);
    &board.periods[first.expect("a control period with a drive on")..]
}

/// The control period in which the controller sees the alarm of the chip.
fn of_fault(board: &Pico2) -> &Period {
    let alarm = |period: &&Period| period.inputs.joints[..3].iter().any(|it| !it.drive_ready);
    with_drives(board).iter().find(alarm).expect("an alarm")
}

/// Control period of a line.
fn period(line: &str) -> u64 {
    line[..10].trim().parse().expect("a number")
}

/// The log has the lines of the run in their order, no control period is missed, and the moments at
/// which they begin, and all pulses, are those of the image without a log.
#[test]
fn the_log_says_what_happens_and_moves_no_edge() {
    let machine = with_chips(&mill());
    let mut plain = run(&image(), &machine);
    assert!(plain.log.is_none());
    let mut board = run(&log_image(), &machine);
    let lines = decoded(&board);
    let expected = [
        "info  haptimill-pico2 0.1.0, protocol ",
        "info  reset: Power",
        "info  kept configuration: Nothing",
        "info  USB: connected",
        "info  a session begins",
        "info  configuration ",
        "warn  missed control periods: ",
        "warn  drive of joint 0: Setting",
        "warn  request 3 refused: Input(Drive { joint: 0, alarm: Setting })",
        "info  drive of joint 0: ready",
        "info  State { from: Disabled, to: Idle, homed: false }",
        "warn  request 7 refused: State(Idle)",
        "info  State { from: Idle, to: Homing, homed: false }",
        "warn  drive of joint 2: Overheated",
        "error fault: Drive { joint: 2, alarm: Overheated }",
        "info  State { from: Homing, to: Fault, homed: false }",
        "info  State { from: Fault, to: EmergencyStop, homed: false }",
        "info  USB: disconnected",
    ];
    let mut rest = lines.iter();
    for text in expected {
        assert!(
            rest.any(|line| line[11..].starts_with(text)),
            "'{text}' is missing, or not in its place"
        );
    }
    assert!(lines.is_sorted_by_key(|line| period(line)));

    let checks = [&mut plain, &mut board].map(|board| Checks::of(board, &machine));
    let [without, with] = &checks;
    println!("{with}");
    for checks in &checks {
        assert_eq!(checks.missed_enabled, 0);
        assert_eq!(checks.differing, None);
        assert!(checks.late.1 - checks.late.0 <= JITTER, "{:?}", checks.late);
        assert!(checks.pulses.compared() >= 1000);
        for axis in &checks.pulses.axes {
            assert!(axis.largest_error <= 1, "{axis:?}");
            assert_eq!(axis.commanded, Some(axis.count), "{axis:?}");
            // Pulses that were handed over before the chip failed leave after it.
            let mut faults = axis.faults.iter();
            assert!(
                faults.all(|fault| fault.kind == FaultKind::Disabled),
                "{axis:?}"
            );
        }
    }

    let [before, fault] = [&plain, &board].map(|board| i64::from(of_fault(board).busy));
    let pairs = with_drives(&plain).iter().zip(with_drives(&board));
    // The polls of the chips and the requests come at moments of their own.
    let equal = pairs.take_while(|(plain, logged)| plain.commands == logged.commands);
    let silent: Vec<i64> = equal
        .filter(|(_, logged)| !lines.iter().any(|it| period(it) == logged.inputs.period))
        .map(|(plain, logged)| i64::from(logged.busy) - i64::from(plain.busy))
        .collect();
    let mean = silent.iter().sum::<i64>() as f64 / silent.len() as f64;
    println!(
        "cycles with and without a log: {fault} and {before} of the fault; {} and {} of the worst \
         control period, which begin {:?} and {:?} late; {mean:.0} more on average without a line, of {} control periods",
        with.busy,
        without.busy,
        with.late,
        without.late,
        silent.len()
    );
    assert!(silent.len() >= 200, "{}", silent.len());
    assert!(fault - before <= FAULT_CYCLES, "{fault} {before}");
    assert!(mean <= SILENT_CYCLES, "{mean}");
}

/// After a reset by the watchdog the log begins again, with the cause.
#[test]
fn the_log_names_the_cause_of_a_reset() {
    let mut board = board_with(&log_image(), &mill());
    replace_period(&mut board, ENDLESS_LOOP);
    for _ in 0..WATCHDOG {
        board.run_period().expect("the emulator runs");
    }
    assert_eq!(board.chip().resets(), 1);
    let lines = decoded(&board);
    let resets = lines.iter().filter(|line| line.contains(" reset: "));
    let resets: Vec<&str> = resets.map(|line| line[11..].trim()).collect();
    assert_eq!(resets, ["info  reset: Power", "error reset: Watchdog"]);
}

/// Without a probe the board goes on: the first lines stay in the buffer, and others are lost as a
/// whole. With a probe there are new ones again.
#[test]
fn a_log_that_no_one_reads_stops_nothing() {
    let machine = mill();
    let board = board_with(&log_image(), &machine);
    let mut session = enabled_board(board, &machine);
    let refuse = |session: &mut Session<Pico2>, is_unread: bool| {
        let log = session.line_mut().log.as_mut().expect("a log");
        log.is_unread = is_unread;
        session
            .ask(Command::Enable)
            .expect_err("the drives are on already");
    };
    for _ in 0..REFUSALS {
        refuse(&mut session, true);
    }
    // It takes what is in the buffer, and then there is room.
    steps(&mut session, 1);
    for _ in 0..2 {
        refuse(&mut session, false);
    }
    steps(&mut session, 1);
    let mut board = session.into_line();
    let lines = decoded(&board);
    let refused = lines.iter().filter(|line| line.contains("refused"));
    let refused = refused.count();
    println!("{refused} of {} refusals", REFUSALS + 2);
    assert!(refused > REFUSALS / 4 && refused < REFUSALS, "{refused}");
    let checks = Checks::of(&mut board, &machine);
    assert!(checks.passed() && checks.missed_enabled == 0, "{checks}");
}
